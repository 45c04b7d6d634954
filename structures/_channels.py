"""Degrees of freedom, and what one row (sensor) or one column (load) of a forward model is called and measured in."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from .errors import InputError, positive, whole

TWIST = 7
_NAMES = ("S", "X", "Y", "Z", "RX", "RY", "RZ", "XY")
_CODES = {name: code for code, name in enumerate(_NAMES)}
_UNITS = ("arbitrary", "m", "m", "m", "rad", "rad", "rad", "1/m")
_NAME = "|".join(sorted(_NAMES, key=len, reverse=True))
_FORMS = (
    re.compile(rf"(?P<node>[0-9]+):?(?P<sign>[+-])(?P<name>{_NAME})"),
    re.compile(rf"(?P<node>[0-9]+)(?P<name>{_NAME})(?P<sign>[+-])"),
)
_EXPECTED = "a label such as 12+Z, 12Z+ or 12:+Z (directions X, Y, Z, RX, RY, RZ; S for a scalar), (12, 3) or a Dof"


def direction_code(direction: int | str) -> int:
    """Signed code of a direction: ``"Z"`` and ``"+Z"`` give 3, ``"-RY"`` gives -5, an integer is checked.

    Codes: 0 scalar, 1 to 3 translations X, Y, Z, 4 to 6 rotations RX, RY, RZ (right-handed, rad), 7 the twist XY of a
    plate (1/m, an internal unknown that no sensor reads). A minus sign flips the polarity.

    Raises
    ------
    InputError
        If it is no direction.
    """
    if isinstance(direction, str):
        code = _CODES.get(direction[1:] if direction[:1] in ("+", "-") else direction)
        code = None if code == 0 and direction.startswith("-") else code
        if code is not None:
            return -code if direction.startswith("-") else code
    else:
        number = whole(direction)
        if number is not None and abs(number) <= TWIST:
            return number
    raise InputError(
        "no direction",
        where="DOF",
        found=repr(direction),
        expected="X, Y, Z, RX, RY, RZ or S, with a sign or without, or a code from -6 to 6",
        hint='direction="+Z", for example',
    )


def direction_label(code: int) -> str:
    """Signed name of a direction code: 3 gives ``"+Z"``, -5 gives ``"-RY"``."""
    return ("-" if code < 0 else "+") + _NAMES[abs(code)]


@dataclass(frozen=True, order=True)
class Dof:
    """One degree of freedom: a node and a signed direction.

    Parameters
    ----------
    node : int
        Number of the node, not negative.
    direction : int or str
        0 scalar, ±1 to ±3 translations X, Y, Z (m), ±4 to ±6 rotations RX, RY, RZ (rad, right-handed), 7 the twist of
        a plate (1/m); or the name, ``"+Z"``. A minus sign says that what is measured or applied there is positive
        against the axis.

    Raises
    ------
    InputError
        If node or direction is none.
    """

    node: int
    direction: int

    def __post_init__(self) -> None:
        node = whole(self.node)
        if node is None or node < 0:
            raise InputError(
                "no node number",
                where="DOF",
                found=repr(self.node),
                expected="an integer, at least 0",
                hint="structure.dofs lists the nodes",
            )
        object.__setattr__(self, "node", node)
        object.__setattr__(self, "direction", direction_code(self.direction))

    @classmethod
    def parse(cls, value: Any) -> Dof:
        """Dof from ``"12+Z"``, ``"12Z+"``, ``"12:+Z"``, ``(12, 3)`` or a Dof.

        Raises
        ------
        InputError
            For anything else.
        """
        if isinstance(value, Dof):
            return value
        if isinstance(value, str):
            for form in _FORMS:
                match = form.fullmatch(value)
                if match:
                    return cls(int(match["node"]), direction_code(match["sign"] + match["name"]))
        elif isinstance(value, tuple) and len(value) == 2:
            return cls(value[0], direction_code(value[1]))
        raise InputError(
            "no DOF", where="DOF", found=repr(value), expected=_EXPECTED, hint="structure.dofs lists all DOFs"
        )

    def __str__(self) -> str:
        return f"{self.node}{direction_label(self.direction)}"

    @property
    def axis(self) -> int:
        """Direction code without its sign."""
        return abs(self.direction)

    @property
    def sign(self) -> int:
        """-1 for a negative direction, else 1."""
        return -1 if self.direction < 0 else 1

    @property
    def key(self) -> tuple[int, int]:
        """(node, axis): two DOFs with the same key are the same degree of freedom, whatever their polarity."""
        return self.node, self.axis

    @property
    def is_rotation(self) -> bool:
        """Whether it is a rotation RX, RY or RZ."""
        return 4 <= self.axis <= 6

    @property
    def unit(self) -> str:
        """SI unit of the motion: ``m``, ``rad``, ``1/m`` (twist) or ``arbitrary`` (scalar)."""
        return _UNITS[self.axis]


ARBITRARY = "arbitrary"
CHANNEL = ("label", "quantity", "unit", "noise", "highpass", "measure")  # what a file keeps of one
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
    interpolation : float, optional
        Standard deviation of the error that an interpolation of the samples has made, the noise of the samples that
        were left out for it among it, in `unit`.

    Raises
    ------
    InputError
        If the label is empty or no text, the unit is unknown, not SI or none of the quantity, or noise, highpass,
        measure or interpolation is not a positive number.
    """

    label: str
    quantity: str = "arbitrary"
    unit: str = "arbitrary"
    noise: float | None = None
    highpass: float | None = None
    measure: float | None = None
    interpolation: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.label, str) or not self.label:
            raise InputError(
                "a channel needs a name",
                where="channel",
                found=repr(self.label),
                expected="a text that is not empty",
                hint='pass label="a1"',
            )
        for name, unit in (("noise", "the unit of the channel"), ("highpass", "Hz"), ("measure", "m or m^2"),
                           ("interpolation", "the unit of the channel")):  # fmt: skip
            value = getattr(self, name)
            if value is not None:
                hint = f"leave {name} out where it is not known"
                positive(name, value, where=f"channel {self.label}", unit=unit, hint=hint)
        if (self.quantity, self.unit) not in _USUAL and not self.quantity == self.unit == ARBITRARY:
            _check_unit(self)


def named(given: Sequence[Any] | None, number: int, prefix: str, where: str) -> tuple[Channel, ...]:
    """Channels from channels or labels; ``prefix0, prefix1, ...`` where nothing is given."""
    if given is None:
        return tuple(Channel(label=f"{prefix}{i}") for i in range(number))
    out = tuple(
        c if isinstance(c, Channel) else Channel(label=str(c)) for c in ([given] if isinstance(given, str) else given)
    )
    labels = [c.label for c in out]
    if len(out) != number or len(set(labels)) != number:
        raise InputError(
            "labels do not fit",
            where=where,
            found=labels,
            expected=f"{number} different labels",
            hint="one text or Channel each",
        )
    return out


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
