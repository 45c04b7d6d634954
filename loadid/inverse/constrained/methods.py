"""Active set, interior point and projected gradient over a record; duality gap, std on a face, FFT products."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..convolution import PenalizedConvolution
from ..convolved.pcg import Circulant
from ..penalties import stencil
from .normal import BlockFactor, Factor, Normal, gram

REFINEMENTS = 2


def violation(gradient: NDArray, signed: NDArray) -> NDArray[np.float64]:
    """What the gradient lacks to be that of a minimum: it is >= 0 where a load may only push, 0 elsewhere."""
    return np.where(signed, np.maximum(-gradient, 0.0), -gradient)


def gap(normal: Normal, free: Factor, v: NDArray, gradient: NDArray, signed: NDArray) -> float:
    """Objective at v (>= 0 where signed) minus a lower bound of its minimum, over ``|y|^2 / 2``.

    The dual of ``min v^T Q v / 2 - q^T v + |y|^2 / 2, v >= 0`` (Wolfe) is to maximise ``|y|^2 / 2 - u^T Q u / 2`` over
    all u with ``Q u - q >= 0``. With ``d`` the violation at v, ``u = v + Q^-1 d`` is such a point, its gradient
    ``s = Q u - q`` is that of v without its negative part, and the difference of the two objectives is
    ``v^T s + (u - v)^T Q (u - v) / 2``: no large numbers are subtracted.

    Parameters
    ----------
    normal : Normal
    free : Factor
        Factors of Q itself.
    v, gradient : array, shape (size,)
        Point and ``Q v - q``.
    signed : array of bool, shape (size,)
        Unknowns that may only push.
    """
    if normal.data2 == 0.0:
        return 0.0
    move, s, curvature = np.zeros(len(v)), gradient, 0.0
    for _ in range(1 + REFINEMENTS):
        move = move + free.solve(violation(s, signed))
        image = normal.apply(move)
        s, curvature = gradient + image, float(move @ image)
    return (float(np.abs(v) @ np.abs(s)) + curvature / 2) / (normal.data2 / 2)


CAP, PATIENCE = 60, 6  # steps, and steps without fewer loads on the wrong side
FEW = 10  # loads on the wrong side that are worth every patience
SLACK = 1e-13  # of the largest H^T y: gradient that is rounding


@dataclass(frozen=True, eq=False)
class Exchanged:
    """Where the exchange stands: unknowns, gradient, held unknowns, whether none is on the wrong side, steps."""

    v: NDArray[np.float64]
    gradient: NDArray[np.float64]
    held: NDArray[np.bool_]
    settled: bool
    steps: int


def exchange(
    normal: Normal, signed: NDArray, held: NDArray, step: Callable[[], None], *, pace: float = 1.0, cap: int = CAP,
) -> Exchanged:  # fmt: skip
    """From a guess of what is held to the minimum: free loads that pull are held, held loads with a pull are freed.

    Primal-dual active set; Hintermüller, Ito & Kunisch, SIAM J. Optim. 13 (2002) 865. It ends after a finite number of
    steps or cycles; it gives up where the loads on the wrong side stop becoming fewer, or fall more slowly than by the
    factor `pace` for each step.
    """
    slack = SLACK * float(np.abs(normal.q).max(initial=0.0))
    fewest, since, steps, allowed = len(held) + 1, 0, 0, np.inf
    while True:
        step()
        steps += 1
        v, gradient = on_face(normal, normal.factor(np.where(held, np.inf, 0.0)), held)
        wrong = signed & np.where(held, gradient < -slack, v < 0)
        count = int(np.count_nonzero(wrong))
        allowed = max(FEW, pace * min(allowed, count / pace if steps == 1 else allowed))
        if count < fewest:
            fewest, since = count, 0
        since += 1
        if count == 0 or count > allowed or steps >= cap or since > PATIENCE:
            return Exchanged(v, gradient, held, count == 0, steps)
        held = held ^ wrong


def on_face(normal: Normal, factor: Factor, held: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Minimum where the held unknowns are 0, refined, and its gradient."""
    v = factor.solve(np.where(held, 0.0, normal.q))
    gradient = normal.gradient(v)
    level = normal.precision * float(np.abs(normal.q).max(initial=0.0))
    for _ in range(3):
        rest = np.where(held, 0.0, -gradient)
        if np.abs(rest).max(initial=0.0) <= level:
            break
        v = v + factor.solve(rest)
        gradient = normal.gradient(v)
    return v, gradient


