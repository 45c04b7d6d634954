"""Filters without one channel each, beside the filter with all: what each predicts, and which loads it answers.

With the prior of the loads and with one of loads `LARGER` times as large: a load that the fit did not know is no fault
of a sensor. Some samples are one product for each filter (its recursion, lifted over them), and a hop of them is
judged at once: what a row costs is little more.

Where one channel is wrong and the samples do not tell which, each filter that may be right has its loads, and what is
known of them is the mixture: the mean of their means, the spread between them beside the std of each
(B. D. O. Anderson, J. B. Moore, Optimal Filtering, Prentice-Hall 1979, ch. 10).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable

from ..._inverse.gaussian.model import FilterModel
from ..._inverse.gaussian.roots import Array, lower, solve_lower
from ..._inverse.gaussian.steady import SteadyFilter, steady
from .filters import restricted

HOP, LIFT = 20, 5  # samples that are judged at once, and that are one product
LARGER = 30.0  # times the std of the loads, of those that the fit did not know
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
        for t, y in enumerate(Y):  # a channel that is missing is as it is predicted
            ahead = x @ self.H.T
            taken = np.where(np.isfinite(y), y, ahead)
            z[:, t] = np.matmul(self.W, (taken - ahead)[:, :, None])[:, :, 0]
            x = np.matmul(self.A, x[:, :, None])[:, :, 0] + np.matmul(self.B, taken[:, :, None])[:, :, 0]
        return z, x

    def mixed(self, rows: NDArray[np.int_], weights: Array, x: Array, Y: Array) -> tuple[Array, Array, Array]:
        """Loads and std (samples, p) of samples, any of some filters being right, and their predictions (rows, n)."""
        load, std = np.empty((len(Y), len(self.Cp))), np.empty((len(Y), len(self.Cp)))
        A, B, G, own = self.A[rows], self.B[rows], self.G[rows], weights @ self.std[rows] ** 2
        for t, y in enumerate(Y):
            ahead = x @ self.H.T
            taken = np.where(np.isfinite(y), y, ahead)
            each = x @ self.Cp.T + np.matmul(G, (taken - ahead)[:, :, None])[:, :, 0]
            load[t] = weights @ each
            std[t] = np.sqrt(own + weights @ (each - load[t]) ** 2)
            x = np.matmul(A, x[:, :, None])[:, :, 0] + np.matmul(B, taken[:, :, None])[:, :, 0]
        return load, std, x


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
