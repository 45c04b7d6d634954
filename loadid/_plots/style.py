"""What every picture shares: colours, the line that it must not travel without, labels, axes, files."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, plain, reals
from structures.files._storage import as_path, replace

from .._results.summary import NOT_VERIFIED, allowed, overridden

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .._results.estimate import LoadEstimate

Array = NDArray[Any]


# Okabe and Ito: told apart with every kind of colour vision, and in grey by their lightness
BLUE, ORANGE, GREEN, SKY, PURPLE = "#0072B2", "#D55E00", "#009E73", "#56B4E9", "#CC79A7"
INK, GREY = "#222222", "#8a8a8a"
PALE = "#9fc3dd"  # of a broad line below a thin one
PANELS = 6
NARROW = 4.0  # inches: the width of a phone
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
DPI = 150  # of bitmaps
VECTORS = ("svg", "svgz", "pdf", "ps", "eps")  # formats that count in points
DENSE = 5000  # points of a line beyond which a vector picture would be larger than a bitmap


def mark(figure: Figure, estimate: LoadEstimate) -> None:
    """Print on the picture what it must not travel without: grade, verification, overridden refusals, cautions."""
    words = [
        f"grade {estimate.grade.letter}",
        NOT_VERIFIED if estimate.certificate is None else f"forward model verified {estimate.certificate.date[:10]}",
    ]
    if estimate.allowed:
        words.append(allowed(estimate, "OVERRIDDEN"))
    found = list(dict.fromkeys(f.code.removeprefix("LID-") for f in estimate.cautions))
    words.append("cautions: " + (", ".join(found[:14]) or "none"))
    if len(found) > 14:
        words[-1] += f" and {len(found) - 14} more"
    color, weight = (ORANGE, "bold") if overridden(estimate) else (INK, "normal")
    lines = textwrap.wrap("  |  ".join(words), int(14 * figure.get_figwidth()))
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


def known_load(estimate: LoadEstimate, truth: ArrayLike | None) -> NDArray[Any] | None:
    """A known load in the shape of the estimate."""
    if truth is None:
        return None
    array = known_amplitudes(truth) if estimate.load.dtype.kind == "c" else known_numbers(truth)
    array = array[:, None] if array.ndim == 1 and estimate.load.ndim == 2 else array
    if array.shape != estimate.load.shape:
        raise InputError("the known load does not fit", where="truth", found=array.shape, expected=estimate.load.shape)
    return array


def known_numbers(truth: ArrayLike) -> NDArray[np.float64]:
    """A known load as finite numbers."""
    array = reals(truth, where="truth", what="the known load is no real numbers")
    if not np.all(np.isfinite(array)):
        raise InputError("NaN or infinity in the known load", where="truth", expected="finite numbers")
    return array


def known_amplitudes(truth: ArrayLike) -> NDArray[np.complex128]:
    """Known complex amplitudes as finite numbers."""
    try:
        array = np.asarray(plain(truth), complex)
    except (TypeError, ValueError):
        array = np.array([np.nan])
    if not np.all(np.isfinite(array)):
        raise InputError("no finite numbers in the known load", where="truth", expected="complex amplitudes")
    return array


def largest(estimate: LoadEstimate) -> list[int]:
    """Loads to show, in their own order: all, or the largest few."""
    size = np.abs(estimate.load).max(axis=0)
    return sorted(int(j) for j in np.argsort(-size, kind="stable")[:PANELS])


def readable(estimate: LoadEstimate, window: tuple[float, float] | None = None) -> tuple[float, str]:
    """Factor and unit that make the axis, or a part of it, readable."""
    axis = estimate.axis
    assert axis is not None
    first, last = window or (float(axis.values[0]), float(axis.values[-1]))
    if axis.unit != "s" or last - first >= 1:
        return 1.0, axis.unit
    return (1e3, "ms") if last - first >= 1e-3 else (1e6, "µs")


def axis_label(estimate: LoadEstimate) -> str:
    """Name and unit of the first axis."""
    assert estimate.axis is not None
    return titled(estimate.axis.name, readable(estimate)[1])


def titled(name: str, of: str) -> str:
    """``time [ms]``, or the name alone where there is no unit."""
    return f"{name} [{of}]" if of and of != "1" else name


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


def places(geometry: Mapping[str, Any] | None) -> tuple[NDArray[np.float64], tuple[str, ...]] | None:
    """Places (points, 1 or 2) of loads along the axes in which they differ, and the names of these.

    Axes of the structure where the loads lie along one or two of them, else distances along the line or in the plane
    that fits them best. None where there is no geometry, or all three differ.
    """
    found = None if geometry is None else geometry.get("coordinates")
    if found is None or len(found) < 2:
        return None
    x = np.asarray(found, float)
    x = x[:, None] if x.ndim == 1 else x
    span = np.ptp(x, axis=0)
    used = np.flatnonzero(span > 1e-6 * span.max())
    if len(used) in (1, 2):
        plane = x[:, used]
        if len(used) == 1 or np.linalg.matrix_rank(plane - plane.mean(axis=0), tol=1e-6 * span.max()) == 2:
            return plane, tuple("xyz"[k] for k in used)
    centred = x - x.mean(axis=0)
    values, axes = np.linalg.svd(centred, full_matrices=False)[1:]
    rank = int(np.sum(values > 1e-6 * values[0])) if values[0] > 0 else 0
    if rank not in (1, 2):
        return None
    along = centred @ axes[:rank].T
    return along - along.min(axis=0), ("along",) if rank == 1 else ("along", "across")