INTERIOR_CAP = 80
NEAR = 0.995  # share of the way to the nearest bound
TIGHT = 1e-11  # complementarity, relative to |y|^2 / 2


@dataclass(frozen=True, eq=False)
class Inside:
    """Unknowns, multipliers (0 where the sign is free), steps."""

    v: NDArray[np.float64]
    s: NDArray[np.float64]
    steps: int


def interior(
    normal: Normal, signed: NDArray, start: NDArray, step: Callable[[], None], *, cap: int = INTERIOR_CAP
) -> Inside:
    """Predictor-corrector steps (Mehrotra, SIAM J. Optim. 2 (1992) 575) from an unconstrained solution.

    Each step solves ``(Q + diag(s / v)) dv = ...`` twice with one factorisation.
    """
    q, z = normal.q, signed
    v = start.copy()
    v[z] = np.maximum(v[z], 0.0) + 0.1 * float(np.mean(np.abs(v[z])))
    gradient = normal.gradient(v)
    s = np.zeros(len(v))
    s[z] = np.maximum(gradient[z], 0.0) + 0.1 * float(np.mean(np.abs(gradient[z])))
    size, steps = max(int(np.count_nonzero(z)), 1), 0
    enough, level = TIGHT * normal.data2 / 2, 1e-10 * float(np.abs(q).max(initial=0.0))
    while steps < cap:
        step()
        rest = gradient - s
        product = float(v[z] @ s[z])
        if product <= enough and np.abs(rest).max(initial=0.0) <= level:
            break
        mu, ratio, one = product / size, np.zeros(len(v)), np.zeros(len(v))
        ratio[z], one[z] = s[z] / v[z], 1 / v[z]
        factor = normal.factor(ratio)
        dv = factor.solve(-rest - s)
        ds = np.where(z, -s - ratio * dv, 0.0)
        after = (v + _reach(v, dv, z) * dv)[z] @ (s + _reach(s, ds, z) * ds)[z] / size
        push = np.where(z, ((after / mu) ** 3 * mu - dv * ds) * one, 0.0)
        dv = factor.solve(-rest - s + push)
        ds = np.where(z, -s - ratio * dv + push, 0.0)
        length = NEAR * min(_reach(v, dv, z), _reach(s, ds, z)) if size else 1.0
        v, s = v + length * dv, s + length * ds
        gradient = normal.gradient(v)
        steps += 1
    return Inside(v, s, steps)


def _reach(v: NDArray, dv: NDArray, signed: NDArray) -> float:
    """Largest step, at most 1 / NEAR, that keeps v positive where signed."""
    falling = signed & (dv < 0)
    return float(min(1 / NEAR, np.min(-v[falling] / dv[falling], initial=np.inf)))


REPORT = 100  # steps between two reports


def projected(
    normal: Normal, signed: NDArray, start: NDArray, steps: int, report: Callable[[], None]
) -> NDArray[np.float64]:
    """Unknowns after some steps of FISTA with restart, >= 0 where signed.

    Beck & Teboulle, SIAM J. Imaging Sci. 2 (2009) 183; O'Donoghue & Candes, Found. Comput. Math. 15 (2015) 715.
    """
    x = z = np.where(signed, np.maximum(start, 0.0), start)
    t, length = 1.0, 1 / normal.reach
    for k in range(steps):
        if k % REPORT == 0:
            report()
        new = z - length * normal.gradient(z)
        new = np.where(signed, np.maximum(new, 0.0), new)
        if (z - new) @ (new - x) > 0:
            t = 1.0
        later = (1 + np.sqrt(1 + 4 * t * t)) / 2
        x, z, t = new, new + (t - 1) / later * (new - x), later
    return x


