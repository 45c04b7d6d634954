"""Where data decide and where the prior does: spectrum of the error of a settled filter over that of the prior.

The error of a filter that has settled is a stationary process, driven by what moves the loads and by the noise of the
sensors; the load by its prior is one too. Frequency by frequency their ratio is what the data have left of what was
not known before. Over all frequencies the first is the square of the std of the track.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...inverse.kalman.steady import Steady

LINES = 160  # frequencies at which the two are compared
LOWEST = 1e-4  # of the Nyquist frequency; what is told there is told below
Bands = tuple[tuple[float, float], ...]


def spectra(settled: Steady, turns: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Variance of a sample by frequency: of the error of every load, and of the load by its prior.

    Parameters
    ----------
    settled : Steady
    turns : array, shape (lines,)
        Frequency in radians a sample, 0 to pi.

    Returns
    -------
    error, prior : array, shape (lines, p)
        Their means over 0 to 2 pi are the variances; infinite or large where a walk has no variance.
    """
    model, part, K = settled.model, settled.part, settled.K
    shift = np.exp(-1j * np.asarray(turns, float))[:, None, None]
    pushes = np.hstack([part.LQ - K @ (part.H @ part.LQ), -K @ part.LR])
    error = _power(settled.A, model.Cp, pushes, shift)
    own = slice(model.nx, None)
    return error, _power(model.F[own, own], model.Cp[:, own], model.LQ[own], shift)


def told_bands(settled: Steady, dt: float) -> tuple[Bands, ...]:
    """Bands in Hz, load by load, in which the error of the track is smaller than what its prior knew.

    The lowest line stands for all below it, the highest ends at the Nyquist frequency.
    """
    turns = np.pi * np.r_[np.geomspace(LOWEST, 0.02, LINES // 4, endpoint=False), np.linspace(0.02, 1, LINES)]
    error, prior = spectra(settled, turns)
    hertz = turns / (2 * np.pi * dt)
    hertz[0] = 0.0
    return tuple(_intervals(hertz, below) for below in (error < prior).T)


def in_words(bands: Bands, nyquist: float) -> str:
    """What the bands of a load say of its track."""
    if not bands:
        return "at no frequency do the data tell more than the prior"
    listed = " and ".join(f"{low:.3g} to {high:.3g} Hz" for low, high in bands)
    if len(bands) == 1 and bands[0][0] == 0.0 and np.isclose(bands[0][1], nyquist):
        return f"the data tell more than the prior at all frequencies ({listed})"
    return f"the data tell more than the prior from {listed}; elsewhere the track is its prior"


def _power(A: NDArray, C: NDArray, B: NDArray, shift: NDArray) -> NDArray[np.float64]:
    """Squares of the gains of ``x_k = A x_{k-1} + B e_k``, read by C, summed over e: (lines, rows of C)."""
    adjoint = np.eye(len(A)) - A.T * shift  # C (I - A s)^-1, transposed
    read = np.linalg.solve(adjoint, np.broadcast_to(C.T.astype(complex), (len(shift), *C.T.shape)))
    return np.asarray(np.sum(np.abs(np.swapaxes(read, 1, 2) @ B) ** 2, axis=2))


def _intervals(hertz: NDArray, inside: NDArray[np.bool_]) -> Bands:
    edges = np.flatnonzero(np.diff(np.r_[False, inside, False])).reshape(-1, 2)
    return tuple((float(hertz[a]), float(hertz[b - 1])) for a, b in edges)
