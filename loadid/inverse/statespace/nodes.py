"""What a path says between the lambdas at which it was computed.

Every scalar of a Tikhonov path is a sum of functions of ``1 / (1 + lam^2 / gamma^2)``, analytic in t = ln lam^2 in a
strip of half-width pi: a table with 0.15 decades between its nodes and a spline of seventh degree through logarithms
leaves 1e-3 of norms and traces (1e-5 of edf), 2e-2 of the bend and of tr (I - A)^4, and of the sensitivity, which has
sharp dips, 0.5 (`tests/inverse/statespace/test_nodes.py`): the place of an optimum moves by less than 2 %. Derivatives
in t give the traces of powers: with f the filter factors, df/dt = -f (1 - f).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STEP = 0.15  # decades of lambda between nodes
AROUND = 4  # nodes beyond the ends of what was asked, for the spline
DEGREE = 7
TINY = np.finfo(float).tiny


class Table:
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
        self, compute: Callable[[float], NDArray], step: float = STEP, around: int = AROUND, degree: int = DEGREE
    ) -> None:
        self._compute, self._step, self._around, self._degree = compute, step, around, degree
        self._found: dict[int, NDArray] = {}

    def holds(self, lam: NDArray) -> bool:
        """Whether these can be answered without computing anything."""
        return all(i in self._found for i in self._range(lam))

    def nodes(self, lam: NDArray) -> NDArray[np.float64]:
        """Relative lambdas of the nodes that answer for these."""
        return 10 ** (self._step * np.asarray(self._range(lam)))

    def at(self, lam: NDArray) -> Values:
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

    def _range(self, lam: NDArray) -> range:
        where = np.log10(lam) / self._step
        low, high = int(np.floor(where.min())) - self._around, int(np.ceil(where.max())) + self._around
        while high - low < self._degree:  # a spline needs so many
            low, high = low - 1, high + 1
        return range(low, high + 1)


@dataclass(frozen=True)
class Values:
    """Logarithms of scalars and their derivatives in t = ln lam^2, each of shape (scalars, k)."""

    log: NDArray[np.float64]
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    third: NDArray[np.float64]

    def value(self, i: int) -> NDArray[np.float64]:
        """Scalar `i`."""
        return np.exp(self.log[i])

    def slopes(self, i: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Scalar `i` with its first three derivatives in t."""
        q, a, b, c = self.value(i), self.first[i], self.second[i], self.third[i]
        return q, q * a, q * (a**2 + b), q * (a**3 + 3 * a * b + c)


def powers_of_rest(slopes: tuple[NDArray, NDArray, NDArray, NDArray]) -> tuple[NDArray, NDArray]:
    """Traces of (I - A)^2 and (I - A)^4 from tr (I - A) and its derivatives.

    With h = 1 - f: h' = h - h^2, so that h^2 = h - h', h^3 = h^2 - (h^2)'/2, h^4 = h^3 - (h^3)'/3.
    """
    q, d1, d2, d3 = slopes
    two = q - d1
    two1, two2 = d1 - d2, d2 - d3
    three, three1 = two - two1 / 2, two1 - two2 / 2
    two = np.clip(two, TINY, q)
    return two, np.clip(three - three1 / 3, two**2 / np.maximum(q, TINY) * 1e-3, two)
