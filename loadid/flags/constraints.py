"""Guards of side constraints: those that fight the data, and solvers that stopped too early."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structures.flags import Evidence, Flag

from ..inverse.constraints import Constraint, Resultant
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


def stopped(solution: ConstrainedSolution, sigma: float | None, m: int) -> Flag | None:
    """W410: the solver ended on its limit of iterations, not at the solution."""
    if solution.converged:
        return None
    ratio = float(np.sqrt(solution.residual2 / m) / sigma) if sigma else float("nan")
    level = f"the residual is {ratio:.3g} times the noise level" if sigma else "the noise level is not known"
    return Flag(
        "W410",
        Evidence("duality gap", solution.gap, 1e-9),
        f"the solver ({solution.solver}) stopped after {solution.iterations} steps, not at the solution: {level}; "
        f"the relative duality gap is {solution.gap:.2g}",
        "allow more iterations, or regularise more",
    )
