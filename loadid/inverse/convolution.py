"""Causal convolution of a finite record as an operator: products with H and H^T by FFT, exact at both ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.spectra import padded_length


class Convolution:
    """``(H g)_k = sum_j h_j g_{k-j}`` for k = 0 .. samples - 1, and its transpose, without the Toeplitz matrix.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Impulse responses, whitened; cut or taken as zero beyond `samples`.
    samples : int, optional
        Length of the record; default the number of taps.
    weight : array, shape (samples, sensors), optional
        What each datum is multiplied by (0 for a missing one): rows of H are scaled by it.
    """

    def __init__(self, h: NDArray, samples: int | None = None, weight: NDArray | None = None) -> None:
        from scipy import fft

        self.samples = len(h) if samples is None else int(samples)
        self.sensors, self.loads = h.shape[1:]
        self.weight = weight
        if weight is not None and weight.shape != (self.samples, self.sensors):
            raise InputError("the weights do not fit the record", where="convolution", found=f"shape {weight.shape}",
                             expected=f"({self.samples}, {self.sensors})")  # fmt: skip
        self.padded = padded_length(self.samples)
        self.lines = fft.rfft(h[: self.samples], self.padded, axis=0)

    @property
    def shape(self) -> tuple[int, int]:
        """Data and unknowns."""
        return self.samples * self.sensors, self.samples * self.loads

    def apply(self, g: NDArray) -> NDArray[np.float64]:
        """H g: loads (samples, loads) to responses (samples, sensors)."""
        from scipy import fft

        G = fft.rfft(g, self.padded, axis=0)
        y = fft.irfft(np.einsum("ksl,kl->ks", self.lines, G), self.padded, axis=0)[: self.samples]
        return y if self.weight is None else y * self.weight

    def adjoint(self, r: NDArray) -> NDArray[np.float64]:
        """H^T r: responses (samples, sensors) to loads (samples, loads)."""
        from scipy import fft

        R = fft.rfft(r if self.weight is None else r * self.weight, self.padded, axis=0)
        return fft.irfft(np.einsum("ksl,ks->kl", self.lines.conj(), R), self.padded, axis=0)[: self.samples]
