"""Layouts side by side, and pictures of them: how well each load is known, and where it is known worst."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag
from structures._model import Model
from structures._models.forward import ForwardModel
from structures.errors import InputError

from .._guards.measurement import lost_channels
from .._plots.style import finished
from ._candidates import CandidateSensors, expected, settle
from ._layout import Judged, Layout, judge, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure
if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class LayoutComparison:
    """Layouts judged for the same loads. Immutable.

    Parameters
    ----------
    layouts : tuple of Judged
    expected : str
        The loads that they were judged for, in words.
    flags : tuple of Flag
        W202 where a condition number is better because modes are lost.
    loads_at, outline : array or None
        Places of the loads and of the nodes of the structure (m), for the picture.
    """

    layouts: tuple[Judged, ...]
    expected: str
    flags: tuple[Flag, ...] = ()
    loads_at: NDArray[np.float64] | None = None
    outline: NDArray[np.float64] | None = None

    def __getitem__(self, name: str) -> Judged:
        for one in self.layouts:
            if one.name == name:
                return one
        raise KeyError(name)

    def best(self, criterion: str = "D") -> Judged:
        """Layout of the largest log det (``"D"``), or of the smallest worst std over amplitude (``"worst"``)."""
        criterion = checked(criterion)
        return max(self.layouts, key=lambda one: one.logdet if criterion == "D" else -float(one.share.max()))

    def table(self) -> str:
        """Condition number with rank and nullity, modes above the noise, worst std and its load, log det."""
        notes = [f"warning: {f.message}" for f in self.flags]
        return "\n".join([table(self.layouts), f"for {self.expected}", *notes])

    def __str__(self) -> str:
        return self.table()

    def plot(self, **settings: Any) -> Figure:
        """Picture of the layouts, the worst load marked; see `loadid.design._comparison.draw`."""
        return draw(self.layouts, self.loads_at, outline=self.outline, **settings)

    def to_dict(self) -> dict[str, Any]:
        """Plain texts, numbers and lists."""
        return {
            "layouts": [one.to_dict() for one in self.layouts],
            "expected": self.expected,
            "flags": [f.to_dict() for f in self.flags],
            "loads_at": None if self.loads_at is None else self.loads_at.tolist(),
        }


def compare(
    sensor_sets: Mapping[str, Any],
    loads: Sequence[Any] | None = None,
    *,
    candidates: Model | ArrayLike | None = None,
    structure: Any = None,
    noise: ArrayLike | None = None,
    amplitude: ArrayLike | None = None,
    snr: float | None = None,
    at: ArrayLike | None = None,
    loads_at: ArrayLike | None = None,
) -> LayoutComparison:
    """Judge sensor layouts before anything is measured.

    Parameters
    ----------
    sensor_sets : mapping of name to layout
        Labels or indices of `candidates`; sensors for `structure`; or a Model or array (sensors, loads) each.
    loads : sequence, optional
        Loads or load basis on `structure`; else labels or indices of the columns that count, default all.
    candidates : Model or array (sensors, loads), optional
        What the sets pick their sensors from.
    structure : Structure, optional
        What the sensors of the sets and the loads are placed on.
    noise : float or array, optional
        Noise std per candidate, or covariance, where the model states none. Without any, the same for all sensors.
    amplitude : float or array (loads,), optional
        Std of each load before any reading, SI.
    snr : float, optional
        Instead of an amplitude: the sensor that sees a load best (of each unit) reads it at this multiple of its noise.
        Default 100. No unit of sensors or loads then matters.
    at, loads_at : array, optional
        Places of candidates and loads (m), where no model knows them; for the picture.

    Returns
    -------
    LayoutComparison

    Raises
    ------
    InputError
        Sets, noise or amplitudes that do not fit; sensors of different units without noise.

    Notes
    -----
    A condition number says nothing without rank and nullity: fewer sensors may condition a smaller problem better.
    """
    if not isinstance(sensor_sets, Mapping) or not sensor_sets:
        raise InputError(
            "no layouts", where="design.compare", found=type(sensor_sets).__name__,
            expected="a mapping from a name to a layout", hint='{"two rows": ["s1", "s2"], "one row": ["s1"]}',
        )  # fmt: skip
    if candidates is not None and structure is not None:
        raise InputError(
            "candidates and structure are two ways to say what the sets pick from", where="design.compare",
            found="both", expected="one of them",
            hint="candidates= for labels or indices, structure= for sensors that are placed on it",
        )  # fmt: skip
    sets: dict[str, tuple[CandidateSensors, NDArray[np.intp]]] = {}
    if candidates is not None:
        pool = settle(candidates, noise=noise, loads=loads, at=at, loads_at=loads_at, where="design.compare")
        sets = {str(k): (pool, pool.index(v, f"layout {k}")) for k, v in sensor_sets.items()}
    else:
        for name, given in sensor_sets.items():
            own, columns = _placed(given, structure, loads), None if structure is not None else loads
            one = settle(own, noise=noise, loads=columns, at=at, loads_at=loads_at, where=f"layout {name}")
            sets[str(name)] = one, np.arange(len(one.H))
    for name, (_, rows) in sets.items():
        if not len(rows):
            raise InputError("a layout without sensors", where=f"layout {name}", found="nothing", expected="a sensor",
                             hint="leave it out")  # fmt: skip
    first = next(iter(sets.values()))[0]
    for name, (pool, _) in sets.items():
        if pool.load_labels != first.load_labels or pool.load_units != first.load_units:
            raise InputError(
                "layouts are compared for the same loads", where=f"layout {name}", found=pool.load_labels[:8],
                expected=first.load_labels[:8], hint="build every model with the same loads",
            )  # fmt: skip
    want = expected([replace(c, H=c.H[r], noise=_sub(c.noise, r)) for c, r in sets.values()], amplitude, snr,
                    "design.compare")  # fmt: skip
    layouts = tuple(of(name, pool, rows, want.amplitude) for name, (pool, rows) in sets.items())
    return LayoutComparison(layouts, want.words, lost(layouts), first.loads_at, first.outline)


def of(name: str, pool: CandidateSensors, rows: NDArray[np.intp], amplitude: NDArray[np.float64]) -> Judged:
    """Judge some rows of the candidates."""
    return judge(
        name,
        pool.whitened(rows) * amplitude,
        amplitude,
        tuple(pool.labels[i] for i in rows),
        pool.load_labels,
        pool.load_units,
        None if pool.at is None else pool.at[rows],
    )


def lost(layouts: Sequence[Judged]) -> tuple[Flag, ...]:
    """W202 for every layout that is better conditioned than one of higher rank."""
    flags = []
    for after in layouts:
        better = [x for x in layouts if x.rank > after.rank and x.kappa > after.kappa]
        if better:
            before = max(better, key=lambda x: (x.rank, x.logdet))
            gone = [s for s in before.sensors if s not in after.sensors] or [f"the sensors of {before.name}"]
            pair = [(x.kappa, x.rank, x.nullity) for x in (before, after)]
            names = [*gone[:6], f"{len(gone) - 6} more"] if len(gone) > 6 else gone
            found = lost_channels(pair[0], pair[1], names)
            if found is not None:
                flags.append(replace(found, message=f"{after.name} against {before.name}: {found.message}"))
    return tuple(flags)


def checked(criterion: Any) -> str:
    """A criterion by its name.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if criterion not in ("D", "worst"):
        raise InputError(
            "no such criterion", where="criterion", found=repr(criterion), expected="'D' or 'worst'",
            hint="D: most information in all; worst: the least known load known best",
        )  # fmt: skip
    return str(criterion)


