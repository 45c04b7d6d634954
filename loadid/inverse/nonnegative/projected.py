"""Accelerated projected gradient over a record: many cheap steps towards the active set, where factors are costly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .normal import Normal

REPORT = 100  # steps between two reports


def projected(
    normal: Normal, signed: NDArray, start: NDArray, steps: int, report: Callable[[], None]
) -> NDArray[np.float64]:
    """Unknowns after some steps of FISTA with restart, >= 0 where signed.

    Beck & Teboulle, SIAM J. Imaging Sci. 2 (2009) 183; O'Donoghue & Candes, Found. Comput. Math. 15 (2015) 715.
    """
    x = z = np.where(signed, np.maximum(start, 0.0), start)
    t, length = 1.0, 1 / normal.reach
    for k in range(steps):
        if k % REPORT == 0:
            report()
        new = z - length * normal.gradient(z)
        new = np.where(signed, np.maximum(new, 0.0), new)
        if (z - new) @ (new - x) > 0:
            t = 1.0
        later = (1 + np.sqrt(1 + 4 * t * t)) / 2
        x, z, t = new, new + (t - 1) / later * (new - x), later
    return x
