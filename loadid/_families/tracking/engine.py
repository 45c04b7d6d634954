"""The filter online: a settled gain while all is well, the square-root recursion elsewhere; loads that come late.

While the gain is settled a load is a short filter over later innovations (`loadid._inverse.gaussian.lag.LagLine`);
around everything else, and for as many samples after it as the answers are late, the covariance of the last loads with
the state goes on sample by sample (`Delayed`). Where two filters are in doubt, each has its own line.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, reals

from ..._inverse.gaussian.lag import Delayed, FixedLag, LagLine, delayed, resumed
from ..._inverse.gaussian.loop import ARRIVED, SHOWN, Loop, PeriodicLoop, RootLoop
from ..._inverse.gaussian.model import FilterModel, FilterState, Innovation, SquareRoot
from ..._inverse.gaussian.roots import Array
from ..._inverse.gaussian.steady import SteadyFilter
from .gate import recent
from .judging import GATE, PATIENCE, Heard, Judge, arrays, state_of, wider
from .likelihood import ChannelPeriod, Listener


class Move(NamedTuple):
    """A sample of one filter: the state before its prediction (None: with all channels), after it, what it said."""

    before: FilterState | None
    state: FilterState
    innovation: Innovation


class Late:
    """The last samples of a filter.

    Parameters
    ----------
    lag : int
    fixed : FixedLag or None
        Of the settled filter.
    load, std : array, shape (p,)
        Before the first sample: the prior.
    """

    def __init__(self, lag: int, fixed: FixedLag | None, load: Array, std: Array) -> None:
        self.lag, self.fixed, self.prior = lag, fixed, (load, std)
        self.line: LagLine | None = None
        self.forms: list[Delayed] = []  # of the filter that speaks (or, in doubt, believes), and of its rival
        self.recent: list[tuple[Array, Array]] = []  # loads and innovations since the gain is settled

    def calm(self, settled: SteadyFilter, load: Array, e: Array) -> tuple[Array, Array]:
        """Loads and std (samples, p) of `lag` samples ago, for loads and innovations (samples, m) at a settled gain."""
        late, std, k = np.empty(load.shape), np.empty(load.shape), 0
        while k < len(load) and self.line is None:
            late[k], std[k] = self.phase(settled, settled, load[k], e[k])
            self.recent = [*self.recent, (load[k].copy(), e[k].copy())][-self.lag :]
            if len(self.recent) == self.lag and len(self.forms[0].load) > self.lag and self.fixed is not None:
                self.line = LagLine(self.fixed)
                self.line.block(*(np.array(part) for part in zip(*self.recent, strict=True)))
            k += 1
        if self.line is not None and k < len(load):
            late[k:], std[k:] = self.line.block(load[k:], e[k:]), self.line.std
        return late, std

    def phase(self, before: SteadyFilter, now: SteadyFilter, load: Array, e: Array) -> tuple[Array, Array]:
        """The same of one sample at the gain of a phase after that of the phase before; e of its channels."""
        self._open()
        root = now.model.Cp @ now.L
        cross, variance = root @ now.L.T, np.sum(root**2, axis=1)
        none = np.zeros((0, *load.shape))
        last = self.forms[0] if self.forms else Delayed(none, none, np.zeros((0, *cross.shape)), self.lag)
        self.forms = [
            last.moved(before.part.F, now.part.H, now.Se_root, now.K @ now.Se_root, e, load, variance, cross, self.lag)
        ]
        return self._due(self.forms[0])

    def moved(self, core: SquareRoot, moves: list[Move], speaker: int) -> tuple[Array, Array]:
        """The same of a sample off the settled gain, by one filter or two; `speaker` is the one that answers."""
        self._open()
        self.recent = []
        forms = []
        for i, move in enumerate(moves):
            if not self.forms:
                forms.append(delayed(core, move.state, self.lag))
                continue
            form = self.forms[min(i, len(self.forms) - 1)]
            before = move.before if move.before is not None else FilterState(move.state.x, move.state.L)
            forms.append(form.advance(core, before, move.state, move.innovation, self.lag))
        self.forms = forms
        return self._due(forms[speaker])

    def decided(self, winner: int) -> None:
        """A doubt has ended."""
        self.forms = [self.forms[winner]]

    def cut(self, speaker: int) -> None:
        """Go on with another filter: nothing later is added to the loads before it."""
        self._open()
        self.forms = [_frozen(form) for form in self.forms[speaker : speaker + 1] or self.forms[:1]]

    def succeed(self, old: Late) -> None:
        """Go on with the loads of another model as they stand; nothing later is added to them."""
        old._open()
        self.forms = [_frozen(form) for form in old.forms[:1]]

    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays."""
        line = None if self.line is None else dict(zip(("load", "e"), self.line.last(), strict=True))
        forms = [{"load": f.load, "variance": f.variance, "cross": f.cross} for f in self.forms]
        return {"line": line, "forms": forms, "recent": [list(pair) for pair in self.recent]}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.line = None
        if tree["line"] is not None:
            assert self.fixed is not None
            self.line = LagLine(self.fixed)
            self.line.block(tree["line"]["load"], tree["line"]["e"])
        self.forms = [Delayed(f["load"], f["variance"], f["cross"], self.lag) for f in tree["forms"]]
        self.recent = [(load, e) for load, e in tree["recent"]]

    # -- inside -----------------------------------------------------------------------------------------------------
    def _open(self) -> None:
        """From the filter over innovations to the form with covariances."""
        if self.line is not None:
            assert self.fixed is not None
            self.forms, self.line, self.recent = [resumed(self.fixed, *self.line.last())], None, []

    def _due(self, form: Delayed) -> tuple[Array, Array]:
        if len(form.load) <= self.lag:
            return self.prior
        return form.load[self.lag], form.std[self.lag]


