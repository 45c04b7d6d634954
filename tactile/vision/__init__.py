"""Images to displacements: frames are read, dots detected, matched to the previous frame, and counted where lost."""

from __future__ import annotations

from .detect import Detected, Detector, detect
from .frames import Frames, frames
from .match import match
from .motion import Motion
from .motions import Motions, read_motions
from .noise import Jitter, jitter
from .scale import size_of_dots
from .tracker import MarkerTracker

__all__ = [
    "Detected",
    "Detector",
    "Frames",
    "Jitter",
    "MarkerTracker",
    "Motion",
    "Motions",
    "detect",
    "frames",
    "jitter",
    "match",
    "read_motions",
    "size_of_dots",
]
