"""All numbers of one map against its truth, at the level that they reach; resultants, errors per cell as in FEATS.

Formulas after `feats-ai/feats`, src/feats/src/train/evaluate.py: mean over samples of the error of the summed force,
and of the mean absolute error per cell, of samples with Fz above -40 N. Most cells are empty, so that the error per
cell falls as the contact gets smaller: never compare it across contact areas.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loadid._guards.measurement import resultant_only
from structures._flags import Flag
from structures.errors import InputError, number

from .._arrays import Array
from .._guards import no_map
from . import _measures as measures
from ._measures import finite, pair, places, weights

LABELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
UNITS = ("N", "N", "N", "N m", "N m", "N m")


def resultant(forces: Any, points: ArrayLike, about: ArrayLike | None = None) -> Array:
    """Force and moment (..., 6) of nodal forces: Fx, Fy, Fz, Mx, My, Mz.

    Parameters
    ----------
    forces : array (..., points, 3)
        Nodal forces (N); of tractions, multiply with the areas first.
    points : array (points, 2 or 3)
        Places (m); two columns lie in the plane through `about`.
    about : array (2 or 3,), optional
        Point of the moments (m), default the origin.
    """
    f = _nodal(forces, "metrics.resultant")
    x = places(points, f.shape[-2])
    o = np.zeros(x.shape[1]) if about is None else finite(about, "about")
    if o.shape != (x.shape[1],):
        raise InputError("no point for the moments", where="metrics.resultant, about", found=f"shape {o.shape}",
                         expected=f"({x.shape[1]},)", hint="as many coordinates as the points have")  # fmt: skip
    arm = np.zeros((len(x), 3))
    arm[:, : x.shape[1]] = x - o
    return np.concatenate([f.sum(axis=-2), np.cross(arm, f).sum(axis=-2)], axis=-1)


def _nodal(forces: Any, where: str) -> Array:
    f = finite(forces, "forces")
    if f.ndim < 2 or f.shape[-1] != 3:
        raise InputError("no nodal forces", where=where, found=f"shape {f.shape}", expected="(..., points, 3)",
                         hint="reshape a flat vector with .reshape(-1, 3)")  # fmt: skip
    return f


@dataclass(frozen=True)
class ResultantErrors:
    """Errors of the resultants over frames, per axis.

    Parameters
    ----------
    labels, units : tuple of str
    std, mae, bias : tuple of float
        Of found minus reference over the frames; std about the bias, as papers print it.
    share : tuple of float or None
        Root mean square error over the range of the reference; None where the reference does not move.
    frames : int
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    std: tuple[float, ...]
    mae: tuple[float, ...]
    bias: tuple[float, ...]
    share: tuple[float | None, ...]
    frames: int

    def table(self) -> str:
        """One line for each axis, as text."""
        lines = [f"resultants over {self.frames} frames (level resultant: a map is not validated by them)",
                 f"{'':4s} {'std':>10s} {'MAE':>10s} {'bias':>10s}  {'unit':4s} {'rms, % of range':>16s}"]  # fmt: skip
        for i, label in enumerate(self.labels):
            share = self.share[i]
            shown = "-" if share is None else f"{100 * share:.2f}"
            lines.append(f"{label:4s} {self.std[i]:10.4g} {self.mae[i]:10.4g} {self.bias[i]:10.3g}  {self.units[i]:4s} "
                         f"{shown:>16s}")  # fmt: skip
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.table()


def resultant_errors(found: Any, truth: Any, labels: tuple[str, ...] = LABELS) -> ResultantErrors:
    """Compare resultants over frames.

    Parameters
    ----------
    found, truth : array (frames, R)
        R = 6 (forces in N and moments in N m), 3 (forces), or as many as there are labels.
    labels : tuple of str

    Raises
    ------
    InputError
        Shapes that differ, fewer than two frames, more columns than labels.
    """
    a, b = finite(found, "found"), finite(truth, "truth")
    if a.shape != b.shape or a.ndim != 2 or len(a) < 2 or not 1 <= a.shape[1] <= len(labels):
        raise InputError(
            "resultants over frames do not fit", where="metrics.resultant_errors", found=f"{a.shape} and {b.shape}",
            expected=f"both (frames, {len(labels)}) or fewer columns, at least two frames",
            hint="metrics.resultant(forces, points) gives one row for each frame",
        )  # fmt: skip
    e = a - b
    reach = np.ptp(b, axis=0)
    rms = np.sqrt(np.mean(e**2, axis=0))
    count = a.shape[1]
    known = dict(zip(LABELS, UNITS, strict=True))
    return ResultantErrors(
        tuple(labels[:count]),
        tuple(known.get(label, "") for label in labels[:count]),
        tuple(e.std(axis=0, ddof=1).tolist()),
        tuple(np.abs(e).mean(axis=0).tolist()),
        tuple(e.mean(axis=0).tolist()),
        tuple(float(r / w) if w > 0 else None for r, w in zip(rms, reach, strict=True)),
        len(a),
    )


