"""Guards of the dynamics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structures.flags import Evidence, Flag

MEMORY = 0.01  # share of the first response that may be left at the end of a record
MOVING = 0.03  # share of the largest response that may be there at the end of a record on the FFT path


def memory(decay_rate: float | None, duration: float, h: NDArray | None = None) -> Flag | None:
    """W505: the record is shorter than the memory of the structure.

    The share of the response left after the record is exp(-decay_rate * duration) where the model knows its slowest
    decay, else the largest value in the last twentieth of the impulse response over the largest of all.
    """
    if decay_rate is not None:
        left = float(np.exp(-decay_rate * duration))
    elif h is not None and len(h) >= 40:
        level = np.abs(h).reshape(len(h), -1)
        left = float(np.max(level[-(len(h) // 20) :].max(axis=0) / np.maximum(level.max(axis=0), np.finfo(float).tiny)))
    else:
        return None
    if left <= MEMORY:
        return None
    return Flag(
        "W505",
        Evidence("response left after the record", left, MEMORY),
        f"the record is shorter than the memory: {left:.1%} of the response is left at its end, "
        "so start and end are contaminated",
        "record longer, begin before the load, or use a state-space method",
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
