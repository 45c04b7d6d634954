"""Functions that a file holds one by one as records: archives of SDynPy, structs of Simcenter Testlab.

Time responses over one time base are the channels of one record; what is over frequency is no record, and said so.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from structures import units as _units
from structures._advice import Advice, either
from structures.files._curves import TIME, Trace, held, read_sdynpy
from structures.files._frf_text import described, pairs_of, parted
from structures.files._recorded import StatedUnit
from structures.files._simcenter import blocks_of, curves_of

from .settle import distinct
from .source import COLUMNS, Source, Table

DEPTH, PARTS = 12, 100_000  # levels and parts of structs
MODEL = Advice(
    "FRFs are a model: ",
    either("structures.files.read_frfs reads them", "loadid model import FILE -o model.h5, then --model model.h5"),
)


def of_sdynpy(source: Source) -> list[Table]:
    """Records of an archive that SDynPy saved.

    Raises
    ------
    InputError
        It is damaged, or holds no time response.
    """
    return _tables(read_sdynpy(source.path), source)


def of_structs(structs: dict[str, Any], source: Source) -> list[Table]:
    """Records of a MAT file with structs of Simcenter Testlab; none where no struct has their form.

    Raises
    ------
    InputError
        It is damaged, or all of these structs are over frequency.
    """
    blocks = list(blocks_of(structs))
    return _tables([c for name, b in blocks for c in curves_of(name, b, str(source.path))], source) if blocks else []


def tree_of(walk: Any, item: Any, place: str, depth: int) -> Any:
    """A struct, a cell or an array of a MAT file of version 7.3, as `read_structs` gives those of level 5.

    A struct is a group, a text a dataset of characters, a cell one of references into the same file.

    Raises
    ------
    InputError
        Structs that are nested too deep or hold too much, and what `Walk.dataset` refuses.
    """
    import h5py

    walk.parts += 1
    if depth > DEPTH or walk.parts > PARTS:
        walk.source.refuse("structs are nested too deep, or hold too much", place, f"{DEPTH} levels, {PARTS} parts")
    if isinstance(item, h5py.Group):
        links = {name: item.get(name, getlink=True) for name in item}
        return {
            name: tree_of(walk, item[name], f"{place}/{name}", depth + 1)
            for name, link in links.items()
            if isinstance(link, h5py.HardLink)
        }
    if not isinstance(item, h5py.Dataset):
        return None
    if h5py.check_ref_dtype(item.dtype) is h5py.Reference:
        if item.external or item.is_virtual or (item.size or 0) > PARTS:
            walk.source.refuse("a cell lies outside the file, or holds too much", place, f"{PARTS} parts in the file")
        return [tree_of(walk, item.file[ref], place, depth + 1) for ref in item[()].T.ravel(order="F") if ref]
    values = walk.dataset(item, place)
    if values is None:
        return None
    if item.attrs.get("MATLAB_class") == b"char":
        return "".join(map(chr, np.ravel(values).astype(int).tolist()))
    return values.T


def refuse_frfs(names: Sequence[str] | None, source: Source) -> None:
    """Nothing, unless the headings of a text table name FRFs over frequency.

    Raises
    ------
    InputError
        Says what the table is, and what reads it.
    """
    if pairs := pairs_of([parted(n)[0] for n in names or ()]):
        source.refuse("this is a table of FRFs over frequency, no record over time", described(pairs),
                      "samples over time", MODEL)  # fmt: skip


def _tables(curves: Sequence[Trace], source: Source) -> list[Table]:
    times = [c for c in curves if c.type == TIME]
    if not times:
        source.refuse("the file holds no time response", held(curves), "functions over time", MODEL)
    runs: list[list[Trace]] = []
    for curve in times:
        for run in runs:
            first = run[0]
            if first.step == curve.step and np.array_equal(first.x, curve.x) and not _has(run, curve):
                run.append(curve)
                break
        else:
            runs.append([curve])
    note = [f"of {held(curves)} only the time responses are read: {MODEL}"] if len(times) < len(curves) else []
    return [_table(run, "" if len(runs) == 1 else f"run {k + 1}", note, source) for k, run in enumerate(runs)]


def _has(run: list[Trace], curve: Trace) -> bool:
    return bool(curve.response) and any(c.response == curve.response for c in run)


def _table(run: list[Trace], name: str, notes: list[str], source: Source) -> Table:
    if len(run) > COLUMNS:
        source.refuse("too many channels", len(run), f"at most {COLUMNS}")
    if any(np.iscomplexobj(c.values) and np.any(c.values.imag) for c in run):
        source.refuse("a time response with complex values", run[0].response, "real samples", MODEL)
    labels = distinct([c.response for c in run])
    said = [f"{label}: {c.unit.why}" for label, c in zip(labels, run, strict=True) if c.unit.why]
    values = np.column_stack([np.real(c.values).astype(float) for c in run])
    texts = [_text(c.unit) for c in run]
    first = run[0]
    if first.step is not None:
        begin = [f"time begins at {first.x[0]:g} s in the file, at 0 in the record"] if first.x[0] else []
        return Table(values, name, labels, tuple(texts), dt=first.step, notes=(*notes, *said, *begin))
    stacked = np.column_stack((first.x, values))
    return Table(stacked, name, ("time", *labels), ("s", *texts), time=0, notes=(*notes, *said))


def _text(said: StatedUnit) -> str | None:
    """Symbol of a unit that the table of units has."""
    return said.unit.symbol if said.unit and _units.known(said.unit.symbol) else None
