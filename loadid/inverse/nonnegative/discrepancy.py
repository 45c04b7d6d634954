"""Lambda of loads that only push: their residual is that of the noise.

The sign is knowledge about the load, so that less smoothing is needed than without it: at the lambda that a rule chose
without the sign, the residual of the constrained load exceeds the noise. Over lambda that residual rises monotonically.
On the half-sine benchmark (tests/benchmarks/nonnegative.py) the load error at this lambda is at most that at the lambda
of the unconstrained discrepancy, for every width of pulse and both noise levels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from structures.errors import InputError

from ..rules import discrepancy_level
from .solver import NonNegativeRecord, NonNegativeSolution

STRIDE = 3.0  # between two lambdas until they bracket the noise
REACH = 1e3  # ratio to the first lambda beyond which nothing is searched
CLOSE = 0.2  # of the scatter of the residual: nearer need not be
CAP = 12  # solutions


@dataclass(frozen=True, eq=False)
class Chosen:
    """Solution at the lambda that was found; `met` if its residual is that of the noise; every (lambda, residual^2)."""

    solution: NonNegativeSolution
    met: bool
    target: float
    tried: tuple[tuple[float, float], ...]


def discrepancy(
    record: NonNegativeRecord, lam: float, sigma: float, *, warm: NonNegativeSolution | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Chosen:  # fmt: skip
    """Largest lambda at which loads that push explain the data to the noise, with the margin of the unconstrained rule.

    Parameters
    ----------
    record : NonNegativeRecord
    lam : float
        Absolute lambda to begin with: the unconstrained choice.
    sigma : float
        Noise level of the whitened data.
    warm : NonNegativeSolution, optional
        Solution at or near `lam`.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Returns
    -------
    Chosen
        Where no lambda down to ``lam / 1000`` explains the data (loads that pull, a wrong model, a noise level that is
        too low), the solution at `lam` itself, with `met` False.

    Raises
    ------
    InputError
        No noise level.
    """
    if not (np.isfinite(sigma) and sigma > 0):
        raise InputError("no noise level", where="sigma", found=sigma, expected="a finite number > 0")
    target = discrepancy_level(record.m, sigma)
    close = CLOSE * np.sqrt(2 * record.m) * sigma**2
    found: list[NonNegativeSolution] = []

    def at(value: float) -> float:
        near = min(found, key=lambda s: abs(np.log(s.lam / value)), default=warm)
        report = None if progress is None else _part(progress, len(found))
        found.append(record.solve(value, near, report))
        return found[-1].residual2 - target

    a, fa = lam, at(lam)
    b, fb = a, fa
    while fa * fb > 0 and abs(fb) > close and len(found) < CAP and 1 / REACH < b / lam < REACH:
        a, fa = b, fb
        b = b / STRIDE if fb > 0 else b * STRIDE
        fb = at(b)
    if fa * fb > 0 and abs(fb) > close:
        explained = fb < 0  # even much smoothing leaves less than the noise
        return Chosen(found[-1] if explained else found[0], explained, target, _tried(found))
    while min(abs(s.residual2 - target) for s in found) > close and len(found) < CAP:
        # regula falsi in ln lambda; the end that stays counts half (Illinois)
        middle = float(np.exp((np.log(a) * fb - np.log(b) * fa) / (fb - fa)))
        fm = at(middle)
        if fm * fb > 0:
            b, fb, fa = middle, fm, fa / 2
        else:
            a, fa, b, fb = b, fb, middle, fm
    best = min(found, key=lambda s: abs(s.residual2 - target))
    return Chosen(best, True, target, _tried(found))


def _tried(found: list[NonNegativeSolution]) -> tuple[tuple[float, float], ...]:
    return tuple((s.lam, s.residual2) for s in found)


def _part(progress: Callable[[float, str], None], done: int) -> Callable[[float, str], None]:
    """Progress of one solution out of those that there may be."""
    return lambda fraction, text: progress((done + fraction) / CAP, text)
