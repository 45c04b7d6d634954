"""From bytes to rows of numbers: whole lines of comma-separated values, with or without time stamps.

A row does not depend on the pieces in which its bytes come. What cannot be read is counted, and the stream goes on. A
line of names may come again at any time: what follows is read by it, or the stream ends there.
"""

from __future__ import annotations

import csv
import io
import logging
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
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
TICK = ""  # the unit of the time stamps, among those of sensors
NUMBER = re.compile(r"[-+]?[\d.]*(?:[eE][-+]?\d*)?")
TITLE = re.compile(r"\s*(.*?)\s*(?:\[(.*)\]|\((.*)\))?\s*", re.DOTALL)
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ColumnLayout:
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
    tick : float
        Unit of the time stamps, in s.
    """

    width: int
    time: int | None
    columns: tuple[int, ...]
    factors: tuple[float, ...]
    tick: float = 1.0

    def to_tree(self) -> dict[str, Any]:
        """Plain values."""
        return {"width": self.width, "time": self.time, "columns": list(self.columns), "factors": list(self.factors),
                "tick": self.tick}  # fmt: skip

    @classmethod
    def from_tree(cls, tree: dict[str, Any]) -> ColumnLayout:
        """Inverse of `to_tree`."""
        columns, factors = tuple(tree["columns"]), tuple(tree["factors"])
        return cls(int(tree["width"]), tree["time"], columns, factors, float(tree.get("tick", 1.0)))


class Lines:
    """Rows out of bytes.

    Parameters
    ----------
    sensors : sequence of Channel
        Of the tracker, in its order.
    layout : ColumnLayout, optional
        As found before; else the first line that is no comment tells it.
    units : mapping of str to str, optional
        Units of columns, by the names of their sensors; they override those of a header.

    Attributes
    ----------
    rest : bytes
        Begin of a line whose end has not come yet; what follows a header that was refused.
    heading : list of str or None
        Cells of a header, until the next line has come: that may hold its units.
    headings : list of int
        Rows of the last `push` before which a header came again.
    refused : InputError or None
        A header behind the rows of the last `push`, which the next one raises.
    counts : Counter
        ``lines``, ``headers`` that came again, and lines that were ``wide`` (of another width), ``unreadable``,
        ``infinite`` or beyond 1e100 (these channels are missing) and ``endless``.

    Raises
    ------
    InputError
        A unit of no sensor, of another quantity, or another one than that of `layout`.
    """

    def __init__(
        self, sensors: Sequence[Channel], layout: ColumnLayout | None = None, units: Mapping[str, str] | None = None
    ) -> None:
        self.sensors, self.layout, self.units = tuple(sensors), layout, dict(units or {})
        self._labels = {c.label for c in self.sensors}
        self.rest = b""
        self.skipping = False  # inside a line that is too long
        self.before: ColumnLayout | None = None  # of the header or the file before
        self.heading: list[str] | None = None
        self.headings: list[int] = []
        self.refused: InputError | None = None
        self.example = b""  # first line that cannot be read
        self.counts: Counter[str] = Counter()
        self._stated = _stated(self.units, self.sensors)
        if layout is not None:
            self._require_stated(layout)

    def push(self, data: bytes) -> tuple[NDArray[np.float64] | None, NDArray[np.float64]]:
        """Time stamps (rows,), or None where there are none, and values (rows, sensors) of all lines that end in data.

        Raises
        ------
        InputError
            A header that lacks a sensor or a unit, a first line of a width that fits no layout, lines none of which
            can be read. Rows before such a header are handed over first: the next call raises.
        """
        if self.refused is not None:
            raise self.refused
        whole = self._whole(data)
        lines = [text for line in whole if (text := self._content(line))]
        self.headings, parts, left = [], [], len(lines)
        try:
            while left:
                todo = lines[len(lines) - left :]
                if self.layout is None:
                    left = len(self._begun(todo))
                    continue
                table = self._table(todo)
                left -= len(table)
                parts.append(self._parted(table))
                if len(table) < len(todo):
                    self._headed(todo[len(table)])
                    self.headings.append(sum(len(values) for _, values in parts))
                    left -= 1
        except InputError as error:
            first = [k for k, line in enumerate(whole) if self._content(line)][len(lines) - left]
            self.rest = b"".join(line + b"\n" for line in whole[first:]) + self.rest
            self.refused = error
            if not parts:
                raise
        if parts:
            self._require_any()
        return self._joined(parts)

    def another(self) -> None:
        """The bytes that follow are those of another file or connection, which may begin with a header."""
        self.rest, self.skipping, self.heading = b"", False, None
        self.before, self.layout = self.layout or self.before, None

    def _joined(self, parts: list[tuple[NDArray | None, NDArray]]) -> tuple[NDArray | None, NDArray]:
        layout = self.layout or self.before
        stamped = layout is not None and layout.time is not None
        stamps = [t for t, _ in parts if t is not None]
        values = np.concatenate([v for _, v in parts]) if parts else np.empty((0, len(self.sensors)))
        return (np.concatenate(stamps) if stamps else np.empty(0)) if stamped else None, values

    def _whole(self, data: bytes) -> list[bytes]:
        """Lines that have ended."""
        data = self.rest + data
        if self.skipping:
            _, ended, data = data.partition(b"\n")
            self.skipping = not ended
        whole, ended, self.rest = data.rpartition(b"\n")
        lines = whole.split(b"\n") if ended else []
        if len(self.rest) > LONGEST:
            self.skipping, self.rest = True, b""
        self.counts["endless"] += sum(len(line) > LONGEST for line in lines) + (self.skipping and bool(data))
        return lines

    def _content(self, line: bytes) -> bytes:
        """The line; nothing of one that is blank, too long, or a comment, unless that names all sensors and no more."""
        bare = line.lstrip()
        if not bare or len(line) > LONGEST:
            return b""
        if not bare.startswith(b"#"):
            return line
        titles = [_titled(cell, self._labels) for cell in _cells(bare.lstrip(b"# "))]
        named = all(self._is_name(name) or _known(unit) for name, unit in titles)
        return bare.lstrip(b"# ") if named and self._labels <= {name for name, _ in titles} else b""

    def _require_any(self) -> None:
        c = self.counts
        if c["lines"] >= HOPELESS and c["wide"] + c["unreadable"] >= c["lines"]:
            layout = self.layout or self.before
            assert layout is not None
            raise InputError("no line of the stream can be read", where="stream", found=printable(self.example),
                             expected=f"{layout.width} numbers with a comma, semicolon or tab between them",
                             hint="time stamps are seconds, as 12.345; name the columns in the first line")  # fmt: skip

    # -- lines of names ---------------------------------------------------------------------------------------------
    def _begun(self, lines: list[bytes]) -> list[bytes]:
        """Find the layout; the lines that hold numbers."""
        if self.heading is None:
            cells = _cells(lines[0])
            if any(_number(c) is None for c in cells):
                self._headed(lines[0])
                lines = lines[1:]
            else:
                self._settle(self._bare(len(cells)))
        if self.heading is not None and lines:
            cells = _cells(lines[0])
            below = _units_row(cells, self.heading)
            self._settle(header(self.heading, self.sensors, self.units, cells if below else None))
            return lines[below:]
        return lines

    def _headed(self, line: bytes) -> None:
        """A line of names, which is kept until the next line has come; in mid-stream one that came again."""
        cells = _cells(line)
        if self.layout is not None:
            cells = self._apart(cells)
        _columns(cells, self.sensors)
        self.counts["headers"] += self.layout is not None
        self.before, self.layout = self.layout or self.before, None
        self.heading = cells

    def _settle(self, layout: ColumnLayout) -> None:
        before = self.before
        if before is not None and (before.time is None) != (layout.time is None):
            lost = layout.time is None
            raise InputError("the column of time is lost" if lost else "a column of time has come in mid-stream",
                             where="header of the stream", expected="time stamps as before",
                             hint=(f"name the column {TIME[0]} or {TIME[1]}, or " if lost else "")
                             + "begin with a new --state and a new --out")  # fmt: skip
        if before is not None and layout != before:
            log.warning("the columns of the stream or their units are others now: it is read by the new header")
        self.layout, self.heading = layout, None

    def _bare(self, width: int) -> ColumnLayout:
        """ColumnLayout of a stream without names."""
        if self.before is not None and self.before.width == width:
            self._require_stated(self.before)
            return self.before
        m = len(self.sensors)
        if width not in (m, m + 1):
            raise InputError("the first line of the stream does not fit the sensors", where="stream",
                             found=f"{width} numbers",
                             expected=f"{m} ({', '.join(c.label for c in self.sensors[:8])}), or {m + 1} with a "
                             "time stamp first")  # fmt: skip
        first = width - m
        factors = tuple(self._stated.get(c.label, 1.0) for c in self.sensors)
        return ColumnLayout(
            width, 0 if first else None, tuple(range(first, width)), factors, self._stated.get(TICK, 1.0)
        )

    def _require_stated(self, layout: ColumnLayout) -> None:
        """Units that were stated now are those by which a stream is gone on with."""
        factors = dict(zip((c.label for c in self.sensors), layout.factors, strict=True)) | {TICK: layout.tick}
        wrong = [name or TIME[1] for name, factor in self._stated.items() if factor != factors[name]]
        if wrong:
            raise InputError("the stream was begun with other units", where="--unit", found=", ".join(wrong),
                             hint="leave --unit out, or begin with a new --state and a new --out")  # fmt: skip

    def _is_number(self, cell: str) -> bool:
        return cell not in self._labels and (number := _number(cell)) is not None and number == number

    def _is_name(self, cell: str) -> bool:
        name = _titled(cell, self._labels)[0]
        return name in self._labels or name.lower() in TIME

    def _is_heading(self, line: bytes) -> bool:
        """Whether a line among numbers names columns: of words one of which is known, or with the name of a sensor."""
        cells = _cells(line)
        words = [c for c in cells if _number(c) is None]
        if any(_titled(c, self._labels)[0] in self._labels for c in words):
            return True
        return not any(map(self._is_number, cells)) and any(self._is_name(c) or _known(_titled(c)[1]) for c in words)

    def _apart(self, cells: list[str]) -> list[str]:
        """Names without the row before them, where that was broken off: ``0.5,1.2time,a,d``.

        Raises
        ------
        InputError
            They cannot be told from it.
        """
        first = next(k for k, c in enumerate(cells) if _number(c) is None)
        cell, after = cells[first], cells[first + 1 :]
        broken, mixed = any(map(self._is_number, cells[:first])), any(map(self._is_number, after))
        number = NUMBER.match(cell)
        assert number is not None
        begin = next((k for k in range(number.end() + 1) if self._is_name(cell[k:])), None)
        if not mixed and begin is not None and (broken or begin):
            self.counts["unreadable"] += 1
            return [cell[begin:], *after]
        if not broken and not mixed:
            return cells
        raise InputError("names and numbers in one line of the stream", where="header of the stream",
                         found=printable(", ".join(cells)), expected="names in a line of their own",
                         hint="end the line before the header, or begin a new file")  # fmt: skip

    # -- lines of numbers -------------------------------------------------------------------------------------------
    def _table(self, lines: list[bytes]) -> NDArray[np.float64]:
        """Numbers (lines, width) up to the next header; a bad line is NaN throughout."""
        table = self._block(lines)
        if table is None:
            named = next((k for k, line in enumerate(lines) if self._is_heading(line)), len(lines))
            table = self._each(lines[:named])
        self.counts["lines"] += len(table)
        return table

    def _block(self, lines: list[bytes]) -> NDArray[np.float64] | None:
        assert self.layout is not None
        width, mark = self.layout.width, _separator(lines[0])
        if mark == b" " and width > 1:
            return None
        data = b"\n".join(lines)
        if mark != b",":
            data = data.replace(b",", b".")  # decimal comma
        try:
            table = np.loadtxt(io.BytesIO(data), delimiter=mark.decode(), comments=None, ndmin=2)
        except ValueError:
            return None
        return table if table.shape == (len(lines), width) else None

    def _each(self, lines: list[bytes]) -> NDArray[np.float64]:
        assert self.layout is not None
        table = np.full((len(lines), self.layout.width), np.nan)
        for k, line in enumerate(lines):
            numbers = [_number(c) for c in _cells(line)]
            if len(numbers) != self.layout.width:
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
        t = table[:, layout.time] * layout.tick
        good = np.isfinite(t)
        if not good.all():
            bad = np.isnan(table).all(axis=1)
            self.counts["unreadable"] += int(np.sum(~good & ~bad))
            self.example = self.example or b"a line without its time stamp"
        return t[good], values[good]  # one without its stamp is a gap, which the next stamp tells


def header(
    cells: Sequence[str],
    sensors: Sequence[Channel],
    units: Mapping[str, str] | None = None,
    below: Sequence[str] | None = None,
) -> ColumnLayout:
    """ColumnLayout of a line of names, ``time,a1,d2`` or ``t [s];a1 [g];d2 [mm]``; columns of no sensor are left out.

    Parameters
    ----------
    cells : sequence of str
    sensors : sequence of Channel
    units : mapping of str to str, optional
        Units by the names of sensors (or of the time), where they are not those of the header.
    below : sequence of str, optional
        Cells of a row of units.

    Raises
    ------
    InputError
        A sensor that is missing or comes twice, a unit that is missing, unknown or that of another quantity.
    """
    labels = [c.label for c in sensors]
    titles, columns = [_titled(c, labels) for c in cells], _columns(cells, sensors)
    under = [None] * len(cells) if below is None else [c.strip("[]() ") or None for c in below]
    stated = units or {}
    found = [stated.get(name) or unit or under[k] for k, (name, unit) in enumerate(titles)]
    missing = [c for k, c in zip(columns, sensors, strict=True) if found[k] is None and c.unit != ARBITRARY]
    if missing:
        raise InputError("the header of the stream does not state the unit of "
                         + ("a channel" if len(missing) == 1 else f"{len(missing)} channels"),
                         where="header of the stream", found=", ".join(c.label for c in missing[:50]),
                         expected="a unit such as m/s^2, g, N, mm, um/m, V",
                         hint="state the unit (" + " ".join(f"--unit {c.label}={c.unit}" for c in missing[:12]) + "), "
                         f"or write it in the header: {missing[0].label} [{missing[0].unit}]")  # fmt: skip
    factors = tuple(_factor(found[k], c) for k, c in zip(columns, sensors, strict=True))
    time = next((k for k, (name, _) in enumerate(titles) if name.lower() in TIME and k not in columns), None)
    if time is None:
        return ColumnLayout(len(cells), None, columns, factors)
    tick = next((unit for name, unit in stated.items() if name.lower() in TIME), found[time])
    return ColumnLayout(len(cells), time, columns, factors, _tick(tick))


def _columns(cells: Sequence[str], sensors: Sequence[Channel]) -> tuple[int, ...]:
    """Column of each sensor."""
    labels = [c.label for c in sensors]
    names = [_titled(c, labels)[0] for c in cells]
    lost = [label for label in labels if names.count(label) != 1]
    if lost:
        raise InputError("a sensor is not in the header of the stream, or twice", where=f"channel {lost[0]}",
                         found=printable(", ".join(names)), expected=", ".join(labels),
                         hint="name the columns as the sensors of the model")  # fmt: skip
    return tuple(names.index(label) for label in labels)


def _titled(cell: str, labels: Collection[str] = ()) -> tuple[str, str | None]:
    """Name and unit of ``acc [g]``; round brackets hold a unit only where it is a known one, and no label is parted."""
    if cell in labels:
        return cell, None
    match = TITLE.fullmatch(cell)
    assert match is not None
    name, square, rounded = match.groups()
    if rounded is not None and not _known(rounded):
        name, rounded = cell.strip(), None
    return name.strip('"'), square if square is not None else rounded


def _known(unit: str | None) -> bool:
    from structures import units

    return unit is not None and units.known(unit)


def _units_row(cells: list[str], heading: list[str]) -> bool:
    """Whether the line under a header holds its units."""
    bare = [c.strip("[]() ") for c in cells]
    return len(cells) == len(heading) and any(bare) and all(not c or _known(c) for c in bare)


def _stated(given: Mapping[str, str], sensors: Sequence[Channel]) -> dict[str, float]:
    """Factors of the units that were stated, by the names of sensors, that of the time by `TICK`."""
    known = {c.label: c for c in sensors}
    found = {}
    for name, unit in given.items():
        if name in known:
            found[name] = _factor(unit, known[name])
        elif name.lower() in TIME:
            found[TICK] = _tick(unit)
        else:
            raise InputError("a unit of no sensor", where=f"--unit {name}={unit}", found=name,
                             expected=", ".join(known), hint="name a sensor of the model, or time")  # fmt: skip
    return found


def _factor(unit: str | None, sensor: Channel) -> float:
    if unit is None or sensor.unit in (ARBITRARY, unit):
        return 1.0
    from structures import units

    found = units.parse(unit, channel=sensor.label, where="header of the stream")
    if found.si != units.parse("m/m" if sensor.unit == "1" else sensor.unit).si:
        raise InputError("a column is in the unit of another quantity", where=f"channel {sensor.label}", found=unit,
                         expected=sensor.unit, hint="send the column in a unit that converts to this one, or state the "
                         f"right unit with --unit {sensor.label}=UNIT")  # fmt: skip
    return float(found.factor)


def _tick(unit: str | None) -> float:
    """Seconds of a unit of time; a text that is no unit stands for none."""
    from structures import units

    return float(units.check(unit, "time", channel="time").factor) if unit is not None and _known(unit) else 1.0


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
        return re.split(r"\s+(?![\[(])", text)  # "acc [g]" is one name
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
