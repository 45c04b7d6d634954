"""A record cut into blocks: what each block answers to the state at its start and to its loads.

Within a block of b samples, with the state x at its start, its loads g stacked in time (b p) and everything linear,

    y = O_y x + T_y g,    w = L g = O_w x + T_w g,    x' = Phi x + Gamma g,

the normal equations of a record become those of blocks that touch each other through n states only ("partial
condensing": Axehill, J. Process Control 33 (2015) 1; Frison, Kouzoupis, Jorgensen & Diehl, ECC 2016).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..statespace.record import Record

LOADS = 48  # loads of a block: small factors are cheap, and the steps from block to block few
PADDING = -1  # kind of a sample behind the end of the record


@dataclass(frozen=True, eq=False)
class Blocks:
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

    pattern: NDArray[np.int_]
    members: tuple[NDArray[np.int_], ...]
    Phi: NDArray[np.float64]
    Gamma: NDArray[np.float64]
    Oy: NDArray[np.float64]
    Ty: NDArray[np.float64]
    Ow: NDArray[np.float64]
    Tw: NDArray[np.float64]
    y: NDArray[np.float64]
    samples: int
    p: int
    free: NDArray[np.int_]

    @property
    def count(self) -> int:
        """Blocks."""
        return len(self.pattern)

    @property
    def n(self) -> int:
        """States."""
        return self.Phi.shape[1]

    @property
    def width(self) -> int:
        """Loads of a block, b p."""
        return self.Gamma.shape[2]

    def each(self, matrices: NDArray, vectors: NDArray) -> NDArray[np.float64]:
        """Product of the matrix of each block's pattern (patterns, i, j) with the block's vector (blocks, j)."""
        out = np.empty((self.count, matrices.shape[1]))
        for matrix, rows in zip(matrices, self.members, strict=True):
            out[rows] = vectors[rows] @ matrix.T
        return out

    def split(self, g: NDArray) -> NDArray[np.float64]:
        """Loads (samples * p,) as (blocks, b p), with zeros behind the end."""
        out = np.zeros(self.count * self.width)
        out[: g.size] = g.reshape(-1)
        return out.reshape(self.count, self.width)

    def join(self, g: NDArray) -> NDArray[np.float64]:
        """Back from (blocks, b p) to (samples * p,)."""
        return g.reshape(-1)[: self.samples * self.p]

    def states(self, start: NDArray, g: NDArray) -> NDArray[np.float64]:
        """State at the start of each block and at the end (blocks + 1, n), from the free states and the loads."""
        x = np.zeros((self.count + 1, self.n))
        x[0, self.free] = start
        push = self.each(self.Gamma, g)
        for j, k in enumerate(self.pattern):
            x[j + 1] = self.Phi[k] @ x[j] + push[j]
        return x


def cut(record: Record) -> Blocks:
    """Blocks of a record."""
    p, m, n = record.p, record.m, record.n
    b = int(np.clip(LOADS // p, 4, max(4, record.samples)))
    count = -(-record.samples // b)
    kinds = np.full(count * b, PADDING)
    kinds[: record.samples] = record.kind
    found, pattern = np.unique(kinds.reshape(count, b), axis=0, return_inverse=True)
    pattern = pattern.reshape(-1)
    X, U = np.broadcast_to(np.eye(n), (len(found), n, n)), np.zeros((len(found), n, b * p))
    outputs: list[list[NDArray]] = [[], [], [], []]
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
    return Blocks(pattern, members, X, U, Oy, Ty, Ow, Tw, y.reshape(count, b * m), record.samples, p, record.free)
