"""The contract of an engine: whitened readings in, loads and their std out."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

Array = NDArray[np.float64]

ENGINES = {
    "linear": "loadid._learning.linear:LinearEngine",
    "torch": "loadid._learning.network:NetworkEngine",
}  # by the name that a file keeps; each class has `learn(lesson, ...)` and `from_arrays`


class Engine(Protocol):
    """A map that is fitted. Immutable; predicts with numpy alone.

    `name` is its key in `ENGINES`.
    """

    name: str

    @property
    def reach(self) -> int:
        """Samples before and after one that its load depends on; 0 of static readings."""

    @property
    def of_constant(self) -> Array:
        """What outputs make of readings that are 1 all the time (sensors, outputs), to first order."""

    def predict(self, data: Array) -> tuple[Array, Array]:
        """Outputs of readings.

        Parameters
        ----------
        data : array (n, [samples,] sensors)
            Whitened; 0 where a reading is missing.

        Returns
        -------
        mean, std : array (n, [samples,] outputs)
            SI; the std before calibration.
        """

    def arrays(self) -> Mapping[str, Any]:
        """What a file keeps: arrays, numbers, text and dictionaries of them."""

    @classmethod
    def from_arrays(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `arrays`."""


def engine(name: str) -> Any:
    """The class of an engine.

    Raises
    ------
    InputError
        There is none of this name.
    """
    if name not in ENGINES:
        raise InputError("no such engine", where="engine", found=repr(name), expected=f"one of {sorted(ENGINES)}")
    module, _, kind = ENGINES[name].partition(":")
    return getattr(importlib.import_module(module), kind)
