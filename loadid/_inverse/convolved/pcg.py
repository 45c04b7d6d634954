"""Conjugate gradients on ``[H; lam L]`` with circulant or exact preconditioners, and the scale of lambda.

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
from scipy import fft

from structures._advice import Advice, Option
from structures.errors import InputError, NotIdentifiable

from ..convolution import PenalizedConvolution

Array = NDArray[np.float64]
Index = NDArray[np.int_]


class Circulant:
    """``P^-1 r``: pad, transform, solve a (loads x loads) system on each line, transform back, cut. SPD for lambda > 0.

    Chan & Ng, SIAM Review 38 (1996) 427. Where neither the sensors nor the penalty see a line (a constant under a
    difference penalty) the penalty of half a line's spacing is a floor.

    Parameters
    ----------
    operator : PenalizedConvolution
    lam : float
        Absolute lambda.
    """

    def __init__(self, operator: PenalizedConvolution, lam: float) -> None:
        self.operator, self.lam = operator, lam
        p, H = operator.loads, operator.spectrum
        share = 1.0 if operator.weight is None else float(np.mean(operator.weight**2))
        G = np.empty((p, p, H.shape[-1]), complex)
        for i in range(p):
            for j in range(i + 1):
                G[i, j] = share * np.sum(H[:, i].conj() * H[:, j], axis=0)
        half = np.maximum(np.arange(H.shape[-1]), 0.5) * np.pi / operator.padded
        damping = lam**2 * (2 * np.sin(half)) ** (2 * operator.order)
        for i in range(p):
            G[i, i] += damping
        self.lower, self.pivots = _factor(G)

    def solve(self, r: Array) -> Array:
        """P^-1 r for loads (k, loads, samples)."""
        padded, L, p = self.operator.padded, self.lower, self.operator.loads
        R = fft.rfft(r, padded)
        for i in range(p):
            for j in range(i):
                R[:, i] -= L[i, j] * R[:, j]
        R *= self.pivots
        for i in range(p - 1, -1, -1):
            for j in range(i + 1, p):
                R[:, i] -= L[j, i].conj() * R[:, j]
        x: Array = fft.irfft(R, padded, overwrite_x=True)
        return x[..., : self.operator.samples]


def _factor(G: Array) -> tuple[Array, Array]:
    """Unit lower factors (p, p, lines) and reciprocal pivots (p, lines) of Hermitian matrices, lower half given."""
    p = len(G)
    L, d = np.zeros_like(G), np.empty((p, G.shape[-1]))
    for j in range(p):
        d[j] = G[j, j].real - sum((np.abs(L[j, k]) ** 2 * d[k] for k in range(j)), np.zeros(G.shape[-1]))
        for i in range(j + 1, p):
            L[i, j] = (G[i, j] - sum(L[i, k] * L[j, k].conj() * d[k] for k in range(j))) / d[j]
    return L, 1.0 / d


class ModalInverse:
    """``A^-1 r`` for A = H^T H + lam^2 L^T L by the modes of (H, L), ``X diag(1 / (c^2 + lam^2 s^2)) X^T``.

    Conjugate gradients then take some steps, which give back the digits that a product with the inverse loses.

    Parameters
    ----------
    operator : PenalizedConvolution
    lam : float
        Absolute lambda.
    """

    def __init__(self, operator: PenalizedConvolution, lam: float) -> None:
        modes = operator.modes
        self.operator, self.lam = operator, lam
        self._X, self._size2 = modes.X, modes.c**2 + (lam * modes.s) ** 2

    def solve(self, r: Array) -> Array:
        """A^-1 r for loads (k, loads, samples)."""
        flat = np.swapaxes(r, 1, 2).reshape(len(r), -1)
        found = (flat @ self._X / self._size2) @ self._X.T
        return np.ascontiguousarray(np.swapaxes(found.reshape(len(r), r.shape[2], r.shape[1]), 1, 2))


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

    y: Array | None = None
    c: Array | None = None
    b: Array | None = None

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

    x: Array
    r: Array
    q: Array
    gradient: float
    iterations: int


def solve(
    operator: PenalizedConvolution, circulant: Circulant | ModalInverse, sides: Sides, tolerance: float = TOLERANCE,
    most: int = MOST, strict: bool = True, takeover: bool = True,
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
        circulant = ModalInverse(operator, circulant.lam)  # it is there, and takes fewer steps
    lam, N, k = circulant.lam, operator.samples, sides.count
    another = takeover and strict and operator.loads * N <= FACTORED and not isinstance(circulant, ModalInverse)
    if another:
        most = min(most, operator.loads * N)  # steps after which it had ended but for rounding
    x = np.zeros((k, operator.loads, N))
    r = np.zeros((k, operator.sensors, N)) if sides.y is None else np.array(sides.y, float)
    q = np.zeros((k, operator.loads, operator.rows)) if sides.c is None else np.array(sides.c, float)
    b = sides.b

    def gradient(live: Index) -> Array:
        s = operator.correlate(r[live]) + lam * operator.rough_adjoint(q[live])
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
        u, v = operator.convolve(d), lam * operator.rough(d)
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
        return solve(operator, ModalInverse(operator, lam), sides, tolerance)
    if failed:
        raise unsettled(f"gradient {reached:.2g} times the first after {iterations} steps")
    return Reached(x, r, q, reached, iterations)


def refined(operator: PenalizedConvolution, circulant: Circulant, y: Array) -> Reached:
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
    scale, lam, change = float(np.linalg.norm(operator.correlate(y))), circulant.lam, np.inf

    def slope(r: Array, q: Array) -> float:
        return float(np.linalg.norm(operator.correlate(r) + lam * operator.rough_adjoint(q)))

    for _ in range(PASSES):
        r, q = y - operator.convolve(found.x), -lam * operator.rough(found.x)
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


def _dot(a: Array, b: Array) -> Array:
    """Inner products of each right side."""
    return np.asarray(np.einsum("kij,kij->k", a, b))


STEPS = 60
SETTLED = 1e-9
UNSEEN = 1e-12
LONG = 1 << 14  # samples beyond which the largest value is extrapolated


def free_responses(operator: PenalizedConvolution) -> Array:
    """Orthonormal responses (count, sensors, samples) to what a difference penalty leaves free.

    Raises
    ------
    NotIdentifiable
        If the sensors do not see a load that the penalty leaves free (LID-E306).
    """
    o, p, N = operator.order, operator.loads, operator.samples
    if o == 0:
        return np.zeros((0, operator.sensors, N))
    loads = np.zeros((o * p, p, N))
    for k in range(o):  # Legendre polynomials: their responses stay apart
        for j in range(p):
            loads[k * p + j, j] = np.linspace(-1, 1, N) ** k
    responses = operator.convolve(loads).reshape(o * p, -1).T
    seen, size = float(np.linalg.norm(responses)), float(np.sqrt(np.sum(operator.h**2) * N))
    Q, R = np.linalg.qr(responses)
    if np.min(np.abs(np.diag(R))) <= UNSEEN * max(seen, size):
        raise NotIdentifiable(
            "a constant or linear load is seen neither by the sensors nor by the penalty",
            advice=Advice("add a sensor that sees a constant load, or choose ", Option("penalty", "identity")),
            code="LID-E306",
        )
    return np.ascontiguousarray(Q.T).reshape(o * p, operator.sensors, N)


def largest(operator: PenalizedConvolution) -> float:
    """Largest generalised singular value of (H, L), what the penalty leaves free taken out.

    That of a record beyond `LONG` samples is extrapolated by its growth over the last doubling: flat where the response
    has been forgotten by then, a power of the length where a difference of a static load is asked for.
    """
    if operator.samples <= LONG or operator.weight is not None:
        return _largest(operator)
    half, whole = _largest(operator.cut(LONG // 2)), _largest(operator.cut(LONG))
    return float(whole * (operator.samples / LONG) ** max(np.log2(whole / half), 0.0))


def _largest(operator: PenalizedConvolution) -> float:
    """Golub & Kahan's bidiagonalisation of ``(I - Q Q^T) H S``, with S the running sums that undo L, until it settles.

    Raises
    ------
    InputError
        If no load moves any sensor.
    """
    rng, free = np.random.default_rng(0), free_responses(operator)
    v = rng.standard_normal((1, operator.loads, operator.samples - operator.order))
    V: list[Array] = [v / np.linalg.norm(v)]
    U: list[Array] = []
    B = np.zeros((STEPS + 1, STEPS))
    before = 0.0
    for k in range(STEPS):
        u = _without(_without(operator.convolve(_sum(V[-1], operator.order)), free), U)
        B[k, k] = alpha = float(np.linalg.norm(u))
        if alpha == 0:
            break
        U.append(u / alpha)
        v = _without(_sum_adjoint(operator.correlate(_without(U[-1], free)), operator.order), V)
        value = float(np.linalg.norm(B[: k + 1, : k + 1], 2))
        beta = float(np.linalg.norm(v))
        if beta <= 1e-14 * value or abs(value - before) <= SETTLED * value:
            return value
        B[k, k + 1 : k + 2] = beta
        V.append(v / beta)
        before = value
    if before == 0:
        raise InputError(
            "the forward model is zero: no load moves any sensor", where="inverse problem",
            found="largest singular value 0", expected="a sensor that sees a load",
            hint="check the sensors, the loads and the units",
        )  # fmt: skip
    return before


def _without(x: Array, basis: Array | list[Array]) -> Array:
    """The part of x (1, rows, samples) at right angles to orthonormal vectors."""
    for _ in range(2 if len(basis) else 0):
        for q in basis:
            x = x - float(np.sum(q * x)) * q.reshape(x.shape)
    return x


def _sum(w: Array, order: int) -> Array:
    """Load with these differences that starts at zero."""
    for _ in range(order):
        w = np.pad(np.cumsum(w, axis=-1), ((0, 0), (0, 0), (1, 0)))
    return w


def _sum_adjoint(g: Array, order: int) -> Array:
    """Transpose of `_sum`."""
    for _ in range(order):
        g = np.cumsum(g[..., :0:-1], axis=-1)[..., ::-1]
    return g
