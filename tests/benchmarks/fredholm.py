"""The classic Fredholm and Volterra test problems, built from their definitions by the midpoint rule.

Kernels and solutions as collected in P. C. Hansen, Regularization Tools, Numer. Algorithms 6 (1994) 1.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Problem = tuple[NDArray[np.float64], NDArray[np.float64]]  # operator (n, n) and load (n,)


def _midpoints(low: float, high: float, n: int) -> tuple[NDArray, float]:
    step = (high - low) / n
    return low + step * (np.arange(n) + 0.5), step


def deriv2(n: int) -> Problem:
    """Green's function of the second derivative on [0, 1]; f(t) = t."""
    t, step = _midpoints(0, 1, n)
    s, u = t[:, None], t[None]
    return step * np.where(s < u, s * (u - 1), u * (s - 1)), t


def shaw(n: int) -> Problem:
    """One-dimensional image of light behind a slit."""
    t, step = _midpoints(-np.pi / 2, np.pi / 2, n)
    u = np.sin(t)[:, None] + np.sin(t)[None]
    kernel = (np.cos(t)[:, None] + np.cos(t)[None]) ** 2 * np.sinc(u) ** 2
    return step * kernel, 2 * np.exp(-6 * (t - 0.8) ** 2) + np.exp(-2 * (t + 0.5) ** 2)


def heat(n: int) -> Problem:
    """Inverse heat equation: Volterra kernel t^(-3/2) exp(-1/(4t)) / (2 sqrt(pi)); the load ends at half time."""
    t, step = _midpoints(0, 1, n)
    k = step * t**-1.5 * np.exp(-1 / (4 * t)) / (2 * np.sqrt(np.pi))
    lag = np.arange(n)[:, None] - np.arange(n)[None]
    x = 20 * (np.arange(n) + 1) / n
    load = np.select(
        [x < 2, x < 3, x <= 10], [0.75 * x**2 / 4, 0.75 + (x - 2) * (3 - x), 0.75 * np.exp(-2 * (x - 3))], 0.0
    )
    return np.where(lag >= 0, k[np.maximum(lag, 0)], 0.0), load


def phillips(n: int) -> Problem:
    """Convolution on [-6, 6] of 1 + cos(pi x / 3), |x| < 3, with itself."""
    t, step = _midpoints(-6, 6, n)

    def phi(x: NDArray) -> NDArray:
        return np.where(np.abs(x) < 3, 1 + np.cos(np.pi * x / 3), 0.0)

    return step * phi(t[:, None] - t[None]), phi(t)


def foxgood(n: int) -> Problem:
    """Kernel sqrt(s^2 + t^2) on [0, 1], severely ill-posed; f(t) = t."""
    t, step = _midpoints(0, 1, n)
    return step * np.hypot(t[:, None], t[None]), t


def gravity(n: int) -> Problem:
    """Vertical gravity of a mass line at depth 1/4."""
    t, step = _midpoints(0, 1, n)
    return step * 0.25 * (0.25**2 + (t[:, None] - t[None]) ** 2) ** -1.5, np.sin(np.pi * t) + 0.5 * np.sin(
        2 * np.pi * t
    )


def baart(n: int) -> Problem:
    """Kernel exp(s cos t), s in [0, pi/2], t in [0, pi]; f(t) = sin t."""
    s, _ = _midpoints(0, np.pi / 2, n)
    t, step = _midpoints(0, np.pi, n)
    return step * np.exp(s[:, None] * np.cos(t)[None]), np.sin(t)


PROBLEMS: dict[str, Callable[[int], Problem]] = {
    f.__name__: f for f in (deriv2, shaw, heat, phillips, foxgood, gravity, baart)
}


# -- noise -----------------------------------------------------------------------------------------------------------
def white(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Independent noise of unit std."""
    return rng.standard_normal(n)


def autoregressive(rng: np.random.Generator, n: int, a: float = 0.9) -> NDArray[np.float64]:
    """AR(1) noise of unit std."""
    e = rng.standard_normal(n)
    e[1:] *= np.sqrt(1 - a**2)
    for k in range(1, n):
        e[k] += a * e[k - 1]
    return e


def interpolated(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Independent noise of every second sample, linear in between; mean square 1."""
    knots = np.arange(0, n, 2)
    e = np.interp(np.arange(n), knots, rng.standard_normal(len(knots)))
    return e / np.sqrt(0.75)


NOISES: dict[str, Callable[[np.random.Generator, int], NDArray[np.float64]]] = {
    "white": white,
    "AR(1) 0.9": autoregressive,
    "interpolated": interpolated,
}
