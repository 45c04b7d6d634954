"""Pictures of force maps (pressure, shear, std, resultants), of benchmarks and of skin designs."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation
from numpy.typing import ArrayLike

from loadid._plots.style import BLUE, GREEN, GREY, INK, NARROW, ORANGE, PURPLE, SKY, mark, new_figure, save, text, tidy
from structures.errors import reals

from .._arrays import Array, Index, shaped

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.quiver import Quiver

    from ..design import SkinDesign
    from ..metrics._benchmark import BenchmarkRow, BenchmarkTable
    from .forcemap import ForceMap


ARROWS = 21  # along the longer side
LONGEST = 1.6  # length of the longest arrow over the distance of the arrows
PULL = 0.1  # of the peak: the least that the scale of the colours shows below zero
QUIET = 0.04  # of the largest shear or pressure, below which an arrow is left out
LEVEL = 0.95
MM, KPA = 1e3, 1e-3
COLOURS = (BLUE, GREEN, ORANGE)
AXES = "xyz"


def map_figure(
    force: ForceMap,
    *,
    truth: ArrayLike | None = None,
    frame: int | None = None,
    figure: Figure | None = None,
    narrow: bool = False,
) -> Figure:
    """Pressure with arrows of shear, a known map (tractions in Pa) beside it on its scale, and std of the pressure.

    Of a sequence the frame of the largest force, or one from 0; `narrow`, for a phone: panels below each other, no std.
    """
    one, known, title, kinds, shape, size = _panels(force, truth, frame, narrow)
    figure = figure or new_figure()
    figure.set_size_inches(*size)
    draw_maps(list(figure.subplots(*shape, squeeze=False).ravel()), one, known, kinds, title)
    mark(figure, force)
    return figure


def sequence_figure(
    force: ForceMap,
    *,
    truth: ArrayLike | None = None,
    wrenches: ArrayLike | None = None,
    frame: int | None = None,
    figure: Figure | None = None,
    narrow: bool = False,
) -> Figure:
    """The map of one frame as `map_figure`, forces and torques of all frames with their bands below.

    `wrenches` (frames, 6) are known forces (N) and torques (N m), drawn with them.
    """
    if force.single or len(force.load) < 2:
        return map_figure(force, truth=truth, frame=frame, figure=figure, narrow=narrow)
    one, known, title, kinds, shape, (wide, high) = _panels(force, truth, frame, narrow)
    figure, room = figure or new_figure(), 5.0 if narrow else 2.6
    figure.set_size_inches(wide, high + room)
    parts: Any = figure.subfigures(2, 1, height_ratios=(high, room))
    draw_maps(list(parts[0].subplots(*shape, squeeze=False).ravel()), one, known, kinds, title)
    lines = parts[1].subplots(*((2, 1) if narrow else (1, 2)), squeeze=False)
    if wrenches is not None:
        what, hint = "the known wrenches do not fit", "Fx, Fy, Fz in N, Mx, My, Mz in N m"
        wrenches = shaped(wrenches, (len(force.load), 6), where="wrenches", what=what, hint=hint)
    at = force.chosen(frame)
    for ax, moment in zip(lines.ravel(), (False, True), strict=True):
        draw_resultants(ax, force, torque=moment, truth=wrenches, at=at)
    mark(figure, force)
    return figure


def _panels(
    force: ForceMap, truth: ArrayLike | None, frame: int | None, narrow: bool
) -> tuple[ForceMap, Array | None, str, list[str], tuple[int, int], tuple[float, float]]:
    """One frame, its truth and name; what its panels show, their rows and columns, and their size in inches."""
    one, known, title = taken(force, truth, frame)
    kinds = ["estimate", *(["truth"] if known is not None else []), *([] if narrow else ["std"])]
    rows, across = (len(kinds), 1) if narrow else (1, len(kinds))
    return one, known, title, kinds, (rows, across), _size(one, across, rows)


def taken(force: ForceMap, truth: ArrayLike | None, frame: int | None) -> tuple[ForceMap, Array | None, str]:
    """One frame of a map, the truth of that frame, and its name."""
    k = force.chosen(frame)
    one, name = (force, "") if force.single else (force.frame(k), force.frame_name(k))
    if truth is None:
        return one, None, name
    known = reals(truth, where="truth")
    known = known[k] if known.ndim == 3 and not force.single else known
    hint = "tractions in Pa at the nodes"
    known = shaped(known, (len(one.nodes), 3), where="truth", what="the known map does not fit", hint=hint)
    return one, known, name


# -- maps -------------------------------------------------------------------------------------------------------------
def draw_maps(axes: list[Axes], one: ForceMap, truth: Array | None, kinds: list[str], title: str = "") -> None:
    """One panel for each kind; estimate and truth share the scale of their colours and arrows."""
    t, std = one.traction(), one.pressure_std()
    low, top, shear = scale([t, *([truth] if truth is not None else [])])
    for k, (ax, kind) in enumerate(zip(axes, kinds, strict=True)):
        if kind == "std":
            image = surface(ax, one, std * KPA, cmap="viridis", vmin=0.0, vmax=max(float(std.max()) * KPA, 1e-300))
            colour_bar(ax, image, "std of the pressure [kPa]")
            ax.set_title("std", loc="left", fontsize=9)
        else:
            values = t if kind == "estimate" else truth
            assert values is not None
            image = surface(ax, one, one.pressure_of(values) * KPA, **colours(low, top))
            arrows = draw_shear(ax, one, values, shear, top)
            if arrows is not None:
                arrow_key(ax, arrows, shear, 0.66)
            colour_bar(ax, image, "pressure [kPa]")
            words = ", ".join(x for x in (kind if truth is not None else "", title) if x)
            ax.set_title(words, loc="left", fontsize=9)
            if kind == "estimate":
                draw_contact(ax, one)
        dress(ax, label=k == 0)


def scale(maps: Sequence[Array]) -> tuple[float, float, float]:
    """Lowest pressure, largest traction along the normal and largest shear of some maps (..., 3), kPa."""
    top = max(max(float(np.abs(x[..., 2]).max()) for x in maps) * KPA, 1e-300)
    low = -max(float(x[..., 2].max()) for x in maps) * KPA
    return low, top, max(float(np.hypot(x[..., 0], x[..., 1]).max()) for x in maps) * KPA


def surface(ax: Axes, one: ForceMap, values: Array, **style: Any) -> Any:
    """Colours over the cells of the surface, or over triangles between its points."""
    x, y = MM * one.nodes[:, 0], MM * one.nodes[:, 1]
    cells = None if one.geometry is None else one.geometry.get("cells")
    corners = None if cells is None else np.asarray(cells)
    if corners is not None and corners.shape[1] == 4:
        corners = np.vstack([corners[:, :3], corners[:, [0, 2, 3]]])
    draw: Any = ax.tripcolor
    return draw(Triangulation(x, y, corners), values, shading="gouraud", rasterized=True, **style)


def colours(low: float, top: float) -> dict[str, Any]:
    """Style of signed values: white at zero, red pressed, blue pulled, equally strong for equal sizes."""
    from matplotlib import colormaps
    from matplotlib.colors import LinearSegmentedColormap

    share = float(np.clip(-low / top, PULL, 1.0))
    table = colormaps["RdBu_r"](np.linspace(0.5 - 0.5 * share, 1.0, 256))
    return {"cmap": LinearSegmentedColormap.from_list("pressed", table), "vmin": -share * top, "vmax": top}


def draw_shear(ax: Axes, one: ForceMap, t: Array, shear: float, top: float) -> Quiver | None:
    """Arrows of the shear on the pad at nodes spread evenly; None where there is none to see."""
    if not shear > QUIET * top:
        return None
    at, step = spread_evenly(one.nodes[:, :2])
    tx, ty = KPA * t[at, 0], KPA * t[at, 1]
    tx, ty = (np.where(np.hypot(tx, ty) > max(QUIET * top, QUIET * shear), v, 0.0) for v in (tx, ty))
    x, y = MM * one.nodes[at, 0], MM * one.nodes[at, 1]
    return ax.quiver(x, y, tx, ty, angles="xy", scale_units="xy", scale=shear / (LONGEST * MM * step), units="width",
                     width=0.004, minlength=0.0, color=INK)  # fmt: skip


def spread_evenly(xy: Array) -> tuple[Index, float]:
    """Nodes at most about `ARROWS` along the longer side, in whole steps of their pitch, and that step."""
    from scipy.spatial import cKDTree

    pitch = float(np.median(cKDTree(xy).query(xy, k=2)[0][:, 1]))
    step = pitch * max(1, round(float(np.ptp(xy, axis=0).max()) / (ARROWS - 1) / pitch))
    if step == pitch:
        return np.arange(len(xy)), pitch
    cell = np.round((xy - xy.min(axis=0)) / step)
    off = np.linalg.norm((xy - xy.min(axis=0)) / step - cell, axis=1)
    order = np.lexsort((off, cell[:, 0], cell[:, 1]))  # of every square, the node nearest to its middle
    first = np.ones(len(order), bool)
    first[1:] = np.any(np.diff(cell[order], axis=0) != 0, axis=1)
    return np.sort(order[first]), step


def draw_contact(ax: Axes, one: ForceMap) -> None:
    """Circle of the contact radius about the centre of pressure, where there is contact."""
    from matplotlib.patches import Circle

    contact = one.contact()
    if not contact.mask.any():
        return
    x, y = MM * contact.centre
    ax.add_patch(Circle((x, y), MM * contact.radius, fill=False, ec=GREEN, lw=1.4, ls=(0, (4, 2))))
    ax.plot(x, y, "+", color=GREEN, ms=7, mew=1.4)


def dress(ax: Axes, *, label: bool = True) -> None:
    """Equal axes in mm."""
    ax.margins(0)
    ax.set(xlabel="x [mm]", aspect="equal")
    if label:
        ax.set_ylabel("y [mm]")
    tidy(ax)
    ax.grid(False)


def arrow_key(ax: Axes, arrows: Quiver, shear: float, at: float) -> None:
    """What an arrow of a round length (1, 2 or 5 times a power of ten) means, above the panel."""
    power = 10.0 ** np.floor(np.log10(shear))
    length = float(max(m for m in (1.0, 2.0, 5.0) if m * power <= shear * (1 + 1e-9)) * power)
    ax.quiverkey(arrows, at, 1.035, length, f"shear {length:g} kPa", labelpos="E", coordinates="axes",
                 fontproperties={"size": 8}, labelsep=0.06)  # fmt: skip


def colour_bar(ax: Axes, image: Any, label: str) -> None:
    """The scale of the colours beside a panel."""
    bar = ax.figure.colorbar(image, ax=ax, shrink=0.85, pad=0.02)
    bar.set_label(label, fontsize=8)
    bar.ax.tick_params(labelsize=8)


def _size(one: ForceMap, across: int, rows: int) -> tuple[float, float]:
    wide, high = np.ptp(one.nodes[:, :2], axis=0)
    each = NARROW if across == 1 and rows > 1 else 4.2 if across < 3 else 3.9
    tall = float(np.clip((each - 1.2) * high / wide, 1.2, 4.6)) + 0.75
    return max(each * across, NARROW), tall * rows + 0.35


# -- resultants -------------------------------------------------------------------------------------------------------
def draw_resultants(
    ax: Axes, force: ForceMap, *, torque: bool = False, truth: Array | None = None, at: int | None = None
) -> None:
    """Force (N) or torque (N mm) of every frame with its 95 % band; known values dashed."""
    assert force.axis is not None
    found, factor = (force.torque(), 1e3) if torque else (force.resultant(), 1.0)
    half = NormalDist().inv_cdf(0.5 + LEVEL / 2) * found.std
    x = force.axis.values
    ax.axhline(0, color=GREY, lw=0.6)
    for k, (colour, name) in enumerate(zip(COLOURS, AXES, strict=True)):
        value, width = factor * found.value[:, k], factor * half[:, k]
        ax.fill_between(x, value - width, value + width, color=colour, alpha=0.25, lw=0)
        ax.plot(x, value, color=colour, lw=1.4, label=f"{'M' if torque else 'F'}{name}")
        if truth is not None:
            ax.plot(x, factor * truth[:, k + 3 * torque], color=INK, lw=1.0, ls=(0, (4, 2)),
                    label="truth" if k == 2 else None)  # fmt: skip
    if at is not None:
        ax.axvline(x[at], color=GREY, lw=0.8, ls=":")
    ax.set_title("torque about the centre of the surface" if torque else f"force on the pad, {LEVEL:.0%} band",
                 loc="left", fontsize=9)  # fmt: skip
    ax.set_ylabel("torque [N mm]" if torque else "force [N]")
    if force.axis.name == "frame":
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("time [s]" if force.axis.name == "time" else "frame")
    ax.margins(x=0.01)
    ax.legend(fontsize=8, frameon=False, ncols=4, loc="best")
    tidy(ax)


LINES = [
    (BLUE, "-", "o"),
    (ORANGE, "--", "s"),
    (GREEN, "-.", "^"),
    (PURPLE, ":", "D"),
    (SKY, "-", "v"),
    (GREY, "--", "x"),
]


def draw_benchmark(table: BenchmarkTable, path: str | os.PathLike[str] | None = None) -> Figure:
    """One panel each for the error of the map, its cosine, the overlap of the contact and the error of the force."""
    figure = new_figure()
    figure.set_size_inches(10, 7)
    panels = figure.subplots(2, 2, sharex=True).ravel()
    shown: tuple[tuple[str, Callable[[BenchmarkRow], float | None]], ...] = (
        ("relative L2 error of the map (0 is right)", lambda r: r.metrics.error),
        ("cosine of the map (1 is right)", lambda r: r.metrics.cosine),
        ("IoU of the contact (1 is right)", lambda r: r.metrics.iou),
        ("error of the resultant force (%)", lambda r: 100 * r.force),
    )
    for i, name in enumerate(table.sensors):
        rows = sorted((r for r in table.rows if r.sensor == name), key=lambda r: r.noise)
        color, line, marker = LINES[i % len(LINES)]
        for ax, (_, value) in zip(panels, shown, strict=True):
            ax.plot([1e6 * r.noise for r in rows], [value(r) for r in rows], color=color, ls=line, marker=marker, ms=5,
                    label=text(name))  # fmt: skip
    for ax, (title, _) in zip(panels, shown, strict=True):
        ax.set_title(title, fontsize=10, loc="left")
        ax.grid(alpha=0.25)
        _open(ax)
    for i in (0, 3):
        panels[i].set_ylim(bottom=0)
    figure.supxlabel("marker noise, std of each component (µm)", fontsize=10)
    panels[0].legend(fontsize=8, frameon=False)
    figure.suptitle(f"{table.presses} presses, {table.draws} draws, medians", fontsize=9, x=0.01, ha="left")
    if path is not None:
        save(figure, path)
    return figure


def draw_design(designs: Sequence[SkinDesign], path: str | os.PathLike[str] | None = None) -> Figure:
    """Above, the share of pressure and shear that is known of each wave; below, four numbers of each design."""
    figure = new_figure()
    figure.set_size_inches(11, 7.5)
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.25, 1))
    upper, lower = parts
    panels = upper.subplots(1, 2, sharey=True)
    for ax, kind in zip(panels, ("pressure", "shear"), strict=True):
        for i, one in enumerate(designs):
            color, line, _ = LINES[i % len(LINES)]
            wave = 2e3 * np.pi / one.spectrum.k
            ax.plot(wave, getattr(one.spectrum, kind), color=color, ls=line, lw=1.8, label=text(one.name))
            ax.axvline(2e3 * one.skin.pitch, color=color, ls=line, lw=0.7, alpha=0.6)
        ax.axhline(0.5, color=GREY, lw=0.8)
        ax.set_xscale("log")
        ax.set_xlim(0.2, 2e3 * max(max(d.skin.size) for d in designs))
        ax.set_ylim(0, 1.02)
        ax.set_title(f"{kind}: share of the expected variance that a reading tells", fontsize=10, loc="left")
        ax.set_xlabel("wavelength of the traction (mm); thin upright lines: two marker pitches", fontsize=9)
        _open(ax)
    panels[0].legend(fontsize=8, frameon=False, loc="lower right")
    _bars(lower, designs)
    if path is not None:
        save(figure, path)
    return figure


def _bars(figure: Any, designs: Sequence[SkinDesign]) -> None:
    patch = f"{1e3 * designs[0].skin.patch:g} mm patch"
    shown = (
        (f"std of pressure (kPa)\non a {patch}", [1e-3 * d.pressure_std for d in designs]),
        (f"std of shear (kPa)\non a {patch}", [1e-3 * d.shear_std for d in designs]),
        ("waves above\nnoise (%)", [100 * d.recoverable / d.waves for d in designs]),
        ("force (N) at\n10 % strain", [d.strain_load for d in designs]),
    )
    where = np.arange(len(designs))[::-1]
    for ax, (title, values) in zip(figure.subplots(1, 4, sharey=True), shown, strict=True):
        ax.barh(where, values, color=[LINES[i % len(LINES)][0] for i in range(len(designs))], height=0.6)
        for y, v in zip(where, values, strict=True):
            ax.text(v, y, f" {v:.3g}", va="center", fontsize=8, color=INK)
        ax.set_yticks(where, [text(d.name) for d in designs], fontsize=8)
        ax.set_xlim(0, 1.25 * max(values))
        ax.set_title(title, fontsize=9, loc="left")
        _open(ax)


def _open(ax: Any) -> None:
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
