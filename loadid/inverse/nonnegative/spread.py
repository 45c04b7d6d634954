"""What is left open on a face: variance of every load and degrees of freedom, with the held loads held. O(N)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .normal import BlockFactor, gram


@dataclass(frozen=True, eq=False)
class Spread:
    """Posterior of a face at unit noise.

    Parameters
    ----------
    variance : array, shape (samples, loads)
        Diagonal of ``(Q on the free loads)^-1``; 0 where a load is held. Times sigma^2: posterior variance.
    edf : float
        tr A of the face: the divergence of ``H g`` by the data where the held loads stay held (Meyer & Woodroofe, Ann.
        Stat. 28 (2000) 1083).
    """

    variance: NDArray[np.float64]
    edf: float


def spread(factor: BlockFactor) -> Spread:
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
    return Spread(B.join(loads).reshape(B.samples, B.p), edf)
