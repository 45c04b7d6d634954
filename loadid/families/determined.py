"""Whether sensors, penalty and constraints together determine the load."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from structures.advice import Advice, Option
from structures.errors import NotIdentifiable

from ..inverse.constraints import Bounds, FrictionCone, NonNegative, Resultant, Support
from .steady import Steady

if TYPE_CHECKING:
    from .static import StaticInversion

MEETING = float(np.sqrt(np.finfo(float).eps))  # of [H/|H|; L/|L|], below which no minimiser stands out
PUSH = 1e-9  # of the largest gradient at rest, below which a constraint holds a load by chance


def missing(posed: Steady) -> int:
    """Load patterns that neither the readings nor the constraints fix without regularisation; 0 is what it must be.

    Resultants count as readings. A sign or a bound fixes a load only where the data push against it: a load that may
    move inside its bounds is bounded, not determined.
    """
    problem, n = posed.base.problem, posed.H.shape[1]
    rows, free = [problem.H / np.linalg.norm(problem.H)], np.ones(n, bool)
    solution = posed.path.solve(0.0)
    least = PUSH * float(np.max(np.abs(problem.H.T @ problem.y), initial=0.0))
    for c, push, active in zip(posed.path.constraints, solution.multipliers, solution.active, strict=True):
        if isinstance(c, Resultant):
            C = np.asarray(c.C, float)
            rows.append(C / np.linalg.norm(C, axis=1, keepdims=True))
        elif isinstance(c, Support):
            free &= np.isin(np.arange(n), np.asarray(c.loads))
        elif isinstance(c, NonNegative | Bounds):
            held = (np.asarray(active, bool) & (np.abs(push) > least)).reshape(-1, push.shape[-1]).all(axis=0)
            loads = np.arange(n) if c.loads is None else np.asarray(c.loads)
            free[loads[held]] = False
        elif isinstance(c, FrictionCone):
            contacts = np.asarray(c.contacts)
            is_open = (np.asarray(active) == 0).reshape(-1, len(contacts)).all(axis=0)
            free[contacts[is_open].ravel()] = False
    count = int(free.sum())
    return count - int(np.linalg.matrix_rank(np.vstack(rows)[:, free])) if count else 0


def refuse_undetermined(family: StaticInversion, posed: Steady) -> None:
    """Refuse a load that neither the sensors nor the penalty nor the constraints determine (LID-E306)."""
    n = family.H.shape[1]
    if family.L is not None and posed.base.meeting < MEETING and "LID-E306" not in family.allow:
        raise NotIdentifiable(
            "the null spaces of the sensors and of the penalty nearly meet: the smallest singular value of "
            f"[H/|H|; L/|L|] is {posed.base.meeting:.2g}, below {MEETING:.2g}",
            advice=Advice(
                "add another sensor, or use ",
                Option("penalty", "identity"),
                " (with a resultant as a constraint, if known)",
            ),
            code="LID-E306",
        )
    if family.free and posed.constrained and posed.rank < n and "LID-E306" not in family.allow:
        lacking = missing(posed)
        if lacking:
            raise NotIdentifiable(
                f"without regularisation the load is not determined: rank {posed.rank} of {n} unknowns, and the "
                f"constraints leave {lacking} load pattern{'s' if lacking > 1 else ''} free to move",
                advice=Advice(
                    "add sensors or a resultant, use a penalty (", Option("penalty", "identity"), "), or fewer loads"
                ),
                code="LID-E306",
            )
    if family.free and not family.constraints and posed.rank < n and "LID-E306" not in family.allow:
        raise NotIdentifiable(
            f"without regularisation the load is not determined: rank {posed.rank} of {n} unknowns "
            f"from {len(posed.H)} sensors",
            advice=Advice("add sensors, use a penalty (", Option("penalty", "identity"), "), or fewer loads"),
            code="LID-E306",
        )
