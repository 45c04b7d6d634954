"""Kalman filter whose covariance is carried as a root: one QR factorisation a sample, exact with channels missing.

    [ LR   H L-  ]           [ Se^1/2       0 ]
    [ 0    L-    ]  =  [     [ P- H^T Se^-T/2   L ]  ]  Q        update
    [ F L   LQ   ]  =  [ L-  0 ] Q                               prediction

Both in one array where a sample follows a sample. The covariance cannot lose its sign, as those of the short and of
the Joseph form do when sensors are quiet. Kailath, Sayed & Hassibi, Linear Estimation, Prentice Hall 2000, ch. 12;
Grewal & Andrews, Kalman Filtering, 4th ed., 2015, ch. 7.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, plain

from .model import FilterModel, Present, present
from .roots import Array, joined, lower, solve_lower, square

MASKS = 512  # sets of channels whose arrays are kept
LOG2PI = float(np.log(2 * np.pi))


@dataclass(frozen=True, eq=False)
class FilterState:
    """Mean x (n,) and root L (n, r) of its covariance; `y` the sample (m,), kept where noises are correlated."""

    x: Array
    L: Array
    y: Array | None = None

    def to_tree(self) -> dict[str, Array | None]:
        """Plain arrays, for files."""
        return {"x": self.x, "L": self.L, "y": self.y}

    @classmethod
    def from_tree(cls, tree: Mapping[str, Any]) -> FilterState:
        """Inverse of `to_tree`; what else the tree holds does not matter."""
        y = None if tree["y"] is None else np.asarray(tree["y"], float)
        return cls(np.asarray(tree["x"], float), np.asarray(tree["L"], float), y)


@dataclass(frozen=True, eq=False)
class Innovation:
    """What a sample said beyond its prediction.

    Parameters
    ----------
    e : array, shape (m,)
        NaN where a channel is missing.
    root : array, shape (present, present)
        Lower triangular root of its covariance; signs on the diagonal are free.
    gain : array, shape (n, present)
        ``P- H^T Se^-T/2``: the mean moved by gain times the whitened innovation.
    present : array of bool, shape (m,)
    nis : float
        Normalised square; chi-square with as many degrees of freedom as channels are present.
    loglik : float
        Logarithm of the predictive density of the sample.
    """

    e: Array
    root: Array
    gain: Array
    present: NDArray[np.bool_]
    nis: float
    loglik: float

    @property
    def std(self) -> Array:
        """Predicted std of e (m,), NaN where missing."""
        out = np.full(len(self.present), np.nan)
        out[self.present] = np.linalg.norm(self.root, axis=1)
        return out

    @property
    def normalised(self) -> Array:
        """Innovation in units of its own std, channel by channel (m,)."""
        return self.e / self.std


@dataclass(frozen=True, eq=False)
class Stack:
    """The constant part of the array of a sample that follows a sample."""

    before: Present
    now: Present
    ahead: Array  # [H F; F], times L
    noise: Array  # triangular root of [H LQ, LR; LQ, 0]


class SquareRoot:
    """The recursion sample by sample.

    Parameters
    ----------
    model : FilterModel

    Raises
    ------
    InputError
        Noises whose correlation is impossible.
    """

    def __init__(self, model: FilterModel) -> None:
        self.model = model
        self._present: dict[bytes, Present] = {}
        self._stacks: dict[bytes, Stack] = {}
        self.whole = self.seen(np.ones(model.m, bool))

    def start(self) -> FilterState:
        """Mean and covariance before the first sample: update without predicting."""
        return FilterState(self.model.x0, self.model.L0)

    def predict(self, state: FilterState) -> FilterState:
        """One sample later."""
        part = self.whole if self.model.S is None else self.seen(_there(state.y, self.model.m))
        return FilterState(part.moved(state.x, state.y), lower(part.F @ state.L, part.LQ))

    def update(self, state: FilterState, y: ArrayLike) -> tuple[FilterState, Innovation]:
        """With the sample y (m,) of the same time; channels that are NaN are left out, exactly.

        Raises
        ------
        InputError
            A sample of another width, or infinite.
        """
        y = self.sample(y)
        part = self.seen(np.isfinite(y))
        return self._updated(_update_array(part, state.L), part, state.x, y)

    def advance(self, state: FilterState, y: ArrayLike) -> tuple[FilterState, Innovation]:
        """Prediction and update in one factorisation."""
        y = self.sample(y)
        stack = self.stack(None if self.model.S is None else _there(state.y, self.model.m), np.isfinite(y))
        x = stack.before.moved(state.x, state.y)
        return self._updated(joined(stack.noise, stack.ahead @ state.L), stack.now, x, y)

    # -- pieces that the steady gains stand on -----------------------------------------------------------------------
    def seen(self, mask: NDArray[np.bool_]) -> Present:
        """The model for one set of channels."""
        key = mask.tobytes()
        found = self._present.get(key)
        if found is None:
            if len(self._present) >= MASKS:
                self._present.clear()
            found = self._present[key] = present(self.model, mask)
        return found

    def stack(self, before: NDArray[np.bool_] | None, now: NDArray[np.bool_]) -> Stack:
        """Arrays of a sample with the channels `now` after one with those of `before`."""
        key = now.tobytes() if before is None else before.tobytes() + now.tobytes()
        found = self._stacks.get(key)
        if found is None:
            if len(self._stacks) >= MASKS:
                self._stacks.clear()
            found = self._stacks[key] = _stack(self.whole if before is None else self.seen(before), self.seen(now))
        return found

    def covariance(self, stack: Stack, L: Array) -> tuple[Array, Array, Array]:
        """Root of Se, gain ``P- H^T Se^-T/2`` and root of the filtered covariance, from that of the sample before."""
        return _parted(joined(stack.noise, stack.ahead @ L), len(stack.now.H))

    def update_root(self, part: Present, L: Array) -> Array:
        """Root of the filtered covariance from that of the predicted one."""
        return _parted(_update_array(part, L), len(part.H))[2]

    def sample(self, y: ArrayLike) -> Array:
        """A sample as float64 (m,).

        Raises
        ------
        InputError
            Another width, or an infinite number; NaN is a missing channel.
        """
        y = np.asarray(plain(y), float)
        if y.shape != (self.model.m,):
            raise InputError("a sample of the wrong width", where="sample", found=f"shape {y.shape}",
                             expected=f"({self.model.m},)")  # fmt: skip
        if np.isinf(y).any():
            raise InputError("an infinite number in a sample", where=f"channel {int(np.flatnonzero(np.isinf(y))[0])}",
                             expected="finite numbers, NaN where a channel is missing")  # fmt: skip
        return y

    def _updated(self, made: Array, part: Present, x: Array, y: Array) -> tuple[FilterState, Innovation]:
        m = len(part.H)
        root, gain, L = _parted(made, m)
        rest = y[part.mask] - part.H @ x
        if m and not np.all(np.diag(root)):
            raise InputError("a channel without noise repeats what is known exactly", where="FilterModel.LR",
                             found="a singular covariance of the innovation", expected="noise on it")  # fmt: skip
        white = solve_lower(root, rest)
        nis = float(white @ white)
        loglik = -0.5 * (nis + m * LOG2PI) - float(np.sum(np.log(np.abs(np.diag(root)))))
        e = np.full(len(y), np.nan)
        e[part.mask] = rest
        kept = y if self.model.S is not None else None
        return FilterState(x + gain @ white, L, kept), Innovation(e, root, gain, part.mask, nis, loglik)


def _there(y: Array | None, m: int) -> NDArray[np.bool_]:
    return np.zeros(m, bool) if y is None else np.isfinite(y)


def _update_array(part: Present, L: Array) -> Array:
    """The array of an update, made triangular."""
    m = len(part.H)
    wide = np.zeros((m + len(L), m + L.shape[1]))
    wide[:m, :m], wide[:m, m:], wide[m:, m:] = part.LR, part.H @ L, L
    return lower(wide)


def _stack(before: Present, now: Present) -> Stack:
    m, n, q = len(now.H), len(before.F), before.LQ.shape[1]
    noise = np.zeros((m + n, q + m))
    noise[:m, :q], noise[m:, :q], noise[:m, q:] = now.H @ before.LQ, before.LQ, now.LR
    return Stack(before, now, np.vstack([now.H @ before.F, before.F]), square(lower(noise)))


def _parted(made: Array, m: int) -> tuple[Array, Array, Array]:
    """Root of Se (m, m), gain (n, m), root (n, at most n) out of a triangular array."""
    return made[:m, :m], np.ascontiguousarray(made[m:, :m]), np.ascontiguousarray(made[m:, m:])
