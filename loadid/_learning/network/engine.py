"""The engine that corrects the linear one by a network: trained by torch, carried out by numpy or onnxruntime."""

from __future__ import annotations

import hashlib
import importlib.util
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from ..linear import LinearEngine
from ..training import Lesson
from . import exchange
from .forms import Form, Grid, Histories, Maps, Numbers, form_of
from .graph import Graph
from .training import Pairs, Schedule, Trained, train

Array = NDArray[Any]
CHUNK = 64  # examples that are mapped at once
SMALL = 0.25  # of the median of sums, over the size of the readings: smaller ones count as these
RUNNERS = ("numpy", "onnxruntime")


@dataclass(frozen=True, eq=False)
class NetworkEngine:
    """The linear estimate and what a network adds to it.

    Parameters
    ----------
    linear : LinearEngine
    form : Form
        What the network sees, and in which units it answers.
    network : Graph
    losses : array (epochs, 2)
        Of the training, on fitted and on held-out examples.
    runner : str
        ``"numpy"`` or ``"onnxruntime"``.
    """

    linear: LinearEngine
    form: Form
    network: Graph
    losses: Array
    runner: str = "numpy"
    name: str = field(default="torch", init=False)

    def __post_init__(self) -> None:
        if self.runner not in RUNNERS:
            raise InputError("nothing of that name runs networks", where="runner", found=repr(self.runner),
                             expected=" or ".join(RUNNERS))  # fmt: skip

    @classmethod
    def learn(
        cls,
        lesson: Lesson,
        progress: Callable[[float, str], None] | None = None,
        *,
        seed: int = 0,
        places: Array | None = None,
        sums: Array | None = None,
        schedule: Schedule | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
    ) -> Self:
        """Fit the linear engine, then the network to what it leaves.

        Parameters
        ----------
        lesson : Lesson
        progress : callable, optional
            Told the share that is done, and of what.
        seed : int
            Of the first weights and of the order of the examples: the same seed gives the same bits.
        places : array (P, 2 or 3), optional
            Of the nodes that the loads act at, in their order: on a rectangular grid a U-shaped network maps them.
        sums : array (k, outputs), optional
            Sums of the outputs, as forces are of tractions: a U-shaped network is brought to meet these too.
        schedule : Schedule, optional
            How long and how fast.
        checkpoint : path, optional
            HDF5 file from which a training that was killed goes on.

        Raises
        ------
        InputError
            As `LinearEngine.learn` and `train`.
        """
        say = progress or (lambda _share, _text: None)
        linear = LinearEngine.learn(lesson, lambda share, text: say(0.2 * share, text))
        plan = schedule or Schedule()
        fitting, choosing = (_together(lesson, part, linear) for part in (lesson.fitting, lesson.choosing))
        form = _form(lesson, places, *fitting)
        done = _trained(form, fitting, choosing, sums, plan, seed, say, checkpoint)
        return cls(linear, form, done.graph, done.losses)

    @property
    def reach(self) -> int:
        """Samples before and after one that its load depends on; 0 of static readings."""
        beyond = sum(s.wide * (s.shape[2] // 2) for s in self.network.steps if len(s.shape) == 3)
        return self.linear.reach + beyond

    @property
    def of_constant(self) -> Array:
        """What outputs make of readings that are 1 all the time (sensors, outputs): by the linear map below."""
        return self.linear.of_constant

    def predict(self, data: Array) -> tuple[Array, Array]:
        """Outputs and their std (n, [samples,] outputs) of whitened data (n, [samples,] sensors)."""
        parts = [self._part(data[k : k + CHUNK]) for k in range(0, len(data), CHUNK)] or [self.linear.predict(data)]
        means, stds = zip(*parts, strict=True)
        return np.concatenate(means), np.concatenate(stds)

    def on(self, runner: str) -> NetworkEngine:
        """The same engine, carried out by ``"numpy"`` or ``"onnxruntime"``.

        Raises
        ------
        InputError
            No such runner, or it is not installed.
        """
        found = NetworkEngine(self.linear, self.form, self.network, self.losses, runner)
        return found if found.run is not None else self

    def to_onnx(self) -> bytes:
        """The network as an ONNX model; what goes in and what comes out is as `form` says.

        Raises
        ------
        InputError
            onnx is not installed.
        """
        return exchange.to_onnx(self.network, {"maps": 2, "histories": 1, "numbers": 0}[self.form.kind])

    @cached_property
    def run(self) -> Callable[[Array], Array]:
        """What carries the network out."""
        return self.network if self.runner == "numpy" else exchange.Runner(self.to_onnx())

    def arrays(self) -> dict[str, Any]:
        """What a file keeps."""
        steps = self.network.described()
        return {
            "linear": self.linear.arrays(),
            "form": {"kind": self.form.kind, **self.form.arrays()},
            "steps": {str(k): step for k, step in enumerate(steps)},
            "weights": dict(self.network.weights),
            "losses": self.losses,
        }

    @classmethod
    def from_arrays(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `arrays`.

        Raises
        ------
        InputError
            Of another kind than this release has, or weights that do not fit.
        """
        steps = [tree["steps"][str(k)] for k in range(len(tree["steps"]))]
        weights = {key: np.asarray(value, np.float32) for key, value in tree["weights"].items()}
        runner = RUNNERS[installed()]
        return cls(LinearEngine.from_arrays(tree["linear"]), form_of(tree["form"]), Graph.of(steps, weights),
                   np.asarray(tree["losses"]), runner)  # fmt: skip

    def _part(self, data: Array) -> tuple[Array, Array]:
        mean, _ = self.linear.predict(data)
        values, size = self.form.inputs(data, mean)
        more, std = self.form.told(self.run(values), size)
        return mean + more, std


def installed() -> bool:
    """Whether onnx and onnxruntime are."""
    return all(importlib.util.find_spec(name) is not None for name in ("onnx", "onnxruntime"))


def _together(lesson: Lesson, part: Any, linear: LinearEngine) -> tuple[Array, Array, Array]:
    """Whitened data, linear estimates and outputs of a part of the set."""
    found = [(data, linear.predict(data)[0], outputs) for data, outputs in lesson.batches(part)]
    data, mean, truth = (np.concatenate(column) for column in zip(*found, strict=True))
    return data, mean, truth


def _form(lesson: Lesson, places: Array | None, data: Array, mean: Array, truth: Array) -> Form:
    """What the network of a lesson sees."""
    if lesson.dt is not None:
        return Histories.of(data, mean, truth)
    if places is not None and lesson.resultant is None and lesson.outputs % len(places) == 0:
        grid = Grid.of(places, lesson.outputs // len(places))
        if grid is not None:
            return Maps.of(grid, data, mean, truth)
    return Numbers.of(data, mean, truth)


def _trained(
    form: Form, fitting: tuple[Array, Array, Array], choosing: tuple[Array, Array, Array], sums: Array | None,
    plan: Schedule, seed: int, say: Callable[[float, str], None], checkpoint: str | os.PathLike[str] | None,
) -> Trained:  # fmt: skip
    learned, held = (_pairs(form, *examples, sums) for examples in (fitting, choosing))
    mirrors = form.mirrors if isinstance(form, Maps) and form.grid.components == 3 else None
    return train(
        form.graph(), learned, held, plan, seed=seed, mirrors=mirrors, checkpoint=checkpoint, mark=_mark(fitting),
        progress=lambda epoch, epochs: say(0.2 + 0.8 * epoch / epochs, f"epoch {epoch} of at most {epochs}"),
    )  # fmt: skip


def _pairs(form: Form, data: Array, mean: Array, truth: Array, sums: Array | None) -> Pairs:
    """What goes in and what should come out; each static example counts by its relative error, and so do its sums."""
    values, size = form.inputs(data, mean)
    targets = form.targets(truth - mean, size)
    weight = np.ones(len(data))
    if form.kind != "histories":
        whole = form.targets(truth, size).reshape(len(data), -1)
        power = np.mean(whole**2, axis=1)
        weight = np.median(power) / np.maximum(power, 0.1 * np.median(power))
    if sums is None or not isinstance(form, Maps):
        return Pairs(values, targets, weight)
    whole = np.linalg.norm(truth @ sums.T, axis=1) / size
    return Pairs(values, targets, weight, form.sums(sums), np.maximum(whole, SMALL * np.median(whole)))


def _mark(examples: tuple[Array, Array, Array]) -> str:
    """What tells one set of examples from another."""
    found = hashlib.sha256()
    for part in examples:
        found.update(np.ascontiguousarray(part, float).tobytes())
    return found.hexdigest()[:16]
