"""Normal operators ``Q = H^T H + lambda^2 L^T L`` and what solves with them: dense, and behind impulse responses.

That of a record over a state space is in `condensed`. Active set, interior point and projected gradient ask nothing
else of a problem; the duality gap judges them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..convolution import PenalizedConvolution
from ..convolved.pcg import Circulant
from ..penalties import stencil
from .quadratic import Quadratic

Array = NDArray[np.float64]

SLACK = 1e-13  # of the largest H^T y: gradient that is rounding


class NormalFactor(Protocol):
    """Solves with one matrix."""

    def solve(self, r: Array) -> Array:
        """Solution v (size,)."""
        ...


class NormalOperator(Protocol):
    """Half of ``v^T Q v - 2 q^T v`` and its faces, over unknowns v (size,)."""

    precision: float  # gradient on free unknowns, over the largest of q, above which a solution is refined

    @property
    def size(self) -> int:
        """Unknowns."""
        ...

    @property
    def q(self) -> Array:
        """H^T y, shape (size,)."""
        ...

    @property
    def slack(self) -> float | Array:
        """Gradient that is rounding, of all unknowns or of each."""
        ...

    def apply(self, v: Array) -> Array:
        """Q v, from H v and L v."""
        ...

    def gradient(self, v: Array) -> Array:
        """Q v - q, from the residual ``H v - y`` and L v."""
        ...

    def factor(self, weight: Array | None = None) -> NormalFactor:
        """Factors of ``Q + diag(weight)``; where the weight (size,) is infinite, the unknown is held at 0."""
        ...


class RecordNormal(NormalOperator, Protocol):
    """That of a record: v holds free states at the start, then the loads (samples, loads)."""

    direct: bool  # whether a factor solves in one go, whatever the weights are

    @property
    def start(self) -> int:
        """Free states: that many unknowns come before the loads."""
        ...

    @property
    def reach(self) -> float:
        """Bound of the largest eigenvalue of Q; infinite where factors are cheap and nobody asks."""
        ...

    @property
    def data2(self) -> float:
        """Squared norm of the whitened data."""
        ...

    def norms(self, v: Array) -> tuple[float, float]:
        """Squared norms of ``y - H v`` and of ``L v``."""
        ...


class DenseNormal:
    """Normal matrix of a quadratic objective |A h - b|^2, which directs the steps; A itself judges them afterwards."""

    def __init__(self, quadratic: Quadratic, b: Array) -> None:
        self.quadratic, self.size, self.precision = quadratic, quadratic.n, quadratic.precision
        self.q = -quadratic.gradient(np.zeros(self.size), b)[0]
        self.slack = 0.1 * SLACK * float(np.linalg.norm(b)) / np.sqrt(quadratic.tau)

    def apply(self, v: Array) -> Array:
        """G v."""
        return self.quadratic.apply(v)

    def gradient(self, v: Array) -> Array:
        """G v - q."""
        return np.asarray(self.quadratic.apply(v) - self.q)

    def factor(self, weight: Array | None = None) -> NormalFactor:
        """Factors of ``G + diag(weight)``; where the weight is infinite, the unknown is held at 0."""
        return self.quadratic.factor(np.zeros(self.size) if weight is None else weight)


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

    def __init__(self, operator: PenalizedConvolution, y: Array, lam: float) -> None:
        self.operator, self.lam = operator, float(lam)
        self.y = np.ascontiguousarray(y.T)[None]

    @property
    def size(self) -> int:
        """Samples times loads."""
        return int(self.operator.samples * self.operator.loads)

    @cached_property
    def data2(self) -> float:
        """Squared norm of the whitened data."""
        return float(np.sum(self.y**2))

    @cached_property
    def q(self) -> Array:
        """H^T y."""
        return self._flat(self.operator.correlate(self.y))

    @cached_property
    def slack(self) -> float:
        """Gradient that is rounding."""
        return SLACK * float(np.abs(self.q).max(initial=0.0))

    def apply(self, v: Array) -> Array:
        """Q v."""
        g = self._loads(v)
        return self._back(self.operator.convolve(g), g)

    def gradient(self, v: Array) -> Array:
        """Q v - q, with the residual formed first."""
        g = self._loads(v)
        return self._back(self.operator.convolve(g) - self.y, g)

    def norms(self, v: Array) -> tuple[float, float]:
        """Squared norms of ``y - H v`` and of ``L v``."""
        g = self._loads(v)
        return float(np.sum((self.y - self.operator.convolve(g)) ** 2)), float(np.sum(self.operator.rough(g) ** 2))

    def factor(self, weight: Array | None = None) -> ConvolvedFactor:
        """What solves with ``Q + diag(weight)``; where the weight is infinite, the unknown is held at 0."""
        return ConvolvedFactor(self, np.zeros(self.size) if weight is None else weight)

    @cached_property
    def circulant(self) -> Circulant:
        """Preconditioner of Q."""
        return Circulant(self.operator, self.lam)

    def precondition(self, r: Array) -> Array:
        """Q^-1 r of an unending record."""
        return self._flat(self.circulant.solve(self._loads(r)))

    @cached_property
    def reach(self) -> float:
        """Bound of the largest eigenvalue of Q: that of the lines of an unending record."""
        o = self.operator
        weight = 1.0 if o.weight is None else float(np.max(o.weight**2))
        return weight * float(np.max(np.sum(np.abs(o.spectrum) ** 2, axis=(0, 1)))) + self.lam**2 * 4.0**o.order

    @cached_property
    def diagonal(self) -> Array:
        """Diagonal of Q of an unending record, one number for each load, for every unknown."""
        own = np.sum(self.operator.h**2, axis=(0, 2)) + self.lam**2 * np.sum(stencil(self.operator.order) ** 2)
        return np.tile(own, self.operator.samples)

    def _back(self, response: Array, g: Array) -> Array:
        o = self.operator
        return self._flat(o.correlate(response) + self.lam**2 * o.rough_adjoint(o.rough(g)))

    def _loads(self, v: Array) -> Array:
        return np.ascontiguousarray(v.reshape(self.operator.samples, self.operator.loads).T)[None]

    @staticmethod
    def _flat(g: Array) -> Array:
        return np.ascontiguousarray(g[0].T).reshape(-1)


class ConvolvedFactor:
    """Conjugate gradients on ``Q + diag(weight)``.

    The preconditioner is the circulant one between factors ``t = sqrt(c / (c + weight))``, c the diagonal of Q: what is
    held stays 0, and where a weight rules, it is divided by.
    """

    def __init__(self, normal: ConvolvedNormal, weight: Array) -> None:
        self.normal = normal
        self.t = np.sqrt(normal.diagonal / (normal.diagonal + weight))
        self.weight = np.where(np.isinf(weight), 0.0, weight)
        self.open = np.isfinite(weight)

    def solve(self, r: Array) -> Array:
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

    def _precondition(self, r: Array) -> Array:
        return self.t * self.normal.precondition(self.t * r)


# -- active set, interior point and projected gradient over a normal operator ------------------------------------------
Mask = NDArray[np.bool_]

REFINEMENTS = 2


def violation(gradient: Array, signed: Mask) -> Array:
    """What the gradient lacks to be that of a minimum: it is >= 0 where a load may only push, 0 elsewhere."""
    return np.where(signed, np.maximum(-gradient, 0.0), -gradient)


def gap(normal: RecordNormal, free: NormalFactor, v: Array, gradient: Array, signed: Mask) -> float:
    """Objective at v (>= 0 where signed) minus a lower bound of its minimum, over ``|y|^2 / 2``.

    The dual of ``min v^T Q v / 2 - q^T v + |y|^2 / 2, v >= 0`` (Wolfe) is to maximise ``|y|^2 / 2 - u^T Q u / 2`` over
    all u with ``Q u - q >= 0``. With ``d`` the violation at v, ``u = v + Q^-1 d`` is such a point, its gradient
    ``s = Q u - q`` is that of v without its negative part, and the difference of the two objectives is
    ``v^T s + (u - v)^T Q (u - v) / 2``: no large numbers are subtracted.

    Parameters
    ----------
    normal : RecordNormal
    free : NormalFactor
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


