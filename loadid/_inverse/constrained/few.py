"""The objective of few data for many loads, and its faces, solved in as many unknowns as there are data."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .feasible import Feasible
from .quadratic import FAIR, WELL, ActiveFace, Factor, Quadratic, gram_of, lengths

Array = NDArray[np.float64]
Index = NDArray[np.int_]


REFINEMENTS = 2  # of a step by the Gram matrix, each of which adds the digits that its condition leaves


class FewRows(Quadratic):
    """|C h - c|^2 + lam^2 |h|^2 with few rows C, far fewer than unknowns.

    Divided by the root of lam^2 and of what the cones add, which is diagonal, a face is I + W^T W with as few rows W:
    its steps are taken in so many unknowns, by the Gram matrix I + W W^T of the dual problem where it is well
    conditioned, else by the SVD of W (Golub & Van Loan, Matrix Computations, 4th ed., sections 2.1.4 and 6.1).

    Parameters
    ----------
    C : array, shape (rows, n)
        Modes that meet data; A holds them first, each with its share of the prior.
    shares : array, shape (rows,)
        Rows of A over those of C.
    lam : float
        Root of what the prior adds to the diagonal of A^T A, > 0.
    feasible : Feasible
    whole : callable
        Makes A, shape (n, n), where it is asked for.
    """

    exact, precision = True, 1e-14

    def __init__(
        self, C: Array, shares: Array, lam: float, feasible: Feasible, whole: Callable[[], Array]
    ) -> None:  # fmt: skip
        self.C, self.shares, self.lam2, self.n, self._whole = C, shares, lam**2, C.shape[1], whole
        own = np.einsum("ij,ij->j", C, C) + self.lam2
        self.tau = lengths(own, feasible)
        condition = self.lam2 / (self.lam2 + float(np.max(np.sum(C**2, axis=1), initial=0.0)))
        self.well, self.fair = condition > WELL, condition > FAIR

    @cached_property
    def A(self) -> Array:  # type: ignore[override]
        """The whole of A."""
        return np.asfortranarray(self._whole())

    @cached_property
    def G(self) -> Array:  # type: ignore[override]
        """A^T A."""
        return gram_of(self.A)

    def _data(self, b: Array) -> tuple[Array, Array | float]:
        """Data c of the rows C, and the gradient that b has beyond them (a prior that is perturbed)."""
        r = len(self.C)
        beyond = b[r:] @ self.A[r:] if np.any(b[r:]) else 0.0
        return b[:r] * self.shares, beyond

    def gradient(self, h: Array, b: Array) -> tuple[Array, float]:
        """A^T (A h - b), and the norm of A h."""
        (data, beyond), image = self._data(b), self.C @ h
        size = np.sqrt(image @ image + self.lam2 * (h @ h))
        return (image - data) @ self.C + self.lam2 * h - beyond, float(size)

    def apply(self, h: Array) -> Array:
        """A^T A h."""
        return np.asarray((self.C @ h) @ self.C + self.lam2 * h)

    def factor(self, weight: Array) -> Factor:
        """Factors of A^T A + diag(weight); where the weight is infinite, the unknown is held at 0."""
        return FewFactor(self.C, self.lam2, weight)

    @property
    def parts(self) -> tuple[Array, Array]:
        """The diagonal, and the rows."""
        return np.full(self.n, self.lam2), self.C

    def few(self, face: ActiveFace, C: Array) -> FewFace:
        """The face in the modes of few rows, with the rows C held."""
        f = np.flatnonzero(~face.held)
        return FewFace(face.columns(self.C)[:, f], self.lam2 + face.curvature(self.tau)[f], face.columns(C)[:, f])

    def dual_energy(self, delta: Array, h: Array) -> float:
        """Half of |A^-T delta|^2: what a gradient left over can lower half the objective by, anywhere."""
        free = FewFace(self.C, np.full(self.n, self.lam2), np.zeros((0, self.n)))
        return float(0.5 * delta @ -free.step(np.zeros(len(self.C)), delta, np.zeros(0))[0])

    def _solve(
        self, face: ActiveFace, f: Index, h: Array, d0: Array, b: Array, gradient: Array, stiff: Array, lean: Array,
        Ct: Array, short: Array, pulled: bool,
    ) -> tuple[Array, Array]:  # fmt: skip
        data, beyond = self._data(b)
        h = h + face.back(d0)
        slope = face.turn(self.lam2 * h - beyond)[f] + lean
        return FewFace(face.columns(self.C)[:, f], self.lam2 + stiff, Ct).step(self.C @ h - data, slope, short)


class FewFace:
    """A face of few rows: ``C^T C + diag(own)`` where rows E are held, in unknowns ``z = sqrt(own) x``.

    Parameters
    ----------
    C, E : array, shape (rows, f), (held rows, f)
    own : array, shape (f,)
        > 0.
    """

    def __init__(self, C: Array, own: Array, E: Array) -> None:
        self.root = np.sqrt(own)
        self.all = C / self.root
        self.Q, self.size, self.turn = np.zeros((len(own), 0)), np.zeros(0), np.zeros((0, len(E)))
        self.W = self.all
        if len(E):
            Q, size, turn = np.linalg.svd((E / self.root).T, full_matrices=False)
            keep = size > 1e-13 * size.max(initial=0.0)  # rows that follow from each other hold no more
            self.Q, self.size, self.turn = Q[:, keep], size[keep], turn[keep]
            self.W = self.all - (self.all @ self.Q) @ self.Q.T

    def step(self, rest: Array, slope: Array, short: Array) -> tuple[Array, Array]:
        """Minimiser x of ``|C x + rest|^2 + x own x + 2 slope x`` where ``E x = short``, and the multipliers of E."""
        p = slope / self.root
        fixed = self.Q @ ((self.turn @ short) / self.size)
        inside = p - self.Q @ (self.Q.T @ p)
        z = fixed - inside - self._back(rest + self.all @ fixed - self.W @ inside)
        for _ in range(0 if self._dual is None else REFINEMENTS):
            lacks = (rest + self.all @ z) @ self.all + z + p
            lacks = lacks - self.Q @ (self.Q.T @ lacks)
            z = z - lacks + self._back(self.W @ lacks)
        gradient = (rest + self.all @ z) @ self.all + z + p
        return z / self.root, -self.turn.T @ ((self.Q.T @ gradient) / self.size)

    def _back(self, rest: Array) -> Array:
        """W^T (I + W W^T)^-1 rest."""
        from scipy.linalg import lapack

        if self._dual is not None:
            return np.asarray(lapack.dpotrs(self._dual, rest)[0] @ self.W)
        U, s, V = self.modes
        return np.asarray((s / (1 + s**2) * (U.T @ rest)) @ V)

    @cached_property
    def _dual(self) -> Array | None:
        """Cholesky factor of I + W W^T where it is well conditioned."""
        from scipy.linalg import lapack

        K = self.W @ self.W.T
        K[np.arange(len(K)), np.arange(len(K))] += 1.0
        norm = float(np.abs(K).sum(axis=0).max())
        factor, info = lapack.dpotrf(K.T, overwrite_a=1)
        return factor if info == 0 and lapack.dpocon(factor, norm)[0] > WELL else None

    @cached_property
    def modes(self) -> tuple[Array, Array, Array]:
        """SVD of W."""
        U, s, V = np.linalg.svd(self.W, full_matrices=False)
        return U, s, V

    @property
    def passed(self) -> Array:
        """Share of each mode that comes from the data."""
        s = self.modes[1]
        return np.asarray(s**2 / (1 + s**2))

    @property
    def left(self) -> Array:
        """Share of each mode that comes from what is not data."""
        return np.asarray(1 / (1 + self.modes[1] ** 2))

    def change(self, slope: Array) -> float:
        """Norm of the minimiser of ``|C x|^2 + x own x - 2 slope x`` where E x = 0."""
        V, p = self.modes[2], slope / self.root
        p = p - self.Q @ (self.Q.T @ p)
        part = V @ p
        z = (self.left * part) @ V
        if len(V) < len(p):
            z += p - part @ V
        return float(np.linalg.norm(z / self.root))

    @property
    def factor(self) -> Array:
        """F (f, directions), the modes first: ``F F^T`` is the inverse of ``C^T C + diag(own)`` where E x = 0."""
        f, k = self.Q.shape
        modes = min(len(self.modes[2]), f - k)
        whole = np.linalg.qr(np.hstack([self.Q, self.modes[2][:modes].T]), mode="complete")[0][:, k:]
        whole[:, :modes] *= np.sqrt(self.left[:modes])
        return np.asarray(whole / self.root[:, None])


class FewFactor:
    """Solves with ``C^T C + lam2 + diag(weight)`` on the unknowns whose weight is finite."""

    def __init__(self, C: Array, lam2: float, weight: Array) -> None:
        self.free = np.flatnonzero(np.isfinite(weight))
        self.face = FewFace(C[:, self.free], lam2 + weight[self.free], np.zeros((0, len(self.free))))

    def solve(self, r: Array) -> Array:
        """Solution (size,), 0 where held."""
        out = np.zeros(len(r))
        out[self.free] = self.face.step(np.zeros(len(self.face.W)), -r[self.free], np.zeros(0))[0]
        return out
