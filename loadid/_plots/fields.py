"""Loads where they act: over a line, as maps over a surface, and distributed loads over place and time."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from .._guards.inversion import nodal_as_pressure
from .._results.shown import has_field, known_load, known_numbers, places, readable, titled
from .style import (
    BLUE,
    GREY,
    INK,
    NARROW,
    ORANGE,
    SKY,
    mark,
    new_figure,
    text,
    tidy,
    unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .._results.estimate import LoadEstimate

Array = NDArray[Any]


QUANTITIES = ("auto", "force", "traction", "pressure")
FEW = 60  # points of a line up to which each of them is marked


@dataclass(frozen=True)
class _Field:
    """What is drawn: values, std and truth (points, components), places (points, 1 or 2), names."""

    values: Array
    std: Array | None
    truth: Array | None
    x: Array
    along: tuple[str, ...]
    components: list[str]
    word: str
    unit: str
    cells: NDArray[np.int64] | None
    note: str
    warned: bool


def field(
    estimate: LoadEstimate,
    quantity: str = "auto",
    *,
    truth: ArrayLike | None = None,
    frame: int | None = None,
    level: float = 0.95,
    figure: Figure | None = None,
    narrow: bool = False,
) -> Figure:
    """Static load over its places: with its band over a line, as maps of load and std over a surface.

    Parameters
    ----------
    estimate : LoadEstimate
        With the geometry of its load basis.
    quantity : {"auto", "force", "traction", "pressure"}
        ``auto``: forces of nodal loads, tractions of all others. ``traction`` converts nodal forces by the boundary
        mass matrix. ``pressure`` of nodal forces is not drawn: the picture shows forces and flag W106 says why.
    truth : array, shape (loads,), optional
        Known load in the unit of the estimate; converted with it.
    frame : int, optional
        Of a sequence; default the one with the largest load.
    level : float
        Of the band.

    Raises
    ------
    InputError
        If the loads have no places on a line or a surface, or cannot be converted.
    """
    if quantity not in QUANTITIES:
        raise InputError("no such quantity", where="field", found=repr(quantity), expected=f"one of {QUANTITIES}")
    found = _taken(estimate, quantity, truth, frame)
    figure = figure or new_figure()
    if found.x.shape[1] == 1:
        _draw_lines(figure, found, estimate, level, narrow)
    else:
        _draw_maps(figure, found, narrow)
    mark(figure, estimate)
    note = found.note
    if narrow and found.std is not None and found.x.shape[1] > 1:
        note = "; ".join(x for x in (note, f"std at most {found.std.max():.3g} {found.unit}") if x)
    if note:
        lines = "\n".join(textwrap.wrap(note, int(14 * figure.get_figwidth())))
        figure.supxlabel(lines, fontsize=8, color=ORANGE if found.warned else INK, x=0.01, ha="left")
    return figure


# -- what is drawn ----------------------------------------------------------------------------------------------------
def _taken(e: LoadEstimate, quantity: str, truth: ArrayLike | None, frame: int | None) -> _Field:
    g = e.geometry
    if g is None or not has_field(e):
        raise InputError(
            "these loads have no places on a line or a surface", where="field",
            found="loads without a basis" if g is None else f"a basis of {g.get('kind')}",
            expected="a basis of nodes, patches or hats", hint="build the loads with structures.bases",
        )  # fmt: skip
    row: tuple[int, ...] = ()
    note = ""
    if e.load.ndim == 2:
        k = int(np.argmax(np.abs(e.load).max(axis=1))) if frame is None else int(frame)
        row, axis = (k,), e.axis
        at = (
            "" if axis is None or axis.name == "frame" else f" at {axis.name} {axis.values[k]:.4g} {axis.unit}".rstrip()
        )
        note = f"frame {k % len(e.load) + 1} of {len(e.load)}{at}"
    load, std = e.load[row], e.std[row]
    known = None if truth is None else _known(truth, e, row)
    nodal = g.get("kind") == "nodal"
    flag = nodal_as_pressure(str(g.get("kind")), quantity) if quantity == "pressure" else None
    if flag is not None:
        note = f"{flag.code}: {flag.message}; {flag.advice}"
    elif nodal and quantity != "traction":
        note = "; ".join(x for x in (note, "nodal forces: they scale with the element size") if x)
    names = sorted({unit(u) for u in e.units})
    word = "force" if nodal else "traction"
    if quantity == "force" and not nodal:
        raise InputError("this basis carries tractions, no forces", where="field", found=str(g.get("kind")),
                         expected="quantity='traction'", hint="estimate.resultants sums them up")  # fmt: skip
    if quantity == "traction" and nodal:
        matrix = g.get("traction")
        if matrix is None:
            e.traction()  # says what is missing
        T = np.asarray(matrix, float)
        std = _std(e, T)
        load, known, word = T @ load, None if known is None else T @ known, "traction"
        names = ["Pa"] if places(g)[0].shape[1] > 1 else ["N/m"]  # type: ignore[index]
    x, along = places(g)  # type: ignore[misc]
    count = len(e.labels) // len(x)
    cells = g.get("cells")

    def shape(a: Array | None) -> Array | None:
        return None if a is None else np.asarray(a, float).reshape(len(x), count)

    return _Field(
        np.asarray(load, float).reshape(len(x), count), shape(std), shape(known), x, along,
        [text(str(c)) for c in (g.get("components") or [""] * count)], word, ", ".join(names),
        None if cells is None else np.asarray(cells, int), note, flag is not None,
    )  # fmt: skip


def _known(truth: ArrayLike, e: LoadEstimate, row: tuple[int, ...]) -> Array:
    known = known_numbers(truth)
    known = known[row] if known.shape == e.load.shape else known
    if known.shape != e.load.shape[-1:]:
        raise InputError("the known load does not fit", where="truth", found=known.shape, expected=e.load.shape[-1:])
    return known


def _std(e: LoadEstimate, T: Array) -> NDArray[np.float64] | None:
    """Standard deviation of converted loads: their correlations count, so it takes the posterior."""
    if e.posterior is None:
        return None
    if e.load.ndim == 1:
        return np.asarray(np.sqrt(np.maximum(e.posterior.variance(T), 0.0)))
    return np.sqrt(np.maximum([np.asarray(e.posterior.variance(w)).item() for w in T], 0.0))


# -- lines ------------------------------------------------------------------------------------------------------------
def _draw_lines(figure: Figure, f: _Field, e: LoadEstimate, level: float, narrow: bool) -> None:
    from statistics import NormalDist

    count = f.values.shape[1]
    figure.set_size_inches(NARROW if narrow else 7.4, 1.2 + 2.9 * count)
    order = np.argsort(f.x[:, 0])
    x, factor = f.x[order, 0], NormalDist().inv_cdf(0.5 + level / 2)
    for j, ax in enumerate(figure.subplots(count, 1, squeeze=False, sharex=True)[:, 0]):
        value = f.values[order, j]
        ax.axhline(0, color=GREY, lw=0.6)
        if f.std is not None:
            half = factor * f.std[order, j]
            ax.fill_between(x, value - half, value + half, color=SKY, alpha=0.45, lw=0, label=f"{level:.0%} band")
        if f.truth is not None:
            ax.plot(x, f.truth[order, j], color=INK, lw=1.4, ls=(0, (4, 2)), label="truth")
        ax.plot(x, value, color=BLUE, lw=1.3, marker="o" if len(x) <= FEW else None, ms=3, label="estimate")
        ax.set_title(f.components[j], loc="left", fontsize=9)
        ax.set_ylabel(f"{f.word} [{f.unit}]")
        tidy(ax)
        if j == 0:
            ax.legend(fontsize=8)
    ax.set_xlabel(f"{f.along[0]} [m]")


# -- maps -------------------------------------------------------------------------------------------------------------
def _draw_maps(figure: Figure, f: _Field, narrow: bool) -> None:
    count = f.values.shape[1]
    kinds = [
        "estimate",
        *(["truth"] if f.truth is not None else []),
        *(["std"] if f.std is not None and not narrow else []),
    ]
    wide, high = np.ptp(f.x, axis=0)
    across = 1 if narrow else len(kinds)
    each = NARROW if narrow else max(3.2, min(4.6, 12.0 / len(kinds)))
    tall = float(np.clip((each - 1.3) * high / wide, 1.2, 4.5)) + 0.85
    rows = count * len(kinds) // across
    figure.set_size_inches(max(each * across, NARROW if narrow else 5.0), 0.6 + tall * rows)
    grid = figure.subplots(rows, across, squeeze=False).ravel()
    shown = np.concatenate([f.values, *([] if f.truth is None else [f.truth])])
    top = max(float(np.abs(shown).max()), 1e-300)  # one scale, so that noise in a quiet direction looks like noise
    signed = shown.min() < -0.05 * top
    for j in range(count):
        for k, kind in enumerate(kinds):
            ax = grid[j * len(kinds) + k]
            style: dict[str, Any] = (
                {"cmap": "viridis", "vmin": 0.0}
                if kind == "std"
                else {"cmap": "RdBu_r" if signed else "viridis", "vmin": -top if signed else 0.0, "vmax": top}
            )
            values = {"estimate": f.values, "truth": f.truth, "std": f.std}[kind]
            assert values is not None
            image = _map(ax, f, values[:, j], style)
            bar = figure.colorbar(image, ax=ax, shrink=0.75)
            bar.formatter.set_powerlimits((-3, 4))  # type: ignore[attr-defined]
            bar.ax.tick_params(labelsize=8)
            bar.ax.yaxis.get_offset_text().set_fontsize(8)
            bar.set_label(f"{'std of the ' if kind == 'std' else ''}{f.word} [{f.unit}]", fontsize=8)
            ax.set_title(f"{f.components[j]} {kind}".strip(), loc="left", fontsize=9)
            ax.set(xlabel=f"{f.along[0]} [m]", ylabel=f"{f.along[1]} [m]", aspect="equal")
            tidy(ax)
            ax.grid(False)


def _map(ax: Axes, f: _Field, values: Array, style: dict[str, Any]) -> Any:
    """Colours over cells, over a grid, or points where neither is known."""
    if f.cells is not None and f.cells.ndim == 2 and f.cells.shape[1] in (3, 4) and f.cells.max() < len(f.x):
        corners = f.cells[:, :3]
        triangles = corners if f.cells.shape[1] == 3 else np.vstack([corners, f.cells[:, [0, 2, 3]]])
        mesh = Triangulation(f.x[:, 0], f.x[:, 1], triangles)
        return ax.tripcolor(mesh, values, shading="gouraud", rasterized=True, **style)
    a, i = np.unique(np.round(f.x[:, 0], 9), return_inverse=True)
    b, j = np.unique(np.round(f.x[:, 1], 9), return_inverse=True)
    if len(a) * len(b) == len(f.x) and min(len(a), len(b)) > 1:
        table = np.full((len(b), len(a)), np.nan)
        table[j, i] = values
        return ax.pcolormesh(a, b, table, shading="nearest", rasterized=True, **style)
    size = float(np.clip(2e4 / len(f.x), 4, 200))
    return ax.scatter(f.x[:, 0], f.x[:, 1], c=values, s=size, edgecolors=GREY, linewidths=0.3, **style)


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
            "a map over place and time needs histories at places along a line", where="spacetime",
            found="loads without places" if found is None else f"loads of shape {estimate.load.shape}",
            expected="a basis of nodes, patches or hats on a beam, over time",
            hint="plot('field', frame=...) draws one instant over a surface",
        )  # fmt: skip
    known = known_load(estimate, truth)
    figure = figure or new_figure()
    x, count = found[0][:, 0], len(estimate.labels) // len(found[0])
    components = [text(str(c)) for c in ((g or {}).get("components") or [""] * count)]
    kinds: list[tuple[str, Array]] = [("estimate", estimate.load)]
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


def draw_map(ax: Axes, t: ArrayLike, x: ArrayLike, values: Array, label: str, style: dict[str, Any]) -> None:
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
        Mean power, as `loadid._families.field.mean_power` gives it.
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
