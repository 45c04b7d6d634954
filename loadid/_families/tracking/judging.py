"""What a sample is worth: wrong channels kept out, events of the load taken up, two filters while it is in doubt.

Innovations beyond the gate are wrong channels or an event: a load that the prior did not expect, or, before the filter
has settled once, a structure that moved already (`gate.weighed`). The likelier of the two speaks, a rival filter
follows the other, and what later samples say decides between them. One channel that no event explains is kept out
without a rival, for as long as it is beyond and as many samples longer as it was (at most `PATIENCE`): a sensor that is
stuck passes the right value now and then. Where half of the channels have been beyond for more than `PATIENCE` samples,
the state is wrong and not they: it is looked for anew. The filter without a gate judges all of it (`plain`).
"""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._guards.tracking import FAR
from ..._inverse.gaussian.model import FilterModel, FilterState, Innovation, SquareRoot
from ..._inverse.gaussian.roots import Array
from .gate import CALM, DOUBLINGS, OVER, RARE, Plain, missed, onset, plain_of, reach, usual, weighed

GATE = 6.0  # std of an innovation beyond which a sample is looked at
PATIENCE = 20  # samples: of good behaviour at most, until a channel is believed again; of a lost state, that it is held
DECISIVE = 3.0  # logarithm of the odds between an event and wrong channels
TOLD = 3.0  # stds that a load after an event must have, to be answered and not that of a calm filter without a gate
WORSE = 2  # channels beyond the gate for one sample (of two channels one): so much worse may the gate predict
OPEN = 2.0  # of them at most, that the first sample may say: later ones decide

Updated = tuple[FilterState, Innovation]


class Heard(NamedTuple):
    """Normalised innovations (m,) of a sample at a settled gain."""

    normalised: Array


