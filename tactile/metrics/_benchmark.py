"""Several sensors on the same presses and the same noise: accuracy, fidelity, and the slope of the error with noise."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError

from .._arrays import Array
from .._results.forcemap import ForceMap
from ._mapped import MapMetrics, compare
from ._measures import field, finite, means, places

if TYPE_CHECKING:
    from matplotlib.figure import Figure


LEVELS, DRAWS = 4, 10


@dataclass(frozen=True)
class NoiseSlope:
    """Straight line through relative error against marker noise.

    Parameters
    ----------
    slope, std : float
        Relative error per metre of marker noise, and its std from the scatter of the draws.
    intercept : float
        Error of the line at zero noise: what the model, the mesh and the prior cost. Regularised maps bend here.
    misfit : float
        Largest distance of a level's mean from the line, as share of the range of errors: beyond some 0.1 the relation
        is no line, and the slope holds for these levels only.
    levels : tuple of float
        Marker noise std (m).
    errors : tuple of float
        Mean relative error at each level.
    draws : int
        Of each level.
    """

    slope: float
    std: float
    intercept: float
    misfit: float
    levels: tuple[float, ...]
    errors: tuple[float, ...]
    draws: int

    def __str__(self) -> str:
        return (
            f"{1e-6 * self.slope:.4g} +- {1e-6 * self.std:.2g} per um of marker noise, {self.intercept:.3g} at none "
            f"({len(self.levels)} levels from {1e6 * min(self.levels):.3g} to {1e6 * max(self.levels):.3g} um, "
            f"{self.draws} draws each)"
        )


def noise_slope(levels: Any, errors: Any) -> NoiseSlope:
    """Fit relative error against marker noise.

    Parameters
    ----------
    levels : array (L,)
        Marker noise std (m); at least four different ones.
    errors : array (L, draws)
        Relative error of the map in each draw; at least ten draws.

    Raises
    ------
    InputError
        Too few levels or draws, or shapes that do not fit.
    """
    x, e = finite(levels, "levels"), finite(errors, "errors")
    if x.ndim != 1 or e.ndim != 2 or len(e) != len(x) or len(np.unique(x)) < LEVELS or e.shape[1] < DRAWS:
        raise InputError(
            "too little for a slope of error against noise",
            where="metrics.noise_slope",
            found=f"{len(np.unique(x))} levels, errors of shape {e.shape}",
            expected=f"at least {LEVELS} different levels, errors (levels, draws) of at least {DRAWS} draws",
            hint="for example noise of 2, 5, 10 and 20 um, ten draws each",
        )
    mean = e.mean(axis=1)
    away = x - x.mean()
    weight = away / np.sum(away**2)
    slope = float(weight @ mean)
    intercept = float(mean.mean() - slope * x.mean())
    reach = float(np.ptp(mean))
    off = float(np.abs(mean - intercept - slope * x).max())
    return NoiseSlope(
        slope,
        float(np.sqrt(weight**2 @ (e.var(axis=1, ddof=1) / e.shape[1]))),
        intercept,
        off / reach if reach > 0 else 0.0,
        tuple(x.tolist()),
        tuple(mean.tolist()),
        e.shape[1],
    )


Sensor = Callable[[Array], Any]
NOISE = (2e-6, 5e-6, 10e-6, 20e-6)
FIDELITY = ("cosine", "IoU", "peak", "spread", "DTMA", "DTMB", "SNR")
WIDTHS = (7, 6, 6, 6, 7, 7, 7)


@dataclass(frozen=True, eq=False)
class Case:
    """One press: what the markers do without noise, and the load that did it.

    Parameters
    ----------
    displacements : array (N, 3)
        Of the points at which the sensor reads (m), from a model that is not the sensor's own.
    tractions : array (P, 3)
        True tractions (Pa) at the points of the map.
    name : str
    """

    displacements: Array
    tractions: Array
    name: str = ""


@dataclass(frozen=True)
class BenchmarkRow:
    """One sensor at one noise level: medians over presses and draws.

    Parameters
    ----------
    sensor : str
    noise : float
        Std of the marker noise, each component (m).
    force, force_z : float
        Norm of the error of the resultant force, and the error of Fz, over the norm of the true force.
    metrics : MapMetrics
        Medians of its numbers.
    worst : float
        Largest relative L2 error of all presses and draws.
    """

    sensor: str
    noise: float
    force: float
    force_z: float
    metrics: MapMetrics
    worst: float


@dataclass(frozen=True)
class BenchmarkTable:
    """Sensors side by side.

    Parameters
    ----------
    rows : tuple of BenchmarkRow
    slopes : mapping of sensor to NoiseSlope or None
        Of the relative error, mean over the presses; None below four levels of noise or ten draws.
    presses, draws : int
    """

    rows: tuple[BenchmarkRow, ...]
    slopes: Mapping[str, NoiseSlope | None]
    presses: int
    draws: int

    def __getitem__(self, key: tuple[str, float]) -> BenchmarkRow:
        """Row of a sensor and a noise level."""
        for row in self.rows:
            if row.sensor == key[0] and np.isclose(row.noise, key[1], rtol=1e-9, atol=0):
                return row
        raise KeyError(key)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names, in order."""
        return tuple(dict.fromkeys(row.sensor for row in self.rows))

    def table(self) -> str:
        """Accuracy, fidelity and noise resistance of every sensor at every level of noise, as text."""
        wide = max(len("sensor"), *(len(name) for name in self.sensors))
        head = f"{'sensor':{wide}s} {'noise um':>8s} | {'force %':>8s} {'Fz %':>7s} {'rel. L2':>8s} {'worst':>7s} | "
        head += " ".join(f"{n:>{w}s}" for n, w in zip(FIDELITY, WIDTHS, strict=True))
        lines = [f"{self.presses} presses, {self.draws} draws of noise each, medians; accuracy | fidelity", head]
        for r in self.rows:
            m = r.metrics
            fidelity = (m.cosine, m.iou, m.peak_ratio, m.radius_ratio, m.dtma, m.dtmb, m.snr)
            lines.append(
                f"{r.sensor:{wide}s} {1e6 * r.noise:8.3g} | {100 * r.force:8.3g} {100 * r.force_z:+7.2f} "
                f"{_shown(m.error)} {r.worst:7.3f} | "
                + " ".join(_shown(x, w) for x, w in zip(fidelity, WIDTHS, strict=True))
            )
        lines.append("noise resistance: slope of the relative error")
        lines += [f"{name:{wide}s} {self.slopes[name] or 'too few levels or draws'}" for name in self.sensors]
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.table()

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Error, cosine and resultant against marker noise; see `tactile._results.pictures`."""
        from .._results.pictures import draw_benchmark

        return draw_benchmark(self, path)


def cases(
    presses: Sequence[Any],
    layer: Any,
    markers: ArrayLike,
    nodes: ArrayLike,
    *,
    pitch: float | tuple[float, float],
    shape: str = "hat",
) -> tuple[Case, ...]:
    """Presses settled to displacements of the markers, by the exact layer, and to tractions at the nodes.

    Parameters
    ----------
    presses : sequence
        Each a ``Press``, or a sequence of presses that act together.
    layer : Layer or HalfSpace
    markers : array (N, 2 or 3)
        Points that the sensor reads (m).
    nodes : array (P, 2)
        Points of the map (m).
    pitch : float or (along X, along Y)
        Distance of the nodes (m).
    shape : {"hat", "patch"}
        The traction of a node is its mean over the bilinear hat about it (consistent nodal force over area), or over
        its cell. Values at the points themselves would lose force: 13 % of a press of 2 mm radius at a pitch of 1 mm.

    Raises
    ------
    InputError
        Another shape, or a pitch that is not positive.
    """
    x, at = finite(markers, "markers"), finite(nodes, "nodes")[:, :2]
    made = []
    for i, press in enumerate(presses):
        parts = [press] if hasattr(press, "displacement") else list(press)
        u = sum(p.displacement(layer, x) for p in parts)
        made.append(Case(np.asarray(u), sum(means(p, at, pitch, shape) for p in parts), f"press {i + 1}"))  # type: ignore[arg-type]
    return tuple(made)


def benchmark(
    sensors: Mapping[str, Sensor],
    presses: Sequence[Case],
    *,
    areas: ArrayLike,
    points: ArrayLike,
    noise: Sequence[float] = NOISE,
    draws: int = DRAWS,
    seed: int = 0,
    theta: float = 0.2,
    quantity: str = "forces",
    progress: Callable[[float, str], None] | None = None,
) -> BenchmarkTable:
    """Run every sensor on the same presses with the same draws of noise.

    Parameters
    ----------
    sensors : mapping of name to callable
        Each takes displacements (N, 3) in m and returns a `ForceMap` (``sensor.estimate`` as it stands), a map (P, 3)
        of nodal forces (N) or tractions (Pa), or an estimate whose `load` is one.
    presses : sequence of Case
        `cases` makes them from presses on an exact layer.
    areas : array (P,)
        Tributary areas of the map's points (m^2).
    points : array (P, 2 or 3)
        Their places (m).
    noise : sequence of float
        Std of independent marker noise of each component (m).
    draws : int
        Draws of each press and level.
    seed : int
        Of the noise, which is the same for all sensors.
    theta : float
        Share of the peak from which a point counts as contact.
    quantity : {"forces", "tractions"}
        What sensors return that give no force map.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Raises
    ------
    InputError
        No sensor, no press, levels below zero, or maps that do not fit.

    Notes
    -----
    Accuracy (resultant, relative L2), fidelity (cosine, IoU) and noise resistance (slope) are defined here, as the
    formulas of `tactile.metrics`; papers define these words in other ways, and their figures do not compare.
    """
    levels = _levels(noise)
    if not sensors or not presses or draws < 1:
        raise InputError(
            "nothing to compare", where="metrics.benchmark",
            found=f"{len(sensors)} sensors, {len(presses)} presses, {draws} draws", expected="at least one of each",
            hint='metrics.benchmark({"multilayer": sensor}, metrics.cases(presses, layer, markers, nodes), ...)',
        )  # fmt: skip
    w, x = finite(areas, "areas"), places(points, np.size(areas))
    rows, slopes, done, total = [], {}, 0, len(sensors) * len(levels)
    for name, sensor in sensors.items():
        errors = []
        for i, level in enumerate(levels):
            found = [
                _one(sensor, case, level, w, x, theta, quantity, np.random.default_rng([seed, i, j, k]))
                for j, case in enumerate(presses)
                for k in range(draws)
            ]
            rows.append(_row(name, level, found))
            errors.append(np.reshape([m.error for m in found], (len(presses), draws)).mean(axis=0))
            done += 1
            if progress is not None:
                progress(done / total, f"{name}, {1e6 * level:.3g} um")
        enough = len(set(levels)) >= LEVELS and draws >= DRAWS
        slopes[name] = noise_slope(levels, np.array(errors)) if enough else None
    return BenchmarkTable(tuple(rows), slopes, len(presses), draws)


def _levels(noise: Sequence[float]) -> tuple[float, ...]:
    found = np.atleast_1d(finite(noise, "noise"))
    if found.ndim != 1 or not found.size or (found < 0).any():
        raise InputError("no levels of noise", where="metrics.benchmark, noise", found=str(noise)[:60],
                         expected="std >= 0 in m, one for each level", hint="(2e-6, 5e-6, 10e-6, 20e-6)")  # fmt: skip
    return tuple(found.tolist())


def _one(
    sensor: Sensor, case: Case, level: float, w: Array, x: Array, theta: float, quantity: str, rng: np.random.Generator
) -> MapMetrics:
    """One press with one draw of noise."""
    u = finite(case.displacements, "displacements")
    answer = sensor(u + level * rng.standard_normal(u.shape))
    # a force map knows its forces, and over the areas they are the means that the truth is
    forces = answer.forces() if isinstance(answer, ForceMap) else None
    if forces is None:
        found = field(np.reshape(answer.load, (-1, 3)) if hasattr(answer, "load") else answer, "the sensor's map")
        tractions = found / w[:, None] if quantity == "forces" and len(found) == len(w) else found
    else:
        tractions = forces / w[:, None]
    return compare(tractions, case.tractions, areas=w, points=x, theta=theta)


def _row(name: str, level: float, found: Sequence[MapMetrics]) -> BenchmarkRow:
    a, b = (np.array([getattr(m, which)[:3] for m in found]) for which in ("resultant", "reference"))
    size = np.linalg.norm(b, axis=1)
    if not (size > 0).all():
        raise InputError(
            "a press without resultant", where="metrics.benchmark", found="zero resultant force",
            expected="presses with a net force", hint="compare such maps one by one with metrics.compare",
        )  # fmt: skip

    def middle(field_name: str) -> float | None:
        values = [v for v in (getattr(m, field_name) for m in found) if v is not None]
        return float(np.median(values)) if values else None

    names = ("error", "cosine", "iou", "peak_ratio", "radius_ratio", "dtma", "dma", "dtmb", "snr", "centroid_error")
    settled = replace(
        found[0],
        components=tuple(np.median([m.components for m in found], axis=0).tolist()),
        resultant=tuple(np.median([m.resultant for m in found], axis=0).tolist()),
        reference=tuple(np.median([m.reference for m in found], axis=0).tolist()),
        **{n: middle(n) for n in names},  # type: ignore[arg-type]
    )
    return BenchmarkRow(
        name, level,
        float(np.median(np.linalg.norm(a - b, axis=1) / size)),
        float(np.median((a - b)[:, 2] / size)),
        settled, float(max(m.error or 0.0 for m in found)),
    )  # fmt: skip


def _shown(value: float | None, width: int = 8) -> str:
    return f"{'-':>{width}s}" if value is None else f"{value:{width}.3f}" if abs(value) < 1e3 else f"{value:{width}.2g}"
