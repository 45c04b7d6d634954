"""Products with a block Toeplitz operator and a difference penalty, several right sides at once, time on the last axis.

Time last keeps each transform contiguous. Everything here is linear algebra: no data, no lambda.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.spectra import padded_length

from .. import penalties
from ..gsvd import Factors, paired, plain
from ..toeplitz import toeplitz


class Operator:
    """``(H g)_k = sum_j h_j g_{k-j}``, weighted, and the difference penalty L, with their transposes.

    Loads are arrays (k, loads, samples), responses (k, sensors, samples), differences (k, loads, samples - order).

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Impulse responses of the whitened data; cut, or zero beyond their end.
    samples : int
        Length of the record.
    penalty : str
        Named penalty, a difference of any order, ends free.
    weight : array, shape (samples, sensors), optional
        What each datum is multiplied by; 0 for a missing one.
    """

    def __init__(self, h: NDArray, samples: int, penalty: str = "identity", weight: NDArray | None = None) -> None:
        self.samples, (self.sensors, self.loads) = int(samples), h.shape[1:]
        self.penalty, self.order = penalty, penalties.order(penalty)
        if self.samples <= self.order:
            raise InputError("too few samples for this penalty", where="penalty", found=self.samples,
                             expected=f"more than {self.order} for {penalty}")  # fmt: skip
        self.h = np.ascontiguousarray(np.moveaxis(h[: self.samples], 0, -1), float)  # (sensors, loads, taps)
        self.padded = padded_length(self.samples)
        self.weight = None if weight is None else np.ascontiguousarray(weight.T, float)

    @cached_property
    def lines(self) -> NDArray[np.complex128]:
        """Transform of the impulse responses, (sensors, loads, lines); made when first asked for."""
        return self.transform(self.h)

    @property
    def rows(self) -> int:
        """Rows of the penalty for one load."""
        return self.samples - self.order

    @cached_property
    def modes(self) -> Factors:
        """Factorisation of the pair (H, L) written out, unknowns flattened as (samples, loads)."""
        h = np.zeros((self.samples, self.sensors, self.loads))
        h[: self.h.shape[-1]] = np.moveaxis(self.h, -1, 0)
        H = toeplitz(h)
        if self.weight is not None:
            H *= self.weight.T[:, :, None]
        R = np.asarray(np.linalg.qr(H.reshape(-1, H.shape[-1]), mode="r"))
        L = penalties.matrix(self.penalty, self.samples, self.loads)
        return plain(R) if L is None else paired(R, L)

    def cut(self, samples: int) -> Operator:
        """The same for the first samples alone."""
        weight = None if self.weight is None else self.weight[:, :samples].T
        return Operator(np.moveaxis(self.h, -1, 0), samples, self.penalty, weight)

    def with_penalty(self, penalty: str) -> Operator:
        """The same with another penalty."""
        return Operator(
            np.moveaxis(self.h, -1, 0), self.samples, penalty, None if self.weight is None else self.weight.T
        )

    def transform(self, x: NDArray) -> NDArray[np.complex128]:
        """Lines of the padded transform."""
        from scipy import fft

        return fft.rfft(x, self.padded)

    def record(self, lines: NDArray) -> NDArray[np.float64]:
        """The samples of the record from lines of the padded transform."""
        from scipy import fft

        return fft.irfft(lines, self.padded, overwrite_x=True)[..., : self.samples]

    def apply(self, g: NDArray) -> NDArray[np.float64]:
        """H g."""
        y = self.record(_mix(self.lines, self.transform(g)))
        return y if self.weight is None else y * self.weight

    def adjoint(self, r: NDArray) -> NDArray[np.float64]:
        """H^T r."""
        R = self.transform(r if self.weight is None else r * self.weight)
        return self.record(np.conj(_mix(self.lines.swapaxes(0, 1), np.conj(R, out=R))))

    def rough(self, g: NDArray) -> NDArray[np.float64]:
        """L g."""
        for _ in range(self.order):
            g = g[..., 1:] - g[..., :-1]
        return g

    def rough_adjoint(self, d: NDArray) -> NDArray[np.float64]:
        """L^T d."""
        for _ in range(self.order):
            wider = np.empty((*d.shape[:-1], d.shape[-1] + 1))
            wider[..., 0], wider[..., -1] = -d[..., 0], d[..., -1]
            np.subtract(d[..., :-1], d[..., 1:], out=wider[..., 1:-1])
            d = wider
        return d


def _mix(matrix: NDArray, x: NDArray) -> NDArray[np.complex128]:
    """Product line by line: (rows, columns, lines) with (k, columns, lines)."""
    rows, columns = matrix.shape[:2]
    out = np.empty((len(x), rows, x.shape[-1]), complex)
    for k in range(len(x)):
        for i in range(rows):
            np.multiply(matrix[i, 0], x[k, 0], out=out[k, i])
            for j in range(1, columns):
                out[k, i] += matrix[i, j] * x[k, j]
    return out
