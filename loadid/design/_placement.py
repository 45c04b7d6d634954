"""Sensors chosen from many candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._model import Model
from structures.errors import InputError

from . import _layout as search
from ._candidates import CandidateSensors, expected, settle
from ._comparison import checked, draw, of
from ._forecast import Forecast
from ._layout import Layout, RowSet, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


EQUAL = 1e-7  # of log det, or of the logarithm of the worst variance
# norms of the variances that lead to the worst one in turn; a large problem settles ties one way only
WAYS = [[search.D, 8.0, search.WORST], [8.0, 32.0, search.WORST], [search.WORST]]
LARGE = 1_000_000  # candidates times loads times sensors
SHOWN = 8  # equivalent sets that are reported


@dataclass(frozen=True, eq=False)
class Placement:
    """Chosen sensors, and what they promise. Immutable.

    Parameters
    ----------
    chosen : tuple of int
        Rows of the candidates, the most useful first.
    criterion : str
    layout, everything : Judged or HitLayout
        The chosen sensors, and all candidates: nothing better can be had from them.
    gains : tuple of (str, float, float)
        For each sensor in turn its label, and what the layout is with it and those before it: log det and worst share
        for static loads, worst and mean error for hits.
    expected : str
        The loads that they were chosen for, in words.
    method : str
        How they were found.
    ties : tuple of tuple of str
        Other sets that are as good, by mirror symmetry for example; at most eight. Not looked for among hits.
    random : tuple of float
        For hits: worst (or mean) errors of random layouts of as many sensors, ascending.
    forecast : Forecast or None
        For hits: of the chosen sensors.
    candidates_at, loads_at, outline : array or None
        Places (m), for the picture.
    """

    chosen: tuple[int, ...]
    criterion: str
    layout: Layout
    everything: Layout
    gains: tuple[tuple[str, float, float], ...]
    expected: str
    method: str = ""
    ties: tuple[tuple[str, ...], ...] = ()
    random: tuple[float, ...] = ()
    forecast: Forecast | None = None
    candidates_at: NDArray[np.float64] | None = None
    loads_at: NDArray[np.float64] | None = None
    outline: NDArray[np.float64] | None = None

    @property
    def sensors(self) -> tuple[str, ...]:
        """Labels of the chosen sensors, the most useful first."""
        return self.layout.sensors

    def table(self) -> str:
        """The layout beside all candidates, what each sensor adds, and sets that are as good, or random ones."""
        lines = [table([self.layout, self.everything]), f"for {self.expected}; chosen by {self.method}"]
        if self.random:
            lines.append(f"{len(self.random)} random layouts: {self.criterion} error {self.random[0]:.1%} to "
                         f"{self.random[-1]:.1%}, median {float(np.median(self.random)):.1%}")  # fmt: skip
        lines.append("what each sensor adds:")
        wide = max(len(label) for label, _, _ in self.gains)
        lines += [f"  {label.ljust(wide)}  {self.layout.measured(*of)}" for label, *of in self.gains]
        if self.ties:
            more = "at least " if len(self.ties) == SHOWN else ""
            lines.append(f"ties: {more}{len(self.ties)} other sets are as good, the first: {', '.join(self.ties[0])}")
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.table() if self.forecast is None else f"{self.forecast}\n{self.table()}"

    def plot(self, **settings: Any) -> Figure:
        """Picture of the layout, the worst load marked; see `loadid.design._comparison.draw`."""
        return draw((self.layout,), self.loads_at, outline=self.outline, candidates=self.candidates_at, **settings)

    def to_dict(self) -> dict[str, Any]:
        """Plain texts, numbers and lists."""
        return {
            "chosen": list(self.chosen),
            "criterion": self.criterion,
            "layout": self.layout.to_dict(),
            "everything": self.everything.to_dict(),
            "gains": [list(g) for g in self.gains],
            "expected": self.expected,
            "method": self.method,
            "ties": [list(t) for t in self.ties],
            "random": list(self.random),
            "forecast": None if self.forecast is None else self.forecast.to_dict(),
        }


def place(
    candidates: Model | ArrayLike,
    n: int,
    *,
    loads: Sequence[str | int] | None = None,
    criterion: str = "D",
    keep: Sequence[str | int] = (),
    exhaustive: bool | None = None,
    noise: ArrayLike | None = None,
    amplitude: ArrayLike | None = None,
    snr: float | None = None,
    at: ArrayLike | None = None,
    loads_at: ArrayLike | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Placement:
    """Choose n of many candidate sensors, before anything is measured.

    Small problems are searched in full. Large ones start by adding the best sensor after the other, and by taking the
    least useful ones away; both are improved by exchanging sensors, and the better one is kept. Nothing depends on the
    order of the candidates, or on units.

    Parameters
    ----------
    candidates : Model or array (sensors, loads)
        Rows are sensors that could be placed.
    n : int
        Number of sensors, those to `keep` included.
    loads : sequence of str or int, optional
        Columns that count; default all.
    criterion : ``"D"`` or ``"worst"``
        Most information in all: largest log det of the posterior precision. Or the smallest posterior std, over its
        amplitude, of the load that is known least.
    keep : sequence of str or int
        Sensors that are there already.
    exhaustive : bool, optional
        Look at every set; by default where that takes well below a second.
    noise, amplitude, snr, at, loads_at
        As in `compare`. Noise is a std per sensor: where errors are correlated a sensor has no worth of its own.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Returns
    -------
    Placement

    Raises
    ------
    InputError
        A number that does not fit the candidates, correlated noise, or as `compare`.
    """
    pool = settle(candidates, noise=noise, loads=loads, at=at, loads_at=loads_at, where="design.place")
    m, kept = len(pool.H), pool.index(keep, "keep").tolist()
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or not max(len(kept), 1) <= n <= m:
        raise InputError(
            "no such number of sensors", where="design.place", found=repr(n),
            expected=f"{max(len(kept), 1)} to {m}", hint="n counts the sensors to keep, too",
        )  # fmt: skip
    if pool.noise is not None and pool.noise.ndim == 2 and np.any(pool.noise[~np.eye(m, dtype=bool)]):
        raise InputError(
            "sensors with correlated noise cannot be chosen one by one", where="design.place",
            found="a full noise covariance", expected="a std per sensor",
            hint="give noise= as std, and judge the result with design.compare",
        )  # fmt: skip
    criterion, want = checked(criterion), expected([pool], amplitude, snr, "design.place")
    A = pool.whitened() * want.amplitude
    if exhaustive is None:
        exhaustive = search.affordable(m, int(n), kept, A.shape[1])
    goal = search.D if criterion == "D" else search.WORST
    found, others = _search(A, int(n), kept, goal, bool(exhaustive), progress)
    order, gains = _in_turn(A, found, pool)
    layout = of(f"{n} of {m}", pool, order, want.amplitude)
    return Placement(
        chosen=tuple(order.tolist()),
        criterion=criterion,
        layout=layout,
        everything=of("all candidates", pool, np.arange(m), want.amplitude),
        gains=gains,
        ties=tuple(tuple(pool.labels[i] for i in sorted(s)) for s in others),
        expected=want.words,
        method="all sets" if exhaustive else "greedy and backward starts with exchange",
        candidates_at=pool.at,
        loads_at=pool.loads_at,
        outline=pool.outline,
    )


Sets = list[frozenset[int]]


def _search(
    A: NDArray[Any], n: int, keep: list[int], goal: float, every: bool, progress: Callable[[float, str], None] | None
) -> tuple[frozenset[int], Sets]:
    """The best set, and others that are as good."""
    rank = search.canonical(A)
    if every:
        results = search.all_sets(A, n, keep, goal, _steps(progress, 0.0, 1.0))
    else:
        results = _from_starts(A, n, keep, goal, rank, progress)
    top = max(results.values())
    equal = [s for s, value in results.items() if value >= top - EQUAL]
    best = min(equal, key=lambda s: sorted(rank[list(s)].tolist()))
    if not every:
        equal += [s for s in _swapped(A, best, keep, goal) if s not in equal]
    if progress is not None:
        progress(1.0, "placing sensors")
    others = sorted((s for s in equal if s != best), key=lambda s: sorted(rank[list(s)].tolist()))
    return best, others[:SHOWN]


def _from_starts(
    A: NDArray[Any],
    n: int,
    keep: list[int],
    goal: float,
    rank: NDArray[Any],
    progress: Callable[[float, str], None] | None,
) -> dict[frozenset[int], float]:
    """Sets that exchange ends at, with their scores. Ties are settled both ways, so that mirror images are found."""
    ways = [[search.D]] if goal == search.D else WAYS
    jobs = [(prefer, way) for prefer in (rank, len(A) - 1 - rank) for way in ways]
    if goal != search.D and A.size * n > LARGE:
        jobs = jobs[: len(ways)]
    results: dict[frozenset[int], float] = {}
    for i, (prefer, way) in enumerate(jobs):
        for half, start in enumerate((search.greedy, search.backward)):
            step = _steps(progress, (i + half / 2) / len(jobs), (i + half / 2 + 0.5) / len(jobs))
            state = start(A, n, keep, way[0], prefer, step)
            for norm in way:
                state = search.exchange(state, keep, norm, prefer, step)
            results[frozenset(state.members)] = state.score(goal)
    return results


def _steps(progress: Callable[[float, str], None] | None, start: float, stop: float) -> Callable[[], None]:
    """Callback of a search whose number of steps nobody knows: it nears `stop` and never reaches it."""
    done = start

    def step() -> None:
        nonlocal done
        done += (stop - done) * 0.02
        if progress is not None:
            progress(done, "placing sensors")

    return step


def _swapped(A: NDArray[Any], best: frozenset[int], keep: list[int], criterion: float) -> Sets:
    """Sets as good as the best one that differ from it in one sensor."""
    state = RowSet(A, sorted(best))
    inside, change = search.swaps(state, keep)
    if criterion == search.D:
        i, j = np.nonzero(np.abs(change) <= EQUAL)
        return [best - {int(inside[a])} | {int(b)} for a, b in zip(i[:SHOWN], j[:SHOWN], strict=True)]
    found: Sets = []
    for out, gains in search.without(state, inside.tolist(), criterion):
        gains[state.members] = -np.inf
        equal = np.flatnonzero(np.abs(gains - state.score(criterion)) <= EQUAL)
        found += [best - {out} | {int(j)} for j in equal[:SHOWN]]
    return found[:SHOWN]


def _in_turn(
    A: NDArray[Any], chosen: frozenset[int], pool: CandidateSensors
) -> tuple[NDArray[np.intp], tuple[tuple[str, float, float], ...]]:
    """The chosen sensors, the most useful first, and what each adds."""
    rows = np.array(sorted(chosen), dtype=np.intp)
    rank = search.canonical(A)[rows]
    state, gains = RowSet(A[rows], []), []
    for _ in rows:
        allowed = np.ones(len(rows), bool)
        allowed[state.members] = False
        state.change(search.pick(state.gains(search.D), allowed, rank), 1)
        label = pool.labels[rows[state.members[-1]]]
        gains.append((label, state.logdet, float(np.sqrt(min(state.variance.max(), 1.0)))))
    return rows[state.members], tuple(gains)
