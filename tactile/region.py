"""Maps that only press and do not leave their friction cone, solved where the contact is, frame after frame.

Only the nodes of a region are unknowns; the region follows the contact. The answer is exact for a load on the region
(active sets, `loadid.inverse.activeset`), and every frame starts from the one before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from loadid.inverse import activeset
from loadid.inverse.activeset import Point
from loadid.inverse.constraints import Constraint, FrictionCone, NonNegative, Resultant
from loadid.inverse.feasible import Feasible, compile_
from loadid.inverse.quadratic import Quadratic, gram_of
from structures.errors import InputError

from .inversion import Answer, fused
from .reading import Wrench

Array = NDArray[np.float64]
GROWTH = 1.6  # how much larger than needed a region may be before it is cut
FLIP = np.array([1.0, 1.0, -1.0])  # pressures are unknowns, not normal tractions


@dataclass(frozen=True, eq=False)
class Pressed:
    """Load (n,), its std (n,), covariance of its resultant (6, 6), Newton steps, whether they ended, any contact."""

    load: Array
    std: Array
    wrench: Array
    steps: int
    converged: bool
    touched: bool = True


def carried(wrench: Wrench, friction: float | None) -> None:
    """Refuse a resultant that no contact can carry that only presses, with this friction.

    Raises
    ------
    InputError
        An exact resultant that pulls, or shears more than friction allows.
    """
    pull, shear = float(wrench.force[2]), float(np.hypot(*wrench.force[:2]))
    if wrench.std is None and (pull > 0 or (friction is not None and shear > -friction * pull)):
        raise InputError(
            "the force sensor says what this contact cannot carry", where="wrench",
            found=f"shear {shear:.4g} N, Fz {pull:.4g} N",
            expected="Fz <= 0" + ("" if friction is None else f", shear at most {friction:g} times the pressing force"),
            hint="state the std of the force sensor (Wrench(..., std=)), or another friction",
        )  # fmt: skip


class _Region:
    """The problem on some nodes: matrix, Gram matrix, feasible set, posterior of its unconstrained answer."""

    def __init__(self, owner: RegionSolver, nodes: NDArray, lost: NDArray) -> None:
        self.nodes, self.lost = nodes, lost
        self.columns = (3 * nodes[:, None] + np.arange(3)).ravel()
        self.flip = np.tile(FLIP, len(nodes))
        H = owner.H[:, self.columns].astype(float) * self.flip
        H[lost] = 0.0
        # few unknowns, many readings: a QR leaves a square problem for all frames on this region
        self.Q, self.A = qr(np.vstack([H, np.diag(owner.prior[self.columns])]), mode="economic", check_finite=False)
        self.Q = np.asfortranarray(self.Q[: len(H)])
        self.gram = gram_of(self.A)
        self.R = owner.resultant[:, self.columns] * self.flip
        self._spread: Answer | None = None
        self._free: tuple[Quadratic, Feasible] | None = None

    def problem(self, mu: float | None) -> tuple[Quadratic, Feasible]:
        """Objective and feasible set where no resultant is given; prepared once."""
        if self._free is None:
            feasible = self.feasible(mu, None)
            self._free = Quadratic(self.A, feasible, self.gram), feasible
        return self._free

    def feasible(self, mu: float | None, equal: tuple[Array, Array] | None) -> Feasible:
        """Cones, or pressures that are not negative; a resultant that is met."""
        n = len(self.columns)
        triples = np.arange(n).reshape(-1, 3)
        first: Constraint = NonNegative(triples[:, 2]) if mu is None else FrictionCone(mu, triples)
        constraints = [first] if equal is None else [first, Resultant(equal[0], equal[1])]
        return compile_(constraints, n)

    def spread(self, wrench: Wrench | None) -> Answer:
        """Std of the load on the region without constraints, covariance of its resultant, conditioned on a wrench."""
        if self._spread is None:
            from structures.condensation import compliance

            C = compliance(np.asfortranarray(self.gram.copy()))
            reach = C @ self.R.T
            self._spread = Answer(np.zeros(len(C)), np.sqrt(np.diag(C)), self.R @ reach, reach)
        return self._spread if wrench is None else fused(self._spread, self.R, wrench)


class RegionSolver:
    """Constrained maps on the region of contact.

    Parameters
    ----------
    H : array (m, n)
        Whitened transfer matrix.
    prior : array (n,)
        Weight of each load in the penalty, absolute lambda included.
    resultant : array (6, n)
    neighbours : sparse (P, P)
        Which nodes share a cell.
    friction : float or None
        Coefficient of friction; None only forbids pulling.
    """

    def __init__(
        self, H: NDArray, prior: Array, resultant: Array, neighbours: Any, friction: float | None = None
    ) -> None:
        self.H, self.prior, self.resultant = np.asfortranarray(H), prior, resultant
        self.neighbours, self.friction = neighbours.tocsr().astype(bool), friction
        self._last: _Region | None = None
        self._point: Point | None = None

    def solve(self, z: Array, touched: NDArray[np.bool_], wrench: Wrench | None, free: Answer) -> Pressed:
        """Load for whitened readings; `touched` (P,) says where contact is, a ring about it is added.

        The ring makes room for what a first guess misses; where nothing is touched the load is zero, with the std
        of the answer without constraints.
        """
        n = self.H.shape[1]
        wanted = self._grown(touched)
        if not wanted.any():
            return Pressed(np.zeros(n), free.std, free.wrench, 0, True, touched=False)
        lost = np.flatnonzero(~np.isfinite(z))
        region = self._region(wanted, lost)
        point = self._solve(region, np.where(np.isfinite(z), z, 0.0), wrench)
        load, std = np.zeros(n), np.zeros(n)
        spread = region.spread(wrench)
        load[region.columns], std[region.columns] = point.h * region.flip, spread.std
        return Pressed(load, std, spread.wrench, point.steps, point.converged)

    def _grown(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return np.asarray(self.neighbours @ mask, bool) | mask

    def _region(self, wanted: NDArray, lost: NDArray) -> _Region:
        """The last region while it still covers the contact and the same markers are lost."""
        last = self._last
        if last is not None and np.array_equal(last.lost, lost):
            inside = np.zeros(len(wanted), bool)
            inside[last.nodes] = True
            if not np.any(wanted & ~inside) and inside.sum() <= GROWTH * self._grown(wanted).sum():
                return last
        self._point = None if last is None else self._point
        region = _Region(self, np.flatnonzero(self._grown(wanted)), lost)
        self._point = None if self._point is None else self._moved(last, region)
        self._last = region
        return region

    def _moved(self, last: _Region | None, region: _Region) -> Point | None:
        """The last answer on the nodes of a new region."""
        if last is None or self._point is None:
            return None
        whole = np.zeros(self.H.shape[1])
        whole[last.columns] = self._point.h
        start = activeset.origin(region.feasible(self.friction, None))
        return replace(start, h=whole[region.columns])

    def _solve(self, region: _Region, z: Array, wrench: Wrench | None) -> Point:
        b = region.Q.T @ z
        quadratic, feasible = region.problem(self.friction)
        if wrench is not None:
            rows = region.R[: len(wrench.value)]
            if wrench.std is None:
                feasible = region.feasible(self.friction, (rows, wrench.value))
            else:
                soft = rows / wrench.std[:, None]
                quadratic = Quadratic(np.vstack([region.A, soft]), feasible, region.gram + gram_of(soft))
                b = np.concatenate([b, wrench.value / wrench.std])
        start = self._point
        if start is not None and (len(start.nu) != len(feasible.equal) or len(start.h) != len(region.columns)):
            start = None
        self._point = activeset.solve(quadratic, b, feasible, start)
        return self._point
