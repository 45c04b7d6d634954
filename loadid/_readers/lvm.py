"""LabVIEW measurement files (.lvm): text, several segments, several records behind one header.

Layout after NI's description of the format: a file header, then segments of a segment header, a line of column names
and rows of numbers. Each segment header declares the samples of every channel. With one header for the whole file the
rows of the next record simply follow, so a multiple of the declared number of rows is as many records; where a time
column runs on through all of them they are packets of one record. How many segments a file has is declared nowhere: a
file cut exactly between two of them cannot be told from a whole one.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from structures._flags import Flag

from .. import _stamps
from .rows import rows_of
from .settle import distinct
from .source import COLUMNS, Options, Source, Table, register, truncated

END = "***End_of_Header***"
OF_A_SEGMENT = ("Channels", "Samples")  # entries of every segment header, and of no file header
RECORDS = 10_000


@register(
    "LabVIEW LVM", suffixes=(".lvm", ".txt"), sniff=lambda head: head.lstrip(b"\xef\xbb\xbf").startswith(b"LabVIEW M")
)
def load(source: Source, options: Options) -> list[Table]:
    """Every record of the file, named ``record_1, record_2, ...``."""
    text = source.data().decode("utf-8-sig", errors="replace")
    if "\0" in text:
        source.refuse("the file holds binary data", "zero bytes", "LabVIEW LVM text")
    ended = text.endswith(("\n", "\r"))
    lines = text.splitlines()
    header, at = _header(lines, 0, source)
    _require_file_header(header, at, source)
    separator = {"Comma": ",", "Tab": "\t"}.get(header.get("Separator", ["Tab"])[0].strip(), "\t")
    if separator == ",":
        header, at = _header(lines, 0, source, ",")
    decimal = _decimal(header, separator, source)
    shape = header.get("X_Columns", ["One"])[0].strip().lower()
    if shape not in ("no", "one", "multi"):
        source.refuse("unknown number of time columns", f"X_Columns {shape!r}", "No, One or Multi")
    tables: list[Table] = []
    while at < len(lines):
        segment, at = _header(lines, at, source, separator)
        if not segment:
            break
        stop = next((i for i in range(at, len(lines)) if lines[i].startswith(("Channels", END))), len(lines))
        last = stop == len(lines)
        tables += _segment(segment, lines[at:stop], at, separator, decimal, shape, last and not ended, source)
        if len(tables) > RECORDS:
            source.refuse("too many records", len(tables), f"at most {RECORDS}")
        at = stop
    if not tables:
        source.refuse("the file ends in its header", f"{len(lines)} lines", "a segment with samples")
    return [replace(t, name=f"record_{i + 1}") for i, t in enumerate(tables)]


def _header(lines: list[str], at: int, source: Source, separator: str = "\t") -> tuple[dict[str, list[str]], int]:
    """Entries of a header, and the line after it; an empty header when only blank lines are left."""
    entries: dict[str, list[str]] = {}
    skipping = ""
    for i in range(at, len(lines)):
        if lines[i].startswith("***Start_Special***") or lines[i].startswith("***End_Special***"):
            skipping = "" if skipping else "special"
            continue
        key, _, rest = lines[i].partition(separator)
        if key.strip() == END:
            return entries, i + 1
        beyond = key.startswith("X_Value") or (key.strip() in entries and key.strip() in OF_A_SEGMENT)
        if beyond or i - at > 10_000:  # the names of the columns, or a second header: the end of this one is passed
            break
        if key.strip() and not skipping:
            entries[key.strip()] = rest.split(separator)
    else:
        if not entries:
            return {}, len(lines)
    return source.refuse("a header does not end", f"from line {at + 1}", END,
                         "the file is cut in its header: transfer or export it again")  # fmt: skip


def _require_file_header(header: dict[str, list[str]], end: int, source: Source) -> None:
    """Nothing, unless the header of the file holds what stands in that of a segment: its own end was passed."""
    taken = [key for key in OF_A_SEGMENT if any(re.split(r"[\t,]", entry)[0] == key for entry in header)]
    if taken:
        source.refuse("the header of the file does not end before that of its first segment",
                      f"{', '.join(taken)} in lines 1 to {end}", END,
                      "that line is damaged: transfer or export the file again")  # fmt: skip


def _decimal(header: dict[str, list[str]], separator: str, source: Source) -> str:
    """Decimal sign: as the header says, else a comma where the writer's own numbers have one."""
    stated = header.get("Decimal_Separator", [""])[0].strip()
    if stated in (",", "."):
        return stated
    return "," if separator == "\t" and stated.lower() == "comma" else "?"


