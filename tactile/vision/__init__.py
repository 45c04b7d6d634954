"""Images to displacements: frames are read, dots detected, matched to the previous frame, and counted where lost."""

from __future__ import annotations

from ._detect import Detected, Detector, detect, size_of_dots  # noqa: F401
from ._frames import Frames, frames  # noqa: F401
from ._motion import Jitter, MarkerMotion, MarkerMotions, jitter, read_motions  # noqa: F401
from ._tracker import MarkerTracker, match  # noqa: F401

__all__ = ["Detector", "MarkerTracker", "detect", "frames", "jitter", "read_motions"]
