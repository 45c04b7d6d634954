"""Pictures of a sequence of force maps for a video: one scale, the map of the frame, the forces so far."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from loadid.plots.style import INK, mark
from structures.errors import InputError
from structures.values import reals

from .maps import (
    COLOURS,
    KPA,
    LONGEST,
    MM,
    QUIET,
    colours,
    draw_resultants,
    dress,
    named,
    nice,
    spread_evenly,
    surface,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from ..forcemap import ForceMap

Array = NDArray[np.float64]
DPI = 100


def pictures(force: ForceMap, *, truth: ArrayLike | None = None, progress: Any = None) -> Iterator[NDArray[np.uint8]]:
    """A picture (H, W, 3) of every frame.

    Parameters
    ----------
    force : ForceMap
        A sequence.
    truth : array (frames, P, 3), optional
        Known tractions (Pa), drawn beside.
    progress : callable, optional

    Raises
    ------
    InputError
        A single frame, a truth that does not fit.
    """
    if force.single:
        raise InputError("a video takes frames", where="film", found="one force map", expected="a sequence")
    t = force.traction()
    known = None if truth is None else reals(truth, where="truth")
    if known is not None and (known.shape != t.shape or not np.all(np.isfinite(known))):
        raise InputError("the known maps do not fit", where="truth", found=f"shape {known.shape}, or NaN",
                         expected=f"{t.shape} finite tractions in Pa")  # fmt: skip
    return _drawn(force, t, known, progress)


def _drawn(force: ForceMap, t: Array, known: Array | None, progress: Any) -> Iterator[NDArray[np.uint8]]:
    shown = [("estimate", t), *([("truth", known)] if known is not None else [])]
    figure = Figure(figsize=(4.3 * len(shown) + 4.2, 4.3), dpi=DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(shown) + 1, width_ratios=[1.0] * len(shown) + [0.95])
    top = max(max(float(np.abs(x[..., 2]).max()) for _, x in shown) * KPA, 1e-300)
    low = -max(float(x[..., 2].max()) for _, x in shown) * KPA
    shear = max(float(np.hypot(x[..., 0], x[..., 1]).max()) for _, x in shown) * KPA
    panels = [_Panel(ax, force.frame(0), name, (low, top, shear)) for ax, (name, _) in zip(axes, shown, strict=False)]
    draw_resultants(axes[-1], force)
    assert force.axis is not None
    at, values = force.axis.values, force.resultant().value
    line = axes[-1].axvline(at[0], color=INK, lw=1.0)
    dots = axes[-1].scatter(np.full(3, at[0]), values[0], c=list(COLOURS), s=22, zorder=3)
    mark(figure, force)
    moving: list[Artist] = [artist for panel in panels for artist in panel.moving] + [line, dots]
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    figure.set_layout_engine("none")  # what is laid out once stays: nothing jumps from frame to frame
    still = canvas.copy_from_bbox(figure.bbox)
    for k in range(len(force.load)):
        for panel, (_, x) in zip(panels, shown, strict=True):
            panel.show(x[k], named(force, k))
        line.set_xdata([at[k], at[k]])
        dots.set_offsets(np.column_stack([np.full(3, at[k]), values[k]]))
        canvas.restore_region(still)
        for artist in moving:  # the rest is drawn once: axes and labels take nine tenths of a picture's time
            artist.draw(canvas.get_renderer())
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()
        if progress is not None:
            progress((k + 1) / len(force.load), "drawing the video")


class _Panel:
    """One map whose colours and arrows change from frame to frame."""

    def __init__(self, ax: Axes, one: ForceMap, name: str, scale: tuple[float, float, float]) -> None:
        low, top, shear = scale
        self.name, self.quiet = name, QUIET * max(top, shear)
        self.image = surface(ax, one, np.zeros(len(one.nodes)), **colours(low, top))
        bar = ax.figure.colorbar(self.image, ax=ax, shrink=0.85, pad=0.02)
        bar.set_label("pressure [kPa]", fontsize=8)
        bar.ax.tick_params(labelsize=8)
        self.at, step = spread_evenly(one.nodes[:, :2])
        xy = MM * one.nodes[self.at, :2]
        size = shear if shear > 0 else 1.0
        zero = np.zeros(len(xy))
        self.arrows = ax.quiver(*xy.T, zero, zero, angles="xy", scale_units="xy", scale=size / (LONGEST * MM * step),
                                units="width", width=0.004, minlength=0.0, color=INK)  # fmt: skip
        if shear > QUIET * top:
            length = nice(shear)
            ax.quiverkey(self.arrows, 0.62, 1.035, length, f"shear {length:g} kPa", labelpos="E", coordinates="axes",
                         fontproperties={"size": 8}, labelsep=0.06)  # fmt: skip
        dress(ax)
        self.title = ax.set_title(f"{name}, {'0' * 8}", loc="left", fontsize=9)
        self.moving: list[Artist] = [self.image, self.arrows, self.title, ax.spines["left"], ax.spines["bottom"]]

    def show(self, t: Array, name: str) -> None:
        """Show the tractions (P, 3) of a frame."""
        self.image.set_array(-t[:, 2] * KPA)
        tx, ty = KPA * t[self.at, 0], KPA * t[self.at, 1]
        loud = np.hypot(tx, ty) > self.quiet
        self.arrows.set_UVC(np.where(loud, tx, 0.0), np.where(loud, ty, 0.0))
        self.title.set_text(f"{self.name}, {name}")