def _placed(given: Any, structure: Any, loads: Any) -> Any:
    """The model of one layout of sensors on a structure; anything else as it is."""
    if structure is None or isinstance(given, Model):
        return given
    return ForwardModel(structure, given, loads)


def _sub(noise: NDArray[Any] | None, rows: NDArray[np.intp]) -> NDArray[Any] | None:
    return noise if noise is None else noise[rows] if noise.ndim == 1 else noise[np.ix_(rows, rows)]


Array = NDArray[np.float64]


BLUE, ORANGE, INK, GREY, PALE = "#0072B2", "#D55E00", "#222222", "#8a8a8a", "#dddddd"
COLUMNS = 3
FLAT = 1e-6  # extent over the largest one below which a direction is left out
NAMED = 12  # sensors of a bar picture whose names fit


def draw(
    layouts: Sequence[Layout],
    loads_at: Array | None = None,
    *,
    outline: Array | None = None,
    candidates: Array | None = None,
    path: str | os.PathLike[str] | None = None,
    show: bool = False,
) -> Figure:
    """One panel for each layout; loads by posterior over prior std, the worst one marked.

    Places on a line are drawn against that line, places on a surface in the two directions of largest extent; without
    places, loads are drawn in their order.

    Parameters
    ----------
    layouts : sequence of Layout
    loads_at, outline, candidates : array (number, dim), optional
        Places (m) of the loads, the nodes of the structure, and all candidate sensors.
    path : path, optional
        File to save to, by its suffix.
    show : bool
        Open a window.
    """
    columns = min(len(layouts), COLUMNS)
    rows = -(-len(layouts) // columns)
    axes = None if loads_at is None else _directions([loads_at, outline, candidates, *(one.at for one in layouts)])
    surface = axes is not None and len(axes) == 2
    figure = _figure(show)
    figure.set_layout_engine("constrained")
    figure.set_size_inches(min(6.4 * columns, 16.0), (4.4 if surface else 3.8) * rows)
    panels = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    for panel, one in zip(panels, layouts, strict=False):
        if loads_at is None or axes is None:
            _bars(panel, one)
        elif surface:
            _map(panel, one, loads_at[:, axes], [_cut(x, axes) for x in (outline, candidates, one.at)], axes, figure)
        else:
            _line(panel, one, loads_at[:, axes[0]], [_cut(x, axes) for x in (outline, candidates, one.at)], axes[0])
        panel.set_title(one.title, fontsize=9, loc="left")
    for panel in panels[len(layouts) :]:
        panel.set_visible(False)
    return finished(figure, path, show)


def _figure(show: bool) -> Figure:
    if not show:
        return Figure()
    from matplotlib import pyplot

    return pyplot.figure()


def _directions(tables: Sequence[Array | None]) -> list[int]:
    """Directions to draw: the two of largest extent, or one where all places lie on a line along it."""
    known = [t for t in tables if t is not None]
    dim = min(t.shape[1] for t in known)
    extent = np.ptp(np.vstack([t[:, :dim] for t in known]), axis=0)
    order = [int(i) for i in np.argsort(-extent, kind="stable")]
    kept = [i for i in order[:2] if extent[i] > FLAT * max(extent.max(), np.finfo(float).tiny)]
    return sorted(kept) or [0]


def _cut(x: Array | None, axes: list[int]) -> Array | None:
    return None if x is None else x[:, axes]


def _bars(ax: Axes, one: Layout) -> None:
    """Share of every load in its order; no places are known."""
    where = np.arange(len(one.share))
    ax.bar(where, one.share, color=[ORANGE if j == one.worst else BLUE for j in where], width=0.8)
    _share_axis(ax, one)
    ax.set_ylim(bottom=0)
    ax.set_xlabel("load, in the order of the model")
    if len(one.sensors) <= NAMED:
        ax.text(0.99, 0.97, "sensors: " + ", ".join(one.sensors), transform=ax.transAxes, ha="right", va="top",
                fontsize=8, color=INK, wrap=True)  # fmt: skip


def _share_axis(ax: Axes, one: Layout) -> None:
    top = max(float(one.share.max()), 1e-6)
    ax.set_ylim(-0.16 * top, 1.25 * top)
    ax.axhline(0, color=GREY, lw=0.8)
    ax.set_ylabel(one.axis)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _line(ax: Axes, one: Layout, x: Array, rest: Sequence[Array | None], direction: int) -> None:
    """Share of every load above its place; sensors below the line."""
    outline, candidates, sensors = (None if t is None else t[:, 0] for t in rest)
    ax.vlines(x, 0, one.share, color=BLUE, lw=1.2)
    ax.plot(x, one.share, "o", color=BLUE, ms=4, label="loads")
    ax.plot(x[one.worst], one.share[one.worst], "o", ms=11, mfc="none", mec=ORANGE, mew=2, label="worst load")
    _share_axis(ax, one)
    low = ax.get_ylim()[0]
    if outline is not None:
        ax.plot([outline.min(), outline.max()], [0, 0], color=INK, lw=2.5, solid_capstyle="butt")
    if candidates is not None:
        ax.plot(candidates, np.full(len(candidates), 0.5 * low), "|", color=GREY, ms=6, label="candidates")
    if sensors is not None:
        ax.plot(sensors, np.full(len(sensors), 0.5 * low), "^", color=INK, ms=7, label="sensors")
    ax.set_xlabel(f"{'xyz'[direction]} [m]")
    ax.legend(fontsize=8, frameon=False, ncols=4, loc="upper center")


def _map(ax: Axes, one: Layout, x: Array, rest: Sequence[Array | None], axes: list[int], figure: Any) -> None:
    """Loads on the surface, coloured by their share; sensors as triangles."""
    outline, candidates, sensors = rest
    if outline is not None:
        ax.plot(*outline.T, ".", color=PALE, ms=2, zorder=0)
    if candidates is not None:
        ax.plot(*candidates.T, "+", color=GREY, ms=4, zorder=1, label="candidates")
    shades: dict[str, Any] = {"c": one.share, "cmap": "cividis", "vmin": 0, "vmax": float(one.share.max())}
    points = ax.scatter(x[:, 0], x[:, 1], s=46, zorder=2, label="loads", **shades)
    ax.plot(*x[one.worst], "o", ms=13, mfc="none", mec=ORANGE, mew=2.2, zorder=4, label="worst load")
    if sensors is not None:
        ax.plot(*sensors.T, "^", color="white", mec=INK, mew=1.4, ms=9, zorder=3, label="sensors")
    ax.set_aspect("equal", adjustable="box")
    ax.margins(0.08)
    ax.set_xlabel(f"{'xyz'[axes[0]]} [m]")
    ax.set_ylabel(f"{'xyz'[axes[1]]} [m]")
    figure.colorbar(points, ax=ax, label=one.axis, shrink=0.85)
    ax.legend(fontsize=8, frameon=False, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.16))
