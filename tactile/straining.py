"""Strain of a pad under the maps of a stream: solved for now and then, by its ratio to the peak in between."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from structures.flags import Flag

from .guards.pad import large_strain

if TYPE_CHECKING:
    from .pad import Pad

LIKE = 1.2  # by how much a peak may change until its ratio to the strain is found anew
GROWN = 3.0  # by how much it may grow, however recent that was: what came before may have been noise
REST = 25  # frames between two solves, at least: a solve costs as much as many maps


class StrainWatch:
    """Guard W112 over frames. Strain is linear in the load: maps of one shape need one solve.

    Parameters
    ----------
    pad : Pad
    """

    def __init__(self, pad: Pad) -> None:
        self.pad = pad
        self._peak, self._ratio, self._rested = 0.0, 0.0, REST

    def check(self, forces: NDArray[np.float64]) -> Flag | None:
        """W112 of nodal forces (P, 3) in N, if the pad is strained beyond the linear range."""
        peak = float(np.abs(forces).max(initial=0.0))
        if peak == 0:
            return None
        self._rested += 1
        other = not self._peak / LIKE < peak < self._peak * LIKE
        if (other and self._rested > REST) or peak > GROWN * self._peak:
            self._peak, self._ratio = peak, float(np.abs(self.pad.strain(forces)).max()) / peak
            self._rested = 0
        return large_strain(self._ratio * peak)
