"""Training of a network by torch: from arrays to weights, on one thread the same for the same seed.

The mean is fitted by weighted squares, and the logarithm of the std by the Gaussian likelihood of what the mean leaves
(D. Nix & A. Weigend, ICNN 1994), which takes the mean as given: examples that the std gives up on still count
(M. Seitzer et al., ICLR 2022).

Small errors that all loads of a frame share are large in their sum. Where sums count, a second, shorter stage goes on
from the best weights of the first, with the relative error of the sums in the loss: from the start it spoils the maps.
"""

from __future__ import annotations

import importlib
import logging
import os
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.files import _storage as storage

from .graph import Graph

Array = NDArray[Any]
Progress = Callable[[int, int], None]
KIND = "training of a network"
WIDEST = 8.0  # of the logarithm of a std, either way
SUMS = 20.0  # what a squared relative error of sums counts, beside squares of the mean in the units of the network
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Schedule:
    """How long and how fast: epochs, examples of a step, largest rate, epochs without gain before it ends, decay."""

    epochs: int = 40
    batch: int = 64
    rate: float = 2e-3
    patience: int = 8
    decay: float = 1e-4

    @property
    def of_sums(self) -> Schedule:
        """Of the stage in which sums count: three tenths as long, at two fifths of the rate."""
        return replace(self, epochs=max(1, 3 * self.epochs // 10), rate=0.4 * self.rate)


@dataclass(frozen=True, eq=False)
class Pairs:
    """What goes in (n, channels, ...), what should come out (n, outputs, ...), and how much each counts (n,).

    Where sums of the targets count: how much of each target is in them (k, outputs, ...), and of which size those of
    each example are (n,).
    """

    inputs: Array
    targets: Array
    weight: Array
    sums: Array | None = None
    whole: Array | None = None

    def __len__(self) -> int:
        return len(self.inputs)


@dataclass(frozen=True, eq=False)
class Trained:
    """A trained network, and its loss on the fitted and on the held-out examples of every epoch (epochs, 2)."""

    graph: Graph
    losses: Array
    best: int


@dataclass(eq=False)
class _State:
    """Where a training is: weights, moments of Adam, the best weights of the stage so far, losses, when it began."""

    weights: dict[str, Array]
    first: dict[str, Array]
    second: dict[str, Array]
    kept: dict[str, Array]
    losses: list[tuple[float, float]] = field(default_factory=list)
    stage: int = 0
    begun: int = 0

    @property
    def epoch(self) -> int:
        """Of the stage."""
        return len(self.losses) - self.begun

    @property
    def best(self) -> int:
        """Epoch of the stage with the smallest loss; -1 before the first."""
        return int(np.argmin([held for _, held in self.losses[self.begun :]])) if self.epoch else -1

    def go_on(self) -> None:
        """To the next stage, from the best weights."""
        self.weights, self.stage, self.begun = self.kept, self.stage + 1, len(self.losses)
        self.first, self.second = ({key: np.zeros_like(v) for key, v in self.kept.items()} for _ in range(2))


def torch() -> Any:
    """The library.

    Raises
    ------
    InputError
        It is not installed.
    """
    try:
        return importlib.import_module("torch")
    except ImportError:
        raise InputError("networks are trained by a library that is not installed", where="engine",
                         found="no module torch", expected="the extra 'learn'",
                         hint="pip install 'loadid[learn]', or engine=\"linear\"") from None  # fmt: skip


def train(
    graph: Graph,
    fitting: Pairs,
    held: Pairs,
    schedule: Schedule,
    *,
    seed: int,
    mirrors: Callable[[Any, Any, Any], tuple[Any, Any]] | None = None,
    progress: Progress | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    mark: str = "",
) -> Trained:
    """Weights of a network that makes targets of inputs, and half as many channels more: logarithms of their std.

    Parameters
    ----------
    graph : Graph
        With two channels out for each target.
    fitting, held : Pairs
        The steps go down on the first; the second says when to stop and which epoch is kept.
    mirrors : callable, optional
        Takes inputs, targets (tensors) and a generator of torch, and gives others that are as true.
    progress : callable, optional
        Epochs that are done, and all.
    checkpoint : path, optional
        HDF5 in which every epoch is kept: a training that was killed goes on from there, to the same end. It is
        removed when the training has ended.
    mark : str
        What the checkpoint must say of the examples.

    Raises
    ------
    InputError
        torch is not installed; a checkpoint that is damaged, or of another training.
    """
    library = torch()
    name = _named(graph, schedule, seed, mark, len(fitting), fitting.sums is not None)
    path = None if checkpoint is None else storage.as_path(checkpoint)
    state = _resumed(path, name) or _begun(graph, seed)
    stages = [schedule] if fitting.sums is None else [schedule, schedule.of_sums]
    epochs = sum(plan.epochs for plan in stages)
    with _one_thread(library):
        for stage, plan in enumerate(stages):
            if stage < state.stage:
                continue
            if stage > state.stage:
                state.go_on()
            run = _Run(library, graph, fitting, held, plan, seed, mirrors, SUMS if stage else 0.0)
            while state.epoch < plan.epochs and state.epoch - 1 - state.best < plan.patience:
                run.epoch(state)
                if state.best == state.epoch - 1:
                    state.kept = {key: value.copy() for key, value in state.weights.items()}
                _LOG.info("epoch %d: %.4g fitted, %.4g held out", len(state.losses), *state.losses[-1])
                if path is not None:
                    _keep(path, name, state)
                if progress is not None:
                    progress(len(state.losses), epochs)
    if path is not None:
        path.unlink(missing_ok=True)
    return Trained(Graph(graph.steps, state.kept), np.array(state.losses), state.begun + state.best)


@dataclass(eq=False)
class _Run:
    """The examples as tensors, and what an epoch does with them."""

    library: Any
    graph: Graph
    fitting: Pairs
    held: Pairs
    schedule: Schedule
    seed: int
    mirrors: Callable[[Any, Any, Any], tuple[Any, Any]] | None
    share: float

    def __post_init__(self) -> None:
        self.fit, self.check = (
            [self._tensor(a) for a in (p.inputs, p.targets, p.weight, np.ones(len(p)) if p.whole is None else p.whole)]
            for p in (self.fitting, self.held)
        )
        sums = self.fitting.sums
        self.sums: Any = None if sums is None else self._tensor(sums.reshape(len(sums), -1))

    def _tensor(self, values: Array) -> Any:
        return self.library.from_numpy(np.ascontiguousarray(values, np.float32))

    def epoch(self, state: _State) -> None:
        """One pass over the examples, in an order of its own: of the seed and the number of the epoch."""
        t, plan, epoch = self.library, self.schedule, len(state.losses)
        weights = {key: t.from_numpy(value.copy()).requires_grad_(True) for key, value in state.weights.items()}
        moments = [{key: t.from_numpy(v.copy()) for key, v in m.items()} for m in (state.first, state.second)]
        dice = t.Generator().manual_seed(self.seed * 100_003 + epoch)
        order = t.randperm(len(self.fitting), generator=dice)
        steps, total = -(-len(order) // plan.batch), 0.0
        for k in range(steps):
            at = order[k * plan.batch : (k + 1) * plan.batch]
            x, y, w, whole = (v[at] for v in self.fit)
            if self.mirrors is not None:
                x, y = self.mirrors(x, y, dice)
            loss = self.loss(weights, x, y, w, whole)
            total += float(loss.detach()) * len(at)
            gradients = t.autograd.grad(loss, list(weights.values()))
            done = state.epoch * steps + k
            rate = _rate(done, plan.epochs * steps, plan.rate)
            with t.no_grad():
                for (key, value), g in zip(weights.items(), gradients, strict=True):
                    _adam(value, g, moments[0][key], moments[1][key], done + 1, rate, plan.decay)
        with t.no_grad():
            parts = [[v[i : i + 256] for v in self.check] for i in range(0, len(self.held), 256)]
            held = sum(float(self.loss(weights, *p)) * len(p[0]) for p in parts) / len(self.held)
        state.weights = {key: v.detach().numpy() for key, v in weights.items()}
        state.first, state.second = ({key: v.numpy() for key, v in m.items()} for m in moments)
        state.losses.append((total / len(order), held))

    def loss(self, weights: Mapping[str, Any], x: Any, y: Any, w: Any, whole: Any) -> Any:
        """Weighted squares of the mean, the likelihood of the std, and squares of the sums where these count."""
        out = carried(self.library, self.graph, weights, x)
        mean, spread = out[:, : y.shape[1]], out[:, y.shape[1] :].clamp(-WIDEST, WIDEST)
        off = (y - mean) ** 2
        likely = spread + 0.5 * off.detach() * (-2 * spread).exp()
        axes = tuple(range(1, off.ndim))
        loss = (w * off.mean(dim=axes)).mean() + 0.1 * likely.mean()
        if self.share == 0.0:
            return loss
        missed = (y - mean).flatten(1) @ self.sums.T / whole[:, None]
        return loss + self.share * (missed**2).mean()


def carried(library: Any, graph: Graph, weights: Mapping[str, Any], x: Any) -> Any:
    """What the network makes of a tensor."""
    known = {"in": x}
    for step in graph.steps:
        takes, own = [known[n] for n in step.takes], [weights[n] for n in step.weights]
        known[step.makes] = _act(library, step.kind, takes, own, step.wide)
    return known["out"]


def _act(t: Any, kind: str, takes: list[Any], own: list[Any], wide: int) -> Any:
    call = t.nn.functional
    match kind:
        case "dense":
            return call.linear(takes[0], *own)
        case "convolve":
            act = call.conv1d if own[0].ndim == 3 else call.conv2d
            return act(takes[0], *own, padding=tuple(wide * (n // 2) for n in own[0].shape[2:]), dilation=wide)
        case "rectify":
            return call.relu(takes[0])
        case "pool":
            return call.avg_pool2d(takes[0], 2)
        case "double":
            return call.interpolate(takes[0], scale_factor=2, mode="nearest")
        case "add":
            return sum(takes[1:], takes[0])
    return t.cat(takes, dim=1)


def _adam(value: Any, g: Any, first: Any, second: Any, step: int, rate: float, decay: float) -> None:
    """One step of Adam with decay of the weights (I. Loshchilov & F. Hutter, ICLR 2019), in place."""
    first.mul_(0.9).add_(g, alpha=0.1)
    second.mul_(0.99).addcmul_(g, g, value=0.01)
    change = (first / (1 - 0.9**step)) / ((second / (1 - 0.99**step)).sqrt() + 1e-8)
    if value.ndim > 1:
        value.mul_(1 - rate * decay)
    value.sub_(change, alpha=rate)


def _rate(done: int, total: int, largest: float) -> float:
    """A short rise, then half a cosine."""
    rise = max(1, total // 20)
    return largest * min((done + 1) / rise, 0.5 * (1 + np.cos(np.pi * done / total)))


@contextmanager
def _one_thread(library: Any) -> Any:
    """One thread and no choice of algorithm: the same bits for the same seed."""
    before, strict = library.get_num_threads(), library.are_deterministic_algorithms_enabled()
    library.set_num_threads(1)
    library.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        library.set_num_threads(before)
        library.use_deterministic_algorithms(strict)


def _begun(graph: Graph, seed: int) -> _State:
    weights = graph.started(seed)
    zero = {key: np.zeros_like(value) for key, value in weights.items()}
    return _State(weights, zero, {key: value.copy() for key, value in zero.items()}, weights)


def _named(graph: Graph, schedule: Schedule, seed: int, mark: str, count: int, sums: bool) -> str:
    return repr((graph.described(), schedule, seed, mark, count, sums))


def _keep(path: Path, name: str, state: _State) -> None:
    parts = {key: dict(getattr(state, key)) for key in ("weights", "first", "second", "kept")}
    told = {"of": name, "losses": np.array(state.losses), "stage": state.stage, "begun": state.begun}
    storage.write(path, {**told, **parts}, KIND)


def _resumed(path: Path | None, name: str) -> _State | None:
    if path is None or not path.exists():
        return None
    tree = storage.read(path, KIND)
    if tree["of"] != name:
        raise InputError("a checkpoint of another training", where=str(path), found="other examples or settings",
                         expected="those of this one", hint="remove the file, or name another")  # fmt: skip
    weights, first, second, kept = (
        {key: np.asarray(v, np.float32) for key, v in tree[part].items()}
        for part in ("weights", "first", "second", "kept")
    )
    losses = [(float(a), float(b)) for a, b in tree["losses"]]
    return _State(weights, first, second, kept, losses, int(tree["stage"]), int(tree["begun"]))
