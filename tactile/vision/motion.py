"""Motion of the markers in one frame: what is seen, what is not, and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.flags import Flag


@dataclass(frozen=True)
class Motion:
    """Motion of the markers in one frame.

    Parameters
    ----------
    points : array, shape (N, 2)
        Places of the markers at rest, px, x to the right and y down; NaN where the last `zero` did not see one.
    moved : array, shape (N, 2)
        Motion from rest, px; NaN where it is not known.
    lost : array of bool, shape (N,)
        No dot near its prediction, or no place at rest.
    rejected : array of bool, shape (N,)
        A dot was there, but it moved too far, or unlike the neighbours.
    unmatched : int
        Dots of the frame that are no marker's.
    frame : int
        Number of the frame, from 1.
    flags : tuple of Flag
    """

    points: NDArray[np.float64]
    moved: NDArray[np.float64]
    lost: NDArray[np.bool_]
    rejected: NDArray[np.bool_]
    unmatched: int = 0
    frame: int = 0
    flags: tuple[Flag, ...] = ()

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Markers whose motion is known, shape (N,)."""
        return ~(self.lost | self.rejected)

    @property
    def places(self) -> NDArray[np.float64]:
        """Where the markers are now, px, shape (N, 2); NaN where not seen."""
        return self.points + self.moved
