"""Dense path: singular value decomposition, and the generalised one by scaled QR for any penalty."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from .gsvd import EPS, augmented, pad, paired, plain
from .path import FactoredPath, Solution
from .posterior import DensePosterior
from .problem import LinearProblem
from .whiteness import periodogram

TILE = 2_000_000  # numbers of residuals that are held at once
WEAK = (1e-11, 1e-4)  # lambda over |H| / |L| between which one solution is worth a QR of its own


class SVDPath(FactoredPath):
    """Path of a dense problem of up to a few thousand unknowns: every lambda after one factorisation.

    L = I: ordinary SVD. Any other L: QR of ``[H; alpha L]``, SVD of its upper block, sines from its lower block; the
    normal equations are never formed. Hansen (1998), ch. 2. Frames of data share one lambda: every scalar is the sum
    over the frames, `m` and `null` count all of them, and the data coefficients are root mean squares.

    Parameters
    ----------
    problem : LinearProblem
    truncated : bool
        Truncated (generalised) SVD in place of Tikhonov: modes with a generalised singular value below lambda are cut.
    labels : sequence of str, optional
        Names of the loads, for messages.

    Attributes
    ----------
    U : array, shape (m, min(m, n))
        Left singular vectors.
    X, Y : array, shape (n, n)
        Modes of the load and their dual, ``Y.T @ X`` = identity. `filter_factors` has the order of their columns.
    meeting : float
        Smallest singular value of ``[H / |H|; L / |L|]``; below sqrt(eps) the null spaces of H and L nearly meet.
    singular_values : array, shape (min(m, n),)
        Of the whitened operator.

    Raises
    ------
    NotIdentifiable
        If a load is seen neither by the sensors nor by the penalty (LID-E306).
    """

    def __init__(self, problem: LinearProblem, *, truncated: bool = False, labels: Sequence[str] | None = None) -> None:
        H, L = problem.H, problem.L
        m, n = H.shape
        if np.iscomplexobj(H) or np.iscomplexobj(problem.y):
            raise InputError(
                "the dense path takes real problems", where="inverse problem", found="complex numbers",
                expected="real operator and data", hint="loadid.inverse.spectral takes complex lines",
            )  # fmt: skip
        parts = plain(H) if L is None else paired(H, L, labels)
        self.U, self.X, self.Y, self.meeting = parts.U, parts.X, parts.Y, parts.meeting
        self.singular_values = parts.c[: min(m, n)] if L is None else np.linalg.svdvals(H)
        self._cosines = np.where(parts.c > max(m, n) * EPS * parts.c.max(), parts.c, 0.0)  # sums run over the rank
        self._sines = parts.s
        self._kernel = 0 if L is None else int(np.sum(parts.s <= 1e-10 * parts.s.max(initial=0.0)))
        self._orthonormal, self._balance = L is None, parts.balance
        self._lengths: NDArray | None = None
        self._take(problem, truncated)

    def _take(self, problem: LinearProblem, truncated: bool) -> None:
        """Coefficients of the data of a problem with this operator."""
        self.problem, self._coupling = problem, None
        y, (m, n) = problem.y, problem.H.shape
        frames = problem.frames or 1
        beta = self.U.T @ y
        outside = float(np.sum((y - self.U @ beta) ** 2))
        self._data = pad(beta, n)
        # with fewer data than unknowns the other modes meet no data at all
        weight = frames * (np.arange(n) < m).astype(float)
        level = self._data if problem.frames is None else np.sqrt(np.mean(self._data**2, axis=1))
        super().__init__(
            self._cosines, self._sines, level, outside, m * frames,
            weight=weight, null=self._kernel * frames, truncated=truncated,
        )  # fmt: skip

    def with_data(self, y: ArrayLike) -> SVDPath:
        """The same factorisation with other whitened data, (m,) or (m, frames): costs two products.

        Raises
        ------
        InputError
            If the data do not fit or are not finite.
        """
        y, m = np.asarray(y, float), len(self.problem.H)
        if y.ndim not in (1, 2) or y.shape[0] != m or 0 in y.shape:
            raise InputError("the data do not fit the operator", where="data", found=f"shape {y.shape}",
                             expected=f"({m},) or ({m}, frames)")  # fmt: skip
        if not np.all(np.isfinite(y)):
            raise InputError("NaN or inf in the data", where="data", expected="finite numbers",
                             hint="leave out or repair the samples")  # fmt: skip
        inner = self.problem.layout if self.problem.frames is None else self.problem.layout[1:]
        layout = inner if y.ndim == 1 else (y.shape[1], *inner)
        other = copy(self)
        other._take(replace(self.problem, y=y, layout=layout), not self.smooth)
        return other

    # -- what an operator does at one lambda --------------------------------------------------------------------------
    @property
    def rank(self) -> int:
        """Numerical rank of the whitened operator."""
        tol = max(self.problem.H.shape) * EPS
        return int(np.sum(self.singular_values > tol * self.singular_values.max()))

    @property
    def null_space(self) -> NDArray[np.float64]:
        """Orthonormal loads that no sensor sees, shape (n, n - rank)."""
        unseen = self.X[:, self.c == 0]
        return unseen if self._orthonormal else np.linalg.qr(unseen)[0]

    def null_share(self, load: ArrayLike) -> float:
        """Share of a candidate load that lies in ker(H), by its norm: 0 all is seen, 1 nothing is."""
        g = np.asarray(load, float).reshape(-1, self.problem.H.shape[1]).T
        size = float(np.linalg.norm(g))
        return float(np.linalg.norm(self.null_space.T @ g)) / size if size > 0 else 0.0

    def seen_share(self, load: ArrayLike) -> float:
        """Share of a candidate load, by its norm, at right angles to ker(H): ``sqrt(1 - null_share^2)``."""
        g = np.asarray(load, float).reshape(-1, self.problem.H.shape[1]).T
        size = float(np.linalg.norm(g))
        N = self.null_space
        return float(np.linalg.norm(g - N @ (N.T @ g))) / size if size > 0 else 0.0

    def filter_factors(self, lam: float) -> NDArray[np.float64]:
        """Share of each mode that comes from the data, shape (n,), in the order of the columns of `X`."""
        return self._filter(np.array([lam]))[0][0]

    def inverse(self, lam: float) -> NDArray[np.float64]:
        """Regularised inverse of the whitened operator, (n, m): one product takes whitened data to the load."""
        r = self.U.shape[1]
        return (self.X[:, :r] * self._per_coefficient(lam)[:r]) @ self.U.T

    def resolution(self, lam: float) -> NDArray[np.float64]:
        """Resolution matrix R, (n, n): the estimate is R times the load, but for noise."""
        return (self.X * self.filter_factors(lam)) @ self.Y.T

    def resolve(self, load: NDArray, lam: float) -> NDArray[np.float64]:
        """What would be estimated from the noise-free response of `load`: R g; frames stand in front."""
        g = load.reshape(-1, self.problem.H.shape[1]).T
        return (self.X @ (self.filter_factors(lam)[:, None] * (self.Y.T @ g))).T.reshape(load.shape)

    # -- the answer ---------------------------------------------------------------------------------------------------
    def gains(self, lam: ArrayLike) -> NDArray:
        """Mode coefficients f / c * beta of the solution, shape (n,) or (n, frames)."""
        per = self._per_coefficient(float(np.asarray(lam)))
        return per * self._data if self._data.ndim == 1 else per[:, None] * self._data

    def _per_coefficient(self, lam: float) -> NDArray[np.float64]:
        """Gain f / c of each mode, zero beyond the rank."""
        return np.divide(self.filter_factors(lam), self.c, out=np.zeros(self.c.shape), where=self.c > 0)

    def residual(self, lam: float) -> NDArray[np.float64]:
        """Whitened residual y - H g, in the layout of the data."""
        rest = self.problem.y - self.problem.H @ (self.X @ self.gains(lam))
        return rest.T.reshape(self.problem.layout)

    def residuals(self, lams: NDArray) -> Iterable[NDArray[np.float64]]:
        """Whitened residuals (samples, sensors) at some lambdas, of one record by one product for a tile of them."""
        problem = self.problem
        if problem.y.ndim > 1:
            yield from super().residuals(lams)
            return
        r, samples = self.U.shape[1], problem.layout[0]
        beta = np.asarray(self.beta)[:r]
        outside = problem.y - self.U @ beta
        width = max(1, TILE // len(problem.y))
        for k in range(0, len(lams), width):
            rest = (self.rejected(lams[k : k + width])[:, :r] * beta) @ self.U.T + outside
            yield from rest.reshape(len(rest), samples, -1)

    def white_residual(self, lam: float) -> NDArray[np.float64] | None:
        """Expected periodogram (lines,) of the residual of unit white noise; None for frames, or few samples."""
        y, samples = self.problem.y, self.problem.layout[0]
        if y.ndim > 1 or samples < 4:
            return None
        taken = 1 - self.rejected(np.array([lam]))[0, : self.U.shape[1]] ** 2
        return np.maximum(samples * (len(y) // samples) - self.mode_lines @ taken, 0.0)

    @cached_property
    def mode_lines(self) -> NDArray[np.float64]:
        """Periodogram of each left vector, (lines, modes): made once for a factorisation and its copies."""
        U, samples = self.U, self.problem.layout[0]
        return np.concatenate([periodogram(U[:, k : k + 64].reshape(samples, -1, U[:, k : k + 64].shape[1]))
                               for k in range(0, U.shape[1], 64)], axis=1)  # fmt: skip

    def solution(self, lam: float, sigma: float | None) -> Solution:
        """Load, (n,) or (frames, n), and with the noise level `sigma` of the whitened data its posterior."""
        load = self._load(float(lam)).T.reshape(self.problem.load_shape)
        return Solution(load, None if sigma is None else self._posterior(lam, sigma))

    def _load(self, lam: float) -> NDArray[np.float64]:
        """Load (n,) or (n, frames): from the modes, or at a very small lambda from a QR, which keeps more digits."""
        x, L = lam * float(self.scale), self.problem.L
        if L is not None and self.smooth and WEAK[0] < x / self._balance < WEAK[1]:
            return augmented(self.problem.H, L, self.problem.y, x)
        return self.X @ self.gains(lam)

    def _posterior(self, lam: float, sigma: float) -> DensePosterior:
        if not (np.isfinite(sigma) and sigma >= 0):
            raise InputError("no noise level", where="sigma", found=sigma, expected="a finite number >= 0")
        f, shape, frames = self.filter_factors(lam), self.problem.shape, self.problem.frames
        if sigma == 0:  # no spread, and no shares of it
            return DensePosterior(np.zeros((len(f), 1)), shape, frames=frames)
        if self.smooth:
            d = self.c**2 + (lam * float(self.scale) * self.s) ** 2
            spread = np.divide(sigma, np.sqrt(d), out=np.zeros(d.shape), where=d > 0)
        else:  # a hard cut-off has no prior: the noise of the kept modes only
            spread = np.where(f > 0, self._per_coefficient(lam) * sigma, 0.0)
        keep = slice(None) if np.all(spread > 0) else spread > 0
        X, f, spread = self.X[:, keep], f[keep], spread[keep]
        dual = None if self._orthonormal or X.shape[1] == len(X) else self.Y[:, keep] / spread
        return DensePosterior(X * spread, shape, passed=f, dual=dual, orthogonal=self._orthonormal, frames=frames)

    # -- what the sums over modes need where the modes are not at right angles ----------------------------------------
    def _lengths2(self) -> NDArray | float:
        if self._orthonormal:
            return 1.0
        if self._lengths is None:
            self._lengths = np.sum(self.X**2, axis=0)
        return self._lengths

    def _length2(self, factors: NDArray, part: slice) -> NDArray:
        if self._orthonormal:
            return super()._length2(factors, part)
        if self._data.ndim == 1:
            per = np.divide(self.beta, self.c, out=np.zeros(self.c.shape), where=self.c > 0)
            return np.sum(((factors * per) @ self.X.T) ** 2, axis=-1)
        if self._coupling is None:  # lengths of sums of modes, over all frames: nothing is solved with it
            per = np.divide(self._data, self.c[:, None], out=np.zeros(self._data.shape), where=self.c[:, None] > 0)
            self._coupling = np.einsum("ki,kj->ij", self.X, self.X, optimize=True) * (per @ per.T)
        return np.maximum(np.sum((factors @ self._coupling) * factors, axis=-1), 0.0)
