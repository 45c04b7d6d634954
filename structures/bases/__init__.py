"""Load bases: nodal forces, patches, hats and polynomials on beams, plates and faces of solids."""

from __future__ import annotations

from .basis import Basis, BasisLoad
from .builders import hats, patches, polynomials
from .nodes import nodal

__all__ = ["Basis", "BasisLoad", "hats", "nodal", "patches", "polynomials"]
