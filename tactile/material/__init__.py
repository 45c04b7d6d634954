"""Modulus and Poisson's ratio of a gel from tensile and indentation tests, and what those tests do not show."""

from __future__ import annotations

from ..closed.contact import flat_stiffness, sphere_contact, sphere_force
from .curves import Indentation, Tensile
from .fits import Verdict
from .identify import MaterialFit, from_tests

__all__ = [
    "Indentation",
    "MaterialFit",
    "Tensile",
    "Verdict",
    "flat_stiffness",
    "from_tests",
    "sphere_contact",
    "sphere_force",
]
