"""Loads over frequency: amplitude with its band, what is not trusted shaded, the least-squares answer beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from .style import (
    BLUE,
    DENSE,
    GREEN,
    GREY,
    INK,
    NARROW,
    ORANGE,
    PURPLE,
    SKY,
    few_labels,
    known_load,
    largest,
    legend_above,
    mark,
    new_figure,
    text,
    tidy,
)
from .style import unit as readable_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from loadid.estimate import LoadEstimate
    from loadid.spectrum import Spectrum

DECADES = 3.0  # of amplitude below the largest that a panel shows
SHADE = "#f3d9c9"


def has_lines(estimate: LoadEstimate) -> bool:
    """Whether the load itself is over frequency."""
    return estimate.spectrum is not None and estimate.axis is not None and estimate.axis.name == "frequency"


def spectrum_figure(
    estimate: LoadEstimate,
    *,
    truth: ArrayLike | None = None,
    level: float = 0.95,
    figure: Figure | None = None,
    narrow: bool = False,
) -> Figure:
    """Amplitude of every load over frequency with its band, one row per load.

    Lines that are not trusted are shaded and their estimate is left out; the least-squares answer runs through them.
    """
    figure = figure or new_figure()
    _need(estimate)
    known = known_load(estimate, truth)
    shown = largest(estimate)
    rows = len(shown) + 1
    figure.set_size_inches(NARROW if narrow else 10, 1.0 + 2.2 * rows)
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    for ax, j in zip(axes, shown, strict=False):
        draw_spectrum(ax, estimate, j, truth=known, level=level)
    legend_above(axes[0])
    _draw_predicted(axes[-1], estimate.spectrum, [estimate.labels[j] for j in shown], shown)
    axes[-1].set_xlabel("frequency [Hz]")
    if len(shown) < len(estimate.labels):
        figure.supylabel(f"{len(shown)} largest of {len(estimate.labels)} loads", fontsize=9)
    mark(figure, estimate)
    return figure


def lines_figure(estimate: LoadEstimate, *, figure: Figure | None = None) -> Figure:
    """What every line can tell: predicted relative std and gain of each load, condition of the line."""
    figure = figure or new_figure()
    _need(estimate)
    s: Spectrum = estimate.spectrum
    shown = largest(estimate)
    names = [estimate.labels[j] for j in shown]
    panels = 3 if len(estimate.labels) > 1 else 2  # one load has no condition
    figure.set_size_inches(10, 2.4 * panels)
    predicted, gain, *condition = figure.subplots(panels, 1, sharex=True)
    _draw_predicted(predicted, s, names, shown)
    legend_above(predicted)
    for k, j in enumerate(shown):
        good = s.gain[:, j] > 0
        gain.semilogy(s.frequencies[good], s.gain[good, j], color=_colour(k), lw=1.0)
        zeros = np.unique(s.zeros[np.isfinite(s.zeros[:, j]), j])
        at = np.searchsorted(s.frequencies, zeros)
        gain.plot(zeros, np.maximum(s.gain[at, j], 1e-300), ls="none", marker="v", ms=5, mfc="none", color=_colour(k))
    gain.set_ylabel("gain [noise std per unit load]")
    gain.set_title("response that no other load can imitate; triangles: antiresonances", loc="left", fontsize=9)
    seen = np.isfinite(s.condition)
    for ax in condition:
        ax.semilogy(s.frequencies[seen], s.condition[seen], color=INK, lw=1.0)
        ax.set_ylabel("condition [-]")
        ax.set_title("condition of the line, loads of expected size", loc="left", fontsize=9)
    (condition or [gain])[-1].set_xlabel("frequency [Hz]")
    for ax in (gain, *condition):
        few_labels(ax.yaxis)
        tidy(ax)
        ax.margins(x=0.01)
    mark(figure, estimate)
    return figure


def draw_spectrum(ax: Axes, e: LoadEstimate, j: int = 0, *, truth: NDArray | None = None, level: float = 0.95) -> None:
    """Draw the amplitude of one load over frequency into `ax`."""
    s: Spectrum = e.spectrum
    f, trusted = s.frequencies, s.trust()[:, j]
    size, std = np.abs(e.load[:, j]), e.std[:, j]
    lower, upper = (edge[:, j] for edge in e.band(level))
    naive = np.abs(s.naive[:, j]) ** (2 if s.cross is not None else 1)
    dense = len(f) > DENSE
    ax.fill_between(f, 0, 1, where=_beside(~trusted), transform=ax.get_xaxis_transform(), color=SHADE, lw=0, zorder=0,
                    step="mid", rasterized=dense, label=f"predicted error above {s.level:.0%}")  # fmt: skip
    top = float(np.max(np.where(trusted, size + std, 0.0), initial=0.0)) or float(size.max())
    ax.plot(f, naive, color=ORANGE, lw=0.7, label="least squares", rasterized=dense)
    ax.fill_between(f, np.maximum(lower, top * 10**-DECADES), upper, where=trusted, color=SKY, alpha=0.5, lw=0,
                    label=f"{level:.0%} band", rasterized=dense)  # fmt: skip
    if truth is not None:
        ax.plot(f, np.abs(truth[:, j]), color=INK, lw=1.2, ls=(0, (4, 2)), label="truth", rasterized=dense)
    ax.plot(f, np.where(trusted, size, np.nan), color=BLUE, lw=1.1, label="estimate, trusted lines", rasterized=dense)
    alone = trusted & ~np.roll(trusted, 1) & ~np.roll(trusted, -1)
    if alone.any():
        ax.plot(f[alone], size[alone], ls="none", marker=".", ms=4, color=BLUE)
    ax.set_yscale("log")
    ax.set_ylim(top * 10**-DECADES, 20 * top)
    few_labels(ax.yaxis)
    word = "autospectrum" if s.cross is not None else "amplitude"
    ax.set_ylabel(f"{word} [{readable_unit(e.units[j])}]")
    ax.set_title(text(e.labels[j]), loc="left", fontsize=9)
    ax.margins(x=0.01)
    tidy(ax)


def _draw_predicted(ax: Axes, s: Spectrum, names: list[str], shown: list[int]) -> None:
    for k, (name, j) in enumerate(zip(names, shown, strict=True)):
        found = s.predicted[:, j]
        good = np.isfinite(found)
        ax.semilogy(s.frequencies[good], found[good], color=_colour(k), lw=0.9, label=text(name))
    ax.axhline(s.level, color=GREY, lw=1.0, ls=(0, (5, 3)), label=f"level {s.level:.0%}")
    ax.set_ylim(max(float(np.nanmin(s.predicted, initial=1.0)) / 2, 1e-6), 20)
    few_labels(ax.yaxis)
    ax.set_ylabel("predicted std / load [-]")
    ax.set_title("predicted relative error of least squares, from noise and FRF errors", loc="left", fontsize=9)
    ax.legend(loc="upper right", fontsize=7, frameon=False, ncols=3)
    ax.margins(x=0.01)
    tidy(ax)


def _need(estimate: LoadEstimate) -> None:
    if estimate.spectrum is None:
        raise InputError("this estimate has no frequency lines", where="plot", found="no spectrum",
                         expected="an estimate of FrequencyInversion")  # fmt: skip


def _beside(flagged: NDArray) -> NDArray[np.bool_]:
    """Flagged lines and the next one: a filled step needs both of its ends."""
    return flagged | np.concatenate([[False], flagged[:-1]])


def _colour(k: int) -> str:
    return (BLUE, ORANGE, GREEN, PURPLE, INK, SKY)[k % 6]
