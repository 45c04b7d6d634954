"""What one row (sensor) or one column (load) of a forward model is called and measured in."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .errors import InputError

ARBITRARY = "arbitrary"
# What nearly every channel is: it passes without a look at the table of units.
_USUAL = {
    ("displacement", "m"), ("velocity", "m/s"), ("acceleration", "m/s^2"), ("strain", "m/m"), ("strain", "1"),
    ("force", "N"), ("moment", "N*m"), ("pressure", "Pa"), ("line_load", "N/m"), ("angle", "rad"),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One sensor or one load, described.

    Parameters
    ----------
    label : str
        Name, unique within the model.
    quantity : str
        ``displacement, velocity, acceleration, strain, force, moment, pressure, line_load``, another quantity of
        `structures.units`, or ``arbitrary``.
    unit : str
        SI unit of the numbers that the model takes and gives (``m/s^2``, ``N``), or ``arbitrary``. What a file was
        recorded in (g, kN, mV) is stated where it is read, and converted there.
    noise : float, optional
        Standard deviation of the noise of a sensor, in `unit`.
    highpass : float, optional
        Corner frequency of a first-order high-pass (AC coupling) in Hz.
    measure : float, optional
        Tributary length (m) or area (m^2) of a load.

    Raises
    ------
    InputError
        If the label is empty or no text, the unit is unknown, not SI or none of the quantity, or noise, highpass or
        measure is not a positive number.
    """

    label: str
    quantity: str = "arbitrary"
    unit: str = "arbitrary"
    noise: float | None = None
    highpass: float | None = None
    measure: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.label, str) or not self.label:
            raise InputError(
                "a channel needs a name",
                where="channel",
                found=repr(self.label),
                expected="a text that is not empty",
                hint='pass label="a1"',
            )
        for name, unit in (("noise", "in the unit of the channel"), ("highpass", "in Hz"), ("measure", "in m or m^2")):
            value = getattr(self, name)
            if value is not None and not positive(value):
                raise InputError(
                    f"{name} must be positive",
                    where=f"channel {self.label}",
                    found=repr(value),
                    expected=f"one number > 0, {unit}",
                    hint=f"leave {name} out where it is not known",
                )
        if (self.quantity, self.unit) not in _USUAL and not self.quantity == self.unit == ARBITRARY:
            _check_unit(self)


def positive(value: object) -> bool:
    """Whether a value is one finite, positive number."""
    try:
        return not isinstance(value, bool | str) and math.isfinite(value) and value > 0  # type: ignore[arg-type, operator]
    except (TypeError, ValueError):
        return False


def _check_unit(channel: Channel) -> None:
    """Refuse a quantity or unit that nobody knows, a unit of another quantity, and one that is not SI."""
    from . import units  # the table is wanted for unusual channels only

    where = f"channel {channel.label}"
    if channel.quantity not in units.QUANTITIES and channel.quantity not in (ARBITRARY, "other"):
        raise InputError(
            "unknown quantity",
            where=where,
            found=repr(channel.quantity),
            expected=", ".join(units.QUANTITIES),
            hint='quantity="arbitrary" where none fits',
        )
    if channel.unit == ARBITRARY or (channel.unit == "1" and channel.quantity in (ARBITRARY, "other")):
        return  # 1 is the unit of any ratio
    unit = units.parse(channel.unit, channel=channel.label)
    if channel.quantity not in (ARBITRARY, "other"):
        units.check(unit, channel.quantity, channel=channel.label)
    if unit.factor != 1.0:
        raise InputError(
            f"a channel speaks SI, and {unit.symbol} is {unit.factor:g} {unit.si}",
            where=where,
            found=repr(channel.unit),
            expected=unit.si,
            hint=f"leave unit out here, and state it on the record, which converts the numbers: "
            f'read(..., units={{"{channel.label}": "{unit.symbol}"}}) or record.apply_units(...)',
        )
