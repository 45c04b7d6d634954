"""Where an evidence over places is the largest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
REACH, TOLERANCE = 0.2, 3e-3  # of a spacing: radii of the trust region, at first and at last


def highest(
    evidence: Callable[[Array], float], start: Array, box: Array, spacing: float, *, rough: float = 1.0
) -> tuple[float, Array]:
    """The largest evidence near a start, and where it is, by quadratic models of it in a trust region.

    T. M. Ragonneau & Z. Zhang, COBYQA (2022); a simplex takes more than twice as many evaluations here.

    Parameters
    ----------
    evidence : callable
        Of a point (n,).
    start : array, shape (n,)
    box : array, shape (n, 2)
        Bounds.
    spacing : float
        Length of the coordinates.
    rough : float
        Times the tolerance.
    """
    from scipy.optimize import minimize

    found = minimize(lambda at: -evidence(at * spacing), start / spacing, method="COBYQA", bounds=box / spacing,
                     options={"initial_tr_radius": REACH, "final_tr_radius": rough * TOLERANCE})  # fmt: skip
    return -float(found.fun), np.clip(found.x * spacing, *box.T)