COMPONENTS = "xyz"


@dataclass(frozen=True)
class MapMetrics:
    """One map against its truth.

    Parameters
    ----------
    kind : {"distribution", "resultant"}
        What was compared. At level "resultant" there are no numbers of a map, and `flags` holds N701.
    error : float or None
        Relative L2 error; ideal 0.
    components : tuple of float
        The same for X, Y, Z, each against its own norm (against the whole one where the truth has none of it).
    cosine, iou, peak_ratio, radius_ratio : float or None
        Ideal 1. Same shape whatever the gain; overlap of the contact areas; largest magnitude; rms radius.
    dtma, dma, dtmb : float or None
        Ideal 0. Magnitude in the patches, largest magnitude there, leakage outside.
    snr : float or None
        Magnitude in the patches over the std outside, sqrt(var_x + var_y + var_z); large is good.
    centroid_error : float or None
        Distance of the centres (m).
    resultant, reference : tuple of float
        Fx, Fy, Fz (N), Mx, My, Mz (N m) of estimate and truth; empty where no places or areas are known.
    theta : float
        Share of the peak from which a point counts as contact, in `iou`.
    patches : int
        Loaded patches of the truth.
    flags : tuple of Flag
    """

    kind: str
    error: float | None = None
    components: tuple[float, ...] = ()
    cosine: float | None = None
    iou: float | None = None
    peak_ratio: float | None = None
    radius_ratio: float | None = None
    dtma: float | None = None
    dma: float | None = None
    dtmb: float | None = None
    snr: float | None = None
    centroid_error: float | None = None
    resultant: tuple[float, ...] = ()
    reference: tuple[float, ...] = ()
    theta: float = measures.THETA
    patches: int = 0
    flags: tuple[Flag, ...] = ()

    @property
    def partial(self) -> bool:
        """Resultants alone were compared: the distribution is open."""
        return self.kind == "resultant"

    def table(self) -> str:
        """One line for each number with its ideal, as text."""
        lines = [f"level: {self.kind}{' (partial)' if self.partial else ''}"]
        for name, value, ideal in self._rows():
            if value is not None:
                lines.append(f"{name:34s} {value:10.4g}   ideal {ideal}")
        for label, unit, a, b in zip(LABELS, UNITS, self.resultant, self.reference, strict=False):
            lines.append(f"{label:34s} {a:10.4g}   truth {b:.4g} {unit}")
        return "\n".join([*lines, *(f"{f.code}: {f.message}" for f in self.flags)])

    def __str__(self) -> str:
        return self.table()

    def to_dict(self) -> dict[str, Any]:
        """Plain texts, numbers and lists."""
        tree = {f.name: getattr(self, f.name) for f in fields(self)}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in tree.items() if k != "flags"} | {
            "flags": [f.to_dict() for f in self.flags]
        }

    def _rows(self) -> list[tuple[str, float | None, str]]:
        millimetres = None if self.centroid_error is None else 1e3 * self.centroid_error
        return [
            ("relative L2 error", self.error, "0"),
            *((f"relative L2 error, {c}", e, "0") for c, e in zip(COMPONENTS, self.components, strict=False)),
            ("cosine", self.cosine, "1"),
            (f"IoU of contact (theta = {self.theta:g})", self.iou, "1"),
            ("peak ratio", self.peak_ratio, "1"),
            ("spread (rms radius)", self.radius_ratio, "1"),
            ("DTMA (magnitude in the patches)", self.dtma, "0"),
            ("DMA (peak in the patches)", self.dma, "0"),
            ("DTMB (leakage outside)", self.dtmb, "0"),
            ("SNR", self.snr, "large"),
            ("centroid error (mm)", millimetres, "0"),
        ]


