"""Cross spectra and amplitudes of loads on frequency lines, nearest to a target under limits, by the cone solver.

On every line X is the Hermitian matrix of the loads, positive semidefinite, and A the matrix of their FRFs, every row
scaled by the root of its target, over the root of the variance that the errors of the FRFs have per load. With
``A = Q R`` and ``Y = R X R^H`` either problem is one of n^2 real unknowns,

- the whole matrix T of responses: ``min |A X A^H - T|^2``, which is ``|Y - Q^H T Q|^2`` and a constant;
- autospectra alone: ``min sum_i (p_i + 1/p_i - 2) + E|dp|^2 + c |A X A^H - B|^2`` with p_i the response over its
  target: the squared logarithm of p_i to second order on both sides, and convex; what errors of the FRFs add to it;
  and, as many drives make the same autospectra, a little of the distance to what a buzz test gives, B = H H^H
  normalised,

and a limit is linear in Y: ``tr(W Y) <= b`` on a line, ``sum_k width_k tr(W_k Y_k) <= b`` over all of them. S. Boyd,
L. Vandenberghe, *Convex Optimization*, Cambridge (2004), sections 4.6 and 8.1; P. J. Goulart, Y. Chen, "Clarabel: an
interior-point solver for conic programs with quadratic objectives", arXiv 2405.12762 (2024).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import NotIdentifiable

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
ROOT2 = float(np.sqrt(2.0))
TINY = 1e-12  # of the largest entry of R, that keeps a load without any response from making it singular
PRICE = (
    0.1 / 4.343
) ** 2  # of power squared, over that of the drives of the target or of its buzz: a tenth of a decibel
SAFE = 3.0  # -log .05: a limit holds on a line with 95 % of the errors of the FRFs
LIKE = 0.03  # weight of a squared normalised cross spectrum beside a squared logarithm of an autospectrum
PHASES = 200  # rounds in which the phases of a sine follow the response
FOLLOWED = 6  # and under limits


@dataclass(frozen=True, eq=False)
class Goal:
    """What the loads of every line are to reach.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
        Responses over loads, each row over the root of the target of its sensor.
    variance : array, shape (lines, sensors, loads)
        Variance of H, scaled alike.
    target : array, shape (lines, sensors, sensors), or None
        Cross spectra over the roots of their autospectra; None where autospectra alone are given.
    """

    H: Complex
    variance: Real
    target: Complex | None


@dataclass(frozen=True, eq=False)
class Caps:
    """Limits: the power ``rows X rows^H + spread diag X`` is at most `most` on each line, or `total` over all of them.

    Parameters
    ----------
    rows, spread : array, shape (limits, lines, loads)
        Of a drive a unit vector and zeros; of a response as `allowing` makes them.
    most : array, shape (limits, lines)
        inf where there is none.
    widths : array, shape (lines,)
        Hz.
    total : array, shape (limits,)
        inf where there is none.
    """

    rows: Complex
    spread: Real
    most: Real
    widths: Real
    total: Real

    def power(self, X: Complex) -> Real:
        """Power of every limit and line, shape (limits, lines)."""
        own = np.einsum("ckn,knn->ck", self.spread, X).real
        return np.asarray(np.einsum("ckn,knm,ckm->ck", self.rows, X, self.rows.conj()).real + own)

    def at(self, lines: NDArray[Any]) -> Caps:
        """The limits of some lines; those of the whole band are left out."""
        none = np.full(len(self.total), np.inf)
        return Caps(self.rows[:, lines], self.spread[:, lines], self.most[:, lines], self.widths[lines], none)

    @classmethod
    def none(cls, lines: int, loads: int) -> Caps:
        """No limit."""
        empty = np.zeros((0, lines, loads))
        return cls(empty.astype(complex), empty, empty[..., 0], np.ones(lines), np.zeros(0))


def allowing(row: Complex, variance: Real) -> tuple[Complex, Real]:
    """Rows and spread (lines, loads) of a limited response that leave room for errors of its FRFs (lines, loads).

    ``|h + d|^2 <= (1 + a) |h|^2 + (1 + 1/a) |d|^2`` for every a, with the size that d exceeds on 5 % of the lines; a is
    the relative size of d, which is best where nothing cancels.
    """
    size = np.sum(np.abs(row) ** 2, axis=1, keepdims=True)
    a = np.sqrt(SAFE * variance.sum(axis=1, keepdims=True) / np.maximum(size, 1e-300)).clip(1e-9)
    return row * np.sqrt(1 + a), SAFE * variance * (1 + 1 / a)


def densities(
    goal: Goal, caps: Caps, progress: Callable[[float], None] = lambda share: None
) -> tuple[Complex, Complex]:
    """Cross spectra of the loads that come nearest to the goal, without limits and under them.

    Returns
    -------
    array, shape (lines, loads, loads)
        Without limits; of a whole matrix in closed form.
    array, shape (lines, loads, loads)
        Under the limits; lines that keep them anyhow are solved once, unless a limit of the whole band is passed.

    Raises
    ------
    NotIdentifiable
        The solver finds no point that it can vouch for.
    """
    lines = len(goal.H)
    R = _factors(goal)
    none = Caps.none(lines, goal.H.shape[2])
    if goal.target is None:
        free = np.empty((lines, *none.rows.shape[2:] * 2), complex)
        for k in range(lines):
            progress(0.6 * k / lines)
            free[k] = _solved(goal, R, none.at(np.array([k])), np.array([k]))[0]
    else:
        free = _unlimited(goal, R)
    progress(0.6)
    held, over = free.copy(), np.any(caps.power(free) > caps.most, axis=0)
    for i in np.flatnonzero(over):
        held[i] = _solved(goal, R, caps.at(np.array([i])), np.array([i]))[0]
    progress(0.8)
    if np.any(np.sum(caps.widths * caps.power(held), axis=1) > caps.total):
        held = _solved(goal, R, caps, np.arange(lines))
    progress(1.0)
    return free, held


def amplitudes(H: Complex, variance: Real, phase: Real | None, caps: Caps, start: Complex) -> tuple[Complex, Complex]:
    """Complex loads that come nearest to amplitudes, without limits and under them.

    Parameters
    ----------
    H, variance : array, shape (lines, sensors, loads)
        Each row over the amplitude that its sensor is to have.
    phase : array, shape (lines, sensors), or None
        rad; None: they are free, and follow the response, ``f -> arg H f``, which never raises the error.
    caps : Caps
        Of squared amplitudes on the lines.
    start : array, shape (lines, loads)
        Loads whose response has the first phases, where they are free.

    Notes
    -----
    R. W. Gerchberg, W. O. Saxton, Optik 35 (1972) 237-246, for phases that follow.
    """
    A = _augmented(H, variance)
    Q, R = np.linalg.qr(A)
    wanted = np.zeros(A.shape[:2], complex)
    sensors = H.shape[1]

    def aimed(f: Complex) -> Complex:
        angle = np.angle(np.einsum("ksn,kn->ks", H, f)) if phase is None else phase
        wanted[:, :sensors] = np.exp(1j * angle)
        return wanted

    free = start
    for _ in range(PHASES if phase is None else 1):
        new = np.linalg.solve(R, np.einsum("kan,ka->kn", Q.conj(), aimed(free))[..., None])[..., 0]
        settled = np.abs(new - free).max() <= 1e-6 * np.abs(new).max()
        free = new
        if settled:
            break
    held = free.copy()
    over = np.flatnonzero(np.any(caps.power(free[:, :, None] * free[:, None, :].conj()) > caps.most, axis=0))
    for _ in range(FOLLOWED if phase is None else 1):
        for k in over:
            held[k] = _cornered(Q[k], R[k], wanted[k], caps.at(np.array([k])))
        aimed(held)
    return free, held


# -- one line, or all of them together ---------------------------------------------------------------------------------
def _augmented(H: Complex, variance: Real) -> Complex:
    """FRFs over the root of the variance that their errors have per load, shape (lines, sensors + loads, loads)."""
    root = np.sqrt(variance.sum(axis=1))
    floor = TINY * np.maximum(np.abs(H).max(axis=(1, 2), keepdims=True)[:, 0], 1e-300)
    return np.concatenate([H, np.eye(H.shape[2]) * np.maximum(root, floor)[:, None, :]], axis=1)


def _factors(goal: Goal) -> tuple[Complex, Complex]:
    """Q and R of the augmented FRFs of every line."""
    Q, R = np.linalg.qr(_augmented(goal.H, goal.variance))
    return Q, R


def _back(R: Complex, Y: Complex) -> Complex:
    """``R^-1 Y R^-H``, Hermitian."""
    half = np.linalg.solve(R, Y)
    X = np.linalg.solve(R, half.conj().swapaxes(-1, -2))
    return np.asarray((X + X.conj().swapaxes(-1, -2)) / 2)


def _through(rows: Complex, R: Complex) -> Complex:
    """``rows R^-1``, shape (limits, lines, loads)."""
    found = np.linalg.solve(R.swapaxes(1, 2), np.moveaxis(rows, 0, 2))
    return np.asarray(np.moveaxis(found, 2, 0))


def _aim(goal: Goal, Q: Complex) -> Complex:
    """``Q^H T Q``, where only the rows of sensors of the augmented target are not zero."""
    assert goal.target is not None
    head = Q[:, : goal.H.shape[1]]
    return np.asarray(head.conj().swapaxes(1, 2) @ goal.target @ head)


def _unlimited(goal: Goal, factors: tuple[Complex, Complex]) -> Complex:
    """The nearest matrix where nothing limits it: positive semidefinite as the target is."""
    Q, R = factors
    return _back(R, _aim(goal, Q))


@cache
def _basis(n: int) -> Complex:
    """Orthonormal Hermitian matrices, shape (n^2, n, n): Y = sum_k y_k of these has the length of y."""
    found = np.zeros((n * n, n, n), complex)
    for i in range(n):
        found[i, i, i] = 1.0
    k = n
    for i in range(n):
        for j in range(i + 1, n):
            found[k, i, j] = found[k, j, i] = 1 / ROOT2
            found[k + 1, i, j], found[k + 1, j, i] = 1j / ROOT2, -1j / ROOT2
            k += 2
    return found


@cache
def _cone(n: int) -> Any:
    """Map of y to the scaled upper triangle of [[Re Y, -Im Y], [Im Y, Re Y]], which is semidefinite as Y is."""
    from scipy import sparse

    B = _basis(n)
    real = np.block([[B.real, -B.imag], [B.imag, B.real]])
    rows, columns = np.nonzero(np.tri(2 * n).T)
    order = np.lexsort((rows, columns))  # column by column
    rows, columns = rows[order], columns[order]
    return sparse.csc_matrix((real[:, rows, columns] * np.where(rows == columns, 1.0, ROOT2)).T)


def _solved(goal: Goal, factors: tuple[Complex, Complex], caps: Caps, lines: NDArray[Any]) -> Complex:
    """The loads of some lines, solved together."""
    import clarabel
    from scipy import sparse

    n, Q, plain = goal.H.shape[2], factors[0][lines], factors[1][lines]
    R = _sized(plain, caps)
    pairs = [(plain[i], plain[i] if R is plain else R[i]) for i in range(len(lines))]
    blocks = [_block(goal, Q[i], *pairs[i], int(k)) for i, k in enumerate(lines)]
    basis, w = _basis(n), _through(caps.rows, R)
    own = _through(np.broadcast_to(np.eye(n)[:, None], (n, len(lines), n)), R)
    weights = np.einsum("ckn,jnm,ckm->ckj", w, basis, w.conj()).real  # (limits, lines, n^2)
    weights += np.einsum("ckl,lkn,jnm,lkm->ckj", caps.spread, own, basis, own.conj(), optimize=True).real
    wide = blocks[0].P.shape[0]
    P = sparse.block_diag([b.P for b in blocks], format="csc")
    A = [sparse.block_diag([b.A for b in blocks], format="csc")]
    q, b = np.concatenate([x.q for x in blocks]), [np.concatenate([x.b for x in blocks])]
    cones = [cone for x in blocks for cone in x.cones]
    limits, values = [], []
    for c in range(len(weights)):
        rows = [(i, weights[c, i], caps.most[c, i]) for i in range(len(lines)) if np.isfinite(caps.most[c, i])]
        for i, row, most in rows:
            limits.append(_row(row / most, i * wide, wide * len(lines)))
            values.append(1.0)
        if np.isfinite(caps.total[c]):
            spread = np.zeros(wide * len(lines))
            for i in range(len(lines)):
                spread[i * wide : i * wide + n * n] = caps.widths[i] * weights[c, i] / caps.total[c]
            limits.append(sparse.csc_matrix(spread[None]))
            values.append(1.0)
    if limits:
        A.append(sparse.vstack(limits, format="csc"))
        b.append(np.array(values))
        cones.append(clarabel.NonnegativeConeT(len(values)))
    found = _run(P, q, sparse.vstack(A, format="csc"), np.concatenate(b), cones)
    y = found.reshape(len(lines), wide)[:, : n * n]
    X = _back(R, np.einsum("kj,jnm->knm", y, _basis(n)))
    return _within(X, caps)


def _sized(R: Complex, caps: Caps) -> Complex:
    """Factors in whose coordinates both the target and the limits are of the size of one, shape (lines, n, n).

    ``R_s^H R_s = R^H R + sum_c w_c^H w_c / b_c``, where a limit is far below what the target asks for the small part of
    a load that it leaves is then no small number. Without limits they are the factors as they are.
    """
    if not len(caps.rows):
        return R
    even = np.minimum(caps.most, (caps.total / np.sum(caps.widths))[:, None])
    parts = [caps.rows / np.sqrt(even)[..., None]]
    for j in range(R.shape[2]):
        own = np.zeros_like(caps.rows)
        own[..., j] = np.sqrt(caps.spread[..., j] / even)
        parts.append(own)
    rows = np.moveaxis(np.concatenate(parts), 0, 1)
    return np.asarray(np.linalg.qr(np.concatenate([R, rows], axis=1), mode="r"))


def _within(X: Complex, caps: Caps) -> Complex:
    """The loads without what the solver's tolerance left outside: negative eigenvalues, and limits passed by a hair."""
    w, V = np.linalg.eigh(X)
    X = np.asarray(V * np.maximum(w, 0.0)[:, None, :] @ V.conj().swapaxes(1, 2))
    if not len(caps.rows):
        return X
    over = caps.power(X) / caps.most
    whole = np.sum(caps.widths * caps.power(X), axis=1) / caps.total
    return X / np.maximum(over.max(axis=0), max(1.0, float(whole.max())))[:, None, None].clip(1.0)


