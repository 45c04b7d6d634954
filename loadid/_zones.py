"""Where a fluid feeds a structure and where it damps it: the power per length of a load on the moving structure."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, as_array, positive

Array = NDArray[np.float64]


def harmonic_power(load: ArrayLike, velocity: ArrayLike) -> Array:
    """Mean power ``Re(q conj(v)) / 2`` of complex amplitudes of load and velocity, of one shape: above zero it excites.

    W/m of a load in N/m, W/m^2 of a pressure.

    Raises
    ------
    InputError
        If the two do not fit each other.
    """
    q, v = (as_array(x, where="harmonic_power", dtype=complex) for x in (load, velocity))
    _fit(q, v)
    return np.asarray(0.5 * np.real(q * np.conj(v)), float)


def mean_power(load: ArrayLike, velocity: ArrayLike, dt: float, window: float) -> Array:
    """Power of a load history on the velocity under it, averaged over a sliding window.

    Parameters
    ----------
    load, velocity : array (samples, places)
        N/m and m/s at the same places and times.
    dt : float
        Step in s.
    window : float
        Length in s of the Hann window that slides over the record: some periods of the motion.

    Returns
    -------
    array (samples, places)
        W/m: above zero the load excites, below zero it damps. Near the ends of the record the window is cut, and its
        weights still sum to one.

    Raises
    ------
    InputError
        If the two do not fit each other, or the window is shorter than four samples or longer than the record.
    """
    from scipy.signal import fftconvolve

    q, v = (as_array(x, where="mean_power", dtype=float) for x in (load, velocity))
    _fit(q, v)
    step = positive("dt", dt, where="mean_power", unit="s")
    half = round(positive("window", window, where="mean_power", unit="s") / step / 2)
    if half < 2 or 2 * half + 1 > len(q):
        raise InputError("the window does not fit the record", where="mean_power", found=f"{2 * half + 1} samples",
                         expected=f"5 to {len(q)}", hint="some periods of the motion")  # fmt: skip
    weights = np.hanning(2 * half + 3)[1:-1]
    shape = (len(weights),) + (1,) * (q.ndim - 1)
    share = fftconvolve(np.ones(len(q)), weights, mode="same").reshape(-1, *shape[1:])
    return np.asarray(fftconvolve(q * v, weights.reshape(shape), mode="same", axes=0) / share, float)


def _fit(q: NDArray[Any], v: NDArray[Any]) -> None:
    if q.shape != v.shape or q.size == 0 or not (np.all(np.isfinite(q)) and np.all(np.isfinite(v))):
        raise InputError("load and velocity do not fit each other", where="power", found=f"{q.shape} and {v.shape}",
                         expected="finite, of one shape: the same places and times")  # fmt: skip
