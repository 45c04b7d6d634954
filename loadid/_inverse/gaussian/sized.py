"""Two penalties at once in O(N): differences of a load and its own size, ``|L g|^2 + |S g|^2`` with S diagonal.

The size of the load enters as rows that read it with data zero, weighed by lambda as the penalty is: at one lambda the
recursions solve the record with these rows, and the scalars count the rows of the sensors alone. Both penalties keep
their ratio, so that there is one lambda, and no load is free of the penalty.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from structures.errors import InputError

from .gains import Gains, gains
from .passes import Solved, solve
from .path import LONG, LOWEST, Scalars, StateSpacePath, beginning, root_of_largest, transfer
from .posterior import SLOPE, StateSpacePosterior, variances
from .record import WhitenedRecord
from .roots import Array


class SizedPath(StateSpacePath):
    """As `StateSpacePath`, with the penalty ``lam^2 (|L g|^2 + |S g|^2)``.

    Parameters
    ----------
    record : WhitenedRecord
    size : array, shape (p,)
        Diagonal of S, positive: weight of the size of each load beside its differences.
    quick
        As there.

    Raises
    ------
    InputError
        Sizes that are not positive or do not fit.
    """

    def __init__(self, record: WhitenedRecord, size: Array, *, quick: bool = False) -> None:
        size = np.asarray(size, float)
        if size.shape != (record.p,) or not np.all(np.isfinite(size)) or np.any(size <= 0):
            raise InputError("the sizes do not fit the loads", where="size", found=f"shape {size.shape}, or not > 0",
                             expected=f"({record.p},), positive numbers")  # fmt: skip
        self.size = size
        self._data = np.hstack([record.y, np.zeros((record.samples, record.p))])
        super().__init__(record, quick=quick, scale=_largest(record, size))
        self.null = 0

    @property
    def seen(self) -> float:
        """Smallest relative generalised singular value that counts, from the lines of the steady system."""
        if not hasattr(self, "_smallest"):
            H, loads = transfer(self.record)
            penalty = 1.0 + np.einsum("kij,i->kj", np.abs(loads) ** 2, self.size**2)  # over that of L g alone
            values = np.linalg.svd(H / np.sqrt(penalty)[:, None], compute_uv=False)
            self._smallest = float(np.clip(values.min() / float(self.scale), LOWEST, 1.0))
        return self._smallest

    def scalars(self, lam: float) -> Scalars:
        """Everything at one relative lambda; see `StateSpacePath.scalars`."""
        held, solved = self._solved(lam)
        known = variances(self._system(lam), held)
        assert known.variance is not None
        rest = self.record.y - self._heard(solved)
        count = self.unknowns + len(self.record.free)
        penalty = known.penalty + held.lam**2 * float(np.sum(known.variance @ self.size**2))
        change2 = bend = 0.0
        if not self.quick:
            again = self._again(lam, held, rest)
            change2, bend = float(np.sum(again.load**2)), self._inner(again, solved)
        return Scalars(
            residual2=float(np.sum(rest**2)), penalty2=self._inner(solved, solved), edf=count - penalty,
            left=(self.m - count) + penalty, ratio=held.logdet - 2 * count * np.log(held.lam) - self._limit,
            trace=known.trace, change2=change2, bend=bend,
        )  # fmt: skip

    # -- inside -------------------------------------------------------------------------------------------------------
    def _unforced(self) -> float:
        """Log det of the penalty, of inputs and free states together."""
        return gains(_silent(self.record, self.size), 1.0).logdet

    def _system(self, lam: float) -> WhitenedRecord:
        return with_size(self.record, self.size, float(lam) * float(self.scale), self._data)

    def _heard(self, solved: Solved) -> Array:
        return solved.response[:, : self.record.m]

    def _again(self, lam: float, held: Gains, y: Array) -> Solved:
        padded = self._data if y is self.record.y else np.hstack([y, np.zeros((len(y), self.record.p))])
        return solve(self._system(lam), held, padded)

    def _posterior(self, held: Gains, sigma: float) -> StateSpacePosterior:
        return SizedPosterior(self.record, held.lam, sigma, held, size=self.size)

    def _inner(self, a: Solved, b: Solved) -> float:
        """Product of two loads in the penalty."""
        return float(np.sum(a.inputs * b.inputs) + np.sum((a.load * b.load) @ self.size**2))


def with_size(record: WhitenedRecord, size: Array, lam: float, data: Array | None = None) -> WhitenedRecord:
    """The record with rows ``lam size g`` below those of the sensors; `data` are all data, default zero."""
    kinds, weight = len(record.C), lam * np.diag(size)
    rows = np.repeat((weight @ record.E)[None], kinds, 0), np.repeat(weight[None], kinds, 0)
    return replace(
        record, C=np.ascontiguousarray(np.concatenate([record.C, rows[0]], axis=1)),
        D=np.ascontiguousarray(np.concatenate([record.D, rows[1]], axis=1)),
        y=np.zeros((record.samples, record.m + record.p)) if data is None else data,
    )  # fmt: skip


def _silent(record: WhitenedRecord, size: Array, lam: float = 1.0) -> WhitenedRecord:
    """The penalty alone: no sensors."""
    return with_size(replace(record, C=0.0 * record.C, D=0.0 * record.D), size, lam)


def _largest(record: WhitenedRecord, size: Array) -> float:
    """Largest singular value of H over both penalties: the root of that of ``H P^-1 H^T`` for their precision P.

    Beyond `path.LONG` samples that of the beginning: under a penalty on its size a load is forgotten.
    """
    record = beginning(record, LONG) if record.samples > LONG else record
    held, shape = gains(_silent(record, size), 1.0), record.y.shape

    def normal(y: Array) -> Array:
        return solve(record, held, y.reshape(shape)).response.reshape(-1)

    return root_of_largest(normal, record.y.size)


class SizedPosterior(StateSpacePosterior):
    """As `StateSpacePosterior`, with the covariance ``sigma^2 (H^T H + lam^2 (L^T L + S^2))^-1``.

    Parameters
    ----------
    record, lam, sigma, held
        As there; the record without the rows of the size.
    size : array, shape (p,)
    """

    kind = "statespace, sized"

    def __init__(
        self, record: WhitenedRecord, lam: float, sigma: float, held: Gains | None = None, *, size: Array
    ) -> None:
        self.bare, self.size = record, np.asarray(size, float)
        super().__init__(with_size(record, self.size, lam), lam, sigma, held)

    @property
    def noise_std(self) -> Array:
        """Standard deviation from the noise alone: the derivative of lam^2 times the variance in lam^2."""
        steps = self.lam * np.exp(SLOPE * np.array([-2, -1, 1, 2]))
        parts = [x**2 * SizedPosterior(self.bare, x, 1.0, size=self.size).std ** 2 for x in steps]
        slope = (parts[0] - 8 * parts[1] + 8 * parts[2] - parts[3]) / (24 * SLOPE) / self.lam**2
        return np.asarray(self.sigma * np.sqrt(np.maximum(slope, 0.0)))

    def noise_variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)`` from the noise alone."""

        def own(one: Array) -> Array:
            heard = self._solve(one).response[:, : self.bare.m]
            return np.asarray(self.sigma**2 * float(np.sum(heard**2)))

        return self._each(w, own)

    def bias_weights(self, w: Array) -> Array:
        """``(R - I)^T w`` in the shape of `w`: what regularisation takes from the weights."""

        def own(one: Array) -> Array:
            found = self._solve(one)
            return np.asarray(-(self.lam**2) * (self._penalty_adjoint(found.inputs) + found.load * self.size**2))

        return self._each(w, own)

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        bare = StateSpacePosterior(self.bare, self.lam, self.sigma).to_arrays()
        return {**bare, "kind": self.kind, "size": self.size}

    @classmethod
    def from_arrays(cls, tree: dict[str, Any]) -> SizedPosterior:
        """From what `to_arrays` gave."""
        plain = StateSpacePosterior.from_arrays(tree)
        return cls(plain.record, plain.lam, plain.sigma, size=np.asarray(tree["size"], float))
