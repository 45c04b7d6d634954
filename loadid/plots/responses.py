"""Measured against predicted response."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from structures.errors import InputError

from .style import (
    DENSE,
    GREEN,
    GREY,
    NARROW,
    ORANGE,
    PALE,
    PANELS,
    axis_label,
    few_labels,
    legend_above,
    mark,
    new_figure,
    readable,
    text,
    tidy,
    unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from loadid.estimate import LoadEstimate


def response_figure(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """Measured against predicted response, and what is left, per sensor; below each other where it is narrow."""
    if estimate.response is None or estimate.residual is None or estimate.predicted is None:
        raise InputError("the estimate carries no response", where="plot", hint="use a family that keeps it")
    figure = figure or new_figure()
    if estimate.response.ndim == 1 or estimate.axis is None or len(estimate.axis.values) != len(estimate.response):
        figure.set_size_inches(NARROW if narrow else 7, 4)
        _draw_static_response(figure.subplots(), estimate)
        mark(figure, estimate)
        return figure
    shown = range(min(len(estimate.sensors), PANELS))
    if narrow:
        figure.set_size_inches(NARROW, 0.9 + 3.2 * len(shown))
        grid = figure.subplots(2 * len(shown), 1, squeeze=False, sharex=True).reshape(len(shown), 2)
    else:
        figure.set_size_inches(10, 1.1 + 2.0 * len(shown))
        grid = figure.subplots(len(shown), 2, squeeze=False, sharex=True, width_ratios=[3, 2])
    x = estimate.axis.values * readable(estimate)[0]
    dense, lines = len(x) > DENSE, estimate.axis.name == "frequency"
    for (left, right), j in zip(grid, shown, strict=True):
        measured, residual, predicted = (x[:, j] for x in (estimate.response, estimate.residual, estimate.predicted))
        if lines:  # of amplitudes the moduli, decades apart
            measured, residual, predicted = (np.abs(x) for x in (measured, residual, predicted))
            left.set_yscale("log")
            right.set_yscale("log")
        # broad and pale under thin and dark: where they agree, both are still seen
        left.plot(x, measured, color=PALE, lw=4.0, label="measured", rasterized=dense)
        left.plot(x, predicted, color=ORANGE, lw=0.8, label="predicted", rasterized=dense)
        right.plot(x, residual, color=GREEN, lw=0.7, rasterized=dense)
        norm = float(np.linalg.norm(measured))
        share = f"{np.linalg.norm(residual) / norm:.2%} of the signal" if norm > 0 else "the signal is zero"
        left.set_title(text(estimate.sensors[j]), loc="left", fontsize=9)
        right.set_title(f"residual, {share}", loc="left", fontsize=9)
        left.set_ylabel(f"[{unit(estimate.sensor_units[j])}]")
        for ax in (left, right):
            if lines:
                few_labels(ax.yaxis)
            ax.margins(x=0.01)
            tidy(ax)
    legend_above(grid[0][0])
    for ax in grid[-1][1:] if narrow else grid[-1]:
        ax.set_xlabel(axis_label(estimate))
    if len(shown) < len(estimate.sensors):
        figure.supylabel(f"first {len(shown)} of {len(estimate.sensors)} sensors", fontsize=9)
    mark(figure, estimate)
    return figure


def _draw_static_response(ax: Axes, estimate: LoadEstimate) -> None:
    measured, predicted = np.ravel(estimate.response), np.ravel(estimate.predicted)  # type: ignore[arg-type]
    ends = [min(measured.min(), predicted.min()), max(measured.max(), predicted.max())]
    ax.plot(ends, ends, color=GREY, lw=1, label="measured = predicted")
    ax.plot(measured, predicted, ls="none", marker="o", ms=5, mfc="none", color=ORANGE, label="sensors")
    units = ", ".join(unit(u) for u in sorted(set(estimate.sensor_units)))
    ax.set(xlabel=f"measured [{units}]", ylabel=f"predicted [{units}]")
    ax.legend(fontsize=8)
    tidy(ax)
