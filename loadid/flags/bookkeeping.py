"""Guards of bookkeeping: operators without coupling, a lambda that carries units, a lambda that changes per frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.flags import Evidence, Flag

UNCOUPLED = 0.0  # entries off the one of each row, relative to the largest


def diagonal(H: NDArray[np.float64]) -> InputError | None:
    """E102: a transfer matrix without any coupling, f_i proportional to u_i, on more than one load."""
    seen = np.abs(H) > UNCOUPLED
    if min(H.shape) < 2 or np.any(seen.sum(axis=1) > 1) or np.any(seen.sum(axis=0) > 1):
        return None
    n = H.shape[1]
    return InputError(
        f"the transfer matrix is diagonal: none of its {H.size - int(seen.sum())} off-diagonal entries differs from 0, "
        "and force would be painted wherever there is motion",
        where="StaticInversion",
        found=f"no coupling among {n} loads",
        expected="a model in which a load moves its neighbours too",
        hint="assemble the stiffness of the whole body (structures.solids, plates, beams)",
        code="LID-E102",
    )


def absolute_lambda(lam: float, scale: float) -> Flag:
    """W307: lambda was given as an absolute value."""
    return Flag(
        "W307",
        Evidence("absolute lambda", lam, "relative"),
        f"lambda {lam:.3g} is absolute (relative {lam / scale:.3g}): with another modulus, unit or scaling the same "
        "value changes the shape of the load, not only its gain",
        f"use the relative value {lam / scale:.3g}, which goes with the problem",
    )


def changing_lambda(lams: Sequence[float]) -> Flag | None:
    """W409: lambda was chosen anew for each frame."""
    used = np.array([x for x in lams if x > 0])
    if len(set(lams)) < 2:  # one frame, or a lambda that was fixed before
        return None
    spread = float(np.ptp(np.log10(used))) if len(used) else 0.0
    return Flag(
        "W409",
        Evidence("spread of lambda over the frames, decades", spread, 0.0),
        f"lambda changes per frame ({len(lams)} frames, {spread:.2g} decades): frames are not comparable",
        "calibrate([...]) once and freeze(), or leave joint=True",
    )
