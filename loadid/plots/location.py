"""Pictures of a search for the place of a load: residual over the places, and over the candidates."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import reals

from .style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, few_labels, new_figure, save, text, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from loadid.location import LocationResult

KINDS = ("map", "residual")
NAMED = 25  # candidates whose names fit below a picture
ELLIPSE = 2.448  # standard deviations of the 95 % ellipse in two dimensions
AMBIGUOUS = 1.05


def draw(
    result: LocationResult,
    kind: str = "map",
    *,
    truth: ArrayLike | None = None,
    path: str | os.PathLike | None = None,
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
    if path is not None:
        save(figure, path)
    if show:
        figure.canvas.manager.show()  # type: ignore[union-attr]
    return figure


def draw_map(ax: Axes, result: LocationResult, *, load: int = 0, truth: ArrayLike | None = None) -> None:
    """Residual over the places of the candidates: a line along one coordinate, coloured candidates over two."""
    if result.places is None:
        raise InputError(
            "the places of the candidates are not known", where="plot", found="labels alone",
            expected="a model that knows its places", hint="LocationSearch(..., places=), or kind='residual'",
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


def _line(ax: Axes, result: LocationResult, load: int, axis: int, truth: NDArray | None) -> None:
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


def _surface(ax: Axes, result: LocationResult, load: int, axes: list[int], truth: NDArray | None) -> None:
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


def _used(places: NDArray) -> list[int]:
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
