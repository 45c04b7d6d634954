"""Multipliers and active sets of a constrained solution, in the order and the numbering of its constraints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .constraints import Bounds, Constraint, FrictionCone, NonNegative, Resultant, Support
from .face import Face
from .feasible import Feasible
from .resultants import soft, whitening

if TYPE_CHECKING:
    from .activeset import Point

Pair = tuple[NDArray[np.float64], NDArray]  # multipliers, active


def by_constraint(
    constraints: Sequence[Constraint], s: Feasible, p: Point, face: Face, slope: NDArray, push: NDArray
) -> list[Pair]:
    """What each constraint pushes, and where it acts (soft resultants: see `with_soft`).

    Parameters
    ----------
    slope : array, shape (n,)
        Gradient of half the objective by all loads.
    push : array, shape (kept,)
        What intervals and cones push, by the local unknowns.
    """
    in_cone = np.zeros(len(s.keep), bool)
    for group in s.cones:
        in_cone[group.index] = True
    bound, fixed = np.zeros(s.n), np.zeros(s.n, bool)
    bound[s.keep], fixed[s.keep] = np.where(in_cone, 0.0, push), ~in_cone & face.held
    removed = np.ones(s.n, bool)
    removed[s.keep] = False
    found: list[Pair] = []
    for number, c in enumerate(constraints):
        if isinstance(c, NonNegative | Bounds):
            force, on = _bound(s, number, p.kappa, np.where(fixed, bound, 0.0))
            loads = np.arange(s.n) if c.loads is None else np.asarray(c.loads)
            found.append((force[loads], on[loads]))
        elif isinstance(c, Support):
            mine = removed.copy()
            mine[np.asarray(c.loads)] = False
            found.append((np.zeros(s.n), mine))
        elif isinstance(c, Resultant):
            force = np.zeros(len(np.asarray(c.C)))
            mine = np.flatnonzero(s.equal.source == number)
            force[s.equal.place[mine]] = -p.nu[mine] / s.equal.norm[mine]
            found.append((force, np.ones(len(force), bool)))
        else:
            found.append((_cone_push(s, c, push), _cone_status(s, number, c, face)))
    return _of_removed(constraints, found, slope)


def _of_removed(constraints: Sequence[Constraint], found: list[Pair], slope: NDArray) -> list[Pair]:
    """With what the supports push: the gradient at the loads that they removed, less the share of the resultants."""
    rest = slope.copy()
    for c, (force, _) in zip(constraints, found, strict=True):
        if isinstance(c, Resultant):
            rest -= force @ np.asarray(c.C)
    out = []
    for c, (force, on) in zip(constraints, found, strict=True):
        if isinstance(c, Support):
            force = np.where(on, rest, 0.0)
            rest = np.where(on, 0.0, rest)  # a load that two supports remove counts once
        out.append((force, on))
    return out


def with_soft(pairs: list[Pair], constraints: Sequence[Constraint], rest: NDArray, sigma: float) -> list[Pair]:
    """With the multipliers sigma^2 Sigma^-1 (r - C g) of the soft resultants, from H g - y of the stacked rows."""
    start = len(rest) - sum(len(np.asarray(c.C)) for c in soft(constraints))
    out = []
    for pair, c in zip(pairs, constraints, strict=True):
        if isinstance(c, Resultant) and not c.hard:
            R = len(np.asarray(c.C))
            pair = (-(whitening(c, sigma).T @ rest[start : start + R]), pair[1])
            start += R
        out.append(pair)
    return out


def _bound(s: Feasible, number: int, kappa: NDArray, bound: NDArray) -> Pair:
    """Of one set of bounds: those that are the tightest at their load, and those that are rows in a cone."""
    force = np.where((s.lower_source == number) & (bound > 0), bound, 0.0)
    force = np.where((s.upper_source == number) & (bound < 0), bound, force)
    for i in np.flatnonzero(s.below.source == number):
        force[s.below.place[i]] -= s.below.sign[i] * kappa[i]
    return force, force != 0


def _cone_push(s: Feasible, c: FrictionCone, push: NDArray) -> NDArray[np.float64]:
    turned = push.copy()
    for group in s.cones:
        if group.rotated:
            turned[group.index] = np.einsum("kij,kj->ki", group.frame, push[group.index])
    force = np.zeros(s.n)
    force[s.keep] = turned
    return force[np.asarray(c.contacts)]


def _cone_status(s: Feasible, number: int, c: FrictionCone, face: Face) -> NDArray[np.int_]:
    """Status of each contact; those outside the support are open."""
    first = {int(j): i for i, j in enumerate(np.asarray(c.contacts)[:, 0])}
    out = np.zeros(len(first), int)
    for group, status in zip(s.cones, face.status, strict=True):
        for k in np.flatnonzero(group.source == number):
            out[first[int(s.keep[group.index[k, 0]])]] = status[k]
    return out
