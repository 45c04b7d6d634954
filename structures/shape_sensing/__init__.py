"""Shape sensing: the displacements of a structure from measured strains, without its loads and its stiffness.

The inverse finite element method of Tessler and Spangler; the other method of that name, from displacements to forces,
is `tactile`'s. From displacements on to the load of a plate: `loadid.ShapeSensing`.
"""

from __future__ import annotations

from ._elements import QuadPlate
from ._sensing import InverseFEM, SensedField

__all__ = ["InverseFEM", "QuadPlate", "SensedField"]
