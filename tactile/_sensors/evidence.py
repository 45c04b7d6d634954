"""The evidence of readings for loads in discs, in which shear goes with pressure, and what they say of these loads.

Unknown of every disc are the size of its pressure (std) and two ratios of shear to it. With T (3 x 3) what x, y and z
are of the pressure and of shears of their own, loads in disc j have the covariance ``T T'`` between components and 1
between modes, so that readings over their noise have the covariance

    S = 1 + sum_j sum_ab (T T')_ab K_ab,   log p(y) = -(y' S^-1 y + log|S|) / 2,

linear in six numbers of every disc (D. J. C. MacKay, Neural Comput. 4 (1992) 415; C. E. Rasmussen & C. K. I. Williams,
Gaussian Processes for Machine Learning, MIT Press 2006, ch. 5). K_ab are kept in the few directions that the discs, the
error of the mesh and motion of the image span, in which evidence, its slope and its curvature cost next to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, lapack, solve_triangular

from .._arrays import Array
from .discs import Disc, DiscWindow, DiscWindows, pivoted
from .inversion import Inverse

OWN = 0.1  # of the pressure: std of shear that does not go with it
SIZES = np.geomspace(1e2, 1e8, 19)  # Pa, between which sizes are
STEEPEST = 3.0  # ratio
TURNS, ENOUGH = 8, 1e-4  # steps to sizes and ratios, until one brings less evidence
SHORTER = 4  # times a step is quartered
LARGEST_STEP = 2.0  # of log size, or of a ratio
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # components of a covariance


def shares(size: float, u: float, v: float) -> Array:
    """T T' (3, 3) of a disc."""
    return np.asarray(np.exp(2 * size) * (np.outer((u, v, 1.0), (u, v, 1.0)) + OWN**2 * np.diag((1.0, 1.0, 0.0))))


@dataclass(frozen=True, eq=False)
class Fitted:
    """Discs with size (log of Pa) and ratios (J, 3), and their log evidence."""

    discs: tuple[Disc, ...]
    at: Array
    evidence: float


@dataclass(frozen=True, eq=False)
class Local:
    """Evidence at one place: value, slope (3 J,) and curvature (3 J, 3 J), the last two where they are asked for."""

    value: float
    slope: Array
    curved: Array


