"""The evidence of readings for loads in discs, in which shear goes with pressure, and what they say of these loads.

Unknown of every disc are the size of its pressure (std) and two ratios of shear to it. With T (3 x 3) what x, y and z
are of the pressure and of shears of their own, loads in disc j have the covariance ``T T'`` between components and 1
between modes, so that readings over their noise have the covariance

    S = 1 + sum_j sum_ab (T T')_ab K_ab,   log p(y) = -(y' S^-1 y + log|S|) / 2,

linear in six numbers of every disc (D. J. C. MacKay, Neural Comput. 4 (1992) 415; C. E. Rasmussen & C. K. I. Williams,
Gaussian Processes for Machine Learning, MIT Press 2006, ch. 5). K_ab of a disc are kept in the few directions that it
spans with the error of the mesh there, once; what several discs tell is made of theirs and of the products between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import lapack, solve_triangular

from .._arrays import Array
from .discs import Disc, DiscWindows, cholesky, lower, shares, solved
from .inversion import Inverse

SIZES = np.geomspace(1e2, 1e8, 19)  # Pa, between which sizes are
STEEPEST = 3.0  # ratio
TURNS, ENOUGH = 8, 1e-4  # steps to sizes and ratios, until one brings less evidence
SHORTER = 4  # times a step is quartered
LARGEST_STEP = 2.0  # of log size, or of a ratio


@dataclass(frozen=True, eq=False)
class Fitted:
    """Discs with size (log of Pa) and ratios (J, 3), and their log evidence."""

    discs: tuple[Disc, ...]
    at: Array
    evidence: float


@dataclass(frozen=True, eq=False)
class Local:
    """Evidence at one place: its value, and what slope and curvature are made of.

    `F` (parts) are the factors of the covariance along the directions of each part, `inner` the Cholesky factor of
    ``1 + F' B' B F``, and `beta` what this has of the readings.
    """

    at: Array
    value: float
    F: list[Array]
    inner: Array
    beta: Array


class DiscModel:
    """Readings of loads in some discs, and of motion of the image.

    Each of these parts has readings in directions of its own, B_j, and their covariance there is ``F_j F_j'`` at given
    sizes and ratios: with B and F of all parts side by side, ``S = 1 + B F F' B'``, and all of it is told by the
    `inner` matrix ``1 + F' B' B F``. Directions of less than `faint` of the strongest variance of a disc are left out.
    """

    def __init__(self, windows: DiscWindows, discs: tuple[Disc, ...], faint: float = 0.0) -> None:
        self.discs, self.shear, parts = discs, windows.shear, (*discs, None)
        self.windows = [windows.window(d).above(faint) for d in discs]
        self.image = windows.image[1]
        self.bases = [*(w.basis for w in self.windows), windows.image[0]]
        counts = [b.shape[1] for b in self.bases]
        self.cross = [[windows.cross(one, other)[:r, :q] for other, q in zip(parts[:i], counts, strict=False)]
                      for i, (one, r) in enumerate(zip(parts, counts, strict=True))]  # fmt: skip
        ends = np.cumsum([0, *counts])
        self.slices = [slice(*ends[j : j + 2]) for j in range(len(parts))]

    @property
    def modes(self) -> list[int]:
        """Number of the loads of every disc, along all axes."""
        return [3 * w.modes.shape[1] for w in self.windows]

    # -- readings -----------------------------------------------------------------------------------------------------
    def told(self, z: Array) -> Array:
        """Readings (m,) or (m, k) along the directions of all parts."""
        return np.concatenate([basis.T @ z for basis in self.bases])

    def left(self, z: Array, at: Array) -> Array:
        """What loads in the discs and the image do not explain of readings (m,)."""
        here, out = self.evidence(float(z @ z), self.told(z), at), z.copy()
        for basis, f, s in zip(self.bases, here.F, self.slices, strict=True):
            out -= basis @ (f @ here.beta[s])
        return out

    def unlike(self, z: Array, at: Array) -> float:
        """Sum of the squares of readings (m,) over the covariance that they should have: m where the model is right."""
        square, told = float(z @ z), self.told(z)
        here = self.evidence(square, told, at)
        return square - float(self._along(here.F, told) @ here.beta)

    # -- evidence -----------------------------------------------------------------------------------------------------
    def _factors(self, at: Array) -> tuple[list[Array], Array]:
        """F_j of every disc at sizes and ratios (3 J,), and of the image; and the Cholesky factor of what they make."""
        F = [w.factor(one) for w, one in zip(self.windows, at.reshape(-1, 3), strict=True)] + [self.image]
        inner = np.zeros((self.slices[-1].stop,) * 2)
        for i, (f, rows) in enumerate(zip(F, self.slices, strict=True)):
            for j, other in enumerate(F[: i + 1]):
                inner[rows, self.slices[j]] = f.T @ (self.cross[i][j] @ other if j < i else other)
        inner.flat[:: len(inner) + 1] += 1.0
        return F, cholesky(inner)

    def _along(self, F: list[Array], told: Array) -> Array:
        """F' of what is told along the directions (r, ...)."""
        return np.concatenate([f.T @ told[s] for f, s in zip(F, self.slices, strict=True)])

    def evidence(self, square: float, told: Array, at: Array) -> Local:
        """At sizes and ratios (3 J,), of readings with the sum of `square`, `told` along the directions."""
        at = at.ravel()
        F, inner = self._factors(at)
        along = self._along(F, told)
        beta = solved(inner, along)
        value = -0.5 * (square - along @ beta) - np.sum(np.log(np.diag(inner)))
        return Local(at, float(value - 0.5 * np.sum((at * self._shears) ** 2)), F, inner, beta)

    @cached_property
    def _shears(self) -> Array:
        """One over the std of sizes and ratios (3 J,) before any reading."""
        return np.tile([0.0, 1.0, 1.0], len(self.discs)) / self.shear

    def curved(self, here: Local, exactly: bool = False) -> tuple[Array, Array]:
        """Slope (3 J,) and curvature (3 J, 3 J) of evidence.

        The curvature is the average of observed and expected, which costs nothing more than the slope, or `exactly`.
        """
        J, beta = len(self.discs), here.beta
        W = _explained(here.inner)
        places = list(zip(here.at.reshape(-1, 3), self.windows, here.F, self.slices, strict=False))
        made = [w.slopes(one, f) for one, w, f, _ in places]
        slope, by = np.zeros((J, 3)), np.zeros((3 * J, len(beta)))
        for j, (M, s) in enumerate(zip(made, self.slices, strict=False)):
            by[3 * j : 3 * j + 3, s] = M @ beta[s]
            slope[j] = 0.5 * (by[3 * j : 3 * j + 3, s] @ beta[s] - M.reshape(3, -1) @ W[s, s].ravel())
        told, own = by @ W @ by.T, np.diag(self._shears**2)
        if not exactly:
            return slope.ravel() - self._shears**2 * here.at, -0.5 * told - own
        more = np.zeros((J, 3, J, 3))
        for j, ((one, w, f, s), M) in enumerate(zip(places, made, strict=True)):
            second = w.second(one, f, M)
            more[j, :, j] = 0.5 * (second @ beta[s] @ beta[s] - np.sum(second * W[s, s], axis=(2, 3)))
            for i, (other, t) in enumerate(zip(made, self.slices, strict=False)):
                more[j, :, i] += 0.5 * np.einsum("aij,bji->ab", M @ W[s, t], other @ W[t, s], optimize=True)
        return slope.ravel() - self._shears**2 * here.at, more.reshape(3 * J, 3 * J) - told - own

    def fitted(self, z: Array, start: Array, least: float = -np.inf, turns: int = TURNS) -> Fitted:
        """Sizes and ratios of the largest evidence, from a start (J, 3) where they are at least so likely.

        Newton's method with average information (A. R. Gilmour, R. Thompson & B. R. Cullis, Biometrics 51 (1995)
        1440), steps shortened until the evidence grows.
        """
        low, high = self._bounds
        square, told = float(z @ z), self.told(z)
        here = self.evidence(square, told, np.clip(start.ravel(), low, high))
        for _ in range(turns if here.value >= least and self.discs else 0):
            slope, curved = self.curved(here)
            w, V = np.linalg.eigh(curved)
            step = V @ ((V.T @ slope) / np.maximum(np.abs(w), ENOUGH))
            step *= min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), LARGEST_STEP))
            before = here
            for _ in range(SHORTER):
                tried = self.evidence(square, told, np.clip(before.at + step, low, high))
                if tried.value > before.value:
                    here = tried
                    break
                step = step / 4
            if not here.value > before.value + ENOUGH:
                break
        return Fitted(self.discs, here.at.reshape(-1, 3), here.value)

    # -- loads --------------------------------------------------------------------------------------------------------
    def posterior(self, here: Local, z: Array, changes: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Mean (J * 3 * q,) and covariance of the modes, of readings z (m,) whose evidence has been asked.

        `changes` (m, 1 + t) are what errors of std one bring beside such modes. How much there is of the first the
        readings tell, and its second moment by them counts, one at most. The others one frame does not tell: what a
        load would make good of them is in the covariance, whole.
        """
        ends = np.cumsum([0, *self.modes])
        made, covariance = np.zeros((ends[-1], len(here.inner))), np.zeros((ends[-1],) * 2)
        for j, (one, w, f) in enumerate(zip(here.at.reshape(-1, 3), self.windows, here.F, strict=False)):
            own, T, each = slice(*ends[j : j + 2]), shares(*one), np.arange(w.modes.shape[1])
            prior = np.zeros((3, len(each), 3, len(each)))
            prior[:, each, :, each] = T
            covariance[own, own] = prior.reshape(3 * len(each), -1)
            made[own, self.slices[j]] = lower(f, np.tensordot(T, w.made[0], 1).reshape(-1, len(f)).T).T
        mean, reach = made @ here.beta, lower(here.inner, made.T).T
        covariance += reach @ reach.T - made @ made.T
        wrong = changes(mean)
        told, first = self._along(here.F, self.told(wrong)), wrong[:, 0]
        along = lower(here.inner, told)
        felt, open_ = reach @ along, 1.0 + float(first @ first - along[:, 0] @ along[:, 0])
        found = float(first @ z - told[:, 0] @ here.beta) / open_
        felt[:, 0] *= np.sqrt(min(1.0, 1.0 / open_ + found**2))
        return mean, covariance + felt @ felt.T

    @cached_property
    def _bounds(self) -> tuple[Array, Array]:
        J = len(self.discs)
        low = np.tile([np.log(SIZES[0]), -STEEPEST, -STEEPEST], J)
        return low, np.tile([np.log(SIZES[-1]), STEEPEST, STEEPEST], J)


def _explained(factor: Array) -> Array:
    """What is no noise: 1 less the inverse of what has this Cholesky factor."""
    if not len(factor):
        return factor
    inverse = lapack.dpotri(factor, lower=1)[0]
    out = -(inverse + inverse.T)
    out.flat[:: len(out) + 1] = 1.0 - np.diag(inverse)
    return np.asarray(out)


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
