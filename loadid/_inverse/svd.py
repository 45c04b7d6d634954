"""Dense path: singular value decomposition, and the generalised one by scaled QR for any penalty."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from structures._advice import Advice, Option
from structures._threads import threads_for
from structures.errors import InputError, NotIdentifiable

from . import Array
from .path import FactoredPath, Solution
from .posterior import DensePosterior
from .problem import LinearProblem
from .sweep import periodogram

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Factors:
    """Modes of a pair: ``H X = U diag(c)``, ``|L X e_i| = s_i``, ``X^-1 = Y^T``.

    Parameters
    ----------
    U : array, shape (m, min(m, n))
    c, s : array, shape (n,)
    X, Y : array, shape (n, n)
        Modes of the load, and their dual: ``Y.T @ X`` is the identity.
    meeting : float
        Smallest singular value of ``[H / |H|; L / |L|]``: zero where the null spaces of H and L meet.
    balance : float
        ``|H| / |L|``: the absolute lambda at which the two terms weigh the same.
    """

    U: Array
    c: Array
    s: Array
    X: Array
    Y: Array
    meeting: float
    balance: float


def plain(H: Array) -> Factors:
    """Ordinary SVD, L = I."""
    U, c, Wt = svd(H)
    n = H.shape[1]
    return Factors(U, pad(c, n), np.ones(n), Wt.T, Wt.T, 1.0, float(c[0]))


def paired(H: Array, L: Array, labels: Sequence[str] | None = None) -> Factors:
    """Modes of (H, L) from the QR of ``[H; alpha L]`` and the SVD of its upper block.

    The sines come from the lower block, not from sqrt(1 - c^2), which loses every digit where c is near 1; the scaling
    alpha = |H| / |L| keeps the digits of the smaller block. Hansen (1998), sec. 2.1.

    Raises
    ------
    InputError
        If the penalty is zero.
    NotIdentifiable
        If the null spaces meet (LID-E306); the message names the loads.
    """
    with threads_for(H.shape[1]):
        return _paired(H, L, labels)


def _paired(H: Array, L: Array, labels: Sequence[str] | None) -> Factors:
    import scipy.linalg

    m, n = H.shape
    if not np.any(L):
        raise InputError("the penalty matrix is zero", where="penalty", expected="a matrix that penalises something")
    weights = L.diagonal()
    if L.shape == (n, n) and np.all(weights != 0) and np.count_nonzero(L) == n:
        return weighted(H, weights)
    size = norm2(H) or 1.0
    alpha = size / norm2(L)
    stack = np.empty((m + len(L), n), order="F")
    stack[:m], stack[m:] = H, L
    stack[m:] *= alpha
    Q, R = scipy.linalg.qr(stack, mode="economic", overwrite_a=True, check_finite=False)
    upper, lower = np.asfortranarray(Q[:m]), Q[m:].copy()
    del stack, Q
    meeting = _smallest(R, n, labels) / size
    U, c, Wt = svd(upper, overwrite=True)
    W = Wt.T
    s = np.linalg.norm(lower @ W, axis=0) / alpha
    return Factors(U, pad(c, n), s, scipy.linalg.solve_triangular(R, W), R.T @ W, meeting, alpha)


def weighted(H: Array, weights: Array) -> Factors:
    """Modes of (H, diag(weights)): the SVD of H diag(1 / weights), no more than without a penalty."""
    U, c, Wt = svd(H / weights)
    n, W = H.shape[1], Wt.T
    balance = norm2(H) / float(np.abs(weights).max())
    least = float(np.abs(weights).min() / np.abs(weights).max())
    return Factors(U, pad(c, n), np.ones(n), W / weights[:, None], W * weights[:, None], least, balance)


def augmented(H: Array, L: Array, y: Array, x: float) -> Array:
    """Tikhonov solution (n,) or (n, frames) at the absolute lambda `x`, by Householder QR of ``[x L; H]``.

    The most accurate way at one small lambda: an SVD rotates the rounding of the data into the weak modes.
    """
    import scipy.linalg

    n, rows = H.shape[1], len(L)
    data = y.reshape(len(y), -1)
    stack = np.zeros((rows + len(H), n + data.shape[1]), order="F")
    stack[:rows, :n], stack[rows:, :n], stack[rows:, n:] = L, H, data
    stack[:rows, :n] *= x
    R = scipy.linalg.qr(stack, mode="r", overwrite_a=True, check_finite=False)[0]
    return np.asarray(scipy.linalg.solve_triangular(R[:n, :n], R[:n, n:]).reshape(n, *y.shape[1:]))


def svd(A: Array, overwrite: bool = False) -> tuple[Array, Array, Array]:
    """SVD by divide and conquer, with all right vectors: U (m, r), c (r,), Wt (n, n)."""
    import scipy.linalg

    m, n = A.shape
    with threads_for(max(m, n)):
        U, c, Wt = scipy.linalg.svd(A, full_matrices=m < n, overwrite_a=overwrite, check_finite=False)
    return U[:, : len(c)], c, Wt


def pad(x: Array, n: int) -> Array:
    """`x` with zeros up to length `n` on its first axis."""
    return x if len(x) >= n else np.concatenate([x, np.zeros((n - len(x), *x.shape[1:]), x.dtype)])


def norm2(A: Array) -> float:
    """Spectral norm, to a few per cent, from power iterations."""
    top = float(np.abs(A).max(initial=0.0))
    x: Array = np.random.default_rng(0).standard_normal((A.shape[1],))
    size = 0.0
    for _ in range(30 if top > 0 else 0):
        x = x / np.linalg.norm(x)
        y = A @ x / top  # squares stay within the range of numbers
        size = float(np.linalg.norm(y))
        x = A.T @ y / top
        if not np.any(x):
            break
    return size * top


def _smallest(R: Array, n: int, labels: Sequence[str] | None) -> float:
    """Smallest singular value of the triangle; refuses where it is rounding."""
    if len(R) == n:
        diagonal = np.abs(np.diag(R))
        value = _inverse_iteration(R) if diagonal.min() > n * EPS * diagonal.max() else 0.0
        if value > 100 * n * EPS * diagonal.max():
            return value
    vectors_t, values = np.linalg.svd(R)[2], np.zeros(n)
    values[: len(R)] = np.linalg.svdvals(R)
    unseen = values <= n * EPS * values[0]
    if np.any(unseen):
        count = int(np.sum(unseen))
        loads = "one load pattern is" if count == 1 else f"{count} load patterns are"
        raise NotIdentifiable(
            f"{loads} seen neither by the sensors nor by the penalty (relative singular value "
            f"{values[-1] / values[0]:.2g}): {names(vectors_t[unseen].T, labels)}",
            advice=Advice(
                "add a sensor that sees it, or use ",
                Option("penalty", "identity"),
                " (with a resultant as a constraint, if known)",
            ),
            code="LID-E306",
        )
    return float(values[-1])


def _inverse_iteration(R: Array) -> float:
    """Smallest singular value of a regular triangle, from above: the cost is a few triangular solves."""
    from scipy.linalg import solve_triangular

    x = np.linalg.qr(np.random.default_rng(0).standard_normal((len(R), min(4, len(R)))))[0]
    growth = 0.0
    for _ in range(8):
        z = solve_triangular(R, x, trans="T", check_finite=False)
        growth = float(np.linalg.norm(z, 2))
        x = solve_triangular(R, z / growth, check_finite=False)
        x = np.linalg.qr(x)[0]
    return 1 / growth


def names(directions: Array, labels: Sequence[str] | None = None) -> str:
    """Load patterns in words: constant, linear in the order of the loads, or the loads with the largest entries.

    Parameters
    ----------
    directions : array, shape (n, k)
        Orthonormal patterns.
    labels : sequence of str, optional
        Names of the loads; default their numbers.
    """
    n = len(directions)
    plain = np.linalg.qr(np.vander(np.linspace(-1, 1, n), 2, increasing=True))[0] if n > 1 else np.ones((1, 1))
    turn, shared, mix = np.linalg.svd(directions.T @ plain)
    inside = int(np.sum(shared > 1 - 1e-6))  # patterns that are a constant plus a slope
    rest, found = directions @ turn[:, inside:], []
    if inside == 2 or (inside == 1 and abs(mix[0, 0]) > 1 - 1e-6):
        found.append("constant over all loads")
    if inside == 2 or (inside == 1 and not found):
        found.append("linear in the order of the loads")
    if rest.shape[1]:
        size = np.linalg.norm(rest, axis=1)
        largest = [k for k in np.argsort(-size, kind="stable")[:5] if size[k] > 0.01 * size.max()]
        who = [str(k) if labels is None else labels[k] for k in largest]
        found.append(f"largest at {'unknowns' if labels is None else 'loads'} [{', '.join(who)}]")
    return "; ".join(found)


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
                expected="real operator and data", hint="FrequencyInversion takes complex lines",
            )  # fmt: skip
        parts = plain(H) if L is None else paired(H, L, labels)
        self.U, self.X, self.Y, self.meeting = parts.U, parts.X, parts.Y, parts.meeting
        self.singular_values = parts.c[: min(m, n)] if L is None else np.linalg.svdvals(H)
        self._cosines = np.where(parts.c > max(m, n) * EPS * parts.c.max(), parts.c, 0.0)  # sums run over the rank
        self._sines = parts.s
        self._kernel = 0 if L is None else int(np.sum(parts.s <= 1e-10 * parts.s.max(initial=0.0)))
        self._orthonormal, self._balance = L is None, parts.balance
        self._lengths: Array | None = None
        self._take(problem, truncated)

    def _take(self, problem: LinearProblem, truncated: bool) -> None:
        """Coefficients of the data of a problem with this operator."""
        self.problem = problem
        self._coupling: Array | None = None
        y, (m, n) = problem.y, problem.H.shape
        frames = problem.frames or 1
        beta = self.U.T @ y
        outside = float(np.sum((y - self.U @ beta) ** 2))
        self._data = pad(beta, n)
        # with fewer data than unknowns the other modes meet no data at all
        weight = frames * (np.arange(n) < m).astype(float)
        level = self._data if problem.frames is None else np.sqrt(np.mean(self._data**2, axis=1))
        super().__init__(
            self._cosines, self._sines, level, outside, (m - problem.spent) * frames,
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

    @property
    def orthonormal(self) -> bool:
        """Whether the modes are loads of unit length, at right angles."""
        return self._orthonormal

    @property
    def unconstrained(self) -> SVDPath:
        """The path itself: it has no constraints."""
        return self

    # -- what an operator does at one lambda --------------------------------------------------------------------------
    @property
    def rank(self) -> int:
        """Numerical rank of the whitened operator."""
        tol = max(self.problem.H.shape) * EPS
        return int(np.sum(self.singular_values > tol * self.singular_values.max()))

    @property
    def null_space(self) -> Array:
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

    def filter_factors(self, lam: float) -> Array:
        """Share of each mode that comes from the data, shape (n,), in the order of the columns of `X`."""
        return np.asarray(self._filter(np.array([lam]))[0][0])

    def inverse(self, lam: float) -> Array:
        """Regularised inverse of the whitened operator, (n, m): one product takes whitened data to the load."""
        r = self.U.shape[1]
        return (self.X[:, :r] * self._per_coefficient(lam)[:r]) @ self.U.T

    def resolution(self, lam: float) -> Array:
        """Resolution matrix R, (n, n): the estimate is R times the load, but for noise."""
        return (self.X * self.filter_factors(lam)) @ self.Y.T

    def resolve(self, load: Array, lam: float) -> Array:
        """What would be estimated from the noise-free response of `load`: R g; frames stand in front."""
        g = load.reshape(-1, self.problem.H.shape[1]).T
        return (self.X @ (self.filter_factors(lam)[:, None] * (self.Y.T @ g))).T.reshape(load.shape)

    # -- the answer ---------------------------------------------------------------------------------------------------
    def gains(self, lam: ArrayLike) -> Array:
        """Mode coefficients f / c * beta of the solution, shape (n,) or (n, frames)."""
        per = self._per_coefficient(float(np.asarray(lam)))
        return per * self._data if self._data.ndim == 1 else per[:, None] * self._data

    def _per_coefficient(self, lam: float) -> Array:
        """Gain f / c of each mode, zero beyond the rank."""
        return np.divide(self.filter_factors(lam), self.c, out=np.zeros(self.c.shape), where=self.c > 0)

    def residual(self, lam: float) -> Array:
        """Whitened residual y - H g, in the layout of the data."""
        rest = self.problem.y - self.problem.H @ (self.X @ self.gains(lam))
        return rest.T.reshape(self.problem.layout)

    def left_of(self, data: Array, lam: float) -> Array:
        """Residual of other whitened data (samples, sensors)."""
        y = self.problem.projected(np.asarray(data, float).reshape(-1))
        beta = self.U.T @ y
        return ((y - self.U @ beta) + self.U @ (self.rejected(np.array([lam]))[0, : len(beta)] * beta)).reshape(
            data.shape
        )

    def residuals(self, lams: Array) -> Iterable[Array]:
        """Whitened residuals (samples, sensors) at some lambdas, of one record by one product for a tile of them."""
        problem = self.problem
        if problem.y.ndim > 1:
            yield from (self.residual(float(lam)) for lam in lams)
            return
        r, samples = self.U.shape[1], problem.layout[0]
        beta = np.asarray(self.beta)[:r]
        outside = problem.y - self.U @ beta
        width = max(1, TILE // len(problem.y))
        for k in range(0, len(lams), width):
            rest = (self.rejected(lams[k : k + width])[:, :r] * beta) @ self.U.T + outside
            yield from rest.reshape(len(rest), samples, -1)

    def white_residual(self, lam: float) -> Array | None:
        """Expected periodogram (lines,) of the residual of unit white noise; None for frames, or few samples."""
        y, samples = self.problem.y, self.problem.layout[0]
        if y.ndim > 1 or samples < 4:
            return None
        taken = 1 - self.rejected(np.array([lam]))[0, : self.U.shape[1]] ** 2
        return np.maximum(samples * (len(y) // samples) - self.mode_lines @ taken, 0.0)

    @cached_property
    def mode_lines(self) -> Array:
        """Periodogram of each left vector, (lines, modes): made once for a factorisation and its copies."""
        U, samples = self.U, self.problem.layout[0]
        return np.concatenate([periodogram(U[:, k : k + 64].reshape(samples, -1, U[:, k : k + 64].shape[1]))
                               for k in range(0, U.shape[1], 64)], axis=1)  # fmt: skip

    def solution(self, lam: float, sigma: float | None) -> Solution:
        """Load, (n,) or (frames, n), and with the noise level `sigma` of the whitened data its posterior."""
        load = self._load(float(lam)).T.reshape(self.problem.load_shape)
        return Solution(load, None if sigma is None else self._posterior(lam, sigma))

    def sample(self, lam: float, sigma: ArrayLike, draws: int = 200, *, seed: int = 0) -> Array:
        """Loads drawn from the Gaussian posterior at one lambda, (draws,) + the shape of the load.

        `sigma` is the noise level of the whitened data, one for all or one for each draw.
        """
        known, rng = self._posterior(lam, 1.0), np.random.default_rng(seed)
        lead = () if self.problem.frames is None else (self.problem.frames,)
        unit = rng.standard_normal((draws, *lead, known.factor.shape[1])) @ known.factor.T
        level = np.broadcast_to(np.asarray(sigma, float), draws)
        load = self._load(float(lam)).T
        return np.asarray((load + level.reshape(-1, *[1] * load.ndim) * unit).reshape(draws, *self.problem.load_shape))

    def _load(self, lam: float) -> Array:
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
    def _lengths2(self) -> Array | float:
        if self._orthonormal:
            return 1.0
        if self._lengths is None:
            self._lengths = np.sum(self.X**2, axis=0)
        return self._lengths

    def _length2(self, factors: Array, part: slice) -> Array:
        if self._orthonormal:
            return super()._length2(factors, part)
        if self._data.ndim == 1:
            per = np.divide(self.beta, self.c, out=np.zeros(self.c.shape), where=self.c > 0)
            return np.asarray(np.sum(((factors * per) @ self.X.T) ** 2, axis=-1))
        if self._coupling is None:  # lengths of sums of modes, over all frames: nothing is solved with it
            per = np.divide(self._data, self.c[:, None], out=np.zeros(self._data.shape), where=self.c[:, None] > 0)
            self._coupling = np.einsum("ki,kj->ij", self.X, self.X, optimize=True) * (per @ per.T)
        return np.asarray(np.maximum(np.sum((factors @ self._coupling) * factors, axis=-1), 0.0))
