"""Universal files (UFF, UNV): functions (58, 58b), nodes (15), units (164) and header (151); all else is counted.

A file is read whole or refused: every data set must reach its end mark and hold as many values as it declares. What
no reader can see is a file that was cut exactly between two data sets.
"""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..storage import as_path
from .uff_blocks import Block, split
from .uff_functions import Function, function_of
from .uff_records import Place, numbers, text_of
from .uff_units import System, system_of

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


def read_uff(path: str | os.PathLike) -> UffFile:
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
