"""Does a record begin in motion, and can its sensors tell the loads apart?

The responses to loads before the first sample span what a structure can do freely: the columns ``h[k + j]``, j > 0. If
adding them to the model of the first samples removes much more than noise, the record does not start at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import penalties
from ..arrays import Array, Flags
from ..convolution import toeplitz

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
