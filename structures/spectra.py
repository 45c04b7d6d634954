"""Spectra of finite records: padding, counting lines, averaging over neighbouring lines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def padded_length(samples: int) -> int:
    """Fast even transform length of at least twice the record: no part of a response wraps round."""
    from scipy.fft import next_fast_len

    length = int(next_fast_len(2 * samples, real=True))
    while length % 2:
        length = int(next_fast_len(length + 1, real=True))
    return length


def multiplicity(padded: int) -> NDArray[np.float64]:
    """How often each line of a real transform of this length stands in the full one: 1 for DC and Nyquist, else 2."""
    count = np.full(padded // 2 + 1, 2.0)
    count[0] = 1.0
    if padded % 2 == 0:
        count[-1] = 1.0
    return count


def smooth_lines(power: NDArray, half: int) -> NDArray[np.float64]:
    """Hann-weighted mean over ``2 half + 1`` neighbouring lines, the ends mirrored; shape (lines, ...)."""
    lines = len(power)
    half = min(half, (lines - 1) // 2)
    if half < 1:
        return np.array(power, float)
    from scipy.ndimage import convolve1d

    kernel = np.hanning(2 * half + 3)[1:-1]
    return convolve1d(np.asarray(power, float), kernel / kernel.sum(), axis=0, mode="mirror")


def resample_lines(H: NDArray, padded: int) -> NDArray[np.complex128]:
    """Lines of a one-sided response on another spacing: zero-pad or cut its impulse response, both sides of zero.

    Parameters
    ----------
    H : array, shape (lines, ...)
        Response at 0 ... Nyquist of an even transform of length 2 (lines - 1).
    padded : int
        Even length of the new transform; the Nyquist frequency stays.
    """
    from scipy import fft

    old = 2 * (len(H) - 1)
    if padded == old:
        return np.asarray(H, complex)
    h = fft.irfft(H, old, axis=0)
    half = min(old, padded) // 2
    new = np.zeros((padded, *h.shape[1:]))
    new[:half], new[-half:] = h[:half], h[-half:]
    return fft.rfft(new, axis=0)


def minimum_phase(magnitude: NDArray) -> NDArray[np.complex128]:
    """Response of the causal filter with this magnitude whose inverse is causal too, by folding the cepstrum.

    Oppenheim & Schafer, Discrete-Time Signal Processing, 3rd ed., 2010, section 13.

    Parameters
    ----------
    magnitude : array, shape (lines, ...)
        Positive, at 0 ... Nyquist of an even transform of length 2 (lines - 1).
    """
    from scipy import fft

    padded = 2 * (len(magnitude) - 1)
    cepstrum = fft.irfft(np.log(magnitude), padded, axis=0)
    cepstrum[1 : padded // 2] *= 2
    cepstrum[padded // 2 + 1 :] = 0
    return np.exp(fft.rfft(cepstrum, axis=0))
