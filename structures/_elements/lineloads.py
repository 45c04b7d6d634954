"""Loads that are spread along a member of a frame."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._channels import direction_code
from .._system.fields import Span, field_of_kind
from .._system.loads import Load
from .._system.sensors import fixed_quantity
from .._system.structure import Structure
from ..errors import InputError, real, shown, whole
from ..errors import span as span_of
from .framefield import FrameField

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LineLoad(Load):
    """Uniform load (N per m of the member) on a member of a frame, or on a part of it, in any direction.

    Parameters
    ----------
    member : int
        Which member, in the order in which they were given.
    span : (s0, s1), optional
        Part of the member (m from its start); all of it where not given. Elements may be shared partly.
    direction : str or (x, z) or (x, y, z)
        A global translation such as ``"-Z"``, or a direction of any length in the frame's coordinates. A load per
        horizontal metre (snow) on a member at the slope a is this load times cos a.
    label : str, optional
        Member and span where not given.

    Attributes
    ----------
    measure : float or None
        Length (m) where the span is given: load times length is the resultant.

    Raises
    ------
    InputError
        If span or direction is none; in `shape`, if the structure is no frame or has no such member.

    Notes
    -----
    Work-equivalent nodal forces: q L (1/2, L/12, 1/2, -L/12) across an element, for Timoshenko elements too.
    """

    member: int = 0
    span: Span | None = None
    _: KW_ONLY
    direction: Any = "-Z"
    label: str = ""
    quantity: str = "line_load"
    unit: str = "N/m"

    def __post_init__(self) -> None:
        fixed_quantity(self, "line_load")
        if (index := whole(self.member)) is None or index < 0:
            raise InputError(
                "no member",
                where="LineLoad",
                found=shown(self.member),
                expected="an integer, at least 0",
                hint="members are counted from 0",
            )
        if self.span is not None:
            hint = "span=(0.2, 0.4), or leave it out for the whole member"
            start, stop = span_of(self.span, where="LineLoad, span", hint=hint)
            object.__setattr__(self, "span", (start, stop))
            object.__setattr__(self, "measure", stop - start)
        object.__setattr__(self, "direction", _direction(self.direction))
        object.__setattr__(self, "label", self.label or self._words())
        super().__post_init__()

    def _words(self) -> str:
        part = "" if self.span is None else f" s={self.span[0]:.9g}..{self.span[1]:.9g}"
        way = self.direction
        if not isinstance(way, str):
            way = f"({', '.join(f'{v:.4g}' for v in way)})"
        return f"member={self.member}{part} {way}"

    def _field(self, structure: Structure) -> FrameField:
        return field_of_kind(
            structure,
            FrameField,
            self.label,
            what="a LineLoad acts on a member of a frame",
            expected="a structure of frames.frame",
            hint="loads.Patch(x=(x0, x1)) on a beam",
        )

    def region(self, structure: Structure) -> tuple[Span, ...]:
        """Member and span."""
        line = self._field(structure).piece(self.member).line
        return (self.member, self.member), self.span or (0.0, line.length)

    def shape(self, structure: Structure) -> Array:
        """Consistent nodal forces of one unit, shape (n,)."""
        field = self._field(structure)
        vector = np.zeros(3)
        if isinstance(self.direction, str):
            code = direction_code(self.direction)
            vector[abs(code) - 1] = np.sign(code)
        else:
            vector[[0, 2] if len(self.direction) == 2 else [0, 1, 2]] = self.direction
        if field.plane and vector[1]:
            raise InputError(
                "a plane frame has no motion along Y",
                where=f"load {self.label}",
                found=self.direction,
                expected="a direction in X-Z",
                hint="direction=(x, z)",
            )
        return field.line(self.member, self.span, vector)


def _direction(given: Any) -> str | tuple[float, ...]:
    """A translation's label, or a unit vector."""
    if isinstance(given, str):
        code = direction_code(given)
        if 1 <= abs(code) <= 3:
            return given if given[0] in "+-" else f"+{given}"
    else:
        values = [real(v) for v in given] if np.iterable(given) else []
        found = np.array([v for v in values if v is not None])
        if len(found) == len(values) and len(found) in (2, 3) and np.any(found):
            return tuple((found / np.linalg.norm(found)).tolist())
    raise InputError(
        "no direction of a line load",
        where="LineLoad",
        found=shown(given),
        expected='"+X", "+Y", "+Z" or a vector (x, z) or (x, y, z)',
        hint='direction="-Z" is downwards',
    )
