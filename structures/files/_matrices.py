"""Structures as files of K, M and C: load and save."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .. import units
from .._channels import TWIST, Dof
from .._system.damping import Damping, Modal, Rayleigh, Structural
from .._system.structure import Structure
from ..errors import InputError, plain, shown
from . import _storage as storage
from ._container import SPELLINGS, Container, open_npz
from ._hdf5 import KIND, open_hdf5
from ._mat_level5 import LEVEL5_BUDGET, is_level5, read_level5, read_sparse
from ._storage import as_path
from ._text import from_arrays, read_market, read_table

NAMES = ("K", "M", "C")
HDF5 = (".h5", ".hdf5", ".hdf", ".mat")
Files = str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | Mapping[str, str | os.PathLike[str]]


def load(
    path: Files,
    *,
    dofs: str | os.PathLike[str] | Sequence[Any] | None = None,
    supports: Iterable[Any] | None = None,
    coordinates: ArrayLike | None = None,
    damping: Damping | float | None = None,
    names: Mapping[str, str] | None = None,
    expand: bool = False,
    length_unit: str = "m",
    force_unit: str = "N",
) -> Structure:
    """Structure from K, M and C in npz, Matrix Market, MATLAB or HDF5 files.

    Parameters
    ----------
    path : path, list of paths, or dict
        ``"model.npz"``, ``"model.h5"``, ``"model.mat"`` (any version from -v6 on), or a file for each matrix:
        ``{"K": "stiff.mtx", "M": "mass.mtx"}``. Of a list, the file names say which is which (K.mtx, wing_M.mtx,
        stiffness.mtx).
    dofs : path or sequence of DOFs, optional
        The DOF of every row of K: a text file with lines ``node, direction[, x, y, z]``, or a list of labels. Else
        what the container holds under ``dofs`` (labels, or columns node and code) or ``nodes`` and ``directions``;
        without any, the unknowns are the scalars ``0+S, 1+S, ...``.
    supports : iterable of DOFs, optional
        DOFs that are held; else ``supports`` of the container.
    coordinates : array (nodes, dim), optional
        Places of the nodes in ascending order; else those of the DOF table, or ``coordinates`` of the container.
    damping : Rayleigh, Modal, Structural or float, optional
        As in `Structure`; else what `save` stored.
    names : dict, optional
        How the matrices are called in the container: ``{"K": "KAAX"}``.
    expand : bool
        The matrices hold one triangle only: complete them. Without it such a matrix is refused.
    length_unit, force_unit : str
        Units of the numbers: a model in mm and N (mass in t) is ``length_unit="mm"``. Time is in s and angles in rad.
        Matrices and coordinates become SI, each entry by the kind of its two DOFs.

    Returns
    -------
    Structure
        Without a mesh between its nodes: sensors and loads name DOFs.

    Raises
    ------
    InputError
        If a file is missing, damaged, no such file, or contradicts another; it names the file.

    Notes
    -----
    Nothing is unpickled. Sparse matrices are read as CSR or CSC (data, indices, indptr), COO (data, row, col) and
    MATLAB's (data, ir, jc), named ``K_data``, ``K.data`` or ``K/data``.
    """
    scale = _scale(length_unit, force_unit)
    asked = _names(names)
    files = _files(path)
    found, container = _single(next(iter(files.values())), asked) if "" in files else (_each(files, asked), None)
    where = ", ".join(str(p) for p in files.values())
    matrices = {name: _whole(A, name, expand, f"{where}, {name}") for name, A in found.items() if A is not None}
    table, places = _table(dofs, container)
    n = matrices["K"].shape[0]
    if table is not None and len(table) != n:
        raise InputError(
            "the DOF table does not fit the stiffness matrix",
            where=str(dofs) if isinstance(dofs, str | os.PathLike) else f"{where}, dofs",
            found=f"{len(table)} DOFs",
            expected=f"{n}, one per row of K",
            hint="list the DOF of every row, supported ones included; check that both come from one export",
        )
    if coordinates is not None:
        places = np.asarray(coordinates)
    elif places is None and container is not None:
        places = container.array("coordinates")
    held = _supports(supports, container)
    if damping is None and container is not None:
        damping = _damping(container)
    if scale != (1.0, 1.0):
        matrices = _in_si(matrices, table, scale, where)
        places = None if places is None else np.asarray(places, float) * scale[0]
    try:
        return Structure.from_matrices(
            matrices["K"], matrices.get("M"), matrices.get("C"), table, held, places, damping
        )
    except InputError as error:
        raise InputError(
            error.what,
            where=f"{where}: {error.where}" if error.where else where,
            found=error.found,
            expected=error.expected,
            hint=error.hint,
            code=error.code,
        ) from None


# -- which files ------------------------------------------------------------------------------------------------------
def _files(path: Any) -> dict[str, Path]:
    """File of each matrix, or one file under ""."""
    if isinstance(path, Mapping):
        unknown = [name for name in path if name not in NAMES]
        if unknown or "K" not in path:
            raise InputError(
                "no stiffness matrix K" if not unknown else "no such matrix",
                where="files.load",
                found=", ".join(map(str, path)) or "nothing",
                expected="K, and M and C where they are known",
                hint='{"K": "K.mtx", "M": "M.mtx"}',
            )
        return {name: _existing(p) for name, p in path.items()}
    if isinstance(path, Sequence) and not isinstance(path, str | bytes):
        if len(path) == 1:
            return {"": _existing(path[0])}
        return _by_name([_existing(p) for p in path])
    return {"": _existing(path)}


def _by_name(paths: Sequence[Path]) -> dict[str, Path]:
    out: dict[str, Path] = {}
    for path in paths:
        words = path.stem.replace("-", "_").replace(".", "_").split("_")
        kinds = [
            name for name in NAMES if any(w == name or w.lower() in (name.lower(), *SPELLINGS[name]) for w in words)
        ]
        if len(kinds) != 1 or kinds[0] in out:
            raise InputError(
                "the file's name does not say which matrix it holds" if len(kinds) != 1 else f"two files of {kinds[0]}",
                where=str(path),
                found=path.name,
                expected="one each of K (stiffness), M (mass), C (damping)",
                hint='say which: {"K": "first.mtx", "M": "second.mtx"}',
            )
        out[kinds[0]] = path
    if "K" not in out:
        raise InputError(
            "no stiffness matrix K",
            where="files.load",
            found=", ".join(p.name for p in paths) or "no file",
            expected="a file of K among them",
            hint='{"K": "stiff.mtx", "M": "mass.mtx"}',
        )
    return out


def _existing(given: Any) -> Path:
    path: Path = as_path(given)
    if not path.is_file():
        raise InputError(
            "no such file" if not path.exists() else "this is no file",
            where=str(path),
            found="a folder" if path.is_dir() else "nothing",
            expected="a .npz, .mtx, .mat or .h5 file",
            hint="check the path",
        )
    return path


def _open(path: Path) -> Container | None:
    """Container of a file; None for Matrix Market."""
    suffix = path.suffix.lower()
    with path.open("rb") as file:
        head = file.read(128)
    if suffix == ".mtx" or head[:14].lower() == b"%%matrixmarket":
        return None
    if suffix == ".npz" or head[:2] == b"PK":
        return open_npz(path)
    if is_level5(head):
        return _level5(path)
    if suffix in HDF5 or head[1:4] == b"HDF" or head.startswith(b"loadid-hdf5"):
        return open_hdf5(path)
    raise InputError(
        "a file of a kind that is not read",
        where=str(path),
        found=path.suffix or "no suffix",
        expected=".npz, .mtx, .mat, .h5 or .hdf5",
        hint="export K and M as Matrix Market or npz",
    )


def _level5(path: Path) -> Container:
    """Arrays of a file that MATLAB wrote with -v6 or -v7, sparse ones in their parts."""
    if path.stat().st_size > LEVEL5_BUDGET:
        raise InputError("the file is too large", where=str(path), found=f"{path.stat().st_size} bytes",
                         expected=f"at most {LEVEL5_BUDGET} bytes", hint="save it with -v7.3")  # fmt: skip
    data = path.read_bytes()
    arrays, others = read_level5(data, str(path))
    found: dict[str, Any] = {name: partial(np.asarray, values) for name, values in arrays.items()}
    if "sparse" in others.values():
        for name, parts in read_sparse(data, str(path)).items():
            found |= {f"{name}/{part}": partial(np.asarray, values) for part, values in parts.items()}
    if not found:
        raise InputError(
            "a MAT file without matrices", where=str(path),
            found=", ".join(f"{name} ({kind})" for name, kind in list(others.items())[:12]) or "nothing",
            expected="K, and M and C where they are known, as full or sparse matrices",
            hint="save them as variables of their own: save('model.mat', 'K', 'M')",
        )  # fmt: skip
    return Container(str(path), found, {})


def _single(path: Path, names: Mapping[str, str]) -> tuple[dict[str, Any], Container | None]:
    """All matrices of one file."""
    container = _open(path)
    if container is None:
        return {"K": read_market(path)}, None
    if container.matrices() == [""]:
        return {"K": container.matrix("")}, container
    found = {name: container.named(name, names.get(name)) for name in NAMES}
    if found["K"] is None:
        raise container.missing("K", "K")
    return {name: None if own is None else container.matrix(own) for name, own in found.items()}, container


def _each(files: Mapping[str, Path], names: Mapping[str, str]) -> dict[str, Any]:
    """One matrix of each file."""
    out: dict[str, Any] = {}
    for name, path in files.items():
        container = _open(path)
        if container is None:
            out[name] = read_market(path)
            continue
        known = container.matrices()
        own = known[0] if len(known) == 1 and name not in names else container.named(name, names.get(name))
        if own is None:
            raise container.missing(name, name)
        out[name] = container.matrix(own)
    return out


def _names(names: Any) -> Mapping[str, str]:
    wrong = names is not None and not isinstance(names, Mapping)
    if wrong or any(k not in NAMES or not isinstance(v, str) for k, v in (names or {}).items()):
        raise InputError(
            "names of no matrices",
            where="files.load, names",
            found=shown(names),
            expected='a dictionary with keys K, M, C: {"K": "stiff"}',
            hint="leave it out where the file calls them K, M and C",
        )
    return names or {}


# -- what is in them --------------------------------------------------------------------------------------------------
def _whole(A: Any, name: str, expand: bool, where: str) -> sparse.csr_array:
    """The matrix, completed or refused where it holds one triangle only."""
    A = sparse.csr_array(A)
    A.sum_duplicates()
    A.eliminate_zeros()
    below, above = sparse.tril(A, -1), sparse.triu(A, 1)
    if bool(below.nnz) == bool(above.nnz):
        return A
    if expand:
        half = below if below.nnz else above
        return (A + half.T).tocsr()
    side, other = ("lower", "upper") if below.nnz else ("upper", "lower")
    raise InputError(
        f"only the {side} triangle of {name} is stored",
        where=where,
        found=f"{max(below.nnz, above.nnz)} entries in the {side} triangle, none in the {other}",
        expected="the whole symmetric matrix",
        hint="expand=True completes every matrix that holds one triangle",
    )


def _table(dofs: Any, container: Container | None) -> tuple[list[Dof] | None, NDArray[Any] | None]:
    if isinstance(dofs, str | os.PathLike):
        return read_table(_existing(dofs))
    if dofs is not None:
        return [Dof.parse(d) for d in dofs], None
    if container is None:
        return None, None
    labels, nodes, directions = (container.array(name) for name in ("dofs", "nodes", "directions"))
    return from_arrays(labels, nodes, directions, f"{container.path}, dofs"), None


def _supports(supports: Iterable[Any] | None, container: Container | None) -> list[Dof]:
    if supports is not None:
        return [Dof.parse(d) for d in ([supports] if isinstance(supports, str) else supports)]
    stored = None if container is None else container.array("supports")
    if container is None or stored is None or stored.size == 0:
        return []
    return from_arrays(stored, None, None, f"{container.path}, supports") or []


def _damping(container: Container) -> Damping | None:
    rayleigh, modal, structural = (container.array(name) for name in ("rayleigh", "modal", "structural"))
    if rayleigh is not None and rayleigh.shape == (2,):
        return Rayleigh(float(rayleigh[0]), float(rayleigh[1]))
    if modal is not None:
        return Modal(float(modal) if modal.ndim == 0 else modal.tolist())
    if structural is not None and structural.size == 1:
        return Structural(float(structural.reshape(())))
    return None


# -- units ------------------------------------------------------------------------------------------------------------
def _scale(length: str, force: str) -> tuple[float, float]:
    """Metres and newtons of one unit of length and of force."""
    return (
        units.check(length, "displacement", channel="length_unit").factor,
        units.check(force, "force", channel="force_unit").factor,
    )


def _in_si(
    matrices: dict[str, sparse.csr_array], table: Sequence[Dof] | None, scale: tuple[float, float], where: str
) -> dict[str, sparse.csr_array]:
    """Matrices in SI: an energy is force times length, and each unknown has its own length."""
    if table is None or any(dof.axis == 0 for dof in table):
        raise InputError(
            "units need a DOF table: a translation and a rotation scale differently",
            where=where,
            found="unknowns without a direction",
            expected="dofs= with the direction of every row",
            hint="give dofs=, or matrices in SI",
        )
    length, force = scale
    unknown = np.array([1 / length if dof.axis == TWIST else 1.0 if dof.is_rotation else length for dof in table])
    weight = sparse.diags_array(1 / unknown)
    return {name: (force * length * (weight @ A @ weight)).tocsr() for name, A in matrices.items()}


def save(structure: Structure, path: str | os.PathLike[str]) -> None:
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
