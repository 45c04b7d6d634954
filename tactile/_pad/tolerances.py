"""How well a gel is known that nobody measured to the last digit: what bands and a calibration start from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

from structures.errors import InputError, number

WIDEST = 1.0  # of a relative std; beyond it nothing is known


@dataclass(frozen=True)
class Tolerances:
    """Standard deviations of what a pad is built with; 0 is exactly known.

    Parameters
    ----------
    E, thickness : float
        Relative: 0.1 is 10 %.
    nu : float
        Of Poisson's ratio itself.

    Raises
    ------
    InputError
        A std that is negative or NaN, a relative one above 1, one of nu above 0.5.
    """

    E: float = 0.0
    nu: float = 0.0
    thickness: float = 0.0

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self)):
            value = number(name, getattr(self, name), where="Tolerances")
            widest = 0.5 if name == "nu" else WIDEST
            if not 0 <= value <= widest:
                raise InputError(
                    f"{name} cannot be known to this", where=f"Tolerances, {name}", found=value,
                    expected=f"0 to {widest:g}",
                    hint="a std: of nu itself, of modulus and thickness relative to their values (0.1 is 10 %)",
                )  # fmt: skip
            object.__setattr__(self, name, value)

    def beyond(self, held: Mapping[str, float]) -> Tolerances:
        """What of them is left, where stds of some size are held already: by name, their squares apart."""
        left = {f.name: getattr(self, f.name) ** 2 - held.get(f.name, 0.0) ** 2 for f in fields(self)}
        return Tolerances(**{name: max(value, 0.0) ** 0.5 for name, value in left.items()})
