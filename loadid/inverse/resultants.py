"""Values of resultants: whitened rows of those that are measured, right sides of those that are exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import plain

from .constraints import Constraint, Resultant
from .feasible import Feasible


def soft(constraints: Sequence[Constraint]) -> list[Resultant]:
    """The resultants that have a covariance."""
    return [c for c in constraints if isinstance(c, Resultant) and not c.hard]


def whitening(c: Resultant, sigma: float) -> NDArray[np.float64]:
    """Rows W with W^T W = sigma^2 covariance^-1."""
    from scipy.linalg import solve_triangular

    covariance = np.asarray(c.covariance)
    return sigma * solve_triangular(np.linalg.cholesky(covariance), np.eye(len(covariance)), lower=True)


def resultants_of(constraints: Sequence[Constraint], new: Sequence[ArrayLike] | None) -> list[NDArray]:
    """Values of all resultant constraints, in order; `new` replaces them."""
    own = [np.asarray(c.value) for c in constraints if isinstance(c, Resultant)]
    if new is None:
        return own
    values = [np.atleast_1d(np.asarray(plain(v), float)) for v in new]
    sizes = [len(v) for v in values] == [len(v) for v in own]
    if not sizes or not all(np.all(np.isfinite(v)) for v in values):
        raise InputError("the resultants do not fit", where="resultants", found=[v.shape for v in values],
                         expected=f"finite, {[v.shape for v in own]}")  # fmt: skip
    return values


def soft_values(
    constraints: Sequence[Constraint], values: Sequence[NDArray], sigma: float, frames: int
) -> list[NDArray[np.float64]]:
    """Whitened values of the soft resultants, (R, frames) each.

    Raises
    ------
    InputError
        If their frames are not those of the data.
    """
    out = []
    for c, v in zip([c for c in constraints if isinstance(c, Resultant)], values, strict=True):
        if v.ndim == 2 and v.shape[1] != frames:
            raise InputError("the resultants have other frames than the data", where="Resultant",
                             found=v.shape[1], expected=frames)  # fmt: skip
        if not c.hard:
            each = np.broadcast_to(v[:, None], (len(v), frames)) if v.ndim == 1 else v
            out.append(whitening(c, sigma) @ each)
    return out


def with_values(feasible: Feasible, values: Sequence[NDArray]) -> Feasible:
    """The set with these values of its exact resultants."""
    rows = feasible.equal
    if not len(rows):
        return feasible
    picked = [
        values[feasible.resultants.index(int(n))][int(i)] / w
        for n, i, w in zip(rows.source, rows.place, rows.norm, strict=True)
    ]
    framed = [np.ndim(v) for v in picked]
    if any(framed):
        size = next(len(v) for v in picked if np.ndim(v))
        picked = [np.broadcast_to(v, (size,)) for v in picked]
    return replace(feasible, equal=replace(rows, value=np.array(picked)))
