"""Modulus and Poisson's ratio of a gel from tensile and indentation tests, and what those tests do not show."""

from __future__ import annotations

from .._closed.contact import flat_stiffness, sphere_contact, sphere_force
from ._curves import Indentation, Tensile
from ._fits import Verdict
from ._identify import Gain, MaterialFit, Shape, from_tests, gain, poisson

__all__ = [
    "Gain",
    "Indentation",
    "MaterialFit",
    "Shape",
    "Tensile",
    "Verdict",
    "flat_stiffness",
    "from_tests",
    "gain",
    "poisson",
    "sphere_contact",
    "sphere_force",
]
