"""How many modes the data hold, how fast the singular values fall, and what a better signal-to-noise ratio buys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError, as_array

from .. import Array, Indices

# how signals fall with the index of the mode; each has a rate that is fitted
LAWS: dict[str, Callable[[Array], Array]] = {
    "algebraic": np.log,
    "root": np.sqrt,
    "exponential": lambda i: i,
    "gaussian": np.square,
}
AROUND = np.array([0.3, 1.0, 3.0])  # a coefficient of the signal lies about the trend, or well below or above it
SHARE = np.array([0.2, 0.6, 0.2])
TYPICAL = float(np.log(1.4))  # what they make of the size of a coefficient
MOST = 8  # frames beyond which more of them do not make a plateau flatter: no real noise is white to that degree
BINS = 256  # more modes than these are taken together
FIRM = 3.5  # log-likelihood by which signal and noise must beat noise alone
SLIGHT = 3.5  # log-likelihood that a noise level must be worth: without it the coefficients fall to the end
FEWEST = 8  # coefficients, with those that no load can cause, without which no plateau can be told
LEAST = -38.0  # ln of the smallest level that is told from zero, relative to the largest coefficient


@dataclass(frozen=True)
class Plateau:
    """Start of the plateau of the data coefficients.

    Parameters
    ----------
    start : int
        Number of modes before it, i*: the recoverable ones.
    floor : float
        Level of the plateau, root mean square; 0 where the coefficients fall to the end.
    """

    start: int
    floor: float


def plateau(coefficients: ArrayLike, *, frames: int = 1, rest: tuple[float, int] = (0.0, 0)) -> Plateau:
    """Find where the data coefficients reach the noise, from them alone.

    Each coefficient is taken for a sum of signal and noise: normal, with the variance of the noise, the same for all,
    plus that of a signal that falls by one of four laws, about which it scatters widely (a mixture of three scales).
    The likeliest levels, law and rate are found; i* counts the modes in which the signal is above the noise. Only
    ratios of coefficients enter: scaling the operator or the data moves nothing. Singular values do not enter either.
    With fewer than `FEWEST` coefficients, and where a slow fall cannot be told from noise without a fall, all are kept
    in the first case and none in the second.

    Parameters
    ----------
    coefficients : array, shape (r,)
        |u_i^T y| in order of falling generalised singular values; with frames, root mean squares over them.
    frames : int
        Number of frames behind each.
    rest : (float, int)
        Sum of squares (per frame) and number of further coefficients that no load can cause, those of directions of
        the data outside the range of the operator: noise beyond doubt.

    Raises
    ------
    InputError
        If they are no finite numbers.
    """
    b = np.abs(as_array(coefficients, where="plateau", dtype=float))
    if b.ndim != 1 or not np.all(np.isfinite(b)):
        raise InputError(
            "no data coefficients", where="plateau", found=f"shape {b.shape}, or NaN", expected="finite, (modes,)"
        )
    outside, count = rest
    largest = max(b.max(initial=0.0), float(np.sqrt(max(outside, 0.0) / count)) if count else 0.0)
    if largest == 0 or len(b) == 0:
        return Plateau(0, float(largest))
    if len(b) + count < FEWEST:
        return Plateau(len(b), 0.0)
    data = _Data.of(b / largest, frames, float(np.sqrt(outside) / largest) ** 2, count)
    noise = data.level(0)
    alone = data.likelihood(np.array([noise, LEAST, 0.0]), LAWS["exponential"])
    value, best, law = max((_climb(data, law) for law in LAWS.values()), key=lambda found: found[0])
    if value < alone + FIRM:
        return Plateau(0, float(np.exp(noise)) * largest)
    if count == 0 and data.likelihood(_silent(data, best, law), law) > value - SLIGHT:
        return Plateau(len(b), 0.0)
    i = np.arange(1, len(b) + 1)
    start = int(np.sum(_trend(best, law, i, len(b)) + TYPICAL > best[0]))
    return Plateau(start, float(np.exp(best[0])) * largest if best[0] > LEAST + 1 else 0.0)


@dataclass(frozen=True)
class _Data:
    """Squares of coefficients, of neighbours together where there are many, and how many normal numbers are in each."""

    i: Array  # index of the mode
    squares: Array  # mean
    freedom: Array
    rest: float  # mean square of what no load can cause
    count: float  # its freedom
    modes: int

    @classmethod
    def of(cls, b: Array, frames: int, rest: float, count: int) -> _Data:
        each, nu = -(-len(b) // BINS), float(min(max(frames, 1), MOST))
        edges = np.arange(0, len(b), each)
        size = np.diff([*edges, len(b)])
        squares = np.add.reduceat(b**2, edges) / size
        # what lies outside counts no more than the modes: where the model errs, its level is not quite theirs
        weight = nu * min(count, len(b))
        return cls(edges + (size + 1) / 2, squares, nu * size, rest / count if count else 0.0, weight, len(b))

    def level(self, first: int) -> float:
        """Log of the root mean square of the noise if it begins at a bin."""
        total = np.sum((self.squares * self.freedom)[first:]) + self.rest * self.count
        freedom = np.sum(self.freedom[first:]) + self.count
        return max(0.5 * float(np.log(max(total / freedom, 1e-300))), LEAST) if freedom else LEAST

    def likelihood(self, x: Array, law: Callable[[Array], Array]) -> float:
        """Log-likelihood of noise level, signal level and rate, `x` = (ln s, ln t at the first mode, ln rate)."""
        s2 = np.exp(2 * max(x[0], LEAST))
        t = np.exp(np.maximum(_trend(x, law, self.i, self.modes), LEAST))
        v = s2 + np.square(AROUND[:, None] * t)
        each = -0.5 * self.freedom * (self.squares / v + np.log(v))
        top = each.max(axis=0)
        modes = top + np.log(SHARE @ np.exp(each - top))
        return float(float(np.sum(modes)) - 0.5 * self.count * (self.rest / s2 + np.log(s2)))


def _trend(x: Array, law: Callable[[Array], Array], i: Array | Indices, modes: int) -> Array:
    """Log of the level of the signal: from x[1] at the first mode, falling at the rate exp(x[2])."""
    span = float(law(np.array([max(modes, 2.0)]))[0] - law(np.array([1.0]))[0])
    return np.asarray(x[1] - np.exp(min(x[2], 8.0)) * (law(np.asarray(i, float)) - law(np.array([1.0]))[0]) / span)


def _climb(data: _Data, law: Callable[[Array], Array]) -> tuple[float, Array, Callable[[Array], Array]]:
    """Likeliest levels and rate under one law, from the best of some starts."""
    from scipy.optimize import minimize

    logs = 0.5 * np.log(np.maximum(data.squares, np.exp(2 * LEAST)))
    starts = []
    for k in sorted({*np.linspace(2, len(logs), 9).round().astype(int), 3, 5, 8}):
        if 2 <= k <= len(logs):
            fall = -_trend(np.array([0.0, 0.0, 0.0]), law, data.i[:k], data.modes)
            slope, level = np.polyfit(fall, logs[:k], 1)
            starts.append(np.array([data.level(k), level, np.log(max(-slope, 0.1))]))
    if not starts:
        starts = [np.array([LEAST, logs[0], 0.0])]
    values = [data.likelihood(x, law) for x in starts]
    best = starts[int(np.argmax(values))]
    simplex = best + np.vstack([np.zeros(3), np.diag([0.7, 0.7, 0.5])])
    options = {"initial_simplex": simplex, "maxfev": 200, "xatol": 0.02, "fatol": 0.02}
    found = minimize(lambda x: -data.likelihood(x, law), best, method="Nelder-Mead", options=options)
    return -float(found.fun), found.x, law


def _silent(data: _Data, best: Array, law: Callable[[Array], Array]) -> Array:
    """Likeliest signal if there is no noise."""
    from scipy.optimize import minimize

    def whole(x: Array) -> Array:
        return np.array([LEAST, *x])

    options = {"maxfev": 120, "xatol": 0.02, "fatol": 0.02}
    found = minimize(lambda x: -data.likelihood(whole(x), law), best[1:], method="Nelder-Mead", options=options)
    return whole(found.x)


DECAY_LAWS = ("gaussian", "exponential", "algebraic")
DEEPEST = 1e-6  # of the largest singular value: no sensor resolves 120 dB, and below it kinks and the grid rule
FEWEST_VALUES = 6  # values above rounding without which no law can be told
_RISE: dict[str, Callable[[Array], Array]] = {"gaussian": np.square, "exponential": np.asarray, "algebraic": np.log}


@dataclass(frozen=True)
class Decay:
    """Law by which singular values fall: ``ln sigma_k = level - rate * x(k)`` with x = k^2, k or ln k.

    Parameters
    ----------
    law : str
        ``gaussian``, ``exponential``, ``algebraic`` (k^-p, p = `rate`), or ``unknown`` with too few values.
    rate : float
        Slope; the exponent p of the algebraic law.
    level : float
        ln of the fitted first value over the largest one.
    r2 : float
        Share of the variance of ln sigma that the law explains.
    rivals : dict
        r2 of every law.
    values : int
        How many singular values were fitted.
    dimension : int
        Of the region over which the loads are spread: k = i^(1/dimension) counts waves in one direction.
    """

    law: str
    rate: float
    level: float
    r2: float
    rivals: dict[str, float]
    values: int
    dimension: int = 1

    def finest(self, snr: float) -> float:
        """Largest k whose singular value is above the first one over `snr`; NaN for an unknown law."""
        room = self.level + float(np.log(snr))
        if self.law == "unknown" or self.rate <= 0:
            return float("nan")
        if self.law == "algebraic":
            return float(np.exp(room / self.rate))
        return float(float(max(room, 0.0) / self.rate) ** (0.5 if self.law == "gaussian" else 1.0))

    def buys(self, gain: float = 100.0, snr: float = 100.0) -> float:
        """How many times finer the resolution becomes when an SNR of `snr` is raised by `gain`.

        Gaussian: square root of the ratio of the logarithms; exponential: their ratio; algebraic: gain^(1/p), whatever
        the SNR. Loads, sensors and the mesh may end it sooner. NaN for an unknown law.
        """
        before, after = self.finest(snr), self.finest(snr * gain)
        return after / before if before > 0 else float("nan")

    def __str__(self) -> str:
        if self.law == "unknown":
            return f"no law of decay from {self.values} singular values"
        name = f"algebraically, k^-{self.rate:.2g}" if self.law == "algebraic" else f"like {_ARTICLE[self.law]}"
        return f"singular values fall {name} (R2 {self.r2:.3f} over {self.values})"


_ARTICLE = {"gaussian": "a Gaussian, exp(-c k^2)", "exponential": "an exponential, exp(-c k)"}


def decay(singular_values: ArrayLike, dimension: int = 1, unknowns: int | None = None) -> Decay:
    """Fit the three laws to the singular values above rounding and above `DEEPEST`, and take the best.

    Parameters
    ----------
    singular_values : array, shape (r,)
    dimension : int
        1 for loads along a line, 2 for a surface: there are k^2 modes of up to k waves in each direction.
    unknowns : int, optional
        Larger side of the operator, for what rounding leaves; default r.

    Raises
    ------
    InputError
        If they are no finite numbers.
    """
    s = np.sort(np.abs(as_array(singular_values, where="decay", dtype=float)))[::-1]
    if s.ndim != 1 or not np.all(np.isfinite(s)):
        raise InputError("no singular values", where="decay", found=f"shape {s.shape}, or NaN", expected="finite, (r,)")
    tol = 10 * max(unknowns or 0, len(s)) * np.finfo(float).eps  # ten times: values near rounding are no longer true
    s = s[s > tol * s.max(initial=0.0)]
    within = int(np.sum(s > DEEPEST * s.max(initial=0.0)))
    s = s[:within] if within >= FEWEST_VALUES else s
    if len(s) < FEWEST_VALUES or s[-1] == s[0]:
        return Decay("unknown", 0.0, 0.0, 0.0, {}, len(s), dimension)
    y, k = np.log(s / s[0]), np.arange(1.0, len(s) + 1) ** (1 / dimension)
    fits = {law: _line(_RISE[law](k), y) for law in DECAY_LAWS}
    best = max(DECAY_LAWS, key=lambda law: fits[law][2])
    slope, level, r2 = fits[best]
    return Decay(best, -slope, level, r2, {law: fits[law][2] for law in DECAY_LAWS}, len(s), dimension)


def _line(x: Array, y: Array) -> tuple[float, float, float]:
    """Slope, level and R2 of a straight line."""
    slope, level = np.polyfit(x, y, 1)
    return float(slope), float(level), float(1 - np.sum((y - level - slope * x) ** 2) / np.sum((y - y.mean()) ** 2))
