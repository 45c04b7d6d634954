"""A network as data: named steps and their weights, carried out by numpy. Training and export read the same steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

Array = NDArray[Any]


@dataclass(frozen=True)
class Step:
    """One operation: its kind, the values it takes, the value it makes, and the shape of its weight, where it has one.

    `wide` is the distance between the taps of a convolution.
    """

    kind: str
    takes: tuple[str, ...]
    makes: str
    shape: tuple[int, ...] = ()
    wide: int = 1

    @property
    def weights(self) -> tuple[str, ...]:
        """Names of the weight and its offset."""
        return (f"{self.makes}.weight", f"{self.makes}.offset") if self.shape else ()


@dataclass(frozen=True, eq=False)
class Graph:
    """A network: from the value ``in`` to the value ``out``, step by step.

    Values are (n, channels), (n, channels, samples) or (n, channels, rows, columns).
    """

    steps: tuple[Step, ...]
    weights: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for step in self.steps:
            if step.kind not in OPERATIONS:
                raise InputError("a step that no network has", where="network", found=step.kind,
                                 expected=", ".join(OPERATIONS))  # fmt: skip
            for name, shape in zip(step.weights, (step.shape, step.shape[:1]), strict=False):
                found = self.weights[name].shape if name in self.weights else None
                if self.weights and found != shape:
                    raise InputError("weights that do not fit the network", where=name, found=found, expected=shape)

    @property
    def count(self) -> int:
        """How many numbers are trained."""
        return sum(prod(s.shape) + s.shape[0] for s in self.steps if s.shape)

    def started(self, seed: int) -> dict[str, Array]:
        """Weights to begin with: normal, by the fan-in (He et al., ICCV 2015); zero where the network ends."""
        rng, out = np.random.default_rng(seed), {}
        for step in self.steps:
            if step.shape:
                size = 0.0 if step.makes == "out" else np.sqrt(2 / prod(step.shape[1:]))
                name, offset = step.weights
                out[name] = (size * rng.standard_normal(step.shape)).astype(np.float32)
                out[offset] = np.zeros(step.shape[0], np.float32)
        return out

    def __call__(self, values: Array) -> Array:
        """What comes out (n, ...) of what goes in, in single precision."""
        known = {"in": np.asarray(values, np.float32)}
        for step in self.steps:
            known[step.makes] = OPERATIONS[step.kind](
                *(known[name] for name in step.takes), *(self.weights[name] for name in step.weights),
                **({"wide": step.wide} if step.kind.startswith("convolve") else {}),
            )  # fmt: skip
        return known["out"]

    def described(self) -> list[dict[str, Any]]:
        """The steps as plain data, for files."""
        return [
            {"kind": s.kind, "takes": list(s.takes), "makes": s.makes, "shape": list(s.shape), "wide": s.wide}
            for s in self.steps
        ]

    @classmethod
    def of(cls, described: Sequence[Mapping[str, Any]], weights: Mapping[str, Array]) -> Graph:
        """The network of `described` steps.

        Raises
        ------
        InputError
            A step that is unknown, or weights that do not fit.
        """
        steps = tuple(
            Step(str(d["kind"]), tuple(d["takes"]), str(d["makes"]), tuple(map(int, d["shape"])), int(d["wide"]))
            for d in described
        )
        return cls(steps, weights)


# -- what a step does, in numpy ----------------------------------------------------------------------------------------
def _dense(x: Array, weight: Array, offset: Array) -> Array:
    return np.asarray(x @ weight.T + offset)


def _convolve(x: Array, weight: Array, offset: Array, *, wide: int) -> Array:
    """Correlation of the axes after the channels with an odd number of taps, as long as the input, zeros around it."""
    taps, sides = weight.shape[2:], x.shape[2:]
    room = [(0, 0), (0, 0), *((wide * (t // 2),) * 2 for t in taps)]
    padded = np.pad(x, room)
    pieces = [
        padded[(slice(None), slice(None), *(slice(wide * i, wide * i + s) for i, s in zip(at, sides, strict=True)))]
        for at in np.ndindex(*taps)
    ]
    columns = np.stack(pieces, axis=2).reshape(len(x), -1, prod(sides))  # channels, then taps: as the weight
    return (weight.reshape(len(weight), -1) @ columns + offset[:, None]).reshape(len(x), -1, *sides)


def _rectify(x: Array) -> Array:
    return np.maximum(x, 0.0)


def _pool(x: Array) -> Array:
    n, channels, rows, columns = x.shape
    return np.asarray(x.reshape(n, channels, rows // 2, 2, columns // 2, 2).mean(axis=(3, 5)))


def _double(x: Array) -> Array:
    return np.asarray(x.repeat(2, axis=2).repeat(2, axis=3))


def _add(*values: Array) -> Array:
    return np.asarray(sum(values[1:], values[0]))


def _join(*values: Array) -> Array:
    return np.concatenate(values, axis=1)


OPERATIONS: dict[str, Callable[..., Array]] = {
    "dense": _dense,
    "convolve": _convolve,
    "rectify": _rectify,
    "pool": _pool,
    "double": _double,
    "add": _add,
    "join": _join,
}
