"""The noise level: whether the data contradict a stated one, and which the residual shows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from . import Array
from .path import PathPoint, RegularizationPath
from .problem import NoiseSource
from .sweep import RuleResult, Sweep

CHANCE, CLEARLY = 1e-2, 1.3  # of a residual so far above the stated noise; and how far at least
EXCESS = 1e-3  # chance of a residual so far above the noise that the load does not explain its data
FACTOR, LARGER = 30.0, 100.0  # Bayes factor that counts as strong; largest noise level that is tried, over the stated
SPARE, TESTED = 0.2, 10  # share of the data, or number, that a fit leaves for the test of the stated noise level
BELOW_BY = 3.0  # steps of lambda below a sweep over a part of the range


def contradicted(sweep: Sweep, asked: Mapping[str, RuleResult], source: NoiseSource) -> float | None:
    """Noise level that the data show, where chance cannot explain that it is above the stated one.

    White noise above the stated level shows in the residual of every fit; a load that its penalty does not expect only
    in those that smooth too much. So every lambda must contradict whose fit leaves `TESTED` data, or `SPARE` of them:
    by a chi-square test at `CHANCE` with those degrees of freedom, and by a factor of at least `CLEARLY`. None where
    few data can all be spent on the load, so that every fit that leaves some may be smoother than it, and the evidence
    does not ask for more noise either (as in `implausible`); where robust GCV, which would have to stand in, found no
    optimum or one that spends more (a fit that leaves enough is then smoother than the load, and leaves some of it);
    and where the level itself was estimated from the misfit of the model (kind ``residual``).
    """
    path, sigma, found, left = sweep.path, sweep.sigma, asked["robust_gcv"], sweep.point.left
    if sigma is None or left is None or found.lam is None or found.edge or source.kind == "residual":
        return None
    enough = np.flatnonzero(left >= SPARE * path.m)
    if not len(enough) or sweep.lam[enough[0]] > found.lam:
        return None
    least = min(SPARE * path.m, TESTED)
    if left[0] < 1 and least < TESTED and (more := _level_asked_for(sweep)) is not None and more[1] < np.log(FACTOR):
        return None
    level, margin = _levels(sweep, np.flatnonzero(left >= least))
    if np.any(level <= margin * sigma) or _agrees_below(sweep, least):
        return None
    return float(level.min())


def _agrees_below(sweep: Sweep, least: float) -> bool:
    """Whether a lambda below those of a sweep over a part of the range agrees with the stated noise level."""
    assert sweep.point.left is not None
    assert sweep.sigma is not None
    low, lam, left = sweep.path.range[0], float(sweep.lam[0]), float(sweep.point.left[0])
    while left >= least and lam > low:
        lam = max(lam / BELOW_BY, low)
        lower = Sweep(sweep.path, np.array([lam]), sweep.path.at(np.array([lam])), sweep.sigma, whole=False)
        assert lower.point.left is not None
        left = float(lower.point.left[0])
        level, margin = _levels(lower, np.flatnonzero(lower.point.left >= least))
        if np.any(level <= margin * sweep.sigma):
            return True
    return False


def _passed(sweep: Sweep) -> bool:
    """Whether the stated noise level agrees with a residual of `TESTED` data or more."""
    if sweep.point.left is None or sweep.sigma is None:
        return False
    level, margin = _levels(sweep, np.flatnonzero(sweep.point.left >= TESTED))
    return bool(np.any(level <= margin * sweep.sigma))


def _levels(sweep: Sweep, at: NDArray[np.intp]) -> tuple[Array, Array]:
    """Noise level that the residual shows at some lambdas of a sweep, and how far above the true one it may be."""
    from scipy.special import gammaincinv

    assert sweep.point.left is not None
    freedom = sweep.point.left[at]
    level = np.sqrt(sweep.point.residual2[at] / freedom)
    return level, np.maximum(CLEARLY, np.sqrt(2 * gammaincinv(freedom / 2, 1 - CHANCE) / freedom))


def implausible(sweep: Sweep, source: NoiseSource) -> float | None:
    """Noise level that the evidence asks for, where it makes the stated one implausible.

    Says what `contradicted` cannot where a few data are all spent by the fit: a larger level, log-uniform up to
    `LARGER` times the stated one, over every lambda against the stated one over every lambda (a Bayes factor above
    `FACTOR`; Kass & Raftery, J. Am. Stat. Assoc. 90 (1995) 773). None where the path does not give its evidence, and
    where the level passed a test with `TESTED` data left: the evidence of a load unlike its prior would be no more.
    """
    if sweep.sigma is None or source.kind == "residual" or (found := _level_asked_for(sweep)) is None or _passed(sweep):
        return None
    level, factor = found
    return level if factor > np.log(FACTOR) and level > CLEARLY * sweep.sigma else None


def _level_asked_for(sweep: Sweep) -> tuple[float, float] | None:
    """Noise level of the largest evidence over every lambda, from the stated one upwards; ln of their Bayes factor."""
    point, sigma = sweep.point, sweep.sigma
    if sigma is None or point.objective is None or point.log_ratio is None:
        return None
    if sweep.path.stacked or not sweep.whole:
        return None
    from scipy.special import logsumexp

    inside = sweep.lam <= 1.0
    levels = sigma * np.geomspace(1.0, LARGER, 60)
    fit = point.objective[inside, None] / levels**2
    log = -0.5 * (point.log_ratio[inside, None] + fit) - (sweep.path.m - sweep.path.null) * np.log(levels)
    each = logsumexp(log, axis=0)
    return float(levels[np.argmax(each)]), float(logsumexp(each) - np.log(len(levels)) - each[0])


def unexplained(residual2: float, m: float, sigma: float) -> float | None:
    """Residual over the noise, where no noise of that level leaves so much; None where it may.

    The rms of all m data counts, whatever the fit has spent: noise alone leaves less. A chi-square test at `EXCESS`,
    and a factor of at least `CLEARLY`, as stated noise levels are rough.
    """
    from scipy.special import gammaincinv

    level = float(np.sqrt(residual2 / m)) / sigma
    return level if level > max(CLEARLY, float(np.sqrt(2 * gammaincinv(m / 2, 1 - EXCESS) / m))) else None


def residual_level(path: RegularizationPath, lam: float) -> float | None:
    """Noise level of the whitened data that the residual shows, sqrt(|r|^2 / (m - edf)).

    None where the fit leaves less than a fifth of the data: what is left then tells of the prior, not of the noise.
    """
    return shown_level(path.at(lam), path.m)


def shown_level(point: PathPoint, m: float) -> float | None:
    """See `residual_level`, of a point of a path of m data."""
    if point.left is None or float(point.left) < SPARE * m:
        return None
    return float(np.sqrt(point.residual2 / point.left))
