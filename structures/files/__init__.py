"""Structures from files: K, M and C in npz, Matrix Market and HDF5, with a plain DOF table; and back. Models, FRFs too.

Finite-element models of Nastran, Abaqus, Ansys and CalculiX: `read_fe`.

The readers of logs stand on some of these modules: nothing of scipy is loaded before a matrix is read.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._frfs import read_frfs
    from ._matrices import load, save
    from ._modelfile import load_model
    from .fe._model import FeModel
    from .fe._read import read_fe

__all__ = ["FeModel", "load", "load_model", "read_fe", "read_frfs", "save"]

_PLACES = {
    "FeModel": "fe._model", "load": "_matrices", "load_model": "_modelfile", "read_fe": "fe._read",
    "read_frfs": "_frfs", "save": "_matrices",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_PLACES[name]}", __name__), name)


def __dir__() -> list[str]:
    return __all__
