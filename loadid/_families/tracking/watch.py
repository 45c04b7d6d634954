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

Where no single channel is clearly the one, the loads are those of all that may be (`bank.Lifted.mixed`): the band holds
them all. Samples are judged a hop at a time, so that answers do not depend on how they come in blocks.

All this sleeps while a cheaper look (`bank.Standby`) finds nothing, and is woken over the samples since some hops
before.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._guards.tracking import STAYS
from ..._inverse.gaussian.model import FilterModel, FilterState
from ..._inverse.gaussian.roots import Array
from .bank import CHUNK, HOP, REST, SHARE, SLIGHT, Bits, Lifted, Standby, bounds, lifted_of
from .faults import ChannelFault, kind_of, stopped
from .windows import TOP, Usual, Windows, of_others, said

KEPT = 16  # hops behind the present one at which channels may have been swapped
SURE = 80.0  # -2 log of the likelihood ratio, at least
MORE = 3.0  # times the largest of the fit
ALONE = 0.25  # of a ratio, by which it must be ahead of that of every other channel
SPREAD = 0.7  # of a ratio, that a single hop may give: one spike is no broken sensor
USUAL = 2.0  # times the normalised squares of the fit, that samples have which a hypothesis explains
STRANGE = 3.0  # times these, that samples have which do not fit
AGAIN = 2.0  # times what the best hypothesis leaves unexplained, of one that is refuted
REACHED = 4  # hops at whose ends the loads without a channel are held against those of the fit
FARTHEST = STAYS  # times the largest load of the fit, beyond which a channel may be wrong instead
UNLIKELY = 9.0  # -2 log of the odds, of a hypothesis whose loads are far beyond those of the fit
BACKS = (2, 3, 4)  # hops since channels may have been swapped, beside those kept and half of them
SPIKE, FEW = 4.0, 2  # mean normalised square of a sample that may be a spike; how many a hop may have
SETTLING = 10  # hops at the start and after the state may have jumped, which nobody judges
FOUND = 2  # the same where other channels are there than before
JUMPED = 4  # hops that no channel explains, after which the state may have jumped
BACK = 5  # hops of good predictions after which a channel is believed again
WITHIN = 1.5  # times the variance of the fit, of a good prediction


FEWEST = 10  # hops of a record, from which it tells what is usual


