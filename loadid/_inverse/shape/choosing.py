"""Shape parameter and ridge chosen together, and what is known of a field once they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..choice import Choice, choose
from ..path import PathPoint, RegularizationPath
from ..problem import LinearProblem, Noise, NoiseSourceLike
from ..rules import Rule
from ..svd import SVDPath

Array = NDArray[np.float64]
GRID = 80  # ridges that are asked
LOW, HIGH = 1e-12, 1.0  # relative
COUNTS = 1e-3  # likelihood over the largest, below which a pair of shape and ridge is left out
MOST = 100  # pairs that are averaged over
DOUBT = 0.5  # power of the likelihood of a pair: loads are no draws of the prior, and data of little noise are too sure


@dataclass(frozen=True, eq=False)
class Fit:
    """One shape parameter and ridge.

    Parameters
    ----------
    candidate : int
        Which of the shape parameters.
    path : SVDPath
    lam : float
        Relative.
    weight : float
        Share of the posterior probability.
    """

    candidate: int
    path: SVDPath
    lam: float
    weight: float


@dataclass(frozen=True, eq=False)
class Chosen:
    """What was chosen: the best pair first, those that the data cannot tell from it, and what the rules say there."""

    fits: tuple[Fit, ...]
    choice: Choice

    @property
    def best(self) -> Fit:
        """The pair of the largest probability."""
        return self.fits[0]


def paths(rows: Sequence[Array], values: Array, noise: Noise | None) -> list[SVDPath]:
    """A path for each matrix (sensors, functions), of readings (frames, sensors) with one ridge for all frames."""
    y = values[0] if len(values) == 1 else values
    return [SVDPath(LinearProblem.whitened(A, y, noise)) for A in rows]


def unlikely(path: RegularizationPath, point: PathPoint, sigma: float | None) -> Array:
    """Minus twice the log likelihood of the data, the same for all shape parameters, at the noise of `level`."""
    J, ratio = np.asarray(point.objective), np.asarray(point.log_ratio)
    square = level(path, point, sigma) ** 2
    return np.asarray(ratio + path.m * np.log(square) + J / square)


def level(path: RegularizationPath, point: PathPoint, sigma: float | None) -> Array:
    """Noise of the largest likelihood, no less than stated: what the plate equation leaves unexplained is in it."""
    best = np.sqrt(np.asarray(point.objective) / path.m)
    return np.asarray(best if sigma is None else np.maximum(best, sigma))


def chosen(
    candidates: Sequence[SVDPath], rule: str | Rule | float | None, *, sigma: float | None, source: NoiseSourceLike
) -> Chosen:
    """Shape parameter and ridge: together by the evidence, or the ridge of each shape by a rule and the shape by it.

    The evidence of a pair is the marginal likelihood of the data, which robust GCV and the discrepancy approximate and
    which alone says how likely the pairs are that it did not take: the answer is averaged over those. The likelihood is
    tempered, as P. Gruenwald and T. van Ommen (Bayesian Anal. 12 (2017) 1069) do where no model is the truth.
    """
    lam = np.geomspace(LOW, HIGH, GRID)
    pairs: list[tuple[float, int, float]] = []
    for k, path in enumerate(candidates):
        grid = lam if rule is None else np.array([choose(path, rule, sigma=sigma, source=source).lam])
        levels = unlikely(path, path.at(grid), sigma)
        pairs += [(float(v), k, float(x)) for v, x in zip(levels, grid, strict=True) if np.isfinite(v)]
    pairs.sort()
    if rule is not None:
        pairs = pairs[:1]

    weights = np.exp(-0.5 * DOUBT * (np.array([v for v, _, _ in pairs]) - pairs[0][0]))
    kept = [(pair, w) for pair, w in zip(pairs, weights, strict=True) if w >= COUNTS][:MOST]
    total = sum(w for _, w in kept)
    fits = tuple(Fit(k, candidates[k], x, float(w / total)) for (_, k, x), w in kept)
    best = fits[0]
    return Chosen(fits, choose(best.path, best.lam, sigma=sigma, source=source))


@dataclass(frozen=True, eq=False)
class Spread:
    """Mean and error of a field that is linear in the coefficients, averaged over the fits.

    Parameters
    ----------
    mean : array, shape (frames, places)
    root : array, shape (places, directions)
        ``root @ root.T`` is the covariance of a frame, but for what differs between frames.
    apart : array, shape (frames, places)
        Std of the means of the fits.
    hidden : array, shape (frames, places)
        What the ridge takes away from a field like the estimate.
    """

    mean: Array
    root: Array
    apart: Array
    hidden: Array


def spread(found: Chosen, rows: Sequence[Array], sigma: float | None) -> Spread:
    """What the fits say of ``rows[candidate] @ coefficients``."""
    means, lost, roots = [], [], []
    unseen: dict[int, float] = {}  # of each shape, the variance of what no gauge sees
    for fit in found.fits:
        Q, x = rows[fit.candidate], fit.lam * float(fit.path.scale)
        solution = fit.path.solution(fit.lam, None)
        again = fit.path.resolve(solution.load, fit.lam)
        means.append(np.atleast_2d(solution.load) @ Q.T)
        lost.append(np.atleast_2d(again - solution.load) @ Q.T)
        sure = noise_of(fit, sigma)
        s, V = seen_by(fit.path)
        roots.append(np.sqrt(fit.weight) * sure * (Q @ V) / np.hypot(s, x))
        unseen[fit.candidate] = unseen.get(fit.candidate, 0.0) + fit.weight * (sure / x) ** 2
    for fit in {fit.candidate: fit for fit in found.fits}.values():
        Q, (_, V) = rows[fit.candidate], seen_by(fit.path)
        rest = Q - (Q @ V) @ V.T
        roots.append(np.sqrt(unseen[fit.candidate]) * np.asarray(np.linalg.qr(rest.T, mode="r")).T)
    weights = np.array([fit.weight for fit in found.fits])
    mean = np.tensordot(weights, means, axes=1)
    apart = np.sqrt(np.tensordot(weights, (np.array(means) - mean) ** 2, axes=1))
    root = np.asarray(np.linalg.qr(np.hstack(roots).T, mode="r")).T
    return Spread(mean, np.asarray(root), np.asarray(apart), np.asarray(np.tensordot(weights, lost, axes=1)))


def seen_by(path: SVDPath) -> tuple[Array, Array]:
    """Singular values (r,) and directions (functions, r) that the gauges see."""
    s = path.singular_values
    return s, np.asarray(path.X[:, : len(s)])


def noise_of(fit: Fit, sigma: float | None) -> float:
    """Noise level of the whitened data."""
    return float(level(fit.path, fit.path.at(fit.lam), sigma))
