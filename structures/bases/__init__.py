"""Load bases: nodal forces, patches, hats and polynomials on beams, plates and faces of solids."""

from __future__ import annotations

from ._basis import Basis, BasisLoad
from ._builders import hats, patches, polynomials
from ._nodes import nodal

__all__ = ["Basis", "BasisLoad", "hats", "nodal", "patches", "polynomials"]
