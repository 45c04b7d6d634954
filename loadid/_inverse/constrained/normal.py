"""Normal operators ``Q = H^T H + lambda^2 L^T L`` and what solves with them: dense, and behind impulse responses.

That of a record over a state space is in `condensed`. An active set asks nothing else of a problem.
"""

from __future__ import annotations

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

    precision = 1.0

    def __init__(self, quadratic: Quadratic, b: Array) -> None:
        self.G, self.size, self.q = quadratic.G, quadratic.n, b @ quadratic.A
        self.slack = 0.1 * SLACK * float(np.linalg.norm(b)) / np.sqrt(quadratic.tau)

    def apply(self, v: Array) -> Array:
        """G v."""
        return self.G @ v

    def gradient(self, v: Array) -> Array:
        """G v - q."""
        return np.asarray(self.G @ v - self.q)

    def factor(self, weight: Array | None = None) -> CholeskyFactor:
        """Factors of ``G + diag(weight)``; where the weight is infinite, the unknown is held at 0."""
        return CholeskyFactor(self.G, np.zeros(self.size) if weight is None else weight)


class CholeskyFactor:
    """Cholesky factor of the rows and columns whose weight is finite; LinAlgError where they are not definite."""

    def __init__(self, G: Array, weight: Array) -> None:
        from scipy.linalg import lapack

        self.free = np.flatnonzero(np.isfinite(weight))
        M = G.take(self.free, axis=0).take(self.free, axis=1).T  # symmetric: the transpose is in the order of LAPACK
        if np.any(weight[self.free]):
            M[np.arange(len(M)), np.arange(len(M))] += weight[self.free]
        if len(M):
            M, info = lapack.dpotrf(M, overwrite_a=1, clean=0)
            if info:
                raise np.linalg.LinAlgError("not positive definite")
        self.lower = M

    def solve(self, r: Array) -> Array:
        """Solution (size,), 0 where held."""
        from scipy.linalg import lapack

        out = np.zeros(len(r))
        if len(self.free):
            out[self.free] = lapack.dpotrs(self.lower, r[self.free])[0]
        return out


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
