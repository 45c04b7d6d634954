"""Pictures of choices: lambda by every rule, the place of a load, the noise of a tracked load."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, reals

from .._inverse.choice import Choice, PathCurve
from .style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    few_labels,
    finished,
    mark,
    new_figure,
    sized,
    text,
    tidy,
    unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .._results.estimate import LoadEstimate
    from .._results.location import LocationResult

Array = NDArray[Any]


_MARKS = "osD^v<>Ph"


def path_figure(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """L-curve, residual and GCV over lambda, with what every rule said; below each other where it is narrow."""
    choice, sweep = _swept(estimate)
    figure = sized(figure, narrow, 7.0, (10, 4.0))
    left, right = figure.subplots(2, 1) if narrow else figure.subplots(1, 2)
    _draw_lcurve(left, choice, sweep)
    right.loglog(sweep.lam, sweep.residual_norm, color=BLUE, lw=1.3, label="residual norm")
    right.set(xlabel="relative lambda", ylabel="residual norm (whitened)")
    right.set_title(f"verdict: {text(choice.verdict)}", loc="left", fontsize=9)
    _tidy_logs(right)
    if sweep.gcv is not None:
        twin = right.twinx()
        twin.loglog(sweep.lam, sweep.gcv, color=PURPLE, lw=1.1, ls="--")
        twin.set_ylabel("GCV function (dashed)", color=PURPLE, fontsize=9)
        twin.tick_params(labelsize=8, which="both")
        few_labels(twin.yaxis)
        twin.spines["top"].set_visible(False)
    _mark_rules(right, choice, sweep.lam, sweep.residual_norm, legend=False)
    right.axvline(choice.lam, color=ORANGE, lw=0.9)
    mark(figure, estimate)
    return figure


def lcurve(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """L-curve: penalty norm over residual norm, with the lambda of every rule on it.

    Raises
    ------
    InputError
        If the estimate carries no sweep of lambda.
    """
    choice, sweep = _swept(estimate)
    figure = sized(figure, narrow, 3.8, (6.4, 4.2))
    ax = figure.subplots()
    _draw_lcurve(ax, choice, sweep)
    if (last := _plateau(estimate)) is not None:
        at = [_on(last, sweep.lam, sweep.residual_norm)], [_on(last, sweep.lam, sweep.penalty_norm)]
        ax.plot(*at, marker="|", ms=16, mew=1.5, color=ORANGE, ls="none", label=_last(estimate))
        ax.legend(fontsize=8)
    mark(figure, estimate)
    return figure


def gcv(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """GCV function over lambda, with the lambda of every rule on it.

    Raises
    ------
    InputError
        If the estimate carries no GCV function.
    """
    choice, sweep = _swept(estimate)
    if sweep.gcv is None:
        raise InputError("the estimate carries no GCV function", where="plot", hint="choose lambda on a path with edf")
    figure = sized(figure, narrow, 3.8, (6.4, 4.2))
    ax = figure.subplots()
    ax.loglog(sweep.lam, sweep.gcv, color=PURPLE, lw=1.3, label="GCV function")
    ax.set(xlabel="relative lambda", ylabel="GCV function (whitened data, squared)")
    ax.set_title(f"verdict: {text(choice.verdict)}", loc="left", fontsize=9)
    _tidy_logs(ax)
    _mark_rules(ax, choice, sweep.lam, sweep.gcv)
    ax.axvline(choice.lam, color=ORANGE, lw=0.9)
    if (last := _plateau(estimate)) is not None:
        ax.axvline(last, color=ORANGE, lw=1.0, ls="--", label=_last(estimate))
        ax.legend(fontsize=8)
    mark(figure, estimate)
    return figure


def marked(choice: Choice) -> list[tuple[str, float]]:
    """The lambda that was used first, then every other rule that answered."""
    others = [(r.rule, r.lam) for r in choice.rules if r.lam is not None and r.rule != choice.rule]
    return [(choice.rule, choice.lam), *others]


def mark_style(k: int) -> dict[str, Any]:
    """Marker of the k-th rule; the first is the lambda that was used."""
    style: dict[str, Any] = {"marker": _MARKS[k % len(_MARKS)], "ls": "none", "ms": 10 if k == 0 else 7}
    style["zorder"] = 5 - k / 100
    return style | ({"color": ORANGE, "mec": INK} if k == 0 else {"color": INK, "mfc": "none"})


def _draw_lcurve(ax: Axes, choice: Choice, sweep: PathCurve) -> None:
    ax.loglog(sweep.residual_norm, sweep.penalty_norm, color=BLUE, lw=1.3)
    ax.set(xlabel="residual norm (whitened)", ylabel="penalty norm")
    ax.set_title("L-curve", loc="left", fontsize=9)
    _tidy_logs(ax)
    _mark_rules(ax, choice, sweep.residual_norm, sweep.penalty_norm, sweep.lam)


def _mark_rules(ax: Axes, choice: Choice, x: Array, y: Array, lam: Array | None = None, *, legend: bool = True) -> None:
    """Every rule on a curve: at its lambda, or where the curve over `lam` is at its lambda."""
    for k, (name, value) in enumerate(marked(choice)):
        a = value if lam is None else _on(value, lam, x)
        label = f"{text(name)}: {value:.2g}" + (" (used)" if k == 0 else "")
        ax.plot([a], [_on(value, x if lam is None else lam, y)], label=label, **mark_style(k))
    if legend:
        ax.legend(fontsize=8)


def _on(value: float, lam: Array, y: Array) -> float:
    """Height of a curve over log lambda, interpolated in logs; lambda 0 is at its left end."""
    at = np.log(max(value, float(lam[0])))
    return float(np.exp(np.interp(at, np.log(lam), np.log(np.maximum(y, 1e-300)))))


def _plateau(estimate: LoadEstimate) -> float | None:
    """Relative generalised singular value of the last recoverable mode, where it is finite."""
    d = estimate.diagnosis
    if d is None or d.plateau < 1:
        return None
    last = float(d.generalised[d.plateau - 1] / d.scale)
    return last if 0 < last < np.inf else None


def _last(estimate: LoadEstimate) -> str:
    return f"singular value of mode i* = {estimate.diagnosis.plateau}"


def _swept(estimate: LoadEstimate) -> tuple[Choice, PathCurve]:
    choice = estimate.choice
    if choice is None or choice.sweep is None:
        raise InputError("the estimate carries no sweep of lambda", where="plot", hint="choose lambda by a rule")
    return choice, choice.sweep


def _tidy_logs(ax: Axes) -> None:
    tidy(ax)
    for axis in (ax.xaxis, ax.yaxis):
        few_labels(axis)


KINDS = ("map", "residual")
NAMED = 25  # candidates whose names fit below a picture
ELLIPSE = 2.448  # standard deviations of the 95 % ellipse in two dimensions
AMBIGUOUS = 1.05


def draw(
    result: LocationResult,
    kind: str = "map",
    *,
    truth: ArrayLike | None = None,
    path: str | os.PathLike[str] | None = None,
    show: bool = False,
) -> Figure:
    """Figure of a search; see `LocationResult.plot`.

    Raises
    ------
    InputError
        An unknown kind, a map of candidates without places, or known places that do not fit.
    """
    if kind not in KINDS:
        raise InputError("no such picture", where="plot", found=repr(kind), expected=f"one of {', '.join(KINDS)}")
    figure = new_figure(show)
    loads = len(result.best)
    figure.set_size_inches(6.4 if loads == 1 else min(5.0 * loads, 15.0), 4.6)
    for k, ax in enumerate(np.atleast_1d(figure.subplots(1, loads))):
        if kind == "map":
            draw_map(ax, result, load=k, truth=truth)
        else:
            draw_residual(ax, result, load=k)
    warned = sorted(result.codes & {"W511", "E512"})
    words = ["ambiguous: " + ", ".join(warned) if warned else "one place stands out"]
    words.append(f"runner-up / best {result.ratio:.3f}")
    figure.suptitle("  |  ".join(words), fontsize=8, color=ORANGE if warned else INK, x=0.01, ha="left")
    return finished(figure, path, show)


def draw_map(ax: Axes, result: LocationResult, *, load: int = 0, truth: ArrayLike | None = None) -> None:
    """Residual over the places of the candidates: a line along one coordinate, coloured candidates over two."""
    if result.places is None:
        raise InputError(
            "the places of the candidates are not known", where="plot", found="labels alone",
            expected="a model that knows its places",
            hint="LocationSearch(..., search=Search(places=...)), or kind='residual'",
        )  # fmt: skip
    used = _used(result.places)
    known = None if truth is None else _known(truth, result.places.shape[1])
    if len(used) == 1:
        _line(ax, result, load, used[0], known)
    else:
        _surface(ax, result, load, used[:2], known)


def draw_residual(ax: Axes, result: LocationResult, *, load: int = 0) -> None:
    """Residual of the candidates from best to worst, with the line below which a runner-up makes it ambiguous."""
    score = result.scores[load]
    order = np.argsort(score, kind="stable")[:NAMED]
    at = np.arange(len(order))
    ax.plot(at, score[order], "o", color=BLUE, ms=5)
    ax.axhline(AMBIGUOUS * score[order[0]], color=GREY, lw=0.8, ls="--", label="1.05 times the best")
    ax.set_xticks(at, [text(result.labels[j]) for j in order], rotation=90, fontsize=7)
    ax.set_yscale("log")
    few_labels(ax.yaxis)
    ax.set_ylabel("residual over data")
    if len(score) > len(order):
        ax.set_xlabel(f"the best {len(order)} of {len(score)} candidates")
    ax.legend(fontsize=8, frameon=False, loc="lower right")
    tidy(ax)


def _line(ax: Axes, result: LocationResult, load: int, axis: int, truth: Array | None) -> None:
    assert result.places is not None
    x = result.places[:, axis]
    order = np.argsort(x)
    ax.plot(x[order], result.scores[load][order], "o-", color=BLUE, ms=4, lw=1, label="candidates")
    if result.found is not None:
        spread = 0.0 if result.std is None else 1.96 * float(result.std[load, axis])
        at = float(result.found[load, axis])
        if spread > 0 and np.isfinite(spread):
            ax.axvspan(at - spread, at + spread, color=ORANGE, alpha=0.25, lw=0)
        ax.axvline(at, color=ORANGE, lw=1.5, label="found" + (" ± 95 %" if spread > 0 else ""))
    for k, p in enumerate([] if truth is None else truth):
        ax.axvline(p[axis], color=INK, lw=1, ls="--", label="true" if k == 0 else None)
    for k, r in enumerate(r for r in result.rivals if r.load == load):
        ax.axvline(r.place[axis], color=PURPLE, lw=1, ls=":", label="other places" if k == 0 else None)
    seen = result.geometry.get("sensors")
    if seen is not None and seen.shape[1] > axis:
        ax.plot(seen[:, axis], np.zeros(len(seen)), "^", color=GREEN, ms=8, clip_on=False, label="sensors")
    ax.set_ylim(bottom=0)
    ax.set(xlabel=f"{'xyz'[axis]} [m]", ylabel="residual over data")
    tidy(ax)
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=5, fontsize=8, frameon=False)


def _surface(ax: Axes, result: LocationResult, load: int, axes: list[int], truth: Array | None) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.patches import Ellipse

    assert result.places is not None
    x, score = result.places[:, axes], result.scores[load]
    floor = max(float(score.min()), 1e-12 * float(score.max()))
    drawn = ax.scatter(
        x[:, 0], x[:, 1], c=np.maximum(score, floor), s=90, marker="s", cmap="viridis_r", lw=0,
        norm=LogNorm(floor, max(float(score.max()), 1.001 * floor)),
    )  # fmt: skip
    bar = ax.get_figure(root=True).colorbar(drawn, ax=ax, shrink=0.8)  # type: ignore[union-attr]
    bar.set_label("residual over data", fontsize=9)
    few_labels(bar.ax.yaxis)
    seen = result.geometry.get("sensors")
    if seen is not None and seen.shape[1] > max(axes):
        ax.plot(*seen[:, axes].T, "^", color=GREEN, ms=8, label="sensors")
    if truth is not None:
        ax.plot(*truth[:, axes].T, "o", mfc="none", mec=INK, ms=13, mew=1.2, label="true")
    rivals = np.array([r.place for r in result.rivals if r.load == load])
    if len(rivals):
        ax.plot(*rivals[:, axes].T, "x", color=PURPLE, ms=7, label="other places")
    if result.found is not None:
        ax.plot(*result.found[load, axes], "+", color=ORANGE, ms=14, mew=2, label="found")
        if result.covariance is not None and np.all(np.isfinite(result.covariance[load])):
            size, turn = np.linalg.eigh(result.covariance[load][np.ix_(axes, axes)])
            width, height = 2 * ELLIPSE * np.sqrt(np.maximum(size, 0.0))
            angle = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
            centre = (float(result.found[load, axes[0]]), float(result.found[load, axes[1]]))
            ax.add_patch(Ellipse(centre, width, height, angle=angle, fc="none", ec=ORANGE))
    outline = result.geometry.get("outline")
    if outline is not None and outline.shape[1] > max(axes):
        ends = outline[:, axes]
        ax.set_xlim(ends[:, 0].min(), ends[:, 0].max())
        ax.set_ylim(ends[:, 1].min(), ends[:, 1].max())
    ax.set_aspect("equal")
    ax.set(xlabel=f"{'xyz'[axes[0]]} [m]", ylabel=f"{'xyz'[axes[1]]} [m]")
    ax.tick_params(labelsize=8)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=4, fontsize=8, frameon=False)


def _used(places: Array) -> list[int]:
    """Coordinates in which the candidates differ."""
    extent = np.ptp(places, axis=0)
    return [int(i) for i in np.flatnonzero(extent > 1e-6 * extent.max())]


def _known(truth: ArrayLike, dim: int) -> NDArray[np.float64]:
    at = reals(truth, what="the known places are no real numbers", where="truth")
    at = at.reshape(-1, dim) if at.ndim < 2 and at.size % dim == 0 else at
    if at.ndim != 2 or at.shape[1] != dim or not np.all(np.isfinite(at)):
        raise InputError("the known places do not fit", where="truth", found=f"shape {at.shape}",
                         expected=f"(loads, {dim}), finite, in m")  # fmt: skip
    return at


class Swept(Protocol):
    """What a picture asks of a sweep (`loadid._families.tracking.sweep.QSweep`)."""

    @property
    def factors(self) -> NDArray[np.float64]:
        """On the std of the loads."""

    @property
    def residual(self) -> NDArray[np.float64]:
        """What is left of the data, over noise."""

    @property
    def roughness(self) -> NDArray[np.float64]:
        """Steps of the loads."""

    @property
    def nis(self) -> NDArray[np.float64]:
        """Per channel."""

    @property
    def loglik(self) -> NDArray[np.float64]:
        """Of every point."""

    @property
    def corner(self) -> int | None:
        """Its point."""

    @property
    def plateau(self) -> int:
        """First point of it."""

    @property
    def likely(self) -> int:
        """Point of the likelihood."""


def tracked_figure(labels: Sequence[str], units: Sequence[str], times: Array, bins: Array, note: str = "") -> Figure:
    """Loads with their bands over a whole stream.

    Parameters
    ----------
    labels, units : sequence of str
        Of the loads; the largest six are drawn.
    times : array, shape (bins,)
    bins : array, shape (bins, 4, loads)
        Mean, lower and upper end of the 95 % band, mean std of every stretch of time.
    note : str
        What the picture must not travel without: flags, counts.
    """
    size = np.abs(bins[:, 0]).max(axis=0) if len(bins) else np.zeros(len(labels))
    shown = sorted(int(j) for j in np.argsort(-size, kind="stable")[:6])
    figure = new_figure()
    figure.set_size_inches(9.0, 0.9 + 2.2 * len(shown))
    axes = figure.subplots(len(shown), 1, squeeze=False, sharex=True)[:, 0]
    for ax, j in zip(axes, shown, strict=True):
        ax.fill_between(times, bins[:, 1, j], bins[:, 2, j], color=SKY, alpha=0.45, lw=0, label="95 % band")
        ax.plot(times, bins[:, 0, j], color=BLUE, lw=1.0, label="load")
        ax.axhline(0, color=INK, lw=0.5)
        ax.set_ylabel(f"{text(labels[j])} [{unit(units[j])}]")
        tidy(ax)
    axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, fontsize=8, frameon=False, borderaxespad=0.1)
    axes[-1].set_xlabel("time [s]")
    if note:
        lines = "\n".join(textwrap.wrap(note, 120))
        figure.suptitle(lines, fontsize=8, color=INK, x=0.01, ha="left")
    return figure


def sweep_figure(sweep: Swept) -> Figure:
    """L-curve of the variance of the loads, and what the innovations say of it.

    Left: what the loads leave of the data against how rough they are; right: NIS per channel and the likelihood below
    its largest, over the std of the loads.
    """
    figure = new_figure()
    figure.set_size_inches(9.0, 3.8)
    left, right = figure.subplots(1, 2)
    left.loglog(sweep.residual, sweep.roughness, ".-", color=BLUE, lw=1.0, ms=4)
    right.semilogx(sweep.factors, sweep.nis, ".-", color=BLUE, lw=1.0, ms=4, label="NIS per channel")
    right.axhline(1.0, color=GREY, lw=0.8)
    right.set_yscale("log")
    points = {"likelihood": (sweep.likely, GREEN, "o"), "corner": (sweep.corner, ORANGE, "s")}
    if sweep.corner is None:
        points["one arm: alike from here on"] = (sweep.plateau, ORANGE, "s")
    for name, (k, color, shape) in points.items():
        if k is not None:
            style = {"color": color, "marker": shape, "ms": 8, "mfc": "none", "mew": 1.8, "ls": "none", "label": name}
            left.plot(sweep.residual[k], sweep.roughness[k], **style)
            right.plot(sweep.factors[k], sweep.nis[k], **style | {"label": None})
    lost = right.twinx()
    lost.semilogx(sweep.factors, sweep.loglik - sweep.loglik.max(), color=INK, lw=1.0, ls="--")
    lost.set_yscale("symlog", linthresh=10.0)
    lost.set_ylabel("log-likelihood below its largest (dashed)", fontsize=9)
    lost.tick_params(labelsize=8)
    left.set(xlabel="rms of what is left of the data, over noise", ylabel="rms step of the loads [of the likelihood's]")
    right.set(xlabel="factor on the std of the loads", ylabel="NIS per channel")
    for ax in (left, right):
        tidy(ax)
    left.legend(loc="best", fontsize=8, frameon=False)
    return figure
