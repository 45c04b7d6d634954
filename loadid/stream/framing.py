"""From bytes to rows of numbers: whole lines of comma-separated values, with or without time stamps.

A row does not depend on the pieces in which its bytes come. What cannot be read is counted, and the stream goes on.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.channels import ARBITRARY, Channel
from structures.errors import InputError

LARGEST = 1e100  # of a reading: its square must stay a number
HOPELESS = 50  # lines, none of which can be read, after which nothing better is expected
LONGEST = 1 << 16  # bytes of a line; what is longer has lost its end
TIME = ("t", "time", "zeit", "timestamp", "seconds")
MISSING = ("", "nan", "na", "null", "none", "-")


@dataclass(frozen=True)
class Layout:
    """What stands in the columns of a line.

    Parameters
    ----------
    width : int
    time : int or None
        Column of the time stamps.
    columns : tuple of int
        Column of each sensor.
    factors : tuple of float
        From the unit of each column to that of its sensor.
    """

    width: int
    time: int | None
    columns: tuple[int, ...]
    factors: tuple[float, ...]

    def to_tree(self) -> dict[str, Any]:
        """Plain values."""
        return {"width": self.width, "time": self.time, "columns": list(self.columns), "factors": list(self.factors)}

    @classmethod
    def from_tree(cls, tree: dict[str, Any]) -> Layout:
        """Inverse of `to_tree`."""
        return cls(int(tree["width"]), tree["time"], tuple(tree["columns"]), tuple(tree["factors"]))


class Lines:
    """Rows out of bytes.

    Parameters
    ----------
    sensors : sequence of Channel
        Of the tracker, in its order.
    layout : Layout, optional
        As found before; else the first line that is no comment tells it.

    Attributes
    ----------
    rest : bytes
        Begin of a line whose end has not come yet.
    counts : Counter
        ``lines``, and those that were ``wide`` (of another width), ``unreadable``, ``infinite`` or beyond
        1e100 (these channels are missing) and ``endless``.
    """

    def __init__(self, sensors: Sequence[Channel], layout: Layout | None = None) -> None:
        self.sensors, self.layout = tuple(sensors), layout
        self.rest = b""
        self.skipping = False  # inside a line that is too long
        self.before: Layout | None = None  # of the file before
        self.example = b""  # first line that cannot be read
        self.counts: Counter[str] = Counter()

    def push(self, data: bytes) -> tuple[NDArray[np.float64] | None, NDArray[np.float64]]:
        """Time stamps (rows,), or None where there are none, and values (rows, sensors) of all lines that end in data.

        Raises
        ------
        InputError
            A header that lacks a sensor, a first line of a width that fits no layout, lines none of which can be read.
        """
        lines = [line for line in self._whole(data) if line.strip() and not line.lstrip().startswith(b"#")]
        if lines and self.layout is None:
            lines = self._begun(lines)
        if not lines or self.layout is None:
            stamped = self.layout is not None and self.layout.time is not None
            return np.empty(0) if stamped else None, np.empty((0, len(self.sensors)))
        parted = self._parted(self._table(lines))
        self._require_any()
        return parted

    def another(self) -> None:
        """The bytes that follow are those of another file or connection, which may begin with a header."""
        self.rest, self.skipping = b"", False
        self.before, self.layout = self.layout or self.before, None

    def _whole(self, data: bytes) -> list[bytes]:
        """Lines that have ended, but for those that are too long."""
        data = self.rest + data
        if self.skipping:
            _, ended, data = data.partition(b"\n")
            self.skipping = not ended
        whole, ended, self.rest = data.rpartition(b"\n")
        lines = whole.split(b"\n") if ended else []
        kept = [line for line in lines if len(line) <= LONGEST]
        if len(self.rest) > LONGEST:
            self.skipping, self.rest = True, b""
        self.counts["endless"] += len(lines) - len(kept) + (self.skipping and bool(data))
        return kept

    def _require_any(self) -> None:
        c = self.counts
        if c["lines"] >= HOPELESS and c["wide"] + c["unreadable"] >= c["lines"]:
            assert self.layout is not None
            raise InputError("no line of the stream can be read", where="stream", found=printable(self.example),
                             expected=f"{self.layout.width} numbers with a comma, semicolon or tab between them",
                             hint="time stamps are seconds, as 12.345; name the columns in the first line")  # fmt: skip

    # -- the first line ---------------------------------------------------------------------------------------------
    def _begun(self, lines: list[bytes]) -> list[bytes]:
        """Find the layout; the lines that hold numbers."""
        for k, line in enumerate(lines):
            cells = _cells(line)
            numbers = [_number(c) for c in cells]
            if any(n is None for n in numbers):
                self.layout = header(cells, self.sensors)
                return lines[k + 1 :]
            m = len(self.sensors)
            if self.before is not None and self.before.width == len(cells):
                self.layout = self.before
                return lines[k:]
            if len(cells) not in (m, m + 1):
                raise InputError("the first line of the stream does not fit the sensors", where="stream",
                                 found=f"{len(cells)} numbers",
                                 expected=f"{m} ({', '.join(c.label for c in self.sensors[:8])}), or {m + 1} with a "
                                 "time stamp first")  # fmt: skip
            first = len(cells) - m
            self.layout = Layout(len(cells), 0 if first else None, tuple(range(first, first + m)), (1.0,) * m)
            return lines[k:]
        return []

    # -- lines of numbers -------------------------------------------------------------------------------------------
    def _table(self, lines: list[bytes]) -> NDArray[np.float64]:
        """Numbers (lines, width): those of a good block at once, else line by line; a bad line is NaN throughout."""
        assert self.layout is not None
        self.counts["lines"] += len(lines)
        width, mark = self.layout.width, _separator(lines[0])
        if mark != b" " or width == 1:
            data = b"\n".join(lines)
            if mark != b",":
                data = data.replace(b",", b".")  # decimal comma
            try:
                table = np.loadtxt(io.BytesIO(data), delimiter=mark.decode(), comments=None, ndmin=2)
            except ValueError:
                table = np.empty((0, 0))
            if table.shape == (len(lines), width):
                return table
        table = np.full((len(lines), width), np.nan)
        for k, line in enumerate(lines):
            numbers = [_number(c) for c in _cells(line)]
            if len(numbers) != width:
                self.counts["wide"] += 1
            elif any(n is None for n in numbers):
                self.counts["unreadable"] += 1
            else:
                table[k] = numbers
                continue
            self.example = self.example or line
        return table

    def _parted(self, table: NDArray) -> tuple[NDArray | None, NDArray]:
        layout = self.layout
        assert layout is not None
        values = table[:, list(layout.columns)]
        values *= layout.factors
        infinite = np.abs(values) > LARGEST
        if infinite.any():
            self.counts["infinite"] += int(infinite.any(axis=1).sum())
            values[infinite] = np.nan
        if layout.time is None:
            return None, values  # a bad line is a sample without data: it took its place in time
        t = table[:, layout.time]
        good = np.isfinite(t)
        if not good.all():
            bad = np.isnan(table).all(axis=1)
            self.counts["unreadable"] += int(np.sum(~good & ~bad))
            self.example = self.example or b"a line without its time stamp"
        return t[good], values[good]  # one without its stamp is a gap, which the next stamp tells


def header(cells: Sequence[str], sensors: Sequence[Channel]) -> Layout:
    """Layout of a line of names, ``time,a1,d2`` or ``t [s];a1 [g];d2 [mm]``; columns of no sensor are left out.

    Raises
    ------
    InputError
        A sensor that is missing or comes twice, a unit of another quantity.
    """
    named = [re.fullmatch(r"\s*(.*?)\s*(?:\[(.*)\])?\s*", c) for c in cells]
    names = [(n.group(1) if n else c).strip('"') for n, c in zip(named, cells, strict=True)]
    units = [n.group(2) if n else None for n in named]
    lost = [c.label for c in sensors if names.count(c.label) != 1]
    if lost:
        raise InputError("a sensor is not in the header of the stream, or twice", where=f"channel {lost[0]}",
                         found=printable(", ".join(names)), expected=", ".join(c.label for c in sensors),
                         hint="name the columns as the sensors of the model")  # fmt: skip
    columns = tuple(names.index(c.label) for c in sensors)
    times = [k for k, name in enumerate(names) if name.lower() in TIME and k not in columns]
    factors = tuple(_factor(units[k], c) for k, c in zip(columns, sensors, strict=True))
    return Layout(len(cells), times[0] if times else None, columns, factors)


def _factor(unit: str | None, sensor: Channel) -> float:
    if unit is None or ARBITRARY in (unit, sensor.unit) or unit == sensor.unit:
        return 1.0
    from structures import units

    found = units.parse(unit, channel=sensor.label, where="header of the stream")
    if found.si != units.parse(sensor.unit).si:
        raise InputError("a column is in the unit of another quantity", where=f"channel {sensor.label}", found=unit,
                         expected=sensor.unit)  # fmt: skip
    return float(found.factor)


def printable(text: str | bytes, most: int = 200) -> str:
    """Text of a stranger that does a terminal no harm."""
    words = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    words = "".join(c if c.isprintable() else "?" for c in words[: most + 1])
    return words if len(words) <= most else words[:most] + " ..."


def _separator(line: bytes) -> bytes:
    """What stands between numbers; where it is no comma, a comma is a decimal one."""
    return next((mark for mark in (b";", b"\t", b",") if mark in line), b" ")


def _cells(line: bytes) -> list[str]:
    text, mark = line.decode("utf-8-sig", "replace").strip(), _separator(line).decode()
    if mark == " ":
        return text.split()
    if '"' in text:
        with suppress(csv.Error, StopIteration):
            return [c.strip() for c in next(csv.reader([text], delimiter=mark, skipinitialspace=True))]
    return [c.strip() for c in text.split(mark)]


def _number(cell: str) -> float | None:
    """A number, NaN where a sample is missing, None for other text."""
    if cell.lower() in MISSING:
        return float("nan")
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return None
