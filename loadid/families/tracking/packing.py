"""Frozen values of a tracker as one text and one array of numbers for files, and back, bit for bit.

The order of an array in memory is kept: the products of BLAS differ in their last bit with it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.advice import Advice, from_plain, to_plain
from structures.channels import Channel
from structures.errors import InputError
from structures.flags import Evidence, Flag

from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.present import Present
from ...inverse.kalman.steady import Steady
from ...inverse.noise_source import NoiseSource
from .certificate import Certificate
from .fitted import Fitted
from .recipe import PRIORS, Recipe

TYPES: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        Certificate,
        Channel,
        Evidence,
        Fitted,
        Flag,
        FilterModel,
        NoiseSource,
        Present,
        Recipe,
        Steady,
        *PRIORS,
    )
}


def pack(value: Any) -> dict[str, Any]:
    """Numbers, text, None, arrays, mappings, sequences and the frozen values of a tracker.

    Returns
    -------
    dict
        ``text``: JSON of everything but the real numbers of arrays; ``numbers``: these, one after the other.

    Raises
    ------
    InputError
        A value of another type.
    """
    packer = _Packer()
    text = json.dumps(packer.pack(value), ensure_ascii=False)
    return {"text": text, "numbers": np.concatenate([np.zeros(0), *packer.parts])}


def unpack(tree: Mapping[str, Any]) -> Any:
    """Inverse of `pack`.

    Raises
    ------
    InputError
        A tree that `pack` did not make.
    """
    return _Unpacker(tree["numbers"]).unpack(json.loads(tree["text"]))


class _Packer:
    """What is met twice is written once: the matrices of a filter stand in its settled gain too."""

    def __init__(self) -> None:
        self.parts: list[NDArray[np.float64]] = []
        self.seen: dict[int, int] = {}
        self.kept: list[Any] = []  # alive, so that no two of them share an id

    def pack(self, value: Any) -> Any:
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, Advice):
            return {"is": "advice", "of": to_plain(value)}
        if value is None or isinstance(value, bool | int | float | str):
            return value
        if isinstance(value, Mapping):
            return {"is": "mapping", "of": {str(k): self.pack(v) for k, v in value.items()}}
        if isinstance(value, list | tuple):
            return {"is": "tuple" if isinstance(value, tuple) else "list", "of": [self.pack(v) for v in value]}
        if id(value) in self.seen:
            return {"is": "same", "of": self.seen[id(value)]}
        self.seen[id(value)] = len(self.kept)
        self.kept.append(value)
        if isinstance(value, np.ndarray):
            return self._array(value)
        kind = Channel if isinstance(value, Channel) else type(value)  # of a sensor only what a channel says is needed
        if not is_dataclass(value) or kind.__name__ not in TYPES:
            raise InputError("a value that the file of a tracker does not hold", where="checkpoint",
                             found=kind.__name__, expected="numbers, text, arrays, " + ", ".join(TYPES))  # fmt: skip
        own = {f.name: self.pack(getattr(value, f.name)) for f in fields(kind) if f.init}
        return {"is": kind.__name__, "of": own}

    def _array(self, value: NDArray) -> dict[str, Any]:
        if value.dtype != np.float64:
            return {"is": "small", "type": value.dtype.str, "of": value.tolist()}
        turned = value.flags.f_contiguous and not value.flags.c_contiguous
        self.parts.append((value.T if turned else value).ravel())
        return {"is": "turned" if turned else "array", "of": list(value.shape)}


class _Unpacker:
    def __init__(self, numbers: NDArray[np.float64]) -> None:
        self.numbers, self.at = numbers, 0
        self.seen: list[Any] = []

    def unpack(self, tree: Any) -> Any:
        if not isinstance(tree, dict):
            return tree
        kind, inner = tree["is"], tree["of"]
        if kind == "advice":
            return from_plain(inner)
        if kind == "mapping":
            return {k: self.unpack(v) for k, v in inner.items()}
        if kind in ("list", "tuple"):
            found = [self.unpack(v) for v in inner]
            return found if kind == "list" else tuple(found)
        if kind == "same":
            return self.seen[inner]
        place = len(self.seen)
        self.seen.append(None)
        self.seen[place] = value = self._made(kind, tree, inner)
        return value

    def _made(self, kind: str, tree: dict[str, Any], inner: Any) -> Any:
        if kind == "small":
            return np.array(inner, np.dtype(tree["type"]))
        if kind in ("array", "turned"):
            size = int(np.prod(inner))
            part = self.numbers[self.at : self.at + size].copy()
            self.at += size
            return part.reshape(inner) if kind == "array" else part.reshape(inner[::-1]).T
        if kind not in TYPES:
            raise InputError("not a value of a tracker", where="checkpoint", found=repr(kind),
                             expected=", ".join(TYPES))  # fmt: skip
        return TYPES[kind](**{k: self.unpack(v) for k, v in inner.items()})
