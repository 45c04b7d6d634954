"""Text tables (.csv, .txt, ...): delimiter and decimal sign found from the numbers themselves, never from a guess.

Above the numbers there may be anything; the last line with as many cells as the rows names the columns ("acc [m/s^2]",
"acc (g)"), and a line between may hold the units. Cells with dates or times of day are the stamps of the samples.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from structures import units as _units
from structures._flags import Flag

from .. import _stamps
from .curves import refuse_frfs
from .rows import decimals_of, number_of, rows_of, split, whole
from .settle import TIME_NAMES
from .source import COLUMNS, Options, Source, Table, register, truncated

TRIES = (("\t", "."), ("\t", ","), (";", "."), (";", ","), (",", "."), (None, "."), (None, ","))
HEADER_LINES = 1000
LONGEST_NAME = 1000  # characters in which a unit is looked for: the expression below costs their square
WITH_UNIT = re.compile(r"(?P<name>.*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>.*)\))\s*", re.DOTALL)


@dataclass(frozen=True)
class _Layout:
    separator: str | None
    decimal: str
    width: int
    first: int  # index of the first row of numbers


def _readable(head: bytes) -> bool:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return True
    control = sum(b < 9 or 13 < b < 27 or 27 < b < 32 for b in head)
    return bool(head) and control == 0


@register("CSV", suffixes=(".csv", ".txt", ".tsv", ".dat", ".asc", ".tab"), sniff=_readable, generic=True)
def load(source: Source, options: Options) -> list[Table]:
    """The one table of the file."""
    if options.axis not in (None, 0):
        source.refuse(
            "in a text table time runs down", f"axis = {options.axis!r}", "no axis, or 0", "transpose the table"
        )
    text = _decoded(source)
    ended = text.endswith(("\n", "\r"))
    lines = text.splitlines()
    while lines and not lines[-1].strip(" \t;,"):
        lines.pop()
        ended = True
    _refuse_rows_of_channels(lines, source)
    lines = _without_empty_columns(lines)
    lines, notes = _with_points(lines)
    layout = _layout(lines, source, ended)
    body = [(i + 1, line) for i, line in enumerate(lines) if i >= layout.first and line.strip()]
    body, flags = (body, ()) if ended else _unended(body, layout)
    for number, line in body:
        if (count := _count(line, layout)) != layout.width:
            both = layout.separator == "," and not any("." in line for _, line in body[:100])
            source.refuse("lines of different length", f"line {number}: {count} cells", f"{layout.width} cells",
                          "the comma may be the decimal sign too: part the columns by semicolons or tabs" if both
                          else "correct or delete that line")  # fmt: skip
    _refuse_damaged_row(lines[: layout.first], body, layout, source)
    columns = np.arange(layout.width)
    clean = (
        [(n, line.rstrip().rstrip(layout.separator or " ")) for n, line in body] if _trailing(body, layout) else body
    )
    names, units = _heading(lines[: layout.first], layout)
    if names is None and layout.width > max(len(body), 64):
        source.refuse("more columns than rows: the table probably lies on its side",
                      f"{len(body)} rows of {layout.width} cells", "a column for each channel",
                      "transpose it, or name the columns in a line above")  # fmt: skip
    forms = {i: _stamps.form(cell) for i, cell in enumerate(_cells(clean[0][1], layout)) if _is_text(cell, layout)}
    at = [i for i, form in forms.items() if form == "date" and forms.get(i + 1) == "time"]
    if names is None and at and layout.separator is None:  # one name over a date and a time of day
        names, units = _heading(lines[: layout.first], replace(layout, width=layout.width - 1))
        names = None if names is None else (*names[: at[0] + 1], *names[at[0] :])
        units = None if units is None else (*units[: at[0] + 1], *units[at[0] :])
    if not forms:
        refuse_frfs(names, source)
        values = rows_of(clean, layout.separator, layout.decimal, columns, layout.width, source)
        return [Table(values, name=source.path.stem, columns=names, units=units, flags=flags, notes=notes)]
    table = _with_stamps(clean, forms, names, units, flags, layout, source)
    return [replace(table, notes=(*notes, *table.notes))]


def _is_text(cell: str, layout: _Layout) -> bool:
    return number_of(cell, layout.decimal) is None


def _with_stamps(
    body: list[tuple[int, str]],
    forms: dict[int, str],
    names: tuple[str, ...] | None,
    units: tuple[str | None, ...] | None,
    flags: tuple[Flag, ...],
    layout: _Layout,
    source: Source,
) -> Table:
    """Table of rows some columns of which (`forms`) hold dates or times of day."""
    rows = [_cells(line, layout) for _, line in body]
    numbers = np.array([i for i in range(layout.width) if i not in forms])
    if not len(numbers):
        source.refuse("there are time stamps and nothing else", body[0][1][:60], "at least one channel")
    mark = layout.separator or "\t"  # where the stamps stood nothing is left, so that columns keep their places
    bare = [
        (n, mark.join("" if i in forms else c for i, c in enumerate(cells)))
        for (n, _), cells in zip(body, rows, strict=True)
    ]
    values = rows_of(bare, mark, layout.decimal, numbers, layout.width, source)
    kept = None if names is None else tuple(names[i] for i in numbers)
    timed = kept is not None and any(n.strip().lower() in TIME_NAMES for n in kept)
    used = _clock(forms, timed)
    passed = [names[i] if names else f"column {i + 1}" for i in forms if i not in used]
    return Table(
        values,
        name=source.path.stem,
        columns=kept,
        units=None if units is None else tuple(units[i] for i in numbers),
        flags=flags,
        notes=(f"passed over: {', '.join(passed)} (dates or times)",) if passed else (),
        stamps=np.array([" ".join(cells[i] for i in used) for cells in rows]) if used else None,
        clock=" ".join(dict.fromkeys(names[i].strip() for i in used)) if names else "time",
    )


def _clock(forms: dict[int, str], timed: bool) -> list[int]:
    """Columns that make the stamps: one with both, else a date and a time of day, else what there is.

    Where a column of numbers is time, a date without a time of day tells nothing.
    """
    for kinds in (("stamp",), ("date", "time"), ("time",), () if timed else ("date",)):
        found = [next((i for i, f in forms.items() if f == kind), None) for kind in kinds]
        if found and None not in found:
            return [i for i in found if i is not None]
    return []


def _decoded(source: Source) -> str:
    data = source.data()
    encodings = ["utf-16"] if data.startswith((b"\xff\xfe", b"\xfe\xff")) else ["utf-8-sig", "cp1252", "latin-1"]
    for encoding in encodings:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" in text:
            break
        return text
    return source.refuse("the file holds binary data", f"first bytes {source.head[:16]!r}", "text")


def _cells(line: str, layout: _Layout) -> list[str]:
    cells = split(line, layout.separator)
    if len(cells) == layout.width + 1 and not cells[-1]:
        cells.pop()
    return cells


def _count(line: str, layout: _Layout) -> int:
    """Number of `_cells`, without making them where nothing is quoted."""
    if layout.separator is None or '"' in line:
        return len(_cells(line, layout))
    count = line.count(layout.separator) + 1
    return count - 1 if count == layout.width + 1 and not line.rpartition(layout.separator)[2].strip() else count


def _trailing(body: list[tuple[int, str]], layout: _Layout) -> bool:
    """Whether every row ends with a separator that separates nothing."""
    return layout.separator is not None and all(
        len(split(line, layout.separator)) == layout.width + 1 for _, line in body
    )


def _without_empty_columns(lines: list[str]) -> list[str]:
    """Lines without the delimiters that end all of them: columns of a sheet in which nothing stands."""
    filled = [line for line in lines if line.strip()]
    for mark in ",;":
        least = min((len(line) - len(line.rstrip(mark)) for line in filled[:-1]), default=0)
        if least > 1:  # the very last line may be cut
            return [line.removesuffix(mark * least) for line in lines]
    return lines


WIDEST = 256  # columns of a table whose commas have two meanings
COMMA_PAIR = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d{1,3})?")


def _with_points(lines: list[str]) -> tuple[list[str], tuple[str, ...]]:
    """Lines of a table that parts its columns by commas and writes decimal ones, ``0,001,0,25``, with points instead.

    Sure where a line of n names stands over rows of 2n groups of digits, and every second group is of digits alone.
    """
    rows = [i for i, line in enumerate(lines) if line.strip()]
    first = next((k for k, i in enumerate(rows) if _numeric(lines[i], ",", ".")), len(rows))
    if first == 0 or len(rows) - first < 2 or any(c in lines[rows[-1]] for c in ";\t."):
        return lines, ()
    width = len(split(lines[rows[first - 1]], ","))
    if width > WIDEST:
        return lines, ()
    pairs = re.compile(",".join([rf"({COMMA_PAIR.pattern})"] * width))
    body = rows[first:]
    kept = body if pairs.fullmatch(lines[body[-1]].strip()) else body[:-1]  # the very last line may be cut
    if not kept or not all(pairs.fullmatch(lines[i].strip()) for i in kept):
        return lines, ()
    found = list(lines)
    for i in body:
        cells = lines[i].strip().split(",")
        found[i] = ",".join(".".join(cells[k : k + 2]) for k in range(0, len(cells), 2))
    return found, ("commas part the columns and the decimals too: two groups of digits are read as one number",)


def _refuse_damaged_row(above: list[str], body: list[tuple[int, str]], layout: _Layout, source: Source) -> None:
    """Nothing, unless the line over the first row of numbers is a row that was damaged, or one glued to the heading."""
    filled = [k for k, line in enumerate(above) if line.strip()]
    if not filled or not body or layout.width < 2:
        return
    line, mark = above[filled[-1]].strip(), layout.decimal
    cells, row = _cells(line, layout), _cells(body[0][1], layout)
    decimals = decimals_of(row[0], mark)[0]
    tail = rf"\D\d+{re.escape(mark)}\d{{{decimals}}}" if decimals else r"\D\d+"
    numbers = all(cell and number_of(cell, mark) is not None for cell in cells[1 - layout.width :])
    last = re.search(rf"{tail}$", cells[-layout.width]) if len(cells) >= layout.width else None
    glued = numbers and last is not None and (decimals > 0 or len(cells) > layout.width)
    surplus = len(cells) > layout.width and _alike(cells[-1:], row[-1:], mark) > 0
    cut = line[-1].isdigit() and any(line.count(a) != line.count(b) for a, b in ("[]", "()"))
    begun = re.match(rf"[+-]?\d+{re.escape(mark)}\d", line) is not None
    alike = max(_alike(cells, row, mark), _alike(cells[::-1], row[::-1], mark))
    damaged = begun or (len(filled) > 1 and 2 * alike >= layout.width)
    if glued or surplus or cut or (damaged and line[0] not in "#%"):
        source.refuse("the line over the first row of numbers names no columns and is no row: it may be a damaged one",
                      f"line {filled[-1] + 1}: {line[:80]!r}", "names and units of the columns, or numbers",
                      "correct or delete that line")  # fmt: skip


def _alike(cells: list[str], row: list[str], decimal: str) -> int:
    """How many cells are numbers with as many decimals as those of a row below."""
    forms = [(decimals_of(a, decimal), decimals_of(b, decimal)) for a, b in zip(cells, row, strict=False)]
    return sum(a == b and a[0] > 0 for a, b in forms)


def _refuse_rows_of_channels(lines: list[str], source: Source) -> None:
    """Nothing, unless every line is a name and then numbers: a table that lies on its side."""
    filled = [line for line in lines if line.strip()][:64]
    for separator, decimal in TRIES[:-2]:
        rows = [split(line[:100_000], separator) for line in filled]
        if len(rows) < 2 or min(map(len, rows)) < max(8, 2 * len(rows)):
            continue
        named = all(c[0] and number_of(c[0], decimal) is None and not _stamps.form(c[0]) for c in rows)
        if named and all(number_of(c, decimal) is not None for row in rows for c in row[1:8]):
            source.refuse("the rows of the table are channels: it lies on its side",
                          f"{len(filled)} lines that begin with a name, {', '.join(repr(c[0][:20]) for c in rows[:4])}",
                          "a column for each channel", "transpose it: time runs down")  # fmt: skip


def _layout(lines: list[str], source: Source, ended: bool) -> _Layout:
    """Separator, decimal sign, cells per row and first row, from a sample of lines at the end of the file."""
    filled = [i for i, line in enumerate(lines) if line.strip()]
    if not filled:
        source.refuse("the file is empty", "blank lines", "rows of numbers")
    tail = filled[max(0, len(filled) - 200) :]
    sample = [lines[i] for i in (tail[:-1] if len(tail) > 1 else tail)]  # the very last line may be cut
    sample = sample[len(sample) // 2 :] if len(sample) < 100 else sample[-50:]
    fits = [(s, d, w) for s, d in TRIES if (w := _width(sample, s, d))]
    alone = not any(_width([lines[i]], s, d) for i in tail[:-1] for s, d in TRIES)
    if not fits and ended and alone:  # a heading and one row, which is whole
        fits = [(s, d, w) for s, d in TRIES if (w := _width([lines[tail[-1]]], s, d))]
    many = [f for f in fits if f[2] > 1]
    if fits and not many and len(filled) == 1 and not ended:
        source.refuse("one number is no table", repr(lines[tail[-1]][:60]), "rows of numbers")
    if not fits:
        bad = next((line for line in sample if not any(_width([line], s, d) for s, d in TRIES)), sample[-1])
        source.refuse("no rows of numbers", f"line {lines.index(bad) + 1}: {bad[:60]!r}",
                      "numbers, and dates or times, with one delimiter (comma, semicolon, tab or spaces)")  # fmt: skip
    comma = next((f for f in many if f[:2] == (",", ".")), None)
    if comma and comma[2] == 2 and not any("." in line for line in sample) and any(f[1] == "," for f in fits):
        heading = [lines[i] for i in filled if lines[i] not in sample and not _numeric(lines[i], ",", ".")]
        if not heading:
            source.refuse("a comma may be the decimal sign or the delimiter", repr(sample[-1][:40]),
                          "a file that says which",
                          "add a line of column names, or use semicolons or tabs between columns")  # fmt: skip
        chosen = comma if heading[-1].count(",") == 1 else (None, ",", 1)
    else:
        chosen = (many or fits)[0]
    separator, decimal, width = chosen
    if width > COLUMNS:
        source.refuse("too many columns", width, f"at most {COLUMNS}")
    first = next(i for i in filled if _numeric(lines[i], separator, decimal, width))
    if first > HEADER_LINES:
        source.refuse(
            "no numbers near the top", f"first row of numbers in line {first + 1}", f"within {HEADER_LINES} lines"
        )
    return _Layout(separator, decimal, width, first)


def _width(sample: list[str], separator: str | None, decimal: str) -> int:
    """Cells per row when all lines are rows of numbers of one length, else 0."""
    widths = set()
    for line in sample:
        cells = split(line, separator)
        if len(cells) > 1 and not cells[-1]:
            cells.pop()
        if len(cells) > 1 and separator is None and decimal == "," and not any("," in c for c in cells):
            return 0
        told = [number_of(c, decimal) is not None for c in cells]
        if not any(cells) or not any(told) or not all(t or _stamps.form(c) for t, c in zip(told, cells, strict=True)):
            return 0
        widths.add(len(cells))
    return max(widths) if len(widths) <= 2 and max(widths) - min(widths) <= 1 else 0


def _numeric(line: str, separator: str | None, decimal: str, width: int = 0) -> bool:
    cells = split(line, separator)
    if len(cells) > 1 and not cells[-1] and len(cells) == width + 1:
        cells.pop()
    filled = [c for c in cells if c]
    return (
        bool(filled)
        and len(cells) >= width
        and all(number_of(c, decimal) is not None or _stamps.form(c) for c in filled)
    )


def _unended(body: list[tuple[int, str]], layout: _Layout) -> tuple[list[tuple[int, str]], tuple[Flag, ...]]:
    """Rows of a file whose last line has no end: without the last one, and said, unless it is sure to be whole."""
    *others, (_, line) = body
    cells, before = _cells(line, layout), [_cells(row, layout)[-1] for _, row in others[-1000:]]
    if len(cells) > layout.width or (len(cells) == layout.width and whole(cells[-1], before, layout.decimal)):
        return body, ()
    known = "rows are sure to be whole (the last line has no end: give it a line break if nothing of it is lost)"
    return others or body, (truncated(len(others), len(body), known),)


def _heading(lines: list[str], layout: _Layout) -> tuple[tuple[str, ...] | None, tuple[str | None, ...] | None]:
    """Names and units of the columns from the lines above the numbers; (None, None) when they name nothing."""
    rows = []
    for line in reversed(lines):
        if not line.strip():
            continue
        cells = _names_of(line.strip().lstrip("#%").strip(" "), layout)
        if len(cells) == layout.width + 1 and not cells[-1]:
            cells.pop()
        if len(cells) != layout.width:
            break
        rows.append(cells)
        if len(rows) == 2:
            break
    if not rows:
        return None, None
    bare = [_bare(c) for c in rows[0]]
    if len(rows) == 2 and all(not c or _units.known(c) for c in bare) and any(bare) and not _all_known(rows[1]):
        names = [WITH_UNIT.fullmatch(n)["name"] if name_and_unit(n)[1] else n for n in rows[1]]  # type: ignore[index]
        return tuple(names), tuple(c or name_and_unit(n)[1] for c, n in zip(bare, rows[1], strict=True))
    pairs = [name_and_unit(c) for c in rows[0]]
    return tuple(n for n, _ in pairs), tuple(u for _, u in pairs)


def _names_of(line: str, layout: _Layout) -> list[str]:
    if layout.separator is not None:
        return split(line, layout.separator)
    if layout.width == 1:
        return [line]
    cells = line.split()
    return (
        cells if len(cells) == layout.width else re.sub(r"(?<!\s)\s++(?=[\[(])", "", line).split()
    )  # "F [N]" is one name


def _bare(cell: str) -> str:
    """Unit of a cell of a units row, with or without brackets."""
    return cell.strip().strip("[]()").strip()


def _all_known(cells: list[str]) -> bool:
    return all(_units.known(_bare(c)) for c in cells)


def name_and_unit(cell: str) -> tuple[str, str | None]:
    """("acc", "m/s^2") of "acc [m/s^2]"; round brackets hold a unit only when they hold a known one."""
    if len(cell) > LONGEST_NAME:
        return cell.strip(), None
    match = WITH_UNIT.fullmatch(cell.strip())
    if match is None or not match["name"]:
        return cell.strip(), None
    if match["square"] is not None:
        return match["name"], match["square"].strip() or None
    return (match["name"], match["round"].strip()) if _units.known(match["round"]) else (cell.strip(), None)
