"""Loads of every line under given variances of load and noise, and what a line tells without any: one batched SVD."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .compressed import Compressed


@dataclass(frozen=True)
class Factored:
    """Singular value decomposition of the lines over loads of equal expected size.

    Parameters
    ----------
    lines : Compressed
    root : array, shape (lines, loads)
        Expected size of each load: the condition does not depend on the units of the loads.
    U, s : array
        Left singular vectors and singular values of ``R diag(root)``.
    V : array, shape (lines, loads, rank)
        Right singular vectors times `root`: load = V z.
    """

    lines: Compressed
    root: NDArray[np.float64]
    U: NDArray[np.complex128]
    s: NDArray[np.float64]
    V: NDArray[np.complex128]

    @property
    def beta(self) -> NDArray[np.complex128]:
        """Data in the singular directions, (lines, rank, snapshots)."""
        return self.U.conj().swapaxes(1, 2) @ self.lines.b

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Directions above rounding, (lines, rank)."""
        return self.s > max(self.lines.shape[1:]) * np.finfo(float).eps * self.s[:, :1]


@dataclass(frozen=True)
class Posterior:
    """What the data say of the loads of each line.

    Parameters
    ----------
    gain : array, shape (lines, loads, rank)
        The estimator: load = gain b.
    load : array, shape (lines, loads, snapshots)
    covariance : array, shape (lines, loads, loads)
        ``E[e e^H]`` of the error of one realisation: noise and prior.
    edf : array, shape (lines,)
        Effective degrees of freedom.
    """

    gain: NDArray[np.complex128]
    load: NDArray[np.complex128]
    covariance: NDArray[np.complex128]
    edf: NDArray[np.float64]

    @property
    def variance(self) -> NDArray[np.float64]:
        """``E|error|^2``, shape (lines, loads)."""
        return np.maximum(np.einsum("kjj->kj", self.covariance).real, 0.0)


@dataclass(frozen=True)
class Identifiable:
    """What every line tells of each load without a prior, whatever regularisation does.

    Parameters
    ----------
    gain : array, shape (lines, loads)
        Whitened response to one unit of a load that no other loads can imitate: unit noise over it is the
        least-squares standard deviation. 0 where the line does not determine the load.
    naive : array, shape (lines, loads, snapshots)
        Least-squares loads, of smallest norm where there are many.
    condition : array, shape (lines,)
        Largest over smallest singular value; infinite where the line loses rank.
    """

    gain: NDArray[np.float64]
    naive: NDArray[np.complex128]
    condition: NDArray[np.float64]


def factor(lines: Compressed, variance: NDArray) -> Factored:
    """Decompose every line, its loads weighted by the root of their variance (lines, loads)."""
    root = np.sqrt(variance)
    U, s, Vh = np.linalg.svd(lines.scaled(root).R, full_matrices=False)
    return Factored(lines, root, U, s, root[..., None] * Vh.conj().swapaxes(1, 2))


def posterior(f: Factored, noise: NDArray, cut: NDArray | None = None) -> Posterior:
    """Solve every line.

    Parameters
    ----------
    f : Factored
        Its `root` is the standard deviation of the loads before the data.
    noise : array, shape (lines,)
        Variance of the whitened noise.
    cut : array (lines,), optional
        Singular values below this are left out and none is damped (truncated SVD); what is left out keeps its prior.
    """
    if cut is None:
        s = np.where(f.seen, f.s, 0.0)  # what rounding leaves of a silent direction carries no information
        total = np.where(f.seen, f.s**2 + noise[:, None], 1.0)
        filtered, told, remains = s / total, s**2 / total, np.where(f.seen, noise[:, None] / total, 1.0)
    else:
        kept = f.seen & (f.s >= cut[:, None] * (1 - 1e-12))
        safe = np.where(kept, f.s, 1.0)
        filtered, told = np.where(kept, 1 / safe, 0.0), kept.astype(float)
        remains = np.where(kept, noise[:, None] / safe**2, 1.0)
    gain = (f.V * filtered[:, None, :]) @ f.U.conj().swapaxes(1, 2)
    covariance = (f.V * remains[:, None, :]) @ f.V.conj().swapaxes(1, 2)
    if f.s.shape[1] < f.root.shape[1]:  # directions beyond the rank keep their prior
        j = np.arange(f.root.shape[1])
        covariance -= f.V @ f.V.conj().swapaxes(1, 2)
        covariance[:, j, j] += f.root**2
    return Posterior(gain, gain @ f.lines.b, covariance, np.sum(told, axis=1))


def identifiable(f: Factored) -> Identifiable:
    """Judge every line."""
    seen = f.seen
    inverse = np.where(seen, 1 / np.where(seen, f.s, 1.0), 0.0)
    size = np.abs(f.V) ** 2
    spread = np.sqrt(np.einsum("kjr,kr->kj", size, inverse**2))
    # a load that reaches into a direction that the line does not see is not determined
    inside = np.einsum("kjr,kr->kj", size, seen.astype(float))
    told = (inside > (1 - 1e-9) * f.root**2) & (spread > 0)
    full = seen.all(axis=1) & (f.s.shape[1] == f.root.shape[1])
    return Identifiable(
        gain=np.where(told, 1 / np.where(told, spread, 1.0), 0.0),
        naive=f.V @ (inverse[..., None] * f.beta),
        condition=np.where(full, f.s[:, 0] / np.where(full, f.s[:, -1], 1.0), np.inf),
    )
