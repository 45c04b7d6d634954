"""Excel workbooks (.xlsx, .xlsm): sheets as records, headings and units as in text tables, dates as time stamps.

What is read are the values that the workbook holds; formulas are never evaluated. A formula whose value was not saved
is an empty cell.
"""

from __future__ import annotations

import datetime as dt
import io
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from structures.errors import InputError

from .csv_table import load as load_text
from .source import COLUMNS, Options, Source, Table, register, since

ROWS = 2**20  # of a sheet, as Excel has them
_FIRST = (b"[Content_Types].xml", b"_rels/", b"xl/", b"docProps/", b"customXml/")


def _is_workbook(head: bytes) -> bool:
    """Whether a ZIP archive begins with a part of an Office document."""
    return head.startswith(b"PK\x03\x04") and head[30:].startswith(_FIRST)


@dataclass(frozen=True)
class Worksheet(Source):
    """A sheet as the text table that it would be saved as, its rows in the same lines."""

    text: str = ""

    def data(self) -> bytes:
        """The text of the sheet."""
        return self.text.encode()


@register("Excel", suffixes=(".xlsx", ".xlsm"), sniff=_is_workbook, library="openpyxl")
def load(source: Source, options: Options) -> list[Table]:
    """Every sheet with rows of numbers as a record."""
    import openpyxl

    with zipfile.ZipFile(source.path) as archive:
        for member in archive.infolist():
            if member.flag_bits & 1:
                source.refuse("the workbook is encrypted", member.filename, "one without a password",
                              "save it without a password")  # fmt: skip
        source.allow(sum(m.file_size for m in archive.infolist()), "the workbook")
        if damaged := archive.testzip():
            source.refuse("the workbook is damaged", damaged, "parts with the checksum that stands in the archive")
    stream = io.BytesIO(source.data())  # a path would have to end in .xlsx
    book = openpyxl.load_workbook(stream, read_only=True, data_only=True)
    tables, passed = [], []
    try:
        for sheet in book.worksheets:
            try:
                tables += _sheet(sheet, source, options)
            except InputError as error:
                if len(book.worksheets) == 1 or error.what not in ("no rows of numbers", "the file is empty"):
                    raise
                passed.append(f"sheet {sheet.title} ({error.what})")
    finally:
        book.close()
    note = (f"passed over: {', '.join(passed[:20])}",) if passed else ()
    return [replace(t, notes=(*t.notes, *note)) for t in tables]


def _sheet(sheet: Any, source: Source, options: Options) -> list[Table]:
    rows = list(_rows(sheet, source))
    width = max((len(r) for r in rows), default=0)
    dates = _dated(rows, width)
    starts = {}
    for column, (first, stamps, dated) in dates.items():
        seconds, begin = since(stamps)
        starts[column] = begin if dated else None
        for row, value in zip(range(first, len(rows)), seconds, strict=True):
            if column < len(rows[row]) and rows[row][column] is not None:
                rows[row][column] = float(value)
    last = max((k for k, row in enumerate(rows) if any(isinstance(c, str) for c in row)), default=-1)
    full = [[*r, *[None] * (width - len(r))] for r in rows]
    text = "".join("\t".join(_text(c, k > last and bool(r)) for c in full[k]) + "\n" for k, r in enumerate(rows))
    shown = Worksheet(source.path, source.size, source.head, text=text)
    try:
        (table,) = load_text(shown, options)
    except InputError as error:
        if error.where == str(source.path):
            error = InputError(error.what, where=f"{source.path}, sheet {sheet.title}", found=error.found,
                               expected=error.expected, hint=error.hint)  # fmt: skip
        raise error from None
    table = replace(table, name=sheet.title)
    if not dates or table.values.shape[1] != width:
        return [table]
    time = next(iter(dates))
    units = tuple("s" if i in dates else u for i, u in enumerate(table.units or (None,) * width))
    begin = starts[time]
    if begin is None:
        return [replace(table, units=units, time=time)]
    return [_stamped(replace(table, units=units), time, begin)]


def _stamped(table: Table, time: int, begin: float) -> Table:
    """The table with a column of dates, in s after `begin`, as stamps, which are settled where a zone can be stated."""
    keep = [i for i in range(table.values.shape[1]) if i != time]
    away = table.values[:, time]
    moments = np.rint(np.where(np.isnan(away), 0.0, away) * 1e6).astype("timedelta64[us]")
    first = np.datetime64(round(begin * 1e6), "us")
    names, units = table.columns, table.units or ()
    return replace(
        table,
        values=table.values[:, keep],
        columns=None if names is None else tuple(names[i] for i in keep),
        units=tuple(units[i] for i in keep),
        start=begin,
        stamps=np.where(np.isnan(away), np.datetime64("NaT", "us"), first + moments),
        clock="time" if names is None else names[time] or "time",
    )


def _rows(sheet: Any, source: Source) -> Iterator[list[Any]]:
    """Rows of a sheet without the empty cells at their ends and the empty rows at its end."""
    waiting = 0
    sheet.reset_dimensions()  # what a writer says of the size is no promise
    for number, row in enumerate(sheet.iter_rows(values_only=True)):
        if number >= ROWS or len(row) > 4 * COLUMNS:
            source.refuse("the sheet is too large", f"{sheet.title}: row {number} of {len(row)} cells",
                          f"{ROWS} rows of {COLUMNS} cells")  # fmt: skip
        cells = list(row)
        while cells and (cells[-1] is None or cells[-1] == ""):
            cells.pop()
        if not cells:
            waiting += 1
            continue
        yield from ([] for _ in range(waiting))
        waiting = 0
        yield cells


def _dated(rows: list[list[Any]], width: int) -> dict[int, tuple[int, Any, bool]]:
    """Columns that hold dates, times or durations to their end: the first row, the stamps, whether they have dates."""
    found = {}
    for column in range(width):
        cells = [row[column] if column < len(row) else None for row in rows]
        kind = next((type(c) for c in reversed(cells) if c is not None), None)
        if kind not in (dt.datetime, dt.date, dt.time, dt.timedelta):
            continue
        first = len(cells)
        while first and (cells[first - 1] is None or isinstance(cells[first - 1], dt.date | dt.time | dt.timedelta)):
            first -= 1
        while first < len(cells) and cells[first] is None:
            first += 1
        stamps = np.array([_stamp(c) for c in cells[first:]], "datetime64[us]")
        found[column] = (first, stamps, kind in (dt.datetime, dt.date))
    return found


def _stamp(cell: Any) -> Any:
    """A date, a time of day or a duration as a moment; the latter two count from 1970."""
    if cell is None:
        return np.datetime64("NaT", "us")
    day = dt.date(1970, 1, 1)
    if isinstance(cell, dt.timedelta):
        return np.datetime64(day, "us") + np.timedelta64(cell)
    if isinstance(cell, dt.time):
        return np.datetime64(dt.datetime.combine(day, cell), "us")
    return np.datetime64(cell, "us")


def _text(cell: Any, number: bool) -> str:
    """A cell as a text table holds it: numbers with all their digits, NaN where among numbers there is none."""
    if cell is None:
        return "nan" if number else ""
    if isinstance(cell, int | float) and not isinstance(cell, bool):
        return repr(cell)
    return " ".join(str(cell).split())
