"""Tikhonov fits of histories at many candidate places, one dimensionless lambda; candidates that look alike.

A fit minimises ``|H g - y|^2 + sum_k lambda_k^2 |g_k|^2`` over the histories of one load or of several. What it leaves
of any data is the *remainder* ``[y - H g; -lambda g]``; its squared norm is the objective at its minimum.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..convolution import Convolution, PenalizedConvolution
from ..problem import toeplitz
from .pcg import Circulant, Sides, solve

T = TypeVar("T")
R = TypeVar("R")
Progress = Callable[[float, str], None]


def over(
    work: Callable[[T], R], items: Sequence[T], *, workers: int | None = None, progress: Progress | None = None,
    text: str,
) -> list[R]:  # fmt: skip
    """Results of `work` for every item, in their order.

    Parameters
    ----------
    work : callable
    items : sequence
    workers : int, optional
        Threads; default the number of processors.
    progress : callable, optional
        Called from this thread as ``progress(fraction, text)`` after each item. What it raises stops the work: nothing
        that has not begun is begun, and nothing is returned.
    text : str
    """
    tell = progress or (lambda fraction, text: None)
    if not items:
        return []
    threads = min(workers or os.cpu_count() or 1, len(items))
    if threads == 1:
        found = []
        for k, item in enumerate(items, 1):
            found.append(work(item))
            tell(k / len(items), text)
        return found
    with ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(work, item) for item in items]
        try:
            for k, done in enumerate(as_completed(futures), 1):
                done.result()
                tell(k / len(items), text)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
        return [future.result() for future in futures]


ALIKE = 1e-3  # relative difference of impulse responses, up to a factor, below which no data tell them apart


def difference(h: Array) -> Array:
    """Smallest relative difference ``min_c |h_i - c h_j| / |h_i|`` of the responses of each pair, (loads, loads).

    Parameters
    ----------
    h : array, shape (samples, sensors, loads)
        Whitened impulse responses. The load is free, hence its factor c, of either sign.
    """
    flat = h.reshape(-1, h.shape[2])
    unit = flat / np.linalg.norm(flat, axis=0)
    cosine = np.einsum("ki,kj->ij", unit, unit)
    return np.asarray(np.sqrt(np.maximum(1 - cosine**2, 0.0)))


def groups(h: Array, near: Mask | None = None) -> tuple[tuple[int, ...], ...]:
    """Groups of candidates at different places that leave the same data.

    Parameters
    ----------
    h : array, shape (samples, sensors, loads)
    near : array of bool, shape (loads, loads), optional
        Which candidates are neighbours: on a fine grid these are alike because they are one place, and such a patch
        alone is no group.
    """
    alike = difference(h) <= ALIKE
    together, apart = _components(alike), _components(alike if near is None else alike & near)
    found = []
    for label in np.unique(together):
        members = np.flatnonzero(together == label)
        if len(members) > 1 and (near is None or len(np.unique(apart[members])) > 1):
            found.append(tuple(int(i) for i in members))
    return tuple(found)


def _components(linked: Mask) -> Index:
    from scipy.sparse.csgraph import connected_components

    return np.asarray(connected_components(linked, directed=False)[1])


Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int_]
PRECISE, EXACT = 1e-9, 1e-8  # relative gradient at which conjugate gradients stop, and that of an exact fit
CAP = 3000  # their steps at most
NORM = 1e-4  # relative accuracy of the largest singular value of an operator


@dataclass(frozen=True)
class FittedHistory:
    """One fit of one set of data.

    Parameters
    ----------
    load : array, shape (samples, loads)
    residual : array, shape (samples, sensors)
    penalty : array
        lambda g of all loads in one vector.
    exact : bool
        Whether the solver came to its accuracy.
    """

    load: Array
    residual: Array
    penalty: Array
    exact: bool = True

    @property
    def residual2(self) -> float:
        """Squared norm of the residual."""
        return float(np.sum(self.residual**2))

    @property
    def remainder(self) -> Array:
        """Residual and penalty in one vector."""
        return np.concatenate([self.residual.ravel(), self.penalty])


class HistoryFit(Protocol):
    """A regularised operator that can be asked for any data."""

    lam: Array
    name: str

    @property
    def edf(self) -> float:
        """Effective degrees of freedom."""
        ...

    def solve(self, y: Array) -> FittedHistory:
        """Fit of data (samples, sensors)."""
        ...


class DenseFit:
    """Fit by SVD of the Toeplitz operator of one load; every set of data then costs three products.

    Parameters
    ----------
    h : array, shape (samples, sensors, 1)
        Whitened impulse responses.
    relative : float
        Lambda over the largest singular value of the operator.
    """

    name = "dense SVD"

    def __init__(self, h: Array, *, relative: float) -> None:
        self.U, self.s, self.V = np.linalg.svd(toeplitz(h).reshape(-1, len(h)), full_matrices=False)
        self.damping = relative * float(self.s[0])
        self.lam = np.array([self.damping])
        self.filter = self.s**2 / (self.s**2 + self.damping**2)

    @property
    def edf(self) -> float:
        """Effective degrees of freedom."""
        return float(np.sum(self.filter))

    def solve(self, y: Array) -> FittedHistory:
        """Fit of data (samples, sensors)."""
        beta = self.U.T @ y.reshape(-1)
        residual = y - (self.U @ (self.filter * beta)).reshape(y.shape)
        load = (self.s / (self.s**2 + self.damping**2) * beta) @ self.V
        return FittedHistory(load[:, None], residual, -self.damping * load)


class JointFit:
    """Fit of one load or several at given lambdas, by QR of ``[H; lambda I]``: what one place of a search costs.

    Parameters
    ----------
    h : array, shape (samples, sensors, loads)
        Whitened impulse responses.
    lam : array, shape (loads,)
        Absolute lambda of each load.
    """

    name = "dense QR"

    def __init__(self, h: Array, lam: Array) -> None:
        from scipy.linalg import qr

        H = toeplitz(h / lam)
        n = H.shape[2]
        stacked = np.concatenate([H.reshape(-1, n), np.eye(n)])
        Q = qr(stacked, mode="economic", overwrite_a=True, check_finite=False)[0]
        self.lam, self._upper, self._lower = lam, Q[:-n], Q[-n:]

    @property
    def edf(self) -> float:
        """Effective degrees of freedom."""
        return float(np.sum(self._upper**2))

    def solve(self, y: Array) -> FittedHistory:
        """Fit of data (samples, sensors)."""
        z = self._upper.T @ y.reshape(-1)
        scaled = self._lower @ z  # lambda g: the lower block is the inverse of R
        residual = y - (self._upper @ z).reshape(y.shape)
        return FittedHistory(scaled.reshape(len(y), -1) / self.lam, residual, -scaled)


class LongFit:
    """The same fit without a matrix, by FFT products and preconditioned conjugate gradients (`pcg`)."""

    name = "FFT and conjugate gradients"

    def __init__(self, h: Array, lam: Array | None = None, *, relative: float | None = None) -> None:
        if lam is None:
            lam = np.full(h.shape[2], (relative or 0.0) * norm(Convolution(h)))
        self.lam = lam
        self._circulant = Circulant(PenalizedConvolution(h / lam, len(h)), 1.0)

    @property
    def edf(self) -> float:
        """Effective degrees of freedom, estimated over the padded spectrum (an upper estimate)."""
        operator = self._circulant.operator
        sizes = np.linalg.svd(np.moveaxis(operator.spectrum, -1, 0), compute_uv=False) ** 2
        return float(operator.samples * np.mean(np.sum(sizes / (sizes + 1), axis=1)))

    def solve(self, y: Array) -> FittedHistory:
        """Fit of data (samples, sensors)."""
        operator, sides = self._circulant.operator, Sides(y=y.T[None])
        found = solve(operator, self._circulant, sides, PRECISE, CAP, strict=False, takeover=False)
        scaled = np.ascontiguousarray(found.x[0].T)
        return FittedHistory(scaled / self.lam, found.r[0].T, -scaled.ravel(), found.gradient <= EXACT)


def norm(operator: Convolution) -> float:
    """Largest singular value, by Lanczos steps with FFT products."""
    from scipy.sparse.linalg import svds

    start = np.random.default_rng(0).standard_normal(min(operator.shape))
    return float(svds(operator, k=1, tol=NORM, v0=start, return_singular_vectors=False)[0])
