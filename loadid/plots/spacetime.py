"""Distributed loads over place and time: maps of the load and its std, and of the power that it feeds or takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from .style import NARROW, known_load, mark, new_figure, places, readable, text, tidy, titled, unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from loadid.estimate import LoadEstimate

COLUMNS = 2000  # samples that a map shows: more than a picture has pixels


def spacetime(
    estimate: LoadEstimate, *, truth: ArrayLike | None = None, figure: Figure | None = None, narrow: bool = False
) -> Figure:
    """Load along a line over time, its std below, and a known load between them where there is one.

    Parameters
    ----------
    estimate : LoadEstimate
        Of a basis of points or patches along a line, over time.
    truth : array, the shape of the load, optional

    Raises
    ------
    InputError
        If the loads are not histories at places along a line.
    """
    g = estimate.geometry
    found = None if g is None or g.get("kind") == "polynomials" else places(g)
    if found is None or found[0].shape[1] != 1 or estimate.load.ndim != 2 or estimate.axis is None:
        raise InputError(
            "a map over place and time needs histories at places along a line",
            where="spacetime",
            found="loads without places" if found is None else f"loads of shape {estimate.load.shape}",
            expected="a basis of nodes, patches or hats on a beam, over time",
            hint="plot('field', frame=...) draws one instant over a surface",
        )
    known = known_load(estimate, truth)
    figure = figure or new_figure()
    x, count = found[0][:, 0], len(estimate.labels) // len(found[0])
    components = [text(str(c)) for c in ((g or {}).get("components") or [""] * count)]
    kinds: list[tuple[str, NDArray]] = [("estimate", estimate.load)]
    kinds += [] if known is None else [("truth", known)]
    kinds += [("std", estimate.std)]
    figure.set_size_inches(NARROW if narrow else 9.0, 0.7 + 2.1 * count * len(kinds))
    axes = figure.subplots(count * len(kinds), 1, squeeze=False, sharex=True)[:, 0]
    scale, name = readable(estimate)
    top = float(max(np.abs(values).max() for kind, values in kinds if kind != "std"))
    for j in range(count):
        for k, (kind, values) in enumerate(kinds):
            ax = axes[j * len(kinds) + k]
            style: dict[str, Any] = {"cmap": "viridis", "vmin": 0.0} if kind == "std" else signed(top)
            word = f"{'std of the ' if kind == 'std' else ''}load [{unit(estimate.units[j])}]"
            draw_map(ax, scale * estimate.axis.values, x, values[:, j::count], word, style)
            ax.set_title(f"{components[j]} {kind}".strip(), loc="left", fontsize=9)
            ax.set_ylabel(f"{found[1][0]} [m]")
    axes[-1].set_xlabel(titled(estimate.axis.name, name))
    mark(figure, estimate)
    return figure


def signed(top: float) -> dict[str, Any]:
    """Colours of a quantity with a sign: zero is white, and both signs reach as far."""
    top = top if top > 0 else 1.0
    return {"cmap": "RdBu_r", "vmin": -top, "vmax": top}


def draw_map(ax: Axes, t: ArrayLike, x: ArrayLike, values: NDArray, label: str, style: dict[str, Any]) -> None:
    """Colours of `values` (samples, places) over time and place; of a long record means of neighbouring samples."""
    time, place = np.asarray(t, float), np.asarray(x, float)
    order = np.argsort(place)
    step = -(-len(time) // COLUMNS)
    kept = len(time) // step * step
    time = time[:kept].reshape(-1, step).mean(axis=1)
    shown = values[:kept].reshape(len(time), step, -1).mean(axis=1)[:, order]
    image = ax.pcolormesh(time, place[order], shown.T, shading="nearest", rasterized=True, **style)
    figure = ax.get_figure(root=True)
    assert figure is not None
    bar = figure.colorbar(image, ax=ax, shrink=0.9, pad=0.01)
    bar.ax.tick_params(labelsize=8)
    bar.set_label(label, fontsize=8)
    tidy(ax)
    ax.grid(False)


def zones(
    t: ArrayLike, x: ArrayLike, power: ArrayLike, *, truth: ArrayLike | None = None, of: str = "W/m",
    figure: Figure | None = None,
) -> Figure:  # fmt: skip
    """Excitation (red) and damping zones (blue) along a line over time.

    Parameters
    ----------
    t, x : array (samples,), (places,)
        s, m.
    power : array (samples, places)
        Mean power, as `loadid.zones.mean_power` gives it.
    truth : array, the shape of `power`, optional
    of : str
        Unit of the power.

    Raises
    ------
    InputError
        If the shapes do not fit.
    """
    time, place = np.asarray(t, float), np.asarray(x, float)
    rows = [("estimate", np.asarray(power, float))]
    rows += [] if truth is None else [("truth", np.asarray(truth, float))]
    for _, values in rows:
        if values.shape != (len(time), len(place)):
            raise InputError("the power does not fit its places and times", where="zones",
                             found=f"shape {values.shape}", expected=f"({len(time)}, {len(place)})")  # fmt: skip
    figure = figure or new_figure()
    figure.set_size_inches(9.0, 0.5 + 2.4 * len(rows))
    top = float(max(np.abs(values).max() for _, values in rows))
    axes = figure.subplots(len(rows), 1, squeeze=False, sharex=True)[:, 0]
    for ax, (kind, values) in zip(axes, rows, strict=True):
        draw_map(ax, time, place, values, f"mean power [{unit(of)}]", signed(top))
        ax.set_title(f"{kind}: red excites, blue damps", loc="left", fontsize=9)
        ax.set_ylabel("x [m]")
    axes[-1].set_xlabel("time [s]")
    return figure
