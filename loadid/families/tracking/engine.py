"""The filter online: a settled gain while all is well, the square-root recursion around starts, gaps and gates."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import reals

from ...inverse.kalman.loops import Loop
from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.squareroot import Innovation, SquareRoot, State
from ...inverse.kalman.steady import Steady

ARRIVED = 1e-3  # of the variances, from which the settled gain takes over
GATE = 6.0  # std of an innovation beyond which a sample is looked at
PATIENCE = 20  # samples: of good behaviour at most, until a channel is believed again; of a lost state, that it is held
AGREE = 0.9  # share of what is beyond the gate that a step of the loads explains
DECISIVE = 2.0  # logarithm of the odds between a step of the load and one wrong channel


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
    width : array (m,), optional
        Factor on the std of each channel's innovation for the gate: what they are when all is well, where the model is
        not exact. One by default.

    Attributes
    ----------
    phase : {"warm-up", "steady", "transient"}
    counts : Counter
        ``samples, missing, gated, steps``.

    Notes
    -----
    A channel that is beyond the gate alone is kept out for as long as it is, and as many samples longer as it was (at
    most `PATIENCE`): a sensor that is stuck passes the right value now and then. Where half of the channels are, the
    state may be wrong and not they: after `PATIENCE` samples they are believed again. What a step of the loads explains
    is taken up at once; where one channel alone says so, a rival filter runs without it until the others have decided.
    """

    def __init__(
        self, model: FilterModel, settled: Steady | None, gate: float | None = GATE, width: NDArray | None = None
    ) -> None:
        self.model, self.settled, self.gate = model, settled, gate
        self.core = SquareRoot(model)
        self.state: State | None = None  # filtered; None before the first sample
        self.phase = "warm-up"
        self.counts: Counter[str] = Counter()
        self.width = np.ones(model.m) if width is None else np.asarray(width, float)
        self.wrong = np.zeros(model.m, int)  # samples beyond the gate, of a channel that is kept out
        self.good = np.zeros(model.m, int)  # samples within it since
        self.rival: State | None = None  # without the channel that may be wrong
        self.suspect, self.doubt, self.age = 0, 0.0, 0  # that channel, odds against it, samples of the rival
        self.said: Innovation | None = None
        self.taken = np.zeros(model.m)  # the last sample off the settled gain: NaN where a channel was kept out
        self.loop: Loop | None = None
        if settled is not None:
            limit = None if gate is None else gate * self.width * settled.innovation_std
            self.loop = Loop(settled.rows(), model.p, model.m, model.x0, limit)
            self._variance = np.sum(settled.L**2, axis=1)
            self._std = settled.std.copy()
            self._std.setflags(write=False)  # one array for all samples
            self._ahead = self.core.predict(State(model.x0, settled.L, np.zeros(model.m))).L

    # -- samples ----------------------------------------------------------------------------------------------------
    def step(self, y: ArrayLike) -> tuple[NDArray, NDArray]:
        """Loads and their std (p,) of one sample (m,), NaN where a channel is missing.

        Raises
        ------
        InputError
            No sample of this width, or infinite: it is not counted.
        """
        if self.phase == "steady":
            assert self.loop is not None
            try:
                load = self.loop.step(y)
            except TypeError:  # no numbers, or none that have a length: said below
                load = None
            except ValueError as error:
                if isinstance(error, InputError):
                    raise
                load = None
            if load is not None:
                self.counts["samples"] += 1
                return load, self._std
        return self._slow(self._sample(y))

    def block(
        self, Y: NDArray, load: NDArray, std: NDArray, e: NDArray | None = None, taken_as: NDArray | None = None
    ) -> None:
        """Fill loads and std (samples, p) of a block (samples, m).

        Where given, `e` gets the normalised innovations, and `taken_as`, a copy of the block, NaN where a channel was
        kept out.
        """
        Y = np.ascontiguousarray(Y, float)
        raw = np.empty(Y.shape)
        k = 0
        while k < len(Y):
            if self.phase == "steady":
                assert self.loop is not None
                assert self.settled is not None
                taken = self.loop.block(Y[k:], load[k:], raw[k:])
                std[k : k + taken] = self._std
                if e is not None:
                    e[k : k + taken] = raw[k : k + taken] / self.settled.innovation_std
                self.counts["samples"] += taken
                k += taken
                if k == len(Y):
                    return
            load[k], std[k] = self._slow(self._sample(Y[k]))
            if e is not None:
                e[k] = np.nan if self.said is None else self.said.normalised
            if taken_as is not None:
                taken_as[k] = self.taken
            k += 1

    def _sample(self, y: ArrayLike) -> NDArray[np.float64]:
        return self.core.sample(reals(y, where="sample", what="a sample that is no row of real numbers"))

    def _slow(self, y: NDArray) -> tuple[NDArray, NDArray]:
        self.counts["samples"] += 1
        self.counts["missing"] += int(np.sum(~np.isfinite(y)))
        before = self._predicted()
        if self.rival is None:
            y, before, doubted = self._judged(y, before)
            self.state, self.said = self.core.update(before, y)
            if doubted is not None:
                self._doubt(*doubted)
        else:
            y = self._weighed(y, before, self.core.predict(self.rival))
        self.taken = y
        self._settle(y)
        assert self.state is not None
        Cp = self.model.Cp
        load, std = Cp @ self.state.x, np.linalg.norm(Cp @ self.state.L, axis=1)
        if self.rival is not None:  # half the distance between the two: either is within two std
            std = np.sqrt(std**2 + ((load - Cp @ self.rival.x) / 2) ** 2)
        return load, std

    # -- gates ------------------------------------------------------------------------------------------------------
    def _beyond(self, y: NDArray, before: State) -> tuple[NDArray, NDArray, NDArray]:
        """Innovations, their std, and which of them are beyond the gate."""
        assert self.gate is not None
        H = self.model.H
        e = y - H @ before.x
        spread = self.width * np.sqrt(np.sum((H @ before.L) ** 2, axis=1) + np.sum(self.model.LR**2, axis=1))
        return e, spread, np.isfinite(e) & (np.abs(e) > self.gate * spread)

    def _judged(self, y: NDArray, before: State) -> tuple[NDArray, State, tuple[State, NDArray] | None]:
        """Channels beyond the gate are kept out, unless a step of the loads explains them; then it is taken up.

        Returns
        -------
        y : array (m,)
            NaN where a channel is kept out.
        before : State
            Prediction, wider where a step is taken up.
        doubted : (State, array) or None
            Prediction and sample of the rival, where one channel alone speaks of the step.
        """
        if self.gate is None or (self.phase == "warm-up" and self.state is None):
            return y, before, None
        e, spread, beyond = self._beyond(y, before)
        barred = self.wrong > 0
        if not beyond.any() and not barred.any():
            return y, before, None
        fresh = beyond & ~barred
        jump = self._jump(np.where(barred, np.nan, e), spread) if fresh.any() else None
        y = np.where(self._held(y, beyond if jump is None else beyond & barred), np.nan, y)
        if jump is None:
            return y, before, None
        self.counts["steps"] += 1
        alone = fresh.sum() == 1 and np.isfinite(y).sum() > 1
        doubted = (before, np.where(fresh, np.nan, y)) if alone else None
        return y, self._widened(before, jump), doubted

    def _doubt(self, before: State, y: NDArray) -> None:
        """A rival from the same sample without the channel that may be wrong."""
        assert self.said is not None
        self.suspect, self.doubt, self.age = int(np.argmax(self.said.present & np.isnan(y))), 0.0, 0
        self.rival = self.core.update(before, y)[0]

    def _held(self, y: NDArray, beyond: NDArray) -> NDArray[np.bool_]:
        """Which channels are kept out of this sample, and for how long they have been wrong and good since."""
        there = np.isfinite(y)
        self.wrong[beyond] += 1
        self.good = np.where(beyond, 0, self.good + (there & (self.wrong > 0)))
        back = (self.wrong > 0) & (self.good >= np.minimum(self.wrong, PATIENCE))
        self.wrong[back], self.good[back] = 0, 0
        held = there & (self.wrong > 0)
        if 2 * held.sum() >= there.sum() and self.wrong.max() > PATIENCE:  # not they: the state
            return np.zeros_like(held)
        self.counts["gated"] += int(held.sum())
        return held

    def _weighed(self, y: NDArray, before: State, ahead: State) -> NDArray[np.float64]:
        """A sample to the filter that took a step up, and to its rival (`ahead`: its prediction) that doubts it."""
        e, spread, out = self._beyond(y, before)
        out_of_rival = self._beyond(y, ahead)[2]
        wrong = bool(out_of_rival[self.suspect])
        out_of_rival[self.suspect] = False
        held = self._held(y, out & out_of_rival)
        y = np.where(held, np.nan, y)
        jump = self._jump(np.where(held, np.nan, e), spread) if (out & ~held).any() else None
        before = before if jump is None else self._widened(before, jump)
        self.state, self.said = self.core.update(before, y)
        other, own = y, self.said.loglik
        if wrong:  # the others are to judge
            other = y.copy()
            other[self.suspect] = np.nan
            own = self.core.update(before, other)[1].loglik
        self.rival, said = self.core.update(ahead, other)
        self.doubt += said.loglik - own
        self.age += 1
        if self.doubt > DECISIVE:
            self.counts["steps"] -= 1
            self.counts["gated"] += self.age + wrong
            self.wrong[self.suspect] = self.age + 1 if wrong else 0
            self.state, self.said, self.rival = self.rival, said, None
            return other
        if self.doubt < -DECISIVE or self.age >= PATIENCE:
            self.rival = None
        return y

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
            "wrong": self.wrong,
            "good": self.good,
            "suspect": self.suspect,
            "doubt": self.doubt,
            "age": self.age,
            "counts": dict(self.counts),
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.phase = str(tree["phase"])
        self.state = _state(tree["state"])
        self.rival = _state(tree["rival"])
        if self.loop is not None and tree["ahead"] is not None:
            self.loop.x = np.asarray(tree["ahead"], float)
        self.wrong, self.good = np.array(tree["wrong"], int), np.array(tree["good"], int)
        self.suspect, self.doubt, self.age = int(tree["suspect"]), float(tree["doubt"]), int(tree["age"])
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