def _frozen(form: Delayed) -> Delayed:
    """Loads as they stand, of which no later sample tells any more."""
    return Delayed(form.load, form.variance, np.zeros_like(form.cross), form.lag)


NEAR = 1e-3  # of the variances, from which the settled gain takes over
OFF = "transient"  # phase off the settled gain
PIECE = 64  # samples off it that are taken at once
REPEATS = 1e-9  # of the variances, from which the gains of a rhythm do


class Engine(Judge):
    """One filter with its state.

    Parameters
    ----------
    model : FilterModel
    settled : SteadyFilter or None
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
        ``samples, missing, gated, believed, steps, lost``.
    """

    def __init__(
        self, model: FilterModel, settled: SteadyFilter | None, gate: float | None = GATE, width: Array | None = None
    ) -> None:
        super().__init__(model, gate, width)
        self.settled = settled
        self.phase = "warm-up"
        self.ready: FilterState | None = None  # prediction of the next sample, where it is handed over
        self.listener = Listener(self.core, settled is not None)
        self.rhythm: ChannelPeriod | None = None
        self.beat: PeriodicLoop | None = None
        self.loop: Loop | None = None
        self.roots: RootLoop | None = None
        if RootLoop.takes(model):
            most = np.full(model.m, np.inf) if gate is None else gate * self.width
            variance = None if settled is None else np.sum(settled.L**2, axis=1)
            self.roots = RootLoop(model, most, variance, NEAR)
        if settled is not None:
            self._spread = settled.innovation_std
            limit = None if gate is None else gate * self.width * self._spread
            self.loop = Loop(settled.rows(), model.p, model.m, model.x0, limit)
            self._ways = recent(settled, PATIENCE)
            self._variance = np.sum(settled.L**2, axis=1)
            self._std = settled.std.copy()
            self._std.setflags(write=False)  # one array for all samples
            self._ahead = self.core.predict(FilterState(model.x0, settled.L, np.zeros(model.m))).L

    # -- samples ----------------------------------------------------------------------------------------------------

    def step(self, y: ArrayLike) -> tuple[Array, Array]:
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
        load, std, e = np.empty((1, self.model.p)), np.empty((1, self.model.p)), np.empty((1, self.model.m))
        if self._rooted(y[None], load, std, e):
            return load[0], std[0]
        return self._slow(y)

    def block(
        self, Y: Array, load: Array, std: Array, e: Array | None = None, taken_as: Array | None = None,
        late: Late | None = None, settled: NDArray[np.bool_] | None = None,
    ) -> None:  # fmt: skip
        """Fill loads and std (samples, p) of a block (samples, m).

        Where given, `e` gets the normalised innovations, `taken_as`, a copy of the block, NaN where a channel was kept
        out, `settled` (samples,) where a settled gain answered, and loads and std are those that `late` makes of them.
        """
        Y = np.ascontiguousarray(Y, float)
        raw = np.empty(Y.shape)
        k = 0
        while k < len(Y):
            begin = k
            if self.phase == "steady":
                assert self.loop is not None
                assert self.settled is not None
                taken = self.loop.block(Y[k:], load[k:], raw[k:])
                std[k : k + taken] = self._std
                if e is not None:
                    np.divide(raw[k : k + taken], self._spread, out=e[k : k + taken])
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
            if settled is not None:
                settled[begin:k] = True
            if k == len(Y):
                return
            if late is None and (taken := self._rooted(Y[k : k + PIECE], load[k:], std[k:], raw[k:])):
                if e is not None:
                    e[k : k + taken] = raw[k : k + taken]
                k += taken
                continue
            origin = self._origin() if late is not None else (None, None)
            load[k], std[k] = self._slow(self._sample(Y[k]))
            if late is not None:
                self._follow(late, origin, load[k], std[k])
            if e is not None:
                e[k] = np.nan if self.innovation is None else self.innovation.normalised
            if taken_as is not None:
                taken_as[k] = self.taken
            k += 1

    def _sample(self, y: ArrayLike) -> Array:
        return self.core.sample(reals(y, where="sample", what="a sample that is no row of real numbers"))

    def _origin(self) -> tuple[FilterState | None, FilterState | None]:
        """States of the sample before, of the filter that believes (or speaks alone) and of the one that does not."""
        if self.phase == "periodic":
            assert self.rhythm is not None
            assert self.beat is not None
            last = self.rhythm.masks[self.beat.phase - 1]
            return FilterState(self.beat.x, self.rhythm.ahead[0], np.where(last, 0.0, np.nan)), None
        state = None if self.phase == "steady" else self.state
        return (state, self.rival) if self.believing or self.rival is None else (self.rival, state)

    def _follow(
        self, late: Late, before: tuple[FilterState | None, FilterState | None], load: Array, std: Array
    ) -> None:
        """Loads and std of a sample off the settled gain, as they are some samples late."""
        if self.fell:
            late.cut(0 if self.believing else 1)
        if self.pair is None:
            assert self.state is not None
            assert isinstance(self.innovation, Innovation)
            load[:], std[:] = late.moved(self.core, [Move(before[0], self.state, self.innovation)], 0)
            return
        first, second = before[0], before[1] if before[1] is not None else before[0]
        moves = [Move(first, *self.pair[0]), Move(second, *self.pair[1])]
        load[:], std[:] = late.moved(self.core, moves, 0 if self.believing else 1)
        if self.rival is None:
            late.decided(0 if self.believing else 1)

    def _turned(self, Y: Array, load: Array, std: Array, e: Array) -> int:
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
            self.taken, self.innovation = Y[taken - 1].copy(), Heard(e[taken - 1].copy())
        return taken

    def _rooted(self, Y: Array, load: Array, std: Array, e: Array) -> int:
        """Fill samples off the settled gain up to one that has to be judged; how many."""
        if self.roots is None or self.rival is not None or self.plain is not None or self.wrong.any():
            return 0
        before = self._stands()
        if before is None:
            return 0
        if self.phase == "periodic":
            self.listener.clear()
        there = np.isfinite(Y)
        taken, why, x, L = self.roots.block(*before, Y, self.listener.ear(there), load, std, e)
        if not taken:
            return 0
        self.phase, self.ready = OFF if self.phase in ("steady", "periodic") else self.phase, None
        self.state, self.innovation = FilterState(x, L), Heard(e[taken - 1].copy())
        self.taken, self.pair, self.fell = Y[taken - 1].copy(), None, False
        self.counts["samples"] += taken
        self.counts["missing"] += int(np.sum(~there[:taken]))
        self.listener.heard += taken
        if why == ARRIVED:
            self._calm()
        elif why == SHOWN:
            self._regular()
        return taken

    def _stands(self) -> tuple[Array, Array, bool] | None:
        """Mean and root before the next sample, and whether they are its prediction; None before the first one."""
        if self.phase == "steady" and self.loop is not None:
            return self.loop.x, self._ahead, True
        if self.phase == "periodic" and self.beat is not None and self.rhythm is not None:
            return self.beat.x, self.rhythm.ahead[self.beat.phase], True
        if self.ready is not None:
            return self.ready.x, self.ready.L, True
        return None if self.state is None else (self.state.x, self.state.L, False)

    def _slow(self, y: Array) -> tuple[Array, Array]:
        self.counts["samples"] += 1
        self.counts["missing"] += int(np.sum(~np.isfinite(y)))
        there = np.isfinite(y)
        self.judge(y, self._predicted())
        answer = self.answer()
        self._settle(self.taken, there)
        return answer

    def _predicted(self) -> FilterState:
        """Mean and covariance of the sample that comes, before it."""
        if self.phase == "steady":
            assert self.loop is not None
            self.phase = "transient"
            return FilterState(self.loop.x, self._ahead)
        if self.phase == "periodic":
            assert self.beat is not None
            assert self.rhythm is not None
            self.phase = "transient"
            self.listener.clear()
            return FilterState(self.beat.x, self.rhythm.ahead[self.beat.phase])
        if self.ready is not None:
            before, self.ready = self.ready, None
            return before
        if self.state is None:
            return self.core.start()
        return self.core.predict(self.state)

    def _settle(self, y: Array, there: NDArray[np.bool_]) -> None:
        """Back to a settled gain where the covariance has arrived at its: that of all channels, or of a rhythm."""
        assert self.state is not None
        self.listener.hear(there)
        if self.rival is not None or not np.array_equal(np.isfinite(y), there):
            return
        now = np.sum(self.state.L**2, axis=1)
        whole = self.loop is not None and there.all()
        if whole and np.all(np.abs(now - self._variance) <= NEAR * self._variance):
            self._calm()
        else:
            self._regular()

    def _calm(self) -> None:
        """To the settled gain."""
        assert self.state is not None
        assert self.loop is not None
        self.loop.x = self.core.predict(self.state).x
        self.phase, self.young = "steady", False
        self._agreed()
        self.listener.clear()

    def _regular(self) -> None:
        """To the gains of a rhythm, where channels come and go in one and the covariance does too."""
        found = self.listener.found()
        if found is None:
            return
        assert self.state is not None
        rhythm, phase = found
        now = np.sum(self.state.L**2, axis=1)
        if np.all(np.abs(now - rhythm.variances[phase]) <= REPEATS * rhythm.variances[phase]):
            self._beat(rhythm, self.core.predict(self.state).x, (phase + 1) % rhythm.period)
            self.young = False
            self._agreed()

    def _beat(self, rhythm: ChannelPeriod, x: Array, phase: int) -> None:
        """To the gains of a rhythm, from the prediction of a sample of this phase."""
        sigmas = np.inf if self.gate is None else self.gate * self.width
        self.rhythm, self.beat = rhythm, PeriodicLoop(rhythm.filters, x, phase, sigmas)
        self.phase = "periodic"

    # -- to another filter --------------------------------------------------------------------------------------------

    @property
    def prediction(self) -> Array:
        """Mean of the states before the next sample."""
        if self.phase == "steady" and self.loop is not None:
            return np.array(self.loop.x)
        if self.phase == "periodic" and self.beat is not None:
            return np.array(self.beat.x)
        if self.ready is not None:
            return np.array(self.ready.x)
        return np.array((self.core.start() if self.state is None else self.core.predict(self.state)).x)

    def begin(self, ahead: FilterState) -> None:
        """Go on from the prediction of the next sample that another filter has made, without doubts."""
        self.ready, self.state, self.phase = ahead, FilterState(ahead.x, ahead.L, np.full(self.model.m, np.nan)), OFF
        self.rival = self.pair = self.plain = None
        self.wrong[:], self.good[:] = 0, 0
        self.listener.clear()

    def succeed(self, old: Engine, T: Array | None) -> None:
        """Go on where the engine of another model stands: states T times its own, or, without T, anywhere in reach."""
        self.counts, self.wrong, self.good = old.counts.copy(), old.wrong.copy(), old.good.copy()
        self.beyond, self.largest = old.beyond.copy(), old.largest
        if old.state is None and old.phase != "steady" and old.ready is None:
            return
        before = old._predicted()
        whole = np.eye(self.model.n)
        if T is not None:
            whole[: len(T), : len(T)] = T
        self.ready = FilterState(whole @ before.x, whole @ before.L)
        if T is None:
            self.ready = wider(self.ready, self._reach())
        self.state, self.phase = FilterState(self.ready.x, self.ready.L, np.full(self.model.m, np.nan)), "transient"

    # -- the state for files ----------------------------------------------------------------------------------------

    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        return {
            **self.judged_tree(),
            "phase": self.phase,
            "ready": arrays(self.ready),
            "ahead": None if self.loop is None else self.loop.x,
            "listener": self.listener.to_tree(),
            "beat": None if self.phase != "periodic" else self._beaten_tree(),
        }

    def _beaten_tree(self) -> dict[str, Any]:
        assert self.beat is not None
        assert self.rhythm is not None
        return {"masks": self.rhythm.masks, "x": self.beat.x, "phase": self.beat.phase}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.restore_judged(tree)
        self.phase, self.ready = str(tree["phase"]), state_of(tree["ready"])
        if self.loop is not None and tree["ahead"] is not None:
            self.loop.x = np.asarray(tree["ahead"], float)
        self.listener.restore(tree["listener"])
        if (beat := tree["beat"]) is not None:
            rhythm = self.listener.solved(np.array(beat["masks"], bool))
            assert rhythm is not None
            self._beat(rhythm, np.asarray(beat["x"], float), int(beat["phase"]))
