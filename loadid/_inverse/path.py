"""The regularization-path contract, and the path of every problem that has been factorised into scalar modes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from structures._advice import Advice, Option
from structures.errors import InputError

from . import Array
from .posterior import Posterior

ALL = slice(None)
TILE = 32_768  # modes times lambdas that are worked on at once: some such arrays fit in the cache


@dataclass(frozen=True)
class PathPoint:
    """What a path says at some lambdas; every array has the shape of lambda. None: this path cannot give it.

    Parameters
    ----------
    residual2, penalty2 : array
        Squared norms of the whitened residual and of L g.
    edf, edf2 : array or None
        tr A and tr A^2 of the influence matrix A.
    left : array or None
        m - edf, formed without cancellation.
    rest2, rest4 : array or None
        tr (I - A)^2 and tr (I - A)^4: what noise of unit level leaves in the residual, and how that scatters.
    sensitivity : array or None
        Norm of lambda dg/dlambda.
    objective : array or None
        Residual plus lambda^2 penalty at its minimum (for the evidence).
    log_ratio : array or None
        Sum of ln(1 + gamma^2 / lambda^2) over the modes that the penalty sees (for the evidence).
    bend : array or None
        d penalty2 / d ln lambda (for the curvature of the L-curve).
    fitted2, log_supports : array or None
        Of a sparse path: squared residual of the least squares on the support, and ln of the number of supports of
        its size (for the information criterion).
    """

    residual2: Array
    penalty2: Array
    edf: Array | None = None
    edf2: Array | None = None
    left: Array | None = None
    rest2: Array | None = None
    rest4: Array | None = None
    sensitivity: Array | None = None
    objective: Array | None = None
    log_ratio: Array | None = None
    bend: Array | None = None
    fitted2: Array | None = None
    log_supports: Array | None = None


@dataclass(frozen=True)
class Coefficients:
    """Data coefficients |u_i^T y| and generalised singular values, for the Picard plot."""

    beta: Array
    gamma: Array


@dataclass(frozen=True)
class Solution:
    """Load coefficients at one lambda, and what is known of their error."""

    load: Array
    posterior: Posterior | None


class RegularizationPath:
    """What the choice rules, the diagnostics and the families ask of any solver.

    Every `lam` is relative: it is multiplied by `scale`, so that no answer depends on units. A stacked path carries its
    lines on the first axis. A solver sets `m`, `null` and `scale` and overrides `range`, `at`, `residual`, `solution`
    and `resolve`; what else it cannot give is None, and a rule that needs it refuses by name.

    Attributes
    ----------
    m : int
        Number of data.
    null : int
        Dimension of the null space of the penalty.
    scale : array
        Largest generalised singular value: a relative lambda times this is the absolute one.
    smooth : bool
        Whether the path is smooth in lambda (Tikhonov) or a staircase (truncation).
    zero_padded : bool
        Whether it takes the record as the beginning of one twice as long, in which the response has decayed.
    dear : bool
        Whether every lambda costs a solution of its own, so that a search ends near enough.
    reals : int
        Real numbers in one datum: 2 where the data are complex.
    margin : float or None
        Share of all noise whose residual the discrepancy rule lets pass; None: the mean of all noise.
    energy : array or None
        Squared norm of the whitened data; None where no path over a record or readings says it.
    """

    m: int
    null: int
    scale: Array
    smooth: bool = True
    zero_padded: bool = False
    dear: bool = False
    reals: int = 1
    margin: float | None = 0.95
    energy: Array | float | None = None

    @property
    def stacked(self) -> bool:
        """Whether it carries several lines on the first axis."""
        return np.ndim(self.scale) > 0

    @property
    def unconstrained(self) -> RegularizationPath:
        """The path of the loads without constraints; itself where it has none."""
        return self

    @property
    def range(self) -> tuple[float, float]:
        """Sensible interval of relative lambda."""
        raise self._lack("range of lambda")

    @property
    def coefficients(self) -> Coefficients | None:
        """Data coefficients where a factorisation exists."""
        return None

    @property
    def seen(self) -> float | None:
        """Smallest relative generalised singular value that counts, where no factorisation tells it."""
        return None

    def at(self, lam: ArrayLike) -> PathPoint:
        """Scalars of the path at `lam`."""
        raise self._lack("point at a lambda")

    def predicted_error(self, lam: ArrayLike, pilot: float, sigma: float) -> Array | None:
        """Squared load error expected at `lam` if the estimate at `pilot` were the load."""
        return None

    def residual(self, lam: float) -> Array:
        """Whitened residual (samples, sensors)."""
        raise self._lack("residual")

    def left_of(self, data: Array, lam: float) -> Array | None:
        """Residual of other whitened data (samples, sensors): K^-1 times them, K = 1 + H (lambda^2 L^T L)^-1 H^T."""
        return None

    def of_data(self, data: Array, lam: float) -> tuple[Array, Array]:
        """Residual (samples, sensors) and load (samples, loads) of other whitened data."""
        raise self._lack("estimate from other data")

    def start(self, lam: float) -> Array:
        """State at the first sample that is estimated."""
        raise self._lack("state at the first sample")

    def residuals(self, lams: Array) -> Iterable[Array] | None:
        """Whitened residuals (samples, sensors) at some lambdas, near enough to test whiteness; None: no record."""
        return (self.residual(float(lam)) for lam in lams)

    def white_residual(self, lam: float) -> Array | None:
        """Expected periodogram (lines,) of the residual if the data were unit white noise; None where not known."""
        return None

    def energies(self) -> tuple[Array, float] | None:
        """Energy of the data in each mode that meets some, the best seen mode first, and how many data sets share it.

        None where the modes are no real vectors, or not known.
        """
        return None

    def precompute(self, lam: float, progress: Callable[[float, str], None]) -> None:
        """Do at `lam` what takes long before `solution` is asked, and say how far it is; nothing where nothing does."""

    def bound(self, lam: float) -> float | None:
        """Largest norm of what `solution` at `lam` may differ by from the exact one; None where it is exact."""
        return None

    def level_within(self, lam: float, sigma: float) -> float:
        """Noise level of the data that tell the load: `sigma`, or more where those show more than the others."""
        return sigma

    def solution(self, lam: float, sigma: float | None) -> Solution:
        """Load coefficients and posterior at noise level `sigma` of the whitened data."""
        raise self._lack("solution")

    def resolve(self, load: Array, lam: float) -> Array:
        """What would be estimated from the noise-free response of `load`: the resolution matrix applied to it."""
        raise self._lack("resolution")

    def _lack(self, what: str) -> InputError:
        return InputError(f"{type(self).__name__} has no {what}", where="regularization path",
                          found=type(self).__name__, expected=f"a path that gives its {what}")  # fmt: skip


class FactoredPath(RegularizationPath):
    """Path of ``min |H g - y|^2 + lambda^2 |L g|^2`` split into modes ``(c_i, s_i)`` by a (generalised) SVD.

    Filter factors f = c^2 / (c^2 + lambda^2 s^2) and everything that follows from them; Hansen, Rank-Deficient and
    Discrete Ill-Posed Problems, SIAM 1998, ch. 2 and 4. The complement 1 - f is formed directly, never by subtraction.

    Parameters
    ----------
    c, s : array, shape (..., modes)
        Cosines and sines: gamma = c / s. Plain SVD: singular values and ones.
    beta : array, shape (..., modes)
        U^T y.
    outside : array, shape (...)
        Squared norm of the part of y outside the range of H.
    m : int
        Number of data (of one problem of a stack).
    weight : array, shape (modes,), optional
        How often a mode counts (conjugate lines of a spectrum count twice).
    null : int
        Dimension of the null space of L.
    truncated : bool
        Hard cut-off (truncated SVD) in place of Tikhonov's filter.
    """

    _orthonormal = True  # the modes are loads of unit length, at right angles

    def __init__(
        self,
        c: Array,
        s: Array,
        beta: Array,
        outside: Array | float,
        m: int,
        *,
        weight: Array | None = None,
        null: int = 0,
        truncated: bool = False,
    ) -> None:
        self.c, self.s, self.beta, self.outside = c, s, beta, np.asarray(outside, float)
        self.weight = np.ones(c.shape[-1]) if weight is None else weight
        self.m, self.null, self.smooth = m, null, not truncated
        seen = s > 1e-10 * s.max(initial=0.0)
        gamma = np.where(seen, c / np.where(seen, s, 1.0), 0.0)
        self.scale = np.asarray(gamma.max(axis=-1))
        if not all(np.all(np.isfinite(x)) for x in (c, s, beta)):
            raise InputError(
                "NaN or inf in the operator or the data", where="inverse problem", expected="no such number"
            )
        if np.all(self.scale <= 0) and c.max(initial=0.0) > 0:
            raise InputError("the sensors see only what the penalty leaves free: no lambda changes the load",
                             where="inverse problem",
                             found=f"{len(np.flatnonzero(c))} observed modes, none of them penalised",
                             expected="a sensor that sees more",
                             hint=Advice(Option("penalty", "identity"), ", or another sensor"))  # fmt: skip
        if np.all(self.scale <= 0):
            raise InputError("the forward model is zero: no load moves any sensor", where="inverse problem",
                             found="largest singular value 0", expected="a sensor that sees a load",
                             hint="check the sensors, the loads and the units")  # fmt: skip
        if not 1e-140 < c.max() < 1e140:  # squares of these would leave the range of double precision
            raise InputError("the forward model is beyond the range of numbers", where="inverse problem",
                             found=f"largest singular value {c.max():.2g}", expected="between 1e-140 and 1e140",
                             hint="check the units")  # fmt: skip
        self._gamma, self._seen, self._beta2 = gamma, seen, np.abs(beta) ** 2
        self.energy = np.sum(self.weight * self._beta2, axis=-1) + self.outside
        self._cost = np.divide(1.0, c**2, out=np.zeros(c.shape), where=c > 0)

    @property
    def coefficients(self) -> Coefficients:
        """Data coefficients and generalised singular values, largest first."""
        rank = np.argsort(-self._gamma, axis=-1)
        return Coefficients(np.take_along_axis(self.beta, rank, -1), np.take_along_axis(self._gamma, rank, -1))

    @property
    def range(self) -> tuple[float, float]:
        """Relative lambda from below the smallest generalised singular value that rounding leaves, up to 1."""
        floor = 10 * np.finfo(float).eps * np.sqrt(self.c.shape[-1])
        relative = self._gamma / np.where(self.scale > 0, self.scale, 1.0)[..., None]
        smallest = np.min(relative[relative > floor], initial=1.0)
        # well-conditioned problems must be able to choose next to no regularisation
        return float(max(floor, 1e-3 * smallest)), 1.0

    def _filter(self, lam: Array, part: slice = ALL) -> tuple[Array, Array]:
        """Filter factors and their complements, shape (..., lams, modes)."""
        c, s = self.c[..., None, part], self.s[..., None, part]
        x = self._absolute(lam)
        if not self.smooth:
            keep = (c > 0) & (c >= x * s * (1 - 1e-12))
            return keep.astype(float), (~keep).astype(float)
        c2, g = c**2, (x * s) ** 2
        d = c2 + g
        if d.all():
            return c2 / d, g / d
        safe = np.where(d > 0, d, 1.0)  # neither seen nor penalised (lambda 0): nothing is taken from the data
        return c2 / safe, np.where(d > 0, g / safe, 1.0)

    def at(self, lam: ArrayLike) -> PathPoint:
        """Scalars of the path at relative `lam`, shape (k,); for a stack (lines, k)."""
        lam = np.asarray(lam, float)
        sums = self._tiled(self._sums, np.atleast_1d(lam))
        residual2, penalty2, edf, edf2, *rest, objective, log_ratio, change2, bend = sums if lam.ndim else sums[..., 0]
        outside = self.outside[..., None] if lam.ndim else self.outside
        modes = np.sum(self.weight)
        beyond = (self.m - modes) * (self.m > modes * (1 + 1e-12))  # data that no mode reaches
        left, rest2, rest4 = (beyond + x for x in rest)
        if not self.smooth:
            return PathPoint(residual2 + outside, penalty2, edf, edf2, left, rest2, rest4)
        return PathPoint(
            residual2 + outside,
            penalty2,
            edf,
            edf2,
            left,
            rest2,
            rest4,
            sensitivity=2 * np.sqrt(change2),
            objective=objective + outside,
            log_ratio=log_ratio,
            bend=bend,
        )

    @property
    def gamma(self) -> Array:
        """Generalised singular values c / s in the order of the modes; infinite in the null space of the penalty."""
        return np.where(self._seen, self._gamma, np.where(self.c > 0, np.inf, 0.0))

    def rejected(self, lam: ArrayLike) -> Array:
        """Share 1 - f of each mode that the fit leaves in the residual, shape (lams, modes)."""
        return self._filter(np.asarray(lam, float))[1]

    def energies(self) -> tuple[Array, float] | None:
        """Energy of the data in each mode that meets some, best seen first, and how many frames share it."""
        if np.iscomplexobj(self.beta) or self.c.ndim > 1:
            return None
        met = self.weight > 0
        order = np.argsort(-self.gamma[met], kind="stable")
        return (np.abs(self.beta[met]) ** 2)[order], float(self.weight.max(initial=1.0))

    def _tiled(self, sums: Callable[[Array, slice], Array], lam: Array) -> Array:
        """Sums over the modes at each lambda, (sums, ..., lams), a tile of modes and lambdas at a time.

        A long spectrum times a long grid does not fit in memory, let alone in the cache: the time would grow faster
        than the record. Modes that are no orthonormal loads, and those of a stack, are not split.
        """
        modes = self.c.shape[-1]
        width = min(modes, TILE // 8) if self.c.ndim == 1 and self._orthonormal else modes
        rows = max(1, TILE // (self.c.size // modes * width))
        blocks = [lam[..., k : k + rows] for k in range(0, lam.shape[-1], rows)]
        parts = [slice(k, k + width) for k in range(0, modes, width)]
        return np.concatenate([np.sum([sums(block, part) for part in parts], axis=0) for block in blocks], axis=-1)

    def _absolute(self, lam: Array) -> Array:
        """Absolute lambda, with an axis for the modes at the end: shape (..., lams, 1)."""
        if not np.all(lam >= 0):
            raise InputError("no relative lambda", where="lambda", found=lam, expected="finite numbers >= 0")
        return (lam * self.scale[..., None])[..., None]

    def _sums(self, lam: Array, part: slice) -> Array:
        """Everything that `at` sums over modes, for some of them: shape (11, ..., lams)."""
        f, g = self._filter(lam, part)  # g = 1 - f
        s2, w, b2 = self.s[..., part] ** 2, self.weight[part], self._beta2[..., part] * self.weight[part]
        f2, log_ratio = f**2, np.zeros(f.shape[:-1])
        height2 = s2 * self._cost[..., part] * b2
        if self.smooth:
            gamma = (self._gamma[..., part] * self._seen[..., part])[..., None, :]
            with np.errstate(divide="ignore", invalid="ignore"):  # lambda 0: the ratio is infinite
                ratio = np.where(gamma > 0, gamma / self._absolute(lam), 0.0)
            log_ratio = _dot(np.log1p(ratio**2), w)
        return np.stack(
            [
                _dot(g**2, b2),
                _dot(f2, height2),
                _dot(f, w),
                _dot(f2, w),
                _dot(g, w),
                _dot(g**2, w),
                _dot(g**4, w),
                _dot(g, b2),
                log_ratio,
                self._length2(g * f, part),
                -4 * _dot(g * f2, height2),
            ]
        )

    def predicted_error(self, lam: ArrayLike, pilot: ArrayLike, sigma: ArrayLike) -> Array | None:
        """Squared load error at each `lam` (k,) that would be made if the load were the estimate at `pilot`.

        Bias of the filter on the pilot's load plus the variance of the noise: the parametric bootstrap in closed form.
        """
        first = np.atleast_1d(np.asarray(pilot, float))

        def error(lam: Array, part: slice) -> Array:
            f, g = self._filter(lam, part)
            noise = _dot(f**2, self.weight[part] * self._lengths2() * self._cost[..., part])
            return (self._length2(g * self._filter(first, part)[0], part) + np.asarray(sigma) ** 2 * noise)[None]

        return np.asarray(self._tiled(error, np.atleast_1d(np.asarray(lam, float)))[0])

    def _lengths2(self) -> Array | float:
        """Squared length of each mode of the load."""
        return 1.0

    def _length2(self, factors: Array, part: slice) -> Array:
        """Squared length of the loads with mode coefficients ``factors * beta / c``, orthonormal modes."""
        return _dot(factors**2, self.weight[part] * self._beta2[..., part] * self._cost[..., part])

    def gains(self, lam: ArrayLike) -> Array:
        """Mode coefficients f / c * beta of the solution at one relative `lam` (per line of a stack)."""
        f, _ = self._filter(np.asarray(lam, float)[..., None])
        f = f[..., 0, :]
        return np.where(self.c > 0, f / np.where(self.c > 0, self.c, 1.0), 0.0) * self.beta


def _dot(x: Array, w: Array) -> Array:
    """Sum over the modes of x (..., lams, modes) with weights w (..., modes)."""
    return np.asarray(np.einsum("...km,...m->...k", x, w))
