"""Least squares of many rows by one triangular factor, which is all that is kept of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TALL = 4  # rows over columns that are factorised at once


def triangular(rows: Array) -> Array:
    """R of a QR of rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"), float)


@dataclass(frozen=True, eq=False)
class Triangle:
    """R of the QR of rows [1, features, outputs]: R^T R is their Gram matrix, which is never formed.

    Parameters
    ----------
    R : array (1 + features + outputs, the same)
        Upper triangular; rows of zeros where there were fewer rows than columns.
    rows : int
        How many rows there were.
    features : int
    """

    R: Array
    rows: int
    features: int

    @classmethod
    def of(cls, pairs: Iterable[tuple[Array, Array]]) -> Triangle:
        """Of features (k, p) and outputs (k, q), batch by batch."""
        held: list[Array] = []
        rows = p = 0
        for features, outputs in pairs:
            held.append(np.hstack([np.ones((len(features), 1)), features, outputs]))
            p, rows = features.shape[1], rows + len(features)
            if sum(len(block) for block in held) > TALL * held[0].shape[1]:
                held = [triangular(np.vstack(held))]
        R = triangular(np.vstack(held))
        square = np.zeros((R.shape[1], R.shape[1]))
        square[: len(R)] = R
        return cls(square, rows, p)

    def only(self, kept: NDArray[np.int_]) -> Triangle:
        """The factor of some of the features, in ascending order."""
        outputs = np.arange(1 + self.features, self.R.shape[1])
        columns = np.concatenate([[0], 1 + kept, outputs])
        return Triangle(triangular(self.R[:, columns]), self.rows, len(kept))

    # -- of rows less their mean --------------------------------------------------------------------------------------
    @property
    def mean(self) -> Array:
        """Mean of features and outputs."""
        return np.asarray(self.R[0, 1:] / self.R[0, 0])

    @property
    def own(self) -> Array:
        """Factor of the features (features, features)."""
        return self.R[1 : 1 + self.features, 1 : 1 + self.features]

    @property
    def shared(self) -> Array:
        """What of the outputs lies in the range of the features (features, outputs)."""
        return self.R[1 : 1 + self.features, 1 + self.features :]

    @property
    def rest(self) -> Array:
        """Factor of what of the outputs does not (outputs, outputs)."""
        return self.R[1 + self.features :, 1 + self.features :]

    @property
    def targets(self) -> Array:
        """Factor of the outputs (features + outputs, outputs)."""
        return self.R[1:, 1 + self.features :]

    def error(self, intercept: Array, B: Array) -> Array:
        """Root mean square error (outputs,) of ``intercept + features @ B`` on these rows."""
        p = self.features
        left = self.R[:, 1 + p :] - self.R[:, 1 : 1 + p] @ B
        left[0] -= self.R[0, 0] * intercept
        return np.asarray(np.linalg.norm(left, axis=0) / np.sqrt(max(self.rows, 1)))
