"""Images to displacements: frames are read, dots detected, matched to the previous frame, and counted where lost."""

from __future__ import annotations

from ._detect import Detected, Detector, detect, size_of_dots
from ._frames import Frames, frames
from ._motion import Jitter, MarkerMotion, MarkerMotions, jitter, read_motions
from ._tracker import MarkerTracker, match

__all__ = [
    "Detected",
    "Detector",
    "Frames",
    "Jitter",
    "MarkerMotion",
    "MarkerMotions",
    "MarkerTracker",
    "detect",
    "frames",
    "jitter",
    "match",
    "read_motions",
    "size_of_dots",
]
