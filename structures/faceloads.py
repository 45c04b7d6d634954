"""Tractions on the faces of solids: `solids.FacePatch`."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .dofs import direction_code, direction_label
from .errors import InputError
from .fields import Span, field_of
from .loads import Load
from .sensors import fixed_quantity
from .values import plain, shown

if TYPE_CHECKING:
    from .structure import Structure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FacePatch(Load):
    """Uniform traction (Pa) on a rectangle of a face of a solid, partial elements included.

    Parameters
    ----------
    face : str
        "top", "bottom", "left", "right", "front" or "back".
    spans : ((u0, u1), (v0, v1)), optional
        The rectangle (m) over the two coordinates of the face, in the order x, y, z. The whole face where not given.
    direction : str
        Sense of a positive traction along X, Y or Z: "-Z" on the top face presses.
    label : str, optional
        Face and spans where not given.

    Raises
    ------
    InputError
        If a span or a direction is none; in `shape`, if this is no solid.
    """

    face: str = "top"
    spans: tuple[Span, Span] | None = None
    _: KW_ONLY
    direction: str = "+Z"
    label: str = ""
    quantity: str = "pressure"
    unit: str = "Pa"

    def __post_init__(self) -> None:
        if self.spans is not None:
            object.__setattr__(self, "spans", _rectangle(self.spans))
        code = direction_code(self.direction)
        if abs(code) not in (1, 2, 3):
            raise InputError(
                "a traction acts along X, Y or Z",
                where="FacePatch",
                found=self.direction,
                expected="+X, -X, +Y, -Y, +Z or -Z",
                hint="-Z on the top face is a pressure",
            )
        fixed_quantity(self, "pressure")
        place = "" if self.spans is None else " " + " ".join(f"{a:.9g}..{b:.9g}" for a, b in self.spans)
        object.__setattr__(self, "direction", direction_label(code))
        object.__setattr__(self, "label", self.label or f"{self.face}{place} {self.direction}")
        super().__post_init__()

    def _on(self, structure: Structure) -> tuple[Any, tuple[Span, ...]]:
        """The field of a solid, and the rectangle."""
        field: Any = field_of(structure, f"load {self.label}")
        if not hasattr(field, "face_lines"):
            raise InputError(
                "this structure has no faces",
                where=f"load {self.label}",
                found=type(field).__name__,
                expected="a structure of structures.solids",
                hint="loads.Patch loads a beam or a plate",
            )
        whole = ((line.origin, line.origin + line.length) for line in field.face_lines(self.face))
        return field, self.spans or tuple(whole)

    def region(self, structure: Structure) -> tuple[Span, ...]:
        """The rectangle as three spans."""
        field, spans = self._on(structure)
        return tuple(field.face_region(self.face, spans))

    def shape(self, structure: Structure) -> Array:
        """Consistent nodal forces of one unit, shape (n,)."""
        field, spans = self._on(structure)
        code = direction_code(self.direction)
        return np.asarray(math.copysign(1, code) * field.traction(self.face, spans, abs(code)), float)


def _rectangle(spans: Any) -> tuple[Span, Span]:
    """Two spans, checked."""
    try:
        found = np.asarray(plain(spans), float)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (2, 2) or not np.all(np.isfinite(found)) or np.any(found[:, 0] >= found[:, 1]):
        raise InputError(
            "no rectangle",
            where="FacePatch, spans",
            found=shown(spans),
            expected="((u0, u1), (v0, v1)) in m, each start below its stop",
            hint="the two coordinates of the face, in the order x, y, z",
        )
    (a, b), (c, d) = found.tolist()
    return (a, b), (c, d)
