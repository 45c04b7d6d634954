"""What can be told at all: conditioning and rank, resolution, loads that sensors tell apart, the start of a record.

The responses to loads before the first sample span what a structure can do freely: the columns ``h[k + j]``, j > 0. If
adding them to the model of the first samples removes much more than noise, the record does not start at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, plain

from .. import Array, Flags, penalties
from ..path import RegularizationPath
from ..problem import toeplitz


def layout(singular_values: ArrayLike, n: int) -> tuple[float, int, int]:
    """Conditioning of the observed subspace with its rank and nullity: (kappa, rank, nullity)."""
    s = np.sort(np.asarray(plain(singular_values), float))[::-1]
    tol = max(len(s), n) * np.finfo(float).eps * s[0]
    rank = int(np.sum(s > tol))
    return float(s[0] / s[rank - 1]), rank, max(n - rank, 0)


def width(spread: Array, peak: int) -> float:
    """Full width at half maximum of a point spread around its peak, in samples, interpolated."""
    x = np.abs(spread) / abs(spread[peak])

    def reach(y: Array) -> float:
        below = np.flatnonzero(y < 0.5)
        if len(below) == 0:
            return float(len(y))
        k = int(below[0])
        return float(k - 1 + (y[k - 1] - 0.5) / (y[k - 1] - y[k]))

    return max(1.0, reach(x[peak:]) + reach(x[peak::-1]))


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


@dataclass(frozen=True)
class Refinement:
    """Two load bases for the same region and sensors.

    Parameters
    ----------
    coarse, fine : int
        Number of loads of each.
    before, after : int
        Modes above the noise in each.
    eta : float
        Noise, relative to the largest singular value.
    """

    coarse: int
    fine: int
    before: int
    after: int
    eta: float

    @property
    def gained(self) -> int:
        """Modes that refining added above the noise."""
        return self.after - self.before


def refinement(coarse: ArrayLike, fine: ArrayLike, eta: float, *, loads: tuple[int, int] | None = None) -> Refinement:
    """Compare two bases by their operators or their singular values.

    Parameters
    ----------
    coarse, fine : array, shape (m, n) or (r,)
        Whitened operators, or their singular values.
    eta : float
        Noise relative to the largest singular value, between 0 and 1.
    loads : (int, int), optional
        Number of loads, where singular values are given and are fewer.

    Raises
    ------
    InputError
        If `eta` is not between 0 and 1, or the second basis is not the larger one.
    """
    if not 0 < eta < 1:
        raise InputError("no relative noise level", where="eta", found=eta, expected="between 0 and 1")
    (a, s), (b, t) = _values(coarse), _values(fine)
    a, b = loads or (a, b)
    if b <= a:
        raise InputError("the second basis is not finer", where="refinement", found=f"{a} and {b} loads",
                         expected="more loads in the second")  # fmt: skip
    return Refinement(a, b, int(np.sum(s > eta * s.max())), int(np.sum(t > eta * t.max())), float(eta))


def against_half(H: ArrayLike, eta: float, *, components: int = 1, edges: ArrayLike | None = None) -> Refinement:
    """Compare a basis with the one of half its size in which neighbouring loads are merged.

    The merged loads are orthonormal combinations, so that their singular values lie below those of the full basis.

    Parameters
    ----------
    H : array, shape (m, n)
        Whitened operator.
    eta : float
        Noise relative to the largest singular value.
    components : int
        Directions of each point: load index = point * components + component.
    edges : array, shape (E, 2), optional
        Pairs of neighbouring points; default the next one in order.

    Raises
    ------
    InputError
        If there are fewer than two points, or no whole number of them.
    """
    H = np.asarray(H, float)
    points, odd = divmod(H.shape[1], components)
    if odd or points < 2:
        raise InputError("these loads cannot be merged in pairs", where="refinement",
                         found=f"{H.shape[1]} loads of {components} components",
                         expected="two points or more")  # fmt: skip
    pairs = np.column_stack([np.arange(points - 1), np.arange(1, points)]) if edges is None else np.asarray(edges, int)
    group = _matched(points, pairs)
    size = np.bincount(group)
    merged = np.zeros((len(H), len(size), components))
    for point, g in enumerate(group):
        merged[:, g] += H.reshape(len(H), points, components)[:, point]
    merged /= np.sqrt(size)[:, None]
    return refinement(merged.reshape(len(H), -1), H, eta)


def _matched(points: int, edges: Array) -> NDArray[np.int64]:
    """Group of each point: neighbours in pairs, as many as can be found in order."""
    partner = np.full(points, -1)
    for a, b in edges:
        if a != b and partner[a] < 0 and partner[b] < 0:
            partner[a], partner[b] = b, a
    first = np.where(partner < 0, np.arange(points), np.minimum(np.arange(points), partner))
    return np.unique(first, return_inverse=True)[1]


def _values(A: ArrayLike) -> tuple[int, Array]:
    A = np.asarray(A, float)
    if A.ndim not in (1, 2) or A.size == 0 or not np.all(np.isfinite(A)):
        raise InputError("no operator and no singular values", where="refinement", found=f"shape {A.shape}, or NaN",
                         expected="finite, (m, n) or (r,)")  # fmt: skip
    return A.shape[-1], np.linalg.svdvals(A) if A.ndim == 2 else np.abs(A)


WINDOW = 48  # samples from the start that are looked at
PAST = 48  # delays from which loads before the record are taken
DIMENSIONS = 24  # free motions that are told apart, at most
WEAK = 1e-4  # free motions below this share of the strongest are left out
LOOSE = 0.1  # of lambda: a load that the prior does not fit must not look like motion
CLEAR = 5.0  # first sample over the noise from which a response is there
SHORTEST = 16  # samples below which nothing can be said


@dataclass(frozen=True)
class Start:
    """What the first samples say about the time before them.

    Parameters
    ----------
    gain : float
        Sum of squares that free motion removes from the misfit of the first samples, over the variance of the noise or
        of what is then left, whichever is larger: a load that is smoothed too much leaves misfit that is no motion.
    motions : int
        Number of free motions that were allowed; `gain` is near it for a record that starts at rest.
    share : float
        Largest free motion over the largest response of the record, for the sensor where that is most.
    first : float
        Response in the first sample over the largest of the record, for the sensor where that is most; of sensors whose
        first sample is not clearly above their noise it is 0.
    """

    gain: float
    motions: int
    share: float
    first: float


def start(
    h: Array, y: Array, lam: float, penalty: str = "identity", sigma: float = 1.0, missing: Flags | None = None
) -> Start | None:
    """Test of a start at rest, on the first samples alone.

    Columns are added to a penalised least-squares fit, and what they remove from its misfit is compared with what
    chance removes. The load of the first sample is left free, since a blow that falls into it is no motion before it,
    and the others are held by a tenth of lambda (`LOOSE`), so that a start at rest passes whatever the load.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Impulse responses of the whitened sensors.
    y : array, shape (samples, sensors)
        Whitened data.
    lam : float
        Absolute lambda of the whitened problem.
    penalty : str
        Name of the penalty.
    sigma : float
        Noise level of the whitened data.
    missing : array of bool, shape (samples, sensors), optional

    Returns
    -------
    Start or None
        None where the record or the impulse response is too short to tell, or the data are zero.
    """
    n, (_, m, p) = min(WINDOW, len(h) // 2, len(y)), h.shape
    there = np.ones((n, m), bool) if missing is None else ~missing[:n]
    largest = np.max(np.abs(y), axis=0)
    if n < SHORTEST or not largest.any() or not there.any() or not sigma > 0:
        return None
    free = _free(h, n)
    within = toeplitz(h[:n]).reshape(n * m, n * p)
    L = penalties.matrix(penalty, n, p)
    L = (np.eye(n * p) if L is None else L)[p:]  # without the row that ties the first load to nothing or to the next
    keep = there.ravel()
    A = np.vstack([within[keep], LOOSE * lam * L])
    Q = np.linalg.qr(A)[0]

    def left(columns: Array) -> Array:
        tall = np.vstack([columns, np.zeros((len(L), columns.shape[1]))])
        return np.asarray(tall - Q @ (Q.T @ tall))

    misfit, motions = left(y[:n].reshape(-1, 1)[keep]), left(free[keep])
    found = np.linalg.lstsq(motions, misfit, rcond=1e-8)[0]
    after, spare = misfit - motions @ found, len(A) - A.shape[1] - free.shape[1]
    variance = max(sigma**2, float(np.sum(after**2)) / max(spare, 1))
    motion = np.max(np.abs((free @ found).reshape(n, m)), axis=0)
    return Start(
        gain=float(np.sum((motions @ found) ** 2)) / variance,
        motions=free.shape[1],
        share=float(np.max(motion[largest > 0] / largest[largest > 0])),
        first=_first(y, np.asarray(there, bool), largest, sigma),
    )


def _first(y: Array, there: Flags, largest: Array, sigma: float) -> float:
    """Share of the first sample; the noise is judged by third differences too, as a misfit may be no noise at all."""
    rough = np.median(np.abs(np.diff(y, n=3, axis=0)), axis=0) / (0.6745 * np.sqrt(20))
    clear = there[0] & (np.abs(y[0]) > CLEAR * np.minimum(sigma, rough)) & (largest > 0)
    return float(np.max(np.abs(y[0, clear]) / largest[clear], initial=0.0))


def _free(h: Array, n: int) -> Array:
    """Orthonormal free motions of the first `n` samples, (n * sensors, motions): tails of the impulse responses."""
    delays = np.unique(np.geomspace(1, len(h) - n, PAST).astype(int))
    tails = np.stack([h[j : j + n] for j in delays], axis=-1).reshape(n * h.shape[1], -1)
    U, s, _ = np.linalg.svd(tails, full_matrices=False)
    return U[:, : max(min(int(np.sum(s > WEAK * s[0])), DIMENSIONS, len(U) // 4), 1)]


TAPS = 2048  # samples of the impulse response that are looked at
LINES = 200  # lines that are looked at


def apart(h: Array) -> tuple[float, Array]:
    """How well the best line tells all loads apart, and the combination of loads that is seen least over all lines.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Impulse responses; their units do not count, every sensor and every load is scaled to its own size.

    Returns
    -------
    ratio : float
        Smallest over largest singular value of the lines, on the best of them; 0 with fewer sensors than loads.
    combination : array, shape (loads,)
        Of norm 1, in shares of the response that each load causes.
    """
    loads = h.shape[2]
    if loads == 1:
        return 1.0, np.ones(1)
    lines = np.fft.rfft(h[:TAPS], axis=0)
    lines = lines[:: max(len(lines) // LINES, 1)]
    tiny = np.finfo(float).tiny
    lines = lines / np.maximum(np.sqrt(np.mean(np.abs(lines) ** 2, axis=(0, 2), keepdims=True)), tiny)
    lines = lines / np.maximum(np.sqrt(np.mean(np.abs(lines) ** 2, axis=(0, 1), keepdims=True)), tiny)
    stacked = lines.reshape(-1, loads)
    least = np.linalg.svd(np.vstack([stacked.real, stacked.imag]), full_matrices=False)[2][-1]
    if h.shape[1] < loads:
        return 0.0, least
    s = np.linalg.svd(lines, compute_uv=False)
    return float(np.max(s[:, -1] / np.maximum(s[:, 0], tiny))), least