class Judge:
    """A filter off the settled gain, with its doubts.

    Parameters
    ----------
    model : FilterModel
    gate : float or None
        None: every finite number is believed.
    width : array (m,), optional
        Factor on the std of each channel's innovation, one by default.
    """

    def __init__(self, model: FilterModel, gate: float | None = GATE, width: Array | None = None) -> None:
        self.model, self.gate, self.core = model, gate, SquareRoot(model)
        self.width = np.ones(model.m) if width is None else np.asarray(width, float)
        self.counts: Counter[str] = Counter()
        self.state: FilterState | None = None  # filtered; None before the first sample
        self.innovation: Innovation | Heard | None = None
        self.taken = np.zeros(model.m)  # the last sample off the settled gain: NaN where a channel was kept out
        self.wrong = np.zeros(model.m, int)  # samples beyond the gate, of a channel that is kept out
        self.good = np.zeros(model.m, int)  # samples within it since
        self.rival: FilterState | None = (
            None  # the other of two: with the event, or without the channels that may be wrong
        )
        self.pair: tuple[Updated, Updated] | None = None  # both, of the last sample: with the event, and without
        self.believing = True  # the event, until now: the rival does not
        self.suspects = np.zeros(model.m, bool)  # channels that are wrong if there is no event
        self.doubt, self.lean, self.age = 0.0, 0.0, 0  # odds against the event, what is too early in them, samples
        self.events, self.out = 0, 0  # taken up by the one, channel samples kept out by the other
        self.young = True  # never settled
        self._moves: Array | None = None
        self.plain: Plain | None = None  # the filter without a gate, since the gate opened
        self.fell = False  # with the last sample, to that filter
        self.failed, self.loud = 0, 0  # times that the gate was set aside; last sample beyond it since
        self.beyond = np.zeros(model.m, int)  # samples of each channel beyond the gate: kept out, or believed after all
        self.largest, self.size = 0.0, 0.0  # event that was taken up, and that of the doubt: over what the prior knows
        self._usual: float | None = None
        self._ways = onset(model)  # of an event in this sample, then in the samples before

    def judge(self, y: Array, before: FilterState) -> None:
        """Take a sample up, from the prediction of the filter that speaks."""
        self.fell = False
        if self._aside(y, before):
            self._take(before, y)
            return
        steps, lost, barred = self.counts["steps"], self.counts["lost"], self.wrong > 0
        if self.rival is None:
            self._judged(y, before)
        else:
            self._compared(y, before, self.core.predict(self.rival))
        if self.plain is None and self.rival is None and not self.wrong.any():
            return
        if self.counts["lost"] > lost:  # the filter without a gate would not know: it begins anew where the state is
            self.plain = None
            return
        decided = True if self.counts["steps"] > steps else None
        if decided is None and np.any((self.wrong > 0) & ~barred):
            decided = False
        self._overseen(y, before, decided)

    def answer(self) -> tuple[Array, Array]:
        """Loads and their std (p,) after it; in doubt the std of both filters together."""
        assert self.state is not None
        Cp = self.model.Cp
        load: Array = Cp @ self.state.x
        std: Array = np.linalg.norm(Cp @ self.state.L, axis=1)
        if self.plain is not None and (self.believing if self.rival is not None else self.plain.event):
            off = Cp @ self.plain.state.x - load
            untold = np.maximum(np.abs(off), np.abs(load)) < TOLD * std  # by the event, so far
            if np.all(untold & ((self.plain.calm > 0) | (np.abs(load + off) < np.abs(load)))):
                load, std = load + off, np.sqrt(std**2 + off**2)
        if self.rival is None:
            return load, std
        odds = self.doubt - min(self.lean, 0.0)  # that no load explains a sample may be believed at once
        other = _share(odds if self.believing else -odds)
        return load, np.sqrt(std**2 + other * (1 - other) * (load - Cp @ self.rival.x) ** 2)

    # -- the filter without a gate ------------------------------------------------------------------------------------
    def _aside(self, y: Array, before: FilterState) -> bool:
        """Whether a sample is believed although it is beyond the gate: that has failed, and nothing was calm since."""
        if not self.failed or self.gate is None or self.plain is not None:
            return False
        beyond = self._beyond(y, before)[1]
        if not beyond.any():
            return False
        now = self.counts["samples"]
        calm, self.loud = now - self.loud, now
        if calm > CALM * 2 ** min(self.failed, DOUBLINGS):
            return False
        self.beyond += beyond
        self.counts["believed"] += int(beyond.sum())
        return True

    def _overseen(self, y: Array, before: FilterState, decided: bool | None) -> None:
        """A sample to the filter without a gate, which goes on in place of the other where that is no better."""
        assert self.gate is not None
        plain = self.plain
        ahead = before if plain is None else self.core.predict(plain.state)
        plain = Plain(ahead) if plain is None else plain
        against = plain.contradicts(decided)
        out = np.isfinite(y) & ~np.isfinite(self.taken)
        few = 2 * out.sum() < np.isfinite(y).sum()  # as many channels as one can do without: they do not count
        sizes = self._sizes(y, ahead, ahead), self._sizes(y, before, ahead)
        plain = plain.after(*self.core.update(ahead, y), sizes, self.gate, out=out, few=bool(few), decided=decided)
        self.plain = plain
        failed = against or plain.behind > min(max(len(y) - 1, 1), WORSE) * self.gate**2
        if failed or (plain.whole and plain.calm >= CALM):
            self.state, self.innovation, self.taken = plain.state, plain.innovation, y
            self.rival = self.pair = self.plain = None
            self.wrong[:], self.good[:] = 0, 0
            self.fell = True
            if failed and out.sum() > 1 and np.all(out | ~np.isfinite(y)):  # no sensor is right: the state is wrong
                self.state, self.innovation = self.core.update(self._found(ahead), y)
            if failed:
                self.failed, self.loud = self.failed + 1, self.counts["samples"]
            return
        self.beyond += out
        if plain.age >= OVER and self.rival is None and not self.wrong.any():
            self._agreed()

    def _agreed(self) -> None:
        """The gate was right."""
        if self.plain is not None:
            self.plain, self.failed = None, max(self.failed - 1, 0)

    def _sizes(self, y: Array, before: FilterState, ahead: FilterState) -> Array:
        """Of the innovations (m,) after the prediction `before`, over the std that `ahead` expects."""
        H = self.model.H
        spread = self.width * np.sqrt(np.sum((H @ ahead.L) ** 2, axis=1) + np.sum(self.model.LR**2, axis=1))
        return np.asarray(np.abs(y - H @ before.x) / spread)

    # -- inside -----------------------------------------------------------------------------------------------------
    def _beyond(self, y: Array, before: FilterState) -> tuple[Array, NDArray[np.bool_]]:
        """Innovations, and which of them are beyond the gate."""
        assert self.gate is not None
        H = self.model.H
        e = y - H @ before.x
        spread = self.width * np.sqrt(np.sum((H @ before.L) ** 2, axis=1) + np.sum(self.model.LR**2, axis=1))
        return e, np.isfinite(e) & (np.abs(e) > self.gate * spread)

    def _judged(self, y: Array, before: FilterState) -> None:
        """A sample while nothing is in doubt: channels beyond the gate are wrong, or an event begins."""
        if self.gate is None or self.state is None:
            self._take(before, y)
            return
        e, beyond = self._beyond(y, before)
        barred = self.wrong > 0
        if not beyond.any() and not barred.any():
            self._take(before, y)
            return
        fresh = beyond & ~barred
        odds, wider, lost, size = np.inf, before, False, 0.0
        if fresh.any():
            odds, wider, lost, size = self._event(np.where(barred, np.nan, e), before, fresh)
        if np.isinf(odds) or (odds > DECISIVE and fresh.sum() == 1):
            held, state_lost = self._held(y, beyond)
            self._take(self._found(before) if state_lost else before, np.where(held, np.nan, y))
            return
        held, _ = self._held(y, beyond & barred)
        y = np.where(held, np.nan, y)
        without = np.where(fresh, np.nan, y)
        believed, doubted = self.core.update(wider, y), self.core.update(before, without)
        self.suspects, self.age, self.events, self.out = fresh, 0, 1, int(fresh.sum())
        self.size = size
        self.counts["lost"] += lost
        self.doubt, self.lean = odds, odds - float(np.clip(odds, -OPEN, OPEN))
        self._speak(believed, doubted, y, without, believing=odds <= DECISIVE)

    def _speak(
        self, believed: Updated, doubted: Updated, y: Array, without: Array, *,
        believing: bool,
    ) -> None:  # fmt: skip
        """The likelier filter speaks; the other goes on as its rival."""
        first, second = (believed, doubted) if believing else (doubted, believed)
        self.pair = believed, doubted
        self.believing, self.taken = believing, y if believing else without
        (self.state, self.innovation), self.rival = first, second[0]

    def _take(self, before: FilterState, y: Array) -> None:
        self.state, self.innovation = self.core.update(before, y)
        self.taken, self.pair = y, None

    def _event(self, e: Array, before: FilterState, wrong: NDArray[np.bool_]) -> tuple[float, FilterState, bool, float]:
        """Odds of wrong channels against an event, and the prediction that expects it.

        Then whether the state was lost, and the size of the event over that which makes the load as large as its prior.
        Of the samples in which it may have begun those are taken that make it likely; of two that are alike the smaller
        event (half-Cauchy sizes).
        """
        H, LR = self.model.H, self.model.LR
        if self._usual is None:
            self._usual = usual(self.model)
        root = self.width[:, None] * np.hstack([H @ before.L, LR])
        step, best = onset(self.model).shape[1], np.inf
        odds, size, ways = np.inf, 0.0, self._ways
        for stop in range(step, self._ways.shape[1] + 1, step):
            found, c = weighed(e, root, H @ self._ways[:, :stop], wrong)
            cost = found + float(np.log(max(c / self._usual, 1.0)))
            if cost < best:
                best, odds, size, ways = cost, found, c, self._ways[:, :stop]
        if odds > DECISIVE and self.young:
            reached = self._reach()
            other, far = weighed(e, root, H @ reached, wrong)
            if other < odds:
                return other, wider(before, far * reached), True, far
        if size > FAR * self._usual:  # not before later samples have confirmed it
            odds = max(odds, 2 * DECISIVE)
        return odds, wider(before, size * ways), False, size / self._usual

    def _held(self, y: Array, beyond: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], bool]:
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

    def _found(self, before: FilterState) -> FilterState:
        """A prediction as wide as the structure moves: where the state is, the sample says."""
        self.counts["lost"] += 1
        return wider(before, self._reach())

    def _compared(self, y: Array, before: FilterState, ahead: FilterState) -> None:
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

    def _believed(self, y: Array, before: FilterState) -> tuple[Updated, Array, float, bool]:
        """A sample to the filter that believes: its state, what it took, the log density, whether the event goes on."""
        e, beyond = self._beyond(y, before)
        density, again = 0.0, False
        if beyond.any():
            odds, wider, _, size = self._event(e, before, beyond)
            if odds <= DECISIVE:
                before, density, again = wider, -RARE, True
                self.size = max(self.size, size)
            else:
                y, density = np.where(beyond, np.nan, y), missed(e, beyond)
        found = self.core.update(before, y)
        return found, y, density + found[1].loglik, again

    def _decide(
        self, believed: Updated, doubted: Updated, y: Array, left: Array,
        wrong: NDArray[np.bool_],
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
            self.largest = max(self.largest, self.size)
            return
        self.counts["gated"] += self.out
        self.wrong[wrong] = self.age + 1

    def _reach(self) -> Array:
        if self._moves is None:
            self._moves = reach(self.model)
        return self._moves

    # -- the state for files ----------------------------------------------------------------------------------------
    def judged_tree(self) -> dict[str, Any]:
        """What a sample changes in it, as plain arrays and numbers."""
        return {
            "state": arrays(self.state),
            "rival": arrays(self.rival),
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
            "plain": None if self.plain is None else self.plain.to_tree(),
            "failed": self.failed,
            "loud": self.loud,
            "beyond": self.beyond.copy(),
            "largest": self.largest,
            "size": self.size,
            "counts": dict(self.counts),
        }

    def restore_judged(self, tree: dict[str, Any]) -> None:
        """Go on from what `judged_tree` gave."""
        self.state, self.rival = state_of(tree["state"]), state_of(tree["rival"])
        self.wrong, self.good = np.array(tree["wrong"], int), np.array(tree["good"], int)
        self.believing, self.young = bool(tree["believing"]), bool(tree["young"])
        self.suspects = np.array(tree["suspects"], bool)
        self.doubt, self.lean = float(tree["doubt"]), float(tree["lean"])
        self.age, self.events, self.out = int(tree["age"]), int(tree["events"]), int(tree["out"])
        self.plain = plain_of(tree.get("plain"))  # what files of 0.1 do not hold has its first value
        self.beyond = np.array(tree.get("beyond", np.zeros(self.model.m)), int)
        self.failed, self.loud = int(tree.get("failed", 0)), int(tree.get("loud", 0))
        self.largest, self.size = float(tree.get("largest", 0.0)), float(tree.get("size", 0.0))
        self.counts = Counter({str(k): int(v) for k, v in tree["counts"].items()})


def wider(before: FilterState, ways: Array) -> FilterState:
    """A prediction with more directions of its root."""
    return FilterState(before.x, np.hstack([before.L, ways]), before.y)


def arrays(state: FilterState | None) -> dict[str, Any] | None:
    """A state as plain arrays."""
    return None if state is None else state.to_tree()


def state_of(tree: dict[str, Any] | None) -> FilterState | None:
    """Inverse of `arrays`."""
    return None if tree is None else FilterState.from_tree(tree)


def _share(odds: float) -> float:
    """Probability of logarithmic odds."""
    return float(1 / (1 + np.exp(np.clip(-odds, -500, 500))))
