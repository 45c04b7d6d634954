"""Which sensor is wrong: filters without one channel each, beside the filter with all, in service.

Every filter says how likely the samples are. If a channel is wrong, what the filter without it makes of the others is
as at the fit, and the channel itself lies anywhere around its prediction (a variance of its own, of the window):

    all channels      sum over samples of  -2 log N(e; 0, S)
    channel i wrong   the same of the others,  + samples (log of the variance of y_i - H_i x + 1)

Both with the prior of the loads and with one of loads `LARGER` times as large, whichever is the likelier: a load that
the fit did not know is no fault of a sensor. The difference (a generalised likelihood ratio, A. S. Willsky, Automatica
12 (1976) 601-611) is compared with the largest that the record of the fit gave, so that a model that is a bit wrong
names nobody, over windows of several lengths that end now. Two channels that are swapped are right in the filter that
takes them the other way round.

Some samples are one product for each filter (its recursion, lifted over them), and they are judged a hop at a time:
what a row costs is little more, and the answers do not depend on how samples come in blocks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable

from ..._inverse.gaussian.model import FilterModel, FilterState
from ..._inverse.gaussian.roots import Array, lower, solve_lower
from ..._inverse.gaussian.steady import SteadyFilter, steady
from .filters import restricted

HOP, LIFT = 20, 5  # samples that are judged at once, and that are one product
LARGER = 30.0  # times the std of the loads, of those that the fit did not know
WINDOWS = (1, 2, 4, 8)  # hops
KEPT = 16  # hops behind the present one at which channels may have been swapped
SURE = 40.0  # -2 log of the likelihood ratio, at least
MORE = 3.0  # times the largest of the fit
ALONE = 0.25  # of a ratio, by which it must be ahead of that of every other channel
SPREAD = 0.7  # of a ratio, that a single hop may give: one spike is no broken sensor
USUAL = 2.0  # times the normalised squares of the fit, that samples have which a hypothesis explains
STRANGE = 3.0  # times these, that samples have which do not fit
SPIKE, FEW = 4.0, 2  # mean normalised square of a sample that may be a spike; how many a hop may have
SETTLING = 10  # hops at the start and after a channel was missing, which nobody judges
JUMPED = 4  # hops that no channel explains, after which the state may have jumped
BACK = 5  # hops of good predictions after which a channel is believed again
WITHIN = 1.5  # times the variance of the fit, of a good prediction
LARGEST = 1e6  # entries of all lifted filters, beyond which nothing is watched
Bits = NDArray[np.bool_]
KINDS = ("wrong", "offset", "drift", "stuck", "dead", "swapped")


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
    constant : array (filters,)
        Logarithm of the determinant of the innovations, without a left-out channel.
    own : array (filters,)
        Std with which the left-out channel is predicted, 1 without one.
    ahead : tuple of array (n, any)
        Roots of the covariances of the predictions.
    x0 : array (n,)
    """

    out: NDArray[np.int_]
    M: Array
    A: Array
    B: Array
    W: Array
    H: Array
    constant: Array
    own: Array
    ahead: tuple[Array, ...]
    x0: Array

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
    def whole(self) -> Lifted:
        """Those with all channels."""
        rows = np.flatnonzero(self.out < 0)
        return replace(
            self, out=self.out[rows], M=self.M[rows], A=self.A[rows], B=self.B[rows], W=self.W[rows],
            constant=self.constant[rows], own=self.own[rows], ahead=tuple(self.ahead[i] for i in rows),
        )  # fmt: skip

    def hop(self, x: Array, Y: Array) -> tuple[Array, Array]:
        """Normalised innovations (filters, HOP, m) of a hop Y (HOP, m), and the next predictions (filters, n)."""
        q, m = len(x), Y.shape[1]
        z, n = np.empty((q, HOP, m)), x.shape[1]
        if np.isfinite(Y).all():
            v = np.empty((q, n + LIFT * m, 1))
            for t in range(0, HOP, LIFT):
                v[:, :n, 0], v[:, n:, 0] = x, Y[t : t + LIFT].ravel()
                both = np.matmul(self.M, v)[:, :, 0]
                z[:, t : t + LIFT], x = both[:, : LIFT * m].reshape(q, LIFT, m), both[:, LIFT * m :]
            return z, x
        for t, y in enumerate(Y):  # a channel that is missing is as it is predicted
            ahead = x @ self.H.T
            taken = np.where(np.isfinite(y), y, ahead)
            z[:, t] = np.matmul(self.W, (taken - ahead)[:, :, None])[:, :, 0]
            x = np.matmul(self.A, x[:, :, None])[:, :, 0] + np.matmul(self.B, taken[:, :, None])[:, :, 0]
        return z, x


