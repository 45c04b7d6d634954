"""The filter online: a settled gain while all is well, the square-root recursion around starts, gaps and gates."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inverse.kalman.loops import Loop
from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.squareroot import Innovation, SquareRoot, State
from ...inverse.kalman.steady import Steady

ARRIVED = 1e-3  # of the variances, from which the settled gain takes over
GATE = 6.0  # std of an innovation beyond which a sample is looked at
PATIENCE = 20  # samples that one channel is kept out at a stretch: then it is believed again
AGREE = 0.9  # share of what is beyond the gate that a step of the loads explains


class Engine:
    """One filter with its state.

    Parameters
    ----------
    model : FilterModel
    settled : Steady or None
        None where none exists: every sample is one QR factorisation then, and the std may grow.
    gate : float or None
        Std of an innovation from which a channel is kept out, or a step of the load is taken up. None: every finite
        number is believed.

    Attributes
    ----------
    phase : {"warm-up", "steady", "transient"}
    counts : Counter
        ``samples, missing, gated, steps``.
    """

    def __init__(self, model: FilterModel, settled: Steady | None, gate: float | None = GATE) -> None:
        self.model, self.settled, self.gate = model, settled, gate
        self.core = SquareRoot(model)
        self.state: State | None = None  # filtered; None before the first sample
        self.phase = "warm-up"
        self.counts: Counter[str] = Counter()
        self.out_for = np.zeros(model.m, int)
        self.rival: State | None = None  # without the channel that may be wrong
        self.said: Innovation | None = None
        self.loop: Loop | None = None
        if settled is not None:
            limit = None if gate is None else gate * settled.innovation_std
            self.loop = Loop(settled.rows(), model.p, model.m, model.x0, limit)
            self._variance = np.sum(settled.L**2, axis=1)
            self._ahead = self.core.predict(State(model.x0, settled.L, np.zeros(model.m))).L

    # -- samples ----------------------------------------------------------------------------------------------------
    def step(self, y: NDArray) -> tuple[NDArray, NDArray]:
        """Loads and their std (p,) of one sample (m,), NaN where a channel is missing."""
        self.counts["samples"] += 1
        if self.phase == "steady":
            assert self.loop is not None
            assert self.settled is not None
            load = self.loop.step(y)
            if load is not None:
                return load, self.settled.std
        return self._slow(self.core.sample(y))

    def block(self, Y: NDArray, load: NDArray, std: NDArray, e: NDArray | None = None) -> None:
        """Fill loads and std (samples, p) of a block (samples, m); normalised innovations into `e` where given."""
        Y = np.ascontiguousarray(Y, float)
        raw = np.empty(Y.shape)
        k = 0
        while k < len(Y):
            if self.phase == "steady":
                assert self.loop is not None
                assert self.settled is not None
                taken = self.loop.block(Y[k:], load[k:], raw[k:])
                std[k : k + taken] = self.settled.std
                if e is not None:
                    e[k : k + taken] = raw[k : k + taken] / self.settled.innovation_std
                self.counts["samples"] += taken
                k += taken
                if k == len(Y):
                    return
            load[k], std[k] = self.step(Y[k]) if self.phase != "steady" else self._first_slow(Y[k])
            if e is not None:
                e[k] = np.nan if self.said is None else self.said.normalised
            k += 1

    def _first_slow(self, y: NDArray) -> tuple[NDArray, NDArray]:
        self.counts["samples"] += 1
        return self._slow(self.core.sample(y))

    def _slow(self, y: NDArray) -> tuple[NDArray, NDArray]:
        self.counts["missing"] += int(np.sum(~np.isfinite(y)))
        before, rival = self._predicted(), self.rival
        self.rival = None
        y, before = self._judged(y, before)
        self.state, self.said = self.core.update(before, y)
        if rival is not None:
            self._decide(rival, y)
        self._settle(y)
        Cp = self.model.Cp
        load, std = Cp @ self.state.x, np.linalg.norm(Cp @ self.state.L, axis=1)
        if self.rival is not None:  # half the distance between the two: either is within two std
            std = np.sqrt(std**2 + ((load - Cp @ self.rival.x) / 2) ** 2)
        return load, std

    def _decide(self, rival: State, y: NDArray) -> None:
        """Whether the sample before was a step of the load or one wrong channel, by the likelihood of this one."""
        state, said = self.core.advance(rival, y)
        assert self.said is not None
        if said.loglik > self.said.loglik:
            self.state, self.said, self.rival = state, said, None
            self.counts["steps"] -= 1
            self.counts["gated"] += 1

    def _predicted(self) -> State:
        """Mean and covariance of the sample that comes, before it."""
        if self.phase == "steady":
            assert self.loop is not None
            self.phase = "transient"
            return State(self.loop.x, self._ahead)
        if self.state is None:
            return self.core.start()
        return self.core.predict(self.state)

    def _settle(self, y: NDArray) -> None:
        """Back to the settled gain where the covariance has arrived at its."""
        if self.settled is None or self.loop is None or self.rival is not None or not np.isfinite(y).all():
            return
        assert self.state is not None
        now = np.sum(self.state.L**2, axis=1)
        if np.all(np.abs(now - self._variance) <= ARRIVED * self._variance):
            self.loop.x = self.core.predict(self.state).x
            self.phase = "steady"

    def _judged(self, y: NDArray, before: State) -> tuple[NDArray, State]:
        """Channels beyond the gate are kept out, unless a step of the loads explains them; then it is taken up."""
        if self.gate is None or (self.state is None and self.phase == "warm-up" and self.counts["samples"] <= 1):
            return y, before
        H = self.model.H
        e = y - H @ before.x
        spread = np.sqrt(np.sum((H @ before.L) ** 2, axis=1) + np.sum(self.model.LR**2, axis=1))
        beyond = np.isfinite(e) & (np.abs(e) > self.gate * spread)
        self.out_for[~beyond] = 0
        if not beyond.any():
            return y, before
        jump = self._jump(e, spread)
        if jump is not None:
            self.counts["steps"] += 1
            self.out_for[:] = 0
            if beyond.sum() == 1 and self.model.m > 1:  # the channel may be wrong: the next sample decides
                self.rival = self.core.update(before, np.where(beyond, np.nan, y))[0]
            return y, self._widened(before, jump)
        self.out_for[beyond] += 1
        held = beyond & (self.out_for <= PATIENCE)
        self.counts["gated"] += int(held.sum())
        return np.where(held, np.nan, y), before

    def _jump(self, e: NDArray, spread: NDArray) -> NDArray[np.float64] | None:
        """Step of the loads, in units of their prior, that explains the innovations; None where none does."""
        seen = np.isfinite(e)
        loads = (self.model.H @ self._load_root())[seen] / spread[seen, None]
        white = e[seen] / spread[seen]
        jump = np.linalg.lstsq(loads, white, rcond=1e-6)[0]
        explained = np.sum((white - loads @ jump) ** 2) <= (1 - AGREE) * np.sum(white**2)
        return jump if explained else None

    def _load_root(self) -> NDArray[np.float64]:
        """Directions of the state that belong to the loads, in units of their priors."""
        root = np.array(self.model.L0)
        root[: self.model.nx] = 0.0
        return root[:, np.any(root, axis=0)]

    def _widened(self, before: State, jump: NDArray) -> State:
        return State(before.x, np.hstack([before.L, self._load_root() * np.abs(jump)]), before.y)

    # -- the state for files ----------------------------------------------------------------------------------------
    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        return {
            "phase": self.phase,
            "state": _arrays(self.state),
            "rival": _arrays(self.rival),
            "ahead": None if self.loop is None else self.loop.x,
            "out_for": self.out_for,
            "counts": dict(self.counts),
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.phase = str(tree["phase"])
        self.state = _state(tree["state"])
        self.rival = _state(tree["rival"])
        if self.loop is not None and tree["ahead"] is not None:
            self.loop.x = np.asarray(tree["ahead"], float)
        self.out_for = np.asarray(tree["out_for"], int)
        self.counts = Counter({str(k): int(v) for k, v in tree["counts"].items()})


def _arrays(state: State | None) -> dict[str, Any] | None:
    return None if state is None else {"x": state.x, "L": state.L, "y": state.y}


def _state(tree: dict[str, Any] | None) -> State | None:
    if tree is None:
        return None
    y = tree["y"]
    return State(
        np.asarray(tree["x"], float), np.asarray(tree["L"], float), None if y is None else np.asarray(y, float)
    )
