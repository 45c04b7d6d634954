"""read_fe: files of a solver as one model, labelled by its node numbers and in SI."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ... import units as unit_table
from ..._advice import Advice, Spelling, either
from ..._channels import Dof
from ..._elements.members import Material
from ...errors import InputError, numbers, shown
from .._storage import as_path
from .._text import read_market, read_table
from . import _boeing, _bulk, _mesh, _op2, _op4, _rows, _shapes
from ._model import FeModel, rows_of
from ._parts import Matrix, Parts, Shapes, keyed, named_parts, refuse

Files = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
READERS: dict[str, Callable[[Path], Parts]] = {
    ".op4": _op4.read, ".op2": _op2.read, ".pch": _bulk.read, ".bdf": _bulk.read, ".nas": _bulk.read,
    ".dat": _bulk.read, ".sti": _rows.calculix, ".mas": _rows.calculix, ".dof": _rows.calculix, ".inp": _rows.inp,
    ".hb": _boeing.read, ".rsa": _boeing.read, ".rua": _boeing.read, ".matrix": _boeing.read,
    ".mapping": _boeing.mapping, ".unv": _shapes.universal, ".uff": _shapes.universal, ".csv": _shapes.listed,
    ".txt": _shapes.listed,
}  # fmt: skip
BINARY = {
    ".full": "in Ansys: HBMAT, name, ext, , ASCII, STIFF (and MASS) writes it as text",
    ".emat": "in Ansys: HBMAT writes K and M as text", ".rst": "in Ansys: write modes to a universal file",
    ".odb": "in Abaqus: *MATRIX OUTPUT, STIFFNESS, MASS", ".sim": "in Abaqus: *MATRIX OUTPUT, STIFFNESS, MASS",
    ".frd": "in CalculiX: *FREQUENCY, SOLVER=MATRIXSTORAGE", ".f06": "in Nastran: PARAM,EXTOUT,DMIGPCH punches K and M",
    ".fil": "in Abaqus: *MATRIX OUTPUT, STIFFNESS, MASS", ".cdb": "in Ansys: HBMAT writes K and M as text",
}  # fmt: skip
_ROLES = {
    "K": re.compile(r"K([A-Z0-9]*|_.*)?|STIF.*|STIFFNESS", re.IGNORECASE),
    "M": re.compile(r"M([A-Z0-9]{1,4}|_.*)?|MASS.*", re.IGNORECASE),
    "C": re.compile(r"[BC]([A-Z0-9]{1,4}|_.*)?|DMPV.*|DAMP.*", re.IGNORECASE),
}
DOFS_OF_GRID = 6
SAME = 1e-4  # over the largest coordinate: two files have the digits of their texts
FOREIGN = 0.5  # share of the mass off the diagonal that may lie where the stiffness has no entry
FE_SUFFIXES = (*READERS, *BINARY, *_mesh.SUFFIXES)


def read_fe(
    path: Files,
    *,
    units: str | None = None,
    dofs: str | os.PathLike[str] | Sequence[Any] | None = None,
    supports: Iterable[Any] = (),
    names: Mapping[str, str] | None = None,
    material: Material | None = None,
    modal_mass: ArrayLike | None = None,
) -> FeModel:
    """Finite-element model from the files of a solver, in SI.

    K, M and C from Nastran OUTPUT4 (.op4, text or binary), OUTPUT2 (.op2) and punched DMIG cards (.pch, .bdf), Abaqus
    ``*MATRIX OUTPUT`` (.mtx), CalculiX ``MATRIXSTORAGE`` (.sti, .mas, .dof), Harwell-Boeing as Ansys writes it (.hb,
    .rsa, .rua, .matrix, with a .mapping) and Matrix Market (.mtx, .mm); modes from OUTPUT2, universal files (data sets
    55) and tables (.csv); nodes from any of them, from GRID cards and Abaqus or CalculiX input (.inp), and from meshes
    that meshio reads, which become solids with `material`.

    Parameters
    ----------
    path : path or list of paths
        Files that belong together: ``["job_STIF2.mtx", "job_MASS2.mtx", "job.inp"]``.
    units : str
        Length and force of the numbers, ``"mm, N"`` (mass in t) or ``"m, N"``; time is in s, angles in rad. Asked
        unless a universal file states them.
    dofs : path or sequence of DOFs, optional
        Of the rows, where no file names them: a table ``node, direction[, x, y, z]`` or labels.
    supports : iterable of DOFs
        Held, beside those of the files.
    names : dict, optional
        Which matrix is which, where the names leave it open: ``{"K": "KGG", "M": "MGG"}``.
    material : Material, optional
        Of a mesh.
    modal_mass : float or array (modes,), optional
        Where the files do not state it, in their unit of mass: 1 for shapes that are normalised to mass.

    Returns
    -------
    FeModel
        ``model.summary()`` says what it is and what does not fit.

    Raises
    ------
    InputError
        A file that is missing, cut, damaged, of another kind or version; matrices of other sizes or other node
        orders; units that are not stated; rows that nothing names.
    """
    paths = _paths(path)
    scale = None if units is None else parse_units(units)
    found = [_parts(p, material, None if scale is None else scale[0]) for p in paths]
    stated = next((part.scale for part in found if part.scale is not None), None)
    other = scale is not None and stated is not None and not np.allclose(scale, stated, rtol=1e-6, atol=0.0)
    scale = scale or stated
    if scale is None:
        raise InputError(
            "the units of the files are not stated", where=", ".join(p.name for p in paths), found="numbers",
            expected=Advice(either('units="mm, N"', "--units mm,N"), " (mass in t), or others"),
            hint="a solver knows no units: ask who made the model",
        )  # fmt: skip
    source = ", ".join(p.name for p in paths)
    table = _dofs(dofs)
    chosen, passed = _chosen(named_parts(found), names, source)
    matrices, labels, notes = _aligned(chosen, _row_labels(found, table, chosen, source), source)
    if other and stated is not None:
        notes.append(f"the file states units of {stated[0]:g} m and {stated[1]:g} N: those asked for are taken instead")
    shapes = [part.modes for part in found if part.modes is not None]
    if len(shapes) > 1:
        refuse("modes in two files", source, f"{len(shapes)} sets", "one", "leave one file out")
    if not matrices and not shapes and material is None and not any(len(part.nodes) for part in found):
        refuse("nothing to import", source, "no matrices, modes or nodes", "K and M, or modes")
    held = np.concatenate([part.held for part in found])
    asked = [Dof.parse(d) for d in ([supports] if isinstance(supports, str) else supports)]
    nodes, places = _nodes(found, table)
    solid = material is not None and any(p.suffix.lower() in _mesh.SUFFIXES for p in paths)
    made = FeModel(
        K=matrices.get("K"), M=matrices.get("M"), C=matrices.get("C"), labels=labels, nodes=nodes, places=places,
        held=np.concatenate([held, np.array([(d.node, d.axis) for d in asked], np.int64).reshape(-1, 2)]),
        modes=_massed(shapes[0], modal_mass, source) if shapes else None, source=source,
        notes=(*(n for part in found for n in part.notes), *passed, *notes),
    )  # fmt: skip
    _held_known(made, source)
    return _in_si(made, scale, solid)


def parse_units(text: Any) -> tuple[float, float]:
    """Metres and newtons of ``"mm, N"``.

    Raises
    ------
    InputError
        Anything but a unit of length and one of force.
    """
    words = [w for w in re.split(r"[,;\s]+", text.strip()) if w] if isinstance(text, str) else []
    if len(words) != 2:
        raise InputError("no units of a model", where="units", found=shown(text),
                         expected='a length and a force: "mm, N", "m, N", "in, lbf"')  # fmt: skip
    length = unit_table.check(words[0], "displacement", channel="units, length").factor
    return length, unit_table.check(words[1], "force", channel="units, force").factor


# -- files -------------------------------------------------------------------------------------------------------------
def _paths(given: Any) -> list[Path]:
    single = isinstance(given, str | os.PathLike)
    paths: list[Path] = [as_path(given)] if single else [as_path(p) for p in given]
    if not paths:
        refuse("no file", "read_fe", "an empty list", "files of one model", "read_fe(['K.op4', ...], units='mm, N')")
    for path in paths:
        if not path.is_file():
            refuse("no such file" if not path.exists() else "this is no file", str(path),
                   "a folder" if path.is_dir() else "nothing", "a file of a solver", "check the path")  # fmt: skip
    beside = [p.with_suffix(".dof") for p in paths if p.suffix.lower() in (".sti", ".mas")]
    paths += [p for p in dict.fromkeys(beside) if p.is_file() and p not in paths]
    if len(set(paths)) < len(paths):
        refuse("a file twice", "read_fe", ", ".join(map(str, paths)), "each once", "leave one out")
    return paths


def _parts(path: Path, material: Material | None, length: float | None) -> Parts:
    suffix = path.suffix.lower()
    if suffix in BINARY:
        refuse("a file of a solver that is not read", str(path), suffix, "text that the solver exports", BINARY[suffix])
    if suffix in (".mtx", ".mm"):
        with path.open("rb") as file:
            market = file.read(14).lower() == b"%%matrixmarket"
        if market or suffix == ".mm":
            return Parts(matrices={path.stem: Matrix(sparse.csr_array(read_market(path)))})
        return _rows.abaqus(path)
    if suffix in _mesh.SUFFIXES:
        if material is not None and length is None:
            refuse("the units of the mesh are not stated", str(path), "numbers", 'units="mm, N" or others',
                   "a mesh knows no units")  # fmt: skip
        return _mesh.read(path, material, length or 1.0)
    if suffix not in READERS:
        refuse("a file of a kind that is not read", str(path), suffix or "no suffix",
               ", ".join(sorted({*READERS, ".mtx", ".mm", *_mesh.SUFFIXES})), "name it by its kind")  # fmt: skip
    return READERS[suffix](path)


# -- which matrix is which, and its rows -------------------------------------------------------------------------------
def _chosen(
    found: Mapping[str, Matrix], names: Mapping[str, str] | None, source: str
) -> tuple[dict[str, tuple[str, Matrix]], list[str]]:
    """K, M and C with their names, and notes on what is passed over."""
    out: dict[str, tuple[str, Matrix]] = {}
    for role in ("K", "M", "C"):
        asked = (names or {}).get(role)
        if asked is not None and asked not in found:
            refuse(f"no matrix {asked!r}", source, ", ".join(found) or "none", "a name that is there", "check names=")
        taken = [*(names or {}).values()]
        fits = [asked] if asked else [n for n in found if n not in taken and _role(n) == role]
        if len(fits) > 1:
            refuse(f"several matrices that may be {role}", source, ", ".join(fits), "one",
                       Advice("say which: ", _named(role, fits[0])))  # fmt: skip
        if fits:
            out[role] = (fits[0], found[fits[0]])
    if found and "K" not in out:
        refuse("no stiffness matrix", source, ", ".join(found), "one whose name begins with K or STIF",
               Advice("say which: ", _named("K", next(iter(found)))))  # fmt: skip
    used = {name for name, _ in out.values()}
    return out, [f"{name}: passed over" for name in found if name not in used]


def _named(role: str, name: str) -> Spelling:
    return either(f'names={{"{role}": "{name}"}}', f"--names {role}={name}")


def _role(name: str) -> str:
    words = [name, *re.split(r"[_\-. ]+", name)[::-1]]
    for word in words:
        for role, pattern in _ROLES.items():
            if pattern.fullmatch(word):
                return role
    return ""


def _dofs(given: Any) -> tuple[list[Dof], NDArray[np.float64] | None] | None:
    if given is None:
        return None
    if isinstance(given, str | os.PathLike):
        return read_table(_paths(given)[0])
    return [Dof.parse(d) for d in given], None


def _row_labels(
    found: Sequence[Parts], table: Any, chosen: Mapping[str, tuple[str, Matrix]], source: str
) -> NDArray[np.int64] | None:
    """Labels of rows that the matrices do not name."""
    if table is not None:
        if any(d.direction < 0 for d in table[0]):
            refuse("a row with a negative direction", source, "such as 12-Z", "+ only", "turn the signs of the matrix")
        return np.array([(d.node, d.axis) for d in table[0]], np.int64)
    given = [part.rows for part in found if part.rows is not None]
    if len(given) > 1:
        refuse("two tables of rows", source, f"{len(given)} files", "one", "leave one out")
    if given:
        return given[0]
    nodes = np.unique(np.concatenate([n for part in found for n in (part.nodes, part.unplaced)]))
    bare = [m.A.shape[0] for _, m in chosen.values() if m.labels is None]
    if bare and len(nodes) and set(bare) == {DOFS_OF_GRID * len(nodes)}:
        return np.column_stack([np.repeat(nodes, DOFS_OF_GRID), np.tile(np.arange(1, 7), len(nodes))])
    return None


def _aligned(
    chosen: Mapping[str, tuple[str, Matrix]], rows: NDArray[np.int64] | None, source: str
) -> tuple[dict[str, sparse.csr_array], NDArray[np.int64], list[str]]:
    """Matrices over the rows of K, and the labels of these."""
    if not chosen:
        return {}, np.empty((0, 2), np.int64), []
    own, notes = {}, []
    for role, (name, matrix) in chosen.items():
        A, labels = matrix.A, matrix.labels
        if labels is None and rows is not None and A.shape[0] < len(rows) and not matrix.sized:
            A = _grown(A, len(rows))  # lines of entries end with the last that is not zero
        if labels is None and (rows is None or len(rows) != A.shape[0]):
            refuse(
                f"nothing names the rows of {name}" if rows is None else f"the labels do not fit the rows of {name}",
                source, f"{A.shape[0]} rows" + ("" if rows is None else f", {len(rows)} labels"),
                "node and direction of every row", "dofs=, a table node, direction; a .dof or .mapping file; or GRID "
                "points for matrices of the g-set",
            )  # fmt: skip
        own[role] = (name, A, rows if labels is None else labels)
    first, K, labels = own["K"]
    assert labels is not None
    if len(np.unique(keyed(labels))) < len(labels):
        refuse("a degree of freedom twice", source, f"{len(labels)} rows", "each once", "check the labels")
    out = {"K": K}
    for role in [r for r in ("M", "C") if r in own]:
        name, A, theirs = own[role]
        assert theirs is not None
        at = rows_of(labels, theirs)
        if np.any(at < 0):
            node, code = theirs[int(np.argmin(at))]
            refuse(f"{first} and {name} have other degrees of freedom", source,
                   f"{int(np.sum(at < 0))} of {name} that {first} lacks, first node {node}, direction {code}",
                   "the same, from one export")  # fmt: skip
        if len(theirs) < len(labels):
            notes.append(f"{name} has {len(theirs)} of the {len(labels)} degrees of freedom of {first}")
        out[role] = _placed(A, at, len(labels))
    if "M" not in out:
        notes.append("no mass matrix: a model for static loads alone")
    else:
        _same_order(out["K"], out["M"], own["M"][0], source)
    return out, labels, notes


def _grown(A: sparse.csr_array, n: int) -> sparse.csr_array:
    coo = A.tocoo()
    return sparse.coo_array((coo.data, coo.coords), shape=(n, n)).tocsr()


def _placed(A: sparse.csr_array, at: NDArray[np.intp], n: int) -> sparse.csr_array:
    coo = A.tocoo()
    return sparse.coo_array((coo.data, (at[coo.coords[0]], at[coo.coords[1]])), shape=(n, n)).tocsr()


def _same_order(K: sparse.csr_array, M: sparse.csr_array, name: str, source: str) -> None:
    """Refuse a mass that couples what the stiffness does not: their rows are not in one order."""
    coo = M.tocoo()
    apart = coo.coords[0] != coo.coords[1]
    weight = np.abs(coo.data) * apart
    pattern = sparse.csr_array((np.ones(K.nnz), K.indices, K.indptr), shape=K.shape)
    i, j = coo.coords
    beside = np.asarray(pattern[i, j]).ravel() == 0 if len(i) else np.zeros(0, bool)
    if weight.sum() > 0 and weight[beside].sum() > FOREIGN * weight.sum():
        refuse("K and M have their nodes in other orders", f"{source}, {name}",
               f"{100 * weight[beside].sum() / weight.sum():.0f} % of the mass off the diagonal couples degrees of "
               "freedom that K does not", "rows of K and M in one order",
               "export both from one run of the solver")  # fmt: skip


# -- nodes, modes, units -----------------------------------------------------------------------------------------------
def _nodes(found: Sequence[Parts], table: Any) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    nodes = np.concatenate([part.nodes for part in found])
    places = np.concatenate([part.places for part in found])
    if table is not None and table[1] is not None and not len(nodes):
        nodes = np.array(sorted({d.node for d in table[0]}), np.int64)
        places = np.pad(np.asarray(table[1], float), ((0, 0), (0, 3 - table[1].shape[1])))
    known, first, index = np.unique(nodes, return_index=True, return_inverse=True)
    apart = np.abs(places - places[first][index.ravel()]).max(axis=1, initial=0.0)
    if np.any(apart > SAME * np.abs(places).max(initial=0.0)):
        refuse("a node at two places", "read_fe", f"node {nodes[int(np.argmax(apart))]}", "one place for each node",
               "leave out the file that numbers its nodes in another way")  # fmt: skip
    return known, places[first]


def _massed(shapes: Shapes, modal_mass: Any, source: str) -> Shapes:
    if modal_mass is None:
        return shapes
    given = np.broadcast_to(numbers(modal_mass), shapes.frequencies.shape) if np.ndim(modal_mass) < 2 else np.empty(0)
    if given.shape != shapes.frequencies.shape or not np.all(given > 0):
        refuse("no modal masses", f"{source}, modal_mass", shown(modal_mass), "one number > 0, or one for each mode",
               "1 for shapes that are normalised to mass")  # fmt: skip
    if shapes.mass is not None:
        refuse("the files state the modal masses", f"{source}, modal_mass", shown(modal_mass), "none beside them",
               "leave modal_mass out")  # fmt: skip
    return replace(shapes, mass=np.array(given, float))


def _held_known(made: FeModel, source: str) -> None:
    """Supports that no row has are refused: a wrong node number would be silent."""
    if made.K is None or not len(made.held):
        return
    missing = rows_of(made.labels, made.held) < 0
    if missing.any():
        node, code = made.held[int(np.argmax(missing))]
        refuse("a support that no row has", source, f"node {node}, direction {code}", "degrees of freedom of K",
               "leave out what the solver left out of K already")  # fmt: skip


def _in_si(made: FeModel, scale: tuple[float, float], solid: bool) -> FeModel:
    """The model in SI: an energy is force times length, and each unknown has its own length; a solid is so already."""
    length, force = scale
    places = made.places * length
    modes = None if made.modes is None else _shapes_in_si(made.modes, length, force)
    matrices = made.matrices
    if scale != (1.0, 1.0) and not solid:
        if np.any(made.labels[:, 1] == 0):
            refuse("a scalar degree of freedom has no unit of length", made.source, "direction 0", "1 to 6",
                   "leave scalar points out, or convert the matrices to SI")  # fmt: skip
        weight = sparse.diags_array(np.where(made.labels[:, 1] <= 3, 1 / length, 1.0))
        matrices = {name: (force * length * (weight @ A @ weight)).tocsr() for name, A in matrices.items()}
    return replace(made, K=matrices.get("K"), M=matrices.get("M"), C=matrices.get("C"), places=places, modes=modes)


def _shapes_in_si(shapes: Shapes, length: float, force: float) -> Shapes:
    """Shapes in m and rad; a modal mass belongs to its shape: twice an energy, force times length."""
    moved = np.where(shapes.labels[:, 1] > 3, 1.0, length)[:, None] * shapes.shapes
    return replace(shapes, shapes=moved, mass=None if shapes.mass is None else shapes.mass * force * length)
