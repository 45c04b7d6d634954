"""What every picture shares: colours, the line that it must not travel without, labels, axes, files."""

from __future__ import annotations

import os
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure
from numpy.typing import NDArray

from structures.errors import InputError
from structures.files._storage import as_path, replace

from .._results.shown import label
from .._results.summary import overridden

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .._results.estimate import LoadEstimate

Array = NDArray[Any]


# Okabe and Ito: told apart with every kind of colour vision, and in grey by their lightness
BLUE, ORANGE, GREEN, SKY, PURPLE = "#0072B2", "#D55E00", "#009E73", "#56B4E9", "#CC79A7"
INK, GREY = "#222222", "#8a8a8a"
PALE = "#9fc3dd"  # of a broad line below a thin one
NARROW = 4.0  # inches: the width of a phone
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
DPI = 150  # of bitmaps
VECTORS = ("svg", "svgz", "pdf", "ps", "eps")  # formats that count in points
DENSE = 5000  # points of a line beyond which a vector picture would be larger than a bitmap


def mark(figure: Figure, estimate: LoadEstimate) -> None:
    """Print on the picture what it must not travel without: grade, verification, overridden refusals, cautions."""
    color, weight = (ORANGE, "bold") if overridden(estimate) else (INK, "normal")
    lines = textwrap.wrap("  |  ".join(label(estimate)), int(14 * figure.get_figwidth()))
    figure.suptitle("\n".join(lines), fontsize=8, color=color, fontweight=weight, x=0.01, ha="left")


def text(label: str) -> str:
    """A label as matplotlib prints it: no formula, no control characters, not too long."""
    clean = "".join(c if c.isprintable() else " " for c in label).replace("$", r"\$")
    return clean if len(clean) <= 48 else clean[:47] + "…"


def unit(name: str) -> str:
    """``m/s^2`` as ``m/s²``."""
    return text(name.replace("^2", "²").replace("^3", "³").replace("um/", "µm/"))


def new_figure(show: bool = False) -> Figure:
    """An empty figure, with a window only where one is asked for."""
    if show:
        from matplotlib import pyplot

        return pyplot.figure(layout="constrained")
    return Figure(layout="constrained")


def sized(figure: Figure | None, narrow: bool, height: float, wide: tuple[float, float]) -> Figure:
    """A figure as narrow as a phone and of some height, or of a size for a screen (inches)."""
    figure = figure or new_figure()
    figure.set_size_inches(*((NARROW, height) if narrow else wide))
    return figure


def tidy(ax: Axes) -> None:
    """Light grid, no frame, small labels."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color="#dddddd", lw=0.5)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8, which="both")
    for axis in (ax.xaxis, ax.yaxis):
        axis.label.set_fontsize(9)


def few_labels(axis: Any) -> None:
    """Label the decades of a log axis only, where it has two or more of them."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator, ScalarFormatter

    low, high = axis.get_view_interval()
    if high > 30 * low:
        axis.set_major_locator(LogLocator(numticks=8))
        axis.set_major_formatter(FuncFormatter(_decade))  # plain text: setting formulas takes most of a report's time
        axis.set_minor_formatter(NullFormatter())
        if high > 1e4 * low:
            axis.set_minor_locator(NullLocator())  # dozens of ticks without labels, that nobody reads
        return
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(ScalarFormatter())
    axis.set_minor_formatter(NullFormatter())


def _decade(value: float, _: int) -> str:
    """``10⁻³``."""
    power = f"{round(float(np.log10(value)))}" if value > 0 else ""
    return "10" + power.translate(_RAISED) if power else ""


def legend_above(ax: Axes) -> None:
    """Legend in one line above the axes."""
    ax.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, fontsize=8, frameon=False, borderaxespad=0.1)


def finished(figure: Figure, path: str | os.PathLike[str] | None, show: bool) -> Figure:
    """The figure, saved where a path is given and shown where that is asked for."""
    if path is not None:
        save(figure, path)
    if show:
        figure.canvas.manager.show()  # type: ignore[union-attr]
    return figure


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure to a file whose suffix names the format; the old file stays where that fails."""
    replace(as_path(path), rendered(figure, path))


def rendered(figure: Figure, path: str | os.PathLike[str]) -> bytes:
    """Content of the picture file of a figure."""
    return drawn(figure, picture_format(path))


def drawn(figure: Figure, kind: str, **settings: Any) -> bytes:
    """A figure in some format, with settings of `Figure.savefig`.

    Its layout is found before it is drawn, at the resolution that it is drawn at: else matplotlib draws it once for the
    layout alone.
    """
    from io import BytesIO

    dpi = 72 if kind in VECTORS else DPI
    figure.set_dpi(dpi)
    if (layout := figure.get_layout_engine()) is not None:
        layout.execute(figure)
        figure.set_layout_engine(None)
    buffer = BytesIO()
    figure.savefig(buffer, format=kind, dpi=dpi, **settings)
    figure.set_layout_engine(layout)
    return buffer.getvalue()


def picture_format(path: str | os.PathLike[str]) -> str:
    """Format of a picture that the suffix of a file names.

    Raises
    ------
    InputError
        If it names none.
    """
    suffix = as_path(path).suffix.lstrip(".").lower()
    if suffix not in FigureCanvasBase.get_supported_filetypes():
        raise InputError(
            "no picture format", where=str(path), found=suffix or "no suffix", expected="png, svg or pdf",
            hint="end the name with .png, .svg or .pdf",
        )  # fmt: skip
    return suffix