def _segment(
    header: dict[str, list[str]],
    lines: list[str],
    first: int,
    separator: str,
    decimal: str,
    shape: str,
    cut: bool,
    source: Source,
) -> list[Table]:
    """Records of one segment; `cut` says that the very last line of the file has no end."""
    channels = _count(header, "Channels", source)
    declared = [_whole(n, "Samples", source) for n in header.get("Samples", []) if n.strip()]
    if len(declared) != channels:
        source.refuse("a segment does not say how many samples it has", f"Samples {declared}", f"{channels} numbers")
    if len(set(declared)) > 1:
        source.refuse("channels of different length in one segment", f"Samples {declared}", "equal numbers")
    if not lines:
        source.refuse("a segment ends in its header", f"line {first}", "column names and samples")
    names, width, x_columns = _names(lines[0], separator, channels, shape, source)
    body = list(enumerate(lines[1:], first + 2))
    lost = cut and bool(body) and bool(body[-1][1])
    if lost:  # a line without an end may be cut in the middle of a number
        body.pop()
    while body and not body[-1][1].strip():
        body.pop()
    values = rows_of(body, separator, _sign(decimal, body, separator), x_columns, width, source)
    dt = _common(header, "Delta_X", decimal, channels, source)
    texts = [u.strip() or None for u in header.get("Y_Unit_Label", [])]
    if shape == "multi" and len(texts) >= 2 * channels - 1 and not any(texts[1 : 2 * channels : 2]):
        texts = texts[::2]  # cells of the time columns are left empty
    units = texts[:channels]
    units += [None] * (channels - len(units))
    tables = _cut_into_records(values, declared[0], names, units, dt, shape, source)
    if begun := _begun(header):  # of the first record: those that follow it began at times that are not written
        zero = 0.0 if tables[0].time is not None else _common(header, "X0", decimal, channels, source) or 0.0
        tables[0] = replace(tables[0], begun=begun, start=zero)
    if lost and not tables[-1].flags:
        ended = truncated(0, declared[0], f"samples of the record that begins in line {first + 2 + len(body)}")
        tables[-1] = replace(tables[-1], flags=(ended,))
    return tables


def _begun(header: dict[str, list[str]]) -> str:
    """Date and time of the first sample of a segment, as its header states them for the first channel; else ""."""
    text = " ".join(header.get(key, [""])[0].strip().replace(",", ".") for key in ("Date", "Time"))
    return text if _stamps.form(text) == "stamp" else ""


def _names(
    line: str, separator: str, channels: int, shape: str, source: Source
) -> tuple[list[str], int, NDArray[np.int64]]:
    """Channel names, columns that must be there, and which of them are read (time first where there is one)."""
    cells = [c.strip() for c in line.split(separator)]
    if not cells[0].startswith("X_"):
        source.refuse("the line of column names is missing", repr(line[:60]), "X_Value, names, Comment")
    if shape == "multi":
        names = cells[1 : 2 * channels : 2]
        read = [0, *range(1, 2 * channels, 2)]
        width = 2 * channels
    else:
        names = cells[1 : channels + 1]
        read = [*([0] if shape == "one" else []), *range(1, channels + 1)]
        width = channels + 1
    if len(names) < channels or (names[-1] == "Comment" and len(cells) == max(read) + 1):
        source.refuse("column names do not fit the channels", names, f"{channels} names")
    if "X_Value" in names:
        source.refuse(
            "more time columns than X_Columns says", repr(line[:60]), "one for each channel in Multi, else one"
        )
    if channels > COLUMNS:
        source.refuse("too many channels", channels, f"at most {COLUMNS}")
    labels = distinct(cells)  # by their places in the line
    return [labels[k] if cells[k] else "" for k in read[-channels:]], width, np.array(read)


def _cut_into_records(
    values: NDArray[np.float64],
    declared: int,
    names: list[str],
    units: list[str | None],
    dt: float | None,
    shape: str,
    source: Source,
) -> list[Table]:
    rows = len(values)
    if declared == 0 or rows == 0:
        source.refuse("a record without samples", f"{rows} of {declared} samples", "samples")
    tables = []
    flow = shape != "no" and _continues(values[:, 0])  # packets of one record: time runs on from packet to packet
    for start in [0] if flow else range(0, rows, declared):
        part = values[start:] if flow else values[start : start + declared]
        flags: tuple[Flag, ...] = ()
        expected = -(-len(part) // declared) * declared
        if len(part) < expected:
            flags = (truncated(len(part), expected),)
        columns, texts, time = tuple(names), tuple(units), None
        if shape != "no" and np.all(np.isfinite(part[:, 0])) and len(part) > 1:
            columns, texts, time = ("X_Value", *names), ("s", *units), 0
        elif shape != "no":
            part = part[:, 1:]
        notes = () if dt is None or time is not None else (f"step {dt:.9g} s as the file states (Delta_X)",)
        tables.append(Table(part, columns=columns, units=texts, dt=dt, time=time, flags=flags, notes=notes))
    return tables


def _continues(time: NDArray[np.float64]) -> bool:
    if len(time) < 3 or not np.all(np.isfinite(time)):
        return False
    steps = np.diff(time)
    return bool(steps.min() > 0 and steps.max() < 1.5 * np.median(steps) + 1e-6)


def _sign(decimal: str, body: list[tuple[int, str]], separator: str) -> str:
    if decimal != "?":
        return decimal
    sample = "".join(line for _, line in body[:200])
    return "," if separator == "\t" and "," in sample and "." not in sample else "."


def _count(header: dict[str, list[str]], key: str, source: Source) -> int:
    count = _whole(header.get(key, [""])[0], key, source)
    if not 1 <= count <= COLUMNS:
        source.refuse(f"{key} is no sensible number", count, f"1 to {COLUMNS}")
    return count


def _whole(text: str, key: str, source: Source) -> int:
    if not re.fullmatch(r"\s*\d{1,12}\s*", text, re.ASCII):
        source.refuse(f"{key} is no whole number", repr(text[:40]), "digits")
    return int(text)


def _common(header: dict[str, list[str]], key: str, decimal: str, channels: int, source: Source) -> float | None:
    """A number that all channels of a segment share."""
    texts = [t.strip() for t in header.get(key, []) if t.strip()]
    if not texts:
        return None
    found = set()
    for text in texts[:channels]:
        plain = text.replace(",", ".") if decimal != "." else text
        if not re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", plain, re.ASCII):
            source.refuse(f"{key} is no number", repr(text[:40]), "a number")
        found.add(float(plain))
    if len(found) > 1 or len(texts) < channels:
        source.refuse(f"channels differ in {key}", sorted(found), "one step for all channels")
    return found.pop()
