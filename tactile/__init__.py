"""Contact force maps from pad and camera: an application of `structures` and `loadid`.

Closed forms (`Layer`, `HalfSpace`, `Press`, ...), finite-element pads (`Pad`), images to motion (`Eye`, `View`,
`MarkerTracker`), sensors with one face (`MultilayerPad`, `LayerSensor`, `GelSlim`, `GelForce`), and around them
`metrics`, `design`, `material` and `GelMonitor`.
"""

from __future__ import annotations

import importlib
import logging
from typing import Any

_PUBLIC = {
    "ContactLaw": "tactile._sensors.marked",
    "ContactPrior": "tactile._sensors.prior",
    "Cylinder": "tactile._closed.contact",
    "DepthMap": "tactile._sensors.observation",
    "Extent": "tactile._sensors.marked",
    "Eye": "tactile.vision._eye",
    "ForceMap": "tactile._results.forcemap",
    "GelForce": "tactile._sensors.gelforce",
    "GelMonitor": "tactile.material._monitor",
    "GelSlim": "tactile._sensors.gelslim",
    "HalfSpace": "tactile._closed.layer",
    "Hertz": "tactile._closed.contact",
    "ImageMotion": "tactile._sensors.image",
    "Interpolation": "tactile.vision._interpolation",
    "Layer": "tactile._closed.layer",
    "LayerGrid": "tactile._closed.gridded",
    "LayerSensor": "tactile._sensors.layered",
    "LearnedSensor": "tactile._sensors.learned",
    "MarkerTracker": "tactile.vision._tracker",
    "Markers": "tactile._sensors.observation",
    "Mindlin": "tactile._closed.contact",
    "MultilayerPad": "tactile._sensors.multilayer",
    "Pad": "tactile._pad.pad",
    "Press": "tactile._closed.presses",
    "RigidBody": "tactile._closed.rigid_contact",
    "RigidContact": "tactile._closed.rigid_contact",
    "Sphere": "tactile._closed.contact",
    "Tolerances": "tactile._pad.tolerances",
    "View": "tactile.vision._eye",
    "Wrench": "tactile._sensors.observation",
    "frames": "tactile.vision._frames",
    "press_and_slide": "tactile._closed.presses",
}
_PARTS = {
    "datasets": "tactile.datasets",
    "design": "tactile.design",
    "generate": "tactile.generate",
    "halfspace": "tactile._closed.halfspace",
    "live": "tactile.live",
    "material": "tactile.material",
    "metrics": "tactile.metrics",
    "outline": "tactile._pad.body",
    "shapes": "tactile._closed.shapes",
    "vision": "tactile.vision",
}
_UNLISTED = {"Interpolation", "Mindlin", "halfspace", "press_and_slide"}  # imported as in release 0.1

__all__ = sorted({*_PUBLIC, *_PARTS} - _UNLISTED)

logging.getLogger("tactile").addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(_PUBLIC[name]), name)
    if name in _PARTS:
        return importlib.import_module(_PARTS[name])
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