def lifted(model: FilterModel) -> Lifted | None:
    """Filters of a model; None where not two of them exist, where noises are correlated, or where it is too large."""
    n, m = model.n, model.m
    if model.S is not None or m < 2 or 2 * (m + 1) * (LIFT * m + n) ** 2 > LARGEST:
        return None
    parts: list[tuple[int, SteadyFilter]] = []
    for size in (1.0, LARGER):
        wide = replace(model, LQ=size * model.LQ)
        for i in range(-1, m):
            try:
                rest = np.delete(np.arange(m), i) if i >= 0 else np.arange(m)
                parts.append((i, steady(restricted(wide, rest))))
            except (NotIdentifiable, InputError):
                if i < 0:
                    break
    if not parts or parts[0][0] >= 0 or len(parts) < 2:
        return None
    found = [_one(model, i, part) for i, part in parts]
    A, B, W, M, constant, own, ahead = zip(*found, strict=True)
    return Lifted(np.array([i for i, _ in parts]), np.array(M), np.array(A), np.array(B), np.array(W), model.H,
                  np.array(constant), np.array(own), tuple(ahead), model.x0)  # fmt: skip


def _one(model: FilterModel, out: int, settled: SteadyFilter) -> tuple[Any, ...]:
    """One filter as `Lifted` has it."""
    n, m = model.n, model.m
    used = np.array([i for i in range(m) if i != out])
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
    return A, B, W, np.vstack([*rows, state]), constant, own, ahead


@dataclass(frozen=True, eq=False)
class Usual:
    """What the record of a fit gave.

    Parameters
    ----------
    squares : array (filters,)
        Mean normalised square of an innovation.
    own : array (filters,)
        Of the channel that is left out.
    most : array (m,)
        Largest likelihood ratio against each channel.
    loudest : float
        Largest normalised squares of a window, over their mean.
    """

    squares: Array
    own: Array
    most: Array
    loudest: float


FEWEST = 10  # hops of a record, from which it tells what is usual
_LIFTED: WeakKeyDictionary[FilterModel, Lifted | None] = WeakKeyDictionary()


def lifted_of(model: FilterModel) -> Lifted | None:
    """`lifted`, made once for a model."""
    if model not in _LIFTED:
        _LIFTED[model] = lifted(model)
    return _LIFTED[model]


