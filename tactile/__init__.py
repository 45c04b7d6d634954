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
    "Cylinder": "tactile.indenters",
    "DepthMap": "tactile.reading",
    "Eye": "tactile.eye",
    "ForceMap": "tactile.forcemap",
    "GelForce": "tactile.gelforce",
    "GelMonitor": "tactile.monitor",
    "GelSlim": "tactile.gelslim",
    "HalfSpace": "tactile.layer",
    "Hertz": "tactile.contact",
    "Interpolation": "tactile.interpolation",
    "Layer": "tactile.layer",
    "LayerGrid": "tactile.gridded",
    "MarkerTracker": "tactile.vision.tracker",
    "Mindlin": "tactile.contact",
    "MultilayerPad": "tactile.multilayer",
    "Pad": "tactile.pad",
    "Press": "tactile.presses",
    "Sphere": "tactile.indenters",
    "View": "tactile.optics",
    "Wrench": "tactile.reading",
    "frames": "tactile.vision.frames",
    "press_and_slide": "tactile.presses",
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
