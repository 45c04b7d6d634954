"""Rows of numbers from lines of text, exact about the place of what is wrong; and the step of a time column."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .source import Source

NUMBER = re.compile(
    r"[+-]?(?=\.?\d)\d*\.?(?P<decimals>(?<=\.)\d*)?(?:[eEdD][+-]?(?P<exponent>\d{1,3}))?|[+-]?(?:nan|inf|infinity)",
    re.ASCII | re.IGNORECASE,
)
ALIKE = 2  # numbers of one form that a column must show before a last one is compared with them


def rows_of(
    body: list[tuple[int, str]],
    separator: str | None,
    decimal: str,
    columns: NDArray[np.int64],
    width: int,
    source: Source,
) -> NDArray[np.float64]:
    """Numbers of some columns, shape (rows, len(columns)); an empty cell is NaN.

    Parameters
    ----------
    body : list of (line number, line)
    separator : str or None
        None is any white space.
    decimal : str
        ``"."`` or ``","``.
    columns : array of int
        Columns to read.
    width : int
        Cells that every line must have at least.

    Raises
    ------
    InputError
        Names the line and the cell.
    """
    if not body:
        return np.empty((0, len(columns)))
    fast = _fast([line for _, line in body], separator, decimal, columns)
    return fast if fast is not None else _slow(body, separator, decimal, columns, width, source)


def _fast(
    lines: list[str], separator: str | None, decimal: str, columns: NDArray[np.int64]
) -> NDArray[np.float64] | None:
    text = "\n".join(lines)
    if '"' in text or "\n\n" in text or "inf" in text.lower():
        return None
    if decimal == ",":
        if "." in text:
            return None
        text = text.replace(",", ".")
    try:
        table = np.loadtxt(io.StringIO(text), float, None, separator, usecols=columns.tolist(), ndmin=2)
    except (ValueError, IndexError, OverflowError):
        return None
    return table if table.shape == (len(lines), len(columns)) else None


def _slow(
    body: list[tuple[int, str]],
    separator: str | None,
    decimal: str,
    columns: NDArray[np.int64],
    width: int,
    source: Source,
) -> NDArray[np.float64]:
    table = np.empty((len(body), len(columns)))
    for row, (number, line) in enumerate(body):
        cells = split(line, separator)
        if len(cells) < width:
            source.refuse("a line is too short", f"line {number}: {len(cells)} cells", f"{width} cells",
                          "correct or delete that line")  # fmt: skip
        for k, column in enumerate(columns):
            value = number_of(cells[column], decimal)
            if value is None:
                source.refuse("a cell is no number", f"line {number}, column {int(column) + 1}: {cells[column][:40]!r}",
                              f"a number with the decimal sign '{decimal}'",
                              "correct that cell, or leave it empty where nothing was recorded")  # fmt: skip
            table[row, k] = value
    return table


def split(line: str, separator: str | None) -> list[str]:
    """Cells of a line, without quotes."""
    if separator is None:
        return line.split()
    if '"' in line:
        import csv

        return [c.strip() for c in next(csv.reader([line], delimiter=separator))]
    return [c.strip() for c in line.split(separator)]


def number_of(cell: str, decimal: str) -> float | None:
    """Number of a cell, NaN when it is empty, None when it is no number."""
    text = cell.strip()
    if not text:
        return float("nan")
    if decimal == ",":
        if "." in text:
            return None
        text = text.replace(",", ".")
    if not NUMBER.fullmatch(text):
        return None
    return float(text.replace("d", "e").replace("D", "e") if "n" not in text.lower() else text)


def whole(last: str, others: Sequence[str], decimal: str = ".") -> bool:
    """Whether the very last number of a text without a final line end has lost none of its digits.

    That can be told where the other numbers of its column were written with so many decimals, or digits of an
    exponent, and it has as many. A cut integer is an integer.
    """
    forms = [_form(cell, decimal) for cell in others if cell.strip() and cell.strip().lower() != "nan"]
    if last.strip().lower() == "nan":
        return True
    return len(forms) >= ALIKE and len(set(forms)) == 1 and any(forms[0]) and _form(last, decimal) == forms[0]


def _form(cell: str, decimal: str) -> tuple[int, int]:
    """Decimals and digits of the exponent of a number; (0, 0) where there are none."""
    match = NUMBER.fullmatch(cell.strip().replace(decimal, "."))
    return (len(match["decimals"] or ""), len(match["exponent"] or "")) if match else (0, 0)


JITTER = 0.01  # deviation from the grid, in steps, that is still uniform
MISSING = 0.25  # share of dropped samples on the full grid beyond which a column is no time column


@dataclass(frozen=True)
class Base:
    """Step in s, the place of every sample on the grid, how many are missing and after which sample first."""

    dt: float
    place: NDArray[np.int64]
    missing: int = 0
    first: int = 0


def timebase(t: NDArray[np.float64], source: Source) -> Base:
    """Step of a column of time stamps in s.

    Stamps that were rounded on writing still give the step that the instrument had: of the steps that fit all stamps,
    the one whose frequency is a whole number is taken, else the one with the fewest digits. Whole samples that are
    missing are kept as gaps; anything else that is not uniform is refused.

    Raises
    ------
    InputError
        NaN, stamps that do not rise, a step that is not constant.
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
    rounding = _resolution(t)
    typical = float(np.median(steps))
    if rounding > 0.2 * typical:  # steps of 0.000, 0.001, 0.001: only the whole column tells the step
        typical = float(t[-1] - t[0]) / (n - 1)
    slack = max(JITTER * typical, 1.01 * rounding, 8 * np.finfo(float).eps * float(np.abs(t).max()))
    dt, place = _grid(t, _single(steps, typical), slack)
    wrong = np.abs(t - t[0] - place * dt - np.median(t - t[0] - place * dt)) > slack
    if wrong.any() or np.diff(place).min() < 1:
        i = int(np.argmax(np.abs(steps - typical)))
        source.refuse("time is not uniform", f"step {steps[i]:.6g} s after sample {i}, {typical:.6g} s elsewhere",
                      "a constant step", "resample the record, or state --fs HZ without a time column")  # fmt: skip
    missing = int(place[-1]) + 1 - n
    if missing > MISSING * (n + missing):
        source.refuse("too many samples are missing", f"{missing} missing, {n} there", f"at most {MISSING:.0%}",
                      "cut the record at the gap")  # fmt: skip
    first = int(np.argmax(np.diff(place) > 1)) if missing else 0
    return Base(_snap(dt, float(place[-1]), slack_of(t, dt, place), n), place, missing, first)


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


def _snap(dt: float, count: float, away: float, samples: int) -> float:
    """The simplest step that fits the stamps: a whole frequency, else few digits."""
    within = min(2.0 * away / count, 0.005 * dt)
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
