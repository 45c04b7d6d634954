"""The frozen inverse of a pad: one product per frame, exact when markers are lost, fused with a force/torque sensor.

With C the posterior covariance, H the whitened transfer matrix and G = C H^T, leaving rows M out gives the load
``G y`` with ``y_M = (I - A_MM)^-1 A_MO y_O`` and ``A = H G`` (what the others predict there), and the covariance
``C + G_M (I - A_MM)^-1 G_M^T``: the Woodbury identity, no matrix of the size of the map is factored again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from structures.errors import InputError

from .reading import Wrench

if TYPE_CHECKING:
    from loadid.families.static import StaticInversion

Array = NDArray[np.float64]
LARGE = 4_000_000  # entries from which the products run in single precision: 1e-6 of the load, half the memory traffic


@dataclass(frozen=True, eq=False)
class Answer:
    """Load (n,), its std (n,), covariance of its resultant (6, 6), and of the load with it (n, 6)."""

    load: Array
    std: Array
    wrench: Array
    reach: Array


@dataclass(frozen=True, eq=False)
class Inverse:
    """Regularised inverse at one lambda, in whitened readings.

    Parameters
    ----------
    matrix : array (n, m)
        G: loads per whitened reading; single precision where it is large.
    influence : array (m, m)
        A = H G: what is predicted at a reading per unit of another.
    spread : array (m,)
        Std of each reading: what whitens it.
    std : array (n,)
        Posterior std of the loads.
    resultant : array (6, n)
        Force and moment of unit loads.
    reach : array (n, 6)
        C R^T: covariance of the loads with their resultant.
    loss : array (6, n)
        ``R (G H - I)``: what regularisation takes from the resultant of a load.
    lam, scale : float
        Relative lambda and what makes it absolute.
    rule : str
        Who chose it.
    """

    matrix: NDArray
    influence: Array
    spread: Array
    std: Array
    resultant: Array
    reach: Array
    loss: Array
    lam: float
    scale: float
    rule: str

    @property
    def shape(self) -> tuple[int, int]:
        """Loads and readings."""
        return self.matrix.shape

    def __call__(self, y: Array, wrench: Wrench | None = None) -> Answer:
        """Load of readings (m,) in their own units; NaN where one is lost.

        Raises
        ------
        InputError
            If no reading is left.
        """
        z, lost = self.filled(y)
        plain = Answer(self._times(z), self.std, self.resultant @ self.reach, self.reach) if lost.size == 0 else None
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

    def filled(self, y: Array) -> tuple[Array, NDArray[np.intp]]:
        """Whitened readings with the lost ones as the others predict them, and which those are."""
        z = y / self.spread
        lost = np.flatnonzero(~np.isfinite(z))
        if lost.size == len(z):
            raise InputError("no reading is left in this frame", where="frame", found="all markers lost",
                             expected="at least three markers", hint="look at the image")  # fmt: skip
        if lost.size:
            z = np.where(np.isfinite(z), z, 0.0)
            z[lost] = cho_solve(self._left(lost), self.influence[lost] @ z)
        return z, lost

    def _left(self, lost: NDArray[np.intp]) -> Any:
        """Cholesky factor of I - A_MM."""
        left = np.eye(lost.size) - self.influence[np.ix_(lost, lost)]
        try:
            return cho_factor((left + left.T) / 2)
        except LinAlgError:
            raise InputError(
                "too few readings are left for this lambda", where="frame",
                found=f"{lost.size} of {len(self.spread)} lost", expected="readings that determine the map",
                hint="a larger lambda, or a look at the image: light, focus, occlusion",
            ) from None  # fmt: skip

    def _widened(self, z: Array, lost: NDArray[np.intp]) -> Answer:
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


def _gain(S: Array, P: Array) -> Array:
    """P S^-1, scaled so that forces and moments do not drown each other."""
    size = np.sqrt(np.diag(S))
    size = np.where(size > 0, size, 1.0)
    return np.linalg.lstsq(S / size[:, None] / size, (P / size).T, rcond=1e-12)[0].T / size


def prepare(family: StaticInversion, resultant: Array, lam: float, rule: str = "given") -> Inverse:
    """Inverse of a static family at relative `lam`; its constraints are left to others.

    Parameters
    ----------
    family : StaticInversion
        Its noise is known.
    resultant : array (6, n)
    """
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
        spread=spread,
        std=np.asarray(known.std, float),
        resultant=resultant,
        reach=factor @ (factor.T @ resultant.T),
        loss=(resultant @ matrix) @ whitened - resultant,
        lam=float(lam),
        scale=float(base.scale),
        rule=rule,
    )
