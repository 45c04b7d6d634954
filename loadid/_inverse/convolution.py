"""Convolution with impulse responses as a linear operator: products by FFT, whole or in blocks; the difference penalty.

Inside, time is the last axis: each transform is contiguous. Everything here is linear algebra: no data, no lambda.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from structures._testing.spectra import padded_length
from structures.errors import InputError

from . import penalties
from .problem import toeplitz
from .svd import Factors, paired, plain

if TYPE_CHECKING:

    class LinearOperator:
        """As far as it is used here."""

        shape: tuple[int, int]

        def __init__(self, dtype: type, shape: tuple[int, int]) -> None: ...

else:
    from scipy.sparse.linalg import LinearOperator

Array = NDArray[np.float64]
Lines = NDArray[np.complex128]
BLOCK = 1 << 14  # samples of a block, unless the responses are longer
FULL = 4  # a record of so many blocks and more is cut into blocks, if the responses are that much shorter than it
EMPTY = 1e-15  # share of its norm that an impulse response may lose at its end


def heard(h: Array) -> Array:
    """Impulse responses (taps, sensors, loads) without an end that is zero to rounding."""
    left = np.sqrt(np.cumsum(np.sum(h**2, axis=(1, 2))[::-1])[::-1])
    return h[: max(int(np.sum(left > EMPTY * left[0])), 1)]


class Convolution(LinearOperator):
    """``(H g)_k = sum_j h_j g_{k-j}`` for k = 0 .. samples - 1, and its transpose, without the Toeplitz matrix.

    A `scipy.sparse.linalg.LinearOperator` on loads flattened as (samples, loads). `apply` and `apply_transposed` take
    arrays with time on the first axis; `convolve` and `correlate`, which all of them rest on, on the last.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Impulse responses, whitened; cut or taken as zero beyond `samples`.
    samples : int, optional
        Length of the record; default the number of taps.
    weight : array, shape (samples, sensors), optional
        What each datum is multiplied by (0 for a missing one): rows of H are scaled by it.
    block : int, optional
        Samples that are made at once, each with what of the load it still hears (overlap-save). Default: the record by
        one padded transform, or blocks where it is long and the responses are short, which takes the memory of a block.

    Raises
    ------
    InputError
        Weights that do not fit.
    """

    def __init__(
        self, h: Array, samples: int | None = None, weight: Array | None = None, *, block: int | None = None
    ) -> None:
        self.samples = len(h) if samples is None else int(samples)
        self.sensors, self.loads = h.shape[1:]
        super().__init__(float, (self.samples * self.sensors, self.samples * self.loads))
        if weight is not None and weight.shape != (self.samples, self.sensors):
            raise InputError("the weights do not fit the record", where="convolution", found=f"shape {weight.shape}",
                             expected=f"({self.samples}, {self.sensors})")  # fmt: skip
        self.h = np.ascontiguousarray(np.moveaxis(h[: self.samples], 0, -1), float)  # (sensors, loads, taps)
        self.weight = None if weight is None else np.ascontiguousarray(weight.T, float)
        taps = self.h.shape[-1]
        if block is None:
            block = max(BLOCK, taps) if self.samples > FULL * max(BLOCK, taps) else self.samples
        self.block = min(int(block), self.samples)
        self.length = (
            self.padded if self.block == self.samples else int(fft.next_fast_len(taps + self.block, real=True))
        )

    @property
    def responses(self) -> Array:
        """Impulse responses (taps, sensors, loads)."""
        return np.moveaxis(self.h, -1, 0)

    @property
    def weights(self) -> Array | None:
        """Weights of the data (samples, sensors)."""
        return None if self.weight is None else self.weight.T

    @cached_property
    def padded(self) -> int:
        """Length of a transform in which no part of a response wraps round."""
        return padded_length(self.samples)

    @cached_property
    def spectrum(self) -> Lines:
        """Transform of the impulse responses padded to `padded`, (sensors, loads, lines)."""
        return self._transfer if self.length == self.padded else np.asarray(fft.rfft(self.h, self.padded))

    @cached_property
    def _transfer(self) -> Lines:
        """Transform of the impulse responses for one block."""
        return np.asarray(fft.rfft(self.h, self.length))

    # -- time first, and flat -----------------------------------------------------------------------------------------
    def apply(self, g: Array) -> Array:
        """H g: loads (samples, loads, ...) to responses (samples, sensors, ...)."""
        return _time_first(self.convolve(_time_last(g)))

    def apply_transposed(self, r: Array) -> Array:
        """H^T r: responses (samples, sensors, ...) to loads (samples, loads, ...)."""
        return _time_first(self.correlate(_time_last(r)))

    def _matvec(self, x: Array) -> Array:
        return self.apply(x.reshape(self.samples, self.loads)).reshape(-1)

    def _rmatvec(self, x: Array) -> Array:
        return self.apply_transposed(x.reshape(self.samples, self.sensors)).reshape(-1)

    def _matmat(self, X: Array) -> Array:
        return self.apply(X.reshape(self.samples, self.loads, -1)).reshape(self.shape[0], -1)

    def _rmatmat(self, X: Array) -> Array:
        return self.apply_transposed(X.reshape(self.samples, self.sensors, -1)).reshape(self.shape[1], -1)

    # -- time last ----------------------------------------------------------------------------------------------------
    def convolve(self, g: Array) -> Array:
        """H g: loads (..., loads, samples) to responses (..., sensors, samples)."""
        y = self._in_blocks(self.response, g, self.sensors)
        return y if self.weight is None else y * self.weight

    def correlate(self, r: Array) -> Array:
        """H^T r: responses (..., sensors, samples) to loads (..., loads, samples)."""
        return self._in_blocks(self.correlation, r if self.weight is None else r * self.weight, self.loads)

    def _in_blocks(self, product: Callable[[Array, int, int], Array], x: Array, rows: int) -> Array:
        if self.block == self.samples:
            return product(x, 0, self.samples)
        out = np.empty((*x.shape[:-2], rows, self.samples))
        for start in range(0, self.samples, self.block):
            stop = min(start + self.block, self.samples)
            out[..., start:stop] = product(x, start, stop)
        return out

    def response(self, g: Array, start: int, stop: int, before: int | None = None) -> Array:
        """Response from `start` to `stop`, at most a block, without weights; to the load `before` a sample alone."""
        first = max(start - self.h.shape[-1] + 1, 0)
        G = fft.rfft(g[..., first : stop if before is None else before], self.length)
        full: Array = fft.irfft(_mix(self._transfer, G), self.length, overwrite_x=True)
        return full[..., start - first : stop - first]

    def correlation(self, r: Array, start: int, stop: int) -> Array:
        """The transpose from `start` to `stop`, at most a block, without weights."""
        R = fft.rfft(r[..., start : stop + self.h.shape[-1] - 1], self.length)
        lines = np.conj(_mix(self._transfer.swapaxes(0, 1), np.conj(R, out=R)))
        full: Array = fft.irfft(lines, self.length, overwrite_x=True)
        return full[..., : stop - start]


def _time_last(x: Array) -> Array:
    return np.moveaxis(x, (0, 1), (-1, -2))


def _time_first(x: Array) -> Array:
    return np.ascontiguousarray(np.moveaxis(x, (-1, -2), (0, 1)))


def _mix(matrix: Lines, x: Lines) -> Lines:
    """Product line by line: (rows, columns, lines) with (..., columns, lines)."""
    (rows, columns), each = matrix.shape[:2], x.reshape(-1, *x.shape[-2:])
    out = np.empty((len(each), rows, x.shape[-1]), complex)
    for k in range(len(each)):
        for i in range(rows):
            np.multiply(matrix[i, 0], each[k, 0], out=out[k, i])
            for j in range(1, columns):
                out[k, i] += matrix[i, j] * each[k, j]
    return out.reshape(*x.shape[:-2], *out.shape[1:])


class PenalizedConvolution(Convolution):
    """The pair (H, L) of a convolution and a difference penalty; differences are (..., loads, samples - order).

    Parameters
    ----------
    h, samples, weight
        As of `Convolution`.
    penalty : str
        Named penalty, a difference of any order, ends free.
    """

    def __init__(self, h: Array, samples: int, penalty: str = "identity", weight: Array | None = None) -> None:
        self.penalty, self.order = penalty, penalties.order(penalty)
        if samples <= self.order:
            raise InputError("too few samples for this penalty", where="penalty", found=samples,
                             expected=f"more than {self.order} for {penalty}")  # fmt: skip
        super().__init__(h, samples, weight)

    @property
    def rows(self) -> int:
        """Rows of the penalty for one load."""
        return self.samples - self.order

    @cached_property
    def modes(self) -> Factors:
        """Factorisation of the pair (H, L) written out, unknowns flattened as (samples, loads)."""
        h = np.zeros((self.samples, self.sensors, self.loads))
        h[: self.h.shape[-1]] = self.responses
        H = toeplitz(h)
        if self.weights is not None:
            H *= self.weights[:, :, None]
        R = np.asarray(np.linalg.qr(H.reshape(-1, H.shape[-1]), mode="r"))
        L = penalties.matrix(self.penalty, self.samples, self.loads)
        return plain(R) if L is None else paired(R, L)

    def cut(self, samples: int) -> PenalizedConvolution:
        """The same for the first samples alone."""
        weight = None if self.weights is None else self.weights[:samples]
        return PenalizedConvolution(self.responses, samples, self.penalty, weight)

    def rough(self, g: Array) -> Array:
        """L g."""
        return differences(g, self.order)

    def rough_adjoint(self, d: Array) -> Array:
        """L^T d."""
        return differences_adjoint(d, self.order)


def differences(g: Array, order: int) -> Array:
    """Differences of neighbours along the last axis, `order` times."""
    for _ in range(order):
        g = g[..., 1:] - g[..., :-1]
    return g


def differences_adjoint(d: Array, order: int) -> Array:
    """Transpose of `differences`."""
    for _ in range(order):
        wider = np.empty((*d.shape[:-1], d.shape[-1] + 1))
        wider[..., 0], wider[..., -1] = -d[..., 0], d[..., -1]
        np.subtract(d[..., :-1], d[..., 1:], out=wider[..., 1:-1])
        d = wider
    return d
