"""Images to displacements: frames are read, dots detected, matched to the previous frame, and counted where lost."""

from __future__ import annotations

import importlib
from typing import Any

_PUBLIC = {
    "Detected": "detect",
    "Detector": "detect",
    "Frames": "frames",
    "Jitter": "noise",
    "MarkerTracker": "tracker",
    "Motion": "motion",
    "Motions": "motions",
    "detect": "detect",
    "frames": "frames",
    "match": "match",
    "read_motions": "motions",
}
_MODULES = ("backend", "grey", "noise", "scale")

__all__ = sorted({*_PUBLIC, *_MODULES})


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(f".{_PUBLIC[name]}", __name__), name)
    if name in _MODULES:
        return importlib.import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
