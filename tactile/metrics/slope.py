"""How fast the error of a map grows with the noise of the markers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from structures.errors import InputError

from .settled import finite

LEVELS, DRAWS = 4, 10


@dataclass(frozen=True)
class NoiseSlope:
    """Straight line through relative error against marker noise.

    Parameters
    ----------
    slope, std : float
        Relative error per metre of marker noise, and its std from the scatter of the draws.
    intercept : float
        Error of the line at zero noise: what the model, the mesh and the prior cost. Regularised maps bend here.
    misfit : float
        Largest distance of a level's mean from the line, as share of the range of errors: beyond some 0.1 the relation
        is no line, and the slope holds for these levels only.
    levels : tuple of float
        Marker noise std (m).
    errors : tuple of float
        Mean relative error at each level.
    draws : int
        Of each level.
    """

    slope: float
    std: float
    intercept: float
    misfit: float
    levels: tuple[float, ...]
    errors: tuple[float, ...]
    draws: int

    def __str__(self) -> str:
        return (
            f"{1e-6 * self.slope:.4g} +- {1e-6 * self.std:.2g} per um of marker noise, {self.intercept:.3g} at none "
            f"({len(self.levels)} levels from {1e6 * min(self.levels):.3g} to {1e6 * max(self.levels):.3g} um, "
            f"{self.draws} draws each)"
        )


def noise_slope(levels: Any, errors: Any) -> NoiseSlope:
    """Fit relative error against marker noise.

    Parameters
    ----------
    levels : array (L,)
        Marker noise std (m); at least four different ones.
    errors : array (L, draws)
        Relative error of the map in each draw; at least ten draws.

    Raises
    ------
    InputError
        Too few levels or draws, or shapes that do not fit.
    """
    x, e = finite(levels, "levels"), finite(errors, "errors")
    if x.ndim != 1 or e.ndim != 2 or len(e) != len(x) or len(np.unique(x)) < LEVELS or e.shape[1] < DRAWS:
        raise InputError(
            "too little for a slope of error against noise",
            where="metrics.noise_slope",
            found=f"{len(np.unique(x))} levels, errors of shape {e.shape}",
            expected=f"at least {LEVELS} different levels, errors (levels, draws) of at least {DRAWS} draws",
            hint="for example noise of 2, 5, 10 and 20 um, ten draws each",
        )
    mean = e.mean(axis=1)
    away = x - x.mean()
    weight = away / np.sum(away**2)
    slope = float(weight @ mean)
    intercept = float(mean.mean() - slope * x.mean())
    reach = float(np.ptp(mean))
    off = float(np.abs(mean - intercept - slope * x).max())
    return NoiseSlope(
        slope,
        float(np.sqrt(weight**2 @ (e.var(axis=1, ddof=1) / e.shape[1]))),
        intercept,
        off / reach if reach > 0 else 0.0,
        tuple(x.tolist()),
        tuple(mean.tolist()),
        e.shape[1],
    )