def _row(values: Real, start: int, width: int) -> Any:
    from scipy import sparse

    columns = np.arange(start, start + len(values))
    return sparse.csc_matrix((values, (np.zeros(len(values), int), columns)), shape=(1, width))


@dataclass(frozen=True, eq=False)
class _Block:
    """The programme of one line: ``min x^T P x / 2 + q^T x``, ``b - A x`` in the cones; x begins with y."""

    P: Any
    q: Real
    A: Any
    b: Real
    cones: list[Any]


def _block(goal: Goal, Q: Complex, plain: Complex, R: Complex, k: int) -> _Block:
    """The programme of a line in the coordinates Y = R X R^H; Q and `plain` are the factors of its FRFs."""
    import clarabel
    from scipy import sparse

    n, head = goal.H.shape[2], Q[: goal.H.shape[1]]
    m, basis, back = n * n, _basis(n), _inverted(R)
    N = _normalised(goal.H[k]) if goal.target is None else goal.target[k]
    aim = np.einsum("jnm,mn->j", basis, head.conj().T @ N @ head).real
    price = float(_traces(_inverted(plain)) @ aim)  # the power of the drives of the aim
    dear = np.sqrt(PRICE * len(N)) / max(price, 1e-300) * _traces(back)[None]
    limited, weigh = R is not plain, np.eye(m)
    if limited:  # the response is Q M Y M^H Q^H: coordinates of M Y M^H
        M = plain @ back
        weigh = np.einsum("jab,ac,icd,bd->ji", basis.conj(), M, basis, M.conj(), optimize=True).real
    semi = [clarabel.PSDTriangleConeT(2 * n)]
    if goal.target is not None:
        B = np.concatenate([weigh / ROOT2, dear]) if limited else dear
        P, equal, rest = _residuals(0.0 if limited else 1.0, B, m, 0)
        A = sparse.vstack([equal, sparse.hstack([-_cone(n), sparse.csc_matrix((n * (2 * n + 1), rest))])], format="csc")
        q = np.r_[-(weigh.T @ aim), np.zeros(rest)]
        return _Block(P, q, A, np.zeros(A.shape[0]), [clarabel.ZeroConeT(len(B)), *semi])
    # autospectra alone: p = G y, t p >= 1 by a second-order cone, and what errors of the FRF make of p by rows r = B y
    G, B = _powers(goal, back, k)
    rows, sensors = [B, dear, *([np.sqrt(LIKE) * weigh] if limited else [])], len(G)
    B = np.asarray(np.linalg.qr(np.concatenate(rows), mode="r"), float)
    # p / size and size t are unknowns of the size of one
    size = np.minimum(1.0, G[:, :n].sum(axis=1)) if limited else np.ones(sensors)
    P, equal, rest = _residuals(0.0 if limited else 2 * LIKE, B, m, sensors)
    q = np.concatenate([G.sum(axis=0) - 2 * LIKE * (weigh.T @ aim), 1 / size, np.zeros(len(B))])
    hyper = np.zeros((3 * sensors, m + rest))
    for i in range(sensors):  # (t + p, t - p, 2) in the cone
        hyper[3 * i, :m], hyper[3 * i + 1, :m] = -G[i] / size[i], G[i] / size[i]
        hyper[3 * i, m + i], hyper[3 * i + 1, m + i] = -1.0, -1.0
    cone = sparse.hstack([-_cone(n), sparse.csc_matrix((n * (2 * n + 1), rest))])
    A = sparse.vstack([equal, sparse.csc_matrix(hyper), cone], format="csc")
    b = np.concatenate([np.zeros(len(B)), np.tile([0.0, 0.0, 2.0], sensors), np.zeros(n * (2 * n + 1))])
    cones = [clarabel.ZeroConeT(len(B)), *[clarabel.SecondOrderConeT(3)] * sensors, *semi]
    least = float(size.min())
    return _Block(P * least, q * least, A, b, cones)


