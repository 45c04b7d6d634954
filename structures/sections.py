"""Cross-sections of beams."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .errors import InputError
from .values import positive


@dataclass(frozen=True)
class Section:
    """A cross-section that bends about one principal axis.

    Parameters
    ----------
    A : float
        Area (m^2).
    I : float
        Second moment of area about the axis of bending (m^4).
    c : float
        Distance of the outer fibre from the neutral axis (m); where a strain gauge sits.

    Raises
    ------
    InputError
        If a value is not positive.
    """

    A: float
    I: float  # noqa: E741  (the field's symbol)
    c: float

    def __post_init__(self) -> None:
        for name in ("A", "I", "c"):
            _positive(name, getattr(self, name))

    @classmethod
    def rectangle(cls, width: float, height: float) -> Section:
        """Solid rectangle that bends over its `height` (m)."""
        _positive("width", width)
        _positive("height", height)
        return cls(A=width * height, I=width * height**3 / 12, c=height / 2)

    @classmethod
    def circle(cls, diameter: float) -> Section:
        """Solid circle of `diameter` (m)."""
        _positive("diameter", diameter)
        return cls(A=math.pi * diameter**2 / 4, I=math.pi * diameter**4 / 64, c=diameter / 2)

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
        return cls(A=area, I=area * (diameter**2 + inner**2) / 16, c=diameter / 2)


def _positive(name: str, value: float) -> None:
    positive(name, value, where="section", unit="m, m^2 or m^4")
