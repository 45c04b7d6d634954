"""The loads that a layout is judged for: a stated amplitude, or a signal-to-noise ratio."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import plain

from .candidates import Candidates

SNR = 100.0


@dataclass(frozen=True)
class Expected:
    """Std of each load before any reading, (loads,), and where it comes from, in words."""

    amplitude: NDArray[np.float64]
    words: str


def expected(sets: Sequence[Candidates], amplitude: ArrayLike | None, snr: float | None, where: str) -> Expected:
    """Amplitude of the loads: as stated, or such that the sensor that sees a load of each unit best reads it at `snr`.

    Raises
    ------
    InputError
        Both given, one that is not positive or does not fit, an amplitude without a noise level, no sensor that moves.
    """
    one = sets[0]
    n = one.H.shape[1]
    rows = np.vstack([np.abs(c.H) / c.std[:, None] for c in sets])
    if not np.any(rows):
        raise InputError(
            "no load moves any sensor", where=where, found="a transfer matrix of zeros", expected="some response",
            hint="accelerometers and AC-coupled sensors see no static load",
        )  # fmt: skip
    if amplitude is not None:
        if snr is not None or any(c.noise is None for c in sets):
            raise InputError(
                "an amplitude is judged against a noise level" if snr is None else "amplitude and snr say the same",
                where=where, found="no noise" if snr is None else "both", expected="amplitude= with noise=, or snr=",
                hint="give noise= (std per sensor), or state snr= alone",
            )  # fmt: skip
        try:
            level = np.broadcast_to(np.asarray(plain(amplitude), float), (n,))
        except (TypeError, ValueError):
            level = np.zeros(1)
        if not np.all(np.isfinite(level)) or np.any(level <= 0):
            raise InputError(
                "no amplitude", where=where, found=repr(amplitude)[:60], expected=f"positive, one number or ({n},)",
                hint="the std of the load that is expected, SI",
            )  # fmt: skip
        return Expected(np.array(level), "loads of the stated amplitude")
    ratio = SNR if snr is None else snr
    if (
        isinstance(ratio, bool)
        or not isinstance(ratio, int | float | np.number)
        or not np.isfinite(ratio)
        or ratio <= 0
    ):
        raise InputError(
            "no signal-to-noise ratio", where=where, found=repr(snr), expected="a positive number", hint="snr=100"
        )
    level = np.ones(n)
    for unit in set(one.load_units):
        group = np.array([u == unit for u in one.load_units])
        top = rows[:, group].max()
        level[group] = ratio / top if top > 0 else 1.0
    same = "" if all(c.noise is not None for c in sets) else "; noise not stated: equal for all sensors"
    return Expected(level, f"loads that the best-placed sensor reads at {ratio:g} times its noise{same}")
