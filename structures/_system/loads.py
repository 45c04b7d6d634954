"""Loads: what each one does to the structure, as a column over all DOFs; and the guards of loads at supports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .._channels import Channel, direction_code, direction_label
from .._flags import Evidence, Flag
from .._readonly import ReadOnly
from ..errors import InputError, numbers, one_of
from ..errors import span as span_of
from .fields import Span, field_of
from .sensors import Place, fixed_quantity, spot, words

if TYPE_CHECKING:
    from .structure import Structure


Array = NDArray[np.float64]


def upright(what: str, who: str, direction: Any) -> int:
    """Code of a direction along Z.

    Raises
    ------
    InputError
        If it is another.
    """
    code = direction_code(direction)
    if abs(code) != 3:
        raise InputError(
            f"{what} acts along Z", where=who, found=direction, expected="+Z or -Z", hint="-Z turns its sign"
        )
    return code


@dataclass(frozen=True, kw_only=True)
class Load(Channel):
    """Base of all loads: a channel that can say which column it fills."""

    label: str = ""

    def shape(self, structure: Structure) -> Array:
        """Consistent nodal forces of one unit, supported DOFs included and not judged, shape (n,)."""
        raise NotImplementedError

    def region(self, structure: Structure) -> tuple[Span, ...] | None:
        """Where it acts, as spans of the coordinates; None where the structure has no mesh."""
        raise NotImplementedError

    def column(self, structure: Structure) -> Array:
        """Column over all DOFs for one unit of load, shape (n,).

        Entries at supported DOFs are what flows straight into the support.

        Raises
        ------
        InputError
            Code LID-E104 if the load acts on supported DOFs only; without code if it does not fit the structure.
        """
        column = self.shape(structure)
        if not np.any(column[structure.free]):
            refuse_supported([self.label])
        return column


@dataclass(frozen=True)
class _Concentrated(Load):
    dof: Any = None
    _: KW_ONLY
    at: Place | None = None
    direction: str = "+Z"
    label: str = ""

    def _settle(self, turning: bool) -> None:
        """Fix DOF, direction and label, and refuse a force on a rotation or a moment on a translation."""
        who = type(self).__name__
        known, at, code = spot(who, self.dof, self.at, self.direction)
        if code and (4 <= abs(code) <= 6) != turning:
            raise InputError(
                "a moment acts on a rotation" if turning else "a force acts on a translation",
                where=who,
                found=str(known or direction_label(code)),
                expected="RX, RY or RZ" if turning else "X, Y or Z",
                hint="use loads.Point for a force" if turning else "use loads.Moment for a moment",
            )
        fixed_quantity(self, "moment" if turning else "force")
        label = self.label or words(known, at, code)
        for name, value in (("dof", known), ("at", at), ("direction", direction_label(code)), ("label", label)):
            object.__setattr__(self, name, value)
        Channel.__post_init__(self)

    def shape(self, structure: Structure) -> Array:
        """Consistent nodal forces of one unit, shape (n,)."""
        if self.at is None:
            return structure.unit_row(self.dof)
        code = direction_code(self.direction)
        return math.copysign(1, code) * field_of(structure, f"load {self.label}").motion(self.at, abs(code))

    def region(self, structure: Structure) -> tuple[Span, ...] | None:
        """The point."""
        if structure.field is None:
            return None
        if self.at is None:
            return structure.field.box(self.dof.node)
        return tuple((v, v) for v in np.atleast_1d(np.asarray(self.at, float)).tolist())


@dataclass(frozen=True)
class Point(_Concentrated):
    """Force (N) at a DOF or at a point inside an element.

    Parameters
    ----------
    dof : Dof, str or (node, direction), optional
        ``"31+Z"``; a negative direction is a force against the axis.
    at : float or (x, y), optional
        Instead of a DOF: coordinates (m) in the structure's own frame.
    direction : str
        Direction at a point.
    label : str, optional
        The DOF or the place where not given.

    Raises
    ------
    InputError
        If the place is not exactly one or is a rotation.
    """

    _: KW_ONLY
    quantity: str = "force"
    unit: str = "N"

    def __post_init__(self) -> None:
        self._settle(turning=False)


@dataclass(frozen=True)
class Moment(_Concentrated):
    """Couple (N m, right-handed) at a rotation DOF or at a point inside an element; parameters as in `Point`."""

    _: KW_ONLY
    direction: str = "+RY"
    quantity: str = "moment"
    unit: str = "N*m"

    def __post_init__(self) -> None:
        self._settle(turning=True)


@dataclass(frozen=True)
class Patch(Load):
    """Uniform load: N/m on a span of a beam, or Pa on a rectangle of a plate, partial elements included.

    Parameters
    ----------
    x : (x0, x1)
        Span (m) in the structure's own frame.
    y : (y0, y1), optional
        Second side of the rectangle, on a plate.
    direction : {"+Z", "-Z"}
        Sense of a positive load.
    label : str, optional
        The span where not given.

    Attributes
    ----------
    measure : float
        Length (m) or area (m^2): load times measure is the resultant.

    Raises
    ------
    InputError
        If a span is empty or not finite.
    """

    _: KW_ONLY
    x: Span = (0.0, 0.0)
    y: Span | None = None
    direction: str = "+Z"
    label: str = ""
    quantity: str = ""
    unit: str = ""

    def __post_init__(self) -> None:
        spans = [self.x] if self.y is None else [self.x, self.y]
        for name, span in zip("xy", spans, strict=False):
            span_of(span, where=f"Patch, {name}", hint=f"{name}=(0.2, 0.4), for example")
        upright("a patch", "Patch", self.direction)
        quantity, unit = ("line_load", "N/m") if self.y is None else ("pressure", "Pa")
        fixed_quantity(self, quantity)
        place = " ".join(f"{name}={a:.9g}..{b:.9g}" for name, (a, b) in zip("xy", spans, strict=False))
        settled = {
            "direction": direction_label(direction_code(self.direction)),
            "label": self.label or place,
            "quantity": self.quantity or quantity,
            "unit": self.unit or unit,
            "measure": math.prod(b - a for a, b in spans),
        }
        for name, value in settled.items():
            object.__setattr__(self, name, value)
        super().__post_init__()

    def region(self, structure: Structure) -> tuple[Span, ...]:
        """The span or rectangle."""
        return (self.x,) if self.y is None else (self.x, self.y)

    def shape(self, structure: Structure) -> Array:
        """Consistent nodal forces of one unit, shape (n,)."""
        row = field_of(structure, f"load {self.label}").resultant(self.region(structure))
        return math.copysign(1, direction_code(self.direction)) * row


@dataclass(frozen=True, eq=False)
class MovingPoint(ReadOnly, Load):
    """A force (N) that moves along a path: a vehicle on a bridge.

    Parameters
    ----------
    path : array, shape (samples,) or (samples, 2)
        Place of the force at each sample (m).
    direction : {"+Z", "-Z"}
        Sense of a positive force.
    outside : {"raise", "zero"}
        What a place beside the structure means: an error, or a force that is not yet, or no longer, on it.
    label : str, optional
        Name.

    Raises
    ------
    InputError
        If the path is empty or not finite.
    """

    path: Any = None
    _: KW_ONLY
    direction: str = "+Z"
    outside: str = "raise"
    label: str = "moving point"
    quantity: str = "force"
    unit: str = "N"

    def __post_init__(self) -> None:
        path = np.array(numbers(self.path))
        path = path[:, None] if path.ndim == 1 else path
        if path.ndim != 2 or path.size == 0 or not np.all(np.isfinite(path)):
            raise InputError(
                "no path",
                where=f"load {self.label}",
                found=f"shape {path.shape}",
                expected="finite places, (samples,) or (samples, 2), in m",
                hint="one place per sample of the record",
            )
        hint = "zero where the force enters or leaves the structure"
        one_of("unknown setting", self.outside, ("raise", "zero"), where="MovingPoint, outside", hint=hint)
        upright("a moving force", "MovingPoint", self.direction)
        fixed_quantity(self, "force")
        path.flags.writeable = False
        object.__setattr__(self, "path", path)
        super().__post_init__()

    def columns(self, structure: Structure) -> Array:
        """Column over all DOFs at every sample, shape (samples, n).

        Raises
        ------
        InputError
            If the path leaves the structure and `outside` is ``"raise"``.
        """
        mesh = field_of(structure, f"load {self.label}")
        sign = math.copysign(1, direction_code(self.direction))
        out = np.zeros((len(self.path), structure.n))
        for k, place in enumerate(self.path):
            if self.outside == "raise" or mesh.inside(place):
                out[k] = sign * mesh.motion(place, 3)
        return out

    def region(self, structure: Structure) -> None:
        """None: it passes."""

    def column(self, structure: Structure) -> Array:
        """Refuses: a moving load has a column per sample."""
        raise InputError(
            "a moving load has no single column",
            where=f"load {self.label}",
            found="a path",
            expected="columns(structure), (samples, n)",
            hint="state_space() carries B(t)",
        )


def matrix(structure: Structure, loads: Sequence[Load]) -> Array:
    """Columns of several loads, shape (n, loads).

    Raises
    ------
    InputError
        Code LID-E104, naming all loads that act on supported DOFs only.
    """
    return np.asarray(sparse_matrix(structure, loads).toarray())


def sparse_matrix(structure: Structure, loads: Sequence[Load]) -> sparse.csc_array:
    """Columns of several loads as a sparse array (n, loads); no dense one is made on the way.

    Raises
    ------
    InputError
        Code LID-E104, naming all loads that act on supported DOFs only.
    """
    rows: list[NDArray[np.intp]] = []
    values: list[Array] = []
    bad = []
    held = np.zeros(structure.n, bool)
    held[structure.supported] = True
    for load in loads:
        column = load.shape(structure)
        rows.append(np.flatnonzero(column))
        values.append(column[rows[-1]])
        if np.all(held[rows[-1]]):
            bad.append(load.label)
    if bad:
        refuse_supported(bad)
    starts = np.cumsum([0, *map(len, rows)])
    parts = (np.concatenate(values), np.concatenate(rows), starts) if rows else ([], [], starts)
    return sparse.csc_array(parts, shape=(structure.n, len(rows)))


def refuse_supported(labels: Sequence[str]) -> NoReturn:
    """Guard E104: these loads act on supported DOFs only.

    Raises
    ------
    InputError
        Code LID-E104, always.
    """
    k = len(labels)
    raise InputError(
        f"{k} load{' acts' if k == 1 else 's act'} on supported DOFs only: "
        "applied load and reaction are inseparable there",
        where="loads",
        found=", ".join(labels[:8]) + (", ..." if k > 8 else ""),
        expected="loads on DOFs that are free",
        hint="drop them; read the reaction from reactions()",
        code="LID-E104",
    )


def near_support(structure: Structure, loads: Load | Sequence[Load]) -> Flag | None:
    """Guard W105: loads that share an element with a supported DOF, which carries part of them.

    A lumped mass beside a fixed end is not flagged: no shape function spreads its load onto the support. For a
    structure from matrices, DOFs that K couples count as sharing an element.
    """
    loads = [loads] if isinstance(loads, Load) else list(loads)
    alone = [load for load in loads if not hasattr(load, "basis")]
    hit = {load.label: near for load in alone if (near := _supports_near(structure, load))}
    names_hit, held_by = list(hit), {dof for dofs in hit.values() for dof in dofs}
    for basis in {id(load.basis): load.basis for load in loads if hasattr(load, "basis")}.values():
        close, rows = basis.near(structure)  # all loads of a basis at once
        mine = {load.label for load in loads if getattr(load, "basis", None) is basis}
        labels = [label for i in close if (label := basis.labels[i]) in mine]
        names_hit += labels
        held_by |= {structure.dofs[i] for i in rows} if labels else set()
    if not names_hit:
        return None
    hit_words, held_words = (
        ", ".join(map(str, items[:8])) + (", ..." if len(items) > 8 else "") for items in (names_hit, sorted(held_by))
    )
    return Flag(
        "W105",
        Evidence("loads that share an element with a supported DOF", len(names_hit), 0),
        f"{len(names_hit)} of {len(loads)} loads next to a support, which carries part of them: "
        f"{hit_words} beside {held_words}",
        state=True,
    )


def _supports_near(structure: Structure, load: Load) -> list[Any]:
    if isinstance(load, MovingPoint) or not structure.supports:
        return []
    touched = np.flatnonzero(load.shape(structure))
    region = load.region(structure)
    if structure.field is None or region is None:
        near = np.unique(structure.K[touched].indices)
    else:
        near = structure.field.near(region)
    # both are searched, not sorted: thousands of candidates ask for the supports of one structure
    place = np.minimum(np.searchsorted(structure.supported, near), len(structure.supported) - 1)
    return [structure.dofs[i] for i in np.unique(near[structure.supported[place] == near])]
