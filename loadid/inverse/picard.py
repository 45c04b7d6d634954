"""How many modes the data hold: where the data coefficients |u_i^T y| stop falling and stay at the noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import as_array

# how signals fall with the index of the mode; each has a rate that is fitted
LAWS: dict[str, Callable[[NDArray], NDArray]] = {
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

    i: NDArray[np.float64]  # index of the mode
    squares: NDArray[np.float64]  # mean
    freedom: NDArray[np.float64]
    rest: float  # mean square of what no load can cause
    count: float  # its freedom
    modes: int

    @classmethod
    def of(cls, b: NDArray, frames: int, rest: float, count: int) -> _Data:
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

    def likelihood(self, x: NDArray, law: Callable[[NDArray], NDArray]) -> float:
        """Log-likelihood of noise level, signal level and rate, `x` = (ln s, ln t at the first mode, ln rate)."""
        s2 = np.exp(2 * max(x[0], LEAST))
        t = np.exp(np.maximum(_trend(x, law, self.i, self.modes), LEAST))
        v = s2 + np.square(AROUND[:, None] * t)
        each = -0.5 * self.freedom * (self.squares / v + np.log(v))
        top = each.max(axis=0)
        modes = top + np.log(SHARE @ np.exp(each - top))
        return float(np.sum(modes)) - 0.5 * self.count * (self.rest / s2 + np.log(s2))


def _trend(x: NDArray, law: Callable[[NDArray], NDArray], i: NDArray, modes: int) -> NDArray:
    """Log of the level of the signal: from x[1] at the first mode, falling at the rate exp(x[2])."""
    span = float(law(np.array([max(modes, 2.0)]))[0] - law(np.array([1.0]))[0])
    return x[1] - np.exp(min(x[2], 8.0)) * (law(i) - law(np.array([1.0]))[0]) / span


def _climb(data: _Data, law: Callable[[NDArray], NDArray]) -> tuple[float, NDArray, Callable[[NDArray], NDArray]]:
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


def _silent(data: _Data, best: NDArray, law: Callable[[NDArray], NDArray]) -> NDArray[np.float64]:
    """Likeliest signal if there is no noise."""
    from scipy.optimize import minimize

    def whole(x: NDArray) -> NDArray:
        return np.array([LEAST, *x])

    options = {"maxfev": 120, "xatol": 0.02, "fatol": 0.02}
    found = minimize(lambda x: -data.likelihood(whole(x), law), best[1:], method="Nelder-Mead", options=options)
    return whole(found.x)
