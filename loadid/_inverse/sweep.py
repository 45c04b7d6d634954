"""A path over a grid of lambdas, the two searches of rules, and tests whether the residual is white.

A stacked path has its lines on the first axis and lambda on the last; the searches then answer line by line.

Rules that compare the residual with white noise (GCV and its kin, UPRE, NCP, the dof-corrected discrepancy) take
correlated noise for response and follow it. Residual: normalised cumulative periodogram, Rust & O'Leary, Inverse
Problems 24 (2008) 034005, against what white noise would leave after this fit. Coefficients: a plateau that is no
plateau, by an F-test of its two halves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError, plain

from . import Array, Flags, Indices
from .path import PathPoint, RegularizationPath

LARGEST = 1e3  # relative lambda that leaves of the load, to six digits, only what the penalty does not see
LEAST, LINE_POINTS = 1e-8, 41  # smallest relative lambda, and points, of the grid of stacked lines
WALL = 1e3  # height of a wall around the points of a stack where a search does not look, over the largest value
CLOSE = 0.01  # distance from a level at which a search ends where each point costs a solution
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

    @staticmethod
    def null_space(rule: str, lam: float) -> RuleResult:
        """What a rule says that ends where the penalty alone decides."""
        return RuleResult(rule, lam, True, NULL_SPACE, True)

    @property
    def lines(self) -> Array | None:
        """Relative lambda of every line of a stacked path, (lines,); None of one problem."""
        return None


@dataclass(frozen=True)
class LineResult(RuleResult):
    """What one rule said of every line of a stacked path: `lam` is the median of `lams` (lines,)."""

    lams: Array = field(kw_only=True)

    @classmethod
    def of(cls, rule: str, lams: Array) -> LineResult:
        """From the lambdas of the lines."""
        return cls(rule, float(np.median(lams)), lams=lams)

    @property
    def lines(self) -> Array:
        """Relative lambda of every line."""
        return self.lams


class Refusal(Exception):
    """A rule cannot run on this path; the text says why."""


@dataclass(frozen=True)
class Sweep:
    """A path evaluated over a grid of relative lambdas.

    Parameters
    ----------
    path : RegularizationPath
    lam : array, shape (points,)
        Relative lambdas, ascending; of a stack the same for all lines.
    point : PathPoint
        Scalars, (points,); of a stack (lines, points).
    sigma : float or None
        Noise level of the whitened data.
    whole : bool
        Where it is not the whole of the range, a search that ends at a wall goes on in a wider one.
    mean : callable, optional
        Mean of a function (lines, points) over the lines that share a decision.
    outside : array of bool, shape (lines, points), optional
        Points of a stack where a search does not look.
    """

    path: RegularizationPath
    lam: Array
    point: PathPoint
    sigma: float | None
    whole: bool = True
    mean: Callable[[Array], Array] | None = None
    outside: Flags | None = None

    @classmethod
    def over(
        cls,
        path: RegularizationPath,
        sigma: float | None,
        points: int = 121,
        mean: Callable[[Array], Array] | None = None,
    ) -> Sweep:
        """Evaluate `path` over its range, and up to `LARGEST` where the penalty has a null space to end in.

        A stack is evaluated on `LINE_POINTS`.
        """
        low, high = path.range
        if path.stacked:
            lam: Array = np.geomspace(max(low, LEAST), high, LINE_POINTS)
            return cls(path, lam, path.at(lam), sigma, mean=mean)
        lam = np.geomspace(low, high, points)
        if path.null and high < LARGEST:
            step = np.log10(high / low) / (points - 1)
            more = max(6, int(np.log10(LARGEST / high) / step))
            lam = np.concatenate([lam, np.geomspace(high, LARGEST, more + 1)[1:]])
        return cls(path, lam, path.at(lam), sigma)

    def shared(self, value: Array) -> Array:
        """A function on the grid as the search sees it: walled outside, averaged over the lines that decide together.

        Only the grid itself can be asked so, not points between.
        """
        if self.outside is not None:
            value = np.where(self.outside, WALL * np.abs(value).max(), value)
        return value if self.mean is None else self.mean(value)

    def part(self, keep: Flags | Indices) -> Sweep:
        """Some of its points."""
        given: dict[str, Any] = {f.name: getattr(self.point, f.name) for f in fields(self.point)}
        kept: dict[str, Any] = {name: None if value is None else value[keep] for name, value in given.items()}
        point = PathPoint(**kept)
        return replace(self, lam=self.lam[keep], point=point)

    @property
    def ends_free(self) -> bool:
        """Whether its upper end is the null-space solution of the penalty."""
        return self.path.null > 0 and bool(self.lam[-1] >= 0.99 * LARGEST)


INGREDIENTS = {
    "fitted2": "a load of few pulses",
    "log_supports": "a load of few pulses",
}  # of rules, as people say them


def need(point: PathPoint, name: str, rule: str) -> Array:
    """One ingredient of a rule, or the rule's refusal."""
    value: Array | None = getattr(point, name)
    if value is None:
        raise Refusal(f"{rule} needs {INGREDIENTS.get(name, name)}, which this path does not define")
    return value


