"""What segments and windows cannot show: transients that they cut, lines narrower than they resolve, smearing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .channels import Channel
from .flags import Evidence, Flag
from .spectra import smooth_lines

BURST = 30.0  # energy of the loudest over that of the middle segment; 9 segments of narrow-band noise stay below 10
NARROW = 0.1  # share by which half the resolution lowers a peak; a peak as wide as the window loses a sixth
SMEARED = 0.05  # share of the lines that a box window may lift
DECAYED = 0.01  # of the peak of a segment, below which its last fiftieth has decayed
LIFTED = 4.0  # over the spectrum with a Hann window, both smoothed over eleven lines


def leakage(
    tables: Sequence[NDArray],
    dt: float,
    matrix: NDArray,
    channels: Sequence[Channel],
    w: NDArray,
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


def burst(tables: Sequence[NDArray], channels: Sequence[Channel], n: int, hop: int) -> Flag | None:
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
    tables: Sequence[NDArray],
    dt: float,
    auto: NDArray,
    channels: Sequence[Channel],
    w: NDArray,
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
    tables: Sequence[NDArray], dt: float, auto: NDArray, channels: Sequence[Channel], hop: int, detrend: str | None
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


def _decayed(tables: Sequence[NDArray], n: int, hop: int) -> NDArray[np.bool_]:
    """Channels (channels,) that are near rest at the end of every other segment or more."""
    from .welch import segments

    ratios = []
    for table in tables:
        for pieces in segments(table, n, hop, None):
            peak = np.abs(pieces).max(axis=1)
            ratios.append(np.abs(pieces[:, -max(1, n // 50) :]).max(axis=1) / np.where(peak > 0, peak, 1.0))
    return np.median(np.concatenate(ratios), axis=0) < DECAYED


def _energies(table: NDArray, n: int, hop: int) -> NDArray[np.float64]:
    """Sum of squares about its mean of each segment, shape (segments, channels)."""
    start = np.arange(0, len(table) - n + 1, hop)
    centred = table - table.mean(axis=0)
    sums = [np.concatenate([np.zeros((1, table.shape[1])), np.cumsum(centred**p, axis=0)]) for p in (1, 2)]
    first, second = (s[start + n] - s[start] for s in sums)
    return np.maximum(second - first**2 / n, 0.0)


def _autospectra(
    tables: Sequence[NDArray], dt: float, w: NDArray, hop: int, detrend: str | None
) -> NDArray[np.float64]:
    from .welch import density, transforms

    n, total, count = len(w), np.zeros((len(w) // 2 + 1, tables[0].shape[1])), 0
    for table in tables:
        for X in transforms(table, w, max(1, min(hop, n // 2)), detrend):
            total += np.sum(np.abs(X) ** 2, axis=0)
            count += len(X)
    return total * (density(n) * dt / np.sum(w**2) / count)[:, None]


def _names(channels: Sequence[Channel], index: NDArray) -> str:
    return ", ".join(channels[i].label for i in index[:8])
