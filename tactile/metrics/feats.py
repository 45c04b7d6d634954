"""Errors per axis and per cell of a coarse grid, in the style of the FEATS data set (24 x 32 cells).

Formulas after `feats-ai/feats`, src/feats/src/train/evaluate.py: mean over samples of the error of the summed force,
and of the mean absolute error per cell, of samples with Fz above -40 N. Most cells are empty, so that the error per
cell falls as the contact gets smaller: never compare it across contact areas.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError
from structures.values import number

from .settled import Array, finite, places

SHAPE = (24, 32)
LOWEST = -40.0  # N: samples pressed harder are left out, as FEATS does


@dataclass(frozen=True)
class CellErrors:
    """Errors per axis and per cell, each as mean and std over the samples.

    Parameters
    ----------
    total, total_std : tuple of float
        Absolute error of the summed force along X, Y, Z (N).
    cell, cell_std : tuple of float
        Mean absolute error per cell along X, Y, Z (N).
    samples, left_out : int
        Samples used, and samples beyond the limit of Fz.
    shape : (rows, columns)
        Cells of the grid.
    """

    total: tuple[float, ...]
    total_std: tuple[float, ...]
    cell: tuple[float, ...]
    cell_std: tuple[float, ...]
    samples: int
    left_out: int
    shape: tuple[int, int]

    def table(self) -> str:
        """One line for each axis, as text."""
        lines = [f"{self.samples} samples, {self.left_out} left out, grid {self.shape[0]} x {self.shape[1]}",
                 "axis  |sum of cells - label| (N)     mean |error| per cell (N)"]  # fmt: skip
        for i, axis in enumerate("xyz"):
            lines.append(f"{axis:4s}  {self.total[i]:.4g} +- {self.total_std[i]:.3g}".ljust(36)
                         + f"{self.cell[i]:.4g} +- {self.cell_std[i]:.3g}")  # fmt: skip
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.table()


def to_cells(forces: Any, points: ArrayLike, size: tuple[float, float], shape: tuple[int, int] = SHAPE) -> Array:
    """Nodal forces summed into the cells of a grid, (..., rows, columns, 3).

    Parameters
    ----------
    forces : array (..., points, 3)
        Nodal forces (N). Each goes to the cell in which its node lies, so the resultant stays.
    points : array (points, 2 or 3)
        Places (m) about the centre of the grid; rows run along Y, columns along X.
    size : (width, height)
        Sides of the grid along X and Y (m).
    shape : (rows, columns)

    Raises
    ------
    InputError
        A node outside the grid.
    """
    f = finite(forces, "forces")
    if f.ndim < 2 or f.shape[-1] != 3:
        raise InputError("no nodal forces", where="metrics.to_cells", found=f"shape {f.shape}",
                         expected="(..., points, 3)", hint="reshape a flat vector with .reshape(-1, 3)")  # fmt: skip
    x = places(points, f.shape[-2])[:, :2]
    half = np.array(size, float) / 2
    out = np.abs(x) > half * (1 + 1e-9)
    if out.any():
        raise InputError(
            f"{int(out.any(axis=1).sum())} nodes lie outside the grid",
            where="metrics.to_cells",
            found=f"points to {np.abs(x).max(axis=0)} m from the centre",
            expected=f"at most {half} m",
            hint="give the size of the whole pad",
        )
    ny, nx = shape
    column = np.clip(((x[:, 0] + half[0]) / (2 * half[0]) * nx).astype(int), 0, nx - 1)
    row = np.clip(((x[:, 1] + half[1]) / (2 * half[1]) * ny).astype(int), 0, ny - 1)
    cells = np.zeros((*f.shape[:-2], ny * nx, 3))
    np.add.at(np.moveaxis(cells, -2, 0), row * nx + column, np.moveaxis(f, -2, 0))
    return cells.reshape(*f.shape[:-2], ny, nx, 3)


def cell_errors(found: Any, truth: Any, labels: Any = None, *, lowest: float = LOWEST) -> CellErrors:
    """Errors per axis and per cell over samples.

    Parameters
    ----------
    found, truth : array (samples, rows, columns, 3)
        Force per cell (N).
    labels : array (samples, 3), optional
        Forces of a force sensor (N); default the sums of the truth.
    lowest : float
        Samples whose label Fz is not above this (N) are left out.

    Raises
    ------
    InputError
        Shapes that do not fit, or no sample left.
    """
    a, b = finite(found, "found"), finite(truth, "truth")
    if a.shape != b.shape or a.ndim != 4 or a.shape[-1] != 3:
        raise InputError("grids of forces do not fit", where="metrics.cell_errors", found=f"{a.shape} and {b.shape}",
                         expected="both (samples, rows, columns, 3)", hint="metrics.to_cells(...)")  # fmt: skip
    known = b.sum(axis=(1, 2)) if labels is None else finite(labels, "labels")
    if known.shape != (len(a), 3):
        raise InputError("labels do not fit", where="metrics.cell_errors, labels", found=f"shape {known.shape}",
                         expected=f"({len(a)}, 3)", hint="Fx, Fy, Fz of every sample")  # fmt: skip
    kept = known[:, 2] > number("lowest", lowest, where="metrics.cell_errors", unit="N")
    if not kept.any():
        raise InputError(
            "no sample is left", where="metrics.cell_errors", found=f"all Fz <= {lowest:g} N",
            expected=f"samples with Fz > {lowest:g} N", hint="pressing is negative Fz; or set lowest=",
        )  # fmt: skip
    total = np.abs(a.sum(axis=(1, 2)) - known)[kept]
    cell = np.abs(a - b).mean(axis=(1, 2))[kept]
    return CellErrors(
        tuple(total.mean(axis=0).tolist()), tuple(total.std(axis=0).tolist()),
        tuple(cell.mean(axis=0).tolist()), tuple(cell.std(axis=0).tolist()),
        int(kept.sum()), int((~kept).sum()), (a.shape[1], a.shape[2]),
    )  # fmt: skip
