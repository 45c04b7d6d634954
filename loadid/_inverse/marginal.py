"""Posterior over all that was chosen from the data: lambda, and the noise level where nobody stated it.

A band at one lambda is that of somebody who knows lambda. Where the data do not determine it, and always where the
load is smoother or rougher than the penalty expects, this is far too narrow: at the end of the range it is the band of
the penalty's null space. Here every lambda counts by its evidence, log-uniform beforehand over the range that its path
calls sensible; an unknown noise level, log-uniform too, makes each conditional posterior Student's. The load of the
rule stays the centre: the covariance is the second moment about it. MacKay, Neural Comput. 4 (1992) 415, for the
evidence; Kass & Steffey, J. Am. Stat. Assoc. 84 (1989) 717, for what conditioning on estimated parameters leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from . import Array
from .posterior import DensePosterior, from_arrays

if TYPE_CHECKING:
    from .constrained.path import ConstrainedPath
    from .svd import SVDPath

COARSE, FINE = 60, 24  # lambdas over the whole range, and over the part of it that counts
COUNTS = 1e-4  # share of the evidence below which a lambda does not
LARGEST = 1.0  # relative lambda above which nothing is learned from the data
Z95 = 1.959963984540054


@dataclass(frozen=True, eq=False)
class LambdaWeights:
    """What the evidence says of lambda.

    Parameters
    ----------
    lam : array (k,)
        Relative lambdas.
    weight : array (k,)
        Posterior probability of each.
    level : array (k,)
        Noise level of the whitened data at each: the stated one, or the root of its mean in the posterior.
    freedom : float
        Degrees of freedom of the Student distribution; infinite where the level is stated.
    """

    lam: Array
    weight: Array
    level: Array
    freedom: float

    @classmethod
    def of(cls, path: SVDPath, sigma: float | None) -> LambdaWeights:
        """Weights on a path; `sigma` None: nobody stated the noise level."""
        freedom = np.inf if sigma is not None else float(max(path.m - path.null, 1))
        low, high = path.range[0], max(LARGEST, path.range[0])
        first = np.geomspace(low, high, COARSE)
        chance = _evidence(path, sigma, first)[0]
        counted = np.flatnonzero(chance > COUNTS * chance.max())
        ends = first[max(counted[0] - 1, 0)], first[min(counted[-1] + 1, COARSE - 1)]
        lam = np.geomspace(*ends, FINE)
        chance, level = _evidence(path, sigma, lam)
        keep = chance > COUNTS * chance.max()
        return cls(lam[keep], chance[keep] / chance[keep].sum(), level[keep], freedom)

    @property
    def stretch(self) -> float:
        """Half-width of the Student distribution's 95 % interval over that of the Gaussian of the same scale."""
        from scipy.stats import t

        return float(t.ppf(0.975, self.freedom) / Z95) if np.isfinite(self.freedom) else 1.0


def _evidence(path: SVDPath, sigma: float | None, lam: Array) -> tuple[Array, Array]:
    """Evidence at each lambda, the largest 1, and the noise level there."""
    point = path.at(lam)
    assert point.objective is not None
    assert point.log_ratio is not None
    freedom = max(path.m - path.null, 1)
    if sigma is None:
        level = np.sqrt(point.objective / freedom)
        fit = freedom * np.log(np.maximum(point.objective, np.finfo(float).tiny))
    else:
        level, fit = np.full(len(lam), sigma), point.objective / sigma**2
    log = -0.5 * (point.log_ratio + fit)
    return np.exp(log - log.max()), level


