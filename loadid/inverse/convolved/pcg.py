"""Preconditioned conjugate gradients on the stacked system ``[H; lam L]``, several right sides at once.

In the least-squares form (CGLS) the residuals of data and penalty are carried, and the gradient is formed from them:
this keeps the digits that ``H^T H`` would lose. Björck, Numerical Methods for Least Squares Problems, SIAM 1996, ch. 7.
The iteration stops on the gradient in the norm of the preconditioner, which measures the error of the load in the
energy norm as far as the preconditioner is good, and not on the plain residual: that one can be small while smooth
loads are still wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import NotIdentifiable

from .circulant import Circulant
from .factored import Factored
from .operator import Operator

TOLERANCE = 1e-12
MOST = 4000  # iterations
STALLED = 300  # iterations without a smaller gradient that end it
SMALL, FINE, SHARE = 1e-10, 20, 4  # below this gradient: a quarter of those so far (harder, longer swings), 20 or more
ROUNDING = 1e-9  # gradient beyond which a stalled iteration is no solution
HARD = 60  # iterations beyond which the solution is checked by a correction
CORRECTED = 1e-4  # tolerance of a correction
CHANGED = 1e-8  # change of the load that calls for one more
PASSES = 6
FACTORED = 4000  # unknowns up to which a factorisation takes over from an iteration that does not settle


@dataclass(frozen=True)
class Sides:
    """Right sides of ``(H^T H + lam^2 L^T L) x = b + H^T y + lam L^T c``; what is None is zero.

    Parameters
    ----------
    y : array, shape (k, sensors, samples), optional
    c : array, shape (k, loads, samples - order), optional
    b : array, shape (k, loads, samples), optional
    """

    y: NDArray | None = None
    c: NDArray | None = None
    b: NDArray | None = None

    @property
    def count(self) -> int:
        """Number of right sides."""
        return next(len(x) for x in (self.y, self.c, self.b) if x is not None)


@dataclass(frozen=True)
class Reached:
    """Where the iteration ended.

    Parameters
    ----------
    x : array, shape (k, loads, samples)
        Solutions.
    r : array, shape (k, sensors, samples)
        ``y - H x``.
    q : array, shape (k, loads, samples - order)
        ``c - lam L x``.
    gradient : float
        Norm of ``b + H^T r + lam L^T q`` relative to that at x = 0, the largest of all right sides.
    iterations : int
    """

    x: NDArray[np.float64]
    r: NDArray[np.float64]
    q: NDArray[np.float64]
    gradient: float
    iterations: int


def solve(
    operator: Operator, circulant: Circulant | Factored, sides: Sides, tolerance: float = TOLERANCE, most: int = MOST,
    strict: bool = True, takeover: bool = True,
) -> Reached:  # fmt: skip
    """Solve for all right sides at the lambda of the preconditioner.

    Parameters
    ----------
    tolerance : float
        Gradient in the norm of the preconditioner, relative to that at x = 0.
    strict : bool
        Whether to refuse an answer that is neither within the tolerance nor at the level of rounding.
    takeover : bool
        Whether a factorisation takes over where the iteration does not settle.

    Raises
    ------
    NotIdentifiable
        If it ends above `ROUNDING` times the first gradient and above the tolerance, with more than `FACTORED` unknowns
        or with the preconditioner of a factorisation too (LID-E306).
    """
    if takeover and "modes" in vars(operator):
        circulant = Factored(operator, circulant.lam)  # it is there, and takes fewer steps
    lam, N, k = circulant.lam, operator.samples, sides.count
    another = takeover and strict and operator.loads * N <= FACTORED and not isinstance(circulant, Factored)
    if another:
        most = min(most, operator.loads * N)  # steps after which it had ended but for rounding
    x = np.zeros((k, operator.loads, N))
    r = np.zeros((k, operator.sensors, N)) if sides.y is None else np.array(sides.y, float)
    q = np.zeros((k, operator.loads, operator.rows)) if sides.c is None else np.array(sides.c, float)
    b = sides.b

    def gradient(live: NDArray) -> NDArray:
        s = operator.adjoint(r[live]) + lam * operator.rough_adjoint(q[live])
        return s if b is None else s + b[live]

    live = np.arange(k)
    s = gradient(live)
    z = circulant.solve(s)
    zero, first = _dot(s, s), _dot(s, z)  # of x = 0: what all gradients are measured by
    energy, plain = first.copy(), zero.copy()
    best, since, stalled = energy.copy(), np.zeros(k, int), STALLED if strict else STALLED // 3
    iterations, d = 0, z
    keep = energy > tolerance**2 * first
    while True:
        if not keep.all():
            live, d, energy = live[keep], d[keep], energy[keep]
        if not len(live) or iterations == most:
            break
        u, v = operator.apply(d), lam * operator.rough(d)
        step = (energy / (_dot(u, u) + _dot(v, v)))[:, None, None]
        x[live] += step * d
        r[live] -= step * u
        q[live] -= step * v
        s = gradient(live)
        z = circulant.solve(s)
        now = _dot(s, z)
        d = z + (now / energy)[:, None, None] * d
        energy, plain[live], iterations = now, _dot(s, s), iterations + 1
        since[live] = np.where(now < best[live], 0, since[live] + 1)
        best[live] = np.minimum(best[live], now)
        patience = np.where(best[live] < SMALL**2 * first[live], np.clip(iterations // SHARE, FINE, stalled), stalled)
        keep = (now > tolerance**2 * first[live]) & (since[live] < patience)
    reached = float(np.sqrt(np.max(plain / np.where(zero > 0, zero, 1.0), initial=0.0)))
    failed = not np.isfinite(reached) or (strict and np.any(best > max(tolerance, ROUNDING) ** 2 * first))
    if another and (failed or (len(live) and iterations == most)):
        return solve(operator, Factored(operator, lam), sides, tolerance)
    if failed:
        raise unsettled(f"gradient {reached:.2g} times the first after {iterations} steps")
    return Reached(x, r, q, reached, iterations)


def refined(operator: Operator, circulant: Circulant, y: NDArray) -> Reached:
    """Solution for data y (1, sensors, samples), corrected from its own residual until the load no longer changes.

    A small gradient does not show an error along loads that almost no data and no penalty see (second differences and a
    small lambda). A correction does: it starts from that gradient alone.

    Raises
    ------
    NotIdentifiable
        If the load still changes by more than `CHANGED` after `PASSES` corrections.
    """
    found = solve(operator, circulant, Sides(y=y))
    if found.iterations <= HARD and not operator.order:
        return found
    scale, lam, change = float(np.linalg.norm(operator.adjoint(y))), circulant.lam, np.inf

    def slope(r: NDArray, q: NDArray) -> float:
        return float(np.linalg.norm(operator.adjoint(r) + lam * operator.rough_adjoint(q)))

    for _ in range(PASSES):
        r, q = y - operator.apply(found.x), -lam * operator.rough(found.x)
        before = slope(r, q)
        found = Reached(found.x, r, q, before / scale if scale else 0.0, found.iterations)
        more = solve(operator, circulant, Sides(y=r, c=q), CORRECTED, strict=False)
        after = slope(more.r, more.q)
        if not after < before:  # rounding: no correction is better
            return found
        x = found.x + more.x
        change = float(np.linalg.norm(more.x) / max(np.linalg.norm(x), np.finfo(float).tiny))
        found = Reached(x, more.r, more.q, after / scale, found.iterations + more.iterations)
        if change <= CHANGED:
            return found
    raise unsettled(f"the load still changes by {change:.2g} of its size after {found.iterations} steps")


def unsettled(found: str) -> NotIdentifiable:
    """What is raised in place of an answer that is not one."""
    return NotIdentifiable(
        f"data and penalty do not determine the load to some digits at this lambda: {found}",
        advice="take a larger lambda, or a shorter record", code="LID-E306",
    )  # fmt: skip


def _dot(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    """Inner products of each right side."""
    return np.einsum("kij,kij->k", a, b)
