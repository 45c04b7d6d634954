"""Whitened lines reduced to what the loads can reach: everything later costs loads x loads per line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError


@dataclass(frozen=True)
class Compressed:
    """Lines ``R g = b`` with what no load explains.

    Parameters
    ----------
    R : array, shape (lines, rank, loads)
        Whitened FRF after an orthogonal reduction.
    b : array, shape (lines, rank, snapshots)
        Whitened data: ``b b^H`` is the mean over the averages of a cross spectrum; a spectrum is one snapshot.
    outside : array, shape (lines,)
        Squared norm of the data outside the range of the FRF.
    left : int
        Data of a line beyond its loads.
    """

    R: NDArray[np.complex128]
    b: NDArray[np.complex128]
    outside: NDArray[np.float64]
    left: int

    @property
    def shape(self) -> tuple[int, int, int]:
        """Lines, rows and loads."""
        return self.R.shape

    def scaled(self, factor: NDArray) -> Compressed:
        """The same data over other unknowns: load ``g = factor z``, factor (loads,) or (lines, loads)."""
        return Compressed(self.R * np.asarray(factor)[..., None, :], self.b, self.outside, self.left)


def compress(H: NDArray, X: NDArray) -> Compressed:
    """Reduce whitened lines by QR.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
    X : array, shape (lines, sensors) or (lines, sensors, snapshots)

    Raises
    ------
    InputError
        Shapes that do not fit, NaN or infinity.
    """
    X = X[..., None] if X.ndim == 2 else X
    if H.ndim != 3 or X.shape[:2] != H.shape[:2] or 0 in H.shape:
        raise InputError("lines and data do not fit", where="frequency lines", found=f"H {H.shape}, data {X.shape}",
                         expected="(lines, sensors, loads) and (lines, sensors)")  # fmt: skip
    if not (np.all(np.isfinite(H)) and np.all(np.isfinite(X))):
        raise InputError("NaN or inf in the lines or the data", where="frequency lines", expected="finite numbers",
                         hint="leave out these lines")  # fmt: skip
    Q, R = np.linalg.qr(H)
    b = Q.conj().swapaxes(1, 2) @ X
    outside = np.maximum(_power(X) - _power(b), 0.0)
    sensors, loads = H.shape[1:]
    if sensors <= loads:
        outside = np.zeros(len(H))  # rounding: the range is everything
    return Compressed(R, b, outside, max(sensors - loads, 0))


def _power(x: NDArray) -> NDArray[np.float64]:
    """Energy of each line."""
    return np.einsum("ksn,ksn->k", x.conj(), x).real
