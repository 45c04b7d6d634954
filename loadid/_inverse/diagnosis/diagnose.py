"""Diagnostics of any path: what the data can tell of a load, and what becomes of the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._readonly import ReadOnly
from structures.errors import InputError, NotIdentifiable, plain

from .. import Array
from ..svd import SVDPath
from .identifiability import layout, width
from .picard import Decay, Plateau, decay, plateau

WHOLE = 400  # loads up to which the resolution matrix is kept
LOUD = 4.0  # times the noise level: a plateau above that is none
SAMPLED = 200  # of its columns that are measured where there are more loads


@dataclass(frozen=True)
class LoadLayout:
    """Where loads are: in a row, on a line, or on a surface. Load index = point * components + component.

    Parameters
    ----------
    points, components : int
    places : array, shape (points, d), or None
        In m, in the 1, 2 or 3 directions in which they differ; None: in the order of their index.
    measures : array, shape (points,)
        Length or area of each; in samples without places.
    """

    points: int
    components: int = 1
    places: Array | None = None
    measures: Array | None = None

    @classmethod
    def of(cls, n: int, components: int = 1, geometry: Mapping[str, Any] | None = None) -> LoadLayout:
        """LoadLayout of `n` loads, with the geometry of a load basis where there is one.

        Raises
        ------
        InputError
            If the geometry is one of another number of loads.
        """
        found = None if geometry is None or geometry.get("kind") == "polynomials" else geometry.get("coordinates")
        if found is None:
            return cls(n // components, components)
        x = np.asarray(found, float)
        x = x[:, None] if x.ndim == 1 else x
        components = len(geometry.get("components") or ()) or components  # type: ignore[union-attr]
        if len(x) * components != n:
            raise InputError("the places are not those of the loads", where="geometry",
                             found=f"{len(x)} places, {components} components", expected=f"{n} loads")  # fmt: skip
        measures = geometry.get("measures")  # type: ignore[union-attr]
        flat = _flattened(x)
        if flat.shape[1] == 0:
            return cls(len(x), components)
        return cls(len(x), components, flat, _cells(flat) if measures is None else np.asarray(measures, float))

    @property
    def dimension(self) -> int:
        """1 along a line, 2 over a surface, 3 in a body."""
        return 1 if self.places is None else self.places.shape[1]

    @property
    def unit(self) -> str:
        """Unit of a width."""
        return "loads" if self.places is None else "m"

    def width(self, spread: Array, load: int) -> float:
        """Full width at half maximum of a point spread (n,), among the loads of its own direction.

        On a line interpolated; on a surface the diameter of a disc (of a ball) as large as all that is above the half.
        """
        x = np.abs(spread.reshape(self.points, self.components)[:, load % self.components])
        own = load // self.components
        if x[own] <= 0:
            return float(self.points) if self.places is None else float(np.linalg.norm(np.ptp(self.places, axis=0)))
        if self.places is None:
            return width(x, own)
        assert self.measures is not None
        if self.dimension == 1:
            return max(_crossings(self.places[:, 0], x / x[own], own), float(self.measures[own]))
        size = float(np.sum(self.measures[x >= 0.5 * x[own]]))
        # nodes of a surface carry its area; those of a body are taken for points of a surface in it
        return 2 * float(np.sqrt(size / np.pi))

    def cross_talk(self, spread: Array, load: int, reach: float) -> float:
        """Largest response beyond `reach` of a load, or in another direction, over that at the load itself.

        Infinite where the load itself is shown nowhere in place.
        """
        x, own = np.abs(spread.reshape(self.points, self.components)), load // self.components
        at = np.arange(self.points)[:, None] if self.places is None else self.places
        away = np.linalg.norm(at - at[own], axis=1) > reach
        mine = x[own, load % self.components]
        others = np.delete(x, load % self.components, axis=1)
        largest = max(float(x[away, load % self.components].max(initial=0.0)), float(others.max(initial=0.0)))
        return largest / float(mine) if mine > 0 else (np.inf if largest > 0 else 0.0)


def _flattened(x: Array) -> Array:
    """Coordinates along the directions in which the places differ."""
    centred = x - x.mean(axis=0)
    if not np.any(centred):
        return np.asarray(centred[:, :0])
    span, axes = np.linalg.svd(centred, full_matrices=False)[1:]
    return np.asarray(centred @ axes[span > 1e-6 * span[0]].T)


def _cells(x: Array) -> Array:
    """Tributary length on a line; an equal share of the box elsewhere."""
    if x.shape[1] > 1:
        return np.full(len(x), float(np.prod(np.sort(np.ptp(x, axis=0))[-2:])) / len(x))
    order = np.argsort(x[:, 0])
    cells = np.empty(len(x))
    cells[order] = np.abs(np.gradient(x[order, 0]))
    return cells


def _crossings(x: Array, y: Array, own: int) -> float:
    """Distance between the places left and right of a peak of height 1 where it has fallen to a half."""
    order = np.argsort(x)
    x, y, k = x[order], y[order], int(np.flatnonzero(order == own)[0])

    def reach(a: Array, b: Array) -> float:
        below = np.flatnonzero(b < 0.5)
        if len(below) == 0:
            return abs(float(a[-1] - a[0]))
        j = int(below[0])
        part = (b[j - 1] - 0.5) / (b[j - 1] - b[j])
        return abs(float(a[j - 1] + part * (a[j] - a[j - 1]) - a[0]))

    return reach(x[k:], y[k:]) + reach(x[k::-1], y[k::-1])


@dataclass(frozen=True)
class Spreads:
    """Height, width and cross-talk of some columns of a resolution matrix; arrays (columns,)."""

    loads: NDArray[np.int64]
    widths: Array
    cross_talk: Array


def spreads(columns: ArrayLike, loads: NDArray[np.int64], layout: LoadLayout) -> Spreads:
    """Measure columns (n, k) of a resolution matrix that belong to `loads` (k,)."""
    columns = np.asarray(columns, float)
    widths = np.array([layout.width(column, int(j)) for column, j in zip(columns.T, loads, strict=True)])
    talk = [layout.cross_talk(c, int(j), w) for c, j, w in zip(columns.T, loads, widths, strict=True)]
    return Spreads(np.asarray(loads, int), widths, np.array(talk, float))


@dataclass(frozen=True, eq=False)
class Diagnosis(ReadOnly):
    """What the data can tell at one lambda: plain arrays and numbers, modes in order of falling generalised values.

    Parameters
    ----------
    lam, scale : float
        Relative lambda, and the largest generalised singular value.
    smooth : bool
        Tikhonov, not a truncated SVD.
    sigma : float or None
        Noise level of the whitened data.
    m, n, frames : int
        Data, loads, and frames that share lambda.
    singular_values : array, shape (min(m, n),)
        Of the whitened operator.
    generalised : array, shape (min(m, n),)
        Generalised singular values; infinite for modes that the penalty does not see.
    coefficients : array, shape (min(m, n),)
        |u_i^T y| of the whitened data, root mean square over the frames.
    filter_factors : array, shape (min(m, n),)
        Share of each mode that comes from the data.
    plateau : int
        i*: modes before the coefficients reach the noise, of `rank` that the operator has.
    floor : float
        Level of that noise in the coefficients; 0 where they fall to the end.
    kappa, rank, nullity : float, int, int
        Condition number of the observed part, and what it says nothing about.
    decay : Decay
        Law by which the singular values fall.
    null_share : float or None
        Share of the candidate load, by its norm, in ker(H).
    heights : array, shape (n,)
        Diagonal of the resolution matrix R: what is left of a single load in its own place.
    columns, widths, cross_talk : array, shape (k,)
        Loads whose point spread (column of R) was measured; full width at half maximum in `width_unit`; largest
        response away from the peak or in another direction, over that in place.
    width_unit : str
        ``"m"`` where the places of the loads are known, else ``"loads"``.
    load, width, peak_bias : int, float, float
        The largest candidate load, the width of its point spread, and the share of its height that is lost.
    worst : int
        Load that loses most of its height.
    matrix : array, shape (n, n), or None
        R itself, up to `WHOLE` loads.
    shown : array, shape (s,)
        Loads whose `signatures` (m, s), whitened columns of H, and `point_spreads` (n, s) are kept for pictures.
    """

    lam: float
    scale: float
    smooth: bool
    sigma: float | None
    m: int
    n: int
    frames: int
    singular_values: Array
    generalised: Array
    coefficients: Array
    filter_factors: Array
    plateau: int
    floor: float
    kappa: float
    rank: int
    nullity: int
    decay: Decay
    null_share: float | None
    heights: Array
    columns: NDArray[np.int64]
    widths: Array
    cross_talk: Array
    width_unit: str
    load: int
    width: float
    peak_bias: float
    worst: int
    matrix: Array | None = field(repr=False)
    shown: NDArray[np.int64]
    signatures: Array = field(repr=False)
    point_spreads: Array = field(repr=False)

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                value = value.copy()
                value.setflags(write=False)
                object.__setattr__(self, f.name, value)

    @property
    def seen(self) -> int:
        """Modes of the operator above rounding that the plateau is counted in."""
        return int(np.sum(self.generalised > 0))

    @property
    def snr(self) -> float:
        """Largest singular value over that of the last recoverable mode; 100 where there is none."""
        k = min(self.plateau, len(self.singular_values))
        return float(self.singular_values[0] / self.singular_values[k - 1]) if k > 1 else 100.0

    @property
    def eta(self) -> float:
        """Noise relative to the largest singular value: between the last recoverable mode and the next one."""
        s, k = self.singular_values, min(self.plateau, len(self.singular_values))
        lower = s[k] if k < len(s) and s[k] > 0 else s[max(k - 1, 0)] / 10
        return min(float(np.sqrt(lower * s[max(k - 1, 0)]) / s[0]), 0.999)

    def require(self, modes: int) -> None:
        """Refuse a resolution of `modes` components that the data do not hold.

        Raises
        ------
        NotIdentifiable
            If it is beyond the plateau (LID-W304).
        """
        if modes > self.plateau:
            raise NotIdentifiable(
                f"{modes} components were asked for, i* = {self.plateau} recoverable modes of {self.seen}",
                advice=f"ask for at most {self.plateau}: a coarser load basis, more sensors, or less noise",
                code="LID-W304",
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionary, for result files."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Diagnosis:
        """Inverse of `to_dict`."""
        return cls(**{**data, "decay": Decay(**data["decay"])})


def diagnose(
    path: SVDPath,
    lam: float,
    sigma: float | None = None,
    load: ArrayLike | None = None,
    *,
    geometry: Mapping[str, Any] | None = None,
) -> Diagnosis:
    """What the data of a dense path can tell at one relative lambda.

    Parameters
    ----------
    path : SVDPath
        Of one vector of data or of frames.
    lam : float
        Relative.
    sigma : float, optional
        Noise level of the whitened data.
    load : array, shape of one load, optional
        Candidate, such as the estimate: its largest entry says where width and loss of height are stated.
    geometry : mapping, optional
        ``coordinates`` (P, d) in m, ``measures`` (P,), ``components``, ``kind`` of the loads: widths are then in m.
    """
    m, n = path.problem.H.shape
    kappa, rank, nullity = layout(path.singular_values, n)
    modes = _modes(path, lam)
    known = modes.gamma > 0  # what meets no singular value above rounding is noise
    frames = path.problem.frames or 1
    loose = float(path.outside) / frames + float(np.sum(modes.beta[~known] ** 2))
    found = plateau(modes.beta[known], frames=frames, rest=(loose, m - int(np.sum(known))))
    if sigma is not None and found.floor > LOUD * sigma:  # too loud for noise: what is flat there is signal
        found = Plateau(int(np.flatnonzero(modes.beta[known] > LOUD * sigma).max(initial=-1)) + 1, float(sigma))
    components = path.problem.shape[1] if len(path.problem.shape) == 2 else 1
    where = LoadLayout.of(n, components, geometry)
    heights = np.einsum("ik,k,ik->i", path.X, path.filter_factors(lam), path.Y)
    candidate = None if load is None else np.asarray(plain(load), float).ravel()
    peak = n // 2 if candidate is None or not np.any(candidate) else int(np.argmax(np.abs(candidate)))
    bias = float(1 - heights[peak])
    worst, best = int(np.argmin(heights)), int(np.argmax(heights))
    whole = n <= WHOLE
    columns = np.arange(n) if whole else np.unique([*np.linspace(0, n - 1, SAMPLED).astype(int), peak, worst, best])
    R = path.resolution(lam) if whole else _columns(path, lam, columns)
    measured = spreads(R, columns, where)
    shown = np.array(list(dict.fromkeys([peak, worst, best])), int)
    return Diagnosis(
        lam=float(lam),
        scale=float(path.scale),
        smooth=path.smooth,
        sigma=None if sigma is None else float(sigma),
        m=m,
        n=n,
        frames=frames,
        singular_values=np.sort(path.singular_values)[::-1],
        generalised=modes.gamma,
        coefficients=modes.beta,
        filter_factors=modes.f,
        plateau=found.start,
        floor=found.floor,
        kappa=kappa,
        rank=rank,
        nullity=nullity,
        decay=decay(path.singular_values, min(where.dimension, 2), max(m, n)),
        null_share=None if candidate is None else float(path.null_share(candidate)),
        heights=heights,
        columns=measured.loads,
        widths=measured.widths,
        cross_talk=measured.cross_talk,
        width_unit=where.unit,
        load=peak,
        width=float(measured.widths[columns == peak][0]),
        peak_bias=bias if abs(bias) > 1e-12 else 0.0,
        worst=worst,
        matrix=R if whole else None,
        shown=shown,
        signatures=path.problem.H[:, shown],
        point_spreads=R[:, np.searchsorted(columns, shown)],
    )


@dataclass(frozen=True)
class _Modes:
    gamma: Array
    beta: Array
    f: Array


def _modes(path: SVDPath, lam: float) -> _Modes:
    """The modes that meet data, those first that the penalty does not see, then by falling generalised value."""
    k = min(path.problem.H.shape)
    c, s = path.c[:k], path.s[:k]
    free = s <= 1e-10 * path.s.max(initial=0.0)
    gamma = np.where(free, np.where(c > 0, np.inf, 0.0), c / np.where(free, 1.0, s))
    order = np.argsort(-gamma, kind="stable")
    return _Modes(gamma[order], np.abs(path.beta[:k])[order], path.filter_factors(lam)[:k][order])


def _columns(path: SVDPath, lam: float, loads: NDArray[np.int64]) -> Array:
    """Columns of the resolution matrix, (n, k)."""
    return (path.X * path.filter_factors(lam)) @ path.Y[loads].T
