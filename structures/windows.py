"""Windows of impact tests: a gate on the force, an exponential on force and response, and its damping taken out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .errors import InputError
from .values import number, positive

TAPER = 0.25  # share of each side of the gate that its cosine takes
GROWTH = 1e3  # of the noise at the end of a record, above which an exponential window is too steep to be taken out


def gate(force: NDArray, dt: float, length: float) -> NDArray[np.float64]:
    """Window (samples,) that keeps `length` seconds on each side of the largest force, with cosine flanks.

    Outside there is noise and no force: without it H1 loses the bias that it would have from there.

    Raises
    ------
    InputError
        A length that is not positive.
    """
    away = np.abs(np.arange(len(force)) - int(np.argmax(np.abs(force)))) * dt
    length = positive("gate", length, where="from_hits", unit="s")
    fall = np.clip((away - (1 - TAPER) * length) / (TAPER * length), 0.0, 1.0)
    return 0.5 + 0.5 * np.cos(np.pi * fall)


def exponential(samples: int, dt: float, decay: float, start: int = 0) -> NDArray[np.float64]:
    """Window ``exp(-decay t)`` (samples,), t from the sample `start`; `decay` in 1/s.

    On force and response alike it turns ``H(omega)`` into ``H(omega - i decay)``: a mode of damping ratio z seems to
    have ``z + decay / omega_r`` (Fladung & Rost, Mech. Syst. Signal Process. 11, 1997).
    """
    return np.exp(-decay * dt * (np.arange(samples) - start))


def checked_decay(decay: float, duration: float, where: str) -> float:
    """Decay rate (1/s) of an exponential window over a record of this duration (s).

    Raises
    ------
    InputError
        A decay below zero, or so steep that taking it out would only raise noise.
    """
    a = number("decay", decay, where=where, unit="1/s")
    if a < 0 or np.exp(min(a * duration, 700.0)) > GROWTH:
        raise InputError(
            "no exponential window that can be taken out again",
            where=where,
            found=f"decay {a:g} 1/s, which falls to {np.exp(-min(a * duration, 700.0)):.2g} in {duration:.4g} s",
            expected=f"0 to {np.log(GROWTH) / duration:.4g} 1/s",
            hint="a window that falls to 0.01 to 0.1 at the end of the record is enough",
        )
    return a


def taken_out(H: NDArray, decay: float, samples: int) -> NDArray[np.complex128]:
    """``H(omega)`` from ``H(omega - i decay)``, on lines of a transform that holds the record twice.

    Parameters
    ----------
    H : array, shape (lines, ...), complex
        From 0 Hz to Nyquist, of an even transform.
    decay : float
        Per sample.
    samples : int
        Length of the record: what comes later was not measured, and becomes 0.

    Returns
    -------
    H : array, shape (new lines, ...), complex
        Of the same transform, or of one of twice `samples` where the record fills more than half of it.
    """
    from scipy import fft

    old = 2 * (len(H) - 1)
    after = min(samples, old)
    h = fft.irfft(H, old, axis=0)
    new = max(old, 2 * after)
    before = max(min(old - after, old // 2 - 1), 0)  # what rings before zero stands at the end
    weights = np.exp(decay * np.concatenate([np.arange(after), -np.arange(before, 0, -1)]))
    moved = np.zeros((new, *h.shape[1:]))
    moved[:after] = h[:after] * weights[:after].reshape(-1, *[1] * (h.ndim - 1))
    if before:
        moved[-before:] = h[-before:] * weights[after:].reshape(-1, *[1] * (h.ndim - 1))
    return fft.rfft(moved, axis=0)