def usual(model: FilterModel, Y: Array) -> Usual | None:
    """Of a record (samples, m), NaN where a channel is missing; None where it is too short, or nothing is watched."""
    bank, hops = lifted_of(model), len(Y) // HOP
    skipped = max(2, hops // 20)
    if bank is None or hops - skipped < FEWEST:
        return None
    start = Watch(model, bank, Usual(np.ones(len(bank.out)), np.ones(len(bank.out)), np.zeros(model.m), 1.0))
    sums, seen, light, first = [], [], Standby(bank, model.LQ), skipped
    for k in range(hops):
        hop = Y[k * HOP : (k + 1) * HOP]
        if start.patchy(hop):
            start.anew()
            first = k + 1 + skipped
            continue
        light.look(start.x[0], hop)
        if start.judge(hop) and k >= first:
            kept = start.windows
            sums.append((kept.squares[-1].copy(), kept.counts[-1].copy(), kept.apart[-1].copy()))
            if len(light.found) and light.found.max() < TOP:
                seen.append(light.found[0])
    if len(sums) < FEWEST:
        return None
    squares, counts, apart = (np.array(part) for part in zip(*sums, strict=True))
    level = np.maximum(squares.sum(axis=0) / np.maximum(counts.sum(axis=0), 1), 1e-12)
    there = np.maximum(apart[:, 0].sum(axis=0), 1)
    own = np.maximum(apart[:, 2].sum(axis=0) / there, 1e-12)
    again = Windows(bank, Usual(level, own, np.zeros(model.m), 1.0))
    most, loudest = np.zeros(model.m), 1.0
    for s, c, a in sums:
        again.keep(s, c, a)
        ratios, loud, _ = again.ratios()
        most, loudest = np.maximum(most, ratios.max(axis=0)), max(loudest, loud)
    least = SURE + MORE * float(most.min())
    return Usual(level, own, most, loudest, bounds(np.array(seen), model.m - light.own, least) if seen else None)


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
    most : array (p,), optional
        Largest loads of the fit.
    """

    def __init__(
        self, model: FilterModel, bank: Lifted, usual: Usual, acts: bool = True, always: int = 0,
        most: Array | None = None,
    ) -> None:  # fmt: skip
        q, m = len(bank.out), model.m
        self.model, self.acts, self.always = model, acts, always
        self.most = np.full(model.p, np.inf) if most is None else most
        self._all, self._fitted = bank, usual
        self.x = np.tile(bank.x0, (q, 1))
        self.count, self.filled, self.buffer = 0, 0, np.zeros((HOP, m))
        self.past = np.zeros((0, HOP, m))  # samples of the last hops, and the predictions before them
        self.before = np.zeros((0, len(bank.x0)))
        self.order = np.arange(m)
        self._take(bank)
        self.light = None if usual.calm is None else Standby(bank, model.LQ, usual.calm, SHARE * FARTHEST * self.most)
        self.blind, self.unseen = 0, 0  # hops to come that tell nothing, as cells are missing; samples of such so far
        self.asleep, self.calm = False, 0  # hops in a row in which there is nothing to look at
        self.held: ChannelFault | None = None
        self.masked = False  # kept out by the watch; before, by the gate
        self.good, self.strange, self.next_swap, self.early = 0, 0, 2, SETTLING
        self.named: list[ChannelFault] = []
        self.doubted = np.zeros(1 + m, bool)  # that no channel is wrong, but the load large; that each is
        self.either = np.zeros((0, len(bank.x0)))  # predictions of the filters of these
        self.weights = np.zeros(0)  # of each of them
        self.reached = np.zeros((0, 1 + m))  # their loads over those of the fit, squared, of the last hops
        self.suspects = np.zeros(m, bool)  # channels that were, since the start
        self.far = 0.0  # times the largest load of the fit
        self.unlike, self.kept = 0, 0  # samples that do not fit, channel samples kept out
        self._told()
        self.reseed: FilterState | None = None
        self.settling = False  # the filters are to go on from what the filter of the answers predicts

    def _take(self, bank: Lifted) -> None:
        """Judge by the filters of a bank: those of all channels, or of the ones that are there."""
        self.bank = bank
        self.usual = self._fitted if bank is self._all else of_others(self._fitted, self._all, bank)
        self.windows = Windows(bank, self.usual)

    # -- samples ----------------------------------------------------------------------------------------------------
    @property
    def alarm(self) -> tuple[int, int]:
        """Code and channel (from 1) of the next row, (0, 0) where all is well."""
        if self.held is not None:
            return FAULT, self.held.channel + 1
        swapped = np.flatnonzero(self.order != np.arange(len(self.order)))
        if len(swapped):
            return FAULT, int(swapped[0]) + 1
        either = np.flatnonzero(self.doubted[1:])
        one = int(self.order[either[0]]) + 1 if len(either) == 1 else 0
        if self.strange > 1:
            return MISFIT, one
        return (HUGE if self.doubted[0] else MISFIT if len(either) else self.always), one

    def loads(self, Y: Array) -> tuple[Array, Array] | None:
        """Loads and std (samples, p) of samples of a hop while any of some channels may be wrong; None otherwise."""
        if not self.acts or not self.doubted.any():
            return None
        load, std, self.either = self.bank.mixed(
            self.bank.hypotheses[self.doubted], self.weights, self.either, Y[..., self.order]
        )
        return load, std

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
        clear = not self.masked and not self.doubted.any()
        self.idle = not self.acts or (clear and bool(np.all(np.diff(self.order) > 0)))

    def feed(self, Y: Array) -> tuple[Array, NDArray[np.int_], tuple[Array, Array] | None]:
        """Samples as they are to be taken, their alarms (samples, 2), `loads`, up to where there is to decide."""
        if not self.idle:
            Y = Y[: HOP - self.filled]
            taken, alarms, mixed = self.taken(Y), np.repeat(self.row, len(Y), axis=0), self.loads(Y)
            self.add(Y)
            return taken, alarms, mixed
        rows, k, changed = [], 0, False
        while k < len(Y) and not changed:
            whole = 0 if self.filled or not self.asleep else min((len(Y) - k) // HOP, CHUNK)
            row, stop = self.row, min(k + HOP - self.filled, len(Y))
            if whole:
                stop = k + HOP * self._doze(Y[k : k + whole * HOP])
            else:
                self.add(Y[k:stop])
            rows.append(np.repeat(row, stop - k, axis=0))
            k = stop
            changed = self.filled == 0 and (
                self.settling or self.held is not None or self.reseed is not None or bool(self.doubted.any())
            )
        return Y[:k], rows[0] if len(rows) == 1 else np.concatenate(rows), None

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
        f = self.bank.without(fault.channel)
        self.masked = True
        self._told()
        return FilterState(self.x[f].copy(), self.bank.ahead[f])

    def add(self, Y: Array) -> None:
        """Samples (samples, m) of one hop; at its end it is judged."""
        stop = self.filled + len(Y)
        self.buffer[self.filled : stop] = Y
        self.filled = stop
        if stop == HOP:
            self.full()

    def full(self) -> None:
        """Judge the hop that is complete."""
        self.filled = 0
        if self.asleep:
            self._doze(self.buffer)
            return
        self.count += HOP
        strange = self.light is None or self.light.look(self.x[0], self.buffer[:, self.order])
        self._hop()
        self._rest(strange)
        self._told()

    def _rest(self, strange: bool) -> None:
        """Sleep from the next hop on, where there has been nothing to look at for long enough."""
        clear = self.held is None and self.bank is self._all and bool(np.all(np.diff(self.order) > 0))
        clear &= not (strange or self.early or self.settling or self.strange or self.doubted.any())
        self.calm = self.calm + 1 if clear else 0
        if self.calm >= REST and self.light is not None:
            self.light.begin(self.x[0], self.past, self.before)
            self.asleep = True

    def _doze(self, Y: Array) -> int:
        """Hops (hops HOP, m) that are only looked at, up to one in which there is something, which is judged."""
        assert self.light is not None
        taken, strange = self.light.take(Y)
        self.count += taken * HOP
        if strange:
            self.asleep, self.calm = False, 0
            start, hops = self.light.back()
            self.x = np.tile(start, (len(self.x), 1))
            self._forget()
            for hop in hops[:-1]:
                self.judge(hop)
            self.buffer[:] = hops[-1]
            self._hop()
            self._told()
        return taken

    def _hop(self) -> None:
        """Judge a hop, but for those in which a channel is missing, and for some after them."""
        if self._other():
            return
        told = self.judge(self.buffer)
        if self.early:
            self.early, strange, doubted = self.early - 1, self.strange, self.doubted
            self._forget()
            self.strange = strange  # its alarm stands meanwhile
            self._doubt(doubted[1:], bool(doubted[0]))
            self.settling = self.early == 0
        elif told:
            self.decide()

    def start(self, ahead: Array) -> None:
        """Every filter goes on from a prediction: without a channel some forget their start slowly."""
        self.x, self.settling = np.tile(ahead, (len(self.x), 1)), False

    def patchy(self, Y: Array) -> bool:
        """Whether a channel that is there is missing in more than a few samples of a hop."""
        return bool(np.isnan(Y[:, self.bank.there]).sum(axis=0).max() > HOP // 5)

    def anew(self) -> None:
        """Every filter from its start."""
        self.x = np.tile(self.bank.x0, (len(self.x), 1))
        self._forget()
        self.early = SETTLING

    def _other(self) -> bool:
        """Whether channels come or go with this hop: filters of those that are there go on behind it.

        Nothing is judged while channels are there in part.
        """
        gone = np.isnan(self.buffer).sum(axis=0)
        part = (gone > HOP // 5) & (gone < HOP)
        there = gone < HOP
        if not part.any() and np.array_equal(there[self.order], self.bank.there):
            return False
        bank = None if part.any() else lifted_of(self.model, there[self.order])
        if bank is None:
            self.anew()
            return True
        self._take(bank)
        self.x = np.tile(bank.x0, (len(bank.out), 1))
        self._forget()
        if self.held is not None and not bank.watched[self.held.channel]:
            self.held, self.masked = None, False
        self.early, self.settling = FOUND, True
        return True

    # -- hops -------------------------------------------------------------------------------------------------------
    def judge(self, Y: Array) -> bool:
        """What the filters say of a hop; nothing, and False, where or since cells are missing that they need."""
        Y = Y[:, self.order]
        self.past = np.concatenate([self.past[-KEPT:], Y[None]])
        self.before = np.concatenate([self.before[-KEPT:], self.x[:1]])
        blind = self._blinded(Y)
        Y, z, self.x = self._without_spikes(Y)
        if not np.isfinite(self.x).all():
            self.x = np.where(np.isfinite(self.x).all(axis=1, keepdims=True), self.x, self.bank.x0)
        if blind:
            return False
        self.windows.keep(*said(z, Y, self.bank.out))
        size = self.x[np.minimum(self.bank.hypotheses, len(self.x) - 1)] @ self.bank.Cp.T / self.most
        self.reached = np.concatenate([self.reached[1 - REACHED :], np.sum(size**2, axis=1)[None]])
        return True

    def _blinded(self, Y: Array) -> bool:
        """Whether this hop or one before lacks cells that leave more than chance in the innovations of this one."""
        gone = np.isnan(Y).sum(axis=0) * self.bank.there
        if gone.any():
            harm, hops = self.bank.left
            if gone @ harm > SLIGHT:
                self.blind = max(self.blind, 1 + int(hops[gone > 0].max()))
        blind, self.blind = self.blind > 0, max(self.blind - 1, 0)
        self.unseen += HOP * blind
        return blind

    def _without_spikes(self, Y: Array) -> tuple[Array, Array, Array]:
        """A hop without the few samples that alone make it loud, what the filters make of it, and their predictions.

        A spike is no broken sensor, and the filter of the answers keeps it out by its gate.
        """
        z, ahead = self.bank.hop(self.x, Y)
        kept, found, next_ones = Y, z, ahead
        for _ in range(FEW):
            level = self._levels(found[0])
            if level.mean() < USUAL:
                return kept, found, next_ones
            loud = np.flatnonzero(level > SPIKE)
            if not len(loud):
                break
            kept = np.array(kept)
            kept[loud[0]] = np.nan
            found, next_ones = self.bank.hop(self.x, kept)
        level = self._levels(found[0])
        return (kept, found, next_ones) if level.mean() < USUAL else (Y, z, ahead)

    def _levels(self, z: Array) -> Array:
        """How loud each sample is to the filter with all channels, by its innovations (samples, m)."""
        if not np.isfinite(z).all():
            z = np.nan_to_num(z)
        return np.asarray(np.add.reduce(z * z, axis=1) / z.shape[1] / self.usual.squares[0])

    def decide(self) -> None:
        """Name a channel, or those of which one is wrong, or believe it again."""
        ratios, loud, explained = self.windows.ratios()
        if self.held is not None:
            self._returned(self.held)
            return
        usual = self.usual.loudest
        strange = loud > STRANGE * usual and self.windows.last() > STRANGE * usual  # a spike lies back
        over = ratios > SURE + MORE * self.usual.most
        some: Bits = np.zeros(len(self.order), bool)
        none = False
        if over.any():
            w = int(np.argmax(np.where(over, ratios, -np.inf).max(axis=1)))
            i = int(np.argmax(ratios[w]))
            right = explained[w] < USUAL * usual
            lead = ratios[w, i] - np.delete(ratios[w], i)
            ahead = lead > ALONE * ratios[w, i]  # or the others leave more unexplained than ever
            far = self.reached[:, 1:].max(axis=0)
            ahead |= np.delete(far, i) > far[i] + UNLIKELY
            ahead |= (lead > SURE) & (np.delete(explained[w], i) > max(STRANGE * usual, AGAIN * explained[w, i]))
            if right[i] and over[w, i]:
                beyond = self.windows.beyond(i, w)
                lasting = beyond.max() < SPREAD * beyond.sum()
                if ahead.all() and lasting:
                    if not (strange and self._swap()):  # which explains both with less
                        self._hold(i)
                    return
                if ahead.all() and beyond[-1] >= SPREAD * beyond.sum() > 0:  # in this hop alone, until now
                    self._forgive(i)
                    strange = False
                elif lasting:
                    some = right & over[w]
        if len(self.windows.squares) > 1:
            self.strange = self.strange + 1 if strange else max(self.strange - 1, 0) // 2
        silent = stopped(self.past, self.bank.there, self.model.LR) if strange else None
        if (
            silent is not None
            and self.bank.watched[silent]
            and (explained[0, silent] < STRANGE * usual or self.strange >= JUMPED)
        ):
            self._hold(silent)
            return
        if strange and self.strange >= self.next_swap:
            self.next_swap = self.strange + max(self.strange // 2, 1)
            if self._swap():
                return
            if self.strange >= JUMPED and explained[-1].min() > USUAL * usual:
                self.early = SETTLING  # no channel explains it: the state may have jumped
        elif not strange and self.strange == 0:
            self.next_swap = 2
        large = self.reached[-2:] > FARTHEST**2
        if not some.any() and self.strange < 2 and large[:, 0].all():  # unless no other load is possible
            none, some = True, np.asarray(explained[0] < USUAL * usual) & ~large[:, 1:].any(axis=0) & self.bank.watched
            self.far = max(self.far, float(np.sqrt(self.reached[-1, 0]) * some.any()))
        if some.any() or self.doubted.any():  # what no channel explains, filters without one do not either
            self._doubt(some, none)
        self.unlike += HOP * (self.alarm[0] == MISFIT)

    def _doubt(self, some: Bits, none: bool = False) -> None:
        """Any of some channels may be the wrong one from the next sample on, or none of them.

        A hypothesis is the less likely, the larger its loads are beside those of the fit: Gaussian, of such a std,
        where something is wrong for sure; with the tails of Cauchy where the load may be one that the fit did not know.
        """
        some = some & self.bank.watched
        self.suspects = self.suspects | some
        self.doubted = np.r_[none and bool(some.any()), some]
        self.either = self.x[self.bank.hypotheses[self.doubted]].copy()
        size = self.reached.max(axis=0, initial=0.0)[self.doubted]
        likely = 1 / (1 + size) if none and self.strange < 2 else np.exp(-0.5 * (size - size.min(initial=np.inf)))
        self.weights = likely / likely.sum()

    def _forgive(self, i: int) -> None:
        """Filters that took a few wrong samples of a channel go on from the one that did not."""
        f = self.bank.without(i)
        self.x[self.bank.out != i] = self.x[f]

    def _hold(self, i: int) -> None:
        """Keep a channel out from the next sample on; the filter without it, at usual loads, knows the state."""
        f = self.bank.without(i)
        noise, sums = float(np.linalg.norm(self.model.LR[i])), self.windows.apart[-2:, :, f]
        kind = kind_of(self.past[:, :, i], noise, sums, float(self.usual.own[f]))
        self.held, self.good, self.masked = ChannelFault(i, -1, kind, self.count), 0, False
        self.named.append(self.held)
        self._doubt(np.zeros(len(self.order), bool))

    def _returned(self, fault: ChannelFault) -> None:
        """Believe a channel again that is predicted well for long enough."""
        f = self.bank.without(fault.channel)
        number, total, squares, _ = self.windows.apart[-1, :, f]
        usual, number = self.usual.own[f], max(number, 1)
        self.good = self.good + 1 if squares / number <= WITHIN * usual else 0
        if self.good < BACK:
            return
        number, total, squares, _ = self.windows.apart[-BACK:, :, f].sum(axis=0)
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
        for i, j in combinations(np.flatnonzero(self.bank.there).tolist(), 2):
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
        for back in sorted({len(self.past), max(len(self.past) // 2, 2), *BACKS} & set(range(2, len(self.past) + 1))):
            x, levels = np.tile(self.before[-back], (len(usual), 1)), []
            for Y in self.past[-back:]:
                z, x = bank.hop(x, Y[:, order])
                total, counts, _ = said(z, Y, bank.out)
                levels.append(total / np.maximum(counts * usual, 1))
            last = float(np.mean(levels[-2:], axis=0).min())
            if last < best[0]:
                best = last, x[0].copy()
        return best

    def _forget(self) -> None:
        """Begin new windows."""
        self.windows.clear()
        self.past, self.before, self.strange, self.next_swap = self.past[:0], self.before[:0], 0, 2
        self.doubted, self.reached = np.zeros_like(self.doubted), self.reached[:0]

    # -- files ------------------------------------------------------------------------------------------------------
    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        faults = [[f.channel, f.other, f.kind, f.sample] for f in self.named]
        return {
            **{name: getattr(self, name) for name in (*ARRAYS, *NUMBERS)},
            **self.windows.to_tree(),
            "named": faults, "held": self.held is not None, "there": self.bank.there, "far": self.far,
            "count": self.count + self.filled, "light": None if self.light is None else self.light.to_tree(),
        }  # fmt: skip

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        there = np.array(tree.get("there", self.bank.there), bool)
        if (bank := lifted_of(self.model, there)) is not None and not np.array_equal(there, self.bank.there):
            self._take(bank)
        self.windows.restore(tree)
        for name in set(ARRAYS) & set(tree):  # those in doubt are newer than the first files
            setattr(self, name, np.array(tree[name]))
        self.doubted, self.suspects = self.doubted.astype(bool), self.suspects.astype(bool)
        for name in NUMBERS:
            setattr(self, name, int(tree.get(name, 0)))  # the last two are newer than the first files
        self.count -= self.filled  # those of whole hops
        if self.light is not None and (light := tree.get("light")) is not None:
            self.light.restore(light)
        self.far = float(tree.get("far", 0.0))
        self.named = [ChannelFault(int(c), int(o), str(k), int(s)) for c, o, k, s in tree["named"]]
        self.held = self.named[-1] if tree["held"] else None
        self._told()


HUGE, FAULT, MISFIT, CONTRADICTING = 526, 528, 529, 530  # codes of the guards
ARRAYS = ("x", "buffer", "past", "before", "order", "doubted", "suspects", "either", "weights", "reached")
NUMBERS = ("count", "filled", "good", "strange", "next_swap", "early", "unlike", "kept", "masked", "calm", "asleep",
           "blind", "unseen")  # fmt: skip
