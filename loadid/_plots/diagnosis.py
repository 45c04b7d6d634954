"""What the data can tell: Picard plot, filter factors, resolution matrix, point spreads, columns of the operator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from structures.errors import InputError

from .._results.shown import places
from .choosing import mark_style, marked
from .style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    few_labels,
    mark,
    sized,
    text,
    tidy,
    unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .._inverse.diagnosis.diagnose import Diagnosis
    from .._results.estimate import LoadEstimate

Array = NDArray[Any]


_LINES = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (PURPLE, ":"))


def picard(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """Data coefficients |u_i^T y|, their plateau, and the generalised singular values with the lambda of every rule.

    Raises
    ------
    InputError
        If the estimate carries no diagnosis.
    """
    return _over_modes(estimate, (_draw_picard,), sized(figure, narrow, 4.4, (7.4, 4.6)), narrow)


def filter_factors(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """Share of every mode that comes from the data, and where the other rules would have cut.

    Raises
    ------
    InputError
        If the estimate carries no diagnosis.
    """
    return _over_modes(estimate, (_draw_filter,), sized(figure, narrow, 4.2, (7.4, 4.2)), narrow)


def modes(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """Picard plot and filter factors together, for the report."""
    return _over_modes(estimate, (_draw_picard, _draw_filter), sized(figure, narrow, 8.8, (11, 5.0)), narrow)


def _over_modes(estimate: LoadEstimate, panels: Sequence[Callable[..., None]], figure: Figure, narrow: bool) -> Figure:
    """Panels over the number of the mode, with one legend: the rules have the same marks in all of them."""
    d, count = _diagnosis(estimate), len(panels)
    axes = figure.subplots(count, 1, squeeze=False) if narrow else figure.subplots(1, count, squeeze=False)
    for ax, draw in zip(axes.ravel(), panels, strict=True):
        draw(ax, d, estimate)
    _legend_below(figure, axes.ravel()[0], narrow)
    mark(figure, estimate)
    return figure


def resolution(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """Resolution matrix, and what becomes of single loads: their point spreads, heights and widths.

    Raises
    ------
    InputError
        If the estimate carries no diagnosis.
    """
    d = _diagnosis(estimate)
    panels = 2 if d.matrix is None else 3
    figure = sized(figure, narrow, 3.1 * panels + 0.6, (3.9 * panels, 3.9))
    axes = list(np.atleast_1d(figure.subplots(panels, 1) if narrow else figure.subplots(1, panels)))
    if d.matrix is not None:
        _draw_matrix(figure, axes.pop(0), d)
    _draw_spreads(axes[0], d, estimate)
    _draw_heights(axes[1], d)
    mark(figure, estimate)
    return figure


def columns(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """Columns of the whitened operator, what each of some loads does to the sensors, and their point spreads.

    Raises
    ------
    InputError
        If the estimate carries no diagnosis.
    """
    d = _diagnosis(estimate)
    figure = sized(figure, narrow, 7.0, (10, 4.0))
    left, right = figure.subplots(2, 1) if narrow else figure.subplots(1, 2)
    names = _names(estimate, d.n)
    known = d.sigma is not None
    size, each = _reference(estimate, known)
    for k, j in enumerate(d.shown):
        color, line = _LINES[k % len(_LINES)]
        few = {"marker": "o", "ms": 3} if d.m <= 60 else {}
        y = d.signatures[:, k] * size / (d.sigma if known and d.sigma else 1.0)
        left.plot(np.arange(1, d.m + 1), y, color=color, ls=line, lw=1.2, label=_who(names, d, int(j)), **few)
    left.axhline(0, color=GREY, lw=0.6)
    if known:
        left.axhspan(-1, 1, color=SKY, alpha=0.35, lw=0, label="± noise std")
    left.set(xlabel="datum (sensor)", ylabel=f"response {each}{' / noise std' if known else ''}")
    left.set_title("columns of H: what a load does to the sensors", loc="left", fontsize=9)
    _room(left)
    left.legend(fontsize=7, loc="upper left")
    tidy(left)
    _draw_spreads(right, d, estimate)
    mark(figure, estimate)
    return figure


# -- panels -----------------------------------------------------------------------------------------------------------
def _draw_picard(ax: Axes, d: Diagnosis, estimate: LoadEstimate) -> None:
    i = np.arange(1, len(d.coefficients) + 1)
    twin = ax.twinx()
    ax.set_zorder(twin.get_zorder() + 1)  # the coefficients above the singular values
    ax.patch.set_visible(False)
    shown = np.isfinite(d.generalised) & (d.generalised > 0)
    twin.semilogy(i[shown], d.generalised[shown] / d.scale, color=BLUE, lw=1.3)
    ax.semilogy([], [], color=BLUE, lw=1.3, label="singular value / largest (right)")
    small = 4 if len(i) <= 100 else 2
    positive = d.coefficients > 0
    ax.semilogy(
        i[positive], d.coefficients[positive], ls="none", marker="o", ms=small, color=INK, mfc="none",
        label="data coefficient |u·y|", rasterized=len(i) > 1000,
    )  # fmt: skip
    if d.floor > 0:
        ax.plot([d.plateau + 0.5, i[-1] + 0.5], [d.floor] * 2, color=ORANGE, lw=1.6, label="plateau: noise")
    if d.sigma is not None and 0.1 < d.sigma / max(d.floor, d.sigma * 1e-3) < 10:
        ax.axhline(d.sigma, color=GREY, lw=0.9, ls=":", label="noise level used")
    _mark_plateau(ax, d)
    _mark_lambdas(twin, ax, d, estimate)
    ax.set(xlabel="mode i", ylabel="|u·y| (whitened data)")
    ax.set_title(f"i* = {d.plateau} recoverable modes of {d.seen}", loc="left", fontsize=9)
    twin.set_ylabel("generalised singular value / largest", color=BLUE, fontsize=9)
    twin.tick_params(labelsize=8, which="both")
    twin.spines["top"].set_visible(False)
    _floor(ax, d.coefficients)
    _floor(twin, d.generalised[shown] / d.scale)
    tidy(ax)
    few_labels(ax.yaxis)
    few_labels(twin.yaxis)


def _draw_filter(ax: Axes, d: Diagnosis, estimate: LoadEstimate) -> None:
    i = np.arange(1, len(d.filter_factors) + 1)
    style: dict[str, Any] = {"marker": "o", "ms": 3} if len(i) <= 100 else {}
    ax.plot(i, d.filter_factors, color=BLUE, lw=1.3, label="filter factor at the lambda used", **style)
    ax.fill_between(i, 0, d.filter_factors, color=SKY, alpha=0.3, lw=0)
    _mark_plateau(ax, d)
    if estimate.choice is not None:
        for k, (name, lam) in enumerate(marked(estimate.choice)):
            label = f"{text(name)}: {lam:.2g}" + (" (used)" if k == 0 else "")
            ax.plot([_crossing(d, lam)], [0.5], label=label, clip_on=False, **mark_style(k))
    ax.set(xlabel="mode i", ylabel="share that comes from the data", ylim=(0, 1.05))
    ax.set_title(f"filter factors; their sum is {np.sum(d.filter_factors):.3g} per frame", loc="left", fontsize=9)
    tidy(ax)


def _draw_matrix(figure: Figure, ax: Axes, d: Diagnosis) -> None:
    assert d.matrix is not None
    top = float(np.abs(d.matrix).max()) or 1.0
    edge = (0.5, d.n + 0.5)
    image = ax.imshow(
        d.matrix, cmap="RdBu_r", vmin=-top, vmax=top, extent=(*edge, *edge[::-1]), interpolation="nearest"
    )
    bar = figure.colorbar(image, ax=ax, shrink=0.8)
    bar.ax.tick_params(labelsize=8)
    bar.set_label("shown per unit load", fontsize=8)
    ax.set(xlabel="load that acts", ylabel="load that is shown")
    ax.set_title(f"resolution matrix at lambda {d.lam:.2g}, i* = {d.plateau}", loc="left", fontsize=9)
    tidy(ax)
    ax.grid(False)


def _draw_spreads(ax: Axes, d: Diagnosis, estimate: LoadEstimate) -> None:
    names = _names(estimate, d.n)
    known = places(estimate.geometry)
    if known is not None and known[0].shape[1] == 2 and d.n % len(known[0]) == 0:
        _draw_distances(ax, d, names, known[0])
        return
    x, label = _abscissa(estimate, d.n)
    for k, j in enumerate(d.shown):
        color, line = _LINES[k % len(_LINES)]
        many = len(x) > 60
        ax.plot(
            x, d.point_spreads[:, k], color=color, ls=line, lw=1.2, marker=None if many else "o", ms=2.5,
            label=f"{_who(names, d, int(j))}: {_width(d, int(j))}",
        )  # fmt: skip
        ax.plot([x[j]], [d.point_spreads[j, k]], marker="v", color=color, ms=6, ls="none")
    ax.axhline(0, color=GREY, lw=0.6)
    _room(ax)
    ax.set(xlabel=label, ylabel="shown per unit load")
    ax.set_title("point spreads: what is shown of one load", loc="left", fontsize=9)
    ax.legend(fontsize=7, loc="upper left")
    tidy(ax)


def _draw_distances(ax: Axes, d: Diagnosis, names: list[str], x: Array) -> None:
    """Point spreads over a surface: what is shown in the same direction, over the distance from the load."""
    count = d.n // len(x)
    for k, j in enumerate(d.shown):
        away = np.linalg.norm(x - x[j // count], axis=1)
        shown = d.point_spreads[j % count :: count, k]
        label = f"{_who(names, d, int(j))}: {_width(d, int(j))}"
        ax.plot(away, shown, marker="osD^"[k % 4], ms=4, mfc="none", color=_LINES[k % 4][0], ls="none", label=label)
    ax.axhline(0, color=GREY, lw=0.6)
    _room(ax)
    ax.set(xlabel="distance from the load [m]", ylabel="shown per unit load")
    ax.set_title("point spreads: what is shown of one load", loc="left", fontsize=9)
    ax.legend(fontsize=7, loc="upper left")
    tidy(ax)


def _draw_heights(ax: Axes, d: Diagnosis) -> None:
    ax.plot(np.arange(1, d.n + 1), d.heights, color=BLUE, lw=1.2, label="height left in place")
    talk = np.minimum(d.cross_talk, 10.0)
    ax.plot(d.columns + 1, talk, color=ORANGE, lw=1.0, ls="--", label="cross-talk / height")
    ax.axhline(0, color=GREY, lw=0.6)
    ax.plot([d.worst + 1], [d.heights[d.worst]], marker="v", color=BLUE, ls="none", label="worst load")
    ax.set(xlabel="load", ylabel="share")
    ax.set_ylim(min(0.0, float(d.heights.min())), max(1.05, float(min(talk.max(initial=0.0), 2.0))))
    twin = ax.twinx()
    twin.plot(d.columns + 1, d.widths, color=GREEN, lw=1.0, ls=":")
    ax.plot([], [], color=GREEN, ls=":", label="width (right)")
    twin.set_ylabel(f"full width at half maximum [{d.width_unit}]", color=GREEN, fontsize=9)
    twin.tick_params(labelsize=8)
    twin.spines["top"].set_visible(False)
    ax.set_title("every load", loc="left", fontsize=9)
    _room(ax)
    twin.set_ylim(0, 1.5 * float(d.widths.max()))
    ax.legend(fontsize=6.5, ncols=2, loc="upper left", handlelength=1.6, columnspacing=1.0)
    tidy(ax)


# -- marks ------------------------------------------------------------------------------------------------------------
def _mark_plateau(ax: Axes, d: Diagnosis) -> None:
    ax.axvline(d.plateau + 0.5, color=ORANGE, lw=1.0, ls="--", label=f"i* = {d.plateau}")


def _mark_lambdas(twin: Axes, ax: Axes, d: Diagnosis, estimate: LoadEstimate) -> None:
    """Every rule where the generalised singular values fall to its lambda."""
    if estimate.choice is None:
        return
    for k, (name, lam) in enumerate(marked(estimate.choice)):
        label = f"{text(name)}: {lam:.2g}" + (" (used)" if k == 0 else "")
        if lam > 0:
            twin.plot([_crossing(d, lam)], [lam], **mark_style(k))
        ax.plot([], [], label=label, **mark_style(k))
    if estimate.choice.lam > 0:
        twin.axhline(estimate.choice.lam, color=BLUE, lw=0.8, ls=":")


def _crossing(d: Diagnosis, lam: float) -> float:
    """Mode number at which the generalised singular values fall to a relative lambda, interpolated in logs."""
    gamma = d.generalised / d.scale
    falling = np.flatnonzero(np.isfinite(gamma) & (gamma > 0))
    if len(falling) == 0 or lam <= 0:
        return float(d.seen)
    order = falling[::-1]  # np.interp wants rising abscissas
    return float(np.interp(np.log(lam), np.log(gamma[order]), order + 1.0))


def _floor(ax: Axes, values: Array) -> None:
    """End a log axis where rounding begins."""
    top = float(values.max(initial=0.0))
    if top > 0 and values.min(initial=np.inf) < 1e-17 * top:
        ax.set_ylim(1e-17 * top, None)


def _legend_below(figure: Figure, ax: Axes, narrow: bool) -> None:
    figure.legend(
        *ax.get_legend_handles_labels(),
        loc="outside lower left",
        ncols=2 if narrow else 3,
        fontsize=6 if narrow else 7,
        columnspacing=1.0,
    )


def _room(ax: Axes) -> None:
    """Room for a legend at the top."""
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.4 * (high - low))


# -- names ------------------------------------------------------------------------------------------------------------
def _diagnosis(estimate: LoadEstimate) -> Diagnosis:
    d = estimate.diagnosis
    if d is None:
        raise InputError(
            "the estimate carries no diagnosis", where="plot",
            hint="estimates of StaticInversion carry one; histories show theirs by plot('path')",
        )  # fmt: skip
    found: Diagnosis = d
    return found


def _names(estimate: LoadEstimate, n: int) -> list[str]:
    if len(estimate.labels) == n:
        return [text(label) for label in estimate.labels]
    return [f"load {j + 1}" for j in range(n)]


def _reference(estimate: LoadEstimate, known: bool) -> tuple[float, str]:
    """Size of the load that is shown, and its words: the largest of the estimate beside a noise std, else one unit."""
    units = {unit(u) for u in estimate.units}
    if len(units) != 1:
        return 1.0, "per unit load"
    word, size = units.pop(), float(np.abs(estimate.load).max())
    if not known or size == 0:
        return 1.0, f"per {word}"
    return size, f"to {size:.3g} {word}"


def _who(names: list[str], d: Diagnosis, j: int) -> str:
    roles = {"largest": d.load, "worst seen": d.worst, "best seen": int(np.argmax(d.heights))}
    role = [word for word, k in roles.items() if k == j]
    return f"{names[j]} ({', '.join(role)})" if role else names[j]


def _width(d: Diagnosis, j: int) -> str:
    found = d.widths[d.columns == j]
    return f"width {found[0]:.3g} {d.width_unit}" if len(found) else ""


def _abscissa(estimate: LoadEstimate, n: int) -> tuple[NDArray[np.float64], str]:
    """Place of each load on a line, or its number."""
    known = places(estimate.geometry)
    if known is not None and known[0].shape == (n, 1):
        return known[0][:, 0], f"{known[1][0]} [m]"
    return np.arange(1, n + 1, dtype=float), "load"
