"""Load histories that only push: the answer under signs beside the path without them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError
from structures.flags import Flag

from .. import flags as guards
from ..inverse.choice import Choice
from ..inverse.constraints import NonNegative
from ..inverse.nonnegative.discrepancy import discrepancy
from ..inverse.nonnegative.solver import CONVERGED, NonNegativeSolution
from ..inverse.rules import RuleResult
from .posing import Posed

RULE = "discrepancy of loads that push"


def signs(constraints: Sequence[Any]) -> ArrayLike | bool | None:
    """Loads that only push: their numbers, None for all; False where nothing is asked.

    Raises
    ------
    InputError
        A constraint that is not `NonNegative`.
    """
    given: list[Any] = list(constraints) if isinstance(constraints, list | tuple) else [constraints]
    found = [c for c in given if isinstance(c, NonNegative)]
    if len(found) < len(given):
        raise InputError("load histories take signs only", where="constraints", found=repr(constraints)[:80],
                         expected="[NonNegative()] or [NonNegative(loads=[...])]")  # fmt: skip
    if not found:
        return False
    if any(c.loads is None for c in found):
        return None
    return np.unique(np.concatenate([np.atleast_1d(np.asarray(c.loads)) for c in found]))


def push(
    posed: Posed, choice: Choice, sigma: float, signed: ArrayLike | None, keep: bool,
    progress: Callable[[float, str], None],
) -> tuple[NonNegativeSolution, Choice]:  # fmt: skip
    """Load under signs, and the lambda that it took.

    Parameters
    ----------
    choice : Choice
        Of the path without signs.
    sigma : float
        Noise level of the whitened data.
    signed : array of int, optional
        Loads that only push; default all.
    keep : bool
        Take the lambda of `choice`, which the user asked for. Else the largest at which the load explains the data.

    Raises
    ------
    InputError
        A path that cannot take signs.
    """
    if posed.pushing is None:
        raise InputError("this path takes no signs", where="constraints", found=posed.name,
                         expected="path='auto' and a named penalty")  # fmt: skip
    record = posed.pushing(signed)
    if keep:
        return record.solve(choice.lam * choice.scale, progress=progress), choice
    found = discrepancy(record, choice.lam * choice.scale, sigma, progress=progress)
    lam = found.solution.lam / choice.scale
    note = "from the residual under signs" if found.met else "no lambda explains the data under signs: left as chosen"
    own = RuleResult(RULE, lam, note=note)
    if not found.met:
        return found.solution, replace(choice, rules=(*choice.rules, replace(own, lam=None)))
    return found.solution, replace(choice, lam=lam, rule=RULE, rules=(*choice.rules, own))


def facts(solution: NonNegativeSolution, m: int, known: bool) -> dict[str, Any]:
    """What is said of it; `m` data, whose noise is known or not."""
    return {
        "residual_to_noise": float(np.sqrt(solution.residual2 / m)) if known else None,
        "gap": solution.gap,
        "converged": solution.converged,
        "held": int(np.sum(solution.held)),
        "solver": solution.solver,
        "steps": solution.steps,
    }


def flags(solution: NonNegativeSolution, posed: Posed, choice: Choice, sigma: float) -> tuple[Flag, ...]:
    """W308 and W410 of a load under signs."""
    free = float(np.sum(posed.path.residual(choice.lam) ** 2))
    known = sigma if posed.noise.known else None
    return guards.collect(
        [
            guards.pulling(solution, free, sigma, posed.path.m),
            guards.stopped(solution, known, posed.path.m, CONVERGED),
        ]
    )
