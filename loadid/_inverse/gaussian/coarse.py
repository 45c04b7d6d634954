"""Lambda of a long record: its windows say where to look, the whole record decides.

All windows have the same length and the same matrices, so that one recursion of gains and covariances serves them all;
each begins in a state of its own that is an unknown. A window stands for as many as its weight says, so that few hits
in a long quiet record count as what they are. Their lambda is that of the whole record.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable

from .. import rules
from ..choice import ORDERS, Choice, ChoiceLike, decide, is_rule
from ..path import RegularizationPath, Solution
from ..problem import NoiseSource
from ..sweep import LARGEST, RuleResult, Sweep
from .gains import Gains, gains
from .passes import Solved, solve
from .path import Scalars, StateSpacePath, unforced
from .posterior import variances
from .record import WhitenedRecord
from .roots import Array

REACH = 0.5  # decades to either side of what the windows' rules chose
WIDER = 1.0  # decades by which the search goes on beyond a wall
POINTS = 15  # in a decade
_MIDDLE = 1e-2  # relative lambda that tells the lower end of a range from the upper one
SHARED = ("discrepancy", "upre", "gcv", "robust_gcv", "predicted_error", "evidence")  # of one sweep, at no further cost


def confirm(
    path: RegularizationPath, guess: Choice, choice: ChoiceLike, *, sigma: float | None, source: NoiseSource
) -> Choice:
    """Choose on the whole record, near the lambdas that the rules chose on its windows (`guess`).

    Parameters are those of `choose`. The search goes on beyond every wall that a rule of the sweep ends at, but for
    those that ended at the lower end of the range on the windows: what it ends with are optima inside what was
    searched, or an end of the whole range, which then has been searched from end to end. Rules that cost more than the
    sweep keep what they said on the windows. A lambda that was given is kept.
    """
    if guess.rule == "given":
        return guess
    on_windows = {r.rule: r for r in guess.rules}
    first = rules.name_of(choice) if is_rule(choice) else ORDERS[sigma is not None][0]
    own = {first: choice} if is_rule(choice) else {}
    wanted = {first if on_windows[first].lam is not None else guess.rule}
    asking = [r for r in guess.rules if r.rule in SHARED and r.lam is not None]
    wanted |= {r.rule for r in asking if not r.edge or (r.lam or 0.0) > _MIDDLE}
    search = _Search.around(path, guess, sigma)
    while True:
        asked = {
            r: rules.run(own.get(r, r), search.sweep) if r in wanted | {*SHARED} else on_windows[r] for r in on_windows
        }
        wider = next((w for r in wanted if (w := search.beyond(asked[r])) is not None), None)
        if wider is None:
            # a long record leaves data enough for the predicted error, whose band holds more than that of UPRE
            found = decide(search.sweep, choice, asked, source, refine=False)
            wider = search.beyond(asked[found.rule]) if found.rule in SHARED else None
            if wider is None:
                return found
        search = wider


@dataclass(frozen=True)
class _Search:
    """A sweep over a part of the range from `low` to `high`."""

    sweep: Sweep
    low: float
    high: float

    @classmethod
    def around(cls, path: RegularizationPath, guess: Choice, sigma: float | None) -> _Search:
        """Over what the rules chose that have a say."""
        low, high = path.range
        high = LARGEST if path.null else high
        lams = [r.lam for r in guess.rules if r.rule in SHARED and r.lam is not None and not r.edge]
        near = np.clip([guess.lam, *lams], low, high)
        return cls._over(path, sigma, near.min() * 10**-REACH, near.max() * 10**REACH, low, high)

    @classmethod
    def _over(
        cls, path: RegularizationPath, sigma: float | None, first: float, last: float, low: float, high: float
    ) -> _Search:
        first, last = max(first, low), min(last, high)
        lam: Array = np.geomspace(first, last, max(int(POINTS * np.log10(last / first)), 3) + 1)
        return cls(Sweep(path, lam, path.at(lam), sigma, whole=(first, last) == (low, high)), low, high)

    def beyond(self, found: RuleResult) -> _Search | None:
        """The wider search after a rule that ended at a wall; None after an optimum, or where nothing is left."""
        first, last = float(self.sweep.lam[0]), float(self.sweep.lam[-1])
        if (found.lam is not None and not found.edge) or (first, last) == (self.low, self.high):
            return None
        downwards = first > self.low and (found.lam is None or found.lam <= first * (1 + 1e-9))
        upwards = last < self.high and (found.lam is None or found.lam >= last * (1 - 1e-9))
        if not (downwards or upwards):  # a wall of the range itself: the rest of it may hold something better
            downwards = upwards = True
        return self._over(
            self.sweep.path, self.sweep.sigma, first * 10 ** (-WIDER * downwards), last * 10 ** (WIDER * upwards),
            self.low, self.high,
        )  # fmt: skip


LENGTH, COUNT = 512, 6  # samples of a window; fewest windows from which some are picked


class WindowsPath(StateSpacePath):
    """Weighted sum of the paths of some windows of a record, for rules only.

    Parameters
    ----------
    record : WhitenedRecord
        Of one window.
    windows : array, shape (windows, samples, m)
        Their data.
    weights : array of int, shape (windows,)
        Number of windows of the record that each stands for.
    scale : float
        Of the whole record.
    """

    def __init__(self, record: WhitenedRecord, windows: Array, weights: NDArray[np.int_], scale: float) -> None:
        self.windows, self.weights = windows, weights
        self._solutions: dict[float, tuple[Gains, list[Solved]]] = {}
        super().__init__(record, quick=True, scale=scale)
        self.count = int(np.sum(weights))
        self.m, self.null = self.count * record.data, self.count * len(record.free)
        self.energy = float(weights @ np.sum(windows**2, axis=(1, 2)))
        self._limit *= self.count

    @property
    def unknowns(self) -> int:
        """Loads times samples of all windows that are stood for."""
        return self.count * self.record.samples * self.record.p

    def scalars(self, lam: float) -> Scalars:
        """Sums over the windows at one relative lambda."""
        held, each = self._each(lam)
        known, count = variances(self.record, held, every_sample=False), self.count
        penalty, total = count * known.penalty, self.unknowns + self.null
        return Scalars(
            residual2=self._sum(np.sum((y - one.response) ** 2) for y, one in zip(self.windows, each, strict=True)),
            penalty2=self._sum(np.sum(one.inputs**2) for one in each),
            edf=total - penalty,
            left=(self.m - total) + penalty,
            ratio=count * held.logdet - 2 * self.unknowns * np.log(held.lam) - self._limit,
            trace=count * known.trace,
            change2=0.0,
            bend=0.0,
        )

    def residual(self, lam: float) -> Array:
        """Whitened residuals of the windows side by side, (samples, windows * m)."""
        return np.hstack([y - one.response for y, one in zip(self.windows, self._each(lam)[1], strict=True)])

    def _bias2(self, pilot: float, at: float) -> Array:
        then, each = self._each(at)[0], self._each(pilot)[1]
        lost = (np.sum((solve(self.record, then, one.response).load - one.load) ** 2) for one in each)
        return np.array([self._sum(lost)])

    def _sum(self, each: Iterable[float]) -> float:
        """Weighted sum over the windows."""
        return float(self.weights @ np.fromiter(each, float, len(self.windows)))

    def _each(self, lam: float) -> tuple[Gains, list[Solved]]:
        """Gains, and the solution of every window."""
        if lam not in self._solutions:
            held = gains(self.record, lam * float(self.scale))
            self._solutions[lam] = held, [solve(self.record, held, y) for y in self.windows]
        return self._solutions[lam]

    def solution(self, lam: float, sigma: float | None) -> Solution:
        """Not for windows.

        Raises
        ------
        InputError
            Always: ask the path of the record.
        """
        raise InputError("windows have no solution of the record", where="state-space path", found="windows of it",
                         expected="the path of the whole record", hint="choose lambda here, solve there")  # fmt: skip


def windows_of(path: StateSpacePath) -> WindowsPath | None:
    """Windows of a long record that stand for all of it; None where they cannot.

    They are ranked by the energy that only a load explains, beyond any state at their start: a window that merely rings
    ranks low. The first stands for itself, the second too, the next for two, four, eight and so on, each group by its
    middle one. Those without missing samples count, and the state at their start must be seen by the sensors.
    """
    record = path.record
    starts = np.arange(0, record.samples - LENGTH + 1, LENGTH)
    same = np.array([np.all(record.kind[k : k + LENGTH] == record.kind[k]) for k in starts])
    common = np.bincount(record.kind[starts[same]]).argmax() if same.any() else -1
    starts = starts[same & (record.kind[starts] == common)]
    if len(starts) < COUNT:
        return None
    one = replace(
        record, kind=np.full(LENGTH, common, np.int32), y=np.zeros((LENGTH, record.m)), free=np.arange(record.n),
        data=int(LENGTH * np.sum(np.any(record.C[common] != 0, axis=1) | np.any(record.D[common] != 0, axis=1))),
    )  # fmt: skip
    ranked = starts[np.argsort(-_forced_energy(one, record.y, starts), kind="stable")]
    picked, weights = _representatives(len(ranked))
    data = np.array([record.y[k : k + LENGTH] for k in ranked[picked]])
    try:
        return WindowsPath(one, data, weights, float(path.scale))
    except NotIdentifiable:
        return None


def _forced_energy(window: WhitenedRecord, y: Array, starts: Array) -> Array:
    """Energy of each window of the data (samples, m) that no state at its start explains."""
    Q = np.linalg.qr(unforced(window))[0]
    energy = np.empty(len(starts))
    for i, k in enumerate(starts):
        data = y[k : k + LENGTH].reshape(-1)
        rest = data - Q @ (Q.T @ data)
        energy[i] = rest @ rest
    return energy


def _representatives(count: int) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Middle ranks of groups of 1, 1, 2, 4, 8, ... of `count` ranks, and the sizes of the groups."""
    edges = [0, 1]
    while edges[-1] < count:
        edges.append(min(2 * edges[-1], count))
    first, last = np.array(edges[:-1]), np.array(edges[1:])
    return (first + last - 1) // 2, last - first
