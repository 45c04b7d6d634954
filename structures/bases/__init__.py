"""Load bases: nodal forces, patches, hats and polynomials on beams, plates and faces of solids."""

from __future__ import annotations

from ._basis import Basis
from ._basis import BasisLoad as BasisLoad
from ._builders import hats, patches, polynomials
from ._nodes import nodal

__all__ = ["Basis", "hats", "nodal", "patches", "polynomials"]
