"""Skin design as conditioning: what a pad, its markers and its camera can tell, before any of them is made."""

from __future__ import annotations

from .comparison import SkinComparison, compare
from .judged import SkinDesign, skin
from .locked import locking
from .markers import effective_markers
from .parameters import Skin
from .strain import largest_strain, strains

__all__ = [
    "Skin",
    "SkinComparison",
    "SkinDesign",
    "compare",
    "effective_markers",
    "largest_strain",
    "locking",
    "skin",
    "strains",
]
