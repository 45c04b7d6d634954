"""The noise level with which a band is made."""

from __future__ import annotations

import numpy as np

from ..inverse.choice import Choice, residual_level
from ..inverse.path import RegularizationPath
from .noise import Noise

CHANCE = 0.05  # a residual this unlikely under the stated noise is model error


def noise_level(path: RegularizationPath, choice: Choice, noise: Noise) -> float:
    """Stated level of the whitened noise; what the residual shows where that is clearly more or nothing was stated."""
    seen = residual_level(path, choice.lam)
    if noise.sigma is None:
        return seen or _last_resort(path, choice)
    if seen is None or seen <= noise.sigma * _margin(path, choice.lam):
        return noise.sigma
    return seen


def _margin(path: RegularizationPath, lam: float) -> float:
    """How far the residual level exceeds the noise by chance, for the freedom that the fit leaves."""
    from scipy.special import gammaincinv

    left = path.at(lam).left
    freedom = 1.0 if left is None else max(float(left), 1.0)
    return float(np.sqrt(2 * gammaincinv(freedom / 2, 1 - CHANCE) / freedom))


def _last_resort(path: RegularizationPath, choice: Choice) -> float:
    """Noise level where the fit leaves too little to tell: of the nearest larger lambda that leaves enough."""
    lam = np.geomspace(max(choice.lam, path.range[0]), max(10 * choice.lam, 1.0), 60)
    levels = (residual_level(path, float(x)) for x in lam)
    return next((level for level in levels if level), float(np.sqrt(path.at(1.0).residual2 / path.m)))
