"""Guards of side constraints: those that fight the data, and solvers that stopped too early."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structures.flags import Evidence, Flag

from ..inverse.constraints import Constraint, Resultant
from ..inverse.nonnegative.solver import NonNegativeSolution
from ..inverse.solver import ConstrainedSolution

RISE = 2.0  # of the residual, in noise levels


def fighting(solution: ConstrainedSolution, constraints: Sequence[Constraint], sigma: float, m: int) -> Flag | None:
    """W308: the residual with the constraints lies more than two noise levels above the one without them.

    Parameters
    ----------
    sigma : float
        Noise level of the whitened data.
    m : int
        Number of data.
    """
    rise = solution.change / (sigma * np.sqrt(m))
    if not rise > RISE:
        return None
    force = [
        float(np.linalg.norm(push @ np.asarray(c.C) if isinstance(c, Resultant) else push))
        for c, push in zip(constraints, solution.multipliers, strict=True)
    ]
    worst = int(np.argmax(force))
    share = force[worst] / max(sum(force), np.finfo(float).tiny)
    return Flag(
        "W308",
        Evidence("rise of the residual, noise levels", float(rise), RISE),
        f"the constraints fight the data: they raise the residual by {rise:.3g} times the noise; "
        f"{share:.0%} of the force is that of constraint {worst} ({constraints[worst]})",
        "check the signs, the side and the frames of the contact, and the frame of the force/torque sensor",
    )


def pulling(solution: NonNegativeSolution, free_residual2: float, sigma: float, m: int) -> Flag | None:
    """W308 of a history: loads that only push leave a residual more than two noise levels above that of any load.

    Parameters
    ----------
    free_residual2 : float
        Squared residual of the load without signs at the same lambda.
    sigma : float
        Noise level of the whitened data.
    m : int
        Number of data.
    """
    rise = (np.sqrt(solution.residual2) - np.sqrt(free_residual2)) / (sigma * np.sqrt(m))
    if not rise > RISE:
        return None
    return Flag(
        "W308",
        Evidence("rise of the residual, noise levels", float(rise), RISE),
        f"loads that only push fight the data: they raise the residual by {rise:.3g} times the noise",
        "check the sign of the load and of the sensors, or let the load pull (no constraints)",
    )


def stopped(
    solution: ConstrainedSolution | NonNegativeSolution, sigma: float | None, m: int, limit: float = 1e-9
) -> Flag | None:
    """W410: the solver ended on its limit of iterations, not at the solution."""
    if solution.converged:
        return None
    steps = solution.steps if isinstance(solution, NonNegativeSolution) else solution.iterations
    ratio = float(np.sqrt(solution.residual2 / m) / sigma) if sigma else float("nan")
    level = f"the residual is {ratio:.3g} times the noise level" if sigma else "the noise level is not known"
    return Flag(
        "W410",
        Evidence("duality gap", solution.gap, limit),
        f"the solver ({solution.solver}) stopped after {steps} steps, not at the solution: {level}; "
        f"the relative duality gap is {solution.gap:.2g}",
        "allow more iterations, or regularise more",
    )
