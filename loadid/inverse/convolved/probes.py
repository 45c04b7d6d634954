"""Estimates where the displacement rank is large: many sensors, loads or gaps in the data.

Traces by random signs (Hutchinson, Commun. Stat. Simul. Comput. 19 (1990) 433), the same at each lambda; the diagonal
of B by combs of random signs, which see each sample once and mistake only what is correlated over the distance between
their teeth (Tang & Saad, Numer. Linear Algebra Appl. 19 (2012) 485).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .circulant import Circulant
from .operator import Operator
from .pcg import Sides, solve

NUMBERS = 1 << 16  # random signs in all probes of a trace
FEWEST, MOST = 2, 32
TEETH = 64  # samples between the teeth of a comb
AT_ONCE = 16


def traces(operator: Operator, lam: float, tolerance: float) -> tuple[float, float, float]:
    """Part of the degrees of freedom that the penalty governs, the rest of the governed modes, and the trace of B.

    Signs on the rows of the penalty: part and rest are positive and add up to the number of rows, whatever the probes.
    The relative standard error of the part is about ``sqrt(2 / (probes * part))``.
    """
    rng = np.random.default_rng(0)
    p, N, o = operator.loads, operator.samples, operator.order
    count = int(np.clip(NUMBERS // (N * p), FEWEST, MOST))
    z, w = rng.choice([-1.0, 1.0], (count, p, N - o)), rng.choice([-1.0, 1.0], (count, p, N))
    none_z, none_w = np.zeros_like(z), np.zeros_like(w)
    sides = Sides(c=np.concatenate([z, none_z]), b=np.concatenate([none_w, w]))
    found = solve(operator, Circulant(operator, lam), sides, tolerance)
    part = float(np.sum(z * found.q[:count])) / count  # q = z - lam L x
    return part, float(z[0].size) - part, float(np.sum(w * found.x[count:])) / count


def variances(operator: Operator, lam: float, tolerance: float = 1e-6) -> NDArray[np.float64]:
    """Diagonal of B, (loads, samples), by one comb for each load and each of `TEETH` places."""
    rng = np.random.default_rng(0)
    p, N = operator.loads, operator.samples
    sign, out = rng.choice([-1.0, 1.0], (p, N)), np.empty((p, N))
    circulant, teeth = Circulant(operator, lam), min(TEETH, N)
    combs = [(j, k) for j in range(p) for k in range(teeth)]
    for start in range(0, len(combs), AT_ONCE):
        some = combs[start : start + AT_ONCE]
        b = np.zeros((len(some), p, N))
        for i, (j, k) in enumerate(some):
            b[i, j, k::teeth] = sign[j, k::teeth]
        x = solve(operator, circulant, Sides(b=b), tolerance).x
        for i, (j, k) in enumerate(some):
            out[j, k::teeth] = x[i, j, k::teeth] * sign[j, k::teeth]
    return np.maximum(out, 1e-3 * np.median(out))
