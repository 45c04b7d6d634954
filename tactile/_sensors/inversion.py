"""The frozen inverse of a pad, one product per frame; and maps in their friction cones, solved where the contact is.

With C the posterior covariance, H the whitened transfer matrix and G = C H^T, leaving rows M out gives the load
``G y`` with ``y_M = (I - A_MM)^-1 A_MO y_O`` and ``A = H G`` (what the others predict there), and the covariance
``C + G_M (I - A_MM)^-1 G_M^T``: the Woodbury identity, no matrix of the size of the map is factored again.

Only the nodes of a region are unknowns; the region follows the contact. The answer is exact for a load on the region
(active sets, `loadid._inverse.constrained.activeset`), and every frame starts from the one before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve, qr

from loadid._inverse.constrained import activeset
from loadid._inverse.constrained.activeset import ActivePoint
from loadid._inverse.constrained.feasible import Feasible, compile_
from loadid._inverse.constrained.quadratic import Quadratic, gram_of
from loadid.constraints import Constraint, FrictionCone, NonNegative, Resultant, frames
from structures._readonly import ReadOnly
from structures._system.factor import compliance
from structures.errors import InputError

from .._arrays import Array, Index, Mask
from .observation import Wrench

if TYPE_CHECKING:
    from loadid._families.static import StaticInversion

    from .gaussian import ForceBand


CARRIED = 0.98  # of the shear that a friction allows, on all of a contact at once
LARGE = 4_000_000  # entries from which the products run in single precision: 1e-6 of the load, half the memory traffic


@dataclass(frozen=True, eq=False)
class Answer:
    """Load (n,), its std (n,), covariance of its resultant (6, 6), and of the load with it (n, 6)."""

    load: Array
    std: Array
    wrench: Array
    reach: Array


@dataclass(frozen=True, eq=False)
class Inverse(ReadOnly):
    """Regularised inverse at one lambda (relative, times `scale`, by `rule`), in readings whitened by `noise` (m,).

    `matrix` G (n, m) gives loads per whitened reading, in single precision where it is large; `influence` A = H G (m,
    m) what is predicted at a reading per unit of another; `std` (n,) is posterior; `resultant` R (6, n) force and
    moment of unit loads; `reach` C R^T (n, 6); `loss` R (G H - I) (6, n) what regularisation takes from the resultant
    of a load; `band` what std and resultants are made of under a contact prior.
    """

    matrix: NDArray[np.floating[Any]]
    influence: Array
    noise: Array
    std: Array
    resultant: Array
    reach: Array
    loss: Array
    lam: float
    scale: float
    rule: str
    band: ForceBand | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Loads and readings."""
        return self.matrix.shape

    def __call__(self, y: Array, wrench: Wrench | None = None, load: Array | None = None) -> Answer:
        """Load of readings (m,) in their own units; NaN where one is lost, refused where none is left.

        `load` (n,) is that of these readings, where it is known already and none is lost.
        """
        z, lost = self.filled(y)
        plain = None
        if lost.size == 0:
            found = self._times(z) if load is None else load
            plain = Answer(found, self.std, self.resultant @ self.reach, self.reach)
        answer = self._widened(z, lost) if plain is None else plain
        return answer if wrench is None else fused(answer, self.resultant, wrench)

    def recovery(self, press: Array) -> float:
        """Share of the resultant force of a load (n,) that would be found, were it there and the noise zero."""
        force = self.resultant[:3] @ press
        return float(1 + force @ (self.loss[:3] @ press) / (force @ force))

    def hidden(self, load: Array) -> Array:
        """What regularisation is expected to have taken from the resultant of this load (6,)."""
        return self.loss @ load

    def _times(self, z: Array) -> Array:
        return np.asarray(self.matrix @ z.astype(self.matrix.dtype, copy=False), float)

    def filled(self, y: Array) -> tuple[Array, Index]:
        """Whitened readings with the lost ones as the others predict them, and which those are."""
        z = y / self.noise
        lost = np.flatnonzero(~np.isfinite(z))
        if lost.size == len(z):
            raise InputError("no reading is left in this frame", where="frame", found="all markers lost",
                             expected="at least three markers", hint="look at the image")  # fmt: skip
        if lost.size:
            z = np.where(np.isfinite(z), z, 0.0)
            z[lost] = cho_solve(self._left(lost), self.influence[lost] @ z)
        return z, lost

    def _left(self, lost: Index) -> Any:
        """Cholesky factor of I - A_MM."""
        left = np.eye(lost.size) - self.influence[np.ix_(lost, lost)]
        try:
            return cho_factor((left + left.T) / 2)
        except LinAlgError:
            raise InputError(
                "too few readings are left for this lambda", where="frame",
                found=f"{lost.size} of {len(self.noise)} lost", expected="readings that determine the map",
                hint="a larger lambda, or a look at the image: light, focus, occlusion",
            ) from None  # fmt: skip

    def _widened(self, z: Array, lost: Index) -> Answer:
        """The answer of filled readings, with the std of those that were read."""
        factor = self._left(lost)
        columns = self.matrix[:, lost].astype(float)
        more = cho_solve(factor, columns.T)
        reach = self.reach + columns @ cho_solve(factor, (self.resultant @ columns).T)
        spread = np.sqrt(self.std**2 + np.einsum("nk,kn->n", columns, more))
        return Answer(self._times(z), spread, self.resultant @ reach, reach)


