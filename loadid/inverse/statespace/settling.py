"""When a recursion that converges geometrically has arrived: by the radius of its closed loop, not by its last steps.

Steps of a lightly damped loop beat, rest for a while and go on, and those of a badly conditioned one never fall to
rounding. Both are told apart from arrival by the rate: what is left after k samples is rho^(2 k) of what was left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..compiled import Compiled
from .small import multiply

STRIDE = 32  # samples between two looks
SETTLED = 4e-15  # relative change over a stride that is rounding
NEAR = 1e-9  # change from which the approach is geometric
SQUARINGS = 15
MARGINAL = 0.01  # decay over the whole record below which a loop counts as one that forgets nothing
STALLED, SHARE = 1e-12, 0.5  # change of such a loop that no longer falls by this share over half of its history
NEVER = 1 << 62


@Compiled
def decay(M: NDArray, a: NDArray, b: NDArray) -> float:
    """Decay per sample, -ln of the spectral radius of M; two matrices to work in.

    From norms of M^k and M^2k, whose ratio is rho^k however far M is from normal.
    """
    a[:] = M
    log, before = 0.0, 0.0
    for _ in range(SQUARINGS):
        size = np.abs(a).max()
        if size == 0.0 or not np.isfinite(size):
            return np.inf
        a /= size
        log += np.log(size)
        before = log
        multiply(a, a, b)
        a[:] = b
        log *= 2.0
    size = np.abs(a).max()
    if size == 0.0:
        return np.inf
    return -(log + np.log(size) - before) / (1 << (SQUARINGS - 1))


@Compiled
def arrival(since: int, change: float, size: float, decay: float, samples: int) -> int:
    """Sample at which rounding is all that is left, for a change over the last stride."""
    if decay * samples < MARGINAL:
        return NEVER
    left, rounding = change / (1.0 - np.exp(-2.0 * STRIDE * decay)), 0.25 * SETTLED * size
    if left <= rounding:
        return since
    wait = np.log(left / rounding) / (2.0 * decay) if rounding > 0.0 else np.inf
    return since + int(min(wait, float(samples))) + 1
