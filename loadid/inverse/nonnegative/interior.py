"""Interior-point method over a record: from inside the admissible loads to the minimum, however ill-conditioned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .normal import Normal

CAP = 80
NEAR = 0.995  # share of the way to the nearest bound
TIGHT = 1e-11  # complementarity, relative to |y|^2 / 2


@dataclass(frozen=True, eq=False)
class Inside:
    """Unknowns, multipliers (0 where the sign is free), steps."""

    v: NDArray[np.float64]
    s: NDArray[np.float64]
    steps: int


def interior(normal: Normal, signed: NDArray, start: NDArray, step: Callable[[], None], *, cap: int = CAP) -> Inside:
    """Predictor-corrector steps (Mehrotra, SIAM J. Optim. 2 (1992) 575) from an unconstrained solution.

    Each step solves ``(Q + diag(s / v)) dv = ...`` twice with one factorisation.
    """
    q, z = normal.q, signed
    v = start.copy()
    v[z] = np.maximum(v[z], 0.0) + 0.1 * float(np.mean(np.abs(v[z])))
    gradient = normal.gradient(v)
    s = np.zeros(len(v))
    s[z] = np.maximum(gradient[z], 0.0) + 0.1 * float(np.mean(np.abs(gradient[z])))
    size, steps = max(int(np.count_nonzero(z)), 1), 0
    enough, level = TIGHT * normal.data2 / 2, 1e-10 * float(np.abs(q).max(initial=0.0))
    while steps < cap:
        step()
        rest = gradient - s
        product = float(v[z] @ s[z])
        if product <= enough and np.abs(rest).max(initial=0.0) <= level:
            break
        mu, ratio, one = product / size, np.zeros(len(v)), np.zeros(len(v))
        ratio[z], one[z] = s[z] / v[z], 1 / v[z]
        factor = normal.factor(ratio)
        dv = factor.solve(-rest - s)
        ds = np.where(z, -s - ratio * dv, 0.0)
        after = (v + _reach(v, dv, z) * dv)[z] @ (s + _reach(s, ds, z) * ds)[z] / size
        push = np.where(z, ((after / mu) ** 3 * mu - dv * ds) * one, 0.0)
        dv = factor.solve(-rest - s + push)
        ds = np.where(z, -s - ratio * dv + push, 0.0)
        length = NEAR * min(_reach(v, dv, z), _reach(s, ds, z)) if size else 1.0
        v, s = v + length * dv, s + length * ds
        gradient = normal.gradient(v)
        steps += 1
    return Inside(v, s, steps)


def _reach(v: NDArray, dv: NDArray, signed: NDArray) -> float:
    """Largest step, at most 1 / NEAR, that keeps v positive where signed."""
    falling = signed & (dv < 0)
    return float(min(1 / NEAR, np.min(-v[falling] / dv[falling], initial=np.inf)))
