"""Modulus and Poisson's ratio of a gel from tensile and indentation tests, and what those tests do not show."""

from __future__ import annotations

from .._closed.contact import flat_stiffness, sphere_contact, sphere_force  # noqa: F401
from ._fits import Indentation, Tensile, Verdict  # noqa: F401
from ._identify import Gain, MaterialFit, Shape, from_tests, gain, poisson  # noqa: F401

__all__ = ["Indentation", "Tensile", "from_tests", "gain", "poisson"]