@dataclass(frozen=True, eq=False)
class Spread:
    """Posterior of a face at unit noise.

    Parameters
    ----------
    variance : array, shape (samples, loads)
        Diagonal of ``(Q on the free loads)^-1``; 0 where a load is held. Times sigma^2: posterior variance.
    edf : float
        tr A of the face: the divergence of ``H g`` by the data where the held loads stay held (Meyer & Woodroofe, Ann.
        Stat. 28 (2000) 1083).
    """

    variance: NDArray[np.float64]
    edf: float


def spread(factor: BlockFactor) -> Spread:
    """Variance and degrees of freedom of the face whose factors these are.

    With M = Hgg + Gamma^T P Gamma and K = M^-1 (Hgx + Gamma^T P Phi) in every block, the covariance X of the state at
    its start gives that of its loads, ``M^-1 + K X K^T``, and of its response; X runs forward over the blocks.
    """
    N, B = factor.normal, factor.normal.blocks
    loads, states, f = np.empty((B.count, B.width)), np.empty((B.count + 1, B.n, B.n)), B.free
    K, pushed, own = np.empty((B.count, B.width, B.n)), np.empty((B.count, B.n, B.n)), np.empty(B.count)
    grams = gram(B.Ty, B.Ty)
    eye = np.eye(B.width)
    for part, scaled, t in N.scaled(factor.d):
        k = B.pattern[part]
        PG = factor.P[1:][part] @ (B.Gamma[k] * t[:, None, :])
        M = scaled + (B.Gamma[k] * t[:, None, :]).transpose(0, 2, 1) @ PG
        coupling = N.Hgx[k] * t[:, :, None] + PG.transpose(0, 2, 1) @ B.Phi[k]
        found = np.linalg.solve(M, np.concatenate([coupling, np.broadcast_to(eye, M.shape)], axis=2))
        K[part] = t[:, :, None] * found[:, :, : B.n]
        covariance = found[:, :, B.n :] * t[:, :, None] * t[:, None, :]
        loads[part] = np.einsum("jii->ji", covariance)
        own[part] = np.einsum("jab,jab->j", covariance, grams[k])
        pushed[part] = B.Gamma[k] @ covariance @ B.Gamma[k].transpose(0, 2, 1)
    states[0] = 0.0
    if len(f):
        states[0][np.ix_(f, f)] = np.linalg.solve(factor.P[0][np.ix_(f, f)], np.eye(len(f)))
    for j in range(B.count):
        states[j + 1] = factor.Z[j] @ states[j] @ factor.Z[j].T + pushed[j]
    X = states[:-1]
    loads += np.einsum("jgx,jgx->jg", K @ X, K)
    edf = float(own.sum())
    for pattern, rows in enumerate(B.members):
        seen = B.Oy[pattern] - B.Ty[pattern] @ K[rows]
        edf += float(np.einsum("jax,jax->", seen @ X[rows], seen))
    return Spread(B.join(loads).reshape(B.samples, B.p), edf)


TOLERANCE = 1e-10  # gradient in the norm of the preconditioner, over that at zero
MOST = 3000  # iterations of a solve; what they leave undone is in the gap


