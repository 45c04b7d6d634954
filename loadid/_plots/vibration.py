"""Pictures of the vibration laboratory: targets with their tolerance, predicted responses, drives, errors."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    PURPLE,
    SKY,
    few_labels,
    finished,
    mark,
    new_figure,
    text,
    tidy,
    unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..vibration._drives import Drives
    from ..vibration._paths import TransferPaths

COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY, GREY)
SHOWN = 4  # sensors, the worst first


def draw_drives(drives: Drives, *, path: str | os.PathLike[str] | None = None, show: bool = False) -> Figure:
    """Figure of drives; see `Drives.plot`."""
    error = np.sqrt(np.mean(drives.error**2, axis=0))
    worst = [int(i) for i in np.sort(np.argsort(-error, kind="stable")[:SHOWN])]
    rows = max((len(worst) + 1) // 2, 1)
    figure = new_figure(show)
    figure.set_size_inches(10, 2.4 * (rows + 1) + 0.6)
    grid = figure.subplots(rows + 1, 2, squeeze=False)
    for ax, i in zip(grid[:rows].ravel(), worst, strict=False):
        _response(ax, drives, i, error[i])
    for ax in grid[:rows].ravel()[len(worst) :]:
        ax.set_axis_off()
    _levels(grid[rows, 0], drives)
    _errors(grid[rows, 1], drives)
    codes = ", ".join(dict.fromkeys(f.code.removeprefix("LID-") for f in drives.flags)) or "none"
    figure.suptitle(
        f"{drives.kind} drives: {drives.rms_error:.2f} dB rms, {drives.within:.0%} within {drives.tolerance:g} dB  |  "
        f"flags: {codes}", fontsize=9, x=0.01, ha="left", color=INK,
    )  # fmt: skip
    return finished(figure, path, show)


def _response(ax: Axes, drives: Drives, i: int, rms: float) -> None:
    """One sensor: target with its tolerance, prediction with what errors of the FRFs make of it."""
    f, target, made, std = drives.frequencies, drives.target[:, i], drives.response[:, i], drives.std[:, i]
    factor = 10 ** (drives.tolerance / (10 if drives.kind == "random" else 20))
    ax.fill_between(f, target / factor, target * factor, color=PALE, alpha=0.45, lw=0,
                    label=f"target, ±{drives.tolerance:g} dB")  # fmt: skip
    ax.fill_between(f, np.maximum(made - 2 * std, made / 100), made + 2 * std, color=ORANGE, alpha=0.25, lw=0)
    ax.plot(f, target, color=BLUE, lw=1)
    ax.plot(f, made, color=ORANGE, lw=1, label="predicted, ±2 std")
    c = drives.sensors[i]
    ax.set_title(f"{text(c.label)}: {rms:.2f} dB rms", loc="left", fontsize=9)
    _frame(ax, drives, c.unit)
    ax.legend(fontsize=7, frameon=False, loc="best")


def _levels(ax: Axes, drives: Drives) -> None:
    """The drives, each with its own limit on the lines."""
    f, level, most = drives.frequencies, drives.level, _own_limits(drives)
    for j, c in enumerate(drives.loads[: len(COLOURS)]):
        ax.plot(f, np.maximum(level[:, j], 1e-30), color=COLOURS[j], lw=1, label=text(c.label))
        if j in most:
            ax.plot(f, most[j], color=COLOURS[j], lw=0.8, ls="--")
    ax.set_title("drives; dashed: limits on lines", loc="left", fontsize=9)
    top = float(level.max())
    ax.set_ylim(top * 1e-6 if drives.kind == "random" else top * 1e-3, top * 4)
    _frame(ax, drives, drives.loads[0].unit)
    ax.legend(fontsize=7, frameon=False, loc="best", ncols=2)


def _own_limits(drives: Drives) -> dict[int, NDArray[Any]]:
    """Load -> its limit on the lines, where it has one."""
    found: dict[int, NDArray[Any]] = {}
    for row, most in zip(drives.caps, drives.most, strict=True):
        single = np.count_nonzero(row[0]) == 1 and np.all(row == row[0])
        if single and np.any(np.isfinite(most)):
            j = int(np.argmax(np.abs(row[0])))
            found[j] = np.where(np.isfinite(most), most if drives.kind == "random" else np.sqrt(most), np.nan)
    return found


def _errors(ax: Axes, drives: Drives) -> None:
    """Error over the lines: of every sensor, and the rms with and without limits."""
    f, error = drives.frequencies, drives.error
    ax.axhspan(-drives.tolerance, drives.tolerance, color=PALE, alpha=0.3, lw=0)
    ax.plot(f, error, color=GREY, lw=0.5, alpha=0.6)
    ax.plot(f, np.sqrt(np.mean(error**2, axis=1)), color=ORANGE, lw=1.3, label="rms of the sensors")
    if drives.limits:
        ax.plot(f, np.sqrt(np.mean(drives.free**2, axis=1)), color=INK, lw=1, ls=":", label="rms without limits")
    ax.set_title("error of the predicted response; grey: each sensor", loc="left", fontsize=9)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel("dB")
    _log(ax, f)
    tidy(ax)
    ax.legend(fontsize=7, frameon=False, loc="best")


def _frame(ax: Axes, drives: Drives, of: str) -> None:
    ax.set_yscale("log")
    squared = f"({of})²/Hz" if "/" in of else f"{of}²/Hz"
    ax.set_ylabel(f"[{unit(squared if drives.kind == 'random' else of)}]")
    ax.set_xlabel("frequency [Hz]")
    _log(ax, drives.frequencies)
    few_labels(ax.yaxis)
    tidy(ax)


def _log(ax: Axes, f: NDArray[Any]) -> None:
    if len(f) > 1 and f[0] > 0 and f[-1] > 8 * f[0]:
        ax.set_xscale("log")
        few_labels(ax.xaxis)
    if len(f) > 1:
        ax.set_xlim(float(f[0]), float(f[-1]))


# -- transfer paths ----------------------------------------------------------------------------------------------------
RANKED = 8  # blocked forces in a ranking


def draw_paths(paths: TransferPaths, *, path: str | os.PathLike[str] | None = None, show: bool = False) -> Figure:
    """Figure of a transfer path analysis; see `TransferPaths.plot`."""
    figure = new_figure(show)
    figure.set_size_inches(10, 7)
    grid = figure.subplots(2, 2)
    _forces(grid[0, 0], paths, turning=False)
    _forces(grid[0, 1], paths, turning=True)
    _predicted(grid[1, 0], paths)
    _ranking(grid[1, 1], paths)
    mark(figure, paths.estimate)
    return finished(figure, path, show)


def _forces(ax: Axes, paths: TransferPaths, *, turning: bool) -> None:
    """Sizes of the blocked forces, or of the moments, with their 95 % band."""
    e = paths.estimate
    assert e.axis is not None
    f, size = e.axis.values, np.abs(e.load)
    moments = ["m" in u.replace("m/s", "").split("^2/Hz")[0] for u in e.units]
    chosen = [j for j in range(size.shape[1]) if moments[j] == turning]
    if not chosen:
        ax.set_axis_off()
        return
    top = size[:, chosen].max()
    for rank, j in enumerate(sorted(chosen, key=lambda j: -float(size[:, j].max()))[: len(COLOURS)]):
        ax.fill_between(f, np.maximum(size[:, j] - 2 * e.std[:, j], top * 1e-9), size[:, j] + 2 * e.std[:, j],
                        color=COLOURS[rank], alpha=0.2, lw=0)  # fmt: skip
        ax.plot(f, size[:, j], color=COLOURS[rank], lw=1, label=text(e.labels[j]))
    ax.set_yscale("log")
    ax.set_ylim(top * 1e-4, top * 3)
    ax.set(xlabel="frequency [Hz]", ylabel=f"[{unit(e.units[chosen[0]])}]")
    ax.set_title(f"blocked {'moments' if turning else 'forces'}, ±2 std", loc="left", fontsize=9)
    _log(ax, f)
    few_labels(ax.yaxis)
    tidy(ax)
    ax.legend(fontsize=7, frameon=False, loc="best", ncols=2)


def _predicted(ax: Axes, paths: TransferPaths) -> None:
    """The sensor that was kept out and shows the largest error, measured and predicted."""
    if paths.held_out is None:
        ax.text(0.5, 0.5, "no sensor was kept out", ha="center", va="center", fontsize=9, transform=ax.transAxes)
        ax.set_axis_off()
        return
    c = paths.held_out.comparison
    i = int(np.argmax(np.nan_to_num(c.rms_lines)))
    f = np.asarray(c.axis.values)
    ax.semilogy(f, np.abs(c.measured)[:, i], color=INK, lw=1, label="measured, kept out")
    ax.semilogy(f, np.abs(c.synthesised)[:, i], color=ORANGE, lw=1, ls="--", label="from the blocked forces")
    ax.set(xlabel="frequency [Hz]", ylabel=f"[{unit(c.units[i])}]")
    ax.set_title(f"{text(c.sensors[i])}: {c.rms_lines[i]:.2f} dB rms", loc="left", fontsize=9)
    _log(ax, f)
    few_labels(ax.yaxis)
    tidy(ax)
    ax.legend(fontsize=7, frameon=False, loc="best")


def _ranking(ax: Axes, paths: TransferPaths) -> None:
    """Shares of the blocked forces in the power of the receivers, with two std."""
    ranked = paths.ranking()[:RANKED]
    names = [text(name) for name, _, _ in ranked]
    share = np.array([100 * s for _, s, _ in ranked])
    std = np.array([0.0 if d is None else 200 * d for _, _, d in ranked])
    y = np.arange(len(ranked))[::-1]
    ax.barh(y, share, color=BLUE, height=0.7, xerr=std, error_kw={"ecolor": INK, "lw": 1, "capsize": 2})
    ax.set_yticks(y, names)
    ax.set(xlabel="share of the power of the receivers [%], ±2 std", xlim=(0, max(float((share + std).max()) * 1.1, 1)))
    receivers = ", ".join(text(s.label) for s in paths.contributions.sensors[:4])
    ax.set_title(f"who makes {receivers} move", loc="left", fontsize=9)
    tidy(ax)
