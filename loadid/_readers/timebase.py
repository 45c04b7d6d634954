"""The step of a column of time stamps, and the place of every sample on the even grid that they mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, either
from structures.errors import InputError

from .source import Source

JITTER = 0.01  # deviation from the grid, in steps, that is still uniform
LONE = 0.05  # share of stamps that may be damaged where all others keep one grid
MISSING = 0.25  # share of dropped samples on the full grid beyond which a column is no time column


class UnevenStampsError(InputError):
    """Stamps that rise and are on no even grid: samples between them can be interpolated."""


@dataclass(frozen=True)
class Base:
    """Step in s, the place of every sample on the grid, how many are missing and after which sample first."""

    dt: float
    place: NDArray[np.int64]
    missing: int = 0
    first: int = 0


def timebase(t: NDArray[np.float64], source: Source, rounding: float = 0.0, stated: float | None = None) -> Base:
    """Step of a column of time stamps in s.

    Stamps that were rounded on writing still give the step that the instrument had: of the steps that fit all stamps,
    the one whose frequency is a whole number is taken, else the one with the fewest digits. Whole samples that are
    missing are kept as gaps; anything else that is not uniform is refused. `rounding` is what the numbers lost before
    they came here; a step that the file states beside them is taken where it fits them.

    Raises
    ------
    InputError
        NaN, stamps that do not rise; `UnevenStampsError` where the step is not constant or too many samples lack.
    """
    require_rising(t, source)
    n, steps = len(t), np.diff(t)
    rounding = max(_resolution(t), rounding)
    typical = float(np.median(steps))
    if rounding > 0.2 * typical:  # steps of 0.000, 0.001, 0.001: only the whole column tells the step
        typical = float(t[-1] - t[0]) / (n - 1)
    slack = max(JITTER * typical, 1.01 * rounding, 8 * np.finfo(float).eps * float(np.abs(t).max()))
    dt, place = _grid(t, _single(steps, typical), slack)
    wrong = np.abs(t - t[0] - place * dt - np.median(t - t[0] - place * dt)) > slack
    if wrong.any() or np.diff(place).min() < 1:
        i = int(np.argmax(np.abs(steps - typical)))
        _refuse_damaged(t, place, typical, slack, source)
        source.refuse("time is not uniform", f"step {steps[i]:.6g} s after sample {i}, {typical:.6g} s elsewhere",
                      "a constant step", _resample(typical), UnevenStampsError)  # fmt: skip
    missing = int(place[-1]) + 1 - n
    if missing > MISSING * (n + missing):
        source.refuse("too many samples are missing", f"{missing} missing, {n} there", f"at most {MISSING:.0%}",
                      "cut the record at the gap", UnevenStampsError)  # fmt: skip
    first = int(np.argmax(np.diff(place) > 1)) if missing else 0
    away, count = slack_of(t, dt, place), float(place[-1])
    fits = stated is not None and abs(stated - dt) <= max(_within(dt, count, away), 2.0 * rounding / count)
    return Base(stated if fits and stated else _snap(dt, count, away), place, missing, first)


def _refuse_damaged(
    t: NDArray[np.float64], place: NDArray[np.int64], step: float, slack: float, source: Source
) -> None:
    """Nothing, unless all stamps but a few keep one grid: these are damaged, and no reason to resample the others."""
    away = t - place * step
    wrong = np.abs(away - np.median(away)) > slack
    if 0 < wrong.sum() <= max(1, LONE * len(t)):
        k = int(np.argmax(wrong))
        source.refuse("a few stamps lie off the grid of all others",
                      f"{int(wrong.sum())} of {len(t)}, the first that of sample {k}, {t[k]:.9g} s",
                      f"time is not uniform there: a step of {step:.6g} s",
                      "they are damaged: correct them, or leave the time column out and state --fs HZ")  # fmt: skip


def _resample(step: float) -> Advice:
    """What to do with stamps at uneven steps."""
    rate = f"{_ceiling(1 / step):g}"
    return Advice(f"state a rate of {rate} Hz or more to resample to: ", either(f"fs={rate}", f"--fs {rate}"),
                  "; where the samples are even and only their stamps are not, leave the time column out")  # fmt: skip


def _ceiling(rate: float) -> float:
    """The next larger number of two digits."""
    unit = 10.0 ** (np.floor(np.log10(rate)) - 1)
    return float(np.ceil(rate / unit - 1e-9) * unit)


def require_rising(t: NDArray[np.float64], source: Source) -> None:
    """Nothing, if times are finite and rise.

    Raises
    ------
    InputError
    """
    n = len(t)
    if n < 2 or not np.all(np.isfinite(t)):
        bad = "one stamp" if n < 2 else f"{int((~np.isfinite(t)).sum())} stamps that are no numbers"
        source.refuse("the time column gives no step", bad, "finite, rising stamps",
                      "repair the time column, or leave it out and state --fs HZ")  # fmt: skip
    steps = np.diff(t)
    if not steps.min() > 0:
        i = int(np.argmin(steps))
        source.refuse("time does not rise", f"{t[i]:.9g} s, then {t[i + 1]:.9g} s after sample {i}", "rising stamps",
                      "sort or repair the time column, or leave it out and state --fs HZ")  # fmt: skip


def fill(values: NDArray[Any], base: Base) -> NDArray[np.float64]:
    """Samples on the full grid, NaN where one is missing."""
    if not base.missing:
        return np.asarray(values, dtype=float)
    full = np.full((int(base.place[-1]) + 1, values.shape[1]), np.nan)
    full[base.place] = values
    return full


def slack_of(t: NDArray[np.float64], dt: float, place: NDArray[np.int64]) -> float:
    """Largest distance of a stamp from its grid, with the rounding of the numbers themselves."""
    away = t - t[0] - place * dt
    return float(np.ptp(away)) + 4 * float(np.spacing(np.abs(t).max()))


def _single(steps: NDArray[np.float64], typical: float) -> float:
    """Mean of the steps without a gap: the median or the mean of all is off by rounding or by the gaps themselves."""
    for _ in range(4):
        alone = steps[np.rint(steps / typical) == 1]
        if not len(alone) or typical == alone.mean():
            break
        typical = float(alone.mean())
    return typical


def _grid(t: NDArray[np.float64], typical: float, slack: float) -> tuple[float, NDArray[np.int64]]:
    """Step and place of every stamp; the steps are counted one by one so that an error of the step does not add up."""
    counts = np.maximum(np.rint(np.diff(t) / typical), 1.0)
    if counts.max() > 1e6 * len(t):
        counts = np.minimum(counts, 1e6)
    place = np.concatenate(([0.0], np.cumsum(counts))).astype(np.int64)
    dt = float(t[-1] - t[0]) / float(place[-1])
    return dt, place


def _within(dt: float, count: float, away: float) -> float:
    """How far the step may be from the one that the stamps were written with."""
    return min(2.0 * away / count, 0.005 * dt)


def _snap(dt: float, count: float, away: float) -> float:
    """The simplest step that fits the stamps: a whole frequency, else few digits."""
    within = _within(dt, count, away)
    whole = round(1.0 / dt)
    if whole >= 1 and abs(1.0 / whole - dt) <= within:
        return 1.0 / whole
    for digits in range(1, 12):
        simple = float(f"{dt:.{digits - 1}e}")
        if abs(simple - dt) <= within:
            return simple
    return dt


def _resolution(t: NDArray[np.float64]) -> float:
    """Decimal place to which stamps were rounded, in s; 0 when they were not."""
    part = t[:: max(1, len(t) // 2000)]
    eps = 4 * np.finfo(float).eps * float(np.abs(part).max())
    for digits in range(13):
        place = 10.0**-digits
        if eps > 0.1 * place:
            break
        if np.all(np.abs(part - np.round(part, digits)) <= eps):
            return place
    return 0.0
