"""Which displacement sensors would show what the sensors at hand cannot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import NotIdentifiable
from structures.model import Model
from structures.placing import columns

MOST = 200_000  # degrees of freedom beyond which the best of an even selection is named


@dataclass(frozen=True)
class Cure:
    """A displacement sensor that is not there.

    Parameters
    ----------
    dof : str
        Where, ``"10+X"``.
    moves : float
        By how much (m) the load that is unseen, at one of its sizes, moves it for ever.
    """

    dof: str
    moves: float

    def __str__(self) -> str:
        return f"a displacement sensor at {self.dof}, which the unseen load moves by {self.moves:.3g} m"


def cures(model: Model, unseen: NDArray[np.float64], scale: NDArray[np.float64]) -> tuple[Cure, ...]:
    """The displacement sensors that together show every load that leaves no static trace, the best first.

    Parameters
    ----------
    model : Model
        A `ForwardModel` has places to offer; others have none.
    unseen : array, shape (p, r)
        Directions of the loads, in their sizes: `Observability.lacking`.
    scale : array, shape (p,)
        Sizes of the loads.

    Returns
    -------
    tuple of Cure
        As many as directions; empty where the model names no places, moves freely, or its loads move.

    Notes
    -----
    Greedy choice by column-pivoted QR of the static responses, as in P. Businger, G. H. Golub, "Linear least squares
    solutions by Householder transformations", Numerische Mathematik 7 (1965) 269-276.
    """
    from scipy.linalg import qr

    if model.structure is None or model.moving or not unseen.shape[1]:
        return ()
    structure = model.structure
    free = [i for i, index in enumerate(structure.free) if abs(structure.dofs[index].direction) <= 3]
    free = free[:: 1 + len(free) // MOST]
    B = columns(structure, model.loads if model.basis is None else model.basis)
    try:
        if (factor := model.factor) is None:
            return ()
        moved = factor.solve(B @ (np.asarray(scale, float)[:, None] * unseen))[free]
    except NotIdentifiable:
        return ()
    pivots = qr(moved.T, mode="r", pivoting=True)[1]
    chosen = [int(i) for i in pivots[: unseen.shape[1]]]
    found = [Cure(str(structure.dofs[structure.free[free[i]]]), float(np.linalg.norm(moved[i]))) for i in chosen]
    return tuple(cure for cure in found if cure.moves > 0)
