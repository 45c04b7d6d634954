"""Sensors chosen from many candidates for hits: the layout that leaves the least expected error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from math import comb
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._model import Model, as_model
from structures._readonly import ReadOnly
from structures.errors import InputError, NotIdentifiable

from ._candidates import of_model
from ._forecast import of
from ._hits import COARSE, HitProblem, Pulse, posed
from ._placement import Placement

Array = NDArray[np.float64]
Sets = frozenset[int]

CRITERIA = ("worst", "mean")
EVERY = 400  # sets that are all looked at
RANDOM = 12  # layouts beside the chosen one, and another start of the search
SWEEPS = 6


@dataclass(frozen=True, eq=False)
class HitLayout(ReadOnly):
    """What one set of sensors promises for a hit.

    Parameters
    ----------
    name : str
    sensors : tuple of str
    rank, nullity : int
        Largest rank of the FRFs over frequency, and loads minus rank.
    kappa : float
        Median condition number over that rank, of rows in units of the noise.
    loads, units : tuple of str
    share : array, shape (loads,)
        Expected rms error of a hit on each load, over the rms of the hit.
    at : array, shape (sensors, dim), or None
        Places of the sensors (m).
    """

    name: str
    sensors: tuple[str, ...]
    rank: int
    nullity: int
    kappa: float
    loads: tuple[str, ...]
    units: tuple[str, ...]
    share: Array
    at: Array | None = None

    def __post_init__(self) -> None:
        for name in ("share", "at"):
            if (value := getattr(self, name)) is not None:
                frozen = np.array(value, float)
                frozen.setflags(write=False)
                object.__setattr__(self, name, frozen)

    @property
    def worst(self) -> int:
        """Load of the largest error."""
        return int(np.argmax(np.round(self.share, 12)))

    @property
    def mean_share(self) -> float:
        """Rms error over all loads."""
        return float(np.sqrt(np.mean(self.share**2)))

    axis = "expected error of a hit over its rms"
    heads: ClassVar[tuple[str, ...]] = (
        "layout",
        "sensors",
        "condition",
        "rank",
        "nullity",
        "worst error",
        "at load",
        "mean error",
    )

    @property
    def title(self) -> str:
        """Two lines above a picture."""
        j = self.worst
        return (f"{self.name}: {len(self.sensors)} sensors, rank {self.rank}, condition {self.kappa:.3g}\n"
                f"worst: {self.loads[j]}, error {self.share[j]:.0%} of the hit")  # fmt: skip

    def row(self) -> tuple[str, ...]:
        """Its line of a table."""
        return (self.name, str(len(self.sensors)), f"{self.kappa:.3g}", str(self.rank), str(self.nullity),
                f"{self.share[self.worst]:.1%}", self.loads[self.worst], f"{self.mean_share:.1%}")  # fmt: skip

    @staticmethod
    def measured(first: float, second: float) -> str:
        """Worst and mean error."""
        return f"worst error {first:.1%}  mean {second:.1%}"

    def to_dict(self) -> dict[str, Any]:
        """Plain texts, numbers and lists."""
        return {
            **{name: value for name, value in asdict(self).items() if name not in ("share", "at")},
            "kappa": self.kappa if self.rank else None, "share": self.share.tolist(), "worst": self.loads[self.worst],
            "worst_share": float(self.share[self.worst]), "mean_share": self.mean_share,
            "at": None if self.at is None else self.at.tolist(),
        }  # fmt: skip


def place_for_hits(
    candidates: Model,
    n: int,
    *,
    pulse: tuple[float, float] = (1e-3, 100.0),
    criterion: str = "worst",
    keep: Sequence[str | int] = (),
    exhaustive: bool | None = None,
    noise: ArrayLike | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Placement:
    """Choose n of the sensors of a dynamic model, so that a hit is found with the least error.

    The error of a layout is that of a half sine on each load, the others zero but unknown, at the best lambda: a closed
    form. Small problems are searched in full; else sensors are added one by one, each the best now, and exchanged
    while that helps, from that layout and from the best of some random ones.

    Parameters
    ----------
    candidates : Model
        Its sensors could be placed. Finite elements, modes, a state space, or FRFs, measured or tabulated.
    n : int
        Number of sensors, those to `keep` included.
    pulse : (float, float)
        Duration (s) and peak of the hit.
    criterion : {"worst", "mean"}
        Least error of the load that is found least well, or least rms error of all.
    keep : sequence of str or int
        Sensors that are there already.
    exhaustive : bool, optional
        Look at every set; by default up to 400.
    noise : float or array (sensors,), optional
        Std of a sample, SI; default that of the model or of its tests, else 1 % of the largest response of the sensors
        of a unit.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Returns
    -------
    Placement

    Raises
    ------
    InputError
        No dynamic model, a number that does not fit, a criterion that is none, a hit that moves no sensor.

    Notes
    -----
    Bias and variance of a regularised load, P. C. Hansen, Discrete Inverse Problems (SIAM 2010), sections 4.2 and 5.1;
    exchange of points of a design, V. V. Fedorov, Theory of Optimal Experiments (1972), ch. 3.
    """
    model = as_model(candidates, "design.place_for_hits")
    labels, hit = [c.label for c in model.sensors], Pulse(*pulse)
    fixed = _kept(keep, labels)
    m = len(labels)
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or not max(len(fixed), 1) <= n <= m:
        raise InputError("no such number of sensors", where="design.place_for_hits", found=repr(n),
                         expected=f"{max(len(fixed), 1)} to {m}", hint="n counts the sensors to keep, too")  # fmt: skip
    if criterion not in CRITERIA:
        raise InputError("no such criterion", where="criterion", found=repr(criterion), expected="'worst' or 'mean'")
    told = progress or (lambda fraction, text: None)
    told(0.0, "placing sensors")
    fine = posed(model, hit, noise, "", None, alike=True)
    search = _Search(posed(model, hit, fine.noise, fine.noise_source, None, COARSE), criterion, int(n), fixed, m, told)
    every = comb(m - len(fixed), n - len(fixed)) <= EVERY if exhaustive is None else bool(exhaustive)
    order = search.in_turn(search.all() if every else search.from_starts())
    told(0.95, "judging the layout")
    found, finer = of(fine, model, hit, order), _Search(fine, criterion, int(n), fixed, m, lambda f, t: None)
    gains = tuple((labels[i], *finer.errors(frozenset(order[: k + 1]))) for k, i in enumerate(order))
    sensors_at, loads_at, outline = of_model(model)
    H = transfer(model)
    judge = _judge(model, fine, H, sensors_at)
    told(1.0, "placing sensors")
    return Placement(
        chosen=tuple(order), criterion=criterion, layout=judge(f"{n} of {m}", order),
        everything=judge("all candidates", list(range(m))), random=tuple(finer.random()), gains=gains, forecast=found,
        expected=f"a hit of {1e3 * hit.duration:g} ms on each load, noise {found.noise_source}",
        method="all sets" if every else "greedy and random starts with exchange",
        candidates_at=sensors_at, loads_at=loads_at, outline=outline,
    )  # fmt: skip


def transfer(model: Model) -> Array | None:
    """Transfer matrices (lines, sensors, loads): measured, between resonances, or static; None where none is known."""
    if model.frequencies is not None:
        return np.asarray(model.frf(model.frequencies)[model.frequencies > 0])
    modes = model.natural_frequencies
    try:
        if modes is not None and np.any(modes > 0):
            modes = modes[modes > 0][:40]
            return np.asarray(model.frf(
                np.sort(np.concatenate([0.7 * modes[:1], np.sqrt(modes[1:] * modes[:-1]), 1.2 * modes[-1:]]))
            ))  # fmt: skip
        return np.asarray(model.static()[None])
    except (InputError, NotIdentifiable):
        return None


# -- inside ------------------------------------------------------------------------------------------------------------
def _kept(keep: Sequence[str | int], labels: list[str]) -> list[int]:
    found = [labels.index(k) if k in labels else k for k in keep]
    wrong = [k for k in found if isinstance(k, bool) or not isinstance(k, int | np.integer) or not 0 <= k < len(labels)]
    if wrong or len(set(found)) < len(found):
        raise InputError("no such sensors", where="keep", found=repr(list(keep)), expected=", ".join(labels[:12]),
                         hint="name each sensor once, by its label or index")  # fmt: skip
    return [int(k) for k in found]


class _Search:
    """Layouts with their errors; each is asked once."""

    def __init__(self, problem: HitProblem, criterion: str, n: int, keep: list[int], m: int,
                 told: Callable[[float, str], None]) -> None:  # fmt: skip
        self.problem, self.criterion, self.n, self.keep, self.m, self.told = problem, criterion, n, keep, m, told
        self.known: dict[Sets, tuple[float, float]] = {}
        self.done = 0.0

    def errors(self, rows: Sets) -> tuple[float, float]:
        """Worst and mean error."""
        if rows not in self.known:
            each = np.linalg.norm(self.problem.errors(sorted(rows)), axis=1)
            self.known[rows] = float(each.max()), float(np.sqrt(np.mean(each**2)))
            self.done += (0.95 - self.done) * 0.005
            self.told(self.done, "placing sensors")
        return self.known[rows]

    def score(self, rows: Sets) -> float:
        """What is made small; of equal worst errors the smaller mean one, which leads out of plateaus."""
        worst, mean = self.errors(rows)
        return worst + 1e-4 * mean if self.criterion == "worst" else mean

    def all(self) -> Sets:
        """The best of all sets."""
        free = [i for i in range(self.m) if i not in self.keep]
        sets = [frozenset([*self.keep, *some]) for some in combinations(free, self.n - len(self.keep))]
        return min(sets, key=self.score)

    def random(self) -> list[float]:
        """Errors of random layouts, ascending; none where there is one layout only."""
        return sorted(self.errors(rows)[CRITERIA.index(self.criterion)] for rows in self._drawn())

    def from_starts(self) -> Sets:
        """The best layout that exchanges end at."""
        chosen = frozenset(self.keep)
        while len(chosen) < self.n:
            chosen = min((chosen | {i} for i in range(self.m) if i not in chosen), key=self.score)
        starts = [chosen, min(self._drawn(), key=self.score)]
        return min((self._exchanged(start) for start in starts), key=self.score)

    def in_turn(self, best: Sets) -> list[int]:
        """The sensors of a layout, the most useful first."""
        order: list[int] = []
        while len(order) < len(best):
            order.append(min(best - set(order), key=lambda i: self.score(frozenset([*order, i]))))
        return order

    def _drawn(self) -> list[Sets]:
        rng, free = np.random.default_rng(0), [i for i in range(self.m) if i not in self.keep]
        more = self.n - len(self.keep)
        if more == 0 or more == len(free):
            return [frozenset([*self.keep, *free[:more]])]
        return [frozenset([*self.keep, *rng.choice(free, more, replace=False).tolist()]) for _ in range(RANDOM)]

    def _exchanged(self, rows: Sets) -> Sets:
        for _ in range(SWEEPS):
            before = rows
            for out in sorted(rows - set(self.keep)):
                others = (rows - {out} | {i} for i in range(self.m) if i not in rows)
                rows = min([rows, *others], key=self.score)
            if rows == before:
                break
        return rows


def _judge(
    model: Model, problem: HitProblem, H: Array | None, at: Array | None
) -> Callable[[str, list[int]], HitLayout]:
    loads, units = tuple(c.label for c in model.loads), tuple(c.unit for c in model.loads)

    def judged(name: str, rows: list[int]) -> HitLayout:
        rank, kappa = 0, float("inf")
        if H is not None:
            s = np.linalg.svd(H[:, rows] / problem.noise[rows][:, None], compute_uv=False)
            rank = int(np.max(np.sum(s > max(H.shape[1:]) * np.finfo(float).eps * s[:, :1], axis=1), initial=0))
            last = s[:, rank - 1] if rank else np.zeros(len(s))
            kappa = float(np.median(s[last > 0, 0] / last[last > 0])) if np.any(last > 0) else float("inf")
        share = np.linalg.norm(problem.errors(rows), axis=1)
        return HitLayout(name, tuple(model.sensors[i].label for i in rows), rank, len(loads) - rank, kappa, loads,
                         units, share, None if at is None else at[rows])  # fmt: skip

    return judged
