"""Filters without one channel each, beside the filter with all: what each predicts, and which loads it answers.

With the prior of the loads and with one of loads `LARGER` times as large: a load that the fit did not know is no fault
of a sensor. Some samples are one product for each filter (its recursion, lifted over them), and a hop of them is
judged at once: what a row costs is little more.

Where one channel is wrong and the samples do not tell which, each filter that may be right has its loads, and what is
known of them is the mixture: the mean of their means, the spread between them beside the std of each
(B. D. O. Anderson, J. B. Moore, Optimal Filtering, Prentice-Hall 1979, ch. 10).

And the cheap look at all of it, `Standby`: is there anything to look at? The settled filter with all channels alone,
over hops of samples. Its whitened innovations are summed over windows that end now: the squares of each and of all, and
the square of their mean; the load is held against those of the fit. As long as these stay below what the record of the
fit gave, or what white noise gives once in a long time, and well below what any channel must cost before it is named,
no hypothesis of `watch` wins, and none of them is followed. Otherwise they all go on from a prediction of this filter
some hops back, over the samples since, which are kept.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable

from ..._inverse.gaussian.compiled import Compiled
from ..._inverse.gaussian.loop import Loop
from ..._inverse.gaussian.model import FilterModel
from ..._inverse.gaussian.roots import Array, lower, solve_lower
from ..._inverse.gaussian.steady import SteadyFilter, steady
from .filters import restricted

HOP, LIFT = 20, 5  # samples that are judged at once, and that are one product
LARGER = 30.0  # times the std of the loads, of those that the fit did not know
SLIGHT, LASTS = 2.0, 10  # squares that missing cells may leave in later ones unnoticed; hops that are looked at
LARGEST = 1e6  # entries of all lifted filters, beyond which nothing is watched
Bits = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Lifted:
    """Settled filters of the same states, over a hop: all channels and then without each, usual loads and larger.

    Parameters
    ----------
    out : array of int (filters,)
        Channel that is left out; -1 for none.
    M : array (filters, LIFT m + n, n + LIFT m)
        Normalised innovations of some samples and the prediction after, from the prediction before and the samples.
    A, B, W : array (filters, n, n), (filters, n, m), (filters, m, m)
        The same sample by sample; what makes innovations normal.
    H : array (m, n)
    Cp : array (p, n)
    G, std : array (filters, p, m), (filters, p)
        What an innovation adds to the loads, and their std after a sample.
    constant : array (filters,)
        Logarithm of the determinant of the innovations, without a left-out channel.
    own : array (filters,)
        Std with which the left-out channel is predicted, 1 without one.
    ahead : tuple of array (n, any)
        Roots of the covariances of the predictions.
    x0 : array (n,)
    there : array of bool (m,)
        Channels that are not missing all the time.
    """

    out: NDArray[np.int_]
    M: Array
    A: Array
    B: Array
    W: Array
    H: Array
    Cp: Array
    G: Array
    std: Array
    constant: Array
    own: Array
    ahead: tuple[Array, ...]
    x0: Array
    there: Bits

    @cached_property
    def groups(self) -> NDArray[np.int_]:
        """Filters (1 + m, 2) with all channels, then without each, at usual loads and larger; one past them if none."""
        found = np.full((1 + len(self.H), 2), len(self.out))
        for i in range(-1, len(self.H)):
            its = np.flatnonzero(self.out == i)
            if len(its):
                found[i + 1] = its[0], its[-1]
        return found

    @cached_property
    def watched(self) -> Bits:
        """Channels (m,) without which there is a filter."""
        return np.asarray(self.groups[1:, 0] < len(self.out))

    @cached_property
    def hypotheses(self) -> NDArray[np.int_]:
        """Filters (1 + m,) with all channels, then without each, at usual loads; one past them if none."""
        return self.groups[:, 0]

    def without(self, i: int) -> int:
        """The filter without a channel, at usual loads."""
        return int(self.groups[i + 1, 0])

    @cached_property
    def left(self) -> tuple[Array, NDArray[np.int_]]:
        """What a missing cell of each channel (m,) leaves in the squares of later innovations, and for how many hops.

        Gains that are settled take the state for as well known as ever. Of the filter that it harms most, until less
        than `SLIGHT` is left.
        """
        size = np.linalg.norm(self.W, axis=1)  # of a channel, by the others: 1 / std (filters, m)
        state = self.B / np.where(size > 0, size, np.inf)[:, None]
        sums = np.zeros((LASTS, *size.shape))
        for k in range(LASTS * HOP):
            sums[k // HOP] += np.sum(np.matmul(self.W @ self.H, state) ** 2, axis=1)
            state = np.matmul(self.A, state)
        rest = np.cumsum(sums[::-1], axis=0)[::-1].max(axis=1)  # from each hop on, (LASTS, m)
        return rest[0], np.sum(rest > SLIGHT, axis=0)

    @cached_property
    def whole(self) -> Lifted:
        """Those with all channels."""
        rows = np.flatnonzero(self.out < 0)
        return replace(
            self, out=self.out[rows], M=self.M[rows], A=self.A[rows], B=self.B[rows], W=self.W[rows], G=self.G[rows],
            std=self.std[rows], constant=self.constant[rows], own=self.own[rows],
            ahead=tuple(self.ahead[i] for i in rows),
        )  # fmt: skip

    def hop(self, x: Array, Y: Array) -> tuple[Array, Array]:
        """Normalised innovations (filters, HOP, m) of a hop Y (HOP, m), and the next predictions (filters, n)."""
        q, m = len(x), Y.shape[1]
        z, n = np.empty((q, HOP, m)), x.shape[1]
        gone = ~self.there
        if gone.any():  # no filter takes them
            Y = np.where(gone, 0.0, Y)
        if np.isfinite(Y).all():
            v = np.empty((q, n + LIFT * m, 1))
            for t in range(0, HOP, LIFT):
                v[:, :n, 0], v[:, n:, 0] = x, Y[t : t + LIFT].ravel()
                both = np.matmul(self.M, v)[:, :, 0]
                z[:, t : t + LIFT], x = both[:, : LIFT * m].reshape(q, LIFT, m), both[:, LIFT * m :]
            return z, x
        x = np.array(x)
        loop = _with_gaps.after(len(Y) * self._moves.size)
        loop(self._moves, self.W, self.H, self._needed, np.ascontiguousarray(Y), x, z)
        return z, x

    def compile(self) -> None:
        """Load the compiler for hops with missing samples now, and not within one."""
        _with_gaps.build()
        self.hop(np.zeros((len(self.out), self.H.shape[1])), np.full((HOP, len(self.H)), np.nan))

    @cached_property
    def _moves(self) -> Array:
        """States and samples that are expected next, from a prediction and a sample (filters, n+m, n+m), transposed."""
        ahead = np.concatenate([self.A, self.B], axis=2)
        return np.ascontiguousarray(np.swapaxes(np.concatenate([ahead, self.H @ ahead], axis=1), 1, 2))

    @cached_property
    def _needed(self) -> Bits:
        """Channels (m,) that any filter has; the others are missing all the time."""
        return np.asarray(self.W.any(axis=(0, 1)))

    def mixed(self, rows: NDArray[np.int_], weights: Array, x: Array, Y: Array) -> tuple[Array, Array, Array]:
        """Loads and std (samples, p) of samples, any of some filters being right, and their predictions (rows, n)."""
        load, std = np.empty((len(Y), len(self.Cp))), np.empty((len(Y), len(self.Cp)))
        A, B, G, W, own = self.A[rows], self.B[rows], self.G[rows], self.W[rows], weights @ self.std[rows] ** 2
        for t, y in enumerate(Y):
            ahead = x @ self.H.T
            news = _completed(y - ahead, W)
            each = x @ self.Cp.T + np.matmul(G, news[:, :, None])[:, :, 0]
            load[t] = weights @ each
            std[t] = np.sqrt(own + weights @ (each - load[t]) ** 2)
            x = np.matmul(A, x[:, :, None])[:, :, 0] + np.matmul(B, (ahead + news)[:, :, None])[:, :, 0]
        return load, std, x


@Compiled
def _with_gaps(moves: Array, W: Array, H: Array, needed: Bits, Y: Array, x: Array, z: Array) -> None:
    """Innovations z (filters, samples, m) of samples with missing ones (`_completed`), and the next predictions in x.

    The least squares by reflections.
    """
    q, m, n = W.shape[0], W.shape[1], x.shape[1]
    both, news, rest, work, ahead, at = (
        np.zeros(n + m), np.zeros(m), np.zeros(m), np.zeros((m, m)), np.zeros(n + m), np.zeros(m, np.int64),
    )  # fmt: skip
    for f in range(q):
        for j in range(n):
            ahead[j] = x[f, j]
        for i in range(m):
            ahead[n + i] = 0.0
            for j in range(n):
                ahead[n + i] += H[i, j] * x[f, j]
        for t in range(Y.shape[0]):
            gone = 0
            for j in range(n + m):
                both[j] = ahead[j]
            for i in range(m):
                news[i] = Y[t, i] - both[n + i]
                if not np.isfinite(Y[t, i]):
                    news[i] = 0.0
                    if needed[i]:
                        at[gone] = i
                        gone += 1
            for i in range(m):
                rest[i] = 0.0
                for j in range(m):
                    rest[i] += W[f, i, j] * news[j]
            for c in range(gone):
                for i in range(m):
                    work[i, c] = W[f, i, at[c]]
                    z[f, t, i] = rest[i]
            for c in range(gone):
                size = 0.0
                for i in range(c, m):
                    size += work[i, c] * work[i, c]
                first = work[c, c]
                corner = -np.sqrt(size) if first >= 0.0 else np.sqrt(size)
                work[c, c] = first - corner
                beta = 1.0 / (size - first * corner)
                for k in range(c + 1, gone + 1):
                    total = 0.0
                    for i in range(c, m):
                        total += work[i, c] * (work[i, k] if k < gone else z[f, t, i])
                    total *= beta
                    for i in range(c, m):
                        if k < gone:
                            work[i, k] -= total * work[i, c]
                        else:
                            z[f, t, i] -= total * work[i, c]
                work[c, c] = corner
            for c in range(gone - 1, -1, -1):
                total = -z[f, t, c]
                for k in range(c + 1, gone):
                    total -= work[c, k] * news[at[k]]
                news[at[c]] = total / work[c, c]
            for i in range(m):
                z[f, t, i] = 0.0
                for j in range(m):
                    z[f, t, i] += W[f, i, j] * news[j]
                both[n + i] += news[i]
            for j in range(n + m):
                ahead[j] = 0.0
            k = 0
            while k + 4 <= n + m:
                a, b, c, d = both[k], both[k + 1], both[k + 2], both[k + 3]
                for j in range(n + m):
                    ahead[j] += (a * moves[f, k, j] + b * moves[f, k + 1, j]) + (
                        c * moves[f, k + 2, j] + d * moves[f, k + 3, j]
                    )
                k += 4
            while k < n + m:
                a = both[k]
                for j in range(n + m):
                    ahead[j] += a * moves[f, k, j]
                k += 1
        for j in range(n):
            x[f, j] = ahead[j]


def _completed(news: Array, W: Array) -> Array:
    """Innovations (filters, m), those of missing channels as the others tell: the gains take no more than is there.

    That is the mean of the missing ones given the others: the one of least ``|W news|``.
    """
    gone = ~np.isfinite(news[0])
    if not gone.any():
        return news
    news = np.where(gone, 0.0, news)
    gone &= W.any(axis=(0, 1))  # no filter has a channel that is missing all the time
    missing, told = W[:, :, gone], np.matmul(W, news[:, :, None])
    Q, R = np.linalg.qr(missing)
    news[:, gone] = -np.linalg.solve(R, np.matmul(np.swapaxes(Q, 1, 2), told))[:, :, 0]
    return news


def lifted(model: FilterModel, there: Bits) -> Lifted | None:
    """Filters of a model; None where not two of them exist, where noises are correlated, or where it is too large."""
    n, m = model.n, model.m
    if model.S is not None or there.sum() < 2 or 2 * (m + 1) * (LIFT * m + n) ** 2 > LARGEST:
        return None
    parts: list[tuple[int, NDArray[np.int_], SteadyFilter]] = []
    for size in (1.0, LARGER):
        wide = replace(model, LQ=size * model.LQ)
        for i in (-1, *np.flatnonzero(there).tolist()):
            used = np.array([j for j in np.flatnonzero(there) if j != i])
            try:
                parts.append((i, used, steady(restricted(wide, used))))
            except (NotIdentifiable, InputError):
                if i < 0:
                    break
    if not parts or parts[0][0] >= 0 or len(parts) < 2:
        return None
    found = [_one(model, *part) for part in parts]
    A, B, W, M, G, std, constant, own, ahead = zip(*found, strict=True)
    return Lifted(np.array([i for i, *_ in parts]), np.array(M), np.array(A), np.array(B), np.array(W), model.H,
                  model.Cp, np.array(G), np.array(std), np.array(constant), np.array(own), tuple(ahead), model.x0,
                  there)  # fmt: skip


def _one(model: FilterModel, out: int, used: NDArray[np.int_], settled: SteadyFilter) -> tuple[Any, ...]:
    """One filter as `Lifted` has it."""
    n, m = model.n, model.m
    K = np.zeros((n, m))
    K[:, used] = settled.K
    A, B = model.F @ (np.eye(n) - K @ model.H), model.F @ K
    ahead = lower(model.F @ settled.L, settled.part.LQ)
    own = 1.0 if out < 0 else float(np.hypot(np.linalg.norm(model.H[out] @ ahead), np.linalg.norm(model.LR[out])))
    W = np.zeros((m, m))
    W[np.ix_(used, used)] = solve_lower(settled.Se_root, np.eye(len(used)))
    if out >= 0:
        W[out, out] = 1 / own
    state = np.hstack([np.eye(n), np.zeros((n, LIFT * m))])
    rows = []
    for t in range(LIFT):
        y = np.zeros((m, n + LIFT * m))
        y[:, n + t * m : n + (t + 1) * m] = np.eye(m)
        rows.append(W @ (y - model.H @ state))
        state = A @ state + B @ y
    constant = 2 * float(np.sum(np.log(np.abs(np.diag(settled.Se_root)))))
    return A, B, W, np.vstack([*rows, state]), model.Cp @ K, settled.std, constant, own, ahead


_LIFTED: WeakKeyDictionary[FilterModel, dict[bytes, Lifted | None]] = WeakKeyDictionary()


def lifted_of(model: FilterModel, there: Bits | None = None) -> Lifted | None:
    """`lifted`, made once for a model and the channels that are there (all)."""
    there = np.ones(model.m, bool) if there is None else there
    made = _LIFTED.setdefault(model, {})
    if there.tobytes() not in made:
        made[there.tobytes()] = lifted(model, there)
    return made[there.tobytes()]


WINDOWS = (1, 2, 4, 8)  # hops
BEFORE = WINDOWS[-1] - 1  # hops of which the sums are kept
GRID = 16  # hops from one prediction that is kept to the next
BEHIND = 17  # hops at least over which the hypotheses are followed when they are woken
REST = WINDOWS[-1]  # hops in a row without anything, after which the hypotheses sleep
CHUNK = 64  # hops that are looked at together
ALL = np.ones(HOP)  # samples of a hop
TOP = 1e6  # innovation over its std, from which there is something, as where it is no number
RARELY = 4.5  # std of a Gaussian: as rarely is white noise beyond the bounds
ABOVE = 1.25  # times what the record of the fit gave beyond its mean
BELOW = 0.5  # of what a channel must cost to be named
SHARE = 0.8  # of the load that is a reason to look
SHOWN = 20  # samples over which a load shows
ENDS = np.array([[float(k >= WINDOWS[-1] - w) for k in range(WINDOWS[-1])] for w in WINDOWS])  # what a window adds up


def bounds(seen: Array, loads: int, least: float) -> Array:
    """Of the sums of each window (windows, own + 3), below which there is nothing to look at.

    Parameters
    ----------
    seen : array (hops, windows, own + 3)
        What the record of a fit gave.
    loads : int
    least : float
        What a channel must cost to be named, -2 log of the likelihood ratio.
    """
    own, n, mean = seen.shape[2] - 3, np.array(WINDOWS) * HOP, seen.mean(axis=0)
    free = np.column_stack([np.outer(n, np.r_[np.ones(own), own + loads]), np.full((len(n), 2), [max(own, 1), loads])])
    rare = mean * (1 - 2 / (9 * free) + RARELY * np.sqrt(2 / (9 * free))) ** 3  # Wilson and Hilferty
    cost = np.full(mean.shape, least)
    cost[:, -2:] *= n[:, None]  # of sums, not of means
    above = np.minimum(ABOVE * (seen.max(axis=0) - mean), BELOW * cost)
    above[:, -1] = cost[:, -1]  # another load than at the fit: no channel is named for it
    return np.asarray(np.maximum(rare, mean + above))


def _turned(A: Array, WH: Array, LQ: Array, p: int) -> Array:
    """Whitened innovations turned so that those in which a load shows most are the last p."""
    ways = [LQ]
    for _ in range(SHOWN):
        ways.append(A @ ways[-1])
    return np.linalg.svd(WH @ np.hstack(ways))[0].T[::-1]


class Standby:
    """The filter with all channels, and what it has seen.

    Parameters
    ----------
    bank : Lifted
    LQ : array (n, any)
        What a sample adds to the states, root of its covariance.
    bounds : array (windows, any), optional
        Infinite by default.
    most : array (p,), optional
        Largest loads at the end of a hop; infinite by default.
    """

    def __init__(self, bank: Lifted, LQ: Array, bounds: Array | None = None, most: Array | None = None) -> None:
        A, B, G, H = bank.A[0], bank.B[0], bank.G[0], bank.H
        W, self.own = _turned(A, bank.W[0] @ H, LQ, len(bank.Cp)) @ bank.W[0], max(len(H) - len(bank.Cp), 0)
        p, self.m = len(bank.Cp), len(H)
        rows = np.vstack([np.hstack([bank.Cp - G @ H, G]), np.hstack([-W @ H, W]), np.hstack([A, B])])
        self.loop = Loop(rows, p, self.m, bank.x0, np.full(self.m, TOP))
        self.bounds = np.full((len(WINDOWS), self.own + 3), np.inf) if bounds is None else bounds
        self.reach = None if most is None or np.all(np.isinf(most)) else most
        self.parts = np.zeros((2 * self.m, self.own + 3))
        self.parts[: self.own, -2] = self.parts[self.own : self.m, -1] = self.parts[self.m :, self.own] = 1.0
        self.parts[self.m : self.m + self.own, : self.own] = np.eye(self.own)
        self.sums = np.zeros((BEFORE, 2 * self.m))  # of the last hops: of the innovations, and of their squares
        self.hops: deque[Array] = deque(maxlen=BEHIND + GRID)
        self.starts: deque[Array | None] = deque(maxlen=BEHIND + GRID)  # predictions before them, where known
        self.slept = 0  # hops since it is alone
        self.found = np.zeros((0, len(WINDOWS), self.own + 3))  # of the last samples

    def begin(self, x: Array, hops: Array, starts: Array) -> None:
        """Be alone from a prediction on, after hops (hops, HOP, m) and the predictions before them."""
        self.loop.x, self.slept = x, 0
        self.hops.clear()
        self.starts.clear()
        self.hops.extend(hops)
        self.starts.extend(starts)

    def back(self) -> tuple[Array, list[Array]]:
        """A prediction some hops back, and the hops since."""
        known = [k for k, x in enumerate(self.starts) if x is not None]
        k = max((k for k in known if len(self.hops) - k >= BEHIND), default=known[0])
        start = self.starts[k]
        assert start is not None
        return start, list(self.hops)[k:]

    def look(self, x: Array, Y: Array) -> bool:
        """Whether there is anything in a hop (HOP, m) that begins at a prediction."""
        self.loop.x = x
        load, z = np.empty((HOP, self.loop.p)), np.empty(Y.shape)
        return self._judged(load, z, self.loop.block(Y, load, z))[1]

    def take(self, Y: Array) -> tuple[int, bool]:
        """Hops (hops HOP, m) up to the first in which there is anything: how many, and whether there is."""
        load, z, marks, done = np.empty((len(Y), self.loop.p)), np.empty(Y.shape), {}, 0
        while done < len(Y):
            ahead = -(self.slept + done // HOP) % GRID
            if ahead == 0:
                marks[done // HOP], ahead = self.loop.x, GRID
            part = slice(done, min(done + ahead * HOP, len(Y)))
            done += self.loop.block(Y[part], load[part], z[part])
            if done < part.stop:
                break
        taken, strange = self._judged(load, z, done)
        for k in range(max(taken - BEHIND - GRID, 0), taken):
            self.hops.append(np.array(Y[k * HOP : (k + 1) * HOP]))
            self.starts.append(marks.get(k))
        self.slept += taken
        return taken, strange

    def windows(self, z: Array) -> Array:
        """Sums (hops, windows, own + 3) over the windows that end with each hop of innovations (hops HOP, m).

        Squares of each that a load does not explain, and of all; of the sums of the former and of the others.
        """
        m, h = self.m, len(z) // HOP
        z = z[: h * HOP].reshape(h, HOP, m)
        self.sums = new = np.concatenate([self.sums, np.empty((h, 2 * m))])
        new[BEFORE:, :m], new[BEFORE:, m:] = np.matmul(ALL, z), np.matmul(ALL, z * z)
        over = np.matmul(ENDS, np.ndarray((h, len(ENDS[0]), 2 * m), float, new, 0, (new.strides[0], *new.strides)))
        means = over[:, :, :m]
        np.multiply(means, means, out=means)
        return np.asarray(np.matmul(over, self.parts))

    # -- inside -----------------------------------------------------------------------------------------------------
    def _judged(self, load: Array, z: Array, done: int) -> tuple[int, bool]:
        """Hops up to the first in which there is anything, of which so many samples were taken."""
        whole, total = done // HOP, len(z) // HOP
        self.found = self.windows(z[:done])
        within, first = self.found <= self.bounds, whole
        if np.count_nonzero(within) < within.size:
            first = int(np.argmin(within.all(axis=(1, 2))))
        if self.reach is not None:
            ends = np.abs(load[HOP - 1 : done : HOP]) <= self.reach
            if np.count_nonzero(ends) < ends.size:
                first = min(first, int(np.argmin(ends.all(axis=1))))
        strange = first < total
        self.sums = self.sums[: BEFORE + first + 1][-BEFORE:]
        if first == whole < total:  # no numbers, or none that are finite
            self.sums = np.concatenate([self.sums[1:], np.full((1, 2 * self.m), TOP**2)])
        return first + strange, strange

    # -- files ------------------------------------------------------------------------------------------------------
    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        starts = [np.full(len(self.loop.x), np.nan) if x is None else x for x in self.starts]
        return {"x": self.loop.x, "sums": self.sums.copy(), "hops": np.array(self.hops), "starts": np.array(starts),
                "slept": self.slept}  # fmt: skip

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.begin(np.asarray(tree["x"], float), np.asarray(tree["hops"], float), np.zeros((0, 0)))
        known: NDArray[Any] = np.asarray(tree["starts"], float)
        self.starts.extend(None if np.isnan(x).any() else x for x in known)
        self.sums, self.slept = np.array(tree["sums"], float), int(tree["slept"])
