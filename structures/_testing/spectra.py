"""Spectra of finite records: padding, lines, windows, averaging, and what segments and windows cannot show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._channels import Channel
from .._flags import Evidence, Flag
from ..errors import InputError, number, positive

TOLD, AROUND = 3.0, 20  # mean square of an FRF over its variance from which on it is told; lines on each side
BLOCK = 4_000_000  # numbers that are transformed at once


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


def smooth_lines(power: NDArray[Any], half: int, *, own: bool = True) -> NDArray[np.float64]:
    """Hann-weighted mean over ``2 half + 1`` neighbouring lines, the ends mirrored; shape (lines, ...).

    With `own` False over the neighbours alone.
    """
    lines = len(power)
    half = min(half, (lines - 1) // 2)
    if half < 1:
        return np.array(power, float)
    from scipy.ndimage import convolve1d

    kernel = np.hanning(2 * half + 3)[1:-1]
    kernel[half] *= own
    return np.asarray(convolve1d(np.asarray(power, float), kernel / kernel.sum(), axis=0, mode="mirror"))


def without_error(H: NDArray[Any], variance: NDArray[np.float64]) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """FRFs that are as likely too large as too small, and their variance.

    What noise makes of an FRF that is zero takes part in no load: a regression on it finds next to none (errors in
    variables; W. Fuller, Measurement Error Models, 1987). Each line is shrunk by the share of its mean square that is
    no error (N. Wiener, 1949). Below the first line that is told the FRF is any of that size.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
    variance : array, shape (lines, sensors, loads)
    """
    square, error = smooth_lines(np.abs(H) ** 2, AROUND), smooth_lines(variance, AROUND)
    unknown = np.cumsum(square > TOLD * error, axis=0) == 0
    share = 1.0 - np.minimum(np.divide(error, square, out=np.zeros_like(error), where=square > 0), 1.0)
    share = np.where(unknown, 0.0, share)
    return share * H, np.where(unknown, square, share * variance)


def resample_lines(H: NDArray[Any], padded: int) -> NDArray[np.complex128]:
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
    return np.asarray(fft.rfft(new, axis=0))


def minimum_phase(magnitude: NDArray[Any]) -> NDArray[np.complex128]:
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
    return np.asarray(np.exp(fft.rfft(cepstrum, axis=0)))


TAPER = 0.25  # share of each side of the gate that its cosine takes
GROWTH = 1e3  # of the noise at the end of a record, above which an exponential window is too steep to be taken out


def gate(force: NDArray[Any], dt: float, length: float) -> NDArray[np.float64]:
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
    return np.asarray(np.exp(-decay * dt * (np.arange(samples) - start)))


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


def taken_out(H: NDArray[Any], decay: float, samples: int) -> NDArray[np.complex128]:
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
    return np.asarray(fft.rfft(moved, axis=0))


def transforms(table: NDArray[Any], w: NDArray[Any], hop: int, detrend: str | None) -> Iterator[NDArray[np.complex128]]:
    """Transforms (segments, lines, channels) of the windowed segments of one table, some segments at a time."""
    from scipy import fft

    for pieces in segments(table, len(w), hop, detrend):
        yield fft.rfft(pieces * w[:, None], axis=1)


def segments(table: NDArray[Any], n: int, hop: int, detrend: str | None) -> Iterator[NDArray[np.float64]]:
    """Segments (some, n, channels) of one table, each freed of its mean or its straight line."""
    view = np.lib.stride_tricks.sliding_window_view(table, n, axis=0)[::hop].transpose(0, 2, 1)
    some = max(1, BLOCK // (n * table.shape[1]))
    for first in range(0, len(view), some):
        pieces = view[first : first + some]
        if detrend is not None:
            pieces = pieces - pieces.mean(axis=1, keepdims=True)
        if detrend == "linear":
            ramp = np.arange(n) - (n - 1) / 2
            pieces = pieces - ramp[:, None] * (np.einsum("t,stc->sc", ramp, pieces) / np.sum(ramp**2))[:, None]
        yield pieces


BURST = 30.0  # energy of the loudest over that of the middle segment; 9 segments of narrow-band noise stay below 10
NARROW = 0.1  # share by which half the resolution lowers a peak; a peak as wide as the window loses a sixth
SMEARED = 0.05  # share of the lines that a box window may lift
DECAYED = 0.01  # of the peak of a segment, below which its last fiftieth has decayed
LIFTED = 4.0  # over the spectrum with a Hann window, both smoothed over eleven lines


def leakage(
    tables: Sequence[NDArray[Any]],
    dt: float,
    matrix: NDArray[Any],
    channels: Sequence[Channel],
    w: NDArray[Any],
    hop: int,
    detrend: str | None,
    averages: float,
) -> tuple[Flag, ...]:
    """W508 for cross spectra (lines, channels, channels) of tables that were cut into segments of window `w`.

    A burst makes one segment far louder than the middle one. A line narrower than the window loses height when the
    segments are halved. A box window lifts the lines far from a strong one above what a Hann window shows there.
    """
    auto = np.diagonal(matrix, axis1=1, axis2=2).real
    found = [burst(tables, channels, len(w), hop)]
    if found[0] is None:
        found.append(narrow(tables, dt, auto, channels, w, hop, detrend, averages))
        if np.ptp(w) == 0:
            found.append(smeared(tables, dt, auto, channels, hop, detrend))
    return tuple(f for f in found if f)


def burst(tables: Sequence[NDArray[Any]], channels: Sequence[Channel], n: int, hop: int) -> Flag | None:
    """W508 where the energy of a channel comes from few of its segments."""
    energy = np.concatenate([_energies(t, n, hop) for t in tables])
    if len(energy) < 4:
        return None
    middle, top = np.median(energy, axis=0), energy.max(axis=0)
    ratio = np.divide(top, middle, out=np.where(top > 0, np.inf, 1.0), where=middle > 0)
    loud = np.flatnonzero(ratio > BURST)
    if not loud.size:
        return None
    return Flag(
        "W508",
        Evidence("loudest over middle segment", float(min(ratio.max(), 1e300)), BURST),
        f"a transient is cut into segments: {_names(channels, loud)}",
        "take each event as a record of its own, zero-padded until it has decayed, or the time-domain route",
    )


def narrow(
    tables: Sequence[NDArray[Any]],
    dt: float,
    auto: NDArray[Any],
    channels: Sequence[Channel],
    w: NDArray[Any],
    hop: int,
    detrend: str | None,
    averages: float,
) -> Flag | None:
    """W508 where the highest peak of a channel falls when the segments are half as long.

    With half the resolution the bias of a peak is four times as large, in the limit of a wide peak (Bendat & Piersol,
    Random Data, 4th ed., section 8.5.1), so that a third of the fall is the bias that is left. Chance moves a peak too.
    """
    if len(w) < 64 or np.ptp(w) == 0:
        return None
    half = _autospectra(tables, dt, w[::2][: len(w) // 2], hop, detrend)
    coarse = np.arange(1, len(half) - 1)  # lines that both have
    fine = np.max([auto[2 * coarse + k] for k in (-1, 0, 1)], axis=0)
    # the peak as the short segments see it: chosen in the long ones, chance alone would raise it
    peak, columns = np.argmax(half[coarse], axis=0), np.arange(auto.shape[1])
    top, low = fine[peak, columns], half[coarse][peak, columns]
    bias = np.where(top > 0, (top - low) / np.where(top > 0, 3 * top, 1.0), 0.0)
    limit = max(NARROW, 1.0 / np.sqrt(averages))
    bad = np.flatnonzero(bias > limit)
    if not bad.size:
        return None
    return Flag(
        "W508",
        Evidence("share that the highest peak misses", float(bias.max()), limit),
        f"a spectral line is narrower than the segments resolve: {_names(channels, bad)}",
        "longer segments; a periodic signal wants segments of whole periods, and its power is the area of the peak",
    )


def smeared(
    tables: Sequence[NDArray[Any]],
    dt: float,
    auto: NDArray[Any],
    channels: Sequence[Channel],
    hop: int,
    detrend: str | None,
) -> Flag | None:
    """W508 where a box window lifts lines far above what a Hann window shows: strong lines leak.

    Transients that have decayed in their segments do not: there a Hann window shows less, and is the wrong one.
    """
    n = 2 * (len(auto) - 1)
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / n)
    clean = smooth_lines(_autospectra(tables, dt, hann, hop, detrend), 5)
    share = np.mean(smooth_lines(auto, 5)[: len(clean)] > LIFTED * clean, axis=0)
    bad = np.flatnonzero((share > SMEARED) & ~_decayed(tables, n, hop))
    if not bad.size:
        return None
    return Flag(
        "W508",
        Evidence("share of lines lifted by leakage", float(share.max()), SMEARED),
        f"without a window, strong lines leak into the others: {_names(channels, bad)}",
        'window="hann", or segments of whole periods; a box suits transients that start and end at rest',
    )


def _decayed(tables: Sequence[NDArray[Any]], n: int, hop: int) -> NDArray[np.bool_]:
    """Channels (channels,) that are near rest at the end of every other segment or more."""
    ratios = []
    for table in tables:
        for pieces in segments(table, n, hop, None):
            peak = np.abs(pieces).max(axis=1)
            ratios.append(np.abs(pieces[:, -max(1, n // 50) :]).max(axis=1) / np.where(peak > 0, peak, 1.0))
    return np.asarray(np.median(np.concatenate(ratios), axis=0) < DECAYED)


def _energies(table: NDArray[Any], n: int, hop: int) -> NDArray[np.float64]:
    """Sum of squares about its mean of each segment, shape (segments, channels)."""
    start = np.arange(0, len(table) - n + 1, hop)
    centred = table - table.mean(axis=0)
    sums = [np.concatenate([np.zeros((1, table.shape[1])), np.cumsum(centred**p, axis=0)]) for p in (1, 2)]
    first, second = (s[start + n] - s[start] for s in sums)
    return np.asarray(np.maximum(second - first**2 / n, 0.0))


def _autospectra(
    tables: Sequence[NDArray[Any]], dt: float, w: NDArray[Any], hop: int, detrend: str | None
) -> NDArray[np.float64]:
    n, total, count = len(w), np.zeros((len(w) // 2 + 1, tables[0].shape[1])), 0
    for table in tables:
        for X in transforms(table, w, max(1, min(hop, n // 2)), detrend):
            total += np.sum(np.abs(X) ** 2, axis=0)
            count += len(X)
    return np.asarray(total * (multiplicity(n) * dt / np.sum(w**2) / count)[:, None])


def _names(channels: Sequence[Channel], index: NDArray[Any]) -> str:
    return ", ".join(channels[i].label for i in index[:8])
