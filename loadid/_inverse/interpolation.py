"""What a path says between the lambdas at which it was computed.

All scalars are sums of functions of ``1 / (1 + lambda^2 / gamma^2)``, analytic in t = ln lambda^2 in a strip of
half-width pi, so that few nodes do: Hermite polynomials through logarithms and their derivatives where the solves give
these (`moments`), a spline where they do not (`Traces`).

Every scalar of a Tikhonov path is a sum of functions of ``1 / (1 + lam^2 / gamma^2)``, analytic in t = ln lam^2 in a
strip of half-width pi: a table with 0.15 decades between its nodes and a spline of seventh degree through logarithms
leaves 1e-3 of norms and traces (1e-5 of edf), 2e-2 of the bend and of tr (I - A)^4, and of the sensitivity, which has
sharp dips, 0.5 (`tests/inverse/statespace/test_nodes.py`): the place of an optimum moves by less than 2 %. Derivatives
in t give the traces of powers: with f the filter factors, df/dt = -f (1 - f).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np

from . import Array

ROUNDED = 1e-15  # part of the modes that rounding leaves
TINY = np.finfo(float).tiny
STEP, CLOSE = 0.5, 0.25  # decades between nodes with derivatives, and between those of a spline
WIDE = 1.0  # relative lambda above which nodes are twice as far apart
BEYOND = np.array([1e2, 1e3, 1e4])  # relative lambda where the governed part is known to fall as 1 / lambda^2
DECADE = np.log(10)


class HermiteTable:
    """Logarithms of scalars with derivatives in t at nodes, each node computed when first asked for.

    Parameters
    ----------
    compute : callable
        Relative lambda -> groups of scalars, each (scalars, d): logarithm and d - 1 derivatives in t = ln lambda^2.
    low : float
        Smallest relative lambda of a node.
    """

    def __init__(self, compute: Callable[[float], tuple[Array, ...]], low: float) -> None:
        self._compute, self._t = compute, nodes(low, STEP, BEYOND[-1])
        self._found: dict[int, tuple[Array, ...]] = {}

    def holds(self, lam: Array) -> bool:
        """Whether these can be answered without computing anything."""
        return all(i in self._found for i in self._range(lam))

    def at(self, lam: Array) -> Array:
        """Scalars of all groups at relative lambdas (k,): shape (scalars, k)."""
        from scipy.interpolate import BPoly

        where = self._range(lam)
        for i in where:
            if i not in self._found:
                self._found[i] = self._compute(float(np.exp(0.5 * self._t[i])))
        groups = zip(*(self._found[i] for i in where), strict=True)
        curves = [BPoly.from_derivatives(self._t[where], [values.T for values in group]) for group in groups]
        return np.concatenate([np.exp(curve(2 * np.log(lam))).T for curve in curves])

    def _range(self, lam: Array) -> range:
        last = len(self._t) - 1
        low = int(np.searchsorted(self._t, 2 * np.log(lam.min()), side="right")) - 1
        high = int(np.searchsorted(self._t, 2 * np.log(lam.max()), side="left"))
        low = min(max(low, 0), last - 1)
        return range(low, min(max(high, low + 1), last) + 1)


def nodes(low: float, step: float, high: float) -> Array:
    """Values of t = ln lambda^2 from `low` to beyond `high`, `step` decades of lambda apart, twice that above 1."""
    fine = np.arange(np.log(low), np.log(WIDE) + step * DECADE, step * DECADE)
    coarse = np.arange(fine[-1], np.log(high) + 2 * step * DECADE, 2 * step * DECADE)[1:]
    return 2 * np.concatenate([fine, coarse])


def logs(values: Array) -> Array:
    """Logarithms with derivatives from values with derivatives, both (scalars, d)."""
    value = np.maximum(values[:, :1], TINY)
    share = np.where(values[:, :1] > TINY, values / value, 0.0)
    out = np.concatenate([np.log(value), np.zeros_like(values[:, 1:])], axis=1)
    for n in range(1, values.shape[1]):  # f^(n) = sum_k C(n - 1, k) f^(k) u^(n - k) with f' = f u'
        out[:, n] = share[:, n] - sum(comb(n - 1, k) * share[:, k] * out[:, n - k] for k in range(1, n))
    return out


@dataclass(frozen=True)
class Powers:
    """Traces at some lambdas, (k,) each: the part of tr A that the penalty governs, its rest, and derivatives in t."""

    part: Array
    rest: Array
    first: Array
    second: Array
    third: Array


class Traces:
    """Spline through the odds ``part / rest`` of the degrees of freedom, which is straight for a single mode.

    Parameters
    ----------
    compute : callable
        Relative lambda -> (part, rest, trace of B) with part + rest the number of governed modes.
    low : float
        Smallest relative lambda that will be asked for.
    """

    def __init__(self, compute: Callable[[float], tuple[float, float, float]], low: float) -> None:
        self._compute, self._low = compute, low

    @cached_property
    def _nodes(self) -> tuple[Array, Array]:
        t = nodes(self._low, CLOSE, 10.0)
        lam = np.exp(0.5 * t)
        found = np.array([self._compute(float(x)) for x in lam])
        found[:, 0] = np.maximum(found[:, 0], 1 / (1 + lam**2))  # that of the largest mode alone
        part = found[-1, 0] * (lam[-1] / BEYOND) ** 2
        rows = np.stack([part, np.sum(found[-1, :2]) - part, np.full(len(part), found[-1, 2])], axis=1)
        return np.append(t, 2 * np.log(BEYOND)), np.concatenate([found, rows])

    @cached_property
    def _spline(self) -> Callable[..., Array]:
        from scipy.interpolate import make_interp_spline

        t, found = self._nodes
        least = ROUNDED * np.sum(found[-1, :2])  # a part that is nothing beside all modes is rounding, of either sign
        part, rest, trace = np.maximum(found, [least, least, TINY]).T
        # beyond the largest mode the odds fall as 1 / lambda^2: taken out, little is left to interpolate
        spline: Callable[..., Array] = make_interp_spline(t, np.array([np.log(part / rest) + t, np.log(trace)]).T, k=5)
        return spline

    def powers(self, lam: Array) -> Powers:
        """Part, rest and derivatives at relative lambdas."""
        t, (_, found) = 2 * np.log(lam), self._nodes
        count = float(found[-1, 0] + found[-1, 1])
        s, s1, s2, s3 = (self._spline(t, nu=k)[:, 0] for k in range(4))
        s, s1 = s - t, s1 - 1.0
        f, g = 1 / (1 + np.exp(-s)), 1 / (1 + np.exp(s))
        return Powers(
            count * f,
            count * g,
            count * f * g * s1,
            count * f * g * ((g - f) * s1**2 + s2),
            count * f * g * (((g - f) ** 2 - 2 * f * g) * s1**3 + 3 * (g - f) * s1 * s2 + s3),
        )

    def trace(self, lam: Array) -> tuple[Array, Array]:
        """Trace of B and its derivative in t."""
        t = 2 * np.log(lam)
        value = np.exp(self._spline(t)[:, 1])
        return value, value * self._spline(t, nu=1)[:, 1]

    @property
    def grid(self) -> Array:
        """Relative lambdas, closely spaced, over all nodes."""
        t = self._nodes[0]
        return np.exp(0.5 * np.linspace(t[0], t[-1], 16 * len(t)))

    def log_ratio(self, lam: Array) -> Array:
        """Sum of ln(1 + gamma^2 / lambda^2): the integral of the part over t, from lambda to infinity."""
        nodes = self._nodes[0]
        x, w = np.polynomial.legendre.leggauss(8)

        def over(a: Array, b: Array) -> Array:
            t = 0.5 * (a + b)[:, None] + 0.5 * (b - a)[:, None] * x
            return 0.5 * (b - a) * (self.powers(np.exp(0.5 * t.ravel())).part.reshape(t.shape) @ w)

        whole = over(nodes[:-1], nodes[1:])
        after = np.append(np.cumsum(whole[::-1])[::-1], 0.0) + self._nodes[1][-1, 0]  # beyond: part ~ 1 / lambda^2
        t = 2 * np.log(lam)
        k = np.clip(np.searchsorted(nodes, t, side="left"), 0, len(nodes) - 1)
        return np.asarray(over(t, nodes[k]) + after[k])


NODE_STEP = 0.15  # decades of lambda between nodes
AROUND = 4  # nodes beyond the ends of what was asked, for the spline
DEGREE = 7


class SplineTable:
    """Positive scalars of a path on a grid of ln lambda, computed where they are first asked for.

    Parameters
    ----------
    compute : callable
        Relative lambda -> array of positive scalars.
    step : float
        Decades between nodes.
    around, degree : int
        Nodes beyond the ends of what is asked, and degree of the spline.
    """

    def __init__(
        self, compute: Callable[[float], Array], step: float = NODE_STEP, around: int = AROUND, degree: int = DEGREE
    ) -> None:
        self._compute, self._step, self._around, self._degree = compute, step, around, degree
        self._found: dict[int, Array] = {}

    def holds(self, lam: Array) -> bool:
        """Whether these can be answered without computing anything."""
        return all(i in self._found for i in self._range(lam))

    def nodes(self, lam: Array) -> Array:
        """Relative lambdas of the nodes that answer for these."""
        return 10 ** (self._step * np.asarray(self._range(lam)))

    def at(self, lam: Array) -> Values:
        """Values at relative lambdas (k,)."""
        from scipy.interpolate import make_interp_spline

        where = self._range(lam)
        for i in where:
            if i not in self._found:
                self._found[i] = np.log(np.maximum(self._compute(10 ** (self._step * i)), TINY))
        t = 2 * np.log(10) * self._step * np.asarray(where)
        spline = make_interp_spline(t, np.array([self._found[i] for i in where]), k=self._degree)
        at = 2 * np.log(lam)
        return Values(*(np.asarray(spline(at, nu)).T for nu in range(4)))

    def _range(self, lam: Array) -> range:
        where = np.log10(lam) / self._step
        low, high = int(np.floor(where.min())) - self._around, int(np.ceil(where.max())) + self._around
        while high - low < self._degree:  # a spline needs so many
            low, high = low - 1, high + 1
        return range(low, high + 1)


@dataclass(frozen=True)
class Values:
    """Logarithms of scalars and their derivatives in t = ln lam^2, each of shape (scalars, k)."""

    log: Array
    first: Array
    second: Array
    third: Array

    def value(self, i: int) -> Array:
        """Scalar `i`."""
        return np.asarray(np.exp(self.log[i]))

    def slopes(self, i: int) -> tuple[Array, Array, Array, Array]:
        """Scalar `i` with its first three derivatives in t."""
        q, a, b, c = self.value(i), self.first[i], self.second[i], self.third[i]
        return q, q * a, q * (a**2 + b), q * (a**3 + 3 * a * b + c)


def powers_of_rest(slopes: tuple[Array, Array, Array, Array]) -> tuple[Array, Array]:
    """Traces of (I - A)^2 and (I - A)^4 from tr (I - A) and its derivatives.

    With h = 1 - f: h' = h - h^2, so that h^2 = h - h', h^3 = h^2 - (h^2)'/2, h^4 = h^3 - (h^3)'/3.
    """
    q, d1, d2, d3 = slopes
    two = q - d1
    two1, two2 = d1 - d2, d2 - d3
    three, three1 = two - two1 / 2, two1 - two2 / 2
    two = np.clip(two, TINY, q)
    return two, np.clip(three - three1 / 3, two**2 / np.maximum(q, TINY) * 1e-3, two)
