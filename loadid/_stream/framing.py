"""From bytes to rows of numbers: whole lines of comma-separated values, with or without time stamps.

A row does not depend on the pieces in which its bytes come. What cannot be read is counted, and the stream goes on. A
line of names may come again at any time: what follows is read by it, or the stream ends there.
"""

from __future__ import annotations

import io
import logging
import re
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from structures._channels import Channel
from structures.errors import InputError

from .._inverse.gaussian.compiled import Compiled
from .header import (
    TICK,
    TIME,
    ColumnLayout,
    cells_of,
    columns_of,
    header,
    in_seconds,
    is_unit,
    is_units_row,
    number_of,
    printable,
    separator_of,
    stated_factors,
    titled,
)

Array = NDArray[np.float64]

LARGEST = 1e100  # of a reading: its square must stay a number
HOPELESS = 50  # lines, none of which can be read, after which nothing better is expected
LONGEST = 1 << 16  # bytes of a line; what is longer has lost its end
LONG, COLD = 64, 20_000  # lines of a piece that count, and how many until a loop is compiled to read them
TENS = np.array([float(10**k) for k in range(23)])  # exact
SPACE, COMMA, POINT, END, RETURN = b" ,.\n\r"
PLUS, MINUS, ZERO, NINE = b"+-09"
NUMBER = re.compile(r"[-+]?[\d.]*(?:[eE][-+]?\d*)?")
log = logging.getLogger(__name__)


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
        self._many = 0  # lines that came in long pieces
        self._stated = stated_factors(self.units, self.sensors)
        if layout is not None:
            self._require_stated(layout)

    def push(self, data: bytes) -> tuple[Array | None, Array]:
        """Time stamps (rows,), or None where there are none, and values (rows, sensors) of all lines that end in data.

        Raises
        ------
        InputError
            A header that lacks a sensor or a unit, a first line of a width that fits no layout, lines none of which
            can be read. Rows before such a header are handed over first: the next call raises.
        """
        if self.refused is not None:
            raise self.refused
        if (table := self._plain(data)) is not None:
            self.headings, parts = [], [self._parted(table)]
            self._require_any()
            return self._joined(parts)
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

    def _joined(self, parts: list[tuple[Array | None, Array]]) -> tuple[Array | None, Array]:
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
        whole = in_seconds(whole)
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
        titles = [titled(cell, self._labels) for cell in cells_of(bare.lstrip(b"# "))]
        named = all(self._is_name(name) or is_unit(unit) for name, unit in titles)
        return bare.lstrip(b"# ") if named and self._labels <= {name for name, _ in titles} else b""

    def _require_any(self) -> None:
        c = self.counts
        if c["lines"] >= HOPELESS and c["wide"] + c["unreadable"] >= c["lines"]:
            layout = self.layout or self.before
            assert layout is not None
            raise InputError("no line of the stream can be read", where="stream", found=printable(self.example),
                             expected=f"{layout.width} numbers with a comma, semicolon or tab between them",
                             hint="time stamps are seconds, as 12.345, or 2026-03-01T10:00:00.25Z; name the columns in "
                             "the first line")  # fmt: skip

    # -- lines of names ---------------------------------------------------------------------------------------------
    def _begun(self, lines: list[bytes]) -> list[bytes]:
        """Find the layout; the lines that hold numbers."""
        if self.heading is None:
            cells = cells_of(lines[0])
            if any(number_of(c) is None for c in cells):
                self._headed(lines[0])
                lines = lines[1:]
            else:
                self._settle(self._bare(len(cells)))
        if self.heading is not None and lines:
            cells = cells_of(lines[0])
            below = is_units_row(cells, self.heading)
            self._settle(header(self.heading, self.sensors, self.units, cells if below else None))
            return lines[below:]
        return lines

    def _headed(self, line: bytes) -> None:
        """A line of names, which is kept until the next line has come; in mid-stream one that came again."""
        cells = cells_of(line)
        if self.layout is not None:
            cells = self._apart(cells)
        columns_of(cells, self.sensors)
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
        return cell not in self._labels and (number := number_of(cell)) is not None and number == number

    def _is_name(self, cell: str) -> bool:
        name = titled(cell, self._labels)[0]
        return name in self._labels or name.lower() in TIME

    def _is_heading(self, line: bytes) -> bool:
        """Whether a line among numbers names columns: of words one of which is known, or with the name of a sensor."""
        cells = cells_of(line)
        words = [c for c in cells if number_of(c) is None]
        if any(titled(c, self._labels)[0] in self._labels for c in words):
            return True
        return not any(map(self._is_number, cells)) and any(self._is_name(c) or is_unit(titled(c)[1]) for c in words)

    def _apart(self, cells: list[str]) -> list[str]:
        """Names without the row before them, where that was broken off: ``0.5,1.2time,a,d``."""
        first = next(k for k, c in enumerate(cells) if number_of(c) is None)
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
    def _table(self, lines: list[bytes]) -> Array:
        """Numbers (lines, width) up to the next header; a bad line is NaN throughout."""
        table = self._block(lines)
        if table is None:
            named = next((k for k, line in enumerate(lines) if self._is_heading(line)), len(lines))
            table = self._each(lines[:named])
        self.counts["lines"] += len(table)
        return table

    def _plain(self, data: bytes) -> Array | None:
        """Lines (lines, width) of numbers and empty cells alone, read at once; None for others, and for the first."""
        many = data.count(b"\n")
        self._many += many * (many >= LONG)
        if self.layout is None or self.skipping or not many or (self._many < COLD and not _numbers.built):
            return None
        whole, _, rest = (self.rest + data).rpartition(b"\n")
        whole = in_seconds(whole)
        mark = separator_of(whole.partition(b"\n")[0])[0]
        if mark == SPACE or len(rest) > LONGEST:
            return None
        table, text = np.empty((many, self.layout.width)), whole + b"\n"
        others = np.empty((table.size, 3), np.int64)
        found = _numbers(np.frombuffer(text, np.int8), mark, TENS, LONGEST, table, others)
        if found < 0:
            return None
        flat = table.reshape(-1)
        for cell, begin, end in others[:found].tolist():
            flat[cell] = float(text[begin:end].replace(b",", b"."))
        self.rest = rest
        self.counts["lines"] += many
        return table

    def _block(self, lines: list[bytes]) -> Array | None:
        assert self.layout is not None
        width, mark = self.layout.width, separator_of(lines[0])
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

    def _each(self, lines: list[bytes]) -> Array:
        assert self.layout is not None
        table = np.full((len(lines), self.layout.width), np.nan)
        for k, line in enumerate(lines):
            numbers = [number_of(c) for c in cells_of(line)]
            if len(numbers) != self.layout.width:
                self.counts["wide"] += 1
            elif any(n is None for n in numbers):
                self.counts["unreadable"] += 1
            else:
                table[k] = numbers
                continue
            self.example = self.example or line
        return table

    def _parted(self, table: Array) -> tuple[Array | None, Array]:
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