def _inverted(R: Complex) -> Complex:
    return np.asarray(_through(np.eye(len(R), dtype=complex)[:, None], R[None])[:, 0])


def _traces(back: Complex) -> Real:
    """Power of the drives of every element of the basis, (n^2,)."""
    return np.asarray(np.einsum("ln,jnm,lm->j", back, _basis(len(back)), back.conj()).real)


def _normalised(H: Complex) -> Complex:
    """``H H^H`` over the roots of its diagonal: how a buzz test couples the sensors."""
    rows = H / np.linalg.norm(H, axis=1, keepdims=True)
    return np.asarray(rows @ rows.conj().T)


def _residuals(weight: float, B: Real, m: int, between: int) -> tuple[Any, Any, int]:
    """P and rows for ``weight |y|^2 / 2 + |r|^2`` with r = B y; unknowns y, others, r; how many follow y."""
    from scipy import sparse

    P = sparse.diags(np.concatenate([np.full(m, weight), np.zeros(between), np.full(len(B), 2.0)]), format="csc")
    return P, sparse.csc_matrix(np.hstack([B, np.zeros((len(B), between)), -np.eye(len(B))])), between + len(B)


def _powers(goal: Goal, back: Complex, k: int) -> tuple[Real, Real]:
    """Rows of the responses over their targets, (sensors, n^2), and of their std by errors of the FRF, (rows, n^2)."""
    n = len(back)
    g, basis = goal.H[k] @ back, _basis(n)
    G = np.einsum("sn,jnm,sm->sj", g, basis, g.conj()).real
    pushed = np.einsum("ln,jnm,sm->slj", back, basis, g.conj())  # (X h^H) of every sensor and load
    rows = (np.sqrt(2 * goal.variance[k])[..., None] * pushed).reshape(-1, n * n)
    return G, np.concatenate([rows.real, rows.imag])


