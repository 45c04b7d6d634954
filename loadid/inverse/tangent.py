"""What a small change of the data does to a constrained estimate: degrees of freedom, sensitivity, posterior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .face import Face
from .faceposterior import FacePosterior, FramesPosterior
from .feasible import Feasible
from .posterior import Posterior

if TYPE_CHECKING:
    from .activeset import Point
    from .solver import ConstrainedSolver


@dataclass(frozen=True, eq=False)
class Tangent:
    """Directions in which the estimate may move, as a factor of its inverse Hessian.

    Parameters
    ----------
    loads : array, shape (n, d)
        ``loads @ loads.T`` is the inverse of the Hessian of half the objective on the face, curvature included.
    data : array, shape (rows, d)
        The same directions in the whitened response: ``data.T @ data`` is the share that comes from the data.
    other : array, shape (rows, d)
        Their complement, from the penalty and the curvature of the cones: the two together are orthonormal.
    sensitivity : float
        Norm of lambda dg/dlambda.
    """

    loads: NDArray[np.float64]
    data: NDArray[np.float64]
    other: NDArray[np.float64]
    sensitivity: float

    @classmethod
    def of(cls, solver: ConstrainedSolver, y: NDArray, p: Point, s: Feasible) -> Tangent:
        """At the solution of one vector of data."""
        q = solver.quadratic
        push = (q.A @ p.h - solver.compress(y)[0]) @ q.A + p.nu @ s.equal.matrix + p.kappa @ s.below.matrix
        face = Face.near(s, p.h - q.tau * push)
        S = q.shrink(face, np.vstack([s.equal.matrix, s.below.matrix[p.kappa > 0]]))
        image = q.A @ S
        prior, bend = solver.prior[:, None] * image, face.curvature(q.tau)
        curved = np.sqrt(bend[bend > 0])[:, None] * face.turn(S)[bend > 0]
        moved = S @ (prior.T @ (solver.prior * (q.A @ p.h)))
        return cls(
            s.to_global(S), solver.seen[:, None] * image, np.vstack([prior, curved]), 2 * float(np.linalg.norm(moved))
        )

    @property
    def edf(self) -> float:
        """Divergence of the predicted response by the data."""
        return float(np.sum(self.data**2))

    @property
    def edf2(self) -> float:
        """Trace of the square of that derivative."""
        seen = self.data[np.any(self.data, axis=1)]  # modes that meet no data have no rows
        seen = seen if len(seen) <= seen.shape[1] else seen.T
        return float(np.sum((seen @ seen.T) ** 2))

    def rest(self, m: int) -> tuple[float, float, float]:
        """What is left, m - edf, tr (I - A)^2 and tr (I - A)^4 of the derivative A, from the complement."""
        other = self.other
        E = np.einsum("ki,kj->ij", other, other, optimize=True)
        beyond = m - E.shape[0]
        return beyond + float(np.trace(E)), beyond + float(np.sum(E**2)), beyond + float(np.sum((E @ E) ** 2))


def posterior(faces: Sequence[Tangent], sigma: float, shape: tuple[int, ...], frames: int | None) -> Posterior:
    """Gaussian posterior on the active faces, in modes that split the share of the noise from that of the prior."""
    each = []
    for t in faces:
        _, s, Vt = np.linalg.svd(t.data, full_matrices=False)
        passed = np.zeros(t.loads.shape[1])
        passed[: len(s)] = np.minimum(s**2, 1.0)
        each.append(FacePosterior(sigma * t.loads @ Vt.T, shape, passed=passed))
    return each[0] if frames is None else FramesPosterior(each)
