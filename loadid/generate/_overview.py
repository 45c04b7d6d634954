"""A training set as one page: how often each kind was drawn, how what was drawn is spread, pictures of some draws."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _page
from .._page import PageSection

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ._examples import Examples
    from ._trainingset import TrainingSet

MOST = 20_000  # draws that are read for the page
COLUMNS, BINS = 4, 30
HISTORIES = 4  # that are drawn of each kind


def overview(training: TrainingSet, path: str | os.PathLike[str], pictures: Sequence[Figure] = ()) -> None:
    """Write the page of a training set: its kinds, the spread of what was drawn, and pictures.

    Parameters
    ----------
    training : TrainingSet
    path : path
        HTML file to write or to replace.
    pictures : sequence of Figure
        Of draws, beside those that the page makes itself of histories.

    Raises
    ------
    InputError
        A shard that is missing or damaged, or a file that cannot be written.
    """
    _page.write_page(path, lambda: _made(training, pictures))


def _made(training: TrainingSet, pictures: Sequence[Figure]) -> str:
    from .._plots.style import drawn

    found = training.read(slice(0, MOST))
    figures = [*pictures, *([_histories(training, found)] if training.samples else [])]
    shown = [_page.image(drawn(one, "png"), "draws of the set") for one in figures]
    spread = _spread(found)
    sections = [
        PageSection("Kinds", _kinds(training, found)),
        PageSection("Draws", _page.joined(*shown) if shown else ""),
        PageSection("What was drawn", _page.image(drawn(spread, "png"), "histograms of what was drawn")),
        PageSection("In numbers", _numbers(found), folded=True),
        PageSection("Declaration", _page.table(list(_lines("", training.declaration)), ("name", "value")), folded=True),
    ]
    what = f"{len(training)} draws of {len(training.sensors)} sensors and {len(training.loads)} loads"
    steps = f", {training.samples} samples every {training.dt:g} s" if training.samples else ""
    about = f"seed {training.head.seed}, fingerprint {training.fingerprint[:16]}"
    answer = _page.part("notice", f"{what}{steps}.", "good")
    return _page.document("Training set", sections, about=about, answer=answer, wide=True)


def _kinds(training: TrainingSet, found: Examples) -> Any:
    rows = []
    lost = np.zeros(len(found)) if found.missing is None else found.missing.reshape(len(found), -1).mean(axis=1)
    size = np.sqrt(np.mean(found.loads.reshape(len(found), -1) ** 2, axis=1))
    read = np.sqrt(np.mean(found.data.reshape(len(found), -1) ** 2, axis=1))
    level = np.sqrt(np.mean(found.noise**2))
    for kind in training.kinds:
        here = found.kinds == kind
        count = int(here.sum())
        rows.append([kind, f"{count}", f"{100 * count / len(found):.1f} %", *(
            f"{np.median(v[here]):.3g}" if count else "" for v in (size, read)),
            f"{np.median(read[here]) / level:.3g}" if count and level else "",
            f"{100 * lost[here].mean():.2g} %" if count else ""])  # fmt: skip
    head = ("kind", "draws", "share", "load (rms, SI)", "readings (rms, SI)", "over noise", "lost")
    return _page.table(rows, head)


def _numbers(found: Examples) -> Any:
    rows = [[name, *(f"{v:.4g}" for v in np.quantile(values, [0, 0.05, 0.5, 0.95, 1]))]
            for name, values in found.parameters.items()]  # fmt: skip
    return _page.table(rows, ("name", "lowest", "5 %", "median", "95 %", "highest"))


def _spread(found: Examples) -> Figure:
    """Histograms of what varies."""
    from matplotlib.figure import Figure

    varied = [(name, v) for name, v in found.parameters.items() if np.ptp(v) > 0]
    rows = max(1, -(-len(varied) // COLUMNS))
    figure = Figure(figsize=(10, 1.9 * rows), layout="constrained")
    axes = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for ax in axes[len(varied) :]:
        ax.set_axis_off()
    for ax, (name, values) in zip(axes, varied, strict=False):
        ax.hist(values, bins=BINS, color="0.4")
        ax.set_title(name, fontsize=9)
        ax.tick_params(labelsize=7)
        ax.set_yticks([])
        ax.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4))
        ax.xaxis.offsetText.set_fontsize(7)
    return figure


def _histories(training: TrainingSet, found: Examples) -> Figure:
    """A few loads of each kind, and what the first sensor reads of them."""
    from matplotlib.figure import Figure

    kinds = [kind for kind in training.kinds if np.any(found.kinds == kind)]
    figure = Figure(figsize=(10, 1.7 * len(kinds)), layout="constrained")
    axes = figure.subplots(len(kinds), 2, squeeze=False, sharex=True)
    t = (training.dt or 1.0) * np.arange(training.samples or 0)
    for row, kind in zip(axes, kinds, strict=True):
        for k in np.flatnonzero(found.kinds == kind)[:HISTORIES]:
            acting = int(np.argmax(np.abs(found.loads[k]).max(axis=0)))
            row[0].plot(t, found.loads[k][:, acting], lw=0.8)
            row[1].plot(t, found.data[k][:, 0], lw=0.8)
        row[0].set_ylabel(kind, fontsize=8)
    axes[0, 0].set_title(f"load in {training.loads[0].unit}", fontsize=9)
    axes[0, 1].set_title(f"{training.sensors[0].label} in {training.sensors[0].unit}", fontsize=9)
    for ax in axes[-1]:
        ax.set_xlabel("time in s", fontsize=8)
    for ax in axes.ravel():
        ax.tick_params(labelsize=7)
    return figure


def _lines(name: str, value: Any) -> list[list[str]]:
    """Names and values of nested tables, one line for each."""
    if isinstance(value, dict):
        return [line for key, one in value.items() for line in _lines(f"{name}.{key}" if name else str(key), one)]
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [line for k, one in enumerate(value) for line in _lines(f"{name} {k + 1}", one)]
    return [[name, ", ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in value)
             if isinstance(value, list | tuple | np.ndarray) else f"{value}"]]  # fmt: skip
