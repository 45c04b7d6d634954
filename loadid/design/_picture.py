"""Pictures of layouts: where sensors and loads are, how well each load is known, and where it is known worst."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .._plots.style import finished
from ._layout import Judged

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]


BLUE, ORANGE, INK, GREY, PALE = "#0072B2", "#D55E00", "#222222", "#8a8a8a", "#dddddd"
COLUMNS = 3
FLAT = 1e-6  # extent over the largest one below which a direction is left out
NAMED = 12  # sensors of a bar picture whose names fit


def draw(
    layouts: Sequence[Judged],
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
    layouts : sequence of Judged
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
        j = one.worst
        unit = "" if one.units[j] == "arbitrary" else f" {one.units[j]}"
        panel.set_title(
            f"{one.name}: {len(one.sensors)} sensors, rank {one.rank}, condition {one.kappa:.3g}\n"
            f"worst: {one.loads[j]}, std {one.std[j]:.3g}{unit} ({one.share[j]:.0%} of its amplitude)",
            fontsize=9,
            loc="left",
        )
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


def _bars(ax: Axes, one: Judged) -> None:
    """Share of every load in its order; no places are known."""
    where = np.arange(len(one.share))
    ax.bar(where, one.share, color=[ORANGE if j == one.worst else BLUE for j in where], width=0.8)
    _share_axis(ax, one)
    ax.set_ylim(bottom=0)
    ax.set_xlabel("load, in the order of the model")
    if len(one.sensors) <= NAMED:
        ax.text(0.99, 0.97, "sensors: " + ", ".join(one.sensors), transform=ax.transAxes, ha="right", va="top",
                fontsize=8, color=INK, wrap=True)  # fmt: skip


def _share_axis(ax: Axes, one: Judged) -> None:
    top = max(float(one.share.max()), 1e-6)
    ax.set_ylim(-0.16 * top, 1.25 * top)
    ax.axhline(0, color=GREY, lw=0.8)
    ax.set_ylabel("posterior std over amplitude")
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _line(ax: Axes, one: Judged, x: Array, rest: Sequence[Array | None], direction: int) -> None:
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


def _map(ax: Axes, one: Judged, x: Array, rest: Sequence[Array | None], axes: list[int], figure: Any) -> None:
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
    figure.colorbar(points, ax=ax, label="posterior std over amplitude", shrink=0.85)
    ax.legend(fontsize=8, frameon=False, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.16))