def fused(answer: Answer, resultant: Array, wrench: Wrench) -> Answer:
    """Answer conditioned on what a force/torque sensor says: exactly met, or weighed by its std."""
    value = wrench.value
    k = len(value)
    S = answer.wrench[:k, :k]
    if wrench.std is not None:
        S = S + np.diag(wrench.std**2)
    gain = _gain(S, answer.reach[:, :k])
    load = answer.load + gain @ (value - resultant[:k] @ answer.load)
    variance = np.maximum(answer.std**2 - np.sum(gain * answer.reach[:, :k], axis=1), 0.0)
    reach = answer.reach - gain @ answer.wrench[:k]
    return Answer(load, np.sqrt(variance), resultant @ reach, reach)


def met(force: Array, covariance: Array, wrench: Wrench) -> tuple[Array, Array]:
    """Resultant (6,) and its covariance, conditioned on what a force/torque sensor says."""
    value, k = wrench.value, len(wrench.value)
    S = covariance[:k, :k] if wrench.std is None else covariance[:k, :k] + np.diag(wrench.std**2)
    gain = _gain(S, covariance[:, :k])
    return force + gain @ (value - force[:k]), covariance - gain @ covariance[:k]


def held(force: Array, wrench: Wrench, friction: float | None, normal: Array | None = None) -> Wrench:
    """What a contact that only presses is asked to carry exactly: the resultant (6,), or the nearest that it can.

    `normal` (3,) is that of the surface about the contact; Z of a flat one.
    """
    n = np.array([0.0, 0.0, 1.0]) if normal is None else normal
    pull = min(float(force[:3] @ n), 0.0)
    along = force[:3] - (force[:3] @ n) * n
    shear, most = float(np.linalg.norm(along)), np.inf if friction is None else -CARRIED * friction * pull
    along = along * (min(1.0, most / shear) if shear > 0 else 1.0)
    return Wrench(along + pull * n, None if wrench.torque is None else np.array(force[3:]))


def _gain(S: Array, P: Array) -> Array:
    """P S^-1, scaled so that forces and moments do not drown each other."""
    size = np.sqrt(np.diag(S))
    size = np.where(size > 0, size, 1.0)
    return np.linalg.lstsq(S / size[:, None] / size, (P / size).T, rcond=1e-12)[0].T / size


