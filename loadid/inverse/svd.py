"""Dense path: singular value decomposition, and the generalised one by scaled QR for any penalty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable

from .path import FactoredPath, Solution
from .posterior import DensePosterior
from .problem import LinearProblem


class SVDPath(FactoredPath):
    """Path of a dense problem of up to a few thousand unknowns: every lambda after one factorisation.

    L = I: ordinary SVD. Any other L: QR of ``[H; alpha L]``, SVD of its upper block, sines from its lower block; the
    normal equations are never formed. Hansen (1998), ch. 2; the scaling alpha keeps the digits of the smaller block.

    Parameters
    ----------
    problem : LinearProblem
    truncated : bool
        Truncated SVD in place of Tikhonov.

    Raises
    ------
    NotIdentifiable
        If a load is seen neither by the sensors nor by the penalty (LID-E306).
    """

    def __init__(self, problem: LinearProblem, *, truncated: bool = False) -> None:
        self.problem = problem
        H, y, L = problem.H, problem.y, problem.L
        m, n = H.shape
        if np.iscomplexobj(H) or np.iscomplexobj(y):
            raise InputError(
                "the dense path takes real problems", where="inverse problem", found="complex numbers",
                expected="real operator and data", hint="StackedPath takes complex lines",
            )  # fmt: skip
        if L is None:
            U, c, W = _svd(H)
            c, W = _pad(c, n), W.T
            s, self.X, null = np.ones(n), W, 0
        else:
            U, c, s, self.X = _gsvd(H, L)
            null = int(np.sum(s <= 1e-10 * s.max(initial=0.0)))
        beta = _pad(U.T @ y, n)
        outside = float(np.sum((y - U @ (U.T @ y)) ** 2))
        self.singular_values = np.linalg.svdvals(H) if L is not None else c[: min(m, n)]
        c = np.where(c > max(m, n) * np.finfo(float).eps * c.max(), c, 0.0)  # sums run over the rank, never over n
        weight = (np.arange(n) < m).astype(float)  # with fewer data than unknowns the other modes meet no data at all
        super().__init__(c, s, beta, outside, m, weight=weight, null=null, truncated=truncated)
        self._orthonormal = L is None

    @property
    def rank(self) -> int:
        """Numerical rank of the whitened operator."""
        tol = max(self.problem.H.shape) * np.finfo(float).eps
        return int(np.sum(self.singular_values > tol * self.singular_values.max()))

    def residual(self, lam: float) -> NDArray[np.float64]:
        """Whitened residual y - H g, in the layout of the data."""
        g = self.X @ self.gains(lam)
        return (self.problem.y - self.problem.H @ g).reshape(self.problem.layout)

    def solution(self, lam: float, sigma: float | None) -> Solution:
        """Load and, with the noise level `sigma` of the whitened data, its posterior."""
        load = (self.X @ self.gains(lam)).reshape(self.problem.shape)
        if sigma is None:
            return Solution(load, None)
        if self.smooth:
            x = lam * float(self.scale)
            d = self.c**2 + (x * self.s) ** 2
            factor = self.X * np.where(d > 0, sigma / np.sqrt(np.where(d > 0, d, 1.0)), 0.0)
        else:  # a hard cut-off has no prior: the noise of the kept modes only
            f, _ = self._filter(np.array([lam]))
            keep = f[0] > 0
            factor = self.X[:, keep] * (sigma / self.c[keep])
        return Solution(load, DensePosterior(factor, self.problem.shape))

    def resolve(self, load: NDArray, lam: float) -> NDArray[np.float64]:
        """What would be estimated from the noise-free response of `load`: R g with the resolution matrix R."""
        f, _ = self._filter(np.array([lam]))
        g = load.reshape(-1)
        modal = self.X.T @ g if self._orthonormal else np.linalg.solve(self.X, g)
        return (self.X @ (f[0] * modal)).reshape(load.shape)

    def _lengths2(self) -> NDArray | float:
        return 1.0 if self._orthonormal else np.sum(self.X**2, axis=0)

    def _length2(self, factors: NDArray, part: slice) -> NDArray:
        if self._orthonormal:
            return super()._length2(factors, part)
        per = np.divide(self.beta, self.c, out=np.zeros(self.c.shape), where=self.c > 0)
        return np.sum(((factors * per) @ self.X.T) ** 2, axis=-1)


def _svd(H: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """SVD with all right vectors: U (m, r), c (r,), Wt (n, n)."""
    import scipy.linalg

    m, n = H.shape
    U, c, Wt = scipy.linalg.svd(H, full_matrices=m < n)
    return U[:, : len(c)], c, Wt


def _gsvd(H: NDArray, L: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """U, cosines, sines and X of the pair (H, L): H = U diag(c) X^-1, |L X e_i| = s_i."""
    import scipy.linalg

    m, n = H.shape
    if not np.any(L):
        raise InputError("the penalty matrix is zero", where="penalty", expected="a matrix that penalises something")
    alpha = np.linalg.norm(H) / np.linalg.norm(L)
    Q, R = scipy.linalg.qr(np.vstack([H, alpha * L]), mode="economic")
    _refuse_common_null_space(R, n)
    U, c, Wt = _svd(Q[:m])
    W = Wt.T
    s = np.linalg.norm(Q[m:] @ W, axis=0) / alpha  # not sqrt(1 - c^2): that loses every digit where c is near 1
    return U, _pad(c, n), s, scipy.linalg.solve_triangular(R, W)


def _refuse_common_null_space(R: NDArray, n: int) -> None:
    sigma, direction = None, None
    if R.shape[0] < n:
        direction, sigma = np.linalg.svd(R)[2][-1], 0.0
    else:
        values, vectors = np.linalg.svd(R)[1:]
        if values[-1] <= n * np.finfo(float).eps * values[0]:
            direction, sigma = vectors[-1], values[-1] / values[0]
    if direction is not None:
        largest = np.argsort(-np.abs(direction))[:5]
        shape = (
            "constant"
            if np.ptp(direction) < 1e-6 * np.abs(direction).max()
            else f"largest at unknowns {largest.tolist()}"
        )
        raise NotIdentifiable(
            f"a load is seen neither by the sensors nor by the penalty (relative singular value {sigma:.2g}): {shape}",
            advice="add a sensor that sees it, choose penalty='identity', or add a constraint",
            code="LID-E306",
        )


def _pad(x: NDArray, n: int) -> NDArray:
    return x if len(x) >= n else np.concatenate([x, np.zeros(n - len(x), x.dtype)])
