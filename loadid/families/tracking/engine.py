"""The filter online: a settled gain while all is well, the square-root recursion around starts, gaps and gates."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import reals

from ...inverse.kalman.loops import Loop
from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.periodic import PeriodicLoop
from ...inverse.kalman.squareroot import Innovation, SquareRoot, State
from ...inverse.kalman.steady import Steady
from .gate import RARE, missed, reach, weighed
from .late import Late, Move
from .rhythm import Listener, Rhythm

ARRIVED = 1e-3  # of the variances, from which the settled gain takes over
REPEATS = 1e-9  # of the variances, from which the gains of a rhythm do
GATE = 6.0  # std of an innovation beyond which a sample is looked at
PATIENCE = 20  # samples: of good behaviour at most, until a channel is believed again; of a lost state, that it is held
DECISIVE = 3.0  # logarithm of the odds between an event and wrong channels
OPEN = 2.0  # of them at most, that the first sample may say: later ones decide


class Heard(NamedTuple):
    """Normalised innovations (m,) of a sample at a settled gain."""

    normalised: NDArray[np.float64]


class Engine:
    """One filter with its state.

    Parameters
    ----------
    model : FilterModel
    settled : Steady or None
        None where none exists: every sample is one QR factorisation then, and the std may grow.
    gate : float or None
        Std of an innovation from which a channel is kept out, or an event taken up. None: every finite number is
        believed.
    width : array (m,), optional
        Factor on the std of each channel's innovation for the gate: what they are when all is well, where the model is
        not exact. One by default.

    Attributes
    ----------
    phase : {"warm-up", "steady", "transient", "periodic"}
    counts : Counter
        ``samples, missing, gated, steps, lost``.

    Notes
    -----
    Innovations beyond the gate are wrong channels or an event: a load that the prior did not expect, or, before the
    filter has settled once, a structure that moved already (`gate.weighed`). The likelier of the two speaks, a rival
    filter follows the other, and what later samples say decides between them; until then the band holds both. One
    channel that no event explains is kept out without a rival, for as long as it is beyond and as many samples longer
    as it was (at most `PATIENCE`): a sensor that is stuck passes the right value now and then. Where half of the
    channels have been beyond for more than `PATIENCE` samples, the state is wrong and not they: it is looked for anew.
    """

    def __init__(
        self, model: FilterModel, settled: Steady | None, gate: float | None = GATE, width: NDArray | None = None
    ) -> None:
        self.model, self.settled, self.gate = model, settled, gate
        self.core = SquareRoot(model)
        self.state: State | None = None  # filtered; None before the first sample
        self.ready: State | None = None  # prediction of the next sample, where it is handed over
        self.phase = "warm-up"
        self.counts: Counter[str] = Counter()
        self.width = np.ones(model.m) if width is None else np.asarray(width, float)
        self.wrong = np.zeros(model.m, int)  # samples beyond the gate, of a channel that is kept out
        self.good = np.zeros(model.m, int)  # samples within it since
        self.rival: State | None = None  # the other of two: with the event, or without the channels that may be wrong
        self.pair: tuple[tuple[State, Innovation], tuple[State, Innovation]] | None = None  # both, of the last sample
        self.believing = True  # the event, until now: the rival does not
        self.suspects = np.zeros(model.m, bool)  # channels that are wrong if there is no event
        self.doubt, self.lean, self.age = 0.0, 0.0, 0  # odds against the event, what is too early in them, samples
        self.events, self.out = 0, 0  # taken up by the one, channel samples kept out by the other
        self.young = True  # never settled
        self.said: Innovation | Heard | None = None
        self.listener = Listener(self.core)
        self.rhythm: Rhythm | None = None
        self.beat: PeriodicLoop | None = None
        self.taken = np.zeros(model.m)  # the last sample off the settled gain: NaN where a channel was kept out
        self._moves: NDArray[np.float64] | None = None
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
        y = self._sample(y)
        if self.phase == "periodic":
            load, std, e = np.empty((1, self.model.p)), np.empty((1, self.model.p)), np.empty((1, self.model.m))
            if self._turned(y[None], load, std, e):
                return load[0], std[0]
        return self._slow(y)

    def block(
        self, Y: NDArray, load: NDArray, std: NDArray, e: NDArray | None = None, taken_as: NDArray | None = None,
        late: Late | None = None,
    ) -> None:  # fmt: skip
        """Fill loads and std (samples, p) of a block (samples, m).

        Where given, `e` gets the normalised innovations, `taken_as`, a copy of the block, NaN where a channel was kept
        out, and loads and std are those that `late` makes of them.
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
                if late is not None and taken:
                    part = slice(k, k + taken)
                    load[part], std[part] = late.calm(self.settled, load[part], raw[part])
                self.counts["samples"] += taken
                k += taken
            elif self.phase == "periodic":
                assert self.beat is not None
                first, rhythm = self.beat.phase, self.rhythm
                taken = self._turned(Y[k:], load[k:], std[k:], raw[k:])
                if late is not None and rhythm is not None:
                    for i in range(k, k + taken):
                        before, now = rhythm.pair(first + i - k)
                        news = raw[i, now.part.mask] * now.innovation_std
                        load[i], std[i] = late.phase(before, now, load[i].copy(), news)
                if e is not None:
                    e[k : k + taken] = raw[k : k + taken]
                k += taken
            if k == len(Y):
                return
            origin = self._origin() if late is not None else (None, None)
            load[k], std[k] = self._slow(self._sample(Y[k]))
            if late is not None:
                self._follow(late, origin, load[k], std[k])
            if e is not None:
                e[k] = np.nan if self.said is None else self.said.normalised
            if taken_as is not None:
                taken_as[k] = self.taken
            k += 1

    def _sample(self, y: ArrayLike) -> NDArray[np.float64]:
        return self.core.sample(reals(y, where="sample", what="a sample that is no row of real numbers"))

    def _origin(self) -> tuple[State | None, State | None]:
        """States of the sample before, of the filter that believes (or speaks alone) and of the one that does not."""
        if self.phase == "periodic":
            assert self.rhythm is not None
            assert self.beat is not None
            last = self.rhythm.masks[self.beat.phase - 1]
            return State(self.beat.x, self.rhythm.ahead[0], np.where(last, 0.0, np.nan)), None
        state = None if self.phase == "steady" else self.state
        return (state, self.rival) if self.believing or self.rival is None else (self.rival, state)

    def _follow(self, late: Late, before: tuple[State | None, State | None], load: NDArray, std: NDArray) -> None:
        """Loads and std of a sample off the settled gain, as they are some samples late."""
        if self.pair is None:
            assert self.state is not None
            assert isinstance(self.said, Innovation)
            load[:], std[:] = late.moved(self.core, [Move(before[0], self.state, self.said)], 0)
            return
        first, second = before[0], before[1] if before[1] is not None else before[0]
        moves = [Move(first, *self.pair[0]), Move(second, *self.pair[1])]
        load[:], std[:] = late.moved(self.core, moves, 0 if self.believing else 1)
        if self.rival is None:
            late.decided(0 if self.believing else 1)

    def _turned(self, Y: NDArray, load: NDArray, std: NDArray, e: NDArray) -> int:
        """Fill samples at the gains of a rhythm up to the first that does not fit; how many."""
        assert self.beat is not None
        assert self.rhythm is not None
        phase, period = self.beat.phase, self.rhythm.period
        taken = self.beat.block(Y, load, e)
        if taken:
            phases = (phase + np.arange(taken)) % period
            std[:taken] = self.rhythm.std[phases]
            self.counts["samples"] += taken
            self.counts["missing"] += int(np.sum(self.rhythm.absent[phases]))
            self.taken, self.said = Y[taken - 1].copy(), Heard(e[taken - 1].copy())
        return taken

    def _slow(self, y: NDArray) -> tuple[NDArray, NDArray]:
        self.counts["samples"] += 1
        self.counts["missing"] += int(np.sum(~np.isfinite(y)))
        before, there = self._predicted(), np.isfinite(y)
        if self.rival is None:
            self._judged(y, before)
        else:
            self._compared(y, before, self.core.predict(self.rival))
        self._settle(self.taken, there)
        assert self.state is not None
        Cp = self.model.Cp
        load, std = Cp @ self.state.x, np.linalg.norm(Cp @ self.state.L, axis=1)
        if self.rival is not None:  # a mixture of the two, seen from the one that speaks
            odds = self.doubt - min(self.lean, 0.0)  # that no load explains a sample may be believed at once
            other = _share(odds if self.believing else -odds)
            std = np.sqrt(std**2 + other * (1 - other) * (load - Cp @ self.rival.x) ** 2)
        return load, std

    # -- gates ------------------------------------------------------------------------------------------------------
    def _beyond(self, y: NDArray, before: State) -> tuple[NDArray, NDArray[np.bool_]]:
        """Innovations, and which of them are beyond the gate."""
        assert self.gate is not None
        H = self.model.H
        e = y - H @ before.x
        spread = self.width * np.sqrt(np.sum((H @ before.L) ** 2, axis=1) + np.sum(self.model.LR**2, axis=1))
        return e, np.isfinite(e) & (np.abs(e) > self.gate * spread)

    def _judged(self, y: NDArray, before: State) -> None:
        """A sample while nothing is in doubt: channels beyond the gate are wrong, or an event begins."""
        if self.gate is None or (self.phase == "warm-up" and self.state is None):
            self._take(before, y)
            return
        e, beyond = self._beyond(y, before)
        barred = self.wrong > 0
        if not beyond.any() and not barred.any():
            self._take(before, y)
            return
        fresh = beyond & ~barred
        odds, wider, lost = np.inf, before, False
        if fresh.any():
            odds, wider, lost = self._event(np.where(barred, np.nan, e), before, fresh)
        if np.isinf(odds) or (odds > DECISIVE and fresh.sum() == 1):
            held, state_lost = self._held(y, beyond)
            self._take(self._found(before) if state_lost else before, np.where(held, np.nan, y))
            return
        held, _ = self._held(y, beyond & barred)
        y = np.where(held, np.nan, y)
        without = np.where(fresh, np.nan, y)
        believed, doubted = self.core.update(wider, y), self.core.update(before, without)
        self.suspects, self.age, self.events, self.out = fresh, 0, 1, int(fresh.sum())
        self.counts["lost"] += lost
        self.doubt, self.lean = odds, odds - float(np.clip(odds, -OPEN, OPEN))
        self._speak(believed, doubted, y, without, believing=odds <= DECISIVE)

    def _speak(
        self, believed: tuple[State, Innovation], doubted: tuple[State, Innovation], y: NDArray, without: NDArray, *,
        believing: bool,
    ) -> None:  # fmt: skip
        """The likelier filter speaks; the other goes on as its rival."""
        first, second = (believed, doubted) if believing else (doubted, believed)
        self.pair = believed, doubted
        self.believing, self.taken = believing, y if believing else without
        (self.state, self.said), self.rival = first, second[0]

    def _take(self, before: State, y: NDArray) -> None:
        self.state, self.said = self.core.update(before, y)
        self.taken, self.pair = y, None

    def _event(self, e: NDArray, before: State, wrong: NDArray) -> tuple[float, State, bool]:
        """Odds of wrong channels against an event, the prediction that expects it, and whether the state was lost."""
        H, LR = self.model.H, self.model.LR
        root = self.width[:, None] * np.hstack([H @ before.L, LR])
        odds, size = weighed(e, root, H @ self.model.LQ, wrong)
        if odds > DECISIVE and self.young:
            ways = self._reach()
            other, far = weighed(e, root, H @ ways, wrong)
            if other < odds:
                return other, _wider(before, far * ways), True
        return odds, _wider(before, size * self.model.LQ), False

    def _held(self, y: NDArray, beyond: NDArray) -> tuple[NDArray[np.bool_], bool]:
        """Which channels are kept out of this sample, and whether it is the state that is wrong and not they."""
        there = np.isfinite(y)
        self.wrong[beyond] += 1
        self.good = np.where(beyond, 0, self.good + (there & (self.wrong > 0)))
        back = (self.wrong > 0) & (self.good >= np.minimum(self.wrong, PATIENCE))
        self.wrong[back], self.good[back] = 0, 0
        held = there & (self.wrong > 0)
        if 2 * held.sum() >= there.sum() and self.wrong.max() > PATIENCE:
            self.wrong[:], self.good[:] = 0, 0
            return np.zeros_like(held), True
        self.counts["gated"] += int(held.sum())
        return held, False

    def _found(self, before: State) -> State:
        """A prediction as wide as the structure moves: where the state is, the sample says."""
        self.counts["lost"] += 1
        return _wider(before, self._reach())

    def _compared(self, y: NDArray, before: State, ahead: State) -> None:
        """A sample to the filter that speaks and to its rival (`ahead`: its prediction), and what it decides."""
        held, _ = self._held(y, self._beyond(y, before)[1] & (self.wrong > 0))
        y = np.where(held, np.nan, y)
        with_it, without = (before, ahead) if self.believing else (ahead, before)
        believed, taken, own, again = self._believed(y, with_it)
        self.events += again
        e, wrong = self._beyond(y, without)
        left = np.where(wrong, np.nan, y)
        doubted = self.core.update(without, left)
        other = doubted[1].loglik
        if self.suspects.sum() == 1:  # one sensor that is broken stays so: the others are to judge
            alone = np.where(self.suspects & wrong, np.nan, y)
            own = own if np.array_equal(alone, y, equal_nan=True) else self._believed(alone, with_it)[2]
            other += missed(e, wrong & ~self.suspects)
        else:
            other += missed(e, wrong)
        self.doubt += other - own
        self.age += 1
        self.out += int(wrong.sum())
        self._speak(believed, doubted, taken, left, believing=self.believing)
        self._decide(believed, doubted, taken, left, wrong)

    def _believed(self, y: NDArray, before: State) -> tuple[tuple[State, Innovation], NDArray, float, bool]:
        """A sample to the filter that believes: its state, what it took, the log density, whether the event goes on."""
        e, beyond = self._beyond(y, before)
        density, again = 0.0, False
        if beyond.any():
            odds, wider, _ = self._event(e, before, beyond)
            if odds <= DECISIVE:
                before, density, again = wider, -RARE, True
            else:
                y, density = np.where(beyond, np.nan, y), missed(e, beyond)
        found = self.core.update(before, y)
        return found, y, density + found[1].loglik, again

    def _decide(
        self, believed: tuple[State, Innovation], doubted: tuple[State, Innovation], y: NDArray, left: NDArray,
        wrong: NDArray,
    ) -> None:  # fmt: skip
        """End the doubt where later samples have spoken, or for good."""
        odds = self.doubt - self.lean
        if abs(odds) <= DECISIVE and self.age < PATIENCE:
            return
        event = odds < 0 if abs(odds) > DECISIVE else self.believing
        self._speak(believed, doubted, y, left, believing=event)
        self.rival = None
        if event:
            self.counts["steps"] += self.events
            return
        self.counts["gated"] += self.out
        self.wrong[wrong] = self.age + 1

    def _predicted(self) -> State:
        """Mean and covariance of the sample that comes, before it."""
        if self.phase == "steady":
            assert self.loop is not None
            self.phase = "transient"
            return State(self.loop.x, self._ahead)
        if self.phase == "periodic":
            assert self.beat is not None
            assert self.rhythm is not None
            self.phase = "transient"
            self.listener.clear()
            return State(self.beat.x, self.rhythm.ahead[self.beat.phase])
        if self.ready is not None:
            before, self.ready = self.ready, None
            return before
        if self.state is None:
            return self.core.start()
        return self.core.predict(self.state)

    def _settle(self, y: NDArray, there: NDArray[np.bool_]) -> None:
        """Back to a settled gain where the covariance has arrived at its: that of all channels, or of a rhythm."""
        assert self.state is not None
        self.listener.hear(there)
        if self.rival is not None or not np.array_equal(np.isfinite(y), there):
            return
        now = np.sum(self.state.L**2, axis=1)
        whole = self.loop is not None and there.all()
        if whole and np.all(np.abs(now - self._variance) <= ARRIVED * self._variance):
            assert self.loop is not None
            self.loop.x = self.core.predict(self.state).x
            self.phase, self.young = "steady", False
            self.listener.clear()
            return
        found = self.listener.found()
        if found is None:
            return
        rhythm, phase = found
        if np.all(np.abs(now - rhythm.variances[phase]) <= REPEATS * rhythm.variances[phase]):
            self._beat(rhythm, self.core.predict(self.state).x, (phase + 1) % rhythm.period)
            self.young = False

    def _beat(self, rhythm: Rhythm, x: NDArray, phase: int) -> None:
        """To the gains of a rhythm, from the prediction of a sample of this phase."""
        sigmas = np.inf if self.gate is None else self.gate * self.width
        self.rhythm, self.beat = rhythm, PeriodicLoop(rhythm.filters, x, phase, sigmas)
        self.phase = "periodic"

    def _reach(self) -> NDArray[np.float64]:
        if self._moves is None:
            self._moves = reach(self.model)
        return self._moves

    # -- to another filter --------------------------------------------------------------------------------------------
    def succeed(self, old: Engine, T: NDArray | None) -> None:
        """Go on where the engine of another model stands: states T times its own, or, without T, anywhere in reach."""
        self.counts, self.wrong, self.good = old.counts.copy(), old.wrong.copy(), old.good.copy()
        if old.state is None and old.phase != "steady" and old.ready is None:
            return
        before = old._predicted()
        whole = np.eye(self.model.n)
        if T is not None:
            whole[: len(T), : len(T)] = T
        self.ready = State(whole @ before.x, whole @ before.L)
        if T is None:
            self.ready = _wider(self.ready, self._reach())
        self.state, self.phase = State(self.ready.x, self.ready.L, np.full(self.model.m, np.nan)), "transient"

    # -- the state for files ----------------------------------------------------------------------------------------
    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        return {
            "phase": self.phase,
            "state": _arrays(self.state),
            "rival": _arrays(self.rival),
            "ahead": None if self.loop is None else self.loop.x,
            "listener": self.listener.to_tree(),
            "beat": None if self.phase != "periodic" else self._beaten_tree(),
            "ready": _arrays(self.ready),
            "wrong": self.wrong.copy(),
            "good": self.good.copy(),
            "believing": self.believing,
            "suspects": self.suspects,
            "doubt": self.doubt,
            "lean": self.lean,
            "age": self.age,
            "events": self.events,
            "out": self.out,
            "young": self.young,
            "counts": dict(self.counts),
        }

    def _beaten_tree(self) -> dict[str, Any]:
        assert self.beat is not None
        assert self.rhythm is not None
        return {"masks": self.rhythm.masks, "x": self.beat.x, "phase": self.beat.phase}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.phase = str(tree["phase"])
        self.state, self.ready = _state(tree["state"]), _state(tree["ready"])
        self.rival = _state(tree["rival"])
        if self.loop is not None and tree["ahead"] is not None:
            self.loop.x = np.asarray(tree["ahead"], float)
        self.listener.restore(tree["listener"])
        if (beat := tree["beat"]) is not None:
            rhythm = self.listener.solved(np.array(beat["masks"], bool))
            assert rhythm is not None
            self._beat(rhythm, np.asarray(beat["x"], float), int(beat["phase"]))
        self.wrong, self.good = np.array(tree["wrong"], int), np.array(tree["good"], int)
        self.believing, self.young = bool(tree["believing"]), bool(tree["young"])
        self.suspects = np.array(tree["suspects"], bool)
        self.doubt, self.lean = float(tree["doubt"]), float(tree["lean"])
        self.age, self.events, self.out = int(tree["age"]), int(tree["events"]), int(tree["out"])
        self.counts = Counter({str(k): int(v) for k, v in tree["counts"].items()})


def _share(odds: float) -> float:
    """Probability of logarithmic odds."""
    return float(1 / (1 + np.exp(np.clip(-odds, -500, 500))))


def _wider(before: State, ways: NDArray) -> State:
    return State(before.x, np.hstack([before.L, ways]), before.y)


def _arrays(state: State | None) -> dict[str, Any] | None:
    return None if state is None else {"x": state.x, "L": state.L, "y": state.y}


def _state(tree: dict[str, Any] | None) -> State | None:
    if tree is None:
        return None
    y = tree["y"]
    return State(
        np.asarray(tree["x"], float), np.asarray(tree["L"], float), None if y is None else np.asarray(y, float)
    )