class DiscModel:
    """Readings of loads in some discs, and of motion of the image."""

    def __init__(self, windows: DiscWindows, discs: tuple[Disc, ...]) -> None:
        self.discs, self.shear, parts = discs, windows.shear, (*discs, None)
        self.windows: list[DiscWindow] = [windows.window(d) for d in discs]
        self.bases = [windows.basis(d) for d in parts]
        gram = np.block([[windows.cross(one, other) for other in parts] for one in parts])
        self.own, self.on = pivoted(gram)
        r, ends = self.on.shape[1], np.cumsum([0, *(b.shape[1] for b in self.bases)])
        coordinates = np.split(self.on, ends[1:-1])
        self.X = [w.made @ on for w, on in zip(self.windows, coordinates, strict=False)]  # (parts, 3, q, r)
        K = np.empty((len(discs), len(PAIRS), r, r))
        for X, own in zip(self.X, K, strict=True):
            by = X.transpose(1, 0, 2, 3).reshape(3, -1, r)
            for k, (a, b) in enumerate(PAIRS):
                np.matmul(by[a].T, by[b], out=own[k])
                if a != b:
                    own[k] += own[k].T.copy()
        self.K = K.reshape(len(discs) * len(PAIRS), r * r)
        moved = coordinates[-1].T @ windows.image[1]
        self.rest = np.eye(r) + moved @ moved.T

    @property
    def modes(self) -> list[int]:
        """Number of the loads of every disc, along all axes."""
        return [3 * w.modes.shape[1] for w in self.windows]

    # -- readings -----------------------------------------------------------------------------------------------------
    def told(self, z: Array) -> Array:
        """Readings (m,) or (m, k) along the directions that are used (r, ...)."""
        b = np.concatenate([basis.T @ z for basis in self.bases])[self.own]
        return np.asarray(solve_triangular(self.on[self.own], b, lower=True, check_finite=False))

    def left(self, z: Array, at: Array) -> Array:
        """What loads in the discs and the image do not explain of readings (m,)."""
        told = self.told(z)
        explained = np.zeros(len(self.on))
        explained[self.own] = solve_triangular(self.on[self.own], told - self._solve(self._factor(at), told),
                                               lower=True, trans="T", check_finite=False)  # fmt: skip
        out, k = z.copy(), 0
        for basis in self.bases:
            out -= basis @ explained[k : k + basis.shape[1]]
            k += basis.shape[1]
        return out

    # -- evidence -----------------------------------------------------------------------------------------------------
    def _coefficients(self, at: Array, order: int = 0) -> tuple[Array, Array, Array]:
        """Six numbers of every disc (6 J,), and up to an order their derivatives (3 J, 6 J) and (3 J, 3 J, 6 J)."""
        J = len(self.discs)
        c, d, h = np.zeros((J, 6)), np.zeros((J, 3, J, 6)), np.zeros((J, 3, J, 3, J, 6))
        for j, (size, u, v) in enumerate(at.reshape(-1, 3)):
            e = np.exp(2 * size)
            c[j] = e * np.array([u * u + OWN**2, v * v + OWN**2, 1.0, u * v, u, v])
            if order:
                d[j, :, j] = 2 * c[j], e * np.array([2 * u, 0, 0, v, 1, 0]), e * np.array([0, 2 * v, 0, u, 0, 1])
            if order > 1:
                h[j, 0, j, :, j] = 2 * d[j, :, j]
                h[j, :, j, 0, j] = 2 * d[j, :, j]
                h[j, 1, j, 1, j, 0] = h[j, 2, j, 2, j, 1] = 2 * e
                h[j, 1, j, 2, j, 3] = h[j, 2, j, 1, j, 3] = e
        return c.ravel(), d.reshape(3 * J, 6 * J), h.reshape(3 * J, 3 * J, 6 * J)

    def _covariance(self, c: Array) -> Array:
        r = len(self.rest)
        return self.rest + (c @ self.K).reshape(r, r)

    def _factor(self, at: Array) -> Array:
        return _cholesky(self._covariance(self._coefficients(at)[0]))

    @staticmethod
    def _solve(factor: Array, b: Array) -> Array:
        return np.asarray(lapack.dpotrs(factor, b, lower=1)[0]) if len(factor) else b

    def evidence(self, square: float, told: Array, at: Array, order: int = 0) -> Local:
        """At sizes and ratios (3 J,), of readings with the sum of `square`, `told` along the directions.

        `order` is 0 for the value alone, 1 with its slope and the average of observed and expected curvature, which
        costs nothing more, 2 with its curvature itself.
        """
        r, J = len(self.rest), len(self.discs)
        c, d, h = self._coefficients(at, order)
        factor = _cholesky(self._covariance(c))
        alpha = self._solve(factor, told)
        ratios = np.zeros((J, 3))
        ratios[:, 1:] = at.reshape(-1, 3)[:, 1:] / self.shear
        value = -0.5 * (square - told @ told + told @ alpha) - np.sum(np.log(np.diag(factor)))
        value -= 0.5 * float(np.sum(ratios**2))
        if not order:
            return Local(float(value), np.empty(0), np.empty((0, 0)))
        inverse = lapack.dpotri(factor, lower=1)[0]
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        on = (self.K.reshape(-1, r) @ alpha).reshape(6 * J, r)
        by = 0.5 * (on @ alpha - self.K @ inverse.ravel())
        slope = d @ by - ratios.ravel() / self.shear
        on, own = d @ on, np.diag(np.tile([0.0, 1.0, 1.0], J) / self.shear**2)
        told_by = on @ inverse @ on.T
        if order == 1:
            return Local(float(value), slope, -0.5 * told_by - own)
        turned = inverse @ (d @ self.K).reshape(3 * J, r, r)
        crossed = np.einsum("iab,jba->ij", turned, turned, optimize=True)
        return Local(float(value), slope, 0.5 * crossed - told_by + h @ by - own)

    def unlike(self, z: Array, at: Array) -> float:
        """Sum of the squares of readings (m,) over the covariance that they should have: m where the model is right."""
        told = self.told(z)
        return float(z @ z - told @ told + told @ self._solve(self._factor(at), told))

    def fitted(self, z: Array, start: Array, least: float = -np.inf, turns: int = TURNS) -> Fitted:
        """Sizes and ratios of the largest evidence, from a start (J, 3) where they are at least so likely.

        Newton's method with average information (A. R. Gilmour, R. Thompson & B. R. Cullis, Biometrics 51 (1995)
        1440), steps shortened until the evidence grows.
        """
        low, high = self._bounds
        square, told, at = float(z @ z), self.told(z), np.clip(start.ravel(), low, high)
        value = self.evidence(square, told, at).value
        for _ in range(turns if value >= least and len(at) else 0):
            here = self.evidence(square, told, at, order=1)
            value = here.value
            w, V = np.linalg.eigh(here.curved)
            step = V @ ((V.T @ here.slope) / np.maximum(np.abs(w), ENOUGH))
            step *= min(1.0, LARGEST_STEP / max(float(np.abs(step).max(initial=0.0)), LARGEST_STEP))
            grown = value
            for _ in range(SHORTER):
                to = np.clip(at + step, low, high)
                grown = self.evidence(square, told, to).value
                if grown > value:
                    break
                step = step / 4
            if grown > value:
                at = to
            if not grown > value + ENOUGH:
                value = max(value, grown)
                break
            value = grown
        return Fitted(self.discs, at.reshape(-1, 3), value)

    # -- loads --------------------------------------------------------------------------------------------------------
    def mean(self, told: Array, at: Array) -> list[Array]:
        """Modes (3, q) of every disc that are found at sizes and ratios."""
        alpha = self._solve(self._factor(at), told)
        return [made @ alpha for made in self._made(at)]

    def _made(self, at: Array) -> list[Array]:
        """What modes (3, q, r) of every disc have in common with readings along the directions."""
        return [np.tensordot(shares(*one), X[0], 1) for one, X in zip(at.reshape(-1, 3), self.X, strict=True)]

    def posterior(self, z: Array, at: Array, changes: Array) -> tuple[Array, Array]:
        """Mean (J * 3 * q,) and covariance of the modes, by readings (m,), and errors (r, t) of std one beside them.

        Errors are given along the directions. One frame does not tell them: what a load would make good of them is in
        the covariance, whole.
        """
        made = np.vstack([one.reshape(-1, len(self.rest)) for one in self._made(at)])
        factor, told = self._factor(at), self.told(z)
        prior = block_diag(*(np.kron(shares(*one), np.eye(X.shape[2])) for one, X in
                             zip(at.reshape(-1, 3), self.X, strict=True)))  # fmt: skip
        alpha = self._solve(factor, told)
        covariance = prior - made @ self._solve(factor, made.T)
        felt = made @ self._solve(factor, changes)
        return made @ alpha, covariance + felt @ felt.T

    @cached_property
    def _bounds(self) -> tuple[Array, Array]:
        J = len(self.discs)
        low = np.tile([np.log(SIZES[0]), -STEEPEST, -STEEPEST], J)
        return low, np.tile([np.log(SIZES[-1]), STEEPEST, STEEPEST], J)


def _cholesky(S: Array) -> Array:
    return np.asarray(lapack.dpotrf(S, lower=1, clean=1)[0]) if len(S) else S


@dataclass(frozen=True, eq=False)
class EvenEvidence:
    """Log evidence of readings under loads all over the surface, by their frozen inverse, beside motion of the image.

    `left` (m, m) is what no other reading predicts, its inverse the covariance of the whitened readings.
    """

    left: Array
    moved: Array
    size: float

    @classmethod
    def of(cls, inverse: Inverse, moved: Array) -> EvenEvidence:
        """Made once for an inverse."""
        left = np.eye(len(inverse.noise)) - inverse.influence
        within = np.eye(moved.shape[1]) + moved.T @ (left @ moved)
        factor = np.linalg.cholesky(within)
        gained = solve_triangular(factor, moved.T @ left, lower=True)
        size = float(np.linalg.slogdet(left)[1] - 2 * np.sum(np.log(np.diag(factor))))
        return cls(left, gained, size / 2)

    def __call__(self, z: Array) -> float:
        """Of whitened readings (m,)."""
        told = self.moved @ z
        return self.size - 0.5 * float(z @ (self.left @ z) - told @ told)
