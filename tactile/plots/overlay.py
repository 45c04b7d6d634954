"""The camera image with what was found in it: dots, lost markers, motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from loadid.plots.style import ORANGE, SKY, new_figure, text
from tactile.vision.detect import Detected
from tactile.vision.grey import grey
from tactile.vision.motion import Motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NUMBERED = 100  # dots up to which each carries its number
WIDTH = 7.0  # inches of a picture
ENLARGED = 10.0  # length of the arrows over the motion, where that is small


def overlay(
    image: Any,
    found: Detected | Motion,
    *,
    title: str = "",
    scale: float | None = None,
    axes: Axes | None = None,
    figure: Figure | None = None,
) -> Figure:
    """Image with the dots found in it, numbered where they are few; with a `Motion`, arrows, and lost markers crossed.

    Parameters
    ----------
    image : array, shape (H, W) or (H, W, 3)
        The frame, grey or colour.
    found : Detected or Motion
        What was found in it.
    title : str
        Printed above, with the numbers of dots.
    scale : float, optional
        Length of the arrows over the motion; default 1, or 10 where the largest motion is below 3 % of the image.
    axes : Axes, optional
        Where to draw instead of a new figure.
    figure : Figure, optional
    """
    seen = grey(image)
    if axes is None:
        figure = figure or new_figure()
        height, width = seen.shape
        figure.set_size_inches(WIDTH, WIDTH * height / width + 0.5)
        axes = figure.subplots()
    shown = np.asarray(image)
    colour = shown.ndim == 3 and shown.shape[2] >= 3
    axes.imshow(shown[..., :3] if colour else seen, cmap=None if colour else "gray", interpolation="nearest")
    axes.set_axis_off()
    if isinstance(found, Motion):
        words = _draw_motion(axes, found, seen.shape[1], scale)
    else:
        words = _draw_dots(axes, found.points, found.radius)
    axes.set_title(f"{text(title)}: {words}" if title else words, fontsize=9, loc="left")
    drawn = axes.get_figure()
    assert isinstance(drawn, Figure)
    return drawn


def _draw_dots(axes: Axes, points: NDArray[np.float64], radius: float) -> str:
    _rings(axes, points, radius)
    _numbers(axes, points, radius)
    return f"{len(points)} dots"


def _draw_motion(axes: Axes, motion: Motion, width: int, scale: float | None) -> str:
    places, moved = motion.places, motion.moved
    seen = motion.seen
    largest = float(np.hypot(*moved[seen].T).max(initial=0.0))
    factor = scale or (ENLARGED if largest < 0.03 * width else 1.0)
    pitch = _pitch(motion.points)
    _rings(axes, places[seen], 0.25 * pitch)
    axes.quiver(
        *motion.points[seen].T,
        *(factor * moved[seen]).T,
        angles="xy",
        scale_units="xy",
        scale=1,
        color=SKY,
        width=0.003,
    )
    for gone, sign in ((motion.lost, "x"), (motion.rejected, "P")):
        axes.plot(*motion.points[gone].T, sign, color=ORANGE, markersize=8, markeredgewidth=1.5)
    _numbers(axes, motion.points, 0.25 * pitch)
    size = f"largest motion {largest:.2g} px" + (f", arrows x {factor:g}" if factor != 1 else "")
    return f"{seen.sum()} of {len(seen)} markers, {motion.lost.sum()} lost, {motion.rejected.sum()} rejected; {size}"


def _rings(axes: Axes, points: NDArray[np.float64], radius: float) -> None:
    from matplotlib.collections import EllipseCollection

    size = np.full(len(points), 2 * radius)
    rings = EllipseCollection(
        size, size, np.zeros(len(points)), units="xy", offsets=points, transOffset=axes.transData, linewidths=1.0
    )
    rings.set(facecolor="none", edgecolor=ORANGE)
    axes.add_collection(rings)
    axes.plot(*points.T, ".", color=ORANGE, markersize=2)


def _numbers(axes: Axes, points: NDArray[np.float64], radius: float) -> None:
    if len(points) > NUMBERED:
        return
    for k, (x, y) in enumerate(points):
        if np.isfinite(x):
            axes.annotate(str(k + 1), (x + radius, y - radius), color="white", fontsize=6, clip_on=True)


def _pitch(points: NDArray[np.float64]) -> float:
    return Detected(points[np.isfinite(points).all(axis=1)], np.empty(0), 1.0).pitch