def prepare(family: StaticInversion, resultant: Array, lam: float, rule: str = "given") -> Inverse:
    """Inverse of a static family of known noise at relative `lam`; its constraints are left to others."""
    posed = family.at_rest()
    base = posed.base
    known = base.solution(lam, 1.0).posterior
    assert known is not None
    spread = np.asarray(posed.noise.level, float)
    matrix = base.inverse(lam)  # per whitened reading
    whitened = posed.H / spread[:, None]
    factor = known.factor  # type: ignore[attr-defined]
    return Inverse(
        matrix=np.ascontiguousarray(matrix, np.float32 if matrix.size > LARGE else float),
        influence=whitened @ matrix,
        noise=spread,
        std=np.asarray(known.std, float),
        resultant=resultant,
        reach=factor @ (factor.T @ resultant.T),
        loss=(resultant @ matrix) @ whitened - resultant,
        lam=float(lam),
        scale=float(base.scale),
        rule=rule,
    )


GROWTH = 1.6  # how much larger than needed a region may be before it is cut
FLAT = np.diag([1.0, 1.0, -1.0])  # pressures are unknowns, not normal tractions


def pressing(normals: Array | None, count: int) -> Array:
    """Frames (count, 3, 3) of tractions at nodes: two shears and the pressure, as columns; `normals` as `constraints`.

    Of a flat surface, whose normals are None, shears along X and Y and a pressure along -Z.
    """
    return np.tile(FLAT, (count, 1, 1)) if normals is None else frames(-normals)


def turned(columns: Array, frames: Array) -> Array:
    """Columns (m, 3 k) for tractions along X, Y, Z as those for tractions in frames (k, 3, 3)."""
    apart = columns.reshape(len(columns), -1, 1, 3)
    return np.asarray((apart @ frames).reshape(columns.shape))


@dataclass(frozen=True, eq=False)
class Pressed:
    """Load (n,), its std (n,), covariance of its resultant (6, 6), Newton steps, whether they ended, any contact."""

    load: Array
    std: Array
    wrench: Array
    steps: int
    converged: bool
    touched: bool = True


def carried(wrench: Wrench, friction: float | None, normals: Array | None = None) -> None:
    """Refuse an exact resultant that pulls, or shears more than this friction allows a contact that only presses.

    On a curved surface, of outward `normals` (P, 3), wherever that contact may be.
    """
    n = np.array([[0.0, 0.0, 1.0]]) if normals is None else normals
    pulls = n @ wrench.force
    shears = np.linalg.norm(wrench.force - pulls[:, None] * n, axis=1)
    allowed = pulls <= 0 if friction is None else shears <= -friction * pulls
    if wrench.std is None and not allowed.any():
        best = int(np.argmin(pulls))
        pull, shear = float(pulls[best]), float(shears[best])
        raise InputError(
            "the force sensor says what this contact cannot carry", where="wrench",
            found=f"shear {shear:.4g} N, {'Fz' if normals is None else 'along the normal'} {pull:.4g} N",
            expected=("Fz <= 0" if normals is None else "a press")
            + ("" if friction is None else f", shear at most {friction:g} times the pressing force"),
            hint="state the std of the force sensor (Wrench(..., std=)), or another friction",
        )  # fmt: skip


class _Region:
    """The problem on some nodes: matrix, Gram matrix, feasible set, posterior of its unconstrained answer."""

    def __init__(self, owner: RegionSolver, nodes: Index, lost: Index) -> None:
        self.nodes, self.lost = nodes, lost
        self.columns = (3 * nodes[:, None] + np.arange(3)).ravel()
        self.frames = owner.frames[nodes]
        H = turned(owner.H[:, self.columns].astype(float), self.frames)
        H[lost] = 0.0
        # few unknowns, many readings: a QR leaves a square problem for all frames on this region
        penalty = owner.penalty(nodes) if callable(owner.penalty) else np.diag(owner.penalty[self.columns])
        penalty = turned(penalty, self.frames)
        self.Q, self.A = qr(np.vstack([H, penalty]), mode="economic", check_finite=False)
        self.Q = np.asfortranarray(self.Q[: len(H)])
        self.gram = gram_of(self.A)
        self.whole = owner.resultant[:, self.columns]
        self.R = turned(self.whole, self.frames)
        self._spread: Answer | None = None
        self._free: tuple[Quadratic, Feasible] | None = None

    def along(self, local: Array) -> Array:
        """Tractions (3 k, ...) along X, Y, Z of those in the frames of their nodes."""
        return np.asarray((self.frames @ local.reshape(len(self.nodes), 3, -1)).reshape(local.shape))

    def within(self, load: Array) -> Array:
        """Tractions (3 k,) in the frames of their nodes of those along X, Y, Z."""
        return np.asarray((load.reshape(-1, 1, 3) @ self.frames).ravel())

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
            C, k = compliance(np.asfortranarray(self.gram.copy())), np.arange(len(self.nodes))
            reach, own = C @ self.R.T, C.reshape(len(k), 3, len(k), 3)[k, :, k, :]
            std = np.sqrt(np.einsum("kij,kjl,kil->ki", self.frames, own, self.frames).ravel())
            self._spread = Answer(np.zeros(len(C)), std, self.R @ reach, self.along(reach))
        return self._spread if wrench is None else fused(self._spread, self.whole, wrench)


