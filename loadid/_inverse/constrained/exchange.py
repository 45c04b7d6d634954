"""Active set, interior point and projected gradient over a normal operator, and the duality gap that judges them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .normal import NormalFactor, NormalOperator, RecordNormal

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

REFINEMENTS = 2


def violation(gradient: Array, signed: Mask) -> Array:
    """What the gradient lacks to be that of a minimum: it is >= 0 where a load may only push, 0 elsewhere."""
    return np.where(signed, np.maximum(-gradient, 0.0), -gradient)


def gap(normal: RecordNormal, free: NormalFactor, v: Array, gradient: Array, signed: Mask) -> float:
    """Objective at v (>= 0 where signed) minus a lower bound of its minimum, over ``|y|^2 / 2``.

    The dual of ``min v^T Q v / 2 - q^T v + |y|^2 / 2, v >= 0`` (Wolfe) is to maximise ``|y|^2 / 2 - u^T Q u / 2`` over
    all u with ``Q u - q >= 0``. With ``d`` the violation at v, ``u = v + Q^-1 d`` is such a point, its gradient
    ``s = Q u - q`` is that of v without its negative part, and the difference of the two objectives is
    ``v^T s + (u - v)^T Q (u - v) / 2``: no large numbers are subtracted.

    Parameters
    ----------
    normal : RecordNormal
    free : NormalFactor
        Factors of Q itself.
    v, gradient : array, shape (size,)
        Point and ``Q v - q``.
    signed : array of bool, shape (size,)
        Unknowns that may only push.
    """
    if normal.data2 == 0.0:
        return 0.0
    move, s, curvature = np.zeros(len(v)), gradient, 0.0
    for _ in range(1 + REFINEMENTS):
        move = move + free.solve(violation(s, signed))
        image = normal.apply(move)
        s, curvature = gradient + image, float(move @ image)
    return (float(np.abs(v) @ np.abs(s)) + curvature / 2) / (normal.data2 / 2)


CAP = 60  # steps
PATIENCE = 6  # steps without fewer unknowns on the wrong side
FEW = 10  # unknowns on the wrong side that are worth every patience


@dataclass(frozen=True, eq=False)
class Exchanged:
    """Where the exchange stands: unknowns, gradient, held unknowns, whether none is on the wrong side, steps."""

    v: Array
    gradient: Array
    held: Mask
    settled: bool
    steps: int


def exchange(
    normal: NormalOperator, lower: Array, upper: Array | None, low: Mask, high: Mask | None = None, *,
    step: Callable[[], None] = lambda: None, pace: float | None = None, patience: int = PATIENCE, eager: float = 0.0,
    cap: int = CAP,
) -> Exchanged:  # fmt: skip
    """From a guess of what is held to the minimum: unknowns beyond a bound are held, held ones pulled inside are freed.

    Primal-dual active set; Hintermüller, Ito & Kunisch, SIAM J. Optim. 13 (2002) 865; with two bounds Kunisch & Rendl,
    SIAM J. Optim. 14 (2003) 35. It ends after a finite number of steps or cycles, and gives up where the unknowns on
    the wrong side stop becoming fewer.

    Parameters
    ----------
    normal : NormalOperator
    lower, upper : array, shape (size,)
        Bounds, infinite where there is none; no upper ones where None.
    low, high : array of bool, shape (size,)
        Unknowns that are held at a bound to begin with.
    step : callable, optional
        Called before each step.
    pace : float, optional
        Gives up as well where unknowns on the wrong side fall more slowly than by this factor for each step.
    patience : int
    eager : float
        Held unknowns that are pulled less than this share of the most pulled one wait: many need not move at all.
    cap : int
        Most steps.

    Raises
    ------
    LinAlgError
        A face on which the normal operator is singular.
    """
    slack, fewest, since, steps, allowed = normal.slack, len(low) + 1, 0, 0, np.inf
    while True:
        step()
        steps += 1
        held = low if high is None else low | high
        fixed = np.where(low, lower, 0.0)
        if high is not None and upper is not None:
            fixed[high] = upper[high]
        v, gradient = on_face(normal, held, fixed)
        wrong_low = np.where(low, gradient < -slack, ~held & (v < lower))
        wrong = wrong_low if high is None or upper is None else (
            wrong_low | np.where(high, gradient > slack, ~held & (v > upper)))  # fmt: skip
        count = int(np.count_nonzero(wrong))
        if pace is not None:
            allowed = max(FEW, count if steps == 1 else pace * allowed)
        if count < fewest:
            fewest, since = count, 0
        since += 1
        if count == 0 or count > allowed or steps >= cap or since > patience:
            return Exchanged(v, gradient, held, count == 0, steps)
        if eager and np.any(wrong & held):
            pulled = np.where(wrong & held, np.abs(gradient) / slack, 0.0)
            wrong &= ~held | (pulled >= eager * pulled.max())
        if high is None or upper is None:
            low = low ^ wrong
        else:
            low, high = (
                np.where(held, low & ~wrong, wrong & (v < lower)),
                np.where(held, high & ~wrong, wrong & (v > upper)),
            )


def on_face(normal: NormalOperator, held: Mask, fixed: Array) -> tuple[Array, Array]:
    """Minimum where the held unknowns are `fixed`, refined, and its gradient."""
    factor, right = normal.factor(np.where(held, np.inf, 0.0)), normal.q
    if np.any(fixed):
        right = right - normal.apply(fixed)
    v = fixed + factor.solve(np.where(held, 0.0, right))
    gradient = normal.gradient(v)
    level = normal.precision * float(np.abs(normal.q).max(initial=0.0))
    for _ in range(3):
        rest = np.where(held, 0.0, -gradient)
        if np.abs(rest).max(initial=0.0) <= level:
            break
        v = v + factor.solve(rest)
        gradient = normal.gradient(v)
    return v, gradient


INTERIOR_CAP = 80
NEAR = 0.995  # share of the way to the nearest bound
TIGHT = 1e-11  # complementarity, relative to |y|^2 / 2


@dataclass(frozen=True, eq=False)
class Inside:
    """Unknowns, multipliers (0 where the sign is free), steps."""

    v: Array
    s: Array
    steps: int


def interior(
    normal: RecordNormal, signed: Mask, start: Array, step: Callable[[], None], *, cap: int = INTERIOR_CAP
) -> Inside:
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


def _reach(v: Array, dv: Array, signed: Mask) -> float:
    """Largest step, at most 1 / NEAR, that keeps v positive where signed."""
    falling = signed & (dv < 0)
    return float(min(1 / NEAR, np.min(-v[falling] / dv[falling], initial=np.inf)))


REPORT = 100  # steps between two reports


def projected(normal: RecordNormal, signed: Mask, start: Array, steps: int, report: Callable[[], None]) -> Array:
    """Unknowns after some steps of FISTA with restart, >= 0 where signed.

    Beck & Teboulle, SIAM J. Imaging Sci. 2 (2009) 183; O'Donoghue & Candes, Found. Comput. Math. 15 (2015) 715.
    """
    x = z = np.where(signed, np.maximum(start, 0.0), start)
    t, length = 1.0, 1 / normal.reach
    for k in range(steps):
        if k % REPORT == 0:
            report()
        new = z - length * normal.gradient(z)
        new = np.where(signed, np.maximum(new, 0.0), new)
        if (z - new) @ (new - x) > 0:
            t = 1.0
        later = (1 + np.sqrt(1 + 4 * t * t)) / 2
        x, z, t = new, new + (t - 1) / later * (new - x), later
    return x
