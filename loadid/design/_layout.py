"""One layout judged: what its sensors tell and how well; and the search of rows: greedy, backward, exchange.

Rows ``A`` are in units of the noise, loads in units of their prior std: the posterior precision of a set S is
``I + sum of a a^T over S``. State: ``T`` with covariance ``T T^T``, and ``B = A T``. Adding row k, ``b = B[k]``,
multiplies both by ``(I + b b^T)^(-1/2) = I - g b b^T``, a contraction; removing it by ``(I - b b^T)^(-1/2)``.

A criterion is 0 for log det, or p, a power of two, for the p-norm of the posterior variances of the loads:
infinity is the worst.

Sources: V. V. Fedorov, Theory of Optimal Experiments (1972), for the exchange of one row for another; D. C. Kammer,
"Sensor placement for on-orbit modal identification", J. Guidance, Control and Dynamics 14 (1991) 251-259, for the
backward start.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, islice
from math import comb
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from structures._readonly import ReadOnly

Array = NDArray[np.float64]


class Layout(Protocol):
    """A layout that was judged, for static loads or for hits: what tables and pictures need of it."""

    axis: str
    heads: ClassVar[tuple[str, ...]]

    @property
    def title(self) -> str:
        """Above the picture."""

    @property
    def sensors(self) -> tuple[str, ...]:
        """Their labels."""

    @property
    def loads(self) -> tuple[str, ...]:
        """Their labels."""

    @property
    def share(self) -> Array:
        """What is drawn of each load."""

    @property
    def worst(self) -> int:
        """Load of the largest share."""

    @property
    def at(self) -> Array | None:
        """Places of the sensors (m)."""

    def row(self) -> tuple[str, ...]:
        """Its line of a table under `heads`."""

    @staticmethod
    def measured(first: float, second: float) -> str:
        """The two measures of a layout, in words."""

    def to_dict(self) -> dict[str, Any]:
        """Plain texts, numbers and lists."""


@dataclass(frozen=True, eq=False)
class Judged(ReadOnly):
    """What one set of sensors promises.

    Parameters
    ----------
    name : str
    sensors : tuple of str
    rank, nullity : int
        Numerical rank of the transfer matrix, and loads minus rank: combinations without any trace.
    kappa : float
        Condition number over that rank, of rows in units of the noise and loads in units of their amplitude.
    snr : array, shape (min(sensors, loads),)
        Singular values of that matrix, descending: response to a load of the stated amplitude over the noise.
    std : array, shape (loads,)
        Posterior std, SI; at most the amplitude.
    amplitude : array, shape (loads,)
        Stated std of each load before any reading.
    loads, units : tuple of str
    logdet : float
        Log det of posterior over prior precision: the D-criterion, twice the information in nats.
    at : array, shape (sensors, dim), or None
        Places of the sensors (m).
    """

    name: str
    sensors: tuple[str, ...]
    rank: int
    nullity: int
    kappa: float
    snr: Array
    std: Array
    amplitude: Array
    loads: tuple[str, ...]
    units: tuple[str, ...]
    logdet: float
    at: Array | None = None

    def __post_init__(self) -> None:
        for name in ("snr", "std", "amplitude", "at"):
            value = getattr(self, name)
            if value is not None:
                frozen = np.array(value, float)
                frozen.setflags(write=False)
                object.__setattr__(self, name, frozen)

    axis = "posterior std over amplitude"
    heads: ClassVar[tuple[str, ...]] = (
        "layout", "sensors", "condition", "rank", "nullity", "modes above noise", "worst std", "of its amplitude",
        "at load", "log det", "mean std",
    )  # fmt: skip

    @property
    def title(self) -> str:
        """Two lines above a picture."""
        j = self.worst
        unit = "" if self.units[j] == "arbitrary" else f" {self.units[j]}"
        return (f"{self.name}: {len(self.sensors)} sensors, rank {self.rank}, condition {self.kappa:.3g}\n"
                f"worst: {self.loads[j]}, std {self.std[j]:.3g}{unit} "
                f"({self.share[j]:.0%} of its amplitude)")  # fmt: skip

    @property
    def recoverable(self) -> int:
        """Modes whose response to the stated amplitude exceeds the noise."""
        return int(np.sum(self.snr > 1))

    @property
    def share(self) -> Array:
        """Posterior over prior std of each load: 1 is not seen at all."""
        return self.std / self.amplitude

    @property
    def worst(self) -> int:
        """Load of the largest share."""
        return int(np.argmax(np.round(self.share, 12)))

    @property
    def mean_share(self) -> float:
        """Geometric mean of posterior over prior std of all modes: the D-criterion as a std."""
        return float(np.exp(-self.logdet / (2 * len(self.std))))

    def row(self) -> tuple[str, ...]:
        """Its line of a table."""
        j = self.worst
        return (
            self.name,
            str(len(self.sensors)),
            f"{self.kappa:.3g}",
            str(self.rank),
            str(self.nullity),
            f"{self.recoverable} of {len(self.std)}",
            f"{self.std[j]:.3g} {self.units[j] if self.units[j] != 'arbitrary' else ''}".rstrip(),
            f"{self.share[j]:.1%}",
            self.loads[j],
            f"{self.logdet:.4g}",
            f"{self.mean_share:.1%}",
        )

    @staticmethod
    def measured(first: float, second: float) -> str:
        """Log det, and the largest posterior std over its amplitude."""
        return f"log det {first:8.4g}  worst std {second:.1%}"

    def to_dict(self) -> dict[str, Any]:
        """Plain texts, numbers and lists."""
        return {
            "name": self.name,
            "sensors": list(self.sensors),
            "rank": self.rank,
            "nullity": self.nullity,
            "kappa": self.kappa if self.rank else None,
            "recoverable": self.recoverable,
            "snr": self.snr.tolist(),
            "std": self.std.tolist(),
            "amplitude": self.amplitude.tolist(),
            "loads": list(self.loads),
            "units": list(self.units),
            "worst": self.loads[self.worst],
            "worst_std": float(self.std[self.worst]),
            "worst_share": float(self.share[self.worst]),
            "logdet": self.logdet,
            "mean_share": self.mean_share,
            "at": None if self.at is None else self.at.tolist(),
        }


def judge(
    name: str,
    A: Array,
    amplitude: Array,
    sensors: tuple[str, ...],
    loads: tuple[str, ...],
    units: tuple[str, ...],
    at: Array | None = None,
) -> Judged:
    """Judge rows `A` in units of the noise, per load of the stated amplitude.

    The posterior is that of a Gaussian prior of std `amplitude` per load, loads independent:
    ``var = amplitude^2 diag((I + A^T A)^-1)``, from the SVD of A.
    """
    m, n = A.shape
    s, Vt = np.linalg.svd(A, full_matrices=False)[1:]
    rank = int(np.sum(s > max(m, n) * np.finfo(float).eps * s[0])) if s[0] > 0 else 0
    left = np.sum(Vt**2 / (1 + s[:, None] ** 2), axis=0)
    if m < n:  # what no row reaches keeps its prior
        left += np.maximum(1 - np.sum(Vt**2, axis=0), 0.0)
    return Judged(
        name=name,
        sensors=sensors,
        rank=rank,
        nullity=n - rank,
        kappa=float(s[0] / s[rank - 1]) if rank else float("inf"),
        snr=s,
        std=amplitude * np.sqrt(np.minimum(left, 1.0)),
        amplitude=amplitude,
        loads=loads,
        units=units,
        logdet=float(np.sum(np.log1p(s**2))),
        at=at,
    )


def table(layouts: Sequence[Layout]) -> str:
    """Lines of a table of layouts of one kind, columns aligned; names stand at the left."""
    heads = layouts[0].heads
    rows = [heads, *(one.row() for one in layouts)]
    wide = [max(len(r[i]) for r in rows) for i in range(len(heads))]
    left = 0, heads.index("at load")
    return "\n".join(
        "  ".join(
            c.ljust(w) if i in left else c.rjust(w) for i, (c, w) in enumerate(zip(r, wide, strict=True))
        ).rstrip()
        for r in rows
    )


Rows = list[int]
D, WORST = 0.0, np.inf
TIE = 1e-8  # gains, of log det or relative variance, that count as equal
SOLE = 1 - 1e-6  # leverage from which a row is all that sees some load: 1 - d has lost its digits
REFRESH = 64  # rank-one updates after which the state is computed anew
WORK = 3e7  # multiplications up to which all sets are looked at
MANY = 4  # times the rows wanted, above which the backward start takes out many rows at once
SWAPS = 20  # exchanges per chosen row, at most


class RowSet:
    """A set of rows and its posterior.

    Parameters
    ----------
    A : array, shape (rows, loads)
    members : list of int
    """

    def __init__(self, A: Array, members: Rows) -> None:
        self.A, self.members = A, list(members)
        self._refresh()

    def _refresh(self) -> None:
        """T and B from a QR decomposition of the stacked rows [A_S; I]: nothing is squared."""
        from scipy.linalg import solve_triangular

        n = self.A.shape[1]
        R = np.linalg.qr(np.vstack([self.A[self.members], np.eye(n)]), mode="r")
        self.T = np.asarray(solve_triangular(R, np.eye(n)))
        self.B = np.asarray(solve_triangular(R, self.A.T, trans="T").T)
        self.logdet = 2 * float(np.sum(np.log(np.abs(np.diagonal(R)))))
        self.updates = 0

    @property
    def leverage(self) -> Array:
        """Squared length of every row in posterior coordinates: predicted variance over noise variance."""
        return np.asarray(np.einsum("ij,ij->i", self.B, self.B))

    @property
    def variance(self) -> Array:
        """Posterior variance of every load over its prior variance."""
        return np.asarray(np.einsum("ij,ij->i", self.T, self.T))

    def change(self, row: int, sign: int) -> None:
        """Add (+1) or remove (-1) a row."""
        b = self.B[row].copy()
        d = float(b @ b)
        if sign > 0:
            self.members.append(row)
        else:
            self.members.remove(row)
        self.updates += 1
        if self.updates >= REFRESH or (sign < 0 and d > SOLE):
            self._refresh()
            return
        if d == 0:
            return
        root = np.sqrt(1 + sign * d)
        g = -sign / (root * (1 + root))  # (1 / root - 1) / d without cancellation
        self.B += np.outer(self.B @ b, g * b)
        self.T += np.outer(self.T @ b, g * b)
        self.logdet += float(np.log1p(sign * d))

    def copy(self) -> RowSet:
        """An independent copy."""
        other = object.__new__(RowSet)
        other.A, other.members = self.A, list(self.members)
        other.T, other.B, other.logdet, other.updates = self.T.copy(), self.B.copy(), self.logdet, self.updates
        return other

    # -- what a row would do ----------------------------------------------------------------------------------------
    def gains(self, criterion: float) -> Array:
        """With each row added: gain of log det, or minus the logarithm of the norm of the variances that are left."""
        d = self.leverage
        if criterion == D:
            return np.log1p(d)
        return -_log_norm(self.variance[:, None] - (self.T @ self.B.T) ** 2 / (1 + d), criterion)

    def score(self, criterion: float) -> float:
        """What is maximised: log det, or minus the logarithm of the norm of the variances."""
        return self.logdet if criterion == D else -float(_log_norm(self.variance, criterion))


def _log_norm(variance: Array, p: float) -> Array:
    """Logarithm of the p-norm over the first axis, without overflow."""
    top = np.maximum(variance.max(axis=0), np.finfo(float).tiny)
    if p == WORST:
        return np.asarray(np.log(top))
    share = np.maximum(variance, 0.0) / top
    for _ in range(int(np.log2(p))):  # p is a power of two: squares are ten times as fast as powers
        np.square(share, out=share)
    return np.asarray(np.log(top) + np.log(np.maximum(np.sum(share, axis=0), 1.0)) / p)


def canonical(A: Array) -> NDArray[np.intp]:
    """Rank of every row in an order that depends on contents alone; equal rows in the order given."""
    top = np.abs(A).max()
    keys = np.round(A / (top if top > 0 else 1.0), 9)
    order = np.lexsort(keys.T[::-1])
    rank = np.empty(len(A), dtype=np.intp)
    rank[order] = np.arange(len(A))
    return rank


def pick(gains: Array, allowed: NDArray[np.bool_], rank: NDArray[np.intp]) -> int:
    """The row of largest gain; among equals the first in the canonical order."""
    inside = np.where(allowed, gains, -np.inf)
    equal = np.flatnonzero(inside >= inside.max() - TIE)
    return int(equal[np.argmin(rank[equal])])


def greedy(A: Array, n: int, keep: Rows, criterion: float, rank: NDArray[Any], step: Callable[[], None]) -> RowSet:
    """Add one row after the other, each the best now."""
    state = RowSet(A, keep)
    while len(state.members) < n:
        allowed = np.ones(len(A), bool)
        allowed[state.members] = False
        state.change(pick(state.gains(criterion), allowed, rank), 1)
        step()
    return state


def backward(A: Array, n: int, keep: Rows, criterion: float, rank: NDArray[Any], step: Callable[[], None]) -> RowSet:
    """Start from all rows and take out those of least leverage until n are left: a tenth at once while there are many,
    then one by one.
    """
    rows, fixed = np.arange(len(A)), np.isin(np.arange(len(A)), keep)
    while len(rows) > MANY * n:
        state = RowSet(A[rows], list(range(len(rows))))
        many = min(len(rows) // 10 + 1, len(rows) - MANY * n)
        leverage = np.where(fixed[rows], np.inf, np.round(state.leverage, 9))
        rows = np.delete(rows, np.lexsort((rank[rows], leverage))[:many])
        step()
    state = RowSet(A[rows], list(range(len(rows))))
    while len(state.members) > n:
        allowed = np.zeros(len(rows), bool)
        allowed[state.members] = True
        state.change(pick(-state.leverage, allowed & ~fixed[rows], rank[rows]), -1)
        step()
    return RowSet(A, rows[state.members].tolist())


def exchange(state: RowSet, keep: Rows, criterion: float, rank: NDArray[Any], step: Callable[[], None]) -> RowSet:
    """Swap a chosen row for another while that helps: the best of all swaps (log det), or the first row that gains."""
    asked: dict[int, int] = {}
    for _ in range(SWAPS * max(len(state.members), 1)):
        found = _best_swap(state, keep, rank) if criterion == D else _first_swap(state, keep, criterion, rank, asked)
        if found is None:
            break
        before = state.score(criterion)
        state.change(found[0], -1)
        state.change(found[1], 1)
        step()
        if state.score(criterion) <= before:  # promised by rounding
            state.change(found[1], -1)
            state.change(found[0], 1)
            break
    state._refresh()
    return state


def swaps(state: RowSet, keep: Rows) -> tuple[NDArray[np.intp], Array]:
    """Members that may go, and the change of log det for each of them (rows) and each row that comes (columns)."""
    inside = np.array([i for i in state.members if i not in set(keep)], dtype=np.intp)
    d = state.leverage
    cross = state.B[inside] @ state.B.T
    ratio = (1 + d) * (1 - d[inside])[:, None] + cross**2
    change = np.log(np.maximum(ratio, np.finfo(float).tiny))
    for i in np.flatnonzero(d[inside] > SOLE):
        trial = state.copy()
        trial.change(int(inside[i]), -1)
        change[i] = trial.gains(D) + trial.logdet - state.logdet
    change[:, state.members] = -np.inf
    return inside, change


def _best_swap(state: RowSet, keep: Rows, rank: NDArray[Any]) -> tuple[int, int] | None:
    inside, change = swaps(state, keep)
    if not change.size or change.max() <= TIE:
        return None
    i, j = np.nonzero(change >= change.max() - TIE)
    first = np.lexsort((rank[inside[i]], rank[j]))[0]
    return int(inside[i[first]]), int(j[first])


def without(state: RowSet, rows: Rows, criterion: float) -> Iterator[tuple[int, Array]]:
    """For each member: what every row would bring to the set without it. Only the parts that change are computed:
    ``(I - b b^T)^-1 = I + b b^T / (1 - d)``.
    """
    d, variance = state.leverage, state.variance
    reach, cross = state.T @ state.B.T, state.B[rows] @ state.B.T
    for i, row in enumerate(rows):
        if d[row] > SOLE:
            trial = state.copy()
            trial.change(row, -1)
            yield row, trial.gains(criterion)
            continue
        left = 1 - d[row]
        changed = reach + np.outer(reach[:, row], cross[i] / left)
        rest = variance + reach[:, row] ** 2 / left
        np.square(changed, out=changed)
        changed /= 1 + d + cross[i] ** 2 / left
        yield row, -_log_norm(np.subtract(rest[:, None], changed, out=changed), criterion)


def _first_swap(
    state: RowSet, keep: Rows, criterion: float, rank: NDArray[Any], asked: dict[int, int]
) -> tuple[int, int] | None:
    """The first member that another row beats: those not `asked` for longest first, then the least useful ones."""
    fixed, score, leverage = set(keep), state.score(criterion), np.round(state.leverage, 9)
    allowed = np.ones(len(state.A), bool)
    allowed[state.members] = False
    if not allowed.any():
        return None
    order = sorted((i for i in state.members if i not in fixed), key=lambda i: (asked.get(i, -1), leverage[i], rank[i]))
    for out, gains in without(state, order, criterion):
        asked[out] = max(asked.values(), default=0) + 1
        if gains[allowed].max() > score + TIE:
            return out, pick(gains, allowed, rank)
    return None


def affordable(rows: int, n: int, keep: Rows, loads: int) -> bool:
    """Whether all sets can be looked at."""
    return comb(rows - len(keep), n - len(keep)) * (n + loads) * loads**2 <= WORK


def all_sets(A: Array, n: int, keep: Rows, criterion: float, step: Callable[[], None]) -> dict[frozenset[int], float]:
    """Score of every set of n rows that holds those to keep."""
    free = [i for i in range(len(A)) if i not in set(keep)]
    loads = A.shape[1]
    found: dict[frozenset[int], float] = {}
    for batch in _batched(combinations(free, n - len(keep)), 512):
        rows = np.array([[*keep, *c] for c in batch], dtype=np.intp)
        stacked = np.concatenate([A[rows], np.broadcast_to(np.eye(loads), (len(rows), loads, loads))], axis=1)
        R: Array = np.linalg.qr(stacked, mode="r")  # type: ignore[assignment]
        if criterion == D:
            scores = 2 * np.sum(np.log(np.abs(np.einsum("kii->ki", R))), axis=1)
        else:
            T = np.linalg.solve(R, np.broadcast_to(np.eye(loads), R.shape))
            scores = -_log_norm(np.sum(T**2, axis=2).T, criterion)
        found.update(zip(map(frozenset, rows.tolist()), scores.tolist(), strict=True))
        step()
    return found


def _batched(items: Iterable[Any], size: int) -> Iterator[list[Any]]:
    rest = iter(items)
    while batch := list(islice(rest, size)):
        yield batch
