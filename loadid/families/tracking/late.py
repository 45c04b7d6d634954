"""Loads some samples late, with all that was measured meanwhile: exact around starts, gaps, gates and events too.

While the gain is settled a load is a short filter over later innovations (`loadid.inverse.kalman.lag.LagLine`); around
everything else, and for as many samples after it as the answers are late, the covariance of the last loads with the
state goes on sample by sample (`Delayed`). Where two filters are in doubt, each has its own line.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...inverse.kalman.lag import Delayed, FixedLag, LagLine, delayed, resumed
from ...inverse.kalman.squareroot import Innovation, SquareRoot, State
from ...inverse.kalman.steady import Steady

Array = NDArray[np.float64]


class Move(NamedTuple):
    """A sample of one filter: the state before its prediction (None: with all channels), after it, what it said."""

    before: State | None
    state: State
    said: Innovation


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

    def calm(self, settled: Steady, load: Array, e: Array) -> tuple[Array, Array]:
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

    def phase(self, before: Steady, now: Steady, load: Array, e: Array) -> tuple[Array, Array]:
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
            before = move.before if move.before is not None else State(move.state.x, move.state.L)
            forms.append(form.advance(core, before, move.state, move.said, self.lag))
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
