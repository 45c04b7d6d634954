"""Universal files (UFF, UNV): functions (58, 58b), nodes (15), units (164), header (151); all else is counted.

A file is read whole or refused: every data set must reach its end mark and hold as many values as it declares. What
no reader can see is a file that was cut exactly between two data sets.
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .. import units
from ..errors import InputError
from ._recorded import StatedUnit
from ._storage import as_path
from ._uff_datasets import Block, Function, function_of, is_function, split
from ._uff_records import AxisRecord, Place, numbers, text_of

# specific data type -> quantity of a translation, of a rotation; {L} is a length, {F} a force
_TYPES = {
    2: ("{F}/{L}^2", "{F}/{L}^2"), 3: ("m/m", "m/m"), 8: ("{L}", "rad"), 9: ("{F}", "{F}*{L}"), 11: ("{L}/s", "rad/s"),
    12: ("{L}/s^2", "rad/s^2"), 13: ("{F}", "{F}*{L}"), 15: ("{F}/{L}^2", "{F}/{L}^2"),
}  # fmt: skip
_LENGTHS, _FORCES = ("m", "mm", "cm", "in", "ft"), ("N", "mN", "lbf", "kgf", "kN")
# What the code of data set 164 says: units of length and force, per metre and per newton.
_POUND, _POUNDAL = 4.4482216152605, 0.138254954376
_CODES = {
    1: (1.0, 1.0), 2: (1 / 0.3048, 1 / _POUND), 3: (1.0, 1 / 9.80665), 4: (1 / 0.3048, 1 / _POUNDAL),
    5: (1e3, 1e3), 6: (1e2, 1e2), 7: (1 / 0.0254, 1 / _POUND), 8: (1e3, 1 / 9.80665), 10: (1e3, 1.0),
}  # fmt: skip
_SAME = 1e-3  # relative difference of factors that is one of digits


@dataclass(frozen=True)
class System:
    """Units of a file (data set 164).

    Parameters
    ----------
    length, force : float
        Metres and newtons of its units.
    name : str
    """

    length: float
    force: float
    name: str = ""


def system_of(block: Block, place: Place) -> System:
    """Units of data set 164.

    Raises
    ------
    InputError
        Factors that are missing, not positive, or contradict the code of the system.
    """
    first, _, rest = block.body.partition(b"\n")
    found = numbers(rest, place, block.at + len(first) + 1)
    text = text_of(first)
    code, name = text[:10].strip(), text[10:30].strip()
    if len(found) < 3 or not all(math.isfinite(f) and f > 0 for f in found[:2]):
        place.refuse(
            "data set 164 gives no units",
            block.at,
            f"factors {', '.join(f'{f:g}' for f in found[:4]) or 'none'}",
            "positive factors of length, force and temperature",
        )
    length, force = float(found[0]), float(found[1])
    known = _CODES.get(int(code)) if code.isascii() and code.isdecimal() and len(code) < 9 else None
    if known and (abs(length / known[0] - 1) > _SAME or abs(force / known[1] - 1) > _SAME):
        place.refuse(
            "data set 164 contradicts itself",
            block.at,
            f"code {code} ({name}) with the factors {length:g} and {force:g}",
            f"{known[0]:g} and {known[1]:g}, which this code stands for",
            "correct the code, or set it to 9 (user defined)",
        )
    return System(1.0 / length, 1.0 / force, name)


def unit_of(axis: AxisRecord, direction: int, system: System | None) -> StatedUnit:
    """Unit of an ordinate: the text of its axis, else its type in the system of the file; never a guess.

    A text and a type that contradict each other in their dimension, or in the size that data set 164 gives, leave the
    unit open.
    """
    form = _TYPES.get(axis.type)
    turning = 4 <= abs(direction) <= 6
    derived = None if form is None else _symbol(form[turning], system or System(1.0, 1.0))
    quantity = None if derived is None else derived.quantity
    text = _bare(axis.unit)
    if text and units.known(text):
        stated = units.parse(text)
        if derived is not None and stated.dimension != derived.dimension:
            return StatedUnit(None, None, f"data type {axis.type} is {derived.quantity}, and its unit reads {text!r}")
        if derived is not None and system is not None and abs(stated.factor / derived.factor - 1) > _SAME:
            return StatedUnit(None, quantity, f"its unit reads {text!r}, and data set 164 makes it {derived.symbol}")
        return StatedUnit(stated, stated.quantity)
    why = f"its unit reads {text!r}, which is not known" if text else "its axis names no unit"
    if derived is None:
        return StatedUnit(None, None, f"{why}, and data type {axis.type} tells none")
    if system is None:
        return StatedUnit(None, quantity, f"{why}, and there is no data set 164")
    return StatedUnit(derived, quantity)


def ratio(text: str) -> tuple[str, str] | None:
    """Units of response and reference in one text: ``g/N``, ``(m/s^2)/N``, ``(1/N)*(m/s^2)``; None where it is none."""
    inverse = re.fullmatch(r"\(?1/([^()*]+)\)?\s*\*\s*(.+)", text.strip())
    left, slash, right = (inverse[2], "/", inverse[1]) if inverse else text.strip().rpartition("/")
    left, right = _bare(left), _bare(right)
    if not (slash and units.known(left) and units.known(right)):
        return None
    return (left, right) if units.parse(right).quantity in ("force", "moment") else None


def _bare(text: str) -> str:
    """A text without the brackets around it."""
    text = text.strip()
    return text[1:-1].strip() if re.fullmatch(r"\([^()]*\)", text) else text


def _symbol(form: str, system: System) -> units.Unit:
    """Unit of a pattern: with symbols where length and force have one, else with its factor alone."""
    length = _named(_LENGTHS, system.length)
    force = _named(_FORCES, system.force)
    if (length or "{L}" not in form) and (force or "{F}" not in form):
        return units.parse(form.format(L=length, F=force))
    si = units.parse(form.format(L="m", F="N"))
    factor = 1.0
    for mark, size in (("{L}", system.length), ("{F}", system.force)):
        if mark in form:
            factor *= size ** _power(form, mark)
    return units.Unit(f"{factor:.9g} {si.symbol}", factor, si.dimension, si.quantity)


def _power(form: str, mark: str) -> int:
    over, _, under = form.partition("/")
    if mark in over:
        return 1
    return -2 if f"{mark}^2" in under else -1


def _named(symbols: tuple[str, ...], size: float) -> str | None:
    """Symbol of a unit of this size in SI."""
    return next((s for s in symbols if abs(units.parse(s).factor / size - 1) <= 1e-6), None)


BUDGET = 2**31  # bytes of a file
SUFFIXES = (".uff", ".unv", ".ufb", ".bunv")
_SKIPPED = {
    18: "coordinate systems", 55: "shapes", 82: "trace lines", 2411: "nodes", 2412: "elements", 2414: "results",
    2420: "coordinate systems", 2467: "groups",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class UffFile:
    """What a universal file holds.

    Parameters
    ----------
    path : str
    functions : tuple of Function
        Data sets 58 and 58b, in the order of the file.
    system : System or None
        Units of the file (data set 164).
    nodes : dict of int to array (3,)
        Places of the nodes (data set 15) in the length unit of the file.
    title : str
        Name and description (data set 151).
    skipped : dict of int to int
        How many data sets of other numbers there are.
    notes : tuple of str
    """

    path: str
    functions: tuple[Function, ...]
    system: System | None = None
    nodes: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    title: str = ""
    skipped: dict[int, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def holds(self) -> str:
        """Its functions in words: ``15 FRFs, 2 coherences``."""
        found = Counter(f.name for f in self.functions)
        return ", ".join(f"{n} x {name}" for name, n in found.items()) or "no function"


def read_uff(path: str | os.PathLike[str]) -> UffFile:
    """All data sets of a universal file.

    Parameters
    ----------
    path : path
        Text or binary, either byte order; IEEE 754 numbers.

    Raises
    ------
    InputError
        The file is missing, too large, truncated (it says how many samples are left), or damaged; it names the line.
    """
    place = as_path(path)
    try:
        size = place.stat().st_size
        data = place.read_bytes() if size <= BUDGET else b""
    except OSError as error:
        raise InputError(
            "the file cannot be read",
            where=str(place),
            found=error.strerror or error,
            expected="a universal file",
            hint="check the path",
        ) from None
    if size > BUDGET:
        raise InputError("the file is too large", where=str(place), found=f"{size} bytes", expected=f"{BUDGET} bytes")
    return parse_uff(data, str(place))


def parse_uff(data: bytes, path: str) -> UffFile:
    """All data sets of the bytes of a universal file; errors as for `read_uff`."""
    place = Place(path, data)
    functions: list[Function] = []
    nodes: dict[int, NDArray[np.float64]] = {}
    systems: list[System] = []
    title, skipped = "", Counter[int]()
    for block in split(place):
        if block.number == 58:
            functions.append(function_of(block, place))
        elif block.number == 15:
            nodes |= _nodes(block, place)
        elif block.number == 164:
            systems.append(system_of(block, place))
        elif block.number == 151:
            title = title or _title(block)
        else:
            if is_function(block, place):
                place.refuse(
                    "a data set has the records of a function and another number",
                    block.at,
                    f"number {block.number}",
                    "58",
                    "its number is damaged: export or transfer the file again",
                )
            skipped[block.number] += 1
    if len(set(systems)) > 1:
        raise InputError(
            "two systems of units in one file",
            where=path,
            found=" and ".join(f"{s.name or 'unnamed'} ({s.length:g} m, {s.force:g} N)" for s in systems[:2]),
            expected="one data set 164",
            hint="split the file",
        )
    notes = tuple(f"skipped: {n} x data set {k} ({_SKIPPED.get(k, 'unknown')})" for k, n in sorted(skipped.items()))
    return UffFile(path, tuple(functions), systems[0] if systems else None, nodes, title, dict(skipped), notes)


def _nodes(block: Block, place: Place) -> dict[int, NDArray[np.float64]]:
    """Places of the nodes of data set 15: a line of four integers and three coordinates each."""
    found = numbers(block.body, place, block.at)
    if found.size % 7 or not np.all(np.isfinite(found)) or np.any(found[::7] != np.rint(found[::7])):
        place.refuse(
            "data set 15 holds no nodes",
            block.at,
            f"{found.size} numbers",
            "for each node its number, three integers and three coordinates",
        )
    return {int(row[0]): row[4:] for row in found.reshape(-1, 7)}


def _title(block: Block) -> str:
    lines = [text_of(line).strip() for line in block.body.split(b"\n")[:2]]
    return ", ".join(line for line in lines if line and line.upper() != "NONE")
