"""Skin design as conditioning: what a pad, its markers and its camera can tell, before any of them is made."""

from __future__ import annotations

from ._evaluation import SkinComparison, SkinDesign, compare, skin
from ._modes import Skin, effective_markers
from ._resolution import largest_strain, locking, strains

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
