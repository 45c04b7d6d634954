"""Active set over a record: loads change between free and held, all at once, until none does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .normal import Factor, Normal

CAP, PATIENCE = 60, 6  # steps, and steps without fewer loads on the wrong side
FEW = 10  # loads on the wrong side that are worth every patience
SLACK = 1e-13  # of the largest H^T y: gradient that is rounding


@dataclass(frozen=True, eq=False)
class Exchanged:
    """Where the exchange stands: unknowns, gradient, held unknowns, whether none is on the wrong side, steps."""

    v: NDArray[np.float64]
    gradient: NDArray[np.float64]
    held: NDArray[np.bool_]
    settled: bool
    steps: int


def exchange(
    normal: Normal, signed: NDArray, held: NDArray, step: Callable[[], None], *, pace: float = 1.0, cap: int = CAP,
) -> Exchanged:  # fmt: skip
    """From a guess of what is held to the minimum: free loads that pull are held, held loads with a pull are freed.

    Primal-dual active set; Hintermüller, Ito & Kunisch, SIAM J. Optim. 13 (2002) 865. It ends after a finite number of
    steps or cycles; it gives up where the loads on the wrong side stop becoming fewer, or fall more slowly than by the
    factor `pace` for each step.
    """
    slack = SLACK * float(np.abs(normal.q).max(initial=0.0))
    fewest, since, steps, allowed = len(held) + 1, 0, 0, np.inf
    while True:
        step()
        steps += 1
        v, gradient = on_face(normal, normal.factor(np.where(held, np.inf, 0.0)), held)
        wrong = signed & np.where(held, gradient < -slack, v < 0)
        count = int(np.count_nonzero(wrong))
        allowed = max(FEW, pace * min(allowed, count / pace if steps == 1 else allowed))
        if count < fewest:
            fewest, since = count, 0
        since += 1
        if count == 0 or count > allowed or steps >= cap or since > PATIENCE:
            return Exchanged(v, gradient, held, count == 0, steps)
        held = held ^ wrong


def on_face(normal: Normal, factor: Factor, held: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Minimum where the held unknowns are 0, refined, and its gradient."""
    v = factor.solve(np.where(held, 0.0, normal.q))
    gradient = normal.gradient(v)
    level = normal.precision * float(np.abs(normal.q).max(initial=0.0))
    for _ in range(3):
        rest = np.where(held, 0.0, -gradient)
        if np.abs(rest).max(initial=0.0) <= level:
            break
        v = v + factor.solve(rest)
        gradient = normal.gradient(v)
    return v, gradient
