"""Degrees of freedom: one node, one signed direction, one way to print them."""

from __future__ import annotations

import operator
import re
from dataclasses import dataclass
from typing import Any

from .errors import InputError

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
        number = _integer(direction)
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


def _integer(value: Any) -> int | None:
    """The integer that `value` is (Python or NumPy), or None; a bool is none."""
    if isinstance(value, bool):
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None


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
        node = _integer(self.node)
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
