"""Problems over a feasible set by clarabel: cones, equalities, cold starts; and a proof that a set is empty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import NotIdentifiable

from .feasible import Feasible

Array = NDArray[np.float64]


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


def minimum(P: Array, c: Array, s: Feasible, w: Array, size: float, tol: float = 1e-11) -> ConicAnswer:
    """Min 1/2 x^T P x + c^T x over the set, unknowns h = size * w * x."""
    import clarabel
    import scipy.sparse as sp

    matrix, value, kinds = _standard_form(s)
    A = sp.csc_matrix(matrix @ sp.diags(w))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tol
    solver = clarabel.DefaultSolver(sp.csc_matrix(np.triu(P)), c, A, value / size, kinds, settings)
    found = solver.solve()
    return ConicAnswer(str(found.status).rsplit(".", 1)[-1], np.asarray(found.x), np.asarray(found.z))


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
    found = minimum(np.eye(n), np.zeros(n), feasible, np.ones(n), size, tol=1e-8)
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