def usual(model: FilterModel, Y: Array) -> Usual | None:
    """Of a record (samples, m), NaN where a channel is missing; None where it is too short, or nothing is watched."""
    bank, hops = lifted_of(model), len(Y) // HOP
    skipped = max(2, hops // 20)
    if bank is None or hops - skipped < FEWEST:
        return None
    start = Watch(model, bank, Usual(np.ones(len(bank.out)), np.ones(len(bank.out)), np.zeros(model.m), 1.0))
    sums, first = [], skipped
    for k in range(hops):
        hop = Y[k * HOP : (k + 1) * HOP]
        if start.missing(hop):
            first = k + 1 + skipped
            continue
        start.judge(hop)
        if k >= first:
            sums.append((start.squares[-1].copy(), start.counts[-1].copy(), start.apart[-1].copy()))
    if len(sums) < FEWEST:
        return None
    squares, counts, apart = (np.array(part) for part in zip(*sums, strict=True))
    level = np.maximum(squares.sum(axis=0) / np.maximum(counts.sum(axis=0), 1), 1e-12)
    there = np.maximum(apart[:, 0].sum(axis=0), 1)
    own = np.maximum(apart[:, 2].sum(axis=0) / there, 1e-12)
    again = Watch(model, bank, Usual(level, own, np.zeros(model.m), 1.0))
    most, loudest = np.zeros(model.m), 1.0
    for s, c, a in sums:
        again.keep(s, c, a)
        ratios, loud, _ = again.ratios()
        most, loudest = np.maximum(most, ratios.max(axis=0)), max(loudest, loud)
    return Usual(level, own, most, loudest)


@dataclass(frozen=True)
class ChannelFault:
    """A channel that is wrong.

    Parameters
    ----------
    channel : int
    other : int
        With which it is swapped, else -1.
    kind : str
        One of `KINDS`.
    sample : int
        Before which it was named.
    """

    channel: int
    other: int
    kind: str
    sample: int


class Watch:
    """The filters with their states, and what they have found.

    Parameters
    ----------
    model : FilterModel
    bank : Lifted
    usual : Usual
    acts : bool
        Wrong channels are kept out.
    always : int
        Code of the rows in which nothing is found: what the fit has to say.
    """

    def __init__(
        self, model: FilterModel, bank: Lifted, usual: Usual, acts: bool = True, always: int = 0
    ) -> None:  # fmt: skip
        q, m = len(bank.out), model.m
        self.model, self.bank, self.usual, self.acts, self.always = model, bank, usual, acts, always
        self.x = np.tile(bank.x0, (q, 1))
        self.count, self.filled, self.buffer = 0, 0, np.zeros((HOP, m))
        self.squares, self.counts = np.zeros((0, q)), np.zeros((0, q))  # of the last hops, of used channels
        self.apart = np.zeros((0, 4, q))  # of left-out ones: how many, sums, squares, moments about the middle
        self.past = np.zeros((0, HOP, m))  # samples of the last hops, and the predictions before them
        self.before = np.zeros((0, len(bank.x0)))
        self.order = np.arange(m)
        self._hops, self._level = np.array(WINDOWS), np.log(usual.squares)
        self._own = np.where(bank.out < 0, 0.0, 2 * np.log(bank.own) + 1)
        self.held: ChannelFault | None = None
        self.masked = False  # kept out by the watch; before, by the gate
        self.good, self.strange, self.next_swap, self.early = 0, 0, 2, SETTLING
        self.named: list[ChannelFault] = []
        self.unlike, self.kept = 0, 0  # samples that do not fit, channel samples kept out
        self._told()
        self.reseed: FilterState | None = None
        self.settling = False  # the filters are to go on from what the filter of the answers predicts

    # -- samples ----------------------------------------------------------------------------------------------------
    @property
    def alarm(self) -> tuple[int, int]:
        """Code and channel (from 1) of the next row, (0, 0) where all is well."""
        if self.held is not None:
            return FAULT, self.held.channel + 1
        swapped = np.flatnonzero(self.order != np.arange(len(self.order)))
        if len(swapped):
            return FAULT, int(swapped[0]) + 1
        return (MISFIT, 0) if self.strange > 1 else (self.always, 0)

    def taken(self, Y: Array) -> Array:
        """Samples (..., m) as the filter is to take them: without a channel that is wrong, the swapped ones back."""
        if not self.acts:
            return Y
        Y = Y[..., self.order]
        if self.held is not None and self.masked:
            Y = np.array(Y)
            self.kept += int(np.isfinite(Y[..., self.held.channel]).sum())
            Y[..., self.held.channel] = np.nan
        return Y

    def _told(self) -> None:
        """What the rows of the next hop are told, and whether their samples are taken as they are."""
        self.row = np.array([self.alarm])  # code and channel
        self.idle = not self.acts or (not self.masked and bool(np.all(np.diff(self.order) > 0)))

    def feed(self, Y: Array) -> tuple[Array, NDArray[np.int_]]:
        """Samples as they are to be taken, and their alarms (samples, 2), up to where there is something to decide."""
        if not self.idle:
            Y = Y[: HOP - self.filled]
            taken, alarms = self.taken(Y), np.repeat(self.row, len(Y), axis=0)
            self.add(Y)
            return taken, alarms
        rows, k, changed = [], 0, False
        while k < len(Y) and not changed:
            part = slice(k, min(k + HOP - self.filled, len(Y)))
            rows.append(np.repeat(self.row, part.stop - k, axis=0))
            self.add(Y[part])
            k = part.stop
            changed = self.filled == 0 and (self.settling or self.held is not None or self.reseed is not None)
        return Y[:k], np.concatenate(rows)

    def settle(self, gated: Bits) -> FilterState | None:
        """Keep the wrong channel out, unless the gate does already (m,), or it was right in the last hop.

        Then the state from which to go on.
        """
        fault, ahead = self.held, self.reseed
        self.reseed = None
        if fault is None or not self.acts or self.masked:
            return ahead
        if gated[fault.channel] or self.good:
            return None
        f = int(np.flatnonzero(self.bank.out == fault.channel)[0])
        self.masked = True
        self._told()
        return FilterState(self.x[f].copy(), self.bank.ahead[f])

    def add(self, Y: Array) -> None:
        """Samples (samples, m) of one hop; at its end it is judged."""
        stop = self.filled + len(Y)
        self.buffer[self.filled : stop] = Y
        self.filled, self.count = stop, self.count + len(Y)
        self._full()

    def add_one(self, sample: Any) -> None:
        """The same of one sample (m,)."""
        self.buffer[self.filled] = sample
        self.filled += 1
        self.count += 1
        self._full()

    def _full(self) -> None:
        if self.filled == HOP:
            self.filled = 0
            self._hop()
            self._told()

    def _hop(self) -> None:
        """Judge a hop, but for those in which a channel is missing, and for some after them."""
        if self.missing(self.buffer):
            return
        self.judge(self.buffer)
        if self.early:
            self.early, strange = self.early - 1, self.strange
            self._forget()
            self.strange = strange  # its alarm stands meanwhile
            self.settling = self.early == 0
        else:
            self.decide()

    def start(self, ahead: Array) -> None:
        """Every filter goes on from a prediction: without a channel some forget their start slowly."""
        self.x, self.settling = np.tile(ahead, (len(self.x), 1)), False

    def missing(self, Y: Array) -> bool:
        """Whether a channel is missing in more than a few samples of a hop; the filters then begin anew behind it."""
        if np.isnan(Y).sum(axis=0).max() <= HOP // 5:
            return False
        self.x = np.tile(self.bank.x0, (len(self.x), 1))
        self._forget()
        self.early = SETTLING
        return True

    # -- hops -------------------------------------------------------------------------------------------------------
    def judge(self, Y: Array) -> None:
        """What the filters say of a hop."""
        Y = Y[:, self.order]
        self.past = np.concatenate([self.past[-KEPT:], Y[None]])
        self.before = np.concatenate([self.before[-KEPT:], self.x[:1]])
        Y, z, self.x = self._without_spikes(Y)
        self.keep(*self.said(z, Y, self.bank.out))
        if not np.isfinite(self.x).all():
            self.x = np.where(np.isfinite(self.x).all(axis=1, keepdims=True), self.x, self.bank.x0)

    def _without_spikes(self, Y: Array) -> tuple[Array, Array, Array]:
        """A hop without the few samples that alone make it loud, what the filters make of it, and their predictions.

        A spike is no broken sensor, and the filter of the answers keeps it out by its gate.
        """
        z, ahead = self.bank.hop(self.x, Y)
        kept, found, next_ones = Y, z, ahead
        for _ in range(FEW):
            level = np.mean(np.nan_to_num(found[0]) ** 2, axis=1) / self.usual.squares[0]
            if level.mean() < USUAL:
                return kept, found, next_ones
            loud = np.flatnonzero(level > SPIKE)
            if not len(loud):
                break
            kept = np.array(kept)
            kept[loud[0]] = np.nan
            found, next_ones = self.bank.hop(self.x, kept)
        level = np.mean(np.nan_to_num(found[0]) ** 2, axis=1) / self.usual.squares[0]
        return (kept, found, next_ones) if level.mean() < USUAL else (Y, z, ahead)

    def said(self, z: Array, Y: Array, out: NDArray[np.int_]) -> tuple[Array, Array, Array]:
        """Squares and number of the innovations of used channels; number, sum, squares, moment of left-out ones."""
        there = np.isfinite(Y)
        if not there.all() or not np.abs(z).max() < TOP:
            z = np.clip(np.nan_to_num(z, nan=TOP), -TOP, TOP)
        number, left = there.sum(axis=0), out >= 0
        own = z[np.arange(len(z)), :, np.maximum(out, 0)] * left[:, None]
        squares = np.einsum("ij,ij->i", own, own)
        counts = np.where(left, number[np.maximum(out, 0)], 0)
        total = np.einsum("ijk,ijk->i", z, z) - squares
        return total, number.sum() - counts, np.array([counts, own.sum(axis=1), squares, own @ MIDDLE])

    def keep(self, squares: Array, counts: Array, apart: Array) -> None:
        """One more hop, of the last ones that windows ask for."""
        most = max(WINDOWS) - 1
        self.squares = np.concatenate([self.squares[-most:], squares[None]])
        self.counts = np.concatenate([self.counts[-most:], counts[None]])
        self.apart = np.concatenate([self.apart[-most:], apart[None]])

    def ratios(self) -> tuple[Array, float, Array]:
        """Against each channel in each window (windows, m), how loud the samples are, and without each channel (m,)."""
        bank, u = self.bank, self.usual
        hops = self._hops[self._hops <= len(self.squares)]
        squares, counts, apart = (np.add.accumulate(x[::-1])[hops - 1] for x in (self.squares, self.counts, self.apart))
        cost = squares / u.squares + counts * self._level + (hops * HOP)[:, None] * bank.constant
        spread = np.log(np.maximum(apart[:, 2] / np.maximum(apart[:, 0], 1), u.own)) + self._own
        cost = np.concatenate([cost + apart[:, 0] * spread, np.full((len(hops), 1), np.inf)], axis=1)
        level = np.append(squares[-1] / np.maximum(counts[-1] * u.squares, 1), np.inf)
        best, explained = cost[:, bank.groups].min(axis=2), level[bank.groups].min(axis=1)
        found = np.zeros((len(WINDOWS), len(best[0]) - 1))
        found[: len(hops)] = np.maximum(best[:, :1] - best[:, 1:], -LOUD)
        return found, float(explained[0]) if len(self.squares) > 1 else 0.0, explained[1:]

    def _last(self) -> float:
        """How loud the last hop is."""
        level = self.squares[-1] / np.maximum(self.counts[-1] * self.usual.squares, 1)
        return float(level[self.bank.out < 0].min())

    def decide(self) -> None:
        """Name a channel, or believe it again."""
        ratios, loud, explained = self.ratios()
        if self.held is not None:
            self._returned(self.held)
            return
        most = STRANGE * self.usual.loudest
        strange = loud > most and self._last() > most  # a spike lies back
        over = ratios > SURE + MORE * self.usual.most
        if over.any():
            w = int(np.argmax(np.where(over, ratios, -np.inf).max(axis=1)))
            i = int(np.argmax(ratios[w]))
            others = np.delete(ratios[w], i)
            clear = bool(over[w, i]) and ratios[w, i] - others.max() > ALONE * ratios[w, i]
            if clear and explained[i] < USUAL * self.usual.loudest:
                beyond = self._beyond(i, w)
                if beyond.max() < SPREAD * beyond.sum():
                    self._hold(i)
                    return
                if beyond[-1] >= SPREAD * beyond.sum() > 0:  # in this hop alone, until now
                    self._forgive(i)
                    strange = False
        if len(self.squares) > 1:
            self.strange = self.strange + 1 if strange else max(self.strange - 1, 0) // 2
        self.unlike += HOP * (self.strange > 1)
        if strange and (silent := self._silent()) is not None:
            self._hold(silent)
            return
        if strange and self.strange >= self.next_swap:
            self.next_swap = 2 * self.strange
            if not self._swap() and self.strange >= JUMPED and explained.min() > USUAL * self.usual.loudest:
                self.early = SETTLING  # no channel explains it: the state may have jumped
        elif not strange and self.strange == 0:
            self.next_swap = 2

    def _forgive(self, i: int) -> None:
        """Filters that took a few wrong samples of a channel go on from the one that did not."""
        f = int(np.flatnonzero(self.bank.out == i)[0])
        self.x[self.bank.out != i] = self.x[f]

    def _beyond(self, i: int, window: int) -> Array:
        """What the hops of a window have of a channel beyond chance, in squares of its prediction."""
        its = self.bank.out == i
        some = self.apart[-max(WINDOWS[window], 2) :][:, :, its]
        return np.asarray(np.maximum(some[:, 2] / self.usual.own[its] - some[:, 0], 0).min(axis=1))

    def _silent(self) -> int | None:
        """The one channel that has stopped to move: no other one need tell."""
        noise, last = np.linalg.norm(self.model.LR, axis=1), self.past[-1]
        if len(self.past) < 4 or not np.isfinite(last).all():
            return None
        early = self.past[: len(self.past) // 2]
        if not np.isfinite(early).all():
            return None
        moved = np.sqrt(np.median(np.var(early, axis=1), axis=0)) > 5 * noise
        still = moved & ((np.ptp(last, axis=0) < 1e-3 * noise) | (np.std(last, axis=0) < 1.5 * noise))
        found = np.flatnonzero(still)
        return int(found[0]) if len(found) == 1 and np.any(self.bank.out == found[0]) else None

    def _hold(self, i: int) -> None:
        """Keep a channel out from the next sample on; the filter without it, at usual loads, knows the state."""
        f = int(np.flatnonzero(self.bank.out == i)[0])
        self.held, self.good, self.masked = ChannelFault(i, -1, self._kind(i, f), self.count), 0, False
        self.named.append(self.held)

    def _kind(self, i: int, f: int) -> str:
        """What a channel does, in a word."""
        last, noise = self.past[-1][:, i], float(np.linalg.norm(self.model.LR[i]))
        last = last[np.isfinite(last)]
        if len(last) < 2:
            return "wrong"
        before = self.past[: max(len(self.past) // 2, 1), :, i]
        before = before[np.isfinite(before)]
        spread = float(np.std(before)) if len(before) else 0.0
        if np.ptp(last) <= 1e-3 * noise:
            return "dead" if abs(float(last[0])) <= 1e-3 * noise else "stuck"
        if np.std(last) < 2 * noise and spread > 5 * noise and abs(np.mean(last)) < 2 * noise:
            return "dead"
        number, total, squares, moment = self.apart[-2:, :, f].T
        number = np.maximum(number, 1)
        mean = total / number
        rest = (squares - moment**2 / float(MIDDLE @ MIDDLE)) / number - mean**2
        if np.all(rest <= 3 * self.usual.own[f]) and np.all(np.abs(mean) > 1):
            moved = abs(mean[-1] - mean[0])
            return "drift" if moved > 4 * np.sqrt(self.usual.own[f] * 2 / number[-1]) else "offset"
        return "wrong"

    def _returned(self, fault: ChannelFault) -> None:
        """Believe a channel again that is predicted well for long enough."""
        f = int(np.flatnonzero(self.bank.out == fault.channel)[0])
        number, total, squares, _ = self.apart[-1, :, f]
        usual, number = self.usual.own[f], max(number, 1)
        self.good = self.good + 1 if squares / number <= WITHIN * usual else 0
        if self.good < BACK:
            return
        number, total, squares, _ = self.apart[-BACK:, :, f].sum(axis=0)
        if total**2 / max(number, 1) > 9 * usual * WITHIN:  # it still has a mean
            return
        self.held, self.good, self.masked = None, 0, False
        self._forgive(fault.channel)
        self._forget()

    def _swap(self) -> bool:
        """Take two channels the other way round, where that alone makes the last hops usual."""
        if len(self.past) < 3:
            return False
        m, tried = self.model.m, []
        for i, j in combinations(range(m), 2):
            order = np.arange(m)
            order[[i, j]] = j, i
            tried.append((*self._again(order), i, j, order))
        tried.sort(key=lambda one: one[0])
        cost, x, i, j, order = tried[0]
        second = tried[1][0] if len(tried) > 1 else np.inf
        if cost > USUAL * self.usual.loudest or second < 1.5 * cost:
            return False
        self.named += [ChannelFault(int(self.order[i]), int(self.order[j]), "swapped", self.count)]
        self.order = self.order[order]
        self.x = np.tile(x, (len(self.x), 1))
        self._forget()
        if self.acts:
            self.reseed = FilterState(x, self.bank.ahead[0])
        return True

    def _again(self, order: NDArray[np.int_]) -> tuple[float, Array]:
        """Loudness of the last hops with channels in another order, and the prediction after them.

        Begins with that order as far back as it does best: nobody knows when they were swapped.
        """
        best: tuple[float, Array] = (np.inf, self.bank.x0)
        bank, usual = self.bank.whole, self.usual.squares[self.bank.out < 0]
        for back in (len(self.past), max(len(self.past) // 2, 2)):
            x, levels = np.tile(self.before[-back], (len(usual), 1)), []
            for Y in self.past[-back:]:
                z, x = bank.hop(x, Y[:, order])
                total, counts, _ = self.said(z, Y, bank.out)
                levels.append(total / np.maximum(counts * usual, 1))
            last = float(np.mean(levels[-2:], axis=0).min())
            if last < best[0]:
                best = last, x[0].copy()
        return best

    def _forget(self) -> None:
        """Begin new windows."""
        self.squares, self.counts, self.apart = self.squares[:0], self.counts[:0], self.apart[:0]
        self.past, self.before, self.strange, self.next_swap = self.past[:0], self.before[:0], 0, 2

    # -- files ------------------------------------------------------------------------------------------------------
    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        faults = [[f.channel, f.other, f.kind, f.sample] for f in self.named]
        return {
            **{name: getattr(self, name) for name in ARRAYS}, **{name: getattr(self, name) for name in NUMBERS},
            "named": faults, "held": self.held is not None,
        }  # fmt: skip

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        for name in ARRAYS:
            setattr(self, name, np.array(tree[name]))
        for name in NUMBERS:
            setattr(self, name, int(tree[name]))
        self.named = [ChannelFault(int(c), int(o), str(k), int(s)) for c, o, k, s in tree["named"]]
        self.held = self.named[-1] if tree["held"] else None
        self._told()


FAULT, MISFIT, CONTRADICTING = 528, 529, 530  # codes of the guards
MIDDLE = np.arange(HOP) - (HOP - 1) / 2
LOUD = 1e9  # -2 log of a ratio, at most
TOP = 1e6  # normalised innovation, beyond which it is no larger
ARRAYS = ("x", "buffer", "squares", "counts", "apart", "past", "before", "order")
NUMBERS = ("count", "filled", "good", "strange", "next_swap", "early", "unlike", "kept", "masked")