class RegionSolver:
    """Constrained maps on the region of contact; a friction of None only forbids pulling.

    From the whitened transfer matrix H (m, n), the penalty, absolute lambda included (its weight of each load (n,), or
    a function that gives L of some nodes), the resultants (6, n) of unit loads, which nodes share a cell, sparse (P,
    P), and outward normals (P, 3) of a curved surface.
    """

    def __init__(
        self, H: Array, penalty: Array | Callable[[Index], Array], resultant: Array, neighbours: Any,
        friction: float | None = None, normals: Array | None = None,
    ) -> None:  # fmt: skip
        self.H, self.penalty, self.resultant = np.asfortranarray(H), penalty, resultant
        self.frames = pressing(normals, H.shape[1] // 3)
        self.neighbours, self.friction = neighbours.tocsr().astype(bool), friction
        self._state: tuple[_Region | None, ActivePoint | None] = None, None  # of the last frame: one value, for threads

    def solve(self, z: Array, touched: Mask, wrench: Wrench | None, free: Answer) -> Pressed:
        """Load for whitened readings; `touched` (P,) says where contact is, a ring about it is added.

        The ring makes room for what a first guess misses; where nothing is touched the load is zero, with the std
        of the answer without constraints.
        """
        n = self.H.shape[1]
        wanted = self._grown(touched)
        if not wanted.any():
            return Pressed(np.zeros(n), free.std, free.wrench, 0, True, touched=False)
        lost = np.flatnonzero(~np.isfinite(z))
        region, start = self._region(wanted, lost)
        point = self._solve(region, np.where(np.isfinite(z), z, 0.0), wrench, start)
        self._state = region, point
        load, std = np.zeros(n), np.zeros(n)
        spread = region.spread(wrench)
        load[region.columns], std[region.columns] = region.along(point.h), spread.std
        return Pressed(load, std, spread.wrench, point.steps, point.converged)

    def _grown(self, mask: Mask) -> Mask:
        return np.asarray(self.neighbours @ mask, bool) | mask

    def _region(self, wanted: Mask, lost: Index) -> tuple[_Region, ActivePoint | None]:
        """The last region while it still covers the contact and the same markers are lost; where to start in it."""
        last, point = self._state
        if last is not None and np.array_equal(last.lost, lost):
            inside = np.zeros(len(wanted), bool)
            inside[last.nodes] = True
            if not np.any(wanted & ~inside) and inside.sum() <= GROWTH * self._grown(wanted).sum():
                return last, point
        region = _Region(self, np.flatnonzero(self._grown(wanted)), lost)
        return region, None if last is None or point is None else self._moved(last, point, region)

    def _moved(self, last: _Region, point: ActivePoint, region: _Region) -> ActivePoint:
        """The last answer on the nodes of a new region."""
        whole = np.zeros(self.H.shape[1])
        whole[last.columns] = last.along(point.h)
        start = activeset.origin(region.feasible(self.friction, None))
        return replace(start, h=region.within(whole[region.columns]))

    def _solve(self, region: _Region, z: Array, wrench: Wrench | None, start: ActivePoint | None) -> ActivePoint:
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
        if start is not None and (len(start.nu) != len(feasible.equal) or len(start.h) != len(region.columns)):
            start = None
        return activeset.solve(quadratic, b, feasible, start)
