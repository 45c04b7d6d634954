"""The noise level: with which a band is made, and above which a residual says that the load explains nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import flags as guards
from ..estimate import LoadEstimate
from ..inverse.choice import Choice, residual_level, unexplained, ungraded
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


def graded(estimate: LoadEstimate, level: float | None) -> LoadEstimate:
    """The estimate; with the worst grade and W412 first where its residual is `level` times what noise leaves."""
    if level is None or estimate.choice is None:
        return estimate
    flag = guards.unexplained(estimate.choice, level)
    return replace(estimate, choice=ungraded(estimate.choice), flags=(flag, *estimate.flags))


def unexplained_by(path: RegularizationPath, lam: float, noise: Noise) -> float | None:
    """Residual at one lambda over the stated noise, where noise alone never leaves so much."""
    return None if noise.sigma is None else unexplained(float(path.at(lam).residual2), path.m, noise.sigma)


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
