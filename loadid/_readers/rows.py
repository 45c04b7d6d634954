"""Rows of numbers of text tables, exact about the place of what is wrong."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence

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
    if fast is not None:
        return fast
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
    exponent, and it has as many. A cut integer is an integer; where all the others have as many digits before the
    point too, and it has not, the decimals may follow from significant digits.
    """
    lengths = {len(cell.strip().lstrip("+-").partition(decimal)[0]) for cell in others}
    if len(lengths) == 1 and len(last.strip().lstrip("+-").partition(decimal)[0]) not in lengths:
        return False
    forms = [decimals_of(cell, decimal) for cell in others if cell.strip() and cell.strip().lower() != "nan"]
    if last.strip().lower() == "nan":
        return True
    return len(forms) >= ALIKE and len(set(forms)) == 1 and any(forms[0]) and decimals_of(last, decimal) == forms[0]


def decimals_of(cell: str, decimal: str) -> tuple[int, int]:
    """Decimals and digits of the exponent of a number; (0, 0) where there are none."""
    match = NUMBER.fullmatch(cell.strip().replace(decimal, "."))
    return (len(match["decimals"] or ""), len(match["exponent"] or "")) if match else (0, 0)
