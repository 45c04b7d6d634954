"""Contact force maps from pad and camera: an application of `structures` and `loadid`.

Closed forms (`Layer`, `HalfSpace`, `Press`, ...), finite-element pads (`Pad`), images to motion (`Eye`, `View`,
`MarkerTracker`), sensors with one face (`MultilayerPad`, `GelSlim`, `GelForce`), and around them `metrics`, `design`,
`material` and `GelMonitor`.
"""

from __future__ import annotations

import importlib
import logging
from typing import Any

_PUBLIC = {
    "ContactLaw": "tactile.sensors.settings",
    "Cylinder": "tactile.closed.contact",
    "DepthMap": "tactile.sensors.observation",
    "Extent": "tactile.sensors.settings",
    "Eye": "tactile.vision.eye",
    "ForceMap": "tactile.results.forcemap",
    "GelForce": "tactile.sensors.gelforce",
    "GelMonitor": "tactile.material.monitor",
    "GelSlim": "tactile.sensors.gelslim",
    "HalfSpace": "tactile.closed.layer",
    "Hertz": "tactile.closed.contact",
    "Interpolation": "tactile.vision.interpolation",
    "Layer": "tactile.closed.layer",
    "LayerGrid": "tactile.closed.gridded",
    "MarkerTracker": "tactile.vision.tracker",
    "Markers": "tactile.sensors.observation",
    "Mindlin": "tactile.closed.contact",
    "MultilayerPad": "tactile.sensors.multilayer",
    "Pad": "tactile.pad.pad",
    "Press": "tactile.closed.presses",
    "Sphere": "tactile.closed.contact",
    "View": "tactile.vision.eye",
    "Wrench": "tactile.sensors.observation",
    "frames": "tactile.vision.frames",
    "press_and_slide": "tactile.closed.presses",
}
_PARTS = ("design", "material", "metrics", "vision")

__all__ = sorted([*_PUBLIC, *_PARTS])

logging.getLogger("tactile").addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(_PUBLIC[name]), name)
    if name in _PARTS:
        return importlib.import_module(f"tactile.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