def need_sigma(sweep: Sweep, rule: str) -> float:
    """Noise level, or the rule's refusal."""
    if sweep.sigma is None:
        raise Refusal(f"{rule} needs the noise level")
    return sweep.sigma


def smallest_seen(path: RegularizationPath) -> Array | None:
    """Smallest relative generalised singular value (of each line) that rounding leaves; None where it is not known.

    A path without a factorisation may state it as its property ``seen``.
    """
    modes = path.coefficients
    if modes is None:
        return None if path.seen is None else np.asarray(path.seen, float)
    relative = modes.gamma / np.maximum(modes.gamma.max(axis=-1, keepdims=True), np.finfo(float).tiny)
    floor = 10 * np.finfo(float).eps * np.sqrt(relative.shape[-1])
    return np.asarray(np.min(np.where(relative > floor, relative, np.inf), axis=-1, initial=1.0))


def among_modes(sweep: Sweep, rule: str, share: float = 1.0) -> Sweep:
    """The sweep between a share of the smallest generalised singular value and the largest.

    Raises
    ------
    Refusal
        If fewer than three points are left.
    """
    smallest = smallest_seen(sweep.path)
    low = share * (np.zeros(()) if smallest is None else smallest)
    if sweep.path.stacked:
        return replace(sweep, outside=sweep.lam < low[:, None])
    high = sweep.path.range[1] * (1 + 1e-9) if sweep.ends_free else np.inf
    keep = (sweep.lam >= low) & (sweep.lam <= high)
    if np.sum(keep) < 3:
        raise Refusal(f"{rule} needs singular values that differ")
    return sweep.part(keep)


def log(x: Array) -> Array:
    """Logarithm of data that may be zero throughout."""
    return np.log(np.maximum(x, np.finfo(float).tiny))


def dips(value: Array) -> Flags:
    """Local minima, the ends included."""
    walled = np.concatenate([[np.inf], np.where(np.isfinite(value), value, np.inf), [np.inf]])
    return (walled[1:-1] <= walled[:-2]) & (walled[1:-1] < walled[2:])


# -- one-dimensional searches on the grid ----------------------------------------------------------------------------
def minimum(name: str, sweep: Sweep, f: Callable[[PathPoint], Array]) -> RuleResult:
    """Global minimum of a function of the path's scalars."""
    return search(name, sweep, lambda lam: f(sweep.point if lam is sweep.lam else sweep.path.at(lam)))


def search(name: str, sweep: Sweep, f: Callable[[Array], Array]) -> RuleResult:
    """Global minimum over the sweep, refined between its neighbours where the path is smooth.

    Of a stack the grid alone is known to all lines that decide together: the parabola through three points refines.
    """
    value = sweep.shared(f(sweep.lam))
    defined = np.isfinite(value)
    value = np.where(defined, value, np.inf)
    if value.ndim > 1:  # a line on which it is not defined keeps the smallest lambda
        return LineResult.of(name, _lowest(sweep, value))
    if not defined.any():
        raise Refusal(f"{name} is not defined anywhere on this path")
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


