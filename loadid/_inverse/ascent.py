"""Where an evidence over places is the largest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
REACH = 0.2  # of a spacing, of the first steps
TOLERANCE, FLAT = 1e-3, 1e-2  # of a spacing, and of the evidence, below which a step is the last: a seventh of a std


def highest(
    evidence: Callable[[Array], float], start: Array, box: Array, spacing: float, *, rough: float = 1.0
) -> tuple[float, Array]:
    """The largest evidence near a start, and where it is: J. Nelder & R. Mead, Comput. J. 7 (1965) 308.

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

    step = np.where(start + REACH * spacing <= box[:, 1], REACH, -REACH) * spacing
    found = minimize(lambda at: -evidence(at), start, method="Nelder-Mead", bounds=box,
                     options={"initial_simplex": np.vstack([start, start + np.diag(step)]),
                              "xatol": rough * TOLERANCE * spacing, "fatol": rough * FLAT})  # fmt: skip
    return -float(found.fun), np.asarray(found.x)
