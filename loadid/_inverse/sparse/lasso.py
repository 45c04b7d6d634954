"""l1 problems by an active set: Newton steps on a small working set, and the duality gap as their certificate."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .. import Array, Flags, Indices
from .atoms import Atoms


@dataclass(frozen=True)
class SparseSolution:
    """Minimum of ``1/2 |A x - y|^2 + mu sum w |x|``, with what proves it.

    Parameters
    ----------
    x : array, shape (n,)
    support : array of int
        Coefficients that are not zero, ascending.
    residual : array, shape (m,)
        y - A x.
    mu : float
    gap : float
        Duality gap over ``1/2 |y|^2``: the objective is above its minimum by no more than this.
    objective : float
        Over ``1/2 |y|^2``.
    steps : int
        Newton steps (factorisations).
    converged : bool
        Whether the gap that was asked for is reached.
    """

    x: Array
    support: Indices
    residual: Array
    mu: float
    gap: float
    objective: float
    steps: int
    converged: bool


@dataclass(frozen=True)
class L1:
    """The penalty ``mu sum w_j |x_j|``, or the same over ``x >= 0``.

    Parameters
    ----------
    mu : float
    weights : array, shape (n,), or None for ones
    nonnegative : bool
    """

    mu: float
    weights: Array | None = None
    nonnegative: bool = False

    def levels(self, n: int) -> Array:
        """Bound of each correlation, mu w_j, (n,)."""
        return np.full(n, self.mu) if self.weights is None else self.mu * self.weights

    def excess(self, c: Array) -> Array:
        """How far the correlations c = A^T r exceed their levels: positive where a zero should not stay zero."""
        return (c if self.nonnegative else np.abs(c)) - self.levels(len(c))

    def dual_scale(self, c: Array) -> float:
        """Largest factor up to 1 that makes the residual a feasible dual point."""
        size = c if self.nonnegative else np.abs(c)
        worst = float(np.max(size / self.levels(len(c)), initial=0.0))
        return 1.0 if worst <= 1 else 1 / worst

    def value(self, x: Array, which: Indices) -> float:
        """The penalty of some coefficients `x` at the places `which`."""
        size = np.abs(x)
        return float(self.mu * (size.sum() if self.weights is None else self.weights[which] @ size))


def largest(atoms: Atoms, y: Array, weights: Array | None = None, nonnegative: bool = False) -> float:
    """Smallest mu at which everything is zero."""
    c = atoms.adjoint(y)
    c = c if weights is None else c / weights
    return float(np.max(c if nonnegative else np.abs(c), initial=0.0))


def gap(y: Array, residual: Array, penalty: float, scale: float) -> tuple[float, float]:
    """Objective, and its distance from the dual objective at ``scale * residual``, both over ``1/2 |y|^2``.

    The gap is formed from differences of vectors, so that it can fall to the rounding of the objective itself.
    """
    half = 0.5 * float(y @ y)
    if half == 0:
        return 0.0, 0.0
    primal = 0.5 * float(residual @ residual) + penalty
    # 1/2|r|^2 + pen - (1/2|y|^2 - 1/2|y - s r|^2) = 1/2 (1 - s)^2 |r|^2 + pen - s r'(y - r)
    distance = 0.5 * (1 - scale) ** 2 * float(residual @ residual) + penalty - scale * float(residual @ (y - residual))
    return primal / half, max(distance, 0.0) / half


ROUNDS = 200  # of new atoms
STEPS = 60  # Newton steps in one round, and as many more as the working set has atoms
RIDGE = 1e-13  # of the diagonal of the Gram matrix, for neighbours that are equal to rounding
SLACK = 1e-9  # of mu: an atom on its bound is no violation
SHORTER, SHORTEST = 0.3, 0.005  # of a step that would drop too much; below the last one goes to the first sign change
APART = 0.5  # correlation below which two atoms of the working set may start at once


@dataclass
class _WorkingSet:
    """Atoms that have been active, with their Gram matrix; grows, and is cut back when most of it is idle."""

    atoms: Atoms
    which: Indices = field(default_factory=lambda: np.zeros(0, int))
    # it directs the Newton steps; amplitudes come from least squares on the support (`sparse.path.fit`)
    gram: Array = field(default_factory=lambda: np.zeros((0, 0)))
    x: Array = field(default_factory=lambda: np.zeros(0))

    def grow(self, new: Indices) -> None:
        """Take in new atoms with coefficient zero."""
        if not len(new):
            return
        k, total = len(self.which), len(self.which) + len(new)
        wide = np.empty((total, total))
        wide[:k, :k] = self.gram
        if k:
            wide[:k, k:] = self.atoms.gram(self.which, new)
            wide[k:, :k] = wide[:k, k:].T
        wide[k:, k:] = self.atoms.gram(new, new)
        self.gram, self.which = wide, np.concatenate([self.which, new])
        self.x = np.concatenate([self.x, np.zeros(len(new))])

    def prune(self) -> None:
        """Forget idle atoms where they are more than twice the active ones."""
        keep = self.x != 0
        if len(keep) > 100 + 3 * np.count_nonzero(keep):
            self.which, self.x, self.gram = self.which[keep], self.x[keep], self.gram[np.ix_(keep, keep)]

    def full(self, n: int) -> Array:
        """Coefficients (n,)."""
        x = np.zeros(n)
        x[self.which] = self.x
        return x


class Solver:
    """l1 problems of one operator and record at several mu; each starts where the last one ended.

    A round takes in the atoms that stand out most of their neighbours among those that violate the optimality
    conditions (neighbouring responses are nearly equal: one of them will do), and solves the problem on the working set
    exactly: Newton steps on the active atoms with a projection on the orthant of their signs (Lee, Battle, Raina & Ng,
    NIPS 2006, feature-sign search; Schmidt, Fung & Rosales, ECML 2007, for the projection). The residual and the gap of
    each round come from the operator, not from the Gram matrix.

    Parameters
    ----------
    atoms : Atoms
    y : array, shape (m,)
    """

    def __init__(self, atoms: Atoms, y: Array) -> None:
        self.atoms, self.y = atoms, np.asarray(y, float)
        self._work = _WorkingSet(atoms)

    def solve(self, penalty: L1, *, tol: float = 1e-6) -> SparseSolution:
        """Minimise ``1/2 |A x - y|^2`` plus an l1 penalty to a relative duality gap.

        Parameters
        ----------
        penalty : L1
        tol : float
            Gap over ``1/2 |y|^2`` at which to stop.

        Returns
        -------
        SparseSolution
            With ``converged`` False where rounding or the number of rounds ended it.
        """
        atoms, y, work = self.atoms, self.y, self._work
        if penalty.nonnegative:
            work.x = np.maximum(work.x, 0.0)
        levels, steps, best = penalty.levels(atoms.n), 0, None
        for turn in range(ROUNDS):
            x = work.full(atoms.n)
            residual = y - atoms.apply(x) if np.any(work.x) else y.copy()
            c = atoms.adjoint(residual)
            objective, distance = gap(y, residual, penalty.value(work.x, work.which), penalty.dual_scale(c))
            if best is None or distance < best.gap:
                support = np.flatnonzero(x)
                best = SparseSolution(x, support, residual, penalty.mu, distance, objective, 0, distance <= tol)
            if distance <= tol:
                break
            new = _standing_out(penalty.excess(c), levels, work.which)
            if not len(new) and turn and best.gap < distance:
                break  # nothing left to add and no progress: rounding
            work.prune()
            work.grow(new)
            taken = _minimise(work, c[work.which], levels[work.which], penalty.nonnegative)
            steps += taken
            if not taken and not len(new):
                break
        assert best is not None
        return replace(best, steps=steps)


def solve(atoms: Atoms, y: Array, penalty: L1, *, tol: float = 1e-6) -> SparseSolution:
    """One l1 problem, from zero: see `Solver.solve`."""
    return Solver(atoms, y).solve(penalty, tol=tol)


def _standing_out(excess: Array, levels: Array, known: Indices) -> Indices:
    """Violating atoms that exceed both neighbours and are not in the working set; else the worst one."""
    outside = excess > SLACK * levels
    padded = np.concatenate([[-np.inf], excess, [-np.inf]])
    peak = outside & (excess >= padded[:-2]) & (excess > padded[2:])
    peak[known] = False
    if peak.any():
        return np.flatnonzero(peak)
    outside[known] = False
    return np.array([np.argmax(np.where(outside, excess, -np.inf))]) if outside.any() else np.zeros(0, int)


def _minimise(work: _WorkingSet, c: Array, levels: Array, nonnegative: bool) -> int:
    """Minimise over the working set, starting at its x, where the correlations are `c`; returns the Newton steps."""
    G, x0 = work.gram, work.x
    x = x0.copy()
    sign = np.sign(x)
    active = sign != 0
    _start(G, c, levels, active, sign, nonnegative)
    steps = 0
    while steps < STEPS + len(x):
        steps += 1
        a = np.flatnonzero(active)
        if not len(a):
            break
        g = c - G @ (x - x0)
        d = _newton(G, a, g[a] - levels[a] * sign[a])
        wrong = (x[a] == 0) & (d * sign[a] <= 0)
        if wrong.any():
            active[a[wrong]] = False
            continue
        t, dropped = _step(G, g, x, a, d, sign, levels)
        x[a] += t * d
        x[dropped] = 0.0
        x[a] = np.where(x[a] * sign[a] > 0, x[a], 0.0)
        active &= x != 0
        if t == 1.0 and not len(dropped) and not _start(G, c - G @ (x - x0), levels, active, sign, nonnegative):
            break
    work.x = x
    return steps


def _newton(G: Array, a: Indices, slope: Array) -> Array:
    """Newton direction on the active atoms."""
    from scipy.linalg import lapack

    block = G[np.ix_(a, a)].T  # symmetric: the order of columns, which LAPACK takes without a copy
    diagonal = np.diag(block).copy()
    ridge = RIDGE
    while True:
        block[np.diag_indices(len(a))] = diagonal * (1 + ridge)
        factor, info = lapack.dpotrf(block, lower=1, clean=0)
        if info == 0:
            return np.asarray(lapack.dpotrs(factor, slope, lower=1)[0])
        ridge *= 100


def _start(G: Array, g: Array, levels: Array, active: Flags, sign: Array, nonnegative: bool) -> bool:
    """Activate idle atoms that violate their bound, the worst first, each unlike those before it; whether any did."""
    size = np.where(active, -np.inf, (g if nonnegative else np.abs(g)) - levels * (1 + SLACK))
    todo = np.flatnonzero(size > 0)
    todo = todo[np.argsort(-size[todo])]
    norm = np.sqrt(np.diag(G))
    taken: list[int] = []
    for j in todo:
        if not taken or np.all(np.abs(G[j, taken]) < APART * norm[j] * norm[taken]):
            taken.append(int(j))
    active[taken] = True
    sign[taken] = np.sign(g[taken])
    return bool(taken)


def _step(G: Array, g: Array, x: Array, a: Indices, d: Array, sign: Array, levels: Array) -> tuple[float, Indices]:
    """Length of the step along d, and the atoms that it drops: as many as still lower the objective."""
    crossing = (x[a] + d) * sign[a] <= 0
    if not crossing.any():
        return 1.0, np.zeros(0, int)
    ratio = np.where(crossing, -x[a] / np.where(crossing, d, 1.0), np.inf)
    slope = g[a] - levels[a] * sign[a]
    t, first, full = 1.0, float(ratio.min()), np.zeros(len(x))
    while t > max(first, SHORTEST):
        moved = np.where(ratio <= t, 0.0, x[a] + t * d)
        change = moved - x[a]
        # objective on the orthant: quadratic with this slope
        full[a] = change
        if 0.5 * full @ (G @ full) < slope @ change:
            return t, a[ratio <= t]
        t *= SHORTER
    return first, a[ratio <= first]
