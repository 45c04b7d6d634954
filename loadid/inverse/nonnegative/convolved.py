"""Normal equations of a record behind impulse responses, with weights on its unknowns: FFT products and PCG."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..convolved.circulant import Circulant
from ..convolved.operator import Operator
from ..penalties import stencil

TOLERANCE = 1e-10  # gradient in the norm of the preconditioner, over that at zero
MOST = 3000  # iterations of a solve; what they leave undone is in the gap


class ConvolvedNormal:
    """``Q = H^T H + lambda^2 L^T L`` of impulse responses at one absolute lambda.

    Parameters
    ----------
    operator : Operator
        Whitened impulse responses with their penalty, and weights (0 where data are missing).
    y : array, shape (samples, sensors)
        Whitened and weighted data, 0 where missing.
    lam : float
        Absolute lambda, > 0.
    """

    start = 0
    direct, precision = False, 1e-9

    def __init__(self, operator: Operator, y: NDArray, lam: float) -> None:
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
        return self._flat(self.operator.adjoint(self.y))

    def apply(self, v: NDArray) -> NDArray[np.float64]:
        """Q v."""
        g = self._loads(v)
        return self._back(self.operator.apply(g), g)

    def gradient(self, v: NDArray) -> NDArray[np.float64]:
        """Q v - q, with the residual formed first."""
        g = self._loads(v)
        return self._back(self.operator.apply(g) - self.y, g)

    def norms(self, v: NDArray) -> tuple[float, float]:
        """Squared norms of ``y - H v`` and of ``L v``."""
        g = self._loads(v)
        return float(np.sum((self.y - self.operator.apply(g)) ** 2)), float(np.sum(self.operator.rough(g) ** 2))

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
        return weight * float(np.max(np.sum(np.abs(o.lines) ** 2, axis=(0, 1)))) + self.lam**2 * 4.0**o.order

    @cached_property
    def diagonal(self) -> NDArray[np.float64]:
        """Diagonal of Q of an unending record, one number for each load, for every unknown."""
        own = np.sum(self.operator.h**2, axis=(0, 2)) + self.lam**2 * np.sum(stencil(self.operator.order) ** 2)
        return np.tile(own, self.operator.samples)

    def _back(self, response: NDArray, g: NDArray) -> NDArray[np.float64]:
        o = self.operator
        return self._flat(o.adjoint(response) + self.lam**2 * o.rough_adjoint(o.rough(g)))

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
