"""One constrained problem at one lambda, prepared once and solved for many data; resultants and multipliers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, plain

from ...constraints import Bounds, Constraint, FrictionCone, NonNegative, Resultant, Support, faces, project
from ..svd import SVDPath
from . import activeset
from .activeset import CAP, ActivePoint
from .feasible import Feasible
from .few import NARROW, FewRows, NarrowPenalty
from .quadratic import ActiveFace, Quadratic, gram_of

Array = NDArray[np.float64]
FEW = 0.5  # share of the modes that meets data up to which faces are solved by their rows
Index = NDArray[np.int_]


def soft(constraints: Sequence[Constraint]) -> list[Resultant]:
    """The resultants that have a covariance."""
    return [c for c in constraints if isinstance(c, Resultant) and not c.hard]


def whitening(c: Resultant, sigma: float) -> Array:
    """Rows W with W^T W = sigma^2 covariance^-1."""
    from scipy.linalg import solve_triangular

    covariance = np.asarray(c.covariance)
    return np.asarray(sigma * solve_triangular(np.linalg.cholesky(covariance), np.eye(len(covariance)), lower=True))


def resultants_of(constraints: Sequence[Constraint], new: Sequence[ArrayLike] | None) -> list[Array]:
    """Values of all resultant constraints, in order; `new` replaces them."""
    own = [np.asarray(c.value) for c in constraints if isinstance(c, Resultant)]
    if new is None:
        return own
    values = [np.atleast_1d(np.asarray(plain(v), float)) for v in new]
    sizes = [len(v) for v in values] == [len(v) for v in own]
    if not sizes or not all(np.all(np.isfinite(v)) for v in values):
        raise InputError("the resultants do not fit", where="resultants", found=[v.shape for v in values],
                         expected=f"finite, {[v.shape for v in own]}")  # fmt: skip
    return values


def soft_values(constraints: Sequence[Constraint], values: Sequence[Array], sigma: float, frames: int) -> list[Array]:
    """Whitened values of the soft resultants, (R, frames) each.

    Raises
    ------
    InputError
        If their frames are not those of the data.
    """
    out = []
    for c, v in zip([c for c in constraints if isinstance(c, Resultant)], values, strict=True):
        if v.ndim == 2 and v.shape[1] != frames:
            raise InputError("the resultants have other frames than the data", where="Resultant",
                             found=v.shape[1], expected=frames)  # fmt: skip
        if not c.hard:
            each = np.broadcast_to(v[:, None], (len(v), frames)) if v.ndim == 1 else v
            out.append(whitening(c, sigma) @ each)
    return out


def with_values(feasible: Feasible, values: Sequence[Array]) -> Feasible:
    """The set with these values of its exact resultants."""
    rows = feasible.equal
    if not len(rows):
        return feasible
    picked = [
        values[feasible.resultants.index(int(n))][int(i)] / w
        for n, i, w in zip(rows.source, rows.place, rows.norm, strict=True)
    ]
    framed = [np.ndim(v) for v in picked]
    if any(framed):
        size = next(len(v) for v in picked if np.ndim(v))
        picked = [np.broadcast_to(v, (size,)) for v in picked]
    return replace(feasible, equal=replace(rows, value=np.array(picked)))


Pair = tuple[Array, NDArray[np.bool_ | np.int_]]  # multipliers, active


def by_constraint(
    constraints: Sequence[Constraint], s: Feasible, p: ActivePoint, face: ActiveFace, slope: Array, push: Array
) -> list[Pair]:
    """What each constraint pushes, and where it acts (soft resultants: see `with_soft`).

    Parameters
    ----------
    slope : array, shape (n,)
        Gradient of half the objective by all loads.
    push : array, shape (kept,)
        What intervals and cones push, by the local unknowns.
    """
    in_cone = np.zeros(len(s.keep), bool)
    for group in s.cones:
        in_cone[group.index] = True
    bound, fixed = np.zeros(s.n), np.zeros(s.n, bool)
    bound[s.keep], fixed[s.keep] = np.where(in_cone, 0.0, push), ~in_cone & face.held
    removed = np.ones(s.n, bool)
    removed[s.keep] = False
    found: list[Pair] = []
    for number, c in enumerate(constraints):
        if isinstance(c, NonNegative | Bounds):
            force, on = _bound(s, number, p.kappa, np.where(fixed, bound, 0.0))
            loads = np.arange(s.n) if c.loads is None else np.asarray(c.loads)
            found.append((force[loads], on[loads]))
        elif isinstance(c, Support):
            mine = removed.copy()
            mine[np.asarray(c.loads)] = False
            found.append((np.zeros(s.n), mine))
        elif isinstance(c, Resultant):
            force = np.zeros(len(np.asarray(c.C)))
            mine = np.flatnonzero(s.equal.source == number)
            force[s.equal.place[mine]] = -p.nu[mine] / s.equal.norm[mine]
            found.append((force, np.ones(len(force), bool)))
        else:
            found.append((_cone_push(s, c, push), _cone_status(s, number, c, face)))
    return _of_removed(constraints, found, slope)


def _of_removed(constraints: Sequence[Constraint], found: list[Pair], slope: Array) -> list[Pair]:
    """With what the supports push: the gradient at the loads that they removed, less the share of the resultants."""
    rest = slope.copy()
    for c, (force, _) in zip(constraints, found, strict=True):
        if isinstance(c, Resultant):
            rest -= force @ np.asarray(c.C)
    out = []
    for c, (force, on) in zip(constraints, found, strict=True):
        if isinstance(c, Support):
            force = np.where(on, rest, 0.0)
            rest = np.where(on, 0.0, rest)  # a load that two supports remove counts once
        out.append((force, on))
    return out


def with_soft(pairs: list[Pair], constraints: Sequence[Constraint], rest: Array, sigma: float) -> list[Pair]:
    """With the multipliers sigma^2 Sigma^-1 (r - C g) of the soft resultants, from H g - y of the stacked rows."""
    start = len(rest) - sum(len(np.asarray(c.C)) for c in soft(constraints))
    out = []
    for pair, c in zip(pairs, constraints, strict=True):
        if isinstance(c, Resultant) and not c.hard:
            R = len(np.asarray(c.C))
            pair = (-(whitening(c, sigma).T @ rest[start : start + R]), pair[1])
            start += R
        out.append(pair)
    return out


def _bound(s: Feasible, number: int, kappa: Array, bound: Array) -> Pair:
    """Of one set of bounds: those that are the tightest at their load, and those that are rows in a cone."""
    force = np.where((s.lower_source == number) & (bound > 0), bound, 0.0)
    force = np.where((s.upper_source == number) & (bound < 0), bound, force)
    for i in np.flatnonzero(s.below.source == number):
        force[s.below.place[i]] -= s.below.sign[i] * kappa[i]
    return force, force != 0


def _cone_push(s: Feasible, c: FrictionCone, push: Array) -> Array:
    turned = push.copy()
    for group in s.cones:
        if group.rotated:
            turned[group.index] = np.einsum("kij,kj->ki", group.frame, push[group.index])
    force = np.zeros(s.n)
    force[s.keep] = turned
    return np.asarray(force[np.asarray(c.contacts)])


def _cone_status(s: Feasible, number: int, c: FrictionCone, face: ActiveFace) -> Index:
    """Status of each contact; those outside the support are open."""
    first = {int(j): i for i, j in enumerate(np.asarray(c.contacts)[:, 0])}
    out = np.zeros(len(first), int)
    for group, status in zip(s.cones, face.status, strict=True):
        for k in np.flatnonzero(group.source == number):
            out[first[int(s.keep[group.index[k, 0]])]] = status[k]
    return out


@dataclass(frozen=True, eq=False)
class ConstrainedSolution:
    """Load under constraints, with what certifies it. Frames stand in front of every array.

    Parameters
    ----------
    load : array, shape (loads,) or (frames, loads)
    multipliers : tuple of array, one per constraint
        The gradient of half the objective is the sum of what they push: signs (loads,) >= 0, bounds (loads,) > 0 at
        the lower and < 0 at the upper, support (all loads; what the data would make of the removed ones), resultants
        (R,), friction cones (contacts, dim) in the directions of the loads.
    active : tuple of array, one per constraint
        Loads held at a bound (bool); removed loads (bool); resultants (bool); contacts: 0 open, 1 sliding, 2 sticking.
    gap : float
        Duality gap relative to half of |y|^2: half the objective is at most this much above its minimum.
    violation : float
        Largest violation of a constraint, relative to the largest load.
    residual2, penalty2, free_residual2 : float
        Squared norms of the whitened residual (soft resultants are data too), of L g, and of the residual that the
        same lambda leaves without constraints; sums over the frames.
    iterations : int
        Newton steps.
    solver : str
    converged : bool
    points : tuple of ActivePoint
        For a warm start.
    """

    load: Array
    multipliers: tuple[Array, ...]
    active: tuple[NDArray[np.bool_ | np.int_], ...]
    gap: float
    violation: float
    residual2: float
    penalty2: float
    free_residual2: float
    iterations: int
    solver: str
    converged: bool
    points: tuple[ActivePoint, ...] = field(default=(), repr=False)

    @property
    def change(self) -> float:
        """Rise of the residual norm against the solution without constraints."""
        return float(np.sqrt(self.residual2) - np.sqrt(self.free_residual2))


def grams(base: SVDPath, feasible: Feasible) -> tuple[Array, Array]:
    """Gram matrices of operator and penalty in local unknowns; they direct the steps, no solution comes from them."""
    return gram_of(feasible.columns(base.Y.T * base.c[:, None])), gram_of(feasible.columns(base.Y.T * base.s[:, None]))


def few_rows(base: SVDPath, feasible: Feasible) -> tuple[Array, NarrowPenalty | None] | None:
    """Modes that meet data in local unknowns, where they are few, and the penalty, where it has a narrow band.

    The penalty is None where all loads have equal variance; None in all where `FewRows` does not serve.
    """
    from scipy.sparse import csr_array

    met, L = int(np.count_nonzero(base.c)), None
    if met > FEW * len(base.c):
        return None
    if not base.orthonormal:
        if base.problem.L is None or feasible.cones:
            return None
        L = NarrowPenalty(csr_array(np.asarray(base.problem.L)[:, feasible.keep]))
        if L.width > NARROW:
            return None
    return feasible.columns(base.Y[:, :met].T * base.c[:met, None]), L


class ConstrainedSolver:
    """``min |H g - y|^2 + lambda^2 |L g|^2`` under constraints, at one lambda, for many y.

    The factors of the path compress operator and penalty into n rows, diag(sqrt(c^2 + lambda^2 s^2)) X^-1, without
    normal equations. See `loadid._inverse.constrained.path.ConstrainedPath.prepare`.

    Parameters
    ----------
    base : SVDPath
        Its operator holds the whitened rows of soft resultants after those of the sensors.
    constraints : sequence
    feasible : Feasible
    lam : float
        Absolute lambda.
    sigma : float
        Noise level of the whitened data, which soft resultants are weighed against.
    grams : callable, optional
        Gives the Gram matrices of operator and penalty in local unknowns (`grams`), the same at every lambda.
    few : (array, NarrowPenalty or None), optional
        Few modes that meet data, and the penalty (`few_rows`), the same too.
    """

    def __init__(
        self, base: SVDPath, constraints: Sequence[Constraint], feasible: Feasible, lam: float, sigma: float,
        grams: Callable[[], tuple[Array, Array]] | None = None, few: tuple[Array, NarrowPenalty | None] | None = None,
    ) -> None:  # fmt: skip
        self.base, self.constraints, self.feasible, self.lam, self.sigma = (
            base, tuple(constraints), feasible, float(lam), float(sigma),
        )  # fmt: skip
        c, s = base.c, base.s
        d = np.sqrt(c**2 + (self.lam * s) ** 2)
        safe = np.where(d > 0, d, 1.0)
        self.weights, self.seen, self.prior = d, c / safe, self.lam * s / safe
        self.quadratic = (
            self._few(*few)
            if few is not None and self.lam > 0
            else Quadratic(self._rows(), feasible, None if grams is None else grams()[0] + self.lam**2 * grams()[1])
        )

    def _rows(self) -> Array:
        """Rows of the compressed objective."""
        return self.feasible.columns(self.base.Y.T * self.weights[:, None])

    def _few(self, C: Array, L: NarrowPenalty | None) -> FewRows:
        """The objective of few rows C and a penalty L."""
        shares = 1 / self.seen[: len(C)]
        return FewRows(C, shares, self.lam, float(self.base.scale), self.feasible, self._rows, L)

    # -- data ---------------------------------------------------------------------------------------------------------
    def compress(self, y: Array) -> tuple[Array, Array]:
        """Right side b of the compressed problem for one vector of data (soft values included), and U^T y."""
        beta = np.zeros(len(self.seen))
        r = self.base.U.shape[1]
        beta[:r] = self.base.U.T @ y
        return self.seen * beta, beta

    def data(self, y: ArrayLike, resultants: Sequence[ArrayLike] | None) -> tuple[Array, Feasible]:
        """Data with the soft resultants behind them, (rows, frames), and the set with the exact ones.

        Raises
        ------
        InputError
            Data or resultants that do not fit, NaN.
        """
        y = np.asarray(y, float)
        sensors = len(self.base.problem.H) - sum(len(np.asarray(c.C)) for c in soft(self.constraints))
        if y.ndim not in (1, 2) or len(y) != sensors or not np.all(np.isfinite(y)):
            raise InputError("the data do not fit", where="data", found=f"shape {y.shape}, or NaN",
                             expected=f"finite, ({sensors},) or ({sensors}, frames)")  # fmt: skip
        values = resultants_of(self.constraints, resultants)
        frames = y.shape[1] if y.ndim == 2 else 1
        stacked = np.vstack([y.reshape(sensors, frames), *soft_values(self.constraints, values, self.sigma, frames)])
        return stacked, with_values(self.feasible, values)

    # -- solving ------------------------------------------------------------------------------------------------------
    def solve(
        self, y: ArrayLike, warm: ConstrainedSolution | None = None, *,
        resultants: Sequence[ArrayLike] | None = None, cap: int = CAP,
    ) -> ConstrainedSolution:  # fmt: skip
        """Solve for whitened data.

        Parameters
        ----------
        y : array, shape (m,) or (m, frames)
            Each frame is solved on its own, started from the one before.
        warm : ConstrainedSolution, optional
            Solution of data alike, to start from: the answer is the same, the work less.
        resultants : sequence of array, optional
            New values of the resultant constraints, in their order.
        cap : int
            Most Newton steps; below its default no other route is tried (flag W410 where it ends the run).
        """
        stacked, feasible = self.data(y, resultants)
        points = self.points(stacked, feasible, () if warm is None else warm.points, cap)
        return self.finish(stacked, feasible, points, framed=np.ndim(y) == 2)

    def points(
        self, y: Array, feasible: Feasible, starts: Sequence[ActivePoint], cap: int = CAP
    ) -> tuple[ActivePoint, ...]:
        """Answers for the columns of the data, each from its start or, beyond those, from the column before."""
        found: list[ActivePoint] = []
        for k, column in enumerate(y.T):
            start = starts[k] if k < len(starts) else found[-1] if found else None
            found.append(self.point(column, feasible.of(k), start, cap))
        return tuple(found)

    def point(self, y: Array, feasible: Feasible, start: ActivePoint | None, cap: int = CAP) -> ActivePoint:
        """Active-set answer for one vector of data."""
        return activeset.solve(self.quadratic, self.compress(y)[0], feasible, start, cap)

    def finish(self, y: Array, feasible: Feasible, points: Sequence[ActivePoint], framed: bool) -> ConstrainedSolution:
        """Everything that is reported, from the points of all frames."""
        parts = [self._report(column, feasible.of(k), p) for k, (column, p) in enumerate(zip(y.T, points, strict=True))]
        if not framed:
            return parts[0]
        count = len(self.constraints)
        return ConstrainedSolution(
            load=np.stack([p.load for p in parts]),
            multipliers=tuple(np.stack([p.multipliers[i] for p in parts]) for i in range(count)),
            active=tuple(np.stack([p.active[i] for p in parts]) for i in range(count)),
            gap=max(p.gap for p in parts),
            violation=max(p.violation for p in parts),
            residual2=sum(p.residual2 for p in parts),
            penalty2=sum(p.penalty2 for p in parts),
            free_residual2=sum(p.free_residual2 for p in parts),
            iterations=sum(p.iterations for p in parts),
            solver=", ".join(sorted({p.solver for p in parts})),
            converged=all(p.converged for p in parts),
            points=tuple(points),
        )

    def _report(self, y: Array, feasible: Feasible, p: ActivePoint) -> ConstrainedSolution:
        problem = self.base.problem
        g = feasible.to_global(p.h)
        b, beta = self.compress(y)
        outside = y - self.base.U @ beta[: self.base.U.shape[1]]
        rest = problem.H @ g - y
        rough = g if problem.L is None else problem.L @ g
        slope = np.zeros(feasible.n)
        if len(feasible.keep) < feasible.n:  # the gradient by all loads, removed ones too
            slope = self.base.Y @ (self.weights * (self.weights * (self.base.Y.T @ g) - b))
        force = self.quadratic.gradient(p.h, b)[0]
        push = force + p.nu @ feasible.equal.matrix + p.kappa @ feasible.below.matrix
        face = ActiveFace.near(feasible, p.h - self.quadratic.tau * push)
        rows = by_constraint(self.constraints, feasible, p, face, slope, push)
        rows = with_soft(rows, self.constraints, rest, self.sigma)
        half = 0.5 * float(y @ y)
        return ConstrainedSolution(
            load=g.reshape(problem.shape),
            multipliers=tuple(force for force, _ in rows),
            active=tuple(on for _, on in rows),
            gap=self._gap(feasible, p, push) / half if half > 0 else 0.0,
            violation=feasible.violation(p.h),
            residual2=float(rest @ rest),
            penalty2=float(np.sum(rough**2)),
            free_residual2=float(np.sum((self.prior**2 * beta) ** 2) + outside @ outside),
            iterations=p.steps,
            solver=p.solver,
            converged=p.converged,
            points=(p,),
        )

    def _gap(self, s: Feasible, p: ActivePoint, push: Array) -> float:
        """Bound of what half the objective lies above its minimum, by the multipliers made admissible."""
        held = np.zeros(len(push))
        low, up = np.isfinite(s.lower) & (push > 0), np.isfinite(s.upper) & (push < 0)
        held[low | up] = push[low | up]
        gap = float(push[low] @ (p.h - s.lower)[low] + push[up] @ (p.h - s.upper)[up])
        for c in s.cones:
            w = push[c.index]
            dual = w + project(-w, faces(-w, c.mu, c.facets))  # Moreau: nearest multiplier of the dual cone
            held[c.index] = dual
            gap += float(np.sum(dual * p.h[c.index]))
        rest = sum(
            abs(float(m @ (rows.matrix @ p.h - rows.value))) for m, rows in ((p.nu, s.equal), (p.kappa, s.below))
        )
        return abs(gap) + rest + self.quadratic.dual_energy(push - held, p.h)