def compare(
    found: Any,
    truth: Any,
    *,
    areas: ArrayLike | None = None,
    points: ArrayLike | None = None,
    labels: ArrayLike | None = None,
    theta: float = measures.THETA,
    quantity: str = "tractions",
    about: ArrayLike | None = None,
) -> MapMetrics:
    """Hold a map against its truth, at level "distribution".

    Parameters
    ----------
    found, truth : array (points, 3)
        Tractions (Pa), or nodal forces (N) where `quantity` is "forces"; on the same points.
    areas : array (points,), optional
        Tributary areas (m^2): weights of all means and norms. Nodal forces need them: they are divided by them, so that
        a coarse node is no larger pressure.
    points : array (points, 2 or 3), optional
        Places (m): patches, centres, spread and moments need them.
    labels : int array (points,), optional
        Patches of the truth, 0 outside; default `measures.patches`.
    theta : float
        Share of the peak from which a point counts as contact.
    quantity : {"tractions", "forces"}
    about : array, optional
        Point of the moments (m).

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, a truth without load, forces without areas.
    """
    a, b = pair(found, truth)
    if quantity not in ("tractions", "forces") or (quantity == "forces" and areas is None):
        raise InputError(
            "nodal forces need the areas of their nodes" if quantity == "forces" else "unknown quantity",
            where="metrics.compare", found=f"quantity={quantity!r}, areas={'none' if areas is None else 'given'}",
            expected='"tractions", or "forces" with areas=', hint="pass areas=surface.areas",
        )  # fmt: skip
    w = weights(areas, len(a))
    if quantity == "forces":
        a, b = (f / finite(areas, "areas")[:, None] for f in (a, b))
    own = measures.patches(b, points) if labels is None else labels
    totals: list[tuple[float, ...]] = [(), ()]
    if areas is not None and points is not None and a.shape[1] == 3:
        share = finite(areas, "areas")[:, None]
        totals = [tuple(resultant(t * share, points, about).tolist()) for t in (a, b)]
    return MapMetrics(
        kind="distribution",
        error=measures.relative_error(a, b, w),
        components=tuple(measures.relative_error(a, b, w, i) for i in range(a.shape[1])),
        cosine=measures.cosine(a, b, w),
        iou=measures.iou(a, b, w, theta=theta),
        peak_ratio=measures.peak_ratio(a, b),
        radius_ratio=None if points is None else measures.spread(a, b, points, w),
        dtma=measures.dtma(a, b, own, w),
        dma=measures.dma(a, b, own),
        dtmb=measures.dtmb(a, b, own, w),
        snr=measures.snr(a, b, own, w),
        centroid_error=None if points is None else measures.centroid_error(a, b, points, w),
        resultant=totals[0],
        reference=totals[1],
        theta=theta,
        patches=len(set(finite(own, "labels").tolist()) - {0.0}),
    )


def compare_resultants(found: Any, truth: Any, *, loads: int = 10**9) -> MapMetrics:
    """Hold the resultant of a map against a force sensor: level "resultant", which validates no map (N701, N610).

    Parameters
    ----------
    found, truth : array (R,)
        Fx, Fy, Fz (N), and Mx, My, Mz (N m).
    loads : int
        Unknowns of the map; 0 of a method that gives resultants and no map (N610).

    Raises
    ------
    InputError
        Shapes that differ, NaN, more than six numbers.
    """
    a, b = finite(found, "found"), finite(truth, "truth")
    if a.shape != b.shape or a.ndim != 1 or not 1 <= len(a) <= len(LABELS):
        raise InputError("resultants do not fit", where="metrics.compare_resultants", found=f"{a.shape} and {b.shape}",
                         expected="both (6,), or fewer", hint="Fx, Fy, Fz, Mx, My, Mz")  # fmt: skip
    flag = resultant_only({"resultant"}, len(a), loads) if loads else no_map(len(a))
    return MapMetrics("resultant", resultant=tuple(a.tolist()), reference=tuple(b.tolist()),
                      flags=() if flag is None else (flag,))  # fmt: skip


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
    f = _nodal(forces, "metrics.to_cells")
    x = places(points, f.shape[-2])[:, :2]
    half = np.array(size, float) / 2
    out = np.abs(x) > half * (1 + 1e-9)
    if out.any():
        raise InputError(
            f"{int(out.any(axis=1).sum())} nodes lie outside the grid", where="metrics.to_cells",
            found=f"points to {np.abs(x).max(axis=0)} m from the centre", expected=f"at most {half} m",
            hint="give the size of the whole pad",
        )  # fmt: skip
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
