"""Cross-sections of beams and frames."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .errors import InputError
from .values import pair, positive

SERIES = 60  # odd terms of the torsion series: the next one is below 1e-10 of the sum


@dataclass(frozen=True)
class Section:
    """A cross-section with the principal axes y (width) and z (height).

    A beam bends over the height z and needs the first three values only; a plane frame with shear also needs `shear`,
    and a space frame needs `I_z` and `J`.

    Parameters
    ----------
    A : float
        Area (m^2).
    I : float
        Second moment of area about y: bending over the height z, as of a beam and a plane frame (m^4).
    c : float
        Distance of the outer fibre along z from the neutral axis (m); where a strain gauge sits.
    I_z : float, optional
        Second moment of area about z: bending over the width y (m^4).
    c_y : float, optional
        Distance of the outer fibre along y (m).
    J : float, optional
        Torsion constant of St Venant (m^4).
    shear : (float, float), optional
        Shear factors kappa along y and z: the stiffness against shear is kappa G A.

    Raises
    ------
    InputError
        If a value is not positive.

    Notes
    -----
    The shear factors of the ready shapes are those of G. R. Cowper, "The shear coefficient in Timoshenko's beam
    theory", J. Appl. Mech. 33 (1966) 335-340, at nu = 0: 5/6, 6/7, and 1/2 for a thin tube.
    """

    A: float
    I: float  # noqa: E741  (the field's symbol)
    c: float
    I_z: float | None = None
    c_y: float | None = None
    J: float | None = None
    shear: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("A", "I", "c", "I_z", "c_y", "J"):
            value = getattr(self, name)
            if value is not None or name in ("A", "I", "c"):
                _positive(name, value)
        if self.shear is not None:
            factors = pair("shear", self.shear, where="section")
            for factor in factors:
                _positive("a shear factor", factor)
            object.__setattr__(self, "shear", factors)

    @classmethod
    def rectangle(cls, width: float, height: float) -> Section:
        """Solid rectangle, `width` along y and `height` along z (m)."""
        _positive("width", width)
        _positive("height", height)
        return cls(
            A=width * height,
            I=width * height**3 / 12,
            c=height / 2,
            I_z=height * width**3 / 12,
            c_y=width / 2,
            J=_torsion(max(width, height), min(width, height)),
            shear=(5 / 6, 5 / 6),
        )

    @classmethod
    def circle(cls, diameter: float) -> Section:
        """Solid circle of `diameter` (m)."""
        _positive("diameter", diameter)
        return cls._round(math.pi * diameter**2 / 4, math.pi * diameter**4 / 64, diameter, 0.0)

    @classmethod
    def tube(cls, diameter: float, wall: float) -> Section:
        """Round tube of outer `diameter` and `wall` thickness (m)."""
        _positive("diameter", diameter)
        _positive("wall", wall)
        if wall > diameter / 2:
            raise InputError(
                "the wall is thicker than the radius",
                where="section",
                found=wall,
                expected=f"<= {diameter / 2:g} m",
                hint="give the outer diameter; Section.circle is the solid one",
            )
        # written as products: the difference of two fourth powers would cancel for a thin wall
        inner = diameter - 2 * wall
        area = math.pi * wall * (diameter - wall)
        return cls._round(area, area * (diameter**2 + inner**2) / 16, diameter, inner / diameter)

    @classmethod
    def _round(cls, area: float, second: float, diameter: float, ratio: float) -> Section:
        """Section that is the same about every axis; `ratio` is the inner over the outer diameter."""
        a = (1 + ratio**2) ** 2
        kappa = 6 * a / (7 * a + 20 * ratio**2)
        return cls(area, second, diameter / 2, second, diameter / 2, 2 * second, (kappa, kappa))


def _torsion(long: float, short: float) -> float:
    """Torsion constant of a rectangle.

    S. P. Timoshenko, J. N. Goodier, *Theory of Elasticity*, 3rd ed. (1970), article 109: exact, as a series.
    """
    ratio = long / short
    odd = range(1, 2 * SERIES, 2)
    series = sum(math.tanh(n * math.pi * ratio / 2) / n**5 for n in odd)
    return long * short**3 / 3 * (1 - 192 / math.pi**5 / ratio * series)


def _positive(name: str, value: float | None) -> None:
    positive(name, value, where="section", unit="m, m^2 or m^4")
