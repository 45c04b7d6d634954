"""Constrained least squares by active sets; by interior point where they cycle or a set may be empty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import NotIdentifiable

from .feasible import Feasible
from .normal import DenseNormal, exchange
from .quadratic import ActiveFace, Quadratic

Array = NDArray[np.float64]
Index = NDArray[np.int_]

PATIENCE = 12
EAGER = 0.5  # share of the largest pull below which a held load waits
TIGHT = 1e-13  # natural residual, relative to the data, at which a solution is exact
GOOD = 1e-11  # and below which it is accepted when rounding lets it fall no further
CAP = 80
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class ActivePoint:
    """Where an active-set run stands.

    Parameters
    ----------
    h : array, shape (n,)
        Local unknowns, within the intervals and cones.
    nu, kappa : array
        Multipliers of the rows C h = r and F h <= f: gradient + C^T nu + F^T kappa is that of the cones and intervals.
    error : float
        Natural residual, relative to the data.
    steps : int
    solver : str
    converged : bool
    aim : array, shape (n,), optional
        What projects to h: a warm start begins on its face, not on that of a gradient step with new data.
    """

    h: Array
    nu: Array
    kappa: Array
    error: float
    steps: int
    solver: str
    converged: bool
    aim: Array | None = None


@dataclass(frozen=True, eq=False)
class Prox:
    """Proximal term: weight (relative to the diagonal of the objective) and centre."""

    weight: float
    centre: Array


def solve(
    quadratic: Quadratic, b: Array, feasible: Feasible, start: ActivePoint | None = None, cap: int = CAP
) -> ActivePoint:
    """Minimise |A h - b|^2 on the feasible set.

    Newton's method on the equation h = P(h - tau gradient) with the projection P on intervals and cones (semismooth:
    Qi & Sun, Math. Program. 58 (1993) 353; for bounds it is the primal-dual active set of Hintermüller, Ito & Kunisch,
    SIAM J. Optim. 13 (2002) 865). If it cycles, proximal terms that shrink lead to the solution; if that fails too, an
    interior-point solver gives the start.
    """
    here = origin(feasible) if start is None else replace(start, steps=0)
    if feasible.simple and not feasible.cones and quadratic.well:
        here = _bounds_only(quadratic, b, feasible, here, cap)
    plane = _rows_only(feasible)
    if plane and not (quadratic.well or quadratic.exact):
        here = _on_plane(quadratic, b, feasible, here)
    found = newton(quadratic, b, feasible, here, cap=cap)
    routes = [] if plane else [_homotopy, _from_inside]  # a plane has one face: no route leads to a better one
    if any(np.any(c.facets) for c in feasible.cones):
        routes.reverse()  # between facets and edges proximal steps are slow
    steps = found.steps
    for route in routes if cap >= CAP else ():
        if found.converged:
            break
        tried = route(quadratic, b, feasible, found if route is _homotopy and found.error < 1e-6 else here)
        steps += tried.steps
        found = min(found, tried, key=lambda p: p.error)
    return replace(found, steps=steps)


def _bounds_only(q: Quadratic, b: Array, s: Feasible, start: ActivePoint, cap: int) -> ActivePoint:
    """Start from what block exchanges reach; Newton then checks it, and takes a last step where it must."""
    aim = start.h - q.tau * q.gradient(start.h, b)[0] if start.aim is None else start.aim
    low, high = aim <= s.lower, aim >= s.upper if np.any(np.isfinite(s.upper)) else None
    try:
        found = exchange(DenseNormal(q, b), s.lower, s.upper, low, high, patience=PATIENCE, eager=EAGER, cap=cap)
    except np.linalg.LinAlgError:
        return start
    return replace(start, h=np.clip(found.v, s.lower, s.upper), aim=None, steps=found.steps)


def _rows_only(s: Feasible) -> bool:
    """Whether nothing but rows C h = r holds."""
    free = np.all(np.isneginf(s.lower)) and np.all(np.isposinf(s.upper))
    return bool(len(s.equal) and not len(s.below) and not s.cones and free)


def _on_plane(q: Quadratic, b: Array, s: Feasible, start: ActivePoint) -> ActivePoint:
    """Minimiser where C h = r is all that holds: least squares in the null space of C.

    The multipliers never meet the inverse of an ill-conditioned A (Björck, Numerical Methods for Least Squares
    Problems, SIAM 1996, section 5.1.3).
    """
    from scipy.linalg import solve_triangular

    C, rank = s.equal.matrix, len(s.equal)
    Q, T = np.linalg.qr(C.T, mode="complete")
    if rank > q.n or np.abs(np.diag(T)).min() <= 100 * EPS * np.abs(T).max():
        return start  # rows that follow from each other: Newton sorts them
    fixed = Q[:, :rank] @ np.linalg.lstsq(T[:rank].T, s.equal.value, rcond=None)[0]
    V = Q[:, rank:]
    right = b - q.A @ fixed
    W, R = np.linalg.qr(q.A @ V)
    diagonal = np.abs(np.diag(R))
    if R.shape[0] == R.shape[1] and diagonal.min(initial=np.inf) > q.n * EPS * diagonal.max(initial=0.0):
        w = solve_triangular(R, W.T @ right)
    else:
        w = np.linalg.lstsq(q.A @ V, right, rcond=None)[0]
    h = fixed + V @ w
    gradient = (q.A @ h - b) @ q.A
    nu = -np.linalg.lstsq(T[:rank], Q[:, :rank].T @ gradient, rcond=None)[0]
    return replace(start, h=h, nu=nu, aim=None)


def _from_inside(quadratic: Quadratic, b: Array, feasible: Feasible, start: ActivePoint) -> ActivePoint:
    """Newton from the answer of an interior-point solver; that answer where Newton cannot improve it."""
    inner = interior_point(quadratic, b, feasible)
    if inner is None:
        return start
    polished = newton(quadratic, b, feasible, inner)
    best = min(inner, polished, key=lambda p: p.error)
    return replace(
        best, steps=polished.steps, solver="interior point, polished" if best.converged else "interior point"
    )


def origin(feasible: Feasible) -> ActivePoint:
    """The admissible load nearest to none."""
    h = feasible.project(np.zeros(len(feasible.keep)))
    return ActivePoint(h, np.zeros(len(feasible.equal)), np.zeros(len(feasible.below)), np.inf, 0, "active set", False)


@dataclass(frozen=True, eq=False)
class _State:
    """Everything that a step needs, at one point."""

    gradient: Array
    aim: Array
    face: ActiveFace
    active: Index
    error: float


def _look(q: Quadratic, b: Array, s: Feasible, h: Array, nu: Array, kappa: Array, prox: Prox | None) -> _State:
    gradient, size = q.gradient(h, b)
    total = gradient + nu @ s.equal.matrix + kappa @ s.below.matrix
    tau = q.tau
    if prox is not None:
        total = total + prox.weight / q.tau * (h - prox.centre)
        tau = q.tau / (1 + prox.weight)
    aim = h - tau * total
    face = ActiveFace.near(s, aim)
    error = float((np.abs(face.point - h) / np.sqrt(tau)).max(initial=0.0))
    active = np.zeros(0, int)
    if len(s.equal):
        off = s.equal.matrix @ h - s.equal.value
        error = max(error, float((np.abs(off) / np.sqrt(s.equal.matrix**2 @ tau)).max()))
    if len(s.below):
        reach = s.below.matrix**2 @ tau
        wanted = kappa + (s.below.matrix @ h - s.below.value) / reach
        error = max(error, float((np.abs(kappa - np.maximum(wanted, 0.0)) * np.sqrt(reach)).max()))
        active = np.flatnonzero(wanted > 0)
    scale = max(float(np.linalg.norm(b)), size, np.finfo(float).tiny)
    return _State(gradient, aim, face, active, error / scale)


def newton(
    q: Quadratic, b: Array, s: Feasible, start: ActivePoint, *, prox: Prox | None = None, cap: int = CAP,
    tight: float = TIGHT,
) -> ActivePoint:  # fmt: skip
    """Semismooth Newton from a start; the best point that it saw if it does not converge."""
    h, nu, kappa = start.h, start.nu, start.kappa
    best, halved, steps = None, (np.inf, 0), 0
    pull = np.zeros(q.n) if prox is None else prox.weight / q.tau
    tau = q.tau if prox is None else q.tau / (1 + prox.weight)
    # else the last step is repeated from its own residual: a small gradient alone tells half of the digits
    corrected = q.fair or prox is not None
    while True:
        at = _look(q, b, s, h, nu, kappa, prox)
        if best is None or at.error < best[0] or (corrected and at.error <= tight):
            best = (at.error, at.face.point, nu, kappa, at.aim)
        settled = at.error >= 0.1 * halved[0] and best[0] < GOOD  # rounding lets it fall no further
        if at.error < 0.5 * halved[0]:
            halved = (at.error, steps)
        solved = at.error <= tight
        if (
            (solved and corrected)
            or settled
            or start.steps + steps >= cap
            or steps - halved[1] > PATIENCE
            or not np.isfinite(at.error)
        ):
            break
        face = at.face if steps or start.aim is None else ActiveFace.near(s, start.aim)
        rows, short = _rows(s, at.active, h)
        offset = np.zeros(q.n) if prox is None else h - prox.centre
        moved = q.step(h, b, at.gradient, face, tau, pull, offset, rows, short)
        steps, corrected = steps + (not solved), corrected or solved
        if moved is None:
            break
        h, multipliers = moved
        nu, kappa = multipliers[: len(nu)], np.zeros(len(kappa))
        kappa[at.active] = multipliers[len(nu) :]
    error, h, nu, kappa, aim = best
    return ActivePoint(h, nu, kappa, error, start.steps + steps, "active set", error <= GOOD, aim)


def _rows(s: Feasible, active: Index, h: Array) -> tuple[Array, Array]:
    """Rows that hold, and what `h` lacks in each."""
    if not len(active):
        return s.equal.matrix, s.equal.value - s.equal.matrix @ h if len(s.equal) else np.zeros(0)
    C = np.vstack([s.equal.matrix, s.below.matrix[active]])
    return C, np.concatenate([s.equal.value, s.below.value[active]]) - C @ h


def _homotopy(q: Quadratic, b: Array, s: Feasible, start: ActivePoint) -> ActivePoint:
    """Proximal steps: from a well-conditioned neighbour to the problem itself, each run warm."""
    weight, shrink, here, steps = 0.1, 10.0, replace(start, steps=0), 0
    centre = here.h
    for _ in range(80):
        found = newton(q, b, s, here, prox=Prox(weight, centre), tight=1e-12)
        steps += found.steps
        if not found.converged:
            weight, shrink = weight * 4, max(shrink / 2, 2.0)
            if weight > 1e3:
                break
            continue
        here, centre = replace(found, steps=0), found.h
        weight = max(weight / shrink, 1e-10)
        found = newton(q, b, s, here, cap=25)
        steps += found.steps
        if found.converged:
            here = found
            break
    end = _look(q, b, s, here.h, here.nu, here.kappa, None)
    return ActivePoint(
        here.h, here.nu, here.kappa, end.error, steps, "active set, proximal", end.error <= GOOD, end.aim
    )


def interior_point(quadratic: Quadratic, b: Array, feasible: Feasible) -> ActivePoint | None:
    """Solution by clarabel in scaled unknowns, moved into the intervals and cones; None if it fails."""
    w = np.sqrt(quadratic.tau)
    right = -quadratic.gradient(np.zeros(quadratic.n), b)[0] * w
    size = float(np.abs(right).max(initial=0.0)) or 1.0
    own, image = quadratic.parts
    own = own * w**2 if own.ndim == 1 else own * w[:, None] * w
    found = conic_minimum(own, -right / size, feasible, w, size, image=None if image is None else image * w)
    if not found.solved:
        return None
    k, j = len(feasible.equal), len(feasible.below)
    h = feasible.project(found.x * w * size)
    nu, kappa = found.dual[:k] * size, np.maximum(found.dual[k : k + j], 0.0) * size
    error = _look(quadratic, b, feasible, h, nu, kappa, None).error
    return ActivePoint(h, nu, kappa, error, 0, "interior point", error <= GOOD)


@dataclass(frozen=True, eq=False)
class ConicAnswer:
    """Status, unknowns and multipliers of the rows of the standard form, as the solver gave them."""

    status: str
    x: Array
    dual: Array

    @property
    def solved(self) -> bool:
        """Whether it is a solution."""
        return self.status in ("Solved", "AlmostSolved")

    @property
    def empty(self) -> bool:
        """Whether the solver holds that there is no admissible point."""
        return self.status in ("PrimalInfeasible", "AlmostPrimalInfeasible")


def conic_minimum(
    P: Array, c: Array, s: Feasible, w: Array, size: float, tol: float = 1e-11, image: Array | None = None
) -> ConicAnswer:
    """Min 1/2 x^T P x + c^T x over the set, unknowns h = size * w * x; P a matrix or its diagonal.

    Few rows `image` add half of |image x|^2: what they make of x are unknowns of their own, so that nothing of the
    size of the loads squared is factored.
    """
    import clarabel
    import scipy.sparse as sp

    matrix, value, kinds = _standard_form(s)
    A, rows = sp.csc_matrix(matrix @ sp.diags(w)), 0 if image is None else len(image)
    value, upper = value / size, sp.diags(P) if P.ndim == 1 else sp.csc_matrix(np.triu(P))
    if image is not None:
        A = sp.block_array([[sp.csc_matrix(image), -sp.identity(rows)], [A, None]], format="csc")
        upper, value = sp.block_diag([upper, sp.identity(rows)]), np.concatenate([np.zeros(rows), value])
        kinds, c = [clarabel.ZeroConeT(rows), *kinds], np.concatenate([c, np.zeros(rows)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tol
    found = clarabel.DefaultSolver(sp.csc_matrix(upper), c, A, value, kinds, settings).solve()
    x, dual = np.asarray(found.x)[: len(w)], np.asarray(found.z)[rows:]
    return ConicAnswer(str(found.status).rsplit(".", 1)[-1], x, dual)


def _standard_form(s: Feasible) -> tuple[Any, Array, list[Any]]:
    """Rows ``matrix @ h + slack = value`` with the slack in cones: equalities, rows, bounds, facets, round cones."""
    import clarabel
    import scipy.sparse as sp

    n = len(s.keep)
    eye = sp.identity(n, format="csr")
    low, up = np.flatnonzero(np.isfinite(s.lower)), np.flatnonzero(np.isfinite(s.upper))
    parts = [sp.csr_matrix(s.equal.matrix), sp.csr_matrix(s.below.matrix), -eye[low], eye[up]]
    values = [s.equal.value, s.below.value, -s.lower[low], s.upper[up]]
    for c in s.cones:
        for index, mu, K in zip(c.index, c.mu, c.facets, strict=True):
            if K == 0:
                continue
            angle = 2 * np.pi * np.arange(K) / K
            sides = np.column_stack([np.cos(angle), np.sin(angle), np.full(K, -mu)])
            parts.append(sp.csr_matrix(sides @ eye[index].toarray()))
            values.append(np.zeros(K))
    kinds = []
    k = len(s.equal)
    rows = sum(p.shape[0] for p in parts)
    if k:
        kinds.append(clarabel.ZeroConeT(k))
    if rows > k:
        kinds.append(clarabel.NonnegativeConeT(rows - k))
    for c in s.cones:
        for index, mu, K in zip(c.index, c.mu, c.facets, strict=True):
            if K == 0:
                dim = len(index)
                scale = sp.diags(np.r_[mu, np.ones(dim - 1)])
                parts.append(-(scale @ eye[np.r_[index[-1], index[:-1]]]))
                values.append(np.zeros(dim))
                kinds.append(clarabel.SecondOrderConeT(dim))
    return sp.vstack(parts, format="csr"), np.concatenate(values), kinds


def refuse_empty(feasible: Feasible) -> None:
    """Refuse a set that no load is in.

    The smallest load of the set is asked for; the solver's ray of infeasibility, checked here, names the rows.

    Raises
    ------
    NotIdentifiable
        With code LID-E309, naming the resultants or bounds that fight.
    """
    if feasible.simple:
        return
    n = len(feasible.keep)
    finite = [np.abs(x[np.isfinite(x)]).max(initial=0.0) for x in (
        feasible.equal.value, feasible.below.value, feasible.lower, feasible.upper)]  # fmt: skip
    size = float(max(finite)) or 1.0
    found = conic_minimum(np.ones(n), np.zeros(n), feasible, np.ones(n), size, tol=1e-8)
    if not found.empty:
        return
    matrix, value, _ = _standard_form(feasible)
    z = found.dual / np.abs(found.dual).max()
    gain, drift = float(value @ z) / size, float(np.abs(matrix.T @ z).max())
    if not (gain < 0 and drift < 1e-5 * -gain * max(1.0, np.sqrt(n))):
        return  # no proof: the solve itself will tell
    rows = len(feasible.equal) + len(feasible.below)
    names = (*feasible.equal.names, *feasible.below.names)
    heavy = np.flatnonzero(np.abs(z[:rows]) > 0.1 * np.abs(z[:rows]).max(initial=0.0))
    values = np.concatenate([feasible.equal.value * feasible.equal.norm, feasible.below.value])
    listed = ", ".join(f"{names[i]} = {values[i]:.4g}" for i in heavy[:4]) or "the bounds"
    raise NotIdentifiable(
        f"no admissible load has this resultant: {listed} cannot be met within the signs, bounds and cones "
        f"(certificate {gain:.2g} < 0)",
        advice="check the sign and the frame of the resultant, or give it the covariance of its sensor "
        "so that it becomes a penalty",
        code="LID-E309",
    )
