"""Skin design as conditioning: what a pad, its markers and its camera can tell, before any of them is made."""

from __future__ import annotations

from ._evaluation import SkinComparison, SkinDesign, compare, skin  # noqa: F401
from ._modes import Skin, effective_markers  # noqa: F401
from ._resolution import largest_strain, locking, strains  # noqa: F401

__all__ = ["Skin", "compare", "largest_strain", "locking", "skin"]