class ConvolvedNormal:
    """``Q = H^T H + lambda^2 L^T L`` of impulse responses at one absolute lambda.

    Parameters
    ----------
    operator : PenalizedConvolution
        Whitened impulse responses with their penalty, and weights (0 where data are missing).
    y : array, shape (samples, sensors)
        Whitened and weighted data, 0 where missing.
    lam : float
        Absolute lambda, > 0.
    """

    start = 0
    direct, precision = False, 1e-9

    def __init__(self, operator: PenalizedConvolution, y: NDArray, lam: float) -> None:
        self.operator, self.lam = operator, float(lam)
        self.y = np.ascontiguousarray(y.T)[None]

    @property
    def size(self) -> int:
        """Samples times loads."""
        return self.operator.samples * self.operator.loads

    @cached_property
    def data2(self) -> float:
        """Squared norm of the whitened data."""
        return float(np.sum(self.y**2))

    @cached_property
    def q(self) -> NDArray[np.float64]:
        """H^T y."""
        return self._flat(self.operator.correlate(self.y))

    def apply(self, v: NDArray) -> NDArray[np.float64]:
        """Q v."""
        g = self._loads(v)
        return self._back(self.operator.convolve(g), g)

    def gradient(self, v: NDArray) -> NDArray[np.float64]:
        """Q v - q, with the residual formed first."""
        g = self._loads(v)
        return self._back(self.operator.convolve(g) - self.y, g)

    def norms(self, v: NDArray) -> tuple[float, float]:
        """Squared norms of ``y - H v`` and of ``L v``."""
        g = self._loads(v)
        return float(np.sum((self.y - self.operator.convolve(g)) ** 2)), float(np.sum(self.operator.rough(g) ** 2))

    def factor(self, weight: NDArray | None = None) -> ConvolvedFactor:
        """What solves with ``Q + diag(weight)``; where the weight is infinite, the unknown is held at 0."""
        return ConvolvedFactor(self, np.zeros(self.size) if weight is None else weight)

    @cached_property
    def circulant(self) -> Circulant:
        """Preconditioner of Q."""
        return Circulant(self.operator, self.lam)

    def precondition(self, r: NDArray) -> NDArray[np.float64]:
        """Q^-1 r of an unending record."""
        return self._flat(self.circulant.solve(self._loads(r)))

    @cached_property
    def reach(self) -> float:
        """Bound of the largest eigenvalue of Q: that of the lines of an unending record."""
        o = self.operator
        weight = 1.0 if o.weight is None else float(np.max(o.weight**2))
        return weight * float(np.max(np.sum(np.abs(o.spectrum) ** 2, axis=(0, 1)))) + self.lam**2 * 4.0**o.order

    @cached_property
    def diagonal(self) -> NDArray[np.float64]:
        """Diagonal of Q of an unending record, one number for each load, for every unknown."""
        own = np.sum(self.operator.h**2, axis=(0, 2)) + self.lam**2 * np.sum(stencil(self.operator.order) ** 2)
        return np.tile(own, self.operator.samples)

    def _back(self, response: NDArray, g: NDArray) -> NDArray[np.float64]:
        o = self.operator
        return self._flat(o.correlate(response) + self.lam**2 * o.rough_adjoint(o.rough(g)))

    def _loads(self, v: NDArray) -> NDArray[np.float64]:
        return np.ascontiguousarray(v.reshape(self.operator.samples, self.operator.loads).T)[None]

    @staticmethod
    def _flat(g: NDArray) -> NDArray[np.float64]:
        return np.ascontiguousarray(g[0].T).reshape(-1)


class ConvolvedFactor:
    """Conjugate gradients on ``Q + diag(weight)``.

    The preconditioner is the circulant one between factors ``t = sqrt(c / (c + weight))``, c the diagonal of Q: what is
    held stays 0, and where a weight rules, it is divided by.
    """

    def __init__(self, normal: ConvolvedNormal, weight: NDArray) -> None:
        self.normal = normal
        self.t = np.sqrt(normal.diagonal / (normal.diagonal + weight))
        self.weight = np.where(np.isinf(weight), 0.0, weight)
        self.open = np.isfinite(weight)

    def solve(self, r: NDArray) -> NDArray[np.float64]:
        """Solution v (size,) of ``(Q + diag(weight)) v = r``, to the tolerance or to what the iterations reach."""
        r = np.where(self.open, r, 0.0)
        v, z = np.zeros(len(r)), self._precondition(r)
        d, energy = z, float(r @ z)
        first = energy
        for _ in range(MOST):
            if energy <= TOLERANCE**2 * first:
                break
            image = np.where(self.open, self.normal.apply(d) + self.weight * d, 0.0)
            step = energy / float(d @ image)
            v, r = v + step * d, r - step * image
            z = self._precondition(r)
            energy, before = float(r @ z), energy
            d = z + energy / before * d
        return v

    def _precondition(self, r: NDArray) -> NDArray[np.float64]:
        return self.t * self.normal.precondition(self.t * r)