CAP = 60  # steps
PATIENCE = 6  # steps without fewer unknowns on the wrong side
FEW = 10  # unknowns on the wrong side that are worth every patience


@dataclass(frozen=True, eq=False)
class Exchanged:
    """Where the exchange stands: unknowns, gradient, held unknowns, whether none is on the wrong side, steps."""

    v: Array
    gradient: Array
    held: Mask
    settled: bool
    steps: int


def exchange(
    normal: NormalOperator, lower: Array, upper: Array | None, low: Mask, high: Mask | None = None, *,
    step: Callable[[], None] = lambda: None, pace: float | None = None, patience: int = PATIENCE, eager: float = 0.0,
    cap: int = CAP,
) -> Exchanged:  # fmt: skip
    """From a guess of what is held to the minimum: unknowns beyond a bound are held, held ones pulled inside are freed.

    Primal-dual active set; Hintermüller, Ito & Kunisch, SIAM J. Optim. 13 (2002) 865; with two bounds Kunisch & Rendl,
    SIAM J. Optim. 14 (2003) 35. It ends after a finite number of steps or cycles, and gives up where the unknowns on
    the wrong side stop becoming fewer.

    Parameters
    ----------
    normal : NormalOperator
    lower, upper : array, shape (size,)
        Bounds, infinite where there is none; no upper ones where None.
    low, high : array of bool, shape (size,)
        Unknowns that are held at a bound to begin with.
    step : callable, optional
        Called before each step.
    pace : float, optional
        Gives up as well where unknowns on the wrong side fall more slowly than by this factor for each step.
    patience : int
    eager : float
        Held unknowns that are pulled less than this share of the most pulled one wait: many need not move at all.
    cap : int
        Most steps.

    Raises
    ------
    LinAlgError
        A face on which the normal operator is singular.
    """
    slack, fewest, since, steps, allowed = normal.slack, len(low) + 1, 0, 0, np.inf
    while True:
        step()
        steps += 1
        held = low if high is None else low | high
        fixed = np.where(low, lower, 0.0)
        if high is not None and upper is not None:
            fixed[high] = upper[high]
        v, gradient = on_face(normal, held, fixed)
        wrong_low = np.where(low, gradient < -slack, ~held & (v < lower))
        wrong = wrong_low if high is None or upper is None else (
            wrong_low | np.where(high, gradient > slack, ~held & (v > upper)))  # fmt: skip
        count = int(np.count_nonzero(wrong))
        if pace is not None:
            allowed = max(FEW, count if steps == 1 else pace * allowed)
        if count < fewest:
            fewest, since = count, 0
        since += 1
        if count == 0 or count > allowed or steps >= cap or since > patience:
            return Exchanged(v, gradient, held, count == 0, steps)
        if eager and np.any(wrong & held):
            pulled = np.where(wrong & held, np.abs(gradient) / slack, 0.0)
            wrong &= ~held | (pulled >= eager * pulled.max())
        if high is None or upper is None:
            low = low ^ wrong
        else:
            low, high = (
                np.where(held, low & ~wrong, wrong & (v < lower)),
                np.where(held, high & ~wrong, wrong & (v > upper)),
            )


def on_face(normal: NormalOperator, held: Mask, fixed: Array) -> tuple[Array, Array]:
    """Minimum where the held unknowns are `fixed`, refined, and its gradient."""
    factor, right = normal.factor(np.where(held, np.inf, 0.0)), normal.q
    if np.any(fixed):
        right = right - normal.apply(fixed)
    v = fixed + factor.solve(np.where(held, 0.0, right))
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

    v: Array
    s: Array
    steps: int


def interior(
    normal: RecordNormal, signed: Mask, start: Array, step: Callable[[], None], *, cap: int = INTERIOR_CAP
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


def _reach(v: Array, dv: Array, signed: Mask) -> float:
    """Largest step, at most 1 / NEAR, that keeps v positive where signed."""
    falling = signed & (dv < 0)
    return float(min(1 / NEAR, np.min(-v[falling] / dv[falling], initial=np.inf)))


REPORT = 100  # steps between two reports


def projected(normal: RecordNormal, signed: Mask, start: Array, steps: int, report: Callable[[], None]) -> Array:
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
