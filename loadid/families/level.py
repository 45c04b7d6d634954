"""The noise level with which a band is made."""

from __future__ import annotations

import numpy as np

from ..inverse.choice import Choice, residual_level
from ..inverse.path import RegularizationPath
from .noise import Noise


def noise_level(path: RegularizationPath, choice: Choice, noise: Noise) -> float:
    """Stated level of the whitened noise, or what the residual shows where that is more or nothing was stated."""
    seen = residual_level(path, choice.lam)
    return max(noise.sigma or 0.0, seen or 0.0) or _last_resort(path, choice)


def _last_resort(path: RegularizationPath, choice: Choice) -> float:
    """Noise level where the fit leaves too little to tell: of the nearest larger lambda that leaves enough."""
    lam = np.geomspace(max(choice.lam, path.range[0]), max(10 * choice.lam, 1.0), 60)
    levels = (residual_level(path, float(x)) for x in lam)
    return next((level for level in levels if level is not None), float(np.sqrt(path.at(1.0).residual2 / path.m)))