class MarginalPosterior(DensePosterior):
    """Second moment of the load about the chosen one, over all lambdas by their evidence.

    Parameters
    ----------
    factor, shape, passed, dual, orthogonal, frames
        As in `DensePosterior`: the mean conditional covariance, and the share of it that is noise.
    resolved : array, shape (modes,)
        Filter factors at the chosen lambda.
    shifts : array, shape (k,) + the shape of the load
        What the load of each lambda differs by from the chosen one, times the root of its weight.
    expected : float, optional
        Relative error of the load that is expected, the mean over lambda: the covariance is ruled by its tail.
    """

    kind = "marginal"

    def __init__(
        self, factor: Array, shape: tuple[int, ...], *, resolved: Array, shifts: Array, expected: float | None = None,
        **given: Any,
    ) -> None:  # fmt: skip
        super().__init__(factor, shape, **given)
        self.resolved, self.shifts, self.expected = resolved, shifts, expected

    @property
    def std(self) -> Array:
        """Standard deviation, in the shape of the load."""
        return np.asarray(np.sqrt(super().std ** 2 + np.sum(self.shifts**2, axis=0)))

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` has the shape of the load, (k,) + that shape, or that of one frame."""
        flat = self.shifts.reshape(len(self.shifts), -1)
        w = np.asarray(w, float)
        if self.frames is None or w.shape[max(w.ndim - len(self.shape), 0) :] == self.shape:
            moved = np.sum((w.reshape(*w.shape[: w.ndim - len(self.shape)], -1) @ flat.T) ** 2, axis=-1)
        else:  # weights of one frame: the mean of all
            each = flat.reshape(len(flat), self.frames, -1)
            moved = np.mean(np.sum(np.tensordot(each, w.ravel(), 1) ** 2, axis=0))
        return np.asarray(super().variance(w) + moved)

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        return super().to_arrays() | {"resolved": self.resolved, "shifts": self.shifts}

    @classmethod
    def from_arrays(cls, tree: dict[str, Any]) -> MarginalPosterior:
        """Inverse of `to_arrays`."""
        arrays: dict[str, Any] = {
            k: np.asarray(tree[k]) for k in ("factor", "resolved", "shifts", "passed", "dual") if k in tree
        }
        return cls(
            arrays.pop("factor"), tuple(tree["shape"]), orthogonal=bool(tree.get("orthogonal", False)),
            frames=tree.get("frames"), **arrays,
        )  # fmt: skip


class DrawnPosterior(DensePosterior):
    """Second moment of draws about the chosen load: they meet the constraints, and so does what the band is made of.

    Parameters
    ----------
    factor, shape
        As in `DensePosterior`.
    face : Posterior
        On the active face, which says what of it is noise.
    expected : float, optional
        Relative error of the load that is expected, the mean over the draws.
    """

    kind = "drawn"
    approximation = "draws by randomise-then-optimise"

    def __init__(self, factor: Array, shape: tuple[int, ...], face: Any, expected: float | None = None) -> None:
        super().__init__(factor, shape)
        self.face, self.expected = face, expected

    @property
    def noise_std(self) -> Array | None:
        """Standard deviation from the noise alone, on the active face."""
        found: Array | None = self.face.noise_std
        return found

    def noise_variance(self, w: Array) -> Array | None:
        """Variance of ``sum(w * load)`` from the noise alone, on the active face."""
        found: Array | None = self.face.noise_variance(w)
        return found

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        return super().to_arrays() | {"face": self.face.to_arrays()}

    @classmethod
    def from_arrays(cls, tree: dict[str, Any]) -> DrawnPosterior:
        """Inverse of `to_arrays`."""
        return cls(np.asarray(tree["factor"]), tuple(tree["shape"]), from_arrays(tree["face"]))


def posterior(path: SVDPath, lam: float, sigma: float | None) -> MarginalPosterior:
    """Posterior of the load that `path` gives at the relative `lam`.

    Parameters
    ----------
    path : SVDPath
        Smooth in lambda.
    lam : float
        The chosen one.
    sigma : float or None
        Noise level of the whitened data; None where nobody stated it.
    """
    over = LambdaWeights.of(path, sigma)
    problem, c, s = path.problem, path.c, path.s
    precision = c**2 + (over.lam[:, None] * float(path.scale) * s) ** 2  # (k, modes)
    scaled = (over.weight * (over.stretch * over.level) ** 2)[:, None] / precision
    variance = scaled.sum(axis=0)
    noise = np.sum(scaled * c**2 / precision, axis=0) / variance
    centre = path.gains(lam)
    off = np.stack([path.X @ (path.gains(x) - centre) for x in over.lam])
    moved = np.sqrt(over.weight).reshape(-1, *[1] * (off.ndim - 1)) * off
    shifts = np.swapaxes(moved, 1, -1).reshape(len(moved), *problem.load_shape)
    spread = np.sqrt(variance)
    dual = None if path.orthonormal or path.X.shape[1] == len(path.X) else path.Y / spread
    return MarginalPosterior(
        path.X * spread, problem.shape, passed=noise, dual=dual, orthogonal=path.orthonormal, frames=problem.frames,
        resolved=path.filter_factors(lam), shifts=shifts,
        expected=_expected(path, over, path.X @ centre, off, over.level[:, None] ** 2 / precision),
    )  # fmt: skip


def _expected(path: SVDPath, over: LambdaWeights, load: Array, off: Array, variance: Array) -> float:
    """Mean over lambda of the relative error of a load, whose differences and modal variances (k, modes) these are."""
    frames = load.size // len(load)
    within = frames * variance @ np.sum(path.X**2, axis=0)
    axes = tuple(range(1, off.ndim))
    error2 = within + np.sum(off**2, axis=axes)
    true2 = within + np.sum((load + off) ** 2, axis=axes)
    share = np.sqrt(error2 / np.maximum(true2, np.finfo(float).tiny))
    return float(np.sum(over.weight * share) / np.sum(over.weight))


def draws(
    path: SVDPath | ConstrainedPath, sigma: float | None, count: int, seed: int, lam: float | None = None
) -> Array:
    """Loads drawn from the posterior, (count,) + the shape of the load: lambda and noise level by their evidence.

    Under constraints the evidence is that without them, and draws are by randomise-then-optimise
    (`ConstrainedPath.sample`). Where `lam` is given, both are kept.

    Parameters
    ----------
    path : SVDPath or ConstrainedPath
    sigma : float or None
        Noise level of the whitened data; None where nobody stated it.
    """
    if lam is not None and sigma is not None:
        return path.sample(lam, sigma, count, seed=seed)
    rng = np.random.default_rng(seed)
    over = LambdaWeights.of(path.unconstrained, sigma)
    picked = np.searchsorted(np.cumsum(over.weight)[:-1], (rng.random() + np.arange(count)) / count)
    found = []
    for k in np.unique(picked)[::-1]:  # from large to small: each start is warm
        many = int(np.sum(picked == k))
        level = np.full(many, over.level[k])
        if np.isfinite(over.freedom):
            level *= np.sqrt(over.freedom / rng.chisquare(over.freedom, many))
        found.append(path.sample(float(over.lam[k]), level, many, seed=int(rng.integers(1 << 31))))
    return np.concatenate(found)


def about(load: Array, drawn: Array, face: Any) -> DrawnPosterior:
    """Second moment of draws, (count,) + the shape of the load, about a load with its posterior on the active face."""
    off = (drawn - load).reshape(len(drawn), -1)
    error, size = np.linalg.norm(off, axis=1), np.linalg.norm(drawn.reshape(len(drawn), -1), axis=1)
    share = np.divide(error, size, out=np.ones(len(size)), where=size > 0)  # all is wrong where no load was drawn
    expected = float(np.mean(share))
    return DrawnPosterior(np.ascontiguousarray(off.T) / np.sqrt(len(drawn)), load.shape, face, expected)
