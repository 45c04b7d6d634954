"""How lambda was chosen: L-curve, residual and GCV over lambda, with what every rule said."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from loadid.inverse.choice import Choice, Sweep
from structures.errors import InputError

from .style import BLUE, INK, NARROW, ORANGE, PURPLE, few_labels, mark, new_figure, text, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from loadid.estimate import LoadEstimate

_MARKS = "osD^v<>Ph"


def path_figure(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """L-curve, residual and GCV over lambda, with what every rule said; below each other where it is narrow."""
    choice, sweep = _swept(estimate)
    figure = figure or new_figure()
    figure.set_size_inches(*((NARROW, 7.0) if narrow else (10, 4.0)))
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
    figure = _single(figure, narrow)
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
    figure = _single(figure, narrow)
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


def _draw_lcurve(ax: Axes, choice: Choice, sweep: Sweep) -> None:
    ax.loglog(sweep.residual_norm, sweep.penalty_norm, color=BLUE, lw=1.3)
    ax.set(xlabel="residual norm (whitened)", ylabel="penalty norm")
    ax.set_title("L-curve", loc="left", fontsize=9)
    _tidy_logs(ax)
    _mark_rules(ax, choice, sweep.residual_norm, sweep.penalty_norm, sweep.lam)


def _mark_rules(
    ax: Axes, choice: Choice, x: NDArray, y: NDArray, lam: NDArray | None = None, *, legend: bool = True
) -> None:
    """Every rule on a curve: at its lambda, or where the curve over `lam` is at its lambda."""
    for k, (name, value) in enumerate(marked(choice)):
        a = value if lam is None else _on(value, lam, x)
        label = f"{text(name)}: {value:.2g}" + (" (used)" if k == 0 else "")
        ax.plot([a], [_on(value, x if lam is None else lam, y)], label=label, **mark_style(k))
    if legend:
        ax.legend(fontsize=8)


def _on(value: float, lam: NDArray, y: NDArray) -> float:
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


def _swept(estimate: LoadEstimate) -> tuple[Choice, Sweep]:
    choice = estimate.choice
    if choice is None or choice.sweep is None:
        raise InputError("the estimate carries no sweep of lambda", where="plot", hint="choose lambda by a rule")
    return choice, choice.sweep


def _single(figure: Figure | None, narrow: bool) -> Figure:
    figure = figure or new_figure()
    figure.set_size_inches(*((NARROW, 3.8) if narrow else (6.4, 4.2)))
    return figure


def _tidy_logs(ax: Axes) -> None:
    tidy(ax)
    for axis in (ax.xaxis, ax.yaxis):
        few_labels(axis)
