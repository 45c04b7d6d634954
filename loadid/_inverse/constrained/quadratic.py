"""The objective |A h - b|^2 of a constrained problem, the face on which a load lies, and least squares on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ... import constraints as cones
from .feasible import Feasible

if TYPE_CHECKING:
    from .few import FewFace

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class ActiveFace:
    """ActiveFace of the intervals and cones near a point, in turned unknowns: on a cone along the ray, across, outward.

    Parameters
    ----------
    point : array, shape (n,)
        Projection of the point, not turned.
    share : array, shape (n,)
        Derivative of the projection along each turned unknown: 1 free, 0 held.
    turns : tuple of (index (k, dim), axes (k, dim, dim))
        Cones that are turned; the other unknowns stay as they are.
    status : tuple of array
        Per group of cones: 0 open, 1 sliding, 2 sticking.
    """

    point: Array
    share: Array
    turns: tuple[tuple[Index, Array], ...]
    status: tuple[Index, ...]

    @classmethod
    def near(cls, feasible: Feasible, v: Array) -> ActiveFace:
        """The face to which `v` projects."""
        point = np.clip(v, feasible.lower, feasible.upper)
        share = ((v > feasible.lower) & (v < feasible.upper)).astype(float)
        turns, status = [], []
        for c in feasible.cones:
            w = v[c.index]
            found = cones.faces(w, c.mu, c.facets)
            point[c.index], share[c.index] = cones.project(w, found), found.share
            side = found.status == 1
            if np.any(side):
                turns.append((c.index[side], found.axes[side]))
            status.append(found.status)
        return cls(point, share, tuple(turns), tuple(status))

    @property
    def held(self) -> Mask:
        """Turned unknowns that the face holds."""
        return np.asarray(self.share == 0)

    def curvature(self, tau: Array) -> Array:
        """Second derivative that the curved sides of round cones add to half the objective, along each unknown."""
        a = self.share
        return np.divide(1 - a, a * tau, out=np.zeros(len(a)), where=(a > 0) & (a < 1))

    def turn(self, x: Array) -> Array:
        """Turned unknowns, along the first axis."""
        out = x.copy()
        for index, axes in self.turns:
            out[index] = np.einsum("kij,ki...->kj...", axes, x[index])
        return out

    def back(self, x: Array) -> Array:
        """Inverse of `turn`, along the first axis."""
        out = x.copy()
        for index, axes in self.turns:
            block = x[index.ravel()].reshape(*index.shape, -1)
            out[index.ravel()] = np.matmul(axes, block).reshape(index.size, *x.shape[1:])
        return out

    def columns(self, A: Array) -> Array:
        """Columns of a matrix for the turned unknowns; itself where none is turned."""
        if not self.turns:
            return A
        out = A.copy(order="F")
        for index, axes in self.turns:
            _turn(out, index, axes)
        return out

    def gram(self, G: Array, f: Index) -> Array:
        """Rows and columns `f` of a symmetric matrix for the turned unknowns."""
        if not self.turns:
            return np.asfortranarray(G[np.ix_(f, f)])
        used = np.zeros(len(G), bool)
        used[f] = True
        for index, _ in self.turns:
            used[index] = True
        place = np.cumsum(used) - 1
        M = np.asfortranarray(G[np.ix_(used, used)])
        for _ in range(2):
            for index, axes in self.turns:
                _turn(M, place[index], axes)
            M = np.asfortranarray(M.T)
        return np.asfortranarray(M[np.ix_(place[f], place[f])])


def _turn(A: Array, index: Index, axes: Array) -> None:
    """Turn some columns of a Fortran-ordered matrix, in place."""
    flat = index.ravel()
    rows = A.T[flat].reshape(*index.shape, len(A))
    A.T[flat] = np.matmul(axes.transpose(0, 2, 1), rows).reshape(index.size, len(A))


class FaceFactor(Protocol):
    """Solves with a matrix, its rows and columns of held unknowns left out."""

    def solve(self, r: Array) -> Array:
        """Solution (size,), 0 where held."""
        ...


WELL = 1e-11  # reciprocal condition of the Gram matrix above which it may direct the steps
FAIR = 1e-3  # and above which one step has the digits that A tells
EPS = float(np.finfo(float).eps)


class Quadratic:
    """Half of |A h - b|^2 in local unknowns, prepared for many faces.

    A step on a face is a least-squares problem with one more row for each curved cone. Where A is well conditioned its
    Gram matrix directs the step, and the gradient A^T (A h - b), formed from A itself, decides when to stop: iterative
    refinement of the semi-normal equations (Björck, Linear Algebra Appl. 88/89 (1987) 31). Elsewhere each step is a QR.

    Parameters
    ----------
    A : array, shape (rows, n)
    feasible : Feasible
        For the blocks, which share one length scale.
    gram : array, shape (n, n), optional
        A^T A, where it is known.
    """

    exact = False  # whether a step has all its digits where A is ill-conditioned, rows that hold or none
    precision = 1.0  # gradient on free unknowns, over the largest of A^T b, above which a solution is refined

    def __init__(self, A: Array, feasible: Feasible, gram: Array | None = None) -> None:
        self.A = np.asfortranarray(A, float)
        self.n = A.shape[1]
        self.G = gram_of(self.A) if gram is None else gram
        self.tau = lengths(np.diag(self.G).copy(), feasible)
        self._factor: Array | None = None
        condition = self._condition()
        self.well, self.fair = condition > WELL, condition > FAIR
        self._triangle: Array | None = None

    def _condition(self) -> float:
        """Reciprocal condition number of the Gram matrix with a unit diagonal; zero where it is singular."""
        from scipy.linalg import lapack

        w = np.sqrt(self.tau)
        scaled = np.asfortranarray(self.G * w[:, None] * w)
        norm = float(np.abs(scaled).sum(axis=0).max(initial=0.0))
        factor, info = lapack.dpotrf(scaled, clean=1, overwrite_a=1)
        self._factor = None if info else factor
        return float(lapack.dpocon(factor, norm)[0]) if info == 0 and self.n else 0.0

    def gradient(self, h: Array, b: Array) -> tuple[Array, float]:
        """A^T (A h - b), and the norm of A h."""
        image = self.A @ h
        return (image - b) @ self.A, float(np.linalg.norm(image))

    def apply(self, h: Array) -> Array:
        """A^T A h."""
        return self.G @ h

    def factor(self, weight: Array) -> FaceFactor:
        """Factors of A^T A + diag(weight); where the weight is infinite, the unknown is held at 0."""
        return CholeskyFactor(self.G, weight)

    def rough(self, h: Array) -> Array:
        """Gradient of what is prior in A^T A h, where it is told apart (see `few`)."""
        raise NotImplementedError

    @property
    def parts(self) -> tuple[Array, Array | None]:
        """A^T A; or a diagonal, and few rows whose Gram matrix it lacks."""
        return self.G, None

    def few(self, face: ActiveFace, C: Array) -> FewFace | None:
        """The face in the modes of few rows; None where there are many."""
        return None

    def dual_energy(self, delta: Array, h: Array) -> float:
        """Half of |A^-T delta|^2: what a gradient left over can lower half the objective by, anywhere.

        Where A is singular that has no bound; then what it lowers on the way from h to zero, |delta h|.
        """
        from scipy.linalg import solve_triangular

        if not np.any(delta):
            return 0.0
        if self.well and self._factor is not None:
            scaled = np.sqrt(self.tau) * delta
            return float(0.5 * np.sum(solve_triangular(self._factor, scaled, trans="T", check_finite=False) ** 2))
        if self._triangle is None:
            self._triangle = np.asarray(np.linalg.qr(self.A, mode="r"))
        R, diagonal = self._triangle, np.abs(np.diag(self._triangle))
        if len(R) < self.n or diagonal.min() <= self.n * EPS * diagonal.max():
            return float(np.abs(delta @ h))
        return float(0.5 * np.sum(solve_triangular(R, delta, trans="T") ** 2))

    def step(
        self, h: Array, b: Array, gradient: Array, face: ActiveFace, tau: Array, pull: Array,
        offset: Array, C: Array, short: Array,
    ) -> tuple[Array, Array] | None:  # fmt: skip
        """Minimiser on a face from `h`, with C times it fixed; and the multipliers of C. None: singular.

        Parameters
        ----------
        gradient : array, shape (n,)
            A^T (A h - b).
        tau : array, shape (n,)
            Step lengths by which the face was found.
        pull, offset : array, shape (n,)
            Proximal term ``pull * (step + offset)^2`` in (turned) unknowns; zero without.
        C, short : array, shape (rows, n), (rows,)
            Linear rows that hold, and what h lacks: C (step) = short.
        """
        ht, free = face.turn(h), ~face.held
        target = np.where(free, 0.0, face.turn(face.point))
        d0 = np.where(free, 0.0, target - ht)
        bend = face.curvature(tau)
        f = np.flatnonzero(free)
        stiff = (bend + pull)[f]
        lean = (bend * ht + pull * face.turn(offset))[f]  # gradient of the rows that the cones and the prox add
        Ct = face.columns(C)[:, f] if len(C) else C[:, f]
        if len(C):
            short = short - face.columns(C) @ d0
        if len(f) == 0:
            return face.back(ht + d0), np.zeros(len(C))
        solved = self._solve(face, f, h, d0, b, gradient, stiff, lean, Ct, short, bool(np.all(pull[f] > 0)))
        if solved is None:
            return None
        q, nu = solved
        ht = ht + d0
        ht[f] += q
        return face.back(ht), nu

    def _solve(
        self, face: ActiveFace, f: Index, h: Array, d0: Array, b: Array, gradient: Array, stiff: Array, lean: Array,
        Ct: Array, short: Array, pulled: bool,
    ) -> tuple[Array, Array] | None:  # fmt: skip
        """What the free unknowns are moved by, and the multipliers of the rows."""
        solved = (
            self._semi_normal(face, f, d0, gradient, stiff, lean)
            if self.well or pulled
            else self._orthogonal(face, f, d0, b - self.A @ h, stiff, lean)
        )
        if solved is None:
            return None
        q, R = solved
        return _onto_rows(q, R, Ct, short) if len(Ct) else (q, np.zeros(0))

    def _semi_normal(
        self, face: ActiveFace, f: Index, d0: Array, gradient: Array, stiff: Array, lean: Array
    ) -> tuple[Array, Array] | None:
        from scipy.linalg import lapack

        M = face.gram(self.G, f)
        M[np.arange(len(f)), np.arange(len(f))] += stiff
        if np.any(d0):
            gradient = gradient + (self.A @ face.back(d0)) @ self.A
        right = -face.turn(gradient)[f] - lean
        R, info = lapack.dpotrf(M, lower=0, clean=1, overwrite_a=1)
        return None if info else (lapack.dpotrs(R, right)[0], R)

    def _orthogonal(
        self, face: ActiveFace, f: Index, d0: Array, residual: Array, stiff: Array, lean: Array
    ) -> tuple[Array, Array] | None:
        from scipy.linalg import solve_triangular

        At = face.columns(self.A)
        curved = np.flatnonzero(stiff)
        rows = np.zeros((len(curved), len(f)))
        root = np.sqrt(stiff[curved])
        rows[np.arange(len(curved)), curved] = root
        right = np.concatenate([residual - At @ d0, -lean[curved] / root])
        Q, R = np.linalg.qr(np.vstack([At[:, f], rows]))
        diagonal = np.abs(np.diag(R))
        if len(R) < len(f) or diagonal.min() <= len(f) * EPS * diagonal.max():
            return None
        return solve_triangular(R, Q.T @ right), R

    def shrink(self, face: ActiveFace, C: Array) -> Array:
        """Factor S (n, directions) of the inverse Hessian on the face, S S^T, with the rows C held; of full rank.

        The curvature of the cones is in it: S S^T A^T is the derivative of the solution by b.
        """
        f = np.flatnonzero(~face.held)
        stiff = face.curvature(self.tau)[f]
        rows = np.diag(np.sqrt(stiff))[stiff > 0]
        R: Array = np.asarray(np.linalg.qr(np.vstack([face.columns(self.A)[:, f], rows]), mode="r"))
        V = None
        if len(C):
            V = _kernel(face.columns(C)[:, f])
            R = np.asarray(np.linalg.qr(R @ V, mode="r"))
        free = _right_inverse(R)
        S = np.zeros((self.n, free.shape[1]))
        S[f] = free if V is None else V @ free
        return face.back(S)


class CholeskyFactor:
    """Cholesky factor of the rows and columns whose weight is finite; LinAlgError where they are not definite."""

    def __init__(self, G: Array, weight: Array) -> None:
        from scipy.linalg import lapack

        self.free = np.flatnonzero(np.isfinite(weight))
        M = G.take(self.free, axis=0).take(self.free, axis=1).T  # symmetric: the transpose is in the order of LAPACK
        if np.any(weight[self.free]):
            M[np.arange(len(M)), np.arange(len(M))] += weight[self.free]
        if len(M):
            M, info = lapack.dpotrf(M, overwrite_a=1, clean=0)
            if info:
                raise np.linalg.LinAlgError("not positive definite")
        self.lower = M

    def solve(self, r: Array) -> Array:
        """Solution (size,), 0 where held."""
        from scipy.linalg import lapack

        out = np.zeros(len(r))
        if len(self.free):
            out[self.free] = lapack.dpotrs(self.lower, r[self.free])[0]
        return out


def _right_inverse(R: Array) -> Array:
    """S with S S^T the (pseudo-)inverse of R^T R, of full column rank."""
    from scipy.linalg import solve_triangular

    diagonal = np.abs(np.diag(R))
    if R.shape[0] == R.shape[1] and diagonal.min(initial=np.inf) > 100 * len(R) * EPS * diagonal.max(initial=0.0):
        return np.asarray(solve_triangular(R, np.eye(len(R))))
    s, Wt = np.linalg.svd(R, full_matrices=False)[1:]
    keep = s > max(R.shape) * EPS * s.max(initial=0.0)
    return np.asarray(Wt[keep].T / s[keep])


def _onto_rows(q: Array, R: Array, C: Array, short: Array) -> tuple[Array, Array]:
    """The step moved by the least energy so that C step = short, and the multipliers: gradient + C^T nu = 0."""
    from scipy.linalg import solve_triangular

    W = solve_triangular(R, C.T, trans="T")
    Q, T = np.linalg.qr(W)
    z = np.linalg.lstsq(T.T, short - C @ q, rcond=1e-13)[0]
    nu = -np.linalg.lstsq(T, z, rcond=1e-13)[0]
    return q + solve_triangular(R, Q @ z), nu


def _kernel(C: Array) -> Array:
    """Orthonormal null space of some rows."""
    s, Vt = np.linalg.svd(C, full_matrices=True)[1:]
    rank = int(np.sum(s > max(C.shape) * EPS * s.max(initial=0.0)))
    return Vt[rank:].T


def lengths(diagonal: Array, feasible: Feasible) -> Array:
    """Step lengths from the diagonal of A^T A: one per interval or contact."""
    for c in feasible.cones:
        diagonal[c.index] = np.max(diagonal[c.index], axis=1)[:, None]
    top = float(diagonal.max(initial=0.0)) or 1.0
    return 1 / np.maximum(diagonal, 1e-12 * top)


def gram_of(A: Array) -> Array:
    """A^T A, both triangles."""
    from scipy.linalg import blas

    upper = blas.dsyrk(1.0, np.asfortranarray(A, float), trans=1)
    return np.asarray(np.triu(upper) + np.triu(upper, 1).T)
