"""Many small problems at once: one for each frequency line, each with its own lambda or all with one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from .path import FactoredPath, Solution


def factor(H: NDArray, Y: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray]:
    """Batched SVD of whitened lines.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
    Y : array, shape (lines, sensors)

    Returns
    -------
    U (lines, sensors, r), c (lines, r), zero below rounding, V (lines, loads, r), beta (lines, r), outside (lines,)
    """
    U, c, Vh = np.linalg.svd(H, full_matrices=False)
    # what rounding leaves of a silent direction carries no information: sums run over the rank of each line
    c = np.where(c > max(H.shape[1:]) * np.finfo(float).eps * c[:, :1], c, 0.0)
    beta = np.einsum("ksr,ks->kr", U.conj(), Y)
    outside = np.sum(np.abs(Y - np.einsum("ksr,kr->ks", U, beta)) ** 2, axis=1)
    return U, c, Vh.conj().swapaxes(1, 2), beta, outside


class StackedPath(FactoredPath):
    """Path of independent frequency lines, L = I: every scalar has the lines on its first axis.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
        Whitened FRF.
    Y : array, shape (lines, sensors)
        Whitened spectra.
    """

    def __init__(self, H: ArrayLike, Y: ArrayLike) -> None:
        H, Y = np.asarray(H), np.asarray(Y)
        if H.ndim != 3 or H.shape[:2] != Y.shape:
            raise InputError(
                "lines and data do not fit",
                where="stacked problem",
                found=f"H {H.shape}, Y {Y.shape}",
                expected="H (lines, sensors, loads), Y (lines, sensors)",
            )
        if not (np.all(np.isfinite(H)) and np.all(np.isfinite(Y))):
            raise InputError("NaN or inf in the lines or the data", where="stacked problem", expected="finite numbers",
                             hint="leave out these lines")  # fmt: skip
        self.U, c, self.V, beta, outside = factor(H, Y)
        self.H, self.Y = H, Y
        super().__init__(c, np.ones_like(c), beta, outside, H.shape[1])

    def residual(self, lam: ArrayLike) -> NDArray:
        """Whitened residual (lines, sensors) at one lambda per line (lines,) or one for all."""
        return self.Y - np.einsum("ksl,kl->ks", self.H, self.solution(lam, None).load)

    def solution(self, lam: ArrayLike, sigma: float | None) -> Solution:
        """Load spectra (lines, loads) at one lambda per line (lines,) or one for all."""
        lam = np.broadcast_to(np.asarray(lam, float), self.scale.shape)
        return Solution(np.einsum("klr,kr->kl", self.V, self.gains(lam)), None)
