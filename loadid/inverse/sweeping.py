"""A path over a grid of lambdas, what a rule says about it, and the two searches that rules are made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .path import PathPoint, RegularizationPath

LARGEST = 1e3  # relative lambda that leaves of the load, to six digits, only what the penalty does not see
NULL_SPACE = "the data ask for nothing beyond what the penalty leaves free: null-space solution"


@dataclass(frozen=True)
class RuleResult:
    """What one rule said.

    Parameters
    ----------
    rule : str
        Name.
    lam : float or None
        Relative lambda (lambda over the scale of the problem); None when the rule refused.
    edge : bool
        The answer sits at an end of the sweep.
    note : str
        Why it refused, or what is odd about it.
    free : bool
        It chose the null space of the penalty: an end of the sweep that is a solution.
    """

    rule: str
    lam: float | None
    edge: bool = False
    note: str = ""
    free: bool = False

    @classmethod
    def null_space(cls, rule: str, lam: float) -> RuleResult:
        """What a rule says that ends where the penalty alone decides."""
        return cls(rule, lam, True, NULL_SPACE, True)


class Refusal(Exception):
    """A rule cannot run on this path; the text says why."""


@dataclass(frozen=True)
class Sweep:
    """A path evaluated over a grid of relative lambdas (one problem, not a stack).

    Where it is not the `whole` of the range, a search that ends at a wall goes on in a wider one.
    """

    path: RegularizationPath
    lam: NDArray[np.float64]
    point: PathPoint
    sigma: float | None
    whole: bool = True

    @classmethod
    def over(cls, path: RegularizationPath, sigma: float | None, points: int = 121) -> Sweep:
        """Evaluate `path` over its range, and up to `LARGEST` where the penalty has a null space to end in."""
        low, high = path.range
        lam = np.geomspace(low, high, points)
        if path.null and high < LARGEST:
            step = np.log10(high / low) / (points - 1)
            more = max(6, int(np.log10(LARGEST / high) / step))
            lam = np.concatenate([lam, np.geomspace(high, LARGEST, more + 1)[1:]])
        return cls(path, lam, path.at(lam), sigma)

    def part(self, keep: NDArray) -> Sweep:
        """Some of its points."""
        given: dict[str, Any] = {f.name: getattr(self.point, f.name) for f in fields(self.point)}
        kept: dict[str, Any] = {name: None if value is None else value[keep] for name, value in given.items()}
        point = PathPoint(**kept)
        return Sweep(self.path, self.lam[keep], point, self.sigma, self.whole)

    @property
    def ends_free(self) -> bool:
        """Whether its upper end is the null-space solution of the penalty."""
        return self.path.null > 0 and bool(self.lam[-1] >= 0.99 * LARGEST)


def need(point: PathPoint, name: str, rule: str) -> NDArray:
    """One ingredient of a rule, or the rule's refusal."""
    value = getattr(point, name)
    if value is None:
        raise Refusal(f"{rule} needs {name}, which this path does not define")
    return value


def need_sigma(sweep: Sweep, rule: str) -> float:
    """Noise level, or the rule's refusal."""
    if sweep.sigma is None:
        raise Refusal(f"{rule} needs the noise level")
    return sweep.sigma


def seen_modes(path: RegularizationPath) -> tuple[float, float] | None:
    """Smallest and largest generalised singular value, relative, that rounding leaves; None where they are not known.

    A path without a factorisation may state the smallest one as its property ``seen``.
    """
    modes = path.coefficients
    if modes is None:
        seen = path.seen
        return None if seen is None else (float(seen), 1.0)
    relative = modes.gamma / modes.gamma.max()
    floor = 10 * np.finfo(float).eps * np.sqrt(len(relative))
    return float(np.min(relative[relative > floor], initial=1.0)), 1.0


def among_modes(sweep: Sweep, rule: str, share: float = 1.0) -> Sweep:
    """The sweep between a share of the smallest generalised singular value and the largest.

    Raises
    ------
    Refusal
        If fewer than three points are left.
    """
    ends = seen_modes(sweep.path)
    low = 0.0 if ends is None else share * ends[0]
    high = sweep.path.range[1] * (1 + 1e-9) if sweep.ends_free else np.inf
    keep = (sweep.lam >= low) & (sweep.lam <= high)
    if np.sum(keep) < 3:
        raise Refusal(f"{rule} needs singular values that differ")
    return sweep.part(keep)


def log(x: NDArray) -> NDArray:
    """Logarithm of data that may be zero throughout."""
    return np.log(np.maximum(x, np.finfo(float).tiny))


def dips(value: NDArray) -> NDArray[np.bool_]:
    """Local minima, the ends included."""
    walled = np.concatenate([[np.inf], np.where(np.isfinite(value), value, np.inf), [np.inf]])
    return (walled[1:-1] <= walled[:-2]) & (walled[1:-1] < walled[2:])


# -- one-dimensional searches on the grid ----------------------------------------------------------------------------
def minimum(name: str, sweep: Sweep, f: Callable[[PathPoint], NDArray]) -> RuleResult:
    """Global minimum of a function of the path's scalars."""
    return search(name, sweep, lambda lam: f(sweep.point if lam is sweep.lam else sweep.path.at(lam)))


def search(name: str, sweep: Sweep, f: Callable[[NDArray], NDArray]) -> RuleResult:
    """Global minimum over the sweep, refined between its neighbours where the path is smooth."""
    value = f(sweep.lam)
    if not np.any(np.isfinite(value)):
        raise Refusal(f"{name} is not defined anywhere on this path")
    value = np.where(np.isfinite(value), value, np.inf)
    k, last = int(np.argmin(value)), len(value) - 1
    if sweep.ends_free and value[last] <= value[k] * (1 + 1e-9):  # flat all the way: the end is what it means
        k = last
    lam = float(sweep.lam[k])
    if k == last and sweep.ends_free:
        return RuleResult.null_space(name, lam)
    edge = k in (0, last)
    if not edge and sweep.path.smooth:
        a, b = sweep.lam[k - 1], sweep.lam[k + 1]
        for _ in range(2):
            fine = np.geomspace(a, b, 9)
            j = int(np.clip(np.nanargmin(f(fine)), 1, 7))
            lam, a, b = float(fine[j]), fine[j - 1], fine[j + 1]
    return RuleResult(name, lam, edge)


def crossing(name: str, sweep: Sweep, f: Callable[[PathPoint], NDArray]) -> RuleResult:
    """Largest lambda at which a rising function crosses zero."""
    value = f(sweep.point)
    below = np.flatnonzero(value < 0)
    if len(below) == 0:
        return RuleResult(
            name,
            float(sweep.lam[0]),
            True,
            "the residual stays above the noise: noise level too low, or the model is wrong",
        )
    k = int(below[-1])
    if k == len(value) - 1:
        if sweep.ends_free:
            return RuleResult.null_space(name, float(sweep.lam[-1]))
        return RuleResult(name, float(sweep.lam[-1]), True, "the data are within the noise")
    a, b = sweep.lam[k], sweep.lam[k + 1]
    for _ in range(30 if sweep.path.smooth else 0):
        middle = np.sqrt(a * b)
        a, b = (middle, b) if float(f(sweep.path.at(middle))) < 0 else (a, middle)
    return RuleResult(name, float(a))
