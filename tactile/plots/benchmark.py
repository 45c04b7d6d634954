"""Picture of a benchmark: error, fidelity and resultant of several sensors against marker noise."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from loadid.plots.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, new_figure, save, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..metrics.benchmark import BenchmarkTable

LINES = [
    (BLUE, "-", "o"),
    (ORANGE, "--", "s"),
    (GREEN, "-.", "^"),
    (PURPLE, ":", "D"),
    (SKY, "-", "v"),
    (GREY, "--", "x"),
]


def draw(table: BenchmarkTable, path: str | os.PathLike | None = None) -> Figure:
    """One panel each for the error of the map, its cosine, the overlap of the contact and the error of the force."""
    figure = new_figure()
    figure.set_size_inches(10, 7)
    panels = figure.subplots(2, 2, sharex=True).ravel()
    shown = (
        ("relative L2 error of the map (0 is right)", lambda r: r.metrics.error),
        ("cosine of the map (1 is right)", lambda r: r.metrics.cosine),
        ("IoU of the contact (1 is right)", lambda r: r.metrics.iou),
        ("error of the resultant force (%)", lambda r: 100 * r.force),
    )
    for i, name in enumerate(table.sensors):
        rows = sorted((r for r in table.rows if r.sensor == name), key=lambda r: r.noise)
        color, line, marker = LINES[i % len(LINES)]
        for ax, (_, value) in zip(panels, shown, strict=True):
            ax.plot([1e6 * r.noise for r in rows], [value(r) for r in rows], color=color, ls=line, marker=marker, ms=5,
                    label=text(name))  # fmt: skip
    for ax, (title, _) in zip(panels, shown, strict=True):
        ax.set_title(title, fontsize=10, loc="left")
        ax.grid(alpha=0.25)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
    for i in (0, 3):
        panels[i].set_ylim(bottom=0)
    figure.supxlabel("marker noise, std of each component (µm)", fontsize=10)
    panels[0].legend(fontsize=8, frameon=False)
    figure.suptitle(f"{table.presses} presses, {table.draws} draws, medians", fontsize=9, x=0.01, ha="left")
    if path is not None:
        save(figure, path)
    return figure
