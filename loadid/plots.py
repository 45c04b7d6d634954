"""Pictures of a load estimate. Object interface of matplotlib only: no global state, no window unless asked for."""

from __future__ import annotations

import os
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from loadid.estimate import NOT_VERIFIED
from loadid.summary import allowed, overridden, pulse_window, sort
from structures.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from loadid.estimate import LoadEstimate

# Okabe and Ito: told apart with every kind of colour vision, and in grey by their lightness
BLUE, ORANGE, GREEN, SKY, PURPLE = "#0072B2", "#D55E00", "#009E73", "#56B4E9", "#CC79A7"
INK, GREY = "#222222", "#8a8a8a"
PALE = "#9fc3dd"  # of a broad line below a thin one
PANELS = 6
NARROW = 4.0  # inches: the width of a phone
_DENSE = 5000  # points of a line beyond which a vector picture would be larger than a bitmap


def plot(
    estimate: LoadEstimate,
    kind: str = "load",
    *,
    truth: ArrayLike | None = None,
    ax: Axes | None = None,
    path: str | os.PathLike | None = None,
    show: bool = False,
) -> Figure:
    """Figure of an estimate; see `LoadEstimate.plot`."""
    if ax is not None:
        if not hasattr(ax, "fill_between"):
            raise InputError(
                "these are no axes", where="ax", found=f"an object of type {type(ax).__name__}",
                expected="matplotlib Axes", hint="figure, ax = matplotlib.pyplot.subplots()",
            )  # fmt: skip
        draw_load(ax, estimate, 0, truth=_truth(estimate, truth))
        return ax.get_figure(root=True)  # type: ignore[return-value]
    figure = _figure(show)
    if kind == "load":
        load_figure(estimate, truth=truth, figure=figure)
    elif kind == "response":
        response_figure(estimate, figure=figure)
    elif kind == "path":
        path_figure(estimate, figure=figure)
    else:
        raise InputError("no such picture", where="plot", found=kind, expected="'load', 'response' or 'path'")
    if path is not None:
        save(figure, path)
    if show:
        figure.canvas.manager.show()  # type: ignore[union-attr]
    return figure


def save(figure: Figure, path: str | os.PathLike) -> None:
    """Write a figure to a file whose suffix names the format; the old file stays where that fails."""
    from structures.storage import as_path, replace

    replace(as_path(path), rendered(figure, path))


def rendered(figure: Figure, path: str | os.PathLike) -> bytes:
    """Content of the picture file of a figure."""
    from io import BytesIO

    buffer = BytesIO()
    figure.savefig(buffer, format=picture_format(path), dpi=150)
    return buffer.getvalue()


def picture_format(path: str | os.PathLike) -> str:
    """Format of a picture that the suffix of a file names.

    Raises
    ------
    InputError
        If it names none.
    """
    from structures.storage import as_path

    suffix = as_path(path).suffix.lstrip(".").lower()
    if suffix not in FigureCanvasBase.get_supported_filetypes():
        raise InputError(
            "no picture format", where=str(path), found=suffix or "no suffix", expected="png, svg or pdf",
            hint="end the name with .png, .svg or .pdf",
        )  # fmt: skip
    return suffix


# -- the load ---------------------------------------------------------------------------------------------------------
def load_figure(
    estimate: LoadEstimate,
    *,
    truth: ArrayLike | None = None,
    level: float = 0.95,
    figure: Figure | None = None,
    narrow: bool = False,
) -> Figure:
    """Load with its band, one row per load; a panel beside it enlarges a pulse that is short against the record.

    A narrow figure is for a phone: its panels stand below each other, the one around the peak first.
    """
    figure = figure or _figure()
    known = _truth(estimate, truth)
    if estimate.axis is None:
        figure.set_size_inches(NARROW if narrow else max(6.0, min(14.0, 2 + 0.35 * len(estimate.labels))), 4.2)
        _draw_static(figure.subplots(), estimate, known, level)
    else:
        _draw_rows(figure, estimate, known, level, narrow)
    mark(figure, estimate)
    return figure


