"""The columns of a stream: what a line of names says of them, and the cells of a line."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from structures import units as _units
from structures._channels import ARBITRARY, Channel
from structures.errors import InputError

from .. import _stamps

TIME = ("t", "time", "zeit", "timestamp", "seconds")
MISSING = ("", "nan", "na", "null", "none", "-")
TICK = ""  # the unit of the time stamps, among those of sensors
CLOCK = (
    rb"(?<![^,;\t\n\" ])\d{4}[-/]\d\d[-/]\d\d[T ]\d\d:\d\d(?::\d\d(?:%s\d+)?)?"
    rb"(?:Z|[+-]\d\d(?::?\d\d)?)?(?![^,;\t\n\r\" ])"
)  # a cell of its own
STAMP, COMMA_STAMP = re.compile(CLOCK % rb"\."), re.compile(CLOCK % b"[.,]")
LONGEST_NAME = 1000  # characters in which a unit is looked for
TITLE = re.compile(r"\s*(.*?)\s*(?:\[(.*)\]|\((.*)\))?\s*", re.DOTALL)


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


def header(
    cells: Sequence[str],
    sensors: Sequence[Channel],
    units: Mapping[str, str] | None = None,
    below: Sequence[str] | None = None,
) -> ColumnLayout:
    """Layout of a line of names, ``time,a1,d2`` or ``t [s];a1 [g];d2 [mm]``; columns of no sensor are left out.

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
    titles, columns = [titled(c, labels) for c in cells], columns_of(cells, sensors)
    under = [None] * len(cells) if below is None else [c.strip("[]() ") or None for c in below]
    stated = units or {}
    found = [stated.get(name) or unit or under[k] for k, (name, unit) in enumerate(titles)]
    missing = [c for k, c in zip(columns, sensors, strict=True) if found[k] is None and c.unit != ARBITRARY]
    if missing:
        raise InputError("the header of the stream does not state the unit of "
                         + ("a channel" if len(missing) == 1 else f"{len(missing)} channels"),
                         where="header of the stream", found=", ".join(c.label for c in missing[:50]),
                         expected="a unit such as m/s^2, g, N, mm, um/m, V",
                         hint="state the unit (" + " ".join(f"--unit {c.label}={c.unit}" for c in missing[:12])
                         + "; in a plan: unit = {...}), "
                         f"or write it in the header: {missing[0].label} [{missing[0].unit}]")  # fmt: skip
    factors = tuple(_factor(found[k], c) for k, c in zip(columns, sensors, strict=True))
    time = next((k for k, (name, _) in enumerate(titles) if name.lower() in TIME and k not in columns), None)
    if time is None:
        return ColumnLayout(len(cells), None, columns, factors)
    tick = next((unit for name, unit in stated.items() if name.lower() in TIME), found[time])
    return ColumnLayout(len(cells), time, columns, factors, _tick(tick))


def columns_of(cells: Sequence[str], sensors: Sequence[Channel]) -> tuple[int, ...]:
    """Column of each sensor."""
    labels = [c.label for c in sensors]
    names = [titled(c, labels)[0] for c in cells]
    lost = [label for label in labels if names.count(label) != 1]
    if lost:
        raise InputError("a sensor is not in the header of the stream, or twice", where=f"channel {lost[0]}",
                         found=printable(", ".join(names)), expected=", ".join(labels),
                         hint="name the columns as the sensors of the model")  # fmt: skip
    return tuple(names.index(label) for label in labels)


def titled(cell: str, labels: Collection[str] = ()) -> tuple[str, str | None]:
    """Name and unit of ``acc [g]``; round brackets hold a unit only where it is a known one, and no label is parted."""
    if cell in labels or len(cell) > LONGEST_NAME:
        return cell, None
    match = TITLE.fullmatch(cell)
    assert match is not None
    name, square, rounded = match.groups()
    if rounded is not None and not is_unit(rounded):
        name, rounded = cell.strip(), None
    return name.strip('"'), square if square is not None else rounded


def is_unit(unit: str | None) -> bool:
    """Whether a text is a unit that is known."""
    return unit is not None and _units.known(unit)


def is_units_row(cells: list[str], heading: list[str]) -> bool:
    """Whether the line under a header holds its units."""
    bare = [c.strip("[]() ") for c in cells]
    return len(cells) == len(heading) and any(bare) and all(not c or is_unit(c) for c in bare)


def stated_factors(given: Mapping[str, str], sensors: Sequence[Channel]) -> dict[str, float]:
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
    found = _units.parse(unit, channel=sensor.label, where="header of the stream")
    if found.si != _units.parse("m/m" if sensor.unit == "1" else sensor.unit).si:
        raise InputError("a column is in the unit of another quantity", where=f"channel {sensor.label}", found=unit,
                         expected=sensor.unit, hint="send the column in a unit that converts to this one, or state the "
                         f"right unit with --unit {sensor.label}=UNIT")  # fmt: skip
    return float(found.factor)


def _tick(unit: str | None) -> float:
    """Seconds of a unit of time; a text that is no unit stands for none."""
    return float(_units.check(unit, "time", channel="time").factor) if unit is not None and is_unit(unit) else 1.0


def printable(text: str | bytes, most: int = 200) -> str:
    """Text of a stranger that does a terminal no harm."""
    words = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    words = "".join(c if c.isprintable() else "?" for c in words[: most + 1])
    return words if len(words) <= most else words[:most] + " ..."


def separator_of(line: bytes) -> bytes:
    """What stands between numbers; where it is no comma, a comma is a decimal one."""
    return next((mark for mark in (b";", b"\t", b",") if mark in line), b" ")


def cells_of(line: bytes) -> list[str]:
    """Cells of a line, without their quotes."""
    text, mark = line.decode("utf-8-sig", "replace").strip(), separator_of(line).decode()
    if mark == " ":
        return re.split(r"(?<!\s)\s++(?![\[(])", text)  # "acc [g]" is one name
    if '"' in text:
        with suppress(csv.Error, StopIteration):
            return [c.strip() for c in next(csv.reader([text], delimiter=mark, skipinitialspace=True))]
    return [c.strip() for c in text.split(mark)]


def in_seconds(text: bytes) -> bytes:
    """Lines with their ISO 8601 stamps as seconds since 1970: ``2026-03-01T10:00:00.25Z``; UTC where they say nothing.

    A blank for the ``T``, strokes for the dashes and, where no comma separates cells, a decimal comma are read too.
    """
    if b":" not in text:
        return text
    found = STAMP.search(text)
    if found is None:
        return text
    begin = text.rfind(b"\n", 0, found.start()) + 1
    comma = separator_of(text[begin:].partition(b"\n")[0]) != b","
    return (COMMA_STAMP if comma else STAMP).sub(_seconds, text)


def _seconds(found: re.Match[bytes]) -> bytes:
    when = _stamps.seconds(found[0].decode())
    return found[0] if when is None else repr(when).encode()


def number_of(cell: str) -> float | None:
    """A number, NaN where a sample is missing, None for other text."""
    if cell.lower() in MISSING:
        return float("nan")
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return None
