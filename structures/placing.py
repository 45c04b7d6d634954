"""Sensors and loads on a structure: the rows and columns that they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .bases.basis import Basis
from .channels import Channel
from .errors import InputError
from .loads import Load, sparse_matrix
from .statespace import channels
from .structure import Structure


def placed(given: Sequence[Any], method: str, where: str, other: str = "") -> tuple[Channel, ...]:
    """Sensors or loads as channels: each has the `method` (or the `other`) that gives its row or column.

    Raises
    ------
    InputError
        If there is none, one is something else, or two share a label.
    """
    if isinstance(given, Channel | str) or not hasattr(given, "__iter__"):
        given = [given]
    items = list(given)
    wrong = [x for x in items if not (isinstance(x, Channel) and (hasattr(x, method) or (other and hasattr(x, other))))]
    if wrong or not items:
        raise InputError(
            f"no {where[:-1]}" if items else f"no {where}",
            where=where,
            found=repr(wrong[0]) if wrong else "an empty list",
            expected=f"objects of structures.{where}",
            hint='[sensors.Accelerometer("12+Z")]' if where == "sensors" else '[loads.Point("12+Z")]',
        )
    return channels(items, len(items), "", where)


def rows(structure: Structure, sensors: Sequence[Any]) -> sparse.csr_array:
    """Rows of the sensors over the free DOFs, sparse (sensors, n_free), one dense row at a time.

    Raises
    ------
    InputError
        If a row holds NaN or infinity.
    """
    parts = [(np.flatnonzero(values), values) for values in (s.row(structure) for s in sensors)]
    starts = np.cumsum([0, *(len(at) for at, _ in parts)])
    entries = np.concatenate([values[at] for at, values in parts])
    every = sparse.csr_array(
        (entries, np.concatenate([at for at, _ in parts]), starts), shape=(len(parts), structure.n)
    )
    _finite(every.data)
    return every[:, structure.free].tocsr()


def columns(structure: Structure, loads: Any) -> Any:
    """Load columns: sparse (n_free, loads), or dense (samples, n_free, loads) where one moves.

    Raises
    ------
    InputError
        If a column holds NaN or infinity, a load acts on a supported DOF alone, or loads that move differ in length.
    """
    found = _columns(structure, loads)
    _finite(found.data if sparse.issparse(found) else found)
    return found


def _columns(structure: Any, loads: Any) -> Any:
    free = structure.free
    if isinstance(loads, Basis):
        return loads.columns(structure)[free].tocsc()
    fixed = [x for x in loads if isinstance(x, Load) and not hasattr(x, "columns")]
    still = sparse_matrix(structure, fixed)  # names every load on a supported DOF at once
    if len(fixed) == len(loads):
        return still[free].tocsc()
    parts = [
        (load.columns if hasattr(load, "columns") else load.column)(structure)[..., free]  # the one that it has
        for load in loads
    ]
    lengths = {len(part) for part in parts if part.ndim == 2}
    if not lengths:
        return sparse.csc_array(np.array(parts).T)
    if len(lengths) > 1:
        raise InputError(
            "loads that move differ in length",
            where="loads",
            found=sorted(lengths),
            expected="one length",
            hint="give every path the samples of the record",
        )
    length = lengths.pop()
    return np.stack([np.broadcast_to(part, (length, free.size)) for part in parts], axis=-1)


def arrays(matrix: Any) -> tuple[NDArray, ...]:
    """Arrays that a matrix is made of, in one form for equal matrices."""
    if not sparse.issparse(matrix):
        return (matrix,)
    coo = matrix.tocoo()
    order = np.lexsort(coo.coords)
    return tuple(np.asarray(part)[order] for part in (coo.data, *(c.astype(np.int64) for c in coo.coords)))


def _finite(values: NDArray) -> None:
    """A row or a column that holds NaN is named at once, not found in a result."""
    if not np.all(np.isfinite(values)):
        raise InputError(
            "a sensor row or a load column holds NaN or infinity",
            where="ForwardModel",
            found="NaN or infinity",
            expected="finite numbers",
            hint="check the places and the fibres of sensors and loads",
        )