def draw_load(
    ax: Axes,
    estimate: LoadEstimate,
    load: int = 0,
    *,
    truth: NDArray | None = None,
    level: float = 0.95,
    window: tuple[float, float] | None = None,
) -> None:
    """Draw one load over its axis, or over a part of it, into `ax`."""
    if estimate.axis is None:
        raise InputError("a static load has no axis", where="draw_load", hint="use load_figure")
    scale, name = _scale(estimate, window)
    x = estimate.axis.values * scale
    lower, upper = estimate.band(level)
    dense = len(x) > _DENSE
    ax.axhline(0, color=GREY, lw=0.6)
    ax.fill_between(
        x, lower[:, load], upper[:, load], color=SKY, alpha=0.45, lw=0, label=f"{level:.0%} band", rasterized=dense
    )
    if truth is not None:
        ax.plot(x, truth[:, load], color=INK, lw=1.4, ls=(0, (4, 2)), label="truth", rasterized=dense)
    ax.plot(x, estimate.load[:, load], color=BLUE, lw=1.2, label="estimate", rasterized=dense)
    ax.set_title(text(estimate.labels[load]), loc="left", fontsize=9)
    ax.set_ylabel(f"load [{unit(estimate.units[load])}]")
    ax.set_xlabel(f"{estimate.axis.name} [{name}]")
    ax.margins(x=0.01)
    if window is not None:
        ax.set_xlim(window[0] * scale, window[1] * scale)
    _tidy(ax)


def _draw_rows(figure: Figure, estimate: LoadEstimate, truth: NDArray | None, level: float, narrow: bool) -> None:
    shown = _largest(estimate)
    if narrow:
        _draw_stack(figure, estimate, truth, level, shown)
        return
    figure.set_size_inches(10, 1.1 + 2.3 * len(shown) if len(shown) > 1 else 4.0)
    grid = figure.add_gridspec(len(shown), 5)
    alike = len(set(estimate.units)) == 1  # one scale then, so that noise on a quiet load does not look like a load
    first = None
    for row, j in enumerate(shown):
        window = pulse_window(estimate, j)
        ax = figure.add_subplot(grid[row, :3] if window else grid[row, :], sharey=first if alike else None)
        draw_load(ax, estimate, j, truth=truth, level=level)
        if row < len(shown) - 1:
            ax.set_xlabel("")
        if window:
            near = figure.add_subplot(grid[row, 3:], sharey=ax)
            draw_load(near, estimate, j, truth=truth, level=level, window=window)
            near.set_title("around the peak", loc="left", fontsize=9)
            near.set_ylabel("")
            scale = _scale(estimate)[0]
            ax.axvspan(window[0] * scale, window[1] * scale, color=GREY, alpha=0.15, lw=0)
        if first is None:
            first = ax
            _legend_above(ax)
    if len(shown) < len(estimate.labels):
        figure.supylabel(f"{len(shown)} largest of {len(estimate.labels)} loads", fontsize=9)


def _draw_stack(figure: Figure, estimate: LoadEstimate, truth: NDArray | None, level: float, shown: list[int]) -> None:
    """Panels below each other: of every load the part around its peak, then its whole record."""
    panels = [
        (j, w) for j in shown for w in ([pulse_window(estimate, j)] if pulse_window(estimate, j) else []) + [None]
    ]
    figure.set_size_inches(NARROW, 0.9 + 2.3 * len(panels))
    axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for ax, (j, window) in zip(axes, panels, strict=True):
        draw_load(ax, estimate, j, truth=truth, level=level, window=window)
        part = "around the peak" if window else "whole record"
        ax.set_title(f"{text(estimate.labels[j])}, {part}", loc="left", fontsize=9)
    axes[0].legend(loc="best", fontsize=8, frameon=False)


