"""Modes as files: universal files (data sets 55, with nodes 15 and 2411 and units 164), and tables of text.

Data set 55: *Universal File Data Sets*, Structural Dynamics Research Corporation; records 6 to 8 and pairs of node and
values.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..._channels import Dof
from .. import _uff as uff
from .._text import code_of
from .._uff_datasets import Block, split
from .._uff_records import Place, numbers, text_of
from ._parts import CUT, Array, Labels, Parts, Shapes, data_of, keyed, refuse, table
from ._parts import text_of as text

MODAL = 2  # analysis type of data set 55
COMPLEX = 3
GLOBAL = 1  # coordinate systems up to this one are the global one
TITLES = 5


@dataclass(frozen=True, eq=False)
class Mode:
    """One mode as a file has it: Hz, modal mass (0 where it is not said), ratio, motions of some labels."""

    frequency: float
    mass: float
    damping: float
    labels: Labels
    values: Array


def together(modes: list[Mode], where: str) -> Shapes:
    """Modes with the same degrees of freedom as one table, ascending by frequency.

    Raises
    ------
    InputError
        No mode, other degrees of freedom in one of them, a frequency or mass that is none.
    """
    if not modes:
        refuse("the file holds no modes", where, "none", "at least one", "export normal modes with their shapes")
    modes = sorted(modes, key=lambda m: m.frequency)
    order = [np.argsort(keyed(m.labels), kind="stable") for m in modes]
    labels = modes[0].labels[order[0]]
    for number, (mode, o) in enumerate(zip(modes, order, strict=True), 1):
        if len(np.unique(keyed(mode.labels))) < len(mode.labels):
            refuse("a degree of freedom twice in one mode", f"{where}, mode {number}", "the same node again", "once")
        if mode.labels.shape != labels.shape or np.any(mode.labels[o] != labels):
            refuse("the modes have other degrees of freedom", f"{where}, mode {number}",
                   f"{len(mode.labels)} of them", f"the {len(labels)} of the first")  # fmt: skip
        if not (np.isfinite(mode.frequency) and mode.frequency >= 0 and mode.mass >= 0 and mode.damping >= 0):
            refuse("no mode", f"{where}, mode {number}", f"{mode.frequency:g} Hz, mass {mode.mass:g}, "
                   f"damping {mode.damping:g}", "frequency, modal mass and damping >= 0")  # fmt: skip
    shapes = np.column_stack([m.values[o] for m, o in zip(modes, order, strict=True)])
    if not np.isfinite(shapes).all():
        refuse("NaN or infinity in a mode shape", where, f"{int(np.sum(~np.isfinite(shapes)))} values", "numbers")
    mass, damping = np.array([m.mass for m in modes]), np.array([m.damping for m in modes])
    return Shapes(np.array([m.frequency for m in modes]), shapes, labels, mass if np.all(mass > 0) else None,
                  damping if np.any(damping > 0) else None)  # fmt: skip


# -- universal files ---------------------------------------------------------------------------------------------------
def universal(path: Path) -> Parts:
    """Modes, nodes and units of a universal file.

    Raises
    ------
    InputError
        A file that is cut or damaged; complex modes; neither modes nor nodes.
    """
    place = Place(str(path), data_of(path))
    modes: list[Mode] = []
    nodes: dict[int, NDArray[np.float64]] = {}
    elsewhere = turned = 0
    systems: list[uff.System] = []
    for block in split(place):
        if block.number == 55 and (mode := _mode(block, place)) is not None:
            modes.append(mode)
        elif block.number in (15, 2411, 781):
            rows = _nodes(block, place)
            nodes |= {int(row[0]): row[4:] for row in rows}
            elsewhere += int(np.sum(rows[:, 1] > GLOBAL))
            turned += int(np.sum(rows[:, 2] > GLOBAL))
        elif block.number == 164:
            systems.append(uff.system_of(block, place))
    if not modes and not nodes:
        refuse("neither modes nor nodes", str(path), "other data sets", "data sets 55, and 15 or 2411")
    notes = []
    if elsewhere:
        notes.append(f"{path.name}: {elsewhere} nodes stand in a coordinate system of their own: no places read")
    if turned:
        notes.append(f"{path.name}: {turned} nodes have directions of their own: labels follow these")
    known, unplaced = ([], sorted(nodes)) if elsewhere else (sorted(nodes), [])
    scale = (systems[0].length, systems[0].force) if systems else None
    return Parts(
        nodes=np.array(known, np.int64), places=np.array([nodes[n] for n in known], float).reshape(-1, 3),
        unplaced=np.array(unplaced, np.int64), notes=tuple(notes),
        modes=together(modes, str(path)) if modes else None, scale=scale,
    )  # fmt: skip


def _nodes(block: Block, place: Place) -> NDArray[np.float64]:
    """Number, coordinate systems of its place and its motions, colour, and place of every node."""
    found = numbers(block.body, place, block.at)
    if found.size % 7 or not np.all(np.isfinite(found)) or np.any(found[::7] != np.rint(found[::7])):
        place.refuse(f"data set {block.number} holds no nodes", block.at, f"{found.size} numbers",
                     "for each node its number, three integers and three coordinates")  # fmt: skip
    return found.reshape(-1, 7)


def _mode(block: Block, place: Place) -> Mode | None:
    """Mode of a data set 55; None where it holds results of another analysis."""
    lines = block.body.split(b"\n")
    if len(lines) < TITLES + 4:
        place.refuse(CUT, block.at, f"{len(lines)} records", "eight records, and the shape")
    at = [block.at]
    for line in lines:
        at.append(at[-1] + len(line) + 1)
    kinds = _whole(lines[TITLES], place, at[TITLES], 6)
    analysis, each, data_type, values = kinds[1], kinds[2], kinds[4], kinds[5]
    if analysis not in (MODAL, COMPLEX):
        return None
    if analysis == COMPLEX or data_type != 2:
        place.refuse("complex modes", block.at, f"analysis type {analysis}, data type {data_type}",
                     "normal modes with real shapes (2 and 2)", "export normal modes")  # fmt: skip
    if (each, values) not in ((2, 3), (3, 6), (1, 1)):
        place.refuse("a shape of another kind", block.at, f"characteristic {each}, {values} values for each node",
                     "3 translations, or 3 and 3 rotations")  # fmt: skip
    sizes = _whole(lines[TITLES + 1], place, at[TITLES + 1], 2)
    counts = numbers(lines[TITLES + 2], place, at[TITLES + 2])
    if sizes[1] < 4 or len(counts) < 4:
        place.refuse(CUT, at[TITLES + 2], text_of(lines[TITLES + 2])[:60], "frequency, modal mass, damping ratios")
    first = TITLES + 2 + -(-sizes[1] // 6)
    rest = numbers(b"\n".join(lines[first:]), place, at[first])
    if rest.size == 0 or rest.size % (values + 1):
        place.refuse(CUT, at[first], f"{rest.size} numbers", f"a node and {values} values, again and again")
    rows = rest.reshape(-1, values + 1)
    if np.any(rows[:, 0] != np.rint(rows[:, 0])) or np.any(rows[:, 0] < 0):
        place.refuse("no number of a node", at[first], "a fraction", "whole numbers")
    node = np.repeat(rows[:, 0].astype(np.int64), values)
    code = np.tile(np.arange(1, values + 1) if values > 1 else np.array([0]), len(rows))
    return Mode(counts[0], counts[1], counts[2], np.column_stack([node, code]), rows[:, 1:].ravel())


def _whole(line: bytes, place: Place, at: int, count: int) -> list[int]:
    found = numbers(line, place, at)
    if len(found) < count or np.any(found[:count] != np.rint(found[:count])) or np.any(np.abs(found[:count]) > 1e6):
        place.refuse(CUT, at, text_of(line)[:60], f"{count} whole numbers")
    return [int(v) for v in found[:count]]


# -- tables ------------------------------------------------------------------------------------------------------------
def listed(path: Path) -> Parts:
    """Modes of a text table: a line ``frequency``, ``damping`` and ``mass`` each, then ``node, direction, shapes``.

    Raises
    ------
    InputError
        A line that is none: it is named; no line of frequencies.
    """
    where = str(path)
    heads: dict[str, list[float]] = {}
    labels: list[tuple[int, int]] = []
    rows: list[list[float]] = []
    for number, raw in enumerate(text(path).splitlines(), 1):
        words = [w.strip() for w in raw.split("#", 1)[0].replace(";", ",").replace("\t", ",").split(",")]
        at = f"{where}, line {number}"
        if not any(words):
            continue
        name = words[0].lower()
        if name in ("frequency", "damping", "mass"):
            heads[name] = _floats([w for w in words[1:] if w], at)
        elif name.isdigit() and len(words) > 2:
            code = Dof(int(name), code_of(int(words[1]) if words[1].lstrip("+-").isdigit() else words[1].upper()))
            labels.append((code.node, code.axis))
            rows.append([code.sign * v for v in _floats(words[2:], at)])
        elif labels or heads:
            refuse("no line of a table of modes", at, repr(raw[:50]), "node, direction, and a number for each mode",
                   "12, +Z, 0.1, -0.2")  # fmt: skip
    count = len(heads.get("frequency", ()))
    lengths = {len(r) for r in rows} | {len(v) for v in heads.values()}
    if not count or not rows or lengths != {count}:
        refuse("no table of modes", where, f"{count} frequencies, {len(rows)} rows of {sorted(lengths)} numbers",
               "a line frequency, and one row for each degree of freedom",
               "frequency, , 96.5, 338.6, and then 12, +Z, 0.1, -0.2")  # fmt: skip
    whole = np.array(rows)
    modes = [
        Mode(heads["frequency"][k], heads.get("mass", [0.0] * count)[k], heads.get("damping", [0.0] * count)[k],
             np.array(labels, np.int64), whole[:, k])
        for k in range(count)
    ]  # fmt: skip
    return Parts(modes=together(modes, where))


def _floats(words: list[str], where: str) -> list[float]:
    return table(" ".join(words) + "\n", len(words), where)[0].tolist() if words else []
