"""Normal equations of a record in blocks, with weights on its unknowns: products and solutions in O(N).

Within a block of b samples, with the state x at its start, its loads g stacked in time (b p) and everything linear,

    y = O_y x + T_y g,    w = L g = O_w x + T_w g,    x' = Phi x + Gamma g,

the normal equations of a record become those of blocks that touch each other through n states only ("partial
condensing": Axehill, J. Process Control 33 (2015) 1; Frison, Kouzoupis, Jorgensen & Diehl, ECC 2016).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..gaussian.record import WhitenedRecord
from .normal import SLACK

Array = NDArray[np.float64]
Index = NDArray[np.int_]

LOADS = 48  # loads of a block: small factors are cheap, and the steps from block to block few
PADDING = -1  # kind of a sample behind the end of the record


@dataclass(frozen=True, eq=False)
class CondensedRecord:
    """Blocks of a record; those with the same kinds of samples in the same order share a pattern.

    Parameters
    ----------
    pattern : array of int, shape (blocks,)
    members : tuple of array of int
        Blocks of each pattern.
    Phi, Gamma : array, shapes (patterns, n, n), (patterns, n, b p)
    Oy, Ty : array, shapes (patterns, b m, n), (patterns, b m, b p)
    Ow, Tw : array, shapes (patterns, b p, n), (patterns, b p, b p)
    y : array, shape (blocks, b m)
        Whitened data.
    samples, p : int
        Of the record.
    free : array of int
        States that start free.
    """

    pattern: Index
    members: tuple[Index, ...]
    Phi: Array
    Gamma: Array
    Oy: Array
    Ty: Array
    Ow: Array
    Tw: Array
    y: Array
    samples: int
    p: int
    free: Index

    @property
    def count(self) -> int:
        """Blocks."""
        return len(self.pattern)

    @property
    def n(self) -> int:
        """States."""
        return int(self.Phi.shape[1])

    @property
    def width(self) -> int:
        """Loads of a block, b p."""
        return int(self.Gamma.shape[2])

    def each(self, matrices: Array, vectors: Array) -> Array:
        """Product of the matrix of each block's pattern (patterns, i, j) with the block's vector (blocks, j)."""
        out = np.empty((self.count, matrices.shape[1]))
        for matrix, rows in zip(matrices, self.members, strict=True):
            out[rows] = vectors[rows] @ matrix.T
        return out

    def split(self, g: Array) -> Array:
        """Loads (samples * p,) as (blocks, b p), with zeros behind the end."""
        out = np.zeros(self.count * self.width)
        out[: g.size] = g.reshape(-1)
        return out.reshape(self.count, self.width)

    def join(self, g: Array) -> Array:
        """Back from (blocks, b p) to (samples * p,)."""
        return g.reshape(-1)[: self.samples * self.p]

    def states(self, start: Array, g: Array) -> Array:
        """State at the start of each block and at the end (blocks + 1, n), from the free states and the loads."""
        x = np.zeros((self.count + 1, self.n))
        x[0, self.free] = start
        push = self.each(self.Gamma, g)
        for j, k in enumerate(self.pattern):
            x[j + 1] = self.Phi[k] @ x[j] + push[j]
        return x


def cut(record: WhitenedRecord) -> CondensedRecord:
    """Blocks of a record."""
    p, m, n = record.p, record.m, record.n
    b = int(np.clip(LOADS // p, 4, max(4, record.samples)))
    count = -(-record.samples // b)
    kinds = np.full(count * b, PADDING)
    kinds[: record.samples] = record.kind
    found, pattern = np.unique(kinds.reshape(count, b), axis=0, return_inverse=True)
    pattern = pattern.reshape(-1)
    X, U = np.broadcast_to(np.eye(n), (len(found), n, n)), np.zeros((len(found), n, b * p))
    outputs: list[list[Array]] = [[], [], [], []]
    for t in range(b):
        kind, real = np.maximum(found[:, t], 0), (found[:, t] != PADDING)[:, None, None]
        F, G, C, D = record.F[kind], record.G[kind], record.C[kind] * real, record.D[kind] * real
        Wx, Wu = -record.E @ X, -record.E @ U
        Wu[:, :, t * p : (t + 1) * p] += np.eye(p)
        for rows, part in zip(outputs, (C @ X + D @ Wx, C @ U + D @ Wu, Wx * real, Wu * real), strict=True):
            rows.append(part)
        X, U = F @ X + G @ Wx, F @ U + G @ Wu
    Oy, Ty, Ow, Tw = (np.concatenate(rows, axis=1) for rows in outputs)
    y = np.zeros((count * b, m))
    y[: record.samples] = record.y
    order = np.argsort(pattern, kind="stable")
    members = tuple(np.split(order, np.cumsum(np.bincount(pattern, minlength=len(found)))[:-1]))
    return CondensedRecord(
        pattern, members, X, U, Oy, Ty, Ow, Tw, y.reshape(count, b * m), record.samples, p, record.free
    )


CHUNK = 512  # blocks worked on at once


class BlockNormal:
    """Normal equations of a record in blocks at one absolute lambda.

    A solution eliminates the loads of every block (all blocks at once), then runs over the blocks with the n states
    that join them, and puts the loads back. The Gram matrices of the blocks direct the steps; what is minimal is judged
    by `gradient`, and solutions are refined by it (corrected semi-normal equations: Björck, Linear Algebra Appl. 88/89
    (1987) 31): all digits down to a relative lambda of 1e-5, below which its square is rounding beside H^T H.

    Parameters
    ----------
    blocks : CondensedRecord
    lam : float
        Absolute lambda, > 0.
    """

    direct, precision, reach = True, 1e-12, np.inf

    def __init__(self, blocks: CondensedRecord, lam: float) -> None:
        self.blocks, self.lam = blocks, float(lam)
        B, lam2 = blocks, self.lam**2
        self.Hgg, self.Hgx = gram(B.Ty, B.Ty) + lam2 * gram(B.Tw, B.Tw), gram(B.Ty, B.Oy) + lam2 * gram(B.Tw, B.Ow)
        self.Hxx = gram(B.Oy, B.Oy) + lam2 * gram(B.Ow, B.Ow)

    @property
    def start(self) -> int:
        """Free states."""
        return len(self.blocks.free)

    @property
    def size(self) -> int:
        """Free states and loads."""
        return self.start + self.blocks.samples * self.blocks.p

    @cached_property
    def data2(self) -> float:
        """Squared norm of the whitened data."""
        return float(np.sum(self.blocks.y**2))

    @cached_property
    def q(self) -> Array:
        """H^T y."""
        return self._adjoint(self.blocks.y, np.zeros((self.blocks.count, self.blocks.width)))

    @cached_property
    def slack(self) -> float:
        """Gradient that is rounding."""
        return SLACK * float(np.abs(self.q).max(initial=0.0))

    def apply(self, v: Array) -> Array:
        """Q v: states forward, their adjoint backward."""
        return self._adjoint(*self._images(v))

    def gradient(self, v: Array) -> Array:
        """Q v - q, with the residual formed first: nothing that large numbers would hide is lost."""
        response, rough = self._images(v)
        return self._adjoint(response - self.blocks.y, rough)

    def _images(self, v: Array) -> tuple[Array, Array]:
        """H v and L v, block by block."""
        B, g = self.blocks, self.blocks.split(v[self.start :])
        x = B.states(v[: self.start], g)[:-1]
        return B.each(B.Oy, x) + B.each(B.Ty, g), B.each(B.Ow, x) + B.each(B.Tw, g)

    def _adjoint(self, response: Array, rough: Array) -> Array:
        """H^T response + lambda^2 L^T rough."""
        B = self.blocks

        def of(seen: Array, counted: Array) -> Array:
            back = B.each(seen.transpose(0, 2, 1), response)
            return back + self.lam**2 * B.each(counted.transpose(0, 2, 1), rough)

        back, mu = of(B.Oy, B.Ow), np.zeros((B.count + 1, B.n))
        for j in range(B.count - 1, -1, -1):
            mu[j] = back[j] + mu[j + 1] @ B.Phi[B.pattern[j]]
        g = of(B.Ty, B.Tw) + B.each(B.Gamma.transpose(0, 2, 1), mu[1:])
        return np.concatenate([mu[0, B.free], B.join(g)])

    def factor(self, weight: Array | None = None) -> BlockFactor:
        """Factors of ``Q + diag(weight)``; where the weight is infinite, the unknown is held at 0."""
        return BlockFactor(self, self._weights(weight))

    def norms(self, v: Array) -> tuple[float, float]:
        """Squared norms of ``y - H v`` and of ``L v``."""
        response, rough = self._images(v)
        return float(np.sum((self.blocks.y - response) ** 2)), float(np.sum(rough**2))

    def _weights(self, weight: Array | None) -> Array:
        """Weights (blocks, b p), infinite behind the end of the record."""
        B = self.blocks
        d = np.full(B.count * B.width, np.inf)
        d[: B.samples * B.p] = 0.0 if weight is None else weight[self.start :]
        return d.reshape(B.count, B.width)

    def scaled(self, d: Array) -> Iterator[tuple[slice, Array, Array]]:
        """Some blocks after others: ``t (Hgg + diag(d)) t``, of unit diagonal, and t (0 where a load is held)."""
        for a in range(0, self.blocks.count, CHUNK):
            part = slice(a, a + CHUNK)
            scaled = self.Hgg[self.blocks.pattern[part]]
            diagonal = np.einsum("jii->ji", scaled)
            t = 1 / np.sqrt(diagonal + d[part])
            scaled *= t[:, :, None]
            scaled *= t[:, None, :]
            diagonal[:] = 1.0
            yield part, scaled, t


class BlockFactor:
    """Factors of the normal equations of a record with weights ``d`` (blocks, b p): for one right side after another.

    With A = Phi - Gamma S Hgx, c = Gamma S Gamma^T and S = (Hgg + diag(d))^-1 of every block, the cost to go
    x^T P x / 2 - v^T x and the states at the joints obey

        P_j = Hxx - Hgx^T S Hgx + A^T P Z,    Z = (I + c P)^-1 A,    x_{j+1} = Z x_j + (I + c P)^-1 (Gamma S r_j + c v).
    """

    def __init__(self, normal: BlockNormal, d: Array) -> None:
        from scipy.linalg.lapack import dgesv

        self.normal, self.d = normal, d
        B, n = normal.blocks, normal.blocks.n
        self.Sx, self.Su = np.empty((2, B.count, B.width, n))
        for part, scaled, t in normal.scaled(d):
            k = B.pattern[part]
            right = np.concatenate([normal.Hgx[k], B.Gamma[k].transpose(0, 2, 1)], axis=2)
            found = t[:, :, None] * np.linalg.solve(scaled, t[:, :, None] * right)
            self.Sx[part], self.Su[part] = found[:, :, :n], found[:, :, n:]
        self.c, A, J = np.empty((3, B.count, n, n))
        for i, rows in enumerate(B.members):
            self.c[rows] = B.Gamma[i] @ self.Su[rows]
            A[rows] = B.Phi[i] - B.Gamma[i] @ self.Sx[rows]
            J[rows] = normal.Hxx[i] - normal.Hgx[i].T @ self.Sx[rows]
        self.P, self.Z = np.zeros((B.count + 1, n, n)), np.empty((B.count, n, n))
        eye = np.eye(n)
        for j in range(B.count - 1, -1, -1):
            self.Z[j] = dgesv(eye + self.c[j] @ self.P[j + 1], A[j])[2]
            P = J[j] + A[j].T @ (self.P[j + 1] @ self.Z[j])
            self.P[j] = (P + P.T) / 2

    def solve(self, r: Array) -> Array:
        """Solution v (size,) of ``(Q + diag(weight)) v = r``."""
        N, B, n = self.normal, self.normal.blocks, self.normal.blocks.n
        own, Sr = B.split(r[N.start :]), np.empty((B.count, B.width))
        for part, scaled, t in N.scaled(self.d):
            Sr[part] = t * np.linalg.solve(scaled, (t * own[part])[:, :, None])[:, :, 0]
        b, Zt = B.each(B.Gamma, Sr), self.Z.transpose(0, 2, 1)
        constant = -B.each(N.Hgx.transpose(0, 2, 1), Sr) - _times(Zt, _times(self.P[1:], b))
        v = np.zeros((B.count + 1, n))
        for j in range(B.count - 1, -1, -1):
            v[j] = constant[j] + Zt[j] @ v[j + 1]
        x, f = np.zeros((B.count + 1, n)), B.free
        if len(f):
            x[0, f] = np.linalg.solve(self.P[0][np.ix_(f, f)], v[0, f] + r[: N.start])
        push = np.linalg.solve(np.eye(n) + self.c @ self.P[1:], (b + _times(self.c, v[1:]))[:, :, None])[:, :, 0]
        for j in range(B.count):
            x[j + 1] = self.Z[j] @ x[j] + push[j]
        mu = _times(self.P[1:], x[1:]) - v[1:]
        g = Sr - _times(self.Sx, x[:-1]) - _times(self.Su, mu)
        return np.concatenate([x[0, f], B.join(g)])


def _times(matrices: Array, vectors: Array) -> Array:
    """Product of each matrix with its vector."""
    return (matrices @ vectors[:, :, None])[:, :, 0]


def gram(A: Array, B: Array) -> Array:
    """Inner products of the columns of A and of B, pattern by pattern."""
    return A.transpose(0, 2, 1) @ B


@dataclass(frozen=True, eq=False)
class FaceCovariance:
    """Posterior of a face at unit noise.

    Parameters
    ----------
    variance : array, shape (samples, loads)
        Diagonal of ``(Q on the free loads)^-1``; 0 where a load is held. Times sigma^2: posterior variance.
    edf : float
        tr A of the face: the divergence of ``H g`` by the data where the held loads stay held (Meyer & Woodroofe, Ann.
        Stat. 28 (2000) 1083).
    """

    variance: Array
    edf: float


def face_covariance(factor: BlockFactor) -> FaceCovariance:
    """Variance and degrees of freedom of the face whose factors these are.

    With M = Hgg + Gamma^T P Gamma and K = M^-1 (Hgx + Gamma^T P Phi) in every block, the covariance X of the state at
    its start gives that of its loads, ``M^-1 + K X K^T``, and of its response; X runs forward over the blocks.
    """
    N, B = factor.normal, factor.normal.blocks
    loads, states, f = np.empty((B.count, B.width)), np.empty((B.count + 1, B.n, B.n)), B.free
    K, pushed, own = np.empty((B.count, B.width, B.n)), np.empty((B.count, B.n, B.n)), np.empty(B.count)
    grams = gram(B.Ty, B.Ty)
    eye = np.eye(B.width)
    for part, scaled, t in N.scaled(factor.d):
        k = B.pattern[part]
        PG = factor.P[1:][part] @ (B.Gamma[k] * t[:, None, :])
        M = scaled + (B.Gamma[k] * t[:, None, :]).transpose(0, 2, 1) @ PG
        coupling = N.Hgx[k] * t[:, :, None] + PG.transpose(0, 2, 1) @ B.Phi[k]
        found = np.linalg.solve(M, np.concatenate([coupling, np.broadcast_to(eye, M.shape)], axis=2))
        K[part] = t[:, :, None] * found[:, :, : B.n]
        covariance = found[:, :, B.n :] * t[:, :, None] * t[:, None, :]
        loads[part] = np.einsum("jii->ji", covariance)
        own[part] = np.einsum("jab,jab->j", covariance, grams[k])
        pushed[part] = B.Gamma[k] @ covariance @ B.Gamma[k].transpose(0, 2, 1)
    states[0] = 0.0
    if len(f):
        states[0][np.ix_(f, f)] = np.linalg.solve(factor.P[0][np.ix_(f, f)], np.eye(len(f)))
    for j in range(B.count):
        states[j + 1] = factor.Z[j] @ states[j] @ factor.Z[j].T + pushed[j]
    X = states[:-1]
    loads += np.einsum("jgx,jgx->jg", K @ X, K)
    edf = float(own.sum())
    for pattern, rows in enumerate(B.members):
        seen = B.Oy[pattern] - B.Ty[pattern] @ K[rows]
        edf += float(np.einsum("jax,jax->", seen @ X[rows], seen))
    return FaceCovariance(B.join(loads).reshape(B.samples, B.p), edf)
