"""Riccati maps and their composition in root form: 2^k samples in k steps.

A sample maps the predicted covariance P to ``L L^T + F P (I + M M^T P)^-1 F^T``; with ``M M^T = H^T R^-1 H`` and
``L L^T = Q``. Maps of this form are closed under composition, so that samples of any kind can be joined and a map
doubled. Chu, Fan, Lin & Wang, Int. J. Control 77 (2004) 767, for the doubling; here X and G are carried as roots, which
stay positive and feel no scale of the states.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .roots import forward, lower

DOUBLINGS = 40
SETTLED = 1e-14  # share of a variance that a doubling may still add


@dataclass(frozen=True, eq=False)
class Riccati:
    """``P -> L L^T + F P (I + M M^T P)^-1 F^T``; F (n, n), L (n, any), M (n, any)."""

    F: NDArray[np.float64]
    L: NDArray[np.float64]
    M: NDArray[np.float64]


def composed(first: Riccati, second: Riccati) -> tuple[Riccati, NDArray[np.float64]]:
    """`second` after `first`, and the root (n, any) of what `first` adds to the variance of `second`."""
    S = second.M.T @ first.L
    right = lower(np.eye(S.shape[1]), S.T)  # right right^T = I + S^T S
    left = lower(np.eye(S.shape[0]), S)
    carried = forward(right, first.L.T).T  # root of X (I + G X)^-1
    told = forward(left, second.M.T).T  # root of G (I + X G)^-1
    through = first.F - carried @ forward(right, S.T @ (second.M.T @ first.F))
    added = second.F @ carried
    return Riccati(second.F @ through, lower(added, second.L), lower(first.M, first.F.T @ told)), added


def fixed_point(step: Riccati, doublings: int = DOUBLINGS) -> tuple[NDArray[np.float64], int, bool]:
    """Root of the covariance that the map reaches from zero; doublings taken, and whether it settled.

    The root after k doublings is that after 2^k samples: a variance without bound shows itself by growing on.
    """
    for k in range(1, doublings + 1):
        with np.errstate(all="ignore"):  # what grows on without bound ends as inf
            step, added = composed(step, step)
        if not np.all(np.isfinite(step.L)):
            return step.L, k, False
        total = np.sum(step.L**2, axis=1)
        if np.all(np.sum(added**2, axis=1) <= SETTLED * total):
            return step.L, k, True
    return step.L, doublings, False


def joined(first: Riccati, second: Riccati) -> Riccati:
    """`second` after `first`."""
    return composed(first, second)[0]
