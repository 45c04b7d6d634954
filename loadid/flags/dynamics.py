"""Guards of the dynamics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from structures.advice import Advice, Option
from structures.flags import Evidence, Flag

from ..inverse.start import Start

MEMORY = 0.01  # share of the first response that may be left at the end of a record
FEW = 3.0  # periods of the lowest mode below which a record is called short
UNSEEN = 1e-8  # static over dynamic gain that is rounding
PRESENT = 0.05  # share of the largest response from which the first sample is no rest
UNREST = 5.0  # times the misfit that chance removes per free motion
VISIBLE = 0.02  # share of the largest response from which a motion matters
MOVING = 0.03  # share of the largest response that may be there at the end of a record on the FFT path


def memory(
    decay_rate: float | None, duration: float, h: NDArray | None = None, frequencies: NDArray | None = None
) -> Flag | None:
    """W505: the record is shorter than the memory of the structure, as with light damping.

    The share of the response left after the record is exp(-decay_rate * duration) where the model knows its slowest
    decay, else the largest value in the last twentieth of the impulse response over the largest of all. The natural
    frequencies (Hz) tell how many periods of the lowest one the record holds.
    """
    if decay_rate is not None:
        left = float(np.exp(-decay_rate * duration))
    elif h is not None and len(h) >= 8:
        level = np.abs(h).reshape(len(h), -1)
        end = level[-max(len(h) // 20, 2) :].max(axis=0)
        left = float(np.max(end / np.maximum(level.max(axis=0), np.finfo(float).tiny)))
    else:
        return None
    if left <= MEMORY:
        return None
    return Flag(
        "W505",
        Evidence("response left after the record", left, MEMORY),
        f"the record is shorter than the memory: {left:.1%} of the response is left at its end, "
        f"so start and end are contaminated{_periods(frequencies, duration)}",
        f"record longer{_enough(decay_rate, duration)}, begin before the load, or take the start as unknown "
        '(initial="unknown", state-space models)',
    )


def _periods(frequencies: NDArray | None, duration: float) -> str:
    """How many periods of the lowest mode a record holds, where they are few."""
    moving = np.asarray([] if frequencies is None else frequencies, float)
    moving = moving[moving > 0]
    if not len(moving) or moving.min() * duration >= FEW:
        return ""
    return f"; it holds {moving.min() * duration:.2g} periods of the lowest mode ({moving.min():.4g} Hz)"


def _enough(decay_rate: float | None, duration: float) -> str:
    """How long a record must be until the response is gone."""
    if decay_rate is None:
        return ""
    if decay_rate <= 0:
        return " (an undamped motion never ends: state the damping of the model)"
    return f" ({-np.log(MEMORY) / decay_rate:.3g} s instead of {duration:.3g} s)"


def drifting(share: NDArray, loads: Sequence[str], sensors: Sequence[str], penalty: str) -> Flag | None:
    """W517: no sensor sees a constant load, and the penalty leaves it free.

    Parameters
    ----------
    share : array, shape (loads,)
        Static gain over the dynamic one of each load, for the sensor where that is most.
    penalty : str
        Name of a difference: its null space holds the constants.
    """
    blind = np.flatnonzero(np.asarray(share) < UNSEEN)
    if not len(blind):
        return None
    names = ", ".join(loads[j] for j in blind[:8]) + (", ..." if len(blind) > 8 else "")
    return Flag(
        "W517",
        Evidence("static gain over dynamic gain", float(np.max(np.asarray(share)[blind])), UNSEEN),
        f"no sensor ({', '.join(sensors[:8])}{', ...' if len(sensors) > 8 else ''}) sees a constant part of {names}, "
        f"and the {penalty} leaves it free: the mean drifts, and its std grows with the length of the record",
        Advice(
            Option("penalty", "identity"),
            " or a leaky difference holds the load near zero; a displacement or strain sensor that sees "
            "0 Hz determines it",
        ),
    )


def in_motion(found: Start | None) -> Flag | None:
    """W518: the record does not start at rest, or the load is there before it: also what a wrong index offset shows."""
    if found is None or found.first < PRESENT or found.share < VISIBLE or found.gain < UNREST * found.motions:
        return None
    return Flag(
        "W518",
        Evidence("misfit of the start that motion before it removes, per motion", found.gain / found.motions, UNREST),
        f"the record starts in motion: its first sample holds {found.first:.0%} of the largest response, and loads "
        "within the record do not explain it; a model at rest puts this into the load",
        'initial="unknown" (state-space models), or a record that begins before the load; where the structure was at '
        "rest, the index offset or the alignment of the channels is wrong",
    )


def unfinished(values: NDArray, residual: NDArray) -> Flag | None:
    """W505 for padded transforms: the record ends while the structure still moves, whatever moves it.

    Judged by the last fiftieth of each channel (samples, sensors) against its maximum and against its residual.
    """
    end = np.sqrt(np.mean(values[-max(len(values) // 50, 8) :] ** 2, axis=0))
    largest, noise = np.abs(values).max(axis=0), np.sqrt(np.mean(residual**2, axis=0))
    share = np.where(end > 3 * noise, end / np.maximum(largest, np.finfo(float).tiny), 0.0)
    if share.max() <= MOVING:
        return None
    return Flag(
        "W505",
        Evidence("motion at the end over the largest", float(share.max()), MOVING),
        f"the record ends in motion: {share.max():.1%} of the largest response is there at its end, which the padded "
        "transform takes for a jump to zero",
        "record until the structure rests, or cut the record into windows that the dense path takes",
    )


def aliased(frequencies: NDArray | None, dt: float) -> Flag | None:
    """W509: modes of the model above the Nyquist frequency of the record."""
    if frequencies is None:
        return None
    count, nyquist = int(np.sum(np.asarray(frequencies) > 0.5 / dt)), 0.5 / dt
    if count == 0:
        return None
    return Flag(
        "W509",
        Evidence("highest natural frequency, Hz", float(np.max(frequencies)), nyquist),
        f"{count} modes lie above the Nyquist frequency {nyquist:.4g} Hz and are aliased in the sampled response",
        "keep fewer modes (the static residual stands for the rest), or sample faster",
    )
