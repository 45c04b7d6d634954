"""save: a Structure as npz or HDF5."""

from __future__ import annotations

import io
import os
from typing import Any

import numpy as np

from .. import storage
from ..damping import Modal, Rayleigh, Structural
from ..errors import InputError
from ..structure import Structure
from ..values import plain, shown
from .hdf5 import KIND


def save(structure: Structure, path: str | os.PathLike) -> None:
    """Write matrices, DOF table, coordinates, supports and damping to one file, whole or not at all.

    Parameters
    ----------
    structure : Structure
        The mesh between its nodes and the parts that `scaled` changes by name are not stored.
    path : path
        ``.npz`` (readable by NumPy alone), or ``.h5`` / ``.hdf5`` (with a checksum, readable by any HDF5 tool).

    Raises
    ------
    InputError
        If the suffix is another, or the file cannot be written.
    """
    place = storage.as_path(path)
    if not isinstance(structure, Structure):
        raise InputError(
            "no structure",
            where="files.save",
            found=shown(structure),
            expected="a Structure",
            hint="files.save(structure, path)",
        )
    suffix = place.suffix.lower()
    if suffix == ".npz":
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **_arrays(structure, "_"))  # type: ignore[arg-type]
        storage.replace(place, buffer.getvalue())
    elif suffix in (".h5", ".hdf5"):
        tree: dict[str, Any] = {}
        for name, value in _arrays(structure, "/").items():
            stem, _, part = name.rpartition("/")
            stored = value.tolist() if value.dtype.kind == "U" else value
            (tree.setdefault(stem, {}) if stem else tree)[part] = stored
        storage.write(place, tree, KIND)
    else:
        raise InputError(
            "a suffix that is not written",
            where=str(place),
            found=place.suffix or "none",
            expected=".npz, .h5 or .hdf5",
            hint='files.save(structure, "model.npz")',
        )


def _arrays(structure: Structure, mark: str) -> dict[str, np.ndarray]:
    out: dict[str, np.ndarray] = {}
    for name in ("K", "M", "C"):
        A = getattr(structure, name)
        if A is not None:
            parts = {"data": A.data, "indices": A.indices, "indptr": A.indptr, "shape": np.array(A.shape)}
            out |= {f"{name}{mark}{part}": np.asarray(plain(value)) for part, value in parts.items()}
    out["dofs"] = np.array([str(d) for d in structure.dofs], dtype=str)
    if structure.supports:
        out["supports"] = np.array([str(d) for d in structure.supports], dtype=str)
    if structure.coordinates is not None:
        out["coordinates"] = structure.coordinates
    if isinstance(structure.damping, Rayleigh):
        out["rayleigh"] = np.array([structure.damping.alpha, structure.damping.beta])
    elif isinstance(structure.damping, Modal):
        out["modal"] = np.asarray(structure.damping.ratios, float)
    elif isinstance(structure.damping, Structural):
        out["structural"] = np.array(structure.damping.eta)
    return out
