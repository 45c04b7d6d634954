"""The compliant surface of the lab: x in [0, 1] in cells, a load on them, and what markers on it read.

The kernel ``H_ij = (h / pi) t / (t^2 + (x_i - x_j)^2)`` stands for a bonded layer of thickness t: its half-width is t.
The readings are those of the same cells that are estimated, so that exact data give the load back exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._inverse.constrained.path import ConstrainedPath
from .._inverse.penalties import difference
from .._inverse.problem import LinearProblem
from .._inverse.sparse.atoms import DenseAtoms
from .._inverse.sparse.path import SparsePath
from .._inverse.svd import SVDPath
from ..constraints import NonNegative, Resultant, Support

CELLS = 48
WIDE = 0.03  # std of a fingertip
ROUNDING = 1e-12
CONTACT = 0.1  # share of the peak above which a cell is in contact
Array = NDArray[np.float64]

x: Array = (np.arange(CELLS) + 0.5) / CELLS


def fingertips(spacing: float) -> Array:
    """Two Gaussians about the middle, (cells,)."""
    return np.asarray(sum(np.exp(-(((x - c) / WIDE) ** 2) / 2) for c in (0.5 - spacing / 2, 0.5 + spacing / 2)))


PROFILES: dict[str, Callable[[float], Array]] = {
    "fingertips": fingertips,
    "hertz": lambda spacing: np.sqrt(np.maximum(1 - ((x - 0.5) / 0.12) ** 2, 0.0)),
    "punch": lambda spacing: np.where(np.abs(x - 0.5) < 0.12, 1.0, 0.0),
    "gaussian": lambda spacing: np.exp(-(((x - 0.5) / 0.08) ** 2) / 2),
    "point": lambda spacing: np.where(np.arange(CELLS) == CELLS // 2, 1.0, 0.0),
}
ORDERS = {"identity": 0, "gradient": 1, "laplacian": 2}

PENALTY = {"gradient": "gradient", "laplacian": "laplacian"}
METHODS = ("naive", "identity", "gradient", "laplacian", "tsvd", "nonnegative", "support", "resultant", "l1")


@dataclass(frozen=True)
class PressedLayer:
    """A layer, its load and its markers.

    Parameters
    ----------
    t : float
        Thickness, in lengths of the surface.
    spacing : float
        Between the fingertips.
    profile : str
        One of `PROFILES`.
    every : int
        A marker on every so manieth cell.
    occluded : bool
        No marker from the first to the last cell in contact.
    """

    t: float
    spacing: float = 0.25
    profile: str = "fingertips"
    every: int = 1
    occluded: bool = False

    @property
    def load(self) -> Array:
        """Pressure on the cells, (cells,)."""
        return PROFILES[self.profile](self.spacing)

    @property
    def contact(self) -> NDArray[np.int64]:
        """Cells from the first to the last that bears more than `CONTACT` of the peak."""
        bearing = np.flatnonzero(self.load > CONTACT * self.load.max())
        return np.arange(bearing[0], bearing[-1] + 1)

    @property
    def markers(self) -> NDArray[np.int64]:
        """Cells that carry a marker that is seen."""
        all_of = np.arange(0, CELLS, self.every)
        return np.setdiff1d(all_of, self.contact) if self.occluded else all_of

    def sigma(self, eta: float) -> float:
        """Std of noise that is a share `eta` of the largest reading of all cells; none where it would be rounding."""
        return eta * float(np.max(kernel(self.t) @ self.load)) if eta > ROUNDING else 0.0

    def readings(self, sigma: float, seed: int) -> Array:
        """What the markers read, (markers,); all layouts of a surface share the noise of their cells."""
        noise = np.random.default_rng(seed).standard_normal(CELLS)
        return (kernel(self.t) @ self.load + sigma * noise)[self.markers]

    def path(self, data: Array, penalty: str = "identity", *, truncated: bool = False) -> SVDPath:
        """Every lambda of some readings, (markers,) or (markers, draws), after one factorisation of the operator."""
        return _factored(self.t, tuple(self.markers.tolist()), penalty, truncated).with_data(data)

    def errors(self, load: Array) -> tuple[Array, Array]:
        """Of a load (..., cells): that of its resultant over the true one, and the rms one of the map over the peak."""
        true = self.load
        resultant = np.abs(load.sum(axis=-1) - true.sum()) / true.sum()
        return np.asarray(resultant), np.asarray(np.sqrt(np.mean((load - true) ** 2, axis=-1)) / true.max())


def solved(
    surface: PressedLayer, path: SVDPath, y: Array, method: str, lam: float, sigma: float
) -> tuple[Array, Array | None, float | None]:
    """Load (cells,), its std where there is noise, and the effective degrees of freedom."""
    if method == "l1":
        found = SparsePath(DenseAtoms(kernel(surface.t)[surface.markers]), y).solve(lam)
        return found.x, None, float(np.count_nonzero(found.x))
    known: dict[str, list[Any]] = {
        "nonnegative": [NonNegative()],
        "support": [NonNegative(), Support(surface.contact)],
        "resultant": [Resultant(np.ones((1, CELLS)), [surface.load.sum()], labels=("F",))],
    }
    constraints = known.get(method)
    relative = 0.0 if method == "naive" else lam / float(path.scale)
    walked = path if constraints is None else ConstrainedPath(path, constraints, sigma=sigma or 1.0)
    solution = walked.solution(relative, sigma or None)
    edf = walked.at(relative).edf
    return (
        np.asarray(solution.load), None if solution.posterior is None else np.asarray(solution.posterior.std),
        None if edf is None else float(edf),
    )  # fmt: skip


@lru_cache(64)
def kernel(t: float) -> Array:
    """Response of all cells to a unit of each, (cells, cells)."""
    found: Array = t / (t**2 + (x[:, None] - x) ** 2) / (np.pi * CELLS)
    found.flags.writeable = False
    return found


@lru_cache(64)
def _factored(t: float, markers: tuple[int, ...], penalty: str, truncated: bool) -> SVDPath:
    H, order = kernel(t)[list(markers)], ORDERS[penalty]
    L = difference(CELLS, order) if order else None
    return SVDPath(LinearProblem.whitened(H, np.zeros(len(H)), L=L), truncated=truncated)
