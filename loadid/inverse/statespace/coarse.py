"""The path of a long record judged on some of its windows: where to look for lambda before the whole is asked.

All windows have the same length and the same matrices, so that one recursion of gains and covariances serves them all;
each begins in a state of its own that is an unknown. A window stands for as many as its weight says, so that few hits
in a long quiet record count as what they are. Their lambda is that of the whole record.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable

from ..path import Solution
from .covariance import spread
from .passes import Solved, solve
from .path import Scalars, StateSpacePath
from .record import Record
from .riccati import Gains, gains
from .scale import unforced

LENGTH, COUNT = 512, 6  # samples of a window; fewest windows from which some are picked


class WindowsPath(StateSpacePath):
    """Weighted sum of the paths of some windows of a record, for rules only.

    Parameters
    ----------
    record : Record
        Of one window.
    windows : array, shape (windows, samples, m)
        Their data.
    weights : array of int, shape (windows,)
        Number of windows of the record that each stands for.
    scale : float
        Of the whole record.
    """

    def __init__(self, record: Record, windows: NDArray, weights: NDArray, scale: float) -> None:
        self.windows, self.weights = windows, weights
        self._solutions: dict[float, tuple[Gains, list[Solved]]] = {}
        super().__init__(record, quick=True, scale=scale)
        self.count = int(np.sum(weights))
        self.m, self.null = self.count * record.data, self.count * len(record.free)
        self._limit *= self.count

    @property
    def unknowns(self) -> int:
        """Loads times samples of all windows that are stood for."""
        return self.count * self.record.samples * self.record.p

    def scalars(self, lam: float) -> Scalars:
        """Sums over the windows at one relative lambda."""
        held, each = self._each(lam)
        known, count = spread(self.record, held, every_sample=False), self.count
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

    def residual(self, lam: float) -> NDArray[np.float64]:
        """Whitened residuals of the windows side by side, (samples, windows * m)."""
        return np.hstack([y - one.response for y, one in zip(self.windows, self._each(lam)[1], strict=True)])

    def _bias2(self, at: float, pilot: float) -> float:
        then, each = self._each(at)[0], self._each(pilot)[1]
        return self._sum(np.sum((solve(self.record, then, one.response).load - one.load) ** 2) for one in each)

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


def _forced_energy(window: Record, y: NDArray, starts: NDArray) -> NDArray[np.float64]:
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
