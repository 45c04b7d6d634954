"""Pictures of presses: the image that the camera takes, and the load that is the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from loadid.generate._work import drawn_as, numbers_of

from .._arrays import Array
from ._maker import PressMaker

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 12  # draws
COLUMNS = 4


def sheet(maker: PressMaker, seed: int, draws: int) -> Figure:
    """The first draws of a set that are of as many kinds as there are: image beside normal and tangential load."""
    from matplotlib.figure import Figure

    found = [drawn_as(maker, seed, k) for k in range(min(draws, 4 * SHOWN))]
    order = sorted(range(len(found)), key=lambda k: (sum(one.kind == found[k].kind for one in found[:k]), k))[:SHOWN]
    pairs = 1 if maker.eye is None else 2
    rows = -(-len(order) // COLUMNS)
    figure = Figure(figsize=(12, 2.2 * pairs * rows), layout="constrained")
    axes = figure.subplots(pairs * rows, COLUMNS, squeeze=False)
    for ax in axes.ravel():
        ax.set_axis_off()
    for place, k in enumerate(order):
        row, column = pairs * (place // COLUMNS), place % COLUMNS
        one = found[k]
        below = axes[row + pairs - 1, column]
        _loads(below, maker, one.loads)
        title = f"{k}: {one.kind}, {1e3 * one.parameters['depth']:.2f} mm, {-one.parameters['Fz']:.2f} N"
        axes[row, column].set_title(title, fontsize=8)
        if maker.eye is not None:
            image = maker.picture(numbers_of(seed, k, int(one.parameters["redrawn"]))).image
            axes[row, column].imshow(image, cmap="gray", vmin=0, vmax=255)
            below.invert_yaxis()  # rows of an image run down
    return figure


def _loads(ax: Any, maker: PressMaker, loads: Array) -> None:
    """Pressure in shades and shear as arrows over the places of the loads."""
    places, each = 1e3 * maker.places[:, :2], loads.reshape(-1, 3)
    pressure = -each[:, 2]
    ax.tripcolor(*places.T, pressure, shading="gouraud", cmap="magma_r", vmin=0)
    strong = np.hypot(each[:, 0], each[:, 1]) > 0.2 * max(np.hypot(each[:, 0], each[:, 1]).max(), 1e-300)
    ax.quiver(*places[strong].T, *each[strong, :2].T, width=0.008, color="tab:cyan")
    ax.set_aspect("equal")
