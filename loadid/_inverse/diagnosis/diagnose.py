"""Diagnostics of any path: what the data can tell of a load, and what becomes of the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import NotIdentifiable, plain

from ..arrays import Array
from ..path import RegularizationPath
from ..svd import SVDPath
from .picard import Decay, Plateau, decay, plateau
from .resolution import LoadLayout, Refinement, against_half, refinement, spreads, width

__all__ = [
    "Decay", "Diagnosis", "LoadLayout", "Plateau", "Refinement", "against_half", "decay", "diagnose", "hidden",
    "layout", "plateau", "refinement", "resolution", "spreads", "width",
]  # fmt: skip

WHOLE = 400  # loads up to which the resolution matrix is kept
LOUD = 4.0  # times the noise level: a plateau above that is none
SAMPLED = 200  # of its columns that are measured where there are more loads


@dataclass(frozen=True, eq=False)
class Diagnosis:
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


def layout(singular_values: ArrayLike, n: int) -> tuple[float, int, int]:
    """Conditioning of the observed subspace with its rank and nullity: (kappa, rank, nullity)."""
    s = np.sort(np.asarray(plain(singular_values), float))[::-1]
    tol = max(len(s), n) * np.finfo(float).eps * s[0]
    rank = int(np.sum(s > tol))
    return float(s[0] / s[rank - 1]), rank, max(n - rank, 0)


def resolution(path: RegularizationPath, lam: float, load: Array) -> tuple[float, float]:
    """Width in samples of the answer to a single-sample load at the peak, and the share of its height that is lost."""
    sample, j = np.unravel_index(int(np.argmax(np.abs(load))), load.shape)
    unit = np.zeros(load.shape)
    unit[sample, j] = 1.0
    spread = path.resolve(unit, lam)[:, j]
    if spread[sample] <= 0:
        return float(len(load)), 1.0
    return width(spread, int(sample)), float(1 - spread[sample])


def hidden(path: RegularizationPath, lam: float, load: Array, std: Array, *, axis: int = 0) -> Array:
    """What regularisation is expected to hide, (R - I) g for the part of the estimate that stands out of its noise.

    The estimate itself has lost it already (low frequencies that accelerometers do not see come back as a slow
    undershoot); its clear part, above three standard deviations and a tenth of the peak, still holds it. Zero for an
    estimate that is all noise. `axis` is that along which there is one peak: time of a history, the loads of a frame.
    """
    size = np.abs(load)
    clear = np.where(size > np.maximum(3 * std, 0.1 * size.max(axis=axis, keepdims=True)), load, 0.0)
    return path.resolve(clear, lam) - clear