def _cornered(Q: Complex, R: Complex, wanted: Complex, caps: Caps) -> Complex:
    """``min |Q R f - wanted|`` under the limits of one line: z = R f is the unknown, and each limit a cone."""
    import clarabel
    from scipy import sparse

    n, aim = len(R), Q.conj().T @ wanted
    blocks, b, cones = [], [], []
    for c in np.flatnonzero(np.isfinite(caps.most[:, 0])):
        own = np.diag(np.sqrt(caps.spread[c, 0]))
        stacked = np.concatenate([caps.rows[c], own[own.any(axis=1)]])[:, None] / np.sqrt(caps.most[c, 0])
        w = _through(stacked, R[None])[:, 0]
        blocks += [np.zeros((1, 2 * n)), -np.hstack([w.real, -w.imag]), -np.hstack([w.imag, w.real])]
        b.append(np.r_[1.0, np.zeros(2 * len(w))])
        cones.append(clarabel.SecondOrderConeT(1 + 2 * len(w)))
    z = _run(sparse.identity(2 * n, format="csc"), -np.r_[aim.real, aim.imag],
             sparse.csc_matrix(np.concatenate(blocks)), np.concatenate(b), cones)  # fmt: skip
    f = np.linalg.solve(R, z[:n] + 1j * z[n:])
    over = float(np.max(caps.power(f[None, :, None] * f[None, None, :].conj()) / caps.most))
    return np.asarray(f / np.sqrt(max(1.0, over)))


def _run(P: Any, q: Real, A: Any, b: Real, cones: list[Any]) -> Real:
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    found = clarabel.DefaultSolver(P, q, A, b, cones, settings).solve()
    if str(found.status) not in ("Solved", "AlmostSolved"):
        raise NotIdentifiable(
            f"the cone solver does not settle the loads under these limits ({found.status})",
            advice="check the limits and the target for units; without limits= the drives say what they need",
            code="LID-E410",
        )  # fmt: skip
    return np.asarray(found.x, float)
