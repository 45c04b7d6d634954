"""Materials of beams and plates."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import InputError
from .values import positive, real, shown


@dataclass(frozen=True)
class Material:
    """A linear elastic, isotropic material.

    Parameters
    ----------
    E : float
        Young's modulus (Pa).
    rho : float
        Density (kg/m^3).
    nu : float
        Poisson's ratio, between -1 and 0.5.

    Raises
    ------
    InputError
        If a value is not possible.
    """

    E: float
    rho: float
    nu: float = 0.3

    def __post_init__(self) -> None:
        positive("E", self.E, where="material", unit="Pa")
        positive("rho", self.rho, where="material", unit="kg/m^3")
        nu = real(self.nu)
        if nu is None or not -1 < nu < 0.5:
            raise InputError(
                "Poisson's ratio is not possible",
                where="material",
                found=shown(self.nu),
                expected="-1 < nu < 0.5",
                hint="most metals have 0.3",
            )


steel = Material(E=210e9, rho=7850.0, nu=0.30)
aluminium = Material(E=70e9, rho=2700.0, nu=0.33)
