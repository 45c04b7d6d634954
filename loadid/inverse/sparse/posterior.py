"""Covariance of a sparse load: least squares on its support, known in a few numbers however long the record is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class SupportPosterior:
    """Covariance ``B S S^T B^T`` of a load ``B x`` that is made of the few atoms of a support.

    It holds the noise on this support. Whether the support is the right one, it does not say.

    Parameters
    ----------
    basis : sparse matrix, shape (samples * loads, k)
        Histories of the atoms of the support.
    spread : array, shape (k, k)
        S, with the level of the noise in it.
    shape : tuple
        (samples, loads).
    """

    kind = "support"
    noise_std = None

    def __init__(self, basis: Any, spread: NDArray, shape: tuple[int, ...]) -> None:
        self.basis, self.spread, self.shape = basis.tocsr(), np.asarray(spread, float), tuple(int(i) for i in shape)

    @classmethod
    def of(cls, basis: Any, loads: NDArray, count: int, spread: NDArray, shape: tuple[int, ...]) -> SupportPosterior:
        """From histories (samples * len(loads), k) of some of `count` loads."""
        from scipy.sparse import coo_matrix

        found = basis.tocoo()
        time, column = np.divmod(found.row, len(loads))
        rows = time * count + np.asarray(loads)[column]
        return cls(coo_matrix((found.data, (rows, found.col)), (int(np.prod(shape)), found.shape[1])), spread, shape)

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation (samples, loads); zero where no atom of the support reaches."""
        std = np.zeros(int(np.prod(self.shape)))
        rows = np.flatnonzero(np.diff(self.basis.indptr))
        for start in range(0, len(rows), 1024):
            part = rows[start : start + 1024]
            std[part] = np.linalg.norm(self.basis[part] @ self.spread, axis=1)
        return std.reshape(self.shape)

    def variance(self, w: NDArray) -> NDArray[np.float64]:
        """Variance of ``sum(w * load)``; `w` has the shape of the load, or (k,) + that shape."""
        w = np.asarray(w, float)
        flat = w.reshape(*w.shape[: w.ndim - len(self.shape)], -1)
        return np.sum((np.asarray(flat @ self.basis) @ self.spread) ** 2, axis=-1)

    def noise_variance(self, w: NDArray) -> NDArray[np.float64]:
        """The same: there is no prior in it."""
        return self.variance(w)

    def bias_weights(self, w: NDArray) -> None:
        """Not known: the support was chosen by the data."""

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        found = self.basis.tocoo()
        return {
            "kind": self.kind,
            "rows": np.asarray(found.row, np.int64),
            "columns": np.asarray(found.col, np.int64),
            "values": found.data,
            "spread": self.spread,
            "shape": list(self.shape),
        }

    @classmethod
    def from_arrays(cls, tree: dict) -> SupportPosterior:
        """What `to_arrays` gave."""
        from scipy.sparse import coo_matrix

        shape, spread = tuple(int(i) for i in tree["shape"]), np.asarray(tree["spread"], float)
        at = np.asarray(tree["rows"], int), np.asarray(tree["columns"], int)
        basis = coo_matrix((np.asarray(tree["values"], float), at), (int(np.prod(shape)), len(spread)))
        return cls(basis, spread, shape)
