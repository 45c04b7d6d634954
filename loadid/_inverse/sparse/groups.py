"""Group penalties: coefficients that are zero together, or not at all, by Newton steps on the groups in use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structures.errors import InputError

from .. import Array, Indices
from .atoms import Atoms
from .lasso import SparseSolution, gap

ROUNDS = 200
STEPS = 100  # Newton steps in one round
SLACK = 1e-9
ENOUGH = 0.01  # of the gap that is asked for: decrease that a Newton step promises below which a round ends
RIDGE = 1e-13
SHRUNK = 0.2  # of its norm: a group that a step has left with less is minimised over alone
FEW = 8  # coefficients of a group up to which it counts as small: many of them may start at once
LARGEST = 6000  # coefficients in use at once


class Groups:
    """A partition of the coefficients, with the penalty ``mu sum_g w_g |x_g|_2``.

    Parameters
    ----------
    labels : array of int, shape (n,)
        Group of each coefficient, 0 ... count - 1.
    weights : array, shape (count,), optional
        Default 1.
    """

    def __init__(self, labels: Indices, weights: Array | None = None) -> None:
        self.labels = np.asarray(labels, int)
        self.count = int(self.labels.max(initial=-1)) + 1
        self.weights = np.ones(self.count) if weights is None else np.asarray(weights, float)
        order = np.argsort(self.labels, kind="stable")
        self.members = np.split(order, np.cumsum(np.bincount(self.labels, minlength=self.count))[:-1])

    def norms(self, x: Array) -> Array:
        """Euclidean norm of each group, (count,)."""
        return np.sqrt(np.bincount(self.labels, x**2, minlength=self.count))


def largest(atoms: Atoms, y: Array, groups: Groups) -> float:
    """Smallest mu at which everything is zero."""
    return float(np.max(groups.norms(atoms.adjoint(y)) / groups.weights))


def solve(
    atoms: Atoms, y: Array, mu: float, groups: Groups, *, tol: float = 1e-6, start: Array | None = None
) -> SparseSolution:
    """Minimise ``1/2 |A x - y|^2 + mu sum_g w_g |x_g|`` to a relative duality gap.

    Yuan & Lin, J. R. Stat. Soc. B 68 (2006) 49, for the problem. Groups that violate their bound are taken in; on those
    in use Newton's method, with a test in every step whether a group is better zero.

    Raises
    ------
    InputError
        Where more coefficients would be in use than can be factorised.
    """
    x = np.zeros(atoms.n) if start is None else np.array(start, float)
    used = groups.norms(x) > 0
    known, G = np.zeros(0, int), np.zeros((0, 0))
    steps, best = 0, None
    for _ in range(ROUNDS):
        residual = y - atoms.apply(x) if used.any() else np.array(y, float)
        c = atoms.adjoint(residual)
        size = groups.norms(c) / groups.weights
        scale = min(1.0, mu / max(float(size.max()), 1e-300))
        penalty = mu * float(groups.weights @ groups.norms(x))
        objective, distance = gap(y, residual, penalty, scale)
        if best is None or distance < best.gap:
            best = SparseSolution(x, np.flatnonzero(x), residual, mu, distance, objective, steps, distance <= tol)
        if distance <= tol:
            break
        new = _standing_out(np.where(used, -np.inf, size), mu, len(groups.labels) <= FEW * groups.count)
        if not len(new) and best.gap < distance:
            break
        used[new] = True
        which = np.concatenate([groups.members[g] for g in np.flatnonzero(used)]) if used.any() else known
        if len(which) > LARGEST:
            raise InputError("the groups in use are too large", where="groups", found=f"{len(which)} coefficients",
                             expected=f"at most {LARGEST}",
                             hint="a coarser dictionary (knots=), a window of the record, or a larger mu")  # fmt: skip
        G = _gram(atoms, which, known, G)
        known = which
        part = _Part(G, c[which], x[which], groups.labels[which], mu * groups.weights)
        steps += part.minimise(ENOUGH * tol * 0.5 * float(y @ y))
        x = np.zeros(atoms.n)
        x[which] = part.x
        used = groups.norms(x) > 0
    assert best is not None
    return replace(best, steps=steps)


def _standing_out(size: Array, mu: float, small: bool) -> Indices:
    """Groups to take in: all that exceed both neighbours where they are small (slots in time), else the worst."""
    outside = size > mu * (1 + SLACK)
    if not outside.any():
        return np.zeros(0, int)
    if not small:
        return np.array([np.argmax(size)])
    padded = np.concatenate([[-np.inf], size, [-np.inf]])
    peaks = np.flatnonzero(outside & (size >= padded[:-2]) & (size > padded[2:]))
    return peaks if len(peaks) else np.array([np.argmax(size)])


def _gram(atoms: Atoms, which: Indices, known: Indices, G: Array) -> Array:
    """Gram matrix of `which`, of which that of `known` is there already."""
    place = {int(j): k for k, j in enumerate(known)}
    old = np.array([place.get(int(j), -1) for j in which])
    here, new = np.flatnonzero(old >= 0), np.flatnonzero(old < 0)
    full = np.empty((len(which), len(which)))
    full[np.ix_(here, here)] = G[np.ix_(old[here], old[here])]
    if len(new):
        block = atoms.gram(which, which[new])
        full[:, new] = block
        full[new, :] = block.T
    return full


class _Part:
    """The problem on the groups in use; `c` are the correlations at the `x` it starts from."""

    def __init__(self, G: Array, c: Array, x: Array, labels: Indices, levels: Array) -> None:
        names, self.group = np.unique(labels, return_inverse=True)
        self.G, self.b, self.x, self.level = G, c + G @ x, x.copy(), levels[names]
        self.count = len(names)
        self._modes: dict[int, tuple[Array, Array]] = {}
        self.members = [np.flatnonzero(self.group == g) for g in range(self.count)]

    def minimise(self, enough: float) -> int:
        """Newton steps until one promises less than `enough`; their number."""
        for g in range(self.count):
            if not self.x[self.members[g]].any():
                self._alone(g)
        before = self._norms()
        for step in range(STEPS):
            self._clear(before)
            before = self._norms()
            a = np.flatnonzero(self._norms()[self.group] > 0)
            if not len(a):
                return step
            slope, H = self._model(a)
            d = _solved(H, slope)
            gain = float(slope @ d)
            if gain <= 0 or not self._move(a, d, gain):
                return step
            if gain <= enough:
                self._clear(before)
                return step + 1
        return STEPS

    def _norms(self) -> Array:
        return np.sqrt(np.bincount(self.group, self.x**2, minlength=self.count))

    def _objective(self, x: Array) -> float:
        norms = np.sqrt(np.bincount(self.group, x**2, minlength=self.count))
        return float(0.5 * x @ (self.G @ x) - self.b @ x + self.level @ norms)

    def _own(self, g: int) -> Array:
        """Correlations of a group with what the others leave."""
        m = self.members[g]
        return self.b[m] - self.G[m] @ self.x + self.G[np.ix_(m, m)] @ self.x[m]

    def _alone(self, g: int) -> None:
        """The minimum over one group, the others held: its norm s solves ``|(s G + mu I)^-1 c| = 1``."""
        from scipy.optimize import brentq

        m, c = self.members[g], self._own(g)
        if np.linalg.norm(c) <= self.level[g]:
            self.x[m] = 0.0
            return
        if g not in self._modes:
            self._modes[g] = np.linalg.eigh(self.G[np.ix_(m, m)])
        values, vectors = self._modes[g]
        values = np.maximum(values, RIDGE * values[-1])
        modal = vectors.T @ c

        def excess(log: float) -> float:
            return float(np.linalg.norm(modal / (np.exp(log) * values + self.level[g]))) - 1

        size = np.log(np.linalg.norm(c) / values[-1])
        high = float(np.log(np.linalg.norm(modal / values)))  # without a penalty it is not larger than this
        low = min(float(size), high) - 1
        while excess(low) < 0:
            low -= 5
        norm = np.exp(brentq(excess, low, high + 1, xtol=1e-12))
        self.x[m] = vectors @ (norm * modal / (norm * values + self.level[g]))

    def _clear(self, before: Array) -> None:
        """Set groups to zero that are best there while the others stay; minimise alone over those that have shrunk."""
        norms = self._norms()
        for g in map(int, np.flatnonzero(norms > 0)):
            if np.linalg.norm(self._own(g)) <= self.level[g]:
                self.x[self.members[g]] = 0.0
            elif norms[g] < SHRUNK * before[g]:
                self._alone(g)  # Newton's model holds within a norm of the group: near zero it cannot move

    def _model(self, a: Indices) -> tuple[Array, Array]:
        """Descent slope and Hessian of the objective on the coefficients `a`, whose groups are not zero."""
        H = self.G[np.ix_(a, a)].copy()
        norms, group = self._norms(), self.group[a]
        slope = self.b[a] - self.G[a] @ self.x - self.level[group] * self.x[a] / norms[group]
        for g in np.unique(group):
            m = np.flatnonzero(group == g)
            u = self.x[a[m]] / norms[g]
            H[m, m] += self.level[g] / norms[g]
            H[np.ix_(m, m)] -= self.level[g] / norms[g] * np.outer(u, u)
        return slope, H

    def _move(self, a: Indices, d: Array, gain: float) -> bool:
        """Go along d as far as the objective falls; whether it did."""
        start, t = self._objective(self.x), 1.0
        while t > 1e-12:
            moved = self.x.copy()
            moved[a] += t * d
            if self._objective(moved) <= start - 1e-4 * t * gain + 1e-15 * abs(start):
                self.x = moved
                return True
            t *= 0.5
        return False


def _solved(H: Array, slope: Array) -> Array:
    from scipy.linalg import lapack

    diagonal, ridge = np.diag(H).copy(), RIDGE
    while True:
        H[np.diag_indices(len(H))] = diagonal * (1 + ridge)
        factor, info = lapack.dpotrf(H, lower=1, clean=0)
        if info == 0:
            return np.asarray(lapack.dpotrs(factor, slope, lower=1)[0])
        ridge *= 100
