"""Products with a convolution of any length a block at a time: the work space is that of a block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BLOCK = 1 << 14  # samples of a block, unless the responses are longer
EMPTY = 1e-15  # share of its norm that an impulse response may lose at its end


def heard(h: NDArray) -> NDArray[np.float64]:
    """Impulse responses (taps, sensors, loads) without an end that is zero to rounding."""
    left = np.sqrt(np.cumsum(np.sum(h**2, axis=(1, 2))[::-1])[::-1])
    return h[: max(int(np.sum(left > EMPTY * left[0])), 1)]


class Stream:
    """``H g`` and ``H^T r`` over a part of a record; time is on the last axis, but for h.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
    block : int, optional
        Samples that `response` and `adjoint` are asked for, at most.
    """

    def __init__(self, h: NDArray, block: int | None = None) -> None:
        from scipy import fft

        self.taps, self.block = len(h), max(BLOCK, len(h)) if block is None else int(block)
        self.length = int(fft.next_fast_len(self.taps + self.block, real=True))
        self.lines = fft.rfft(np.moveaxis(h, 0, -1), self.length)

    def response(self, g: NDArray, start: int, stop: int, before: int | None = None) -> NDArray[np.float64]:
        """Responses (sensors, stop - start) to a load (loads, samples), or to what of it comes before a sample."""
        from scipy import fft

        first = max(start - self.taps + 1, 0)
        G = fft.rfft(g[:, first : stop if before is None else before], self.length)
        full = fft.irfft(np.einsum("slk,lk->sk", self.lines, G), self.length)
        return full[:, start - first : stop - first]

    def adjoint(self, r: NDArray, start: int, stop: int) -> NDArray[np.float64]:
        """Loads (loads, stop - start) of H^T r."""
        from scipy import fft

        R = fft.rfft(r[:, start : stop + self.taps - 1], self.length)
        return fft.irfft(np.einsum("slk,sk->lk", self.lines.conj(), R), self.length)[:, : stop - start]

    def whole(self, g: NDArray) -> NDArray[np.float64]:
        """Responses (sensors, samples) to a load (loads, samples) over its whole length."""
        out = np.empty((self.lines.shape[0], g.shape[1]))
        for a in range(0, g.shape[1], self.block):
            out[:, a : a + self.block] = self.response(g, a, min(a + self.block, g.shape[1]))
        return out

    def whole_adjoint(self, r: NDArray) -> NDArray[np.float64]:
        """Loads (loads, samples) of H^T r over the whole length."""
        out = np.empty((self.lines.shape[1], r.shape[1]))
        for a in range(0, r.shape[1], self.block):
            out[:, a : a + self.block] = self.adjoint(r, a, min(a + self.block, r.shape[1]))
        return out
