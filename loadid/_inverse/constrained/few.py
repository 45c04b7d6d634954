"""The objective of few data for many loads, and its faces, solved in as many unknowns as there are data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..gaussian.compiled import Compiled
from .feasible import Feasible
from .quadratic import FAIR, WELL, ActiveFace, FaceFactor, Quadratic, gram_of, lengths

Array = NDArray[np.float64]
Index = NDArray[np.int_]


EPS = float(np.finfo(float).eps)
NARROW = 16  # columns that rows of a penalty reach over, at most
REFINEMENTS = 2  # of a step by the Gram matrix, each of which adds the digits that its condition leaves


class FewRows(Quadratic):
    """|C h - c|^2 + lam^2 |L h|^2 with few rows C, far fewer than unknowns, and L the identity or with a narrow band.

    Divided by the root of lam^2 L^T L and of what the cones add, a face is I + W^T W with as few rows W: its steps are
    taken in so many unknowns, by the Gram matrix I + W W^T of the dual problem where it is well conditioned, else by
    the SVD of W (Golub & Van Loan, Matrix Computations, 4th ed., sections 2.1.4 and 6.1).

    Parameters
    ----------
    C : array, shape (rows, n)
        Modes that meet data; A holds them first, each with its share of the prior.
    shares : array, shape (rows,)
        Rows of A over those of C.
    lam : float
        Absolute lambda, > 0.
    scale : float
        Lambda at which the prior weighs as much as the best seen mode.
    L : NarrowPenalty, optional
        Penalty of the unknowns; default the identity. With it there are no cones.
    feasible : Feasible
    whole : callable
        Makes A, shape (n, n), where it is asked for.
    """

    exact, precision = True, 1e-12

    def __init__(
        self, C: Array, shares: Array, lam: float, scale: float, feasible: Feasible, whole: Callable[[], Array],
        L: NarrowPenalty | None = None,
    ) -> None:  # fmt: skip
        self.C, self.shares, self.lam2, self.n, self._whole = C, shares, lam**2, C.shape[1], whole
        self.L, self.lam = L, lam
        self._last: tuple[Index, FewFace | None] = np.zeros(0, int), None
        own = 1.0 if L is None else L.own
        self.tau = lengths(np.einsum("ij,ij->j", C, C) + self.lam2 * own, feasible)
        condition = self.lam2 / (self.lam2 + scale**2)
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
        (data, beyond), image, rough = self._data(b), self.C @ h, self.rough(h)
        size = np.sqrt(image @ image + h @ rough)
        return (image - data) @ self.C + rough - beyond, float(size)

    def rough(self, h: Array) -> Array:
        """Gradient of the prior, lam^2 L^T L h."""
        return self.lam2 * (h if self.L is None else self.L.back @ (self.L.rows @ h))

    def apply(self, h: Array) -> Array:
        """A^T A h."""
        return np.asarray((self.C @ h) @ self.C + self.rough(h))

    def factor(self, weight: Array) -> FaceFactor:
        """Factors of A^T A + diag(weight); where the weight is infinite, the unknown is held at 0."""
        return FewFactor(self, weight)

    @property
    def parts(self) -> tuple[Array, Array]:
        """The prior, a diagonal or a matrix, and the rows."""
        return np.full(self.n, self.lam2) if self.L is None else self.lam2 * gram_of(self.L.rows.toarray()), self.C

    def root(self, f: Index, more: Array) -> Root:
        """Root of the prior with a diagonal that the unknowns `f` have besides."""
        if self.L is None:
            return Scales(np.sqrt(self.lam2 + more))
        return Band.of(self.L.rows, f, self.lam, np.sqrt(more), self.L.width)

    def face(self, f: Index) -> FewFace:
        """That of the unknowns `f`, where no cone bends it and no row is held: exchange, check and tangent share it."""
        if self._last[1] is None or not np.array_equal(self._last[0], f):
            found = FewFace(self.C[:, f], self.root(f, np.zeros(len(f))), np.zeros((0, len(f))))
            self._last = f, found
            return found
        return self._last[1]

    def _face(self, face: ActiveFace, f: Index, stiff: Array, E: Array) -> FewFace:
        if not (face.turns or len(E) or np.any(stiff)):
            return self.face(f)
        return FewFace(face.columns(self.C)[:, f], self.root(f, stiff), E)

    def few(self, face: ActiveFace, C: Array) -> FewFace | None:
        """The face in the modes of few rows, with the rows C held; None where these meet what no penalty sees."""
        f = np.flatnonzero(~face.held)
        found = self._face(face, f, face.curvature(self.tau)[f], face.columns(C)[:, f])
        return None if len(C) and len(found.free) else found

    def dual_energy(self, delta: Array, h: Array) -> float:
        """Half of |A^-T delta|^2: what a gradient left over can lower half the objective by, anywhere."""
        free = FewFace(self.C, self.root(np.arange(self.n), np.zeros(self.n)), np.zeros((0, self.n)))
        return float(0.5 * delta @ -free.step(np.zeros(len(self.C)), delta, np.zeros(0))[0])

    def _solve(
        self, face: ActiveFace, f: Index, h: Array, d0: Array, b: Array, gradient: Array, stiff: Array, lean: Array,
        Ct: Array, short: Array, pulled: bool,
    ) -> tuple[Array, Array]:  # fmt: skip
        data, beyond = self._data(b)
        h = h + face.back(d0)
        slope = face.turn(self.rough(h) - beyond)[f] + lean
        return self._face(face, f, stiff, Ct).step(self.C @ h - data, slope, short)


class Root(Protocol):
    """Root R of a prior, R^T R, with the unknowns that it leaves free grounded."""

    free: Index  # unknowns z = R x that the prior does not see

    def rows(self, V: Array) -> Array:
        """V R^-1 of rows V (..., f)."""
        ...

    def up(self, z: Array) -> Array:
        """R^-1 z."""
        ...


class Scales:
    """A diagonal one."""

    free = np.zeros(0, int)

    def __init__(self, root: Array) -> None:
        self.root = root

    def rows(self, V: Array) -> Array:
        """V R^-1 of rows V (..., f)."""
        return np.asarray(V / self.root)

    def up(self, z: Array) -> Array:
        """R^-1 z."""
        return np.asarray((z.T / self.root).T)


class Band:
    """A triangle with a band, shape (f, band), by Givens rotations of the rows of a sparse penalty."""

    def __init__(self, R: Array, free: Index) -> None:
        self.R, self.free = R, free

    @classmethod
    def of(cls, L: Any, f: Index, lam: float, diagonal: Array, band: int | None = None) -> Band:
        """Of the columns `f` of ``lam L`` with a diagonal below; `band` is its width, where that is known."""
        place = np.full(L.shape[1], -1)
        place[f] = np.arange(len(f))
        R = np.zeros((len(f), width(L) if band is None else band))
        R[:, 0] = diagonal
        rotate(L.indptr, L.indices, lam * L.data, place, R)
        free = R[:, 0] == 0.0
        R[free, 0] = np.abs(R[:, 0]).max(initial=0.0) or 1.0
        return cls(R, np.flatnonzero(free))

    def rows(self, V: Array) -> Array:
        """V R^-1 of rows V (..., f)."""
        out = np.array(np.atleast_2d(V).T, float, order="C")
        down(self.R, out)
        return out.T if V.ndim > 1 else out[:, 0]

    def up(self, z: Array) -> Array:
        """R^-1 z."""
        out = np.array(z.reshape(len(z), -1), float, order="C")
        back(self.R, out)
        return out.reshape(z.shape)


@dataclass(frozen=True, eq=False)
class NarrowPenalty:
    """Sparse rows of a penalty, with what every lambda asks of them."""

    rows: Any

    @cached_property
    def back(self) -> Any:
        """Transpose."""
        return self.rows.T

    @cached_property
    def own(self) -> Array:
        """Squared length of each column."""
        return np.asarray((self.rows * self.rows).sum(axis=0)).ravel()

    @cached_property
    def width(self) -> int:
        """See the function."""
        return width(self.rows)


def width(L: Any) -> int:
    """Columns from the first to the last of a sparse row, at most."""
    rows = np.diff(L.indptr) > 0
    if not np.any(rows):
        return 1
    starts = L.indptr[:-1][rows]
    return int((np.maximum.reduceat(L.indices, starts) - np.minimum.reduceat(L.indices, starts)).max()) + 1


@Compiled
def rotate(indptr: Index, indices: Index, data: Array, place: Index, R: Array) -> None:
    """Rotate the sparse rows into the triangle R (f, band); what a pivot lacks goes on to the later rows."""
    n, band = R.shape
    row, least = np.zeros(n + band), 0.0
    for i in range(len(indptr) - 1 + n):
        last = i - len(indptr) + 1
        if last == 0:
            least = 100 * n * EPS * np.abs(R[:, 0]).max()
        first = n
        if last < 0:
            for k in range(indptr[i], indptr[i + 1]):
                j = place[indices[k]]
                if j >= 0:
                    row[j] += data[k]
                    first = min(first, j)
        elif abs(R[last, 0]) <= least:
            R[last, 0] = 0.0
            for k in range(1, band):
                row[last + k] = R[last, k]
                R[last, k] = 0.0
            first = last + 1
        for j in range(first, n):
            a, b = R[j, 0], row[j]
            if b == 0.0:
                done = True
                for k in range(1, band):
                    done = done and row[j + k] == 0.0
                if done:
                    break
                continue
            r = np.hypot(a, b)
            c, s = a / r, b / r
            for k in range(band):
                x, y = R[j, k], row[j + k]
                R[j, k] = c * x + s * y
                row[j + k] = c * y - s * x
            row[j] = 0.0


@Compiled
def down(R: Array, X: Array) -> None:
    """Put R^-T X into X, for the triangle R (f, band)."""
    n, band = R.shape
    for j in range(n):
        for k in range(max(0, j - band + 1), j):
            a = R[k, j - k]
            if a != 0.0:
                for c in range(X.shape[1]):
                    X[j, c] -= a * X[k, c]
        a = 1.0 / R[j, 0]
        for c in range(X.shape[1]):
            X[j, c] *= a


@Compiled
def back(R: Array, X: Array) -> None:
    """Put R^-1 X into X, for the triangle R (f, band)."""
    n, band = R.shape
    for i in range(n):
        j = n - 1 - i
        for k in range(1, min(band, n - j)):
            a = R[j, k]
            if a != 0.0:
                for c in range(X.shape[1]):
                    X[j, c] -= a * X[j + k, c]
        a = 1.0 / R[j, 0]
        for c in range(X.shape[1]):
            X[j, c] *= a


class FewFace:
    """A face of few rows: ``C^T C + R^T R`` where rows E are held, in unknowns ``z = R x``.

    What the prior leaves free, as many rows see: turned so that no other does, they are its prior (Elden, BIT 17 (1977)
    134, for this standard form).

    Parameters
    ----------
    C, E : array, shape (rows, f), (held rows, f)
    root : Root
    """

    def __init__(self, C: Array, root: Root, E: Array) -> None:
        self.root, self.free = root, root.free
        self.all = root.rows(C)
        if len(self.free):
            self._ground()
        self.W = self.all
        self.Q, self.size, self.turn = np.zeros((self.all.shape[1], 0)), np.zeros(0), np.zeros((0, len(E)))
        if len(E):
            Q, size, turn = np.linalg.svd(self._rows(E).T, full_matrices=False)
            keep = size > 1e-13 * size.max(initial=0.0)  # rows that follow from each other hold no more
            self.Q, self.size, self.turn = Q[:, keep], size[keep], turn[keep]
            self.W = self.all - (self.all @ self.Q) @ self.Q.T

    def _ground(self) -> None:
        """Take the rows that see what the prior leaves free for its unknowns: ``y = seen z``."""
        k, self._old = len(self.free), self.all
        self._P, T = np.linalg.qr(self.all[:, self.free], mode="complete")
        turned = self._P.T @ self.all
        self._seen, self._T = turned[:k].copy(), T[:k]
        self._seen[:, self.free] = 0.0
        self.all = turned
        self.all[:k] = 0.0
        self.all[:, self.free] = 0.0

    def _rows(self, V: Array) -> Array:
        """Rows, or one, of the unknowns x, for the unknowns z."""
        V = np.array(self.root.rows(V))
        if len(self.free):
            own = np.linalg.solve(self._T.T, V[..., self.free].T).T
            V -= own @ self._seen
            V[..., self.free] = own
        return V

    def _up(self, z: Array) -> Array:
        """Unknowns x of z."""
        if len(self.free):
            z = np.array(z)
            z[self.free] = np.linalg.solve(self._T, z[self.free] - self._seen @ z)
        return self.root.up(z)

    def step(self, rest: Array, slope: Array, short: Array) -> tuple[Array, Array]:
        """Minimiser x of ``|C x + rest|^2 + |R x|^2 + 2 slope x`` where ``E x = short``, and the multipliers of E."""
        p = self._rows(slope)
        if len(self.free):
            rest = self._P.T @ rest
            p[self.free] += rest[: len(self.free)]
            rest[: len(self.free)] = 0.0
        fixed = self.Q @ ((self.turn @ short) / self.size)
        inside = p - self.Q @ (self.Q.T @ p)
        z = fixed - inside - self._back(rest + self.all @ fixed - self.W @ inside)
        for _ in range(0 if self._dual is None else REFINEMENTS):
            lacks = (rest + self.all @ z) @ self.all + z + p
            lacks = lacks - self.Q @ (self.Q.T @ lacks)
            lacks -= self._back(self.W @ lacks)
            z = z - lacks
            if np.abs(lacks).max() <= EPS * np.abs(z).max():
                break
        if not len(self.size):
            return self._up(z), np.zeros(len(short))
        gradient = (rest + self.all @ z) @ self.all + z + p
        return self._up(z), -self.turn.T @ ((self.Q.T @ gradient) / self.size)

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

    @cached_property
    def sizes(self) -> Array:
        """Singular values of W."""
        wide = self.W.shape[1] > len(self.W)
        return np.asarray(np.linalg.svd(np.linalg.qr(self.W.T, mode="r") if wide else self.W, compute_uv=False))

    @property
    def passed(self) -> Array:
        """Share of each mode that comes from the data: first those that the prior leaves free."""
        s = self.sizes[: self._count]
        return np.concatenate([np.ones(len(self.free)), s**2 / (1 + s**2)])

    @property
    def left(self) -> Array:
        """Share of each mode that comes from what is not data."""
        return np.concatenate([np.zeros(len(self.free)), 1 / (1 + self.sizes[: self._count] ** 2)])

    @property
    def _count(self) -> int:
        """Modes besides those that the prior leaves free."""
        return min(len(self.sizes), len(self.W) - len(self.free), self.W.shape[1] - self.Q.shape[1] - len(self.free))

    def change(self, slope: Array) -> float:
        """Norm of the minimiser of ``|C x|^2 + |R x|^2 - 2 slope x`` where E x = 0."""
        if self._dual is not None:
            return float(np.linalg.norm(self.step(np.zeros(len(self.W)), -slope, np.zeros(self.turn.shape[1]))[0]))
        V, p = self.modes[2], self._rows(slope)
        p = p - self.Q @ (self.Q.T @ p)
        part = V @ p
        z = (part / (1 + self.modes[1] ** 2)) @ V
        if len(V) < len(p):
            z += p - part @ V
        return float(np.linalg.norm(self._up(z)))

    @property
    def factor(self) -> Array:
        """F (f, directions), the modes first: ``F F^T`` is the inverse of ``C^T C + R^T R`` where E x = 0."""
        ground = np.zeros((self.W.shape[1], len(self.free)))
        ground[self.free, np.arange(len(self.free))] = 1.0
        first = np.hstack([self.Q, ground, self.modes[2][: self._count].T])
        whole = np.linalg.qr(first, mode="complete")[0][:, self.Q.shape[1] :]
        whole[:, len(self.free) : len(self.left)] *= np.sqrt(self.left[len(self.free) :])
        return self._up(whole)


class FewFactor:
    """Solves with ``A^T A + diag(weight)`` on the unknowns whose weight is finite."""

    def __init__(self, rows: FewRows, weight: Array) -> None:
        self.free = np.flatnonzero(np.isfinite(weight))
        more = weight[self.free]
        self.face = rows.face(self.free) if not np.any(more) else FewFace(
            rows.C[:, self.free], rows.root(self.free, more), np.zeros((0, len(self.free))))  # fmt: skip

    def solve(self, r: Array) -> Array:
        """Solution (size,), 0 where held."""
        out = np.zeros(len(r))
        if not len(self.free):
            return out
        out[self.free] = self.face.step(np.zeros(len(self.face.W)), -r[self.free], np.zeros(0))[0]
        return out
