"""Loads some samples late: a fixed lag at the settled gain, and for any gains and gaps.

With all samples up to k, and W_0 = Cp P F^T, W_j = W_{j-1} (I - K H)^T F^T,

    p_{k-L|k} = Cp x_{k-L} + sum_{j=1..L} W_{j-1} H^T Se^-1 e_{k-L+j},

and the variance falls by the variance of each term. Anderson & Moore, Optimal Filtering, 1979, ch. 7; no covariance of
the state is inverted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError

from .model import FilterState, Innovation, SquareRoot
from .roots import Array, solve_lower, solve_lower_transposed
from .steady import SteadyFilter


@dataclass(frozen=True, eq=False)
class FixedLag:
    """What later innovations add to a load, for every lag up to the last.

    Parameters
    ----------
    taps : array, shape (lag, p, m)
        Of the innovations 1, 2, ... samples later; they do not depend on the lag. Zero where a phase has no channel.
    std : array, shape (lag + 1, p)
        Of the loads at each lag.
    cross : array, shape (lag + 1, p, n)
        Covariance of the load that many samples ago with the state now, both as estimated now.
    """

    taps: Array
    std: Array
    cross: Array

    @property
    def lag(self) -> int:
        """Samples."""
        return len(self.taps)

    def enough(self, share: float = 0.05) -> int:
        """The smallest lag at which every std is within a share of that at the longest."""
        return int(np.argmax(np.all(self.std <= (1 + share) * self.std[-1], axis=1)))

    def apply(self, load: ArrayLike, e: ArrayLike) -> tuple[Array, Array]:
        """Loads and stds (samples, p) of a steady stretch with all that is known at its end, at most `lag` later.

        Parameters
        ----------
        load : array, shape (samples, p)
            Filtered.
        e : array, shape (samples, m)
            Innovations.
        """
        load, e = np.array(load, float), np.asarray(e, float)
        N = len(load)
        for j in range(1, min(self.lag, N - 1) + 1):
            load[: N - j] += e[j:] @ self.taps[j - 1].T
        return load, self.std[np.minimum(np.arange(N)[::-1], self.lag)]


def fixed_lag(steady: SteadyFilter, lag: int) -> FixedLag:
    """Fixed-lag smoother of a steady filter.

    Raises
    ------
    InputError
        A lag that is no count.
    """
    return phased([steady], 0, lag)


def phased(phases: Sequence[SteadyFilter], start: int, lag: int) -> FixedLag:
    """As `fixed_lag`, of the samples of one phase of a periodic filter."""
    if lag != int(lag) or lag < 0:
        raise InputError("a lag counts samples", where="lag", found=lag, expected="0, 1, 2, ...")
    now, model = phases[start], phases[start].model
    root = model.Cp @ now.L
    W, variance = root @ now.L.T, np.sum(root**2, axis=1)
    taps, std, cross = np.zeros((lag, model.p, model.m)), [np.sqrt(variance)], [W]
    for j in range(1, lag + 1):
        later = phases[(start + j) % len(phases)]
        W = W @ now.part.F.T
        said = W @ solve_lower(later.Se_root, later.part.H).T
        taps[j - 1][:, later.part.mask] = solve_lower_transposed(later.Se_root, said.T).T
        variance = np.maximum(variance - np.sum(said**2, axis=1), 0.0)
        W, now = W - (W @ later.part.H.T) @ later.K.T, later
        std.append(np.sqrt(variance))
        cross.append(W)
    return FixedLag(taps, np.array(std), np.array(cross))


class LagLine:
    """The filter over innovations, sample by sample or in blocks: a line of the last loads and innovations.

    Parameters
    ----------
    fixed : FixedLag
        With a lag of at least one.
    """

    def __init__(self, fixed: FixedLag) -> None:
        lag, p, m = fixed.taps.shape
        if not lag:
            raise InputError("a line needs a lag", where="lag", found=0, expected="1, 2, ...")
        self._fixed, self._taps = fixed, np.ascontiguousarray(fixed.taps.transpose(1, 0, 2).reshape(p, lag * m))
        self._load, self._e, self._m = np.zeros((lag, p)), np.zeros(2 * lag * m), m
        self.lag, self.std, self.count = lag, fixed.std[-1].copy(), 0
        self.std.setflags(write=False)  # one array for all samples

    def push(self, load: Array, e: Array) -> Array | None:
        """The load (p,) `lag` samples ago; None until so many have come. Load and innovation are those of now."""
        lag, m = self.lag, self._m
        i = self.count % lag
        now, twin, kept = i * m, (i + lag) * m, self._e  # each innovation twice: the last ones lie side by side
        kept[now : now + m] = e
        kept[twin : twin + m] = e
        late = None
        if self.count >= lag:
            late = self._taps.dot(kept[now + m : twin + m])
            late += self._load[i]
        self._load[i] = load
        self.count += 1
        return late

    def block(self, load: Array, e: Array) -> Array:
        """As `push` for samples (samples, p), (samples, m): the loads that have become due (due, p)."""
        old, told = self.last()
        loads, es = np.concatenate([old, load]), np.concatenate([told, e])
        due = max(len(loads) - self.lag, 0)
        late = loads[:due].copy()
        # channel by channel: a product of matrices would round by how many samples come at once
        for j in range(1, self.lag + 1):
            for c in range(self._m):
                late += es[j : j + due, c, None] * self._fixed.taps[j - 1][:, c]
        for k in range(max(len(loads) - self.lag, len(old)), len(loads)):
            self._put(self.count + k - len(old), loads[k], es[k])
        self.count += len(load)
        return late

    def last(self) -> tuple[Array, Array]:
        """The last loads and innovations, at most `lag`, oldest first: what a checkpoint and `resumed` need."""
        order = np.arange(max(self.count - self.lag, 0), self.count) % self.lag
        return self._load[order], self._e.reshape(2 * self.lag, self._m)[order]

    def _put(self, at: int, load: Array, e: Array) -> None:
        i = at % self.lag
        self._load[i] = load
        self._e.reshape(2, self.lag, self._m)[:, i] = e


@dataclass(frozen=True, eq=False)
class Delayed:
    """Loads of the last samples with all that is known now, for any gains and gaps.

    Parameters
    ----------
    load, variance : array, shape (lag + 1, p)
        Of now, one sample ago, ...
    cross : array, shape (lag + 1, p, n)
        Covariance with the state now.
    lag : int
        Samples that are kept at most.
    """

    load: Array
    variance: Array
    cross: Array
    lag: int

    @property
    def std(self) -> Array:
        """Of each load (lag + 1, p)."""
        return np.sqrt(self.variance)

    def advance(
        self, core: SquareRoot, before: FilterState, state: FilterState, said: Innovation, lag: int | None = None
    ) -> Delayed:
        """One sample later: states of the filter before and after it, and what it said."""
        then = core.whole if core.model.S is None or before.y is None else core.seen(np.isfinite(before.y))
        root = core.model.Cp @ state.L
        return self.moved(
            then.F, core.seen(said.present).H, said.root, said.gain, said.e[said.present],
            core.model.Cp @ state.x, np.sum(root**2, axis=1), root @ state.L.T, self.lag if lag is None else lag,
        )  # fmt: skip

    def moved(
        self, F: Array, H: Array, Se_root: Array, gain: Array, e: Array,
        load: Array, variance: Array, cross: Array, lag: int,
    ) -> Delayed:  # fmt: skip
        """One sample later, for the transition F into it, its channels (H, e, root of Se, ``P- H^T Se^-T/2``).

        Load (p,), variance (p,) and covariance with the state (p, n) are those of that sample.
        """
        ahead = self.cross @ F.T
        news = ahead @ solve_lower(Se_root, H).T
        later = self.load + news @ solve_lower(Se_root, e)
        less = np.maximum(self.variance - np.sum(news**2, axis=2), 0.0)
        left, old = ahead - news @ gain.T, slice(0, lag)
        return Delayed(
            np.concatenate([load[None], later[old]]), np.concatenate([variance[None], less[old]]),
            np.concatenate([cross[None], left[old]]), lag,
        )  # fmt: skip


def delayed(core: SquareRoot, state: FilterState, lag: int) -> Delayed:
    """Start of the covariance form: nothing but the state of now."""
    root = core.model.Cp @ state.L
    load = (core.model.Cp @ state.x)[None]
    return Delayed(load, np.sum(root**2, axis=1)[None], (root @ state.L.T)[None], lag)


def resumed(fixed: FixedLag, load: ArrayLike, e: ArrayLike) -> Delayed:
    """The covariance form after a steady stretch, from its last loads (count, p) and innovations (count, m).

    As many delays as loads are given, at most `lag` + 1.
    """
    late, std = fixed.apply(load, e)
    count = min(len(late), fixed.lag + 1)
    return Delayed(late[::-1][:count], std[::-1][:count] ** 2, fixed.cross[:count], fixed.lag)
