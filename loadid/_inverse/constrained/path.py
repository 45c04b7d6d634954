"""The regularization path under constraints: signs, bounds, support, resultants, friction cones; its edf, posterior."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import log
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._threads import one_thread
from structures.errors import InputError

from ...constraints import Constraint
from ..path import Coefficients, PathPoint, RegularizationPath, Solution
from ..posterior import FacePosterior, FramesPosterior, Posterior
from ..svd import SVDPath
from . import activeset
from .activeset import ActivePoint, refuse_empty
from .feasible import Feasible, compile_
from .few import FewFace, NarrowPenalty
from .quadratic import ActiveFace
from .solver import ConstrainedSolution, ConstrainedSolver, few_rows, grams, resultants_of, soft, soft_values, whitening

Array = NDArray[np.float64]

__all__ = [
    "ConstrainedPath",
    "ConstrainedSolution",
    "ConstrainedSolver",
]


@dataclass(frozen=True, eq=False)
class Tangent:
    """How the estimate moves with the data where its face stays.

    Parameters
    ----------
    passed, left : array, shape (modes,)
        Eigenvalues of the derivative of the predicted response by the data, and their complements, formed without
        subtraction. Data beyond the modes are left whole.
    sensitivity : float
        Norm of lambda dg/dlambda.
    factor : callable
        Makes the factor F (n, directions), the modes first: ``F F^T`` is the inverse of the Hessian of half the
        objective on the face, curvature included.
    """

    passed: Array
    left: Array
    sensitivity: float
    factor: Callable[[], Array]

    @classmethod
    def of(cls, solver: ConstrainedSolver, y: Array, p: ActivePoint, s: Feasible) -> Tangent:
        """At the solution of one vector of data."""
        q = solver.quadratic
        push = q.gradient(p.h, solver.compress(y)[0])[0] + p.nu @ s.equal.matrix + p.kappa @ s.below.matrix
        face = ActiveFace.near(s, p.h - q.tau * push)
        rows = np.vstack([s.equal.matrix, s.below.matrix[p.kappa > 0]])
        few = q.few(face, rows)
        if few is not None:
            sensitivity = 2 * few.change(face.turn(q.rough(p.h))[~face.held])
            return cls(few.passed, few.left, sensitivity, partial(_on_all, few, face, s))
        S = q.shrink(face, rows)
        image = q.A @ S
        prior, bend = solver.prior[:, None] * image, face.curvature(q.tau)
        curved = np.sqrt(bend[bend > 0])[:, None] * face.turn(S)[bend > 0]
        moved = S @ (prior.T @ (solver.prior * (q.A @ p.h)))
        met = solver.seen > 0
        _, c, V = np.linalg.svd(solver.seen[met, None] * image[met], full_matrices=False)
        left = sum(np.sum((part @ V.T) ** 2, axis=0) for part in (prior, curved))
        return cls(np.minimum(c**2, 1.0), left, 2 * float(np.linalg.norm(moved)), partial(_turned, V, s.to_global(S)))

    def scalars(self, m: int) -> tuple[float, ...]:
        """Sums for m data, with the derivative A: tr A, tr A^2, m - tr A, tr (I - A)^2, tr (I - A)^4, sensitivity."""
        a, b, beyond = self.passed, self.left, m - len(self.left)
        rest = (beyond + float(np.sum(b**k)) for k in (1, 2, 4))
        return float(a.sum()), float(a @ a), *rest, self.sensitivity


def _turned(V: Array, S: Array) -> Array:
    """A factor whose first directions are those of the rows V, which are orthonormal."""
    return np.asarray(S @ np.linalg.qr(V.T, mode="complete")[0])


def _on_all(few: FewFace, face: ActiveFace, s: Feasible) -> Array:
    """Factor over all loads from that on a face."""
    own = few.factor
    out = np.zeros((len(face.share), own.shape[1]))
    out[~face.held] = own
    return s.to_global(face.back(out))


def posterior(faces: Sequence[Tangent], sigma: float, shape: tuple[int, ...], frames: int | None) -> Posterior:
    """Gaussian posterior on the active faces, in modes that split the share of the noise from that of the prior."""
    each = []
    for t in faces:
        factor = t.factor()
        passed, modes = np.zeros(factor.shape[1]), min(factor.shape[1], len(t.passed))
        passed[:modes] = t.passed[:modes]
        each.append(FacePosterior(sigma * factor, shape, passed=passed))
    return each[0] if frames is None else FramesPosterior(each)


SCALARS = (
    "residual2", "penalty2", "edf", "edf2", "left", "rest2", "rest4", "sensitivity", "objective",
)  # fmt: skip
COLD, STEP = 1e-3, 10.0  # relative lambda below which no start is cold; from one lambda to the next
SMALL = 3e8  # products in a factorisation up to which one thread is faster
KEPT = 4  # lambdas whose matrices are kept; their solutions are kept for all


class ConstrainedPath(RegularizationPath):
    """Path of ``min |H g - y|^2 + lambda^2 |L g|^2`` under constraints, solved lambda by lambda, each start warm.

    The effective degrees of freedom are those of the active face: the divergence of the estimate by the data where
    the active set stays as it is (held loads count nothing; a sliding contact counts along its ray and, damped by the
    curvature of its cone, across it). Meyer & Woodroofe, Ann. Stat. 28 (2000) 1083, for projections on convex sets.
    The evidence and the predicted error are not defined here: rules that need them refuse by name. Soft resultants
    are data: they count in `m`, in the residual norm and in the degrees of freedom.

    Parameters
    ----------
    path : SVDPath
        Of the problem without constraints; relative lambdas keep its scale.
    constraints : sequence
        From `loadid.constraints`, in any mixture.
    sigma : float
        Noise level of the whitened data (1 where they were whitened by their noise): a soft resultant is weighed
        against it.

    Raises
    ------
    InputError
        Constraints that do not fit the loads, or contradict each other (LID-E309).
    NotIdentifiable
        If no load is admissible (LID-E309).
    """

    approximation = "active-set approximation"

    def __init__(self, path: SVDPath, constraints: Sequence[Constraint] | Constraint, *, sigma: float = 1.0) -> None:
        if not path.smooth:
            raise InputError("a truncated SVD takes no constraints", where="constraints", expected="Tikhonov")
        if not (np.isfinite(sigma) and sigma > 0):
            raise InputError("no noise level", where="sigma", found=sigma, expected="a finite number > 0")
        self.path, self.sigma = path, float(sigma)
        self.constraints = tuple(constraints) if isinstance(constraints, Sequence) else (constraints,)
        n, frames = path.problem.H.shape[1], path.problem.frames
        self.feasible: Feasible = compile_(self.constraints, n)
        held = self.feasible.equal.value
        if held.ndim == 2 and held.shape[1] != (frames or 1):
            raise InputError("the resultants have other frames than the data", where="Resultant",
                             found=held.shape[1], expected=frames or 1)  # fmt: skip
        self._sets = [self.feasible.of(k) for k in range(held.shape[1] if held.ndim == 2 else 1)]
        for each in self._sets:
            refuse_empty(each)
        self.base = _with_soft(path, self.constraints, self.sigma)
        self.m, self.null, self.scale = self.base.m, path.null, path.scale  # soft resultants are data
        y = self.base.problem.y
        self._columns = y[:, None] if y.ndim == 1 else y
        self._points: dict[float, tuple[ActivePoint, ...]] = {}
        self._solvers: OrderedDict[float, ConstrainedSolver] = OrderedDict()
        self._known: dict[float, Array] = {}  # scalars: several rules and guards sweep the same lambdas

    def _threads(self) -> AbstractContextManager[None]:
        """One thread of the linear algebra where a factorisation on a face is too little work for several."""
        small = len(self.base.c) * int(np.count_nonzero(self.base.c)) ** 2 < SMALL
        return one_thread() if small else nullcontext()

    @property
    def unconstrained(self) -> SVDPath:
        """The path without constraints, soft resultants among its data."""
        return self.base

    # -- the contract -------------------------------------------------------------------------------------------------
    @property
    def problem(self) -> object:
        """The problem without constraints."""
        return self.path.problem

    @property
    def range(self) -> tuple[float, float]:
        """Sensible interval of relative lambda."""
        return self.path.range

    @property
    def coefficients(self) -> Coefficients | None:
        """Data coefficients without constraints."""
        return self.path.coefficients

    def at(self, lam: ArrayLike) -> PathPoint:
        """Scalars of the path at relative `lam`, a number or an array (k,): one solve each, from large to small."""
        lam = np.asarray(lam, float)
        if lam.ndim > 1 or not np.all((lam >= 0) & np.isfinite(lam)):
            raise InputError("no relative lambda", where="lambda", found=lam, expected="finite numbers >= 0")
        each = np.atleast_1d(lam)
        rows = np.zeros((9, len(each)))
        with self._threads():
            for k in np.argsort(-each, kind="stable"):
                value = float(each[k])
                if value not in self._known:
                    self._known[value] = self._scalars(value)
                rows[:, k] = self._known[value]
        return PathPoint(**dict(zip(SCALARS, rows if lam.ndim else rows[:, 0], strict=True)))

    def residual(self, lam: float) -> Array:
        """Whitened residual y - H g of the sensors, in the layout of the data."""
        problem = self.path.problem
        g = np.stack([self._load(p) for p in self._solved(lam)], axis=1)
        y = problem.y if problem.y.ndim == 2 else problem.y[:, None]
        return (y - problem.H @ g).T.reshape(problem.layout)

    def solution(self, lam: float, sigma: float | None) -> Solution:
        """Load and, at the noise level `sigma`, its posterior on the active face (an active-set approximation).

        Loads held by a constraint have std 0 there, which says that a small change of the data leaves them held, not
        that they are known; `sample` draws from what the constraints leave.
        """
        load = np.stack([self._load(p) for p in self._solved(lam)]).reshape(self.path.problem.load_shape)
        if sigma is None:
            return Solution(load, None)
        with self._threads():
            faces = [self._tangent(lam, k) for k in range(len(self._columns.T))]
            return Solution(load, posterior(faces, sigma, self.path.problem.shape, self.path.problem.frames))

    def resolve(self, load: Array, lam: float) -> Array:
        """What would be estimated from the noise-free response of `load` (and its own soft resultants)."""
        g = np.asarray(load, float).reshape(-1, self.path.problem.H.shape[1])
        prepared = self._solver(lam)
        y = self.base.problem.H @ g.T
        out = [self._load(p) for p in prepared.points(y, self.feasible, ())]
        return np.stack(out).reshape(np.shape(load))

    # -- solving ------------------------------------------------------------------------------------------------------
    def solve(self, lam: float, warm: ConstrainedSolution | None = None) -> ConstrainedSolution:
        """Solution at relative `lam` with multipliers, duality gap, violation and active sets."""
        prepared, points = self._solver(lam), self._points.get(float(lam))
        if warm is not None or points is None:
            points = self._run(float(lam), None if warm is None else warm.points)
        return prepared.finish(self._columns, self.feasible, points, framed=self.path.problem.frames is not None)

    def prepare(self, lam: float) -> ConstrainedSolver:
        """Solver at relative `lam` for other whitened data, one after another: ``.solve(y, warm=previous)``."""
        return self._solver(lam)

    def sample(self, lam: float, sigma: ArrayLike, draws: int = 200, *, seed: int = 0) -> Array:
        """Loads drawn by randomise-then-optimise: noise and prior are perturbed, the problem is solved anew, warm.

        Every draw meets the constraints, so that bands from it are one-sided where they must be. Without active
        constraints the draws are exactly those of the Gaussian posterior; with them they are an approximation
        (Bardsley, Solonen, Haario & Laine, SIAM J. Sci. Comput. 36 (2014) A1895; Bardsley & Hansen, Computational
        Uncertainty Quantification for Inverse Problems, SIAM 2018, for bounds). `sigma` is one level, or one for each
        draw.

        Returns
        -------
        array, shape (draws,) + shape of the load
        """
        prepared, rng = self._solver(lam), np.random.default_rng(seed)
        out = []
        for k, (column, point) in enumerate(zip(self._columns.T, self._solved(lam), strict=True)):
            b = prepared.compress(column)[0]
            inside = self._sets[min(k, len(self._sets) - 1)]
            drawn = [b + level * (rng.standard_normal(len(b)) @ self._turn) for level in np.broadcast_to(sigma, draws)]
            with self._threads():
                out.append([self._load(activeset.solve(prepared.quadratic, x, inside, point)) for x in drawn])
        return np.swapaxes(np.array(out), 0, 1).reshape(draws, *self.path.problem.load_shape)

    @cached_property
    def _turn(self) -> Array:
        """Orthogonal matrix that turns with the modes, (loads, modes): draws do not depend on signs of an SVD."""
        left, _, right = np.linalg.svd(self.base.Y)
        return np.asarray(left @ right)

    def _solver(self, lam: float) -> ConstrainedSolver:
        lam = float(lam)
        if not (np.isfinite(lam) and lam >= 0):
            raise InputError("no relative lambda", where="lambda", found=lam, expected="a finite number >= 0")
        if lam not in self._solvers:
            self._solvers[lam] = ConstrainedSolver(
                self.base,
                self.constraints,
                self.feasible,
                lam * float(self.scale),
                self.sigma,
                self._given_grams,
                self._few,
            )
            while len(self._solvers) > KEPT:
                self._solvers.popitem(last=False)
        self._solvers.move_to_end(lam)
        return self._solvers[lam]

    @cached_property
    def _few(self) -> tuple[Array, NarrowPenalty | None] | None:
        return few_rows(self.base, self.feasible)

    @cached_property
    def _rows(self) -> Any:
        """Rows of the penalty, sparse where they are narrow; None for the identity."""
        from scipy.sparse import csr_array

        L, narrow = self.base.problem.L, self._few is not None and self._few[1] is not None
        return csr_array(L) if narrow else L

    def _given_grams(self) -> tuple[Array, Array]:
        return self._grams

    @cached_property
    def _grams(self) -> tuple[Array, Array]:
        return grams(self.base, self.feasible)

    def _solved(self, lam: float) -> tuple[ActivePoint, ...]:
        """Points at `lam`, from the cache or from the nearest lambda in it.

        A small lambda without one within a decade is come to in steps: a cold start does not find its face.
        """
        lam = float(lam)
        if lam not in self._points:
            floor = 1e-300
            if 0.0 < lam < COLD and not any(lam / STEP <= x <= lam * STEP for x in self._points):
                self._solved(min(lam * STEP, COLD))
            near = min(self._points, key=lambda x: abs(log((x + floor) / (lam + floor))), default=None)
            self._run(lam, None if near is None else self._points[near])
        return self._points[lam]

    def _run(self, lam: float, starts: Sequence[ActivePoint] | None) -> tuple[ActivePoint, ...]:
        with self._threads():
            self._points[lam] = self._solver(lam).points(self._columns, self.feasible, starts or ())
        return self._points[lam]

    def _load(self, p: ActivePoint) -> Array:
        return self.feasible.to_global(p.h)

    def _tangent(self, lam: float, frame: int) -> Tangent:
        inside = self._sets[min(frame, len(self._sets) - 1)]
        return Tangent.of(self._solver(lam), self._columns[:, frame], self._solved(lam)[frame], inside)

    def _scalars(self, lam: float) -> Array:
        """Residual, penalty, edf, tr A^2, left, rest2, rest4, sensitivity, objective, summed over the frames."""
        problem, total, change2 = self.base.problem, np.zeros(9), 0.0
        absolute2 = (lam * float(self.scale)) ** 2
        for k, (column, p) in enumerate(zip(self._columns.T, self._solved(lam), strict=True)):
            g = self._load(p)
            rest = column - problem.H @ g
            rough = g if self._rows is None else self._rows @ g
            residual2, penalty2 = float(rest @ rest), float(rough @ rough)
            *sums, change = self._tangent(lam, k).scalars(len(column))
            change2 += change**2
            total += [residual2, penalty2, *sums, 0.0, residual2 + absolute2 * penalty2]
        total[7] = np.sqrt(change2)
        return total


def _with_soft(path: SVDPath, constraints: Sequence[Constraint], sigma: float) -> SVDPath:
    """The path with the whitened rows of soft resultants behind those of the sensors."""
    measured = soft(constraints)
    if not measured:
        return path
    problem = path.problem
    y = problem.y[:, None] if problem.y.ndim == 1 else problem.y
    values = soft_values(constraints, resultants_of(constraints, None), sigma, y.shape[1])
    stacked = np.vstack([y, *values])
    stacked = stacked[:, 0] if problem.y.ndim == 1 else stacked
    H = np.vstack([problem.H, *(whitening(c, sigma) @ np.asarray(c.C) for c in measured)])
    layout = stacked.shape if stacked.ndim == 1 else stacked.T.shape
    return SVDPath(replace(problem, H=H, y=stacked, layout=layout))
