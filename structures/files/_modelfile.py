"""Forward models as files: a structure with its sensors and loads, or a state space, written once and read anywhere.

A file holds what a model is, not how it was built: matrices, supports, damping, and the rows and columns that its
sensors and loads are. Model and model of its file give the same numbers, and have the same fingerprint. What lies
between the nodes of a mesh is not kept: sensors and loads that are added later stand at degrees of freedom.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .._certificate import Certificate
from .._channels import Channel, Dof
from .._flags import Flag
from .._model import Model, as_model
from .._models import forward, statespace
from .._models.forward import ForwardModel
from .._models.measured import MeasuredModel
from .._models.modal import FILE as MODAL
from .._models.modal import ModalModel
from .._models.statespace import StateSpace
from .._models.tabulated import FILE as TABLE
from .._models.tabulated import FrfModel
from .._system.damping import Damping, Modal, Rayleigh, Structural
from .._system.loads import Load
from .._system.sensors import Sensor
from .._system.structure import Structure
from ..errors import InputError
from . import _storage as storage
from ._frf_text import TEXT
from ._frfs import read_frfs
from ._uff import SUFFIXES

if TYPE_CHECKING:
    from .._system.fields import Span


KIND, SPACE = forward.FILE, statespace.FILE
KINDS = (KIND, SPACE)
DAMPING: dict[str, type] = {kind.__name__: kind for kind in (Modal, Rayleigh, Structural)}
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StoredSensor(Sensor):
    """A sensor of a file: the row that it reads, and how often that is derived.

    Parameters
    ----------
    values : array (n,)
        Over all DOFs of its structure.
    order : int
        Time derivatives of the row.
    """

    values: Array
    order: int = 0

    @property
    def derivative(self) -> int:  # type: ignore[override]
        """Time derivatives of the row."""
        return self.order

    def row(self, structure: Structure) -> Array:
        """The row, shape (n,).

        Raises
        ------
        InputError
            Another structure.
        """
        return _fitting(self, self.values, structure)


@dataclass(frozen=True, eq=False)
class StoredLoad(Load):
    """A load of a file: the column that it fills.

    Parameters
    ----------
    values : array (n,)
        Over all DOFs of its structure.
    """

    values: Array

    def shape(self, structure: Structure) -> Array:
        """The column, shape (n,).

        Raises
        ------
        InputError
            Another structure.
        """
        return _fitting(self, self.values, structure)

    def region(self, structure: Structure) -> tuple[Span, ...] | None:
        """Not known."""
        return None


def save(model: Model, path: str | os.PathLike[str]) -> None:
    """Write a model, whole or not at all, with checksums: ``model.save(path)``.

    Parameters
    ----------
    model : ForwardModel, StateSpace, or another that is kept in a file
        Its loads stay in place.
    path : path

    Raises
    ------
    InputError
        A kind of model that is not kept in a file, a load that moves, a file that cannot be written.
    """
    as_model(model, "modelfile.save").save(path)


def load(path: str | os.PathLike[str]) -> ForwardModel | StateSpace:
    """Read a model that `save` wrote.

    Raises
    ------
    InputError
        A file that is missing, damaged or of another kind.
    """
    kind = storage.kind_of(path)
    tree = storage.read(path, SPACE if kind == SPACE else KIND)
    try:
        model = _space(tree) if kind == SPACE else _forward(tree)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            "its content is not what this release expects",
            where=str(path),
            found=f"{type(error).__name__}: {error}",
            hint="read it with the release that wrote it",
        ) from error
    model.certificate = Certificate.stored(tree["certificate"])
    return model


def load_model(path: str | os.PathLike[str]) -> MeasuredModel | FrfModel | ForwardModel | ModalModel | StateSpace:
    """Read a model of any kind that was saved here, or FRFs of a universal file or a text that states what they are.

    Raises
    ------
    InputError
        A file that is missing, damaged, or no model.
    """
    path = storage.as_path(path)
    if path.suffix.lower() in (*SUFFIXES, *TEXT):
        return read_frfs(path)
    kind = storage.kind_of(path) if path.is_file() else None
    if kind in KINDS:
        return load(path)
    if kind == MODAL:
        return ModalModel.load(path)
    return FrfModel.load(path) if kind == TABLE else MeasuredModel.load(path)


load_any = load_model  # its name in release 0.1


def _forward(tree: Mapping[str, Any]) -> ForwardModel:
    matrices = {name: _matrix(parts) for name, parts in tree["matrices"].items()}
    structure = Structure(
        **matrices,
        dofs=_dofs(tree["dofs"]),
        coordinates=tree["coordinates"],
        supports=_dofs(tree["supports"]),
        damping=_damping(tree["damping"]),
        parameters=tree["parameters"],
        terms={name: _matrix(parts) for name, parts in tree["terms"].items()},
    )
    rows, columns = (_matrix(tree[name]).toarray() for name in ("rows", "columns"))
    given = zip(tree["sensors"], rows, tree["derivatives"], strict=True)
    sensors = [StoredSensor(**c, values=row, order=int(order)) for c, row, order in given]
    loads = [StoredLoad(**c, values=column) for c, column in zip(tree["loads"], columns, strict=True)]
    model = ForwardModel(structure, sensors, loads, **tree["settings"])
    model.flags = tuple(Flag.from_dict(f) for f in tree["flags"])  # what a mesh told, it does not tell again
    return model


def _space(tree: Mapping[str, Any]) -> StateSpace:
    sensors, loads = ([Channel(**c) for c in tree[name]] for name in ("sensors", "loads"))
    A, B, C, D = (tree[name] for name in "ABCD")
    return StateSpace(A, B, C, D, tree["dt"], tree["hold"], sensors=sensors, loads=loads)


def _matrix(parts: Mapping[str, Any]) -> sparse.csr_array:
    arrays = tuple(np.asarray(parts[name]) for name in ("data", "indices", "starts"))
    made = sparse.csr_array(arrays, shape=tuple(parts["shape"]))
    made.check_format()  # indices that leave the matrix would be read from anywhere
    return made


def _damping(tree: Mapping[str, Any] | None) -> Damping | None:
    if tree is None:
        return None
    made: Damping = DAMPING[tree["kind"]](**{k: v for k, v in tree.items() if k != "kind"})
    return made


def _dofs(labels: list[str]) -> tuple[Dof, ...]:
    return tuple(Dof.parse(label) for label in labels)


def _fitting(channel: Channel, values: Array, structure: Structure) -> Array:
    if len(values) != structure.n:
        raise InputError(
            "this sensor or load belongs to another structure",
            where=channel.label,
            found=f"{structure.n} DOFs",
            expected=f"the {len(values)} of its file",
            hint="make sensors and loads anew for a new structure",
        )
    return values
