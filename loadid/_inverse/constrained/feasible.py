"""The feasible set that some constraints make together: intervals, cones in local frames, and linear rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from ... import constraints as cones
from ...constraints import Bounds, Constraint, FrictionCone, NonNegative, Resultant, Support

Array = NDArray[np.float64]
Index = NDArray[np.int_]

INF = np.inf


@dataclass(frozen=True, eq=False)
class Cones:
    """Cones of one dimension: local unknowns (k, dim), tangential first and normal last; slope; facets (0: round)."""

    index: Index
    mu: Array
    facets: Index
    source: Index  # number of the constraint of each cone
    frame: Array  # (k, dim, dim): global = frame @ local
    rotated: bool


@dataclass(frozen=True, eq=False)
class Rows:
    """Linear rows ``matrix @ h = value`` (or <=), each of unit length; `norm` is what a row was divided by."""

    matrix: Array
    value: Array  # (rows,) or (rows, frames)
    norm: Array
    source: Index  # number of the constraint
    place: Index  # row of a resultant, or load of a bound
    sign: Array  # of a bound: +1 upper, -1 lower
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.matrix)

    def of(self, frame: int) -> Rows:
        """The rows of one frame."""
        return self if self.value.ndim == 1 else replace(self, value=self.value[:, frame])


@dataclass(frozen=True, eq=False)
class Feasible:
    """Set of admissible loads, in local unknowns h: kept loads, with the components of each contact in its own frame.

    Parameters
    ----------
    n : int
        Loads before the support.
    keep : array of int
        Loads that act.
    lower, upper : array, shape (kept,)
        Bounds of the local unknowns that are in no cone; infinite in cones.
    lower_source, upper_source : array of int, shape (n,)
        Number of the constraint that made each bound, -1 for none.
    cones : tuple of Cones
    equal, below : Rows
        C h = r and F h <= f.
    resultants : tuple of int
        Numbers of the resultant constraints.
    """

    n: int
    keep: Index
    lower: Array
    upper: Array
    lower_source: Index
    upper_source: Index
    cones: tuple[Cones, ...]
    equal: Rows
    below: Rows
    resultants: tuple[int, ...] = ()

    @property
    def simple(self) -> bool:
        """Whether it is a product of intervals and cones: never empty, and its projection is a formula."""
        return not (len(self.equal) or len(self.below))

    def of(self, frame: int) -> Feasible:
        """The set of one frame."""
        return replace(self, equal=self.equal.of(frame)) if self.equal.value.ndim == 2 else self

    def columns(self, A: Array) -> Array:
        """Columns of an operator on all loads, for the local unknowns."""
        return _turn_columns(A[:, self.keep], self.cones)

    def to_global(self, h: Array) -> Array:
        """Loads (n, ...) from local unknowns."""
        g = np.zeros((self.n, *h.shape[1:]))
        local = np.array(h, float)
        for c in self.cones:
            if c.rotated:
                local[c.index] = np.einsum("kij,kj...->ki...", c.frame, h[c.index])
        g[self.keep] = local
        return g

    def project(self, v: Array) -> Array:
        """Nearest point of the intervals and cones (the rows are left aside)."""
        P = np.clip(v, self.lower, self.upper)
        for c in self.cones:
            w = v[c.index]
            P[c.index] = cones.project(w, cones.faces(w, c.mu, c.facets))
        return P

    def violation(self, h: Array) -> float:
        """Largest violation, relative to the largest load (and to what the rows ask for)."""
        size = max(float(np.abs(h).max(initial=0.0)), np.finfo(float).tiny)
        finite = [np.abs(b[np.isfinite(b)]).max(initial=0.0) for b in (self.lower, self.upper)]
        size = max(size, *map(float, finite))
        worst = float(np.maximum(self.lower - h, h - self.upper).max(initial=0.0))
        for c in self.cones:
            worst = max(worst, float(cones.excess(h[c.index], c.mu, c.facets).max(initial=0.0)))
        for rows, sided in ((self.equal, False), (self.below, True)):
            if len(rows):
                off = rows.matrix @ h - rows.value
                off = np.maximum(off, 0.0) if sided else np.abs(off)
                room = np.maximum(np.abs(rows.value), np.abs(rows.matrix) @ np.abs(h))
                worst = max(worst, float((off / np.maximum(room / size, 1e-3)).max()))
        return worst / size


def compile_(constraints: Sequence[Constraint], n: int) -> Feasible:
    """One feasible set from constraints on `n` loads.

    Raises
    ------
    InputError
        Loads that do not exist, contacts that overlap or are cut by the support, bounds that exclude each other
        (LID-E309), resultants that contradict each other (LID-E309).
    """
    _check_kinds(constraints)
    keep = _support(constraints, n)
    local = np.full(n, -1)
    local[keep] = np.arange(len(keep))
    groups = _cones(constraints, n, local)
    lower, upper, low_source, up_source = _bounds(constraints, n, keep)
    below, low, up = _bounds_in_cones(groups, lower[keep], upper[keep], low_source[keep], up_source[keep], keep)
    equal = _resultants(constraints, n, keep, groups)
    resultants = tuple(i for i, c in enumerate(constraints) if isinstance(c, Resultant))
    return Feasible(n, keep, low, up, low_source, up_source, groups, equal, below, resultants)


def _check_kinds(constraints: Sequence[Constraint]) -> None:
    for c in constraints:
        if not isinstance(c, NonNegative | Bounds | Support | Resultant | FrictionCone):
            raise InputError(
                "no constraint", where="constraints", found=type(c).__name__,
                expected="NonNegative, Bounds, Support, Resultant or FrictionCone",
            )  # fmt: skip


def _within(numbers: Index, n: int, where: str, masked: int | None = None) -> Index:
    if masked not in (None, n):
        raise InputError("the mask does not fit the loads", where=where, found=f"{masked} entries", expected=n)
    if np.any(numbers < 0) or np.any(numbers >= n):
        bad = numbers[(numbers < 0) | (numbers >= n)]
        raise InputError(
            "there is no such load", where=where, found=np.unique(bad)[:5].tolist(), expected=f"0 to {n - 1}"
        )
    return numbers


def _support(constraints: Sequence[Constraint], n: int) -> Index:
    keep = np.ones(n, bool)
    for c in constraints:
        if isinstance(c, Support):
            mask = np.zeros(n, bool)
            mask[_within(np.asarray(c.loads), n, "Support", c.masked)] = True
            keep &= mask
    if not np.any(keep):
        raise InputError("the supports have no load in common", where="Support", expected="at least one load")
    return np.flatnonzero(keep)


def _cones(constraints: Sequence[Constraint], n: int, local: Index) -> tuple[Cones, ...]:
    """Cones by dimension, in local numbers."""
    used = np.full(n, -1)
    parts: dict[int, list[tuple[Index, Array, Index, Index, Array]]] = {}
    for number, c in enumerate(constraints):
        if not isinstance(c, FrictionCone):
            continue
        index = _within(np.asarray(c.contacts), n, "FrictionCone")
        flat = index.ravel()
        if len(np.unique(flat)) < len(flat) or np.any(used[flat] >= 0):
            raise InputError("a load is in two friction cones", where="FrictionCone", expected="each load in one")
        used[flat] = number
        inside = local[index] >= 0
        cut = np.any(inside, axis=1) & ~np.all(inside, axis=1)
        if np.any(cut):
            raise InputError(
                "the support cuts contacts apart", where="FrictionCone",
                found=f"contacts {np.flatnonzero(cut)[:5].tolist()}", expected="all components of a contact, or none",
            )  # fmt: skip
        acting = inside[:, 0]
        mu, dim = np.asarray(c.mu)[acting], index.shape[1]
        facets = np.full(len(mu), 0 if c.facets is None or dim == 2 else int(c.facets))
        if c.inner and c.facets is not None and dim == 3:
            mu = mu * np.cos(np.pi / c.facets)
        frame = np.broadcast_to(np.eye(dim), (len(mu), dim, dim))
        if c.normals is not None:
            frame = cones.frames(np.asarray(c.normals)[acting])
        source = np.full(len(mu), number)
        parts.setdefault(dim, []).append((local[index[acting]], mu, facets, source, frame))
    groups = []
    for dim in sorted(parts):
        index, mu, facets, source, frame = (np.concatenate(x) for x in zip(*parts[dim], strict=True))
        groups.append(Cones(index, mu, facets, source, frame, bool(np.any(frame != np.eye(dim)))))
    return tuple(groups)


def _bounds(constraints: Sequence[Constraint], n: int, keep: Index) -> tuple[Array, Array, Index, Index]:
    """The tightest bounds (n,) and who made them."""
    lower, upper = np.full(n, -INF), np.full(n, INF)
    low_source, up_source = np.full(n, -1), np.full(n, -1)
    for number, c in enumerate(constraints):
        if not isinstance(c, NonNegative | Bounds):
            continue
        loads = np.arange(n) if c.loads is None else _within(np.asarray(c.loads), n, type(c).__name__, c.masked)
        limits = (0.0, INF) if isinstance(c, NonNegative) else (c.lower, c.upper)
        new_low, new_up = (np.asarray(x, float) for x in limits)
        try:
            low, up = np.broadcast_to(new_low, loads.shape), np.broadcast_to(new_up, loads.shape)
        except ValueError:
            raise InputError(
                "the bounds do not fit the loads", where="Bounds",
                found=f"{np.size(new_low)} and {np.size(new_up)}", expected=f"one, or {len(loads)}",
            ) from None  # fmt: skip
        tighter = low > lower[loads]
        lower[loads[tighter]], low_source[loads[tighter]] = low[tighter], number
        tighter = up < upper[loads]
        upper[loads[tighter]], up_source[loads[tighter]] = up[tighter], number
    bad = keep[(lower[keep] > upper[keep]) | (lower[keep] == INF) | (upper[keep] == -INF)]
    if len(bad):
        j = int(bad[0])
        raise InputError(
            f"no load is within the bounds of {len(bad)} load{'s' if len(bad) > 1 else ''}", where="constraints",
            found=f"load {j}: lower {lower[j]:.4g} ({_name(constraints, low_source[j])}), "
            f"upper {upper[j]:.4g} ({_name(constraints, up_source[j])})",
            expected="lower <= upper", code="LID-E309",
        )  # fmt: skip
    return lower, upper, low_source, up_source


def _name(constraints: Sequence[Constraint], number: int) -> str:
    return "none" if number < 0 else f"constraint {number}: {constraints[number]}"


def _bounds_in_cones(
    groups: Sequence[Cones], lower: Array, upper: Array, low_source: Index, up_source: Index, keep: Index
) -> tuple[Rows, Array, Array]:
    """Bounds on components of contacts become rows, unless the cone implies them; the other bounds stay as they are."""
    n = len(keep)
    low, up = lower.copy(), upper.copy()
    matrix: list[Array] = []
    found: list[tuple[float, int, int, float]] = []  # value, constraint, load, sign
    for c in groups:
        dim = c.index.shape[1]
        implied = np.all(np.isclose(c.frame[:, :, -1], np.eye(dim)[-1]), axis=1)  # the last component is the push
        for i, a in np.argwhere((lower[c.index] > -INF) | (upper[c.index] < INF)):
            j = c.index[i, a]
            row = np.zeros(n)
            row[c.index[i]] = c.frame[i, a]
            if lower[j] > -INF and not (implied[i] and a == dim - 1 and lower[j] <= 0):
                matrix.append(-row)
                found.append((-lower[j], low_source[j], keep[j], -1.0))
            if upper[j] < INF:
                matrix.append(row)
                found.append((upper[j], up_source[j], keep[j], 1.0))
        low[c.index], up[c.index] = -INF, INF
    value, source, place, sign = (np.array(x) for x in (zip(*found, strict=True) if found else ([],) * 4))
    rows = Rows(
        np.array(matrix, float).reshape(-1, n), value.astype(float), np.ones(len(matrix)), source.astype(int),
        place.astype(int), sign.astype(float), tuple(f"bound of load {p}" for p in place),
    )  # fmt: skip
    return rows, low, up


def _resultants(constraints: Sequence[Constraint], n: int, keep: Index, groups: Sequence[Cones]) -> Rows:
    """Exact resultants as independent rows of unit length."""
    rows: list[Array] = []
    values: list[Array] = []
    source: list[int] = []
    place: list[int] = []
    names: list[str] = []
    for number, c in enumerate(constraints):
        if not isinstance(c, Resultant):
            continue
        C = np.asarray(c.C)
        if C.shape[1] != n:
            raise InputError(
                "the resultants do not fit the loads", where="Resultant", found=f"C {C.shape}", expected=f"(R, {n})"
            )
        if not c.hard:
            continue
        rows.append(C)
        values.append(np.asarray(c.value))
        source += [number] * len(C)
        place += range(len(C))
        names += c.labels
    if not rows:
        none, no = np.zeros(0), np.zeros(0, int)
        return Rows(np.zeros((0, len(keep))), none, none, no, no, none, ())
    frames = {v.shape[1] for v in values if v.ndim == 2}
    if len(frames) > 1:
        raise InputError("resultants with different numbers of frames", where="Resultant", found=sorted(frames))
    if frames:
        values = [np.broadcast_to(v[:, None], (len(v), *frames)) if v.ndim == 1 else v for v in values]
    matrix = _turn_columns(np.concatenate(rows)[:, keep], groups)
    every = Rows(
        matrix, np.concatenate(values), np.linalg.norm(matrix, axis=1), np.array(source), np.array(place),
        np.zeros(len(source)), tuple(names),
    )  # fmt: skip
    return _independent(every, np.linalg.norm(np.concatenate(rows), axis=1))


def _independent(rows: Rows, before: Array) -> Rows:
    """Rows of unit length without those that follow from others; a contradiction is named."""
    size, tol = np.abs(rows.value).max() if rows.value.size else 0.0, 1e-10
    kept: list[int] = []
    for i in range(len(rows)):
        if rows.norm[i] <= tol * before[i] or before[i] == 0:
            if np.any(np.abs(rows.value[i]) > tol * size):
                raise InputError(
                    f"no admissible load has this resultant: {rows.names[i]} is moved by no load that acts",
                    where="Resultant", found=_show(rows.value[i]), expected="0, or a support with loads that move it",
                    code="LID-E309",
                )  # fmt: skip
            continue
        row = rows.matrix[i] / rows.norm[i]
        basis = (rows.matrix[kept] / rows.norm[kept, None]).T
        weights = np.linalg.lstsq(basis, row, rcond=None)[0] if kept else np.zeros(0)
        if np.linalg.norm(row - basis @ weights) > tol:
            kept.append(i)
            continue
        implied = np.einsum("k,k...->...", weights, _scaled(rows.value[kept], rows.norm[kept]))
        own = rows.value[i] / rows.norm[i]
        scale = np.abs(own) + np.einsum(
            "k,k...->...", np.abs(weights), np.abs(_scaled(rows.value[kept], rows.norm[kept]))
        )
        if np.any(np.abs(own - implied) > 1e-9 * scale):
            others = [rows.names[k] for k, w in zip(kept, weights, strict=True) if abs(w) > 1e-8]
            raise InputError(
                f"the resultants contradict each other: {rows.names[i]} follows from {', '.join(others)}",
                where="Resultant", found=f"{rows.names[i]} = {_show(rows.value[i])}",
                expected=_show(implied * rows.norm[i]), hint="leave it out, or give the resultants a covariance",
                code="LID-E309",
            )  # fmt: skip
    k = np.array(kept, int)
    return Rows(
        rows.matrix[k] / rows.norm[k, None], _scaled(rows.value[k], rows.norm[k]), rows.norm[k], rows.source[k],
        rows.place[k], rows.sign[k], tuple(rows.names[i] for i in kept),
    )  # fmt: skip


def _scaled(value: Array, norm: Array) -> Array:
    return value / (norm if value.ndim == 1 else norm[:, None])


def _show(value: Array) -> str:
    flat = np.atleast_1d(value)
    return f"{flat[0]:.4g}" if len(flat) == 1 else f"{flat[:3].round(4).tolist()} ..."


def _turn_columns(A: Array, groups: Sequence[Cones]) -> Array:
    """Columns for local unknowns from columns for the components of the contacts."""
    out = np.array(A, float, order="F")
    for c in groups:
        if c.rotated:
            k, dim = c.index.shape
            block = A[:, c.index.ravel()].reshape(len(A), k, dim)
            out[:, c.index.ravel()] = np.einsum("mki,kij->mkj", block, c.frame).reshape(len(A), -1)
    return out