def compile_parser() -> None:
    """Load the compiler of what reads numbers now, and not after so many lines: for those who read many streams."""
    _numbers.build()


@Compiled
def _numbers(
    text: NDArray[np.int8], mark: int, tens: Array, longest: int, table: Array, others: NDArray[np.int64]
) -> int:
    """Fill a table (lines, width) with the numbers of a text, NaN for nan and an empty cell; -1 where it holds more.

    A decimal number is a whole one over or times a power of ten: where both are exact in float64, one rounding is right
    (W. D. Clinger, PLDI 1990), and where the first is not, a quotient with its rest (T. J. Dekker, Numer. Math. 18
    (1971) 224-242) tells what it rounds to, but for ties and their neighbours. Others are left to `float`: how many, in
    `others` (cells, 3) which, with begin and end of their text.
    """
    lines, width = table.shape
    i, found = 0, 0
    for line in range(lines):
        start = i
        for column in range(width):
            while text[i] == SPACE:
                i += 1
            begin, whole, digits, power, point = i, 0, 0, 0, False
            negative = text[i] == MINUS
            if negative or text[i] == PLUS:
                i += 1
            seen, many = 0, False
            while True:
                c = int(text[i])
                if ZERO <= c <= NINE:
                    seen += 1
                    if digits < 18:
                        whole = 10 * whole + (c - ZERO)
                        digits += whole > 0
                        power -= point
                    else:
                        many = True
                elif not point and (c == POINT or (c == COMMA and mark != COMMA)):
                    point = True
                else:
                    break
                i += 1
            if seen and (c == 101 or c == 69):  # e, E
                i += 1
                down = text[i] == MINUS
                if down or text[i] == PLUS:
                    i += 1
                if not ZERO <= text[i] <= NINE:
                    return -1
                exponent = 0
                while ZERO <= text[i] <= NINE:
                    exponent = min(10 * exponent + (int(text[i]) - ZERO), 9999)
                    i += 1
                power += -exponent if down else exponent
            end = i
            if i == begin and text[i] | 32 == 110 and text[i + 1] | 32 == 97 and text[i + 2] | 32 == 110:  # nan
                i += 3
            while text[i] == SPACE:
                i += 1
            if column + 1 == width and text[i] == RETURN:
                i += 1
            if text[i] != (END if column + 1 == width else mark) or (not seen and (end > begin or width == 1)):
                return -1
            i += 1
            if not seen:
                table[line, column] = np.nan
                continue
            value, right = float(whole), not many and (whole == 0 or abs(power) <= 22)
            if right and whole > 0:
                if whole > 9007199254740992:
                    value, right = _quotient(whole, tens[max(-power, 0)])
                    right = right and power <= 0
                elif power < 0:
                    value /= tens[-power]
                else:
                    value *= tens[power]
            table[line, column] = -value if negative else value
            if not right:
                others[found, 0], others[found, 1], others[found, 2] = line * width + column, begin, end
                found += 1
        if i - start > longest + 1:
            return -1
    return found


@Compiled
def _quotient(whole: int, ten: float) -> tuple[float, bool]:
    """A whole number below 1e18 over a power of ten, and whether it is rounded right."""
    high = float(whole)
    ratio = high / ten
    a, b = 134217729.0 * ratio, 134217729.0 * ten  # 2^27 + 1: halves of the digits
    a, b = a - (a - ratio), b - (b - ten)
    product = ratio * ten
    missed = ((a * b - product) + a * (ten - b) + (ratio - a) * b) + (ratio - a) * (ten - b)
    left, low = (high - product) - missed, float(whole - int(high))
    rest, doubt = (left + low) / ten, 1e-12 * (abs(left) + abs(low)) / ten
    return ratio + rest, ratio + (rest - doubt) == ratio + (rest + doubt)
