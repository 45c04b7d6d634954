"""Strain of a pad under the maps of a stream: found exactly where it matters, by its ratio to the peak elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from structures.flags import Flag

from .guards.pad import LINEAR, large_strain

if TYPE_CHECKING:
    from .pad import Pad

LIKE = 1.5  # by how much a peak may change until its ratio to the strain is found anew
NEAR, CLOSE = 1.4, 1.05  # the same within a factor of the limit


class StrainWatch:
    """Guard W112 over frames: one solve for a new shape of load, none for the frames like it.

    Parameters
    ----------
    pad : Pad
    """

    def __init__(self, pad: Pad) -> None:
        self.pad = pad
        self._peak, self._ratio = 0.0, 0.0

    def check(self, forces: NDArray[np.float64]) -> Flag | None:
        """W112 of nodal forces (P, 3) in N, if the pad is strained beyond the linear range."""
        peak = float(np.abs(forces).max(initial=0.0))
        if peak == 0:
            return None
        near = LINEAR / NEAR < self._ratio * peak < LINEAR * NEAR
        like = CLOSE if near else LIKE
        if not self._peak / like < peak < self._peak * like:
            self._peak, self._ratio = peak, float(np.abs(self.pad.strain(forces)).max()) / peak
        return large_strain(self._ratio * peak)