def _lowest(sweep: Sweep, value: Array) -> Array:
    """Minimum of each line (lines, points), between the points of the grid by the parabola through three of them."""
    k = np.argmin(value, axis=1)
    if not sweep.path.smooth:
        return np.asarray(sweep.lam[k])
    inner = np.clip(k, 1, len(sweep.lam) - 2)
    rows = np.arange(len(value))
    a, b, c = (value[rows, inner + d] for d in (-1, 0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = a - 2 * b + c
        move = np.where((k == inner) & (bend > 0) & np.isfinite(bend), 0.5 * (a - c) / bend, 0.0)
    step = np.log(sweep.lam[1] / sweep.lam[0])
    return np.asarray(sweep.lam[k] * np.exp(np.clip(move, -0.5, 0.5) * step))


def crossing(
    name: str, sweep: Sweep, rising: Callable[[PathPoint], Array], level: Callable[[PathPoint], Array] | float = 0.0
) -> RuleResult:
    """Largest lambda at which a rising function of the path's scalars is below a level, itself one or a number."""

    def f(p: PathPoint) -> Array:
        return rising(p) - (level(p) if callable(level) else level)

    value = sweep.shared(f(sweep.point))
    if value.ndim > 1:
        return LineResult.of(name, _crossed(sweep, value))
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
    if sweep.path.dear and level != 0.0:
        over = level if callable(level) else lambda p: level
        return RuleResult(name, _crossed_dearly(sweep, k, lambda p: rising(p) / over(p)))
    for _ in range(30 if sweep.path.smooth else 0):
        middle = np.sqrt(a * b)
        a, b = (middle, b) if float(f(sweep.path.at(middle))) < 0 else (a, middle)
    return RuleResult(name, float(a))


def _crossed_dearly(sweep: Sweep, k: int, ratio: Callable[[PathPoint], Array]) -> float:
    """Lambda between two points of the grid at which a ratio that rises past 1 is `CLOSE` to it, by few solutions."""
    values = ratio(sweep.point)
    low, high = ((float(sweep.lam[j]), float(values[j])) for j in (k, k + 1))
    for _ in range(12):
        if high[1] - low[1] <= CLOSE or low[1] > 1 - CLOSE / 2:
            break
        share = -np.log(low[1]) / np.log(high[1] / low[1])
        lam = float(low[0] * (high[0] / low[0]) ** np.clip(share, 0.1, 0.9))
        here = lam, float(ratio(sweep.path.at(lam)))
        high, low = (here, low) if here[1] > 1 else (high, here)
    return low[0]


def _crossed(sweep: Sweep, value: Array) -> Array:
    """Last lambda of each line (lines, points) below zero, between two points by their chord."""
    below = value < 0
    last = value.shape[1] - 1
    k = np.where(below.any(axis=1), last - np.argmax(below[:, ::-1], axis=1), 0)
    rows, after = np.arange(len(value)), np.minimum(k + 1, last)
    a, b = value[rows, k], value[rows, after]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where((a < 0) & (b > a), np.clip(-a / (b - a), 0.0, 1.0), 0.0)
    return np.asarray(sweep.lam[k] * (sweep.lam[after] / sweep.lam[k]) ** share)


KS = 1.36  # 95 % quantile of the Kolmogorov-Smirnov statistic times sqrt(q)
COLOURED, SPENT = 3.5, 0.1  # the fit itself colours the residual beyond this share of the data: threshold without modes
ALARM = 1e-3  # one-sided level of the F-test
TESTABLE = 40  # noise modes below which neither test says anything


# -- residual --------------------------------------------------------------------------------------------------------
def ncp_statistic(residual: Array) -> tuple[Array, Array]:
    """Distance of the cumulated residual periodogram from white noise: (norm, Kolmogorov-Smirnov times sqrt q).

    Parameters
    ----------
    residual : array, shape (samples, sensors, ...)
        Periodograms of several channels are added; one answer for each entry of the axes behind.

    Raises
    ------
    Refusal
        If there are too few samples, or all are zero.
    """
    power = periodogram(residual)
    q = len(power)
    total = power.sum(axis=0)
    if q < 2 or np.any(total <= 0):
        raise Refusal("ncp needs a residual with some samples")
    white = np.arange(1, q + 1).reshape(-1, *[1] * (power.ndim - 1)) / q
    distance = np.cumsum(power, axis=0) / total - white
    return np.linalg.norm(distance, axis=0), np.abs(distance).max(axis=0) * np.sqrt(q * residual.shape[1])


def periodogram(residual: Array) -> Array:
    """Periodogram (lines, ...) of (samples, sensors, ...), without the mean, added over the sensors."""
    return np.asarray(np.sum(np.abs(np.fft.rfft(residual, axis=0)[1:]) ** 2, axis=1))


@dataclass(frozen=True)
class Residual:
    """Whether the residual of one fit is what white noise leaves.

    Parameters
    ----------
    statistic, threshold : float
        Kolmogorov-Smirnov distance of the cumulated periodogram times the root of the number of lines; its 95 % limit.
    spent : float
        Degrees of freedom of the fit over the number of data.
    """

    statistic: float
    threshold: float
    spent: float

    @property
    def white(self) -> bool:
        """Not refuted."""
        return self.statistic <= self.threshold


def residual_test(path: RegularizationPath, lam: float) -> Residual | None:
    """Test of the residual at one lambda; None where it has too few samples to tell.

    Where the modes of the data are known, the periodogram is compared with the one that this fit leaves of white
    noise, tr of (I - A)^2 line by line; elsewhere with a flat one, and with a wider limit once the fit spends more
    than a tenth of the data.
    """
    rests = path.residuals(np.array([lam]))
    if rests is None:
        return None
    rest = next(iter(rests))
    rest = rest.reshape(len(rest), -1)
    edf = path.at(lam).edf
    spent = 0.0 if edf is None else float(edf) / path.m
    expected = path.white_residual(lam)
    if expected is None:
        try:
            statistic = float(ncp_statistic(rest)[1])
        except Refusal:
            return None
        return Residual(statistic, KS if spent <= SPENT else COLOURED, spent)
    power = periodogram(rest)
    if len(power) < 2 or power.sum() <= 0 or expected.sum() <= 0:
        return None
    distance = np.cumsum(power) / power.sum() - np.cumsum(expected) / expected.sum()
    lines = expected.sum() ** 2 / np.sum(expected**2) * rest.shape[1]  # that carry noise
    return Residual(float(np.abs(distance).max() * np.sqrt(lines)), KS, spent)


# -- data coefficients -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class PlateauTest:
    """Two halves of the data coefficients beyond those that the fit uses.

    Parameters
    ----------
    ratio : float
        Mean square of the first half over that of the second: 1 for white noise, larger where the noise is smooth.
    chance : float
        Probability of such a ratio, or a larger one, under white noise.
    modes : int
        Noise-dominated modes.
    """

    ratio: float
    chance: float
    modes: int

    @property
    def testable(self) -> bool:
        """Whether there are enough noise modes to tell."""
        return self.modes >= TESTABLE

    @property
    def flat(self) -> bool:
        """Not refuted."""
        return not self.testable or self.chance >= ALARM


def plateau_test(path: RegularizationPath, lam: float) -> PlateauTest | None:
    """F-test of the coefficients i > 2 tr A + 5 at one lambda; None where the modes of the path are no real vectors.

    White noise has the same energy in each; smooth noise loads the first modes, which are smooth too.
    """
    edf, known = path.at(lam).edf, path.energies()
    if known is None or edf is None:
        return None
    energy, copies = known
    rest = energy[int(2 * float(edf) / copies + 5) :]
    half = len(rest) // 2
    if half < 2:
        return PlateauTest(1.0, 1.0, len(rest))
    first, second = float(np.mean(rest[:half])), float(np.mean(rest[half:]))
    if second <= 0:
        return PlateauTest(np.inf if first > 0 else 1.0, 0.0 if first > 0 else 1.0, len(rest))
    from scipy.special import fdtrc

    ratio = first / second
    return PlateauTest(ratio, float(fdtrc(half * copies, (len(rest) - half) * copies, ratio)), len(rest))


# -- interpolated data -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Effective:
    """How many data stand behind interpolated or filtered ones.

    Parameters
    ----------
    nominal : int
        Values.
    effective : float
        ``(tr C)^2 / tr(C^2)`` of their noise covariance C.
    rank : int
        Rank of C.
    """

    nominal: int
    effective: float
    rank: int


def effective_number(W: ArrayLike, noise: ArrayLike | float = 1.0) -> Effective:
    """Effective number of data of ``y = W z``, with C = W Sigma W^T.

    Parameters
    ----------
    W : array, shape (values, raw)
        Interpolation or filter.
    noise : float or array
        Std of the raw data, one or (raw,), or their covariance (raw, raw).

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, or an interpolation that keeps nothing.
    """
    W, noise = np.asarray(plain(W), float), np.asarray(plain(noise), float)
    if W.ndim != 2 or noise.shape not in {(), W.shape[1:], (*W.shape[1:], *W.shape[1:])}:
        raise InputError(
            "the interpolation does not fit the noise", where="interpolation",
            found=f"W {W.shape}, noise {noise.shape}", expected="W (values, raw) with a std (raw,) or covariance",
        )  # fmt: skip
    if not (np.all(np.isfinite(W)) and np.all(np.isfinite(noise))):
        raise InputError("NaN or inf in the interpolation or its noise", where="interpolation", expected="finite")
    if noise.ndim == 2:
        value, vector = np.linalg.eigh(noise)
        root = W @ (vector * np.sqrt(np.maximum(value, 0)))
    else:
        root = W * noise
    energy = np.linalg.svd(root, compute_uv=False) ** 2  # eigenvalues of C
    if not np.any(energy > 0):
        raise InputError("the interpolation keeps nothing", where="interpolation", expected="a matrix that is not zero")
    rank = int(np.sum(energy > max(W.shape) * np.finfo(float).eps * energy[0]))
    return Effective(len(W), float(energy.sum() ** 2 / np.sum(energy**2)), rank)
