"""Structures from files: K, M and C in npz, Matrix Market and HDF5, with a plain DOF table; and back."""

from __future__ import annotations

from .reading import load
from .writing import save

__all__ = ["load", "save"]
