"""MAT files: a matrix is a record, vectors are the channels of one; structs of Simcenter Testlab.

Level 5 (-v6, -v7) is parsed by the package, 7.3 is HDF5 and therefore read in the child. MATLAB has no vectors: a
matrix with one row or one column is taken as one. Complex arrays, cells and other structs are no records; FRFs are a
model, which ``structures.files.read_frfs`` reads.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.files._mat_level5 import is_level5, read_level5, read_structs

from .arrays import Walk, tables_of
from .curves import of_structs, tree_of
from .source import Options, Source, Table, register

_HDF5_MARKS = (b"\x00\x02IM", b"\x02\x00MI")


@register("MAT", suffixes=(".mat",), sniff=is_level5)
def load_level5(source: Source, options: Options) -> list[Table]:
    """Records of a file that MATLAB wrote with -v6 or -v7."""
    arrays, others = read_level5(source.data(), str(source.path))
    if "struct" in others.values() and (found := of_structs(read_structs(source.data(), str(source.path)), source)):
        return found
    return _tables(arrays, others, source, options)


@register("MAT 7.3", suffixes=(".mat",), sniff=lambda head: head[124:128] in _HDF5_MARKS, native=True)
def load_hdf5(source: Source, options: Options) -> list[Table]:
    """Records of a file that MATLAB wrote with -v7.3: the variables at its root, with their axes turned back."""
    import h5py

    arrays: dict[str, NDArray[Any]] = {}
    others: dict[str, str] = {}
    structs: dict[str, Any] = {}
    with h5py.File(source.place or source.path, "r") as file:
        walk = Walk(source, options)
        for name in file:
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                source.refuse("a link leaves the file", name, "a file that holds its own data")
            item = file[name]
            values = walk.dataset(item, name) if isinstance(item, h5py.Dataset) else None
            if isinstance(item, h5py.Group) and item.attrs.get("MATLAB_class") == b"struct":
                structs[name] = tree_of(walk, item, name, 0)
            if values is None:
                others[name] = "struct, cell or complex"
            elif item.attrs.get("MATLAB_class") == b"char":
                arrays[name] = np.array("".join(map(chr, np.ravel(values).astype(int).tolist())))
            else:
                arrays[name] = values.T
    if found := of_structs(structs, source):
        return found
    return _tables(arrays, others, source, options)


def _tables(arrays: dict[str, NDArray[Any]], others: dict[str, str], source: Source, options: Options) -> list[Table]:
    flat = {name: _flat(x) for name, x in arrays.items()}
    found = tables_of(flat, source, options)
    passed = [f"{name} ({word})" for name, word in others.items()]
    passed += [f"{k} (complex)" for k, x in flat.items() if x.dtype.kind == "c"]
    passed += [f"{k} ({x.ndim} axes)" for k, x in flat.items() if x.dtype.kind in "fiu" and x.ndim > 2]
    if not found:
        source.refuse(
            "the file holds no record",
            ", ".join([*passed, *(f"{k} ({x.size} values)" for k, x in flat.items())][:30]) or "no variable",
            "matrices or vectors of real numbers",
            "save plain arrays: x = log.x; save('log.mat', 'x', 'fs'); structures.files.read_frfs reads FRFs",
        )
    note = (f"passed over: {', '.join(passed[:20])}",) if passed else ()
    return [replace(table, notes=(*table.notes, *note)) for table in found]


def _flat(x: NDArray[Any]) -> NDArray[Any]:
    """A matrix of one row or one column as a vector, of one entry as a number."""
    if x.dtype.kind == "U" or x.ndim > 2:
        return x
    return x.reshape(()) if x.size == 1 else np.ravel(x) if min(x.shape, default=0) == 1 else x