def _draw_static(ax: Axes, estimate: LoadEstimate, truth: NDArray | None, level: float) -> None:
    x = np.arange(len(estimate.labels))
    lower, upper = estimate.band(level)
    ax.axhline(0, color=GREY, lw=0.6)
    bars = np.stack([estimate.load - lower, upper - estimate.load])
    ax.errorbar(x, estimate.load, bars, fmt="o", color=BLUE, capsize=3, label=f"estimate, {level:.0%} band")
    if truth is not None:
        ax.plot(x, truth, ls="none", marker="D", mfc="none", ms=9, color=INK, label="truth")
    few = range(len(x)) if len(x) <= 24 else range(0, len(x), -(-len(x) // 12))
    names = [text(estimate.labels[i]) for i in few]
    ax.set_xticks(few, names, rotation=45 if max(map(len, names)) * len(few) > 60 else 0)
    units = sorted(set(estimate.units))
    ax.set_ylabel(f"load [{', '.join(unit(u) for u in units)}]")
    ax.legend(fontsize=8)
    _tidy(ax)


# -- the response -----------------------------------------------------------------------------------------------------
def response_figure(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """Measured against predicted response, and what is left, per sensor; below each other where it is narrow."""
    if estimate.response is None or estimate.residual is None or estimate.predicted is None:
        raise InputError("the estimate carries no response", where="plot", hint="use a family that keeps it")
    figure = figure or _figure()
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
    x = estimate.axis.values * _scale(estimate)[0]
    dense = len(x) > _DENSE
    for (left, right), j in zip(grid, shown, strict=True):
        measured, residual = estimate.response[:, j], estimate.residual[:, j]
        # broad and pale under thin and dark: where they agree, both are still seen
        left.plot(x, measured, color=PALE, lw=4.0, label="measured", rasterized=dense)
        left.plot(x, estimate.predicted[:, j], color=ORANGE, lw=0.8, label="predicted", rasterized=dense)
        right.plot(x, residual, color=GREEN, lw=0.7, rasterized=dense)
        norm = float(np.linalg.norm(measured))
        share = f"{np.linalg.norm(residual) / norm:.2%} of the signal" if norm > 0 else "the signal is zero"
        left.set_title(text(estimate.sensors[j]), loc="left", fontsize=9)
        right.set_title(f"residual, {share}", loc="left", fontsize=9)
        left.set_ylabel(f"[{unit(estimate.sensor_units[j])}]")
        for ax in (left, right):
            ax.margins(x=0.01)
            _tidy(ax)
    _legend_above(grid[0][0])
    for ax in grid[-1][1:] if narrow else grid[-1]:
        ax.set_xlabel(_axis_label(estimate))
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
    _tidy(ax)


# -- how lambda was chosen --------------------------------------------------------------------------------------------
def path_figure(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """L-curve, residual and GCV over lambda, with what every rule said; below each other where it is narrow."""
    choice = estimate.choice
    if choice is None or choice.sweep is None:
        raise InputError("the estimate carries no sweep of lambda", where="plot", hint="choose lambda by a rule")
    figure = figure or _figure()
    figure.set_size_inches(*((NARROW, 7.0) if narrow else (10, 4.0)))
    left, right = figure.subplots(2, 1) if narrow else figure.subplots(1, 2)
    sweep = choice.sweep
    left.loglog(sweep.residual_norm, sweep.penalty_norm, color=BLUE, lw=1.3)
    left.set(xlabel="residual norm (whitened)", ylabel="penalty norm")
    left.set_title("L-curve", loc="left", fontsize=9)
    right.loglog(sweep.lam, sweep.residual_norm, color=BLUE, lw=1.3, label="residual norm")
    right.set(xlabel="relative lambda", ylabel="residual norm (whitened)")
    right.set_title(f"verdict: {text(choice.verdict)}", loc="left", fontsize=9)
    for ax in (left, right):
        _tidy(ax)
        for axis in (ax.xaxis, ax.yaxis):
            _few_labels(axis)
    if sweep.gcv is not None:
        twin = right.twinx()
        twin.loglog(sweep.lam, sweep.gcv, color=PURPLE, lw=1.1, ls="--")
        twin.set_ylabel("GCV function (dashed)", color=PURPLE, fontsize=9)
        twin.tick_params(labelsize=8, which="both")
        _few_labels(twin.yaxis)
        twin.spines["top"].set_visible(False)
    for k, (name, lam) in enumerate(_marked(estimate)):
        chosen = k == 0
        style = {"marker": _MARKS[k % len(_MARKS)], "ls": "none", "ms": 10 if chosen else 7, "zorder": 5 - k / 100}
        style |= {"color": ORANGE, "mec": INK} if chosen else {"color": INK, "mfc": "none"}
        r, p = (
            np.exp(np.interp(np.log(lam), np.log(sweep.lam), np.log(np.maximum(v, 1e-300)))) for v in _norms(estimate)
        )
        left.plot([r], [p], label=f"{text(name)}: {lam:.2g}" + (" (used)" if chosen else ""), **style)
        right.plot([lam], [r], **style)
    right.axvline(choice.lam, color=ORANGE, lw=0.9)
    left.legend(fontsize=8)
    mark(figure, estimate)
    return figure


_MARKS = "osD^v<>Ph"


def _norms(estimate: LoadEstimate) -> tuple[NDArray, NDArray]:
    sweep = estimate.choice.sweep  # type: ignore[union-attr]
    return sweep.residual_norm, sweep.penalty_norm  # type: ignore[union-attr]


def _marked(estimate: LoadEstimate) -> list[tuple[str, float]]:
    """The lambda that was used first, then every other rule that answered."""
    choice = estimate.choice
    assert choice is not None
    others = [(r.rule, r.lam) for r in choice.rules if r.lam is not None and r.rule != choice.rule]
    return [(choice.rule, choice.lam), *others]


# -- shared -----------------------------------------------------------------------------------------------------------
def mark(figure: Figure, estimate: LoadEstimate) -> None:
    """Print on the picture what it must not travel without: verification, overridden refusals, flags."""
    words = [
        NOT_VERIFIED if estimate.certificate is None else f"forward model verified {estimate.certificate.date[:10]}"
    ]
    if estimate.allowed:
        words.append(allowed(estimate).replace("overridden refusals", "OVERRIDDEN"))
    found = sorted({f.code for f in sort(estimate.flags) if f.level != "note"})
    words.append("flags: " + (", ".join(c.removeprefix("LID-") for c in found[:14]) or "none"))
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


def _figure(show: bool = False) -> Figure:
    if show:
        from matplotlib import pyplot

        return pyplot.figure(layout="constrained")
    return Figure(layout="constrained")


def _truth(estimate: LoadEstimate, truth: ArrayLike | None) -> NDArray | None:
    if truth is None:
        return None
    array = np.asarray(truth, float)
    array = array[:, None] if array.ndim == 1 and estimate.load.ndim == 2 else array
    if array.shape != estimate.load.shape:
        raise InputError("the known load does not fit", where="truth", found=array.shape, expected=estimate.load.shape)
    return array


def _largest(estimate: LoadEstimate) -> list[int]:
    """Loads to show, in their own order: all, or the largest few."""
    size = np.abs(estimate.load).max(axis=0)
    return sorted(int(j) for j in np.argsort(-size, kind="stable")[:PANELS])


def _scale(estimate: LoadEstimate, window: tuple[float, float] | None = None) -> tuple[float, str]:
    """Factor and unit that make the axis, or a part of it, readable."""
    axis = estimate.axis
    assert axis is not None
    first, last = window or (float(axis.values[0]), float(axis.values[-1]))
    if axis.unit != "s" or last - first >= 1:
        return 1.0, axis.unit
    return (1e3, "ms") if last - first >= 1e-3 else (1e6, "µs")


def _axis_label(estimate: LoadEstimate) -> str:
    assert estimate.axis is not None
    return f"{estimate.axis.name} [{_scale(estimate)[1]}]"


def _tidy(ax: Axes) -> None:
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color="#dddddd", lw=0.5)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8, which="both")
    for axis in (ax.xaxis, ax.yaxis):
        axis.label.set_fontsize(9)


def _few_labels(axis: Any) -> None:
    """Label the decades of a log axis only, where it has two or more of them."""
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    low, high = axis.get_view_interval()
    if high > 30 * low:
        axis.set_minor_formatter(NullFormatter())
        return
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(ScalarFormatter())
    axis.set_minor_formatter(NullFormatter())


def _legend_above(ax: Axes) -> None:
    ax.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, fontsize=8, frameon=False, borderaxespad=0.1)
