"""Videos of force maps and of any pictures, MP4, AVI or GIF; the camera image with what was found in it."""

from __future__ import annotations

import itertools
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from loadid._plots.style import INK, ORANGE, SKY, mark, new_figure, text
from structures.errors import InputError, positive
from structures.files._storage import as_path, replace

from .._arrays import Array, shaped
from ..vision._detect import Detected
from ..vision._images import grey, installed, opencv
from ..vision._motion import MarkerMotion
from .pictures import (
    COLOURS,
    KPA,
    LONGEST,
    MM,
    QUIET,
    arrow_key,
    colour_bar,
    colours,
    draw_resultants,
    dress,
    scale,
    spread_evenly,
    surface,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from .forcemap import ForceMap


NUMBERED = 100  # dots up to which each carries its number
WIDTH = 7.0  # inches of a picture
ENLARGED = 10.0  # length of the arrows over the motion, where that is small


def overlay(
    image: Any,
    found: Detected | MarkerMotion,
    *,
    title: str = "",
    scale: float | None = None,
    axes: Axes | None = None,
    figure: Figure | None = None,
) -> Figure:
    """Image with the dots found in it, numbered where they are few; of a `MarkerMotion` arrows, and lost ones crossed.

    The arrows are `scale` times the motion; by default 1, or 10 where the largest motion is below 3 % of the image.
    """
    seen = grey(image)
    if axes is None:
        figure = figure or new_figure()
        height, width = seen.shape
        figure.set_size_inches(WIDTH, WIDTH * height / width + 0.5)
        axes = figure.subplots()
    shown = np.asarray(image)
    colour = shown.ndim == 3 and shown.shape[2] >= 3
    axes.imshow(shown[..., :3] if colour else seen, cmap=None if colour else "gray", interpolation="nearest")
    axes.set_axis_off()
    if isinstance(found, MarkerMotion):
        words = _draw_motion(axes, found, seen.shape[1], scale)
    else:
        words = f"{len(found.points)} dots"
        _rings(axes, found.points, found.radius)
        _numbers(axes, found.points, found.radius)
    axes.set_title(f"{text(title)}: {words}" if title else words, fontsize=9, loc="left")
    drawn = axes.get_figure()
    assert isinstance(drawn, Figure)
    return drawn


def _draw_motion(axes: Axes, motion: MarkerMotion, width: int, scale: float | None) -> str:
    places, moved = motion.places, motion.moved
    seen = motion.tracked
    largest = float(np.hypot(*moved[seen].T).max(initial=0.0))
    factor = scale or (ENLARGED if largest < 0.03 * width else 1.0)
    pitch = _pitch(motion.points)
    _rings(axes, places[seen], 0.25 * pitch)
    arrows = (*motion.points[seen].T, *(factor * moved[seen]).T)
    axes.quiver(*arrows, angles="xy", scale_units="xy", scale=1, color=SKY, width=0.003)
    for gone, sign in ((motion.lost, "x"), (motion.rejected, "P")):
        axes.plot(*motion.points[gone].T, sign, color=ORANGE, markersize=8, markeredgewidth=1.5)
    _numbers(axes, motion.points, 0.25 * pitch)
    size = f"largest motion {largest:.2g} px" + (f", arrows x {factor:g}" if factor != 1 else "")
    return f"{seen.sum()} of {len(seen)} markers, {motion.lost.sum()} lost, {motion.rejected.sum()} rejected; {size}"


def _rings(axes: Axes, points: Array, radius: float) -> None:
    from matplotlib.collections import EllipseCollection

    size = np.full(len(points), 2 * radius)
    rings = EllipseCollection(
        size, size, np.zeros(len(points)), units="xy", offsets=points, transOffset=axes.transData, linewidths=1.0
    )
    rings.set(facecolor="none", edgecolor=ORANGE)
    axes.add_collection(rings)
    axes.plot(*points.T, ".", color=ORANGE, markersize=2)


def _numbers(axes: Axes, points: Array, radius: float) -> None:
    if len(points) > NUMBERED:
        return
    for k, (x, y) in enumerate(points):
        if np.isfinite(x):
            axes.annotate(str(k + 1), (x + radius, y - radius), color="white", fontsize=6, clip_on=True)


def _pitch(points: Array) -> float:
    return Detected(points[np.isfinite(points).all(axis=1)], np.empty(0), 1.0).pitch


DPI = 100


def pictures(force: ForceMap, *, truth: ArrayLike | None = None, progress: Any = None) -> Iterator[NDArray[np.uint8]]:
    """A picture (H, W, 3) of every frame of a sequence, known tractions (frames, P, 3) in Pa beside the map."""
    if force.single:
        raise InputError("a video takes frames", where="film", found="one force map", expected="a sequence")
    t = force.traction()
    what, hint = "the known maps do not fit", "tractions in Pa"
    known = None if truth is None else shaped(truth, t.shape, where="truth", what=what, hint=hint)
    return _drawn(force, t, known, progress)


def _drawn(force: ForceMap, t: Array, known: Array | None, progress: Any) -> Iterator[NDArray[np.uint8]]:
    shown = [("estimate", t), *([("truth", known)] if known is not None else [])]
    figure = Figure(figsize=(4.3 * len(shown) + 4.2, 4.3), dpi=DPI, layout="constrained")
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(shown) + 1, width_ratios=[1.0] * len(shown) + [0.95])
    span = scale([x for _, x in shown])
    panels = [_Panel(ax, force.frame(0), name, span) for ax, (name, _) in zip(axes, shown, strict=False)]
    draw_resultants(axes[-1], force)
    assert force.axis is not None
    at, values = force.axis.values, force.resultant().value
    line = axes[-1].axvline(at[0], color=INK, lw=1.0)
    dots = axes[-1].scatter(np.full(3, at[0]), values[0], c=list(COLOURS), s=22, zorder=3)
    mark(figure, force)
    moving: list[Artist] = [artist for panel in panels for artist in panel.moving] + [line, dots]
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    figure.set_layout_engine("none")  # what is laid out once stays: nothing jumps from frame to frame
    still = canvas.copy_from_bbox(figure.bbox)
    for k in range(len(force.load)):
        for panel, (_, x) in zip(panels, shown, strict=True):
            panel.show(x[k], force.frame_name(k))
        line.set_xdata([at[k], at[k]])
        dots.set_offsets(np.column_stack([np.full(3, at[k]), values[k]]))
        canvas.restore_region(still)
        for artist in moving:  # the rest is drawn once: axes and labels take nine tenths of a picture's time
            artist.draw(canvas.get_renderer())
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()
        if progress is not None:
            progress((k + 1) / len(force.load), "drawing the video")


class _Panel:
    """One map whose colours and arrows change from frame to frame."""

    def __init__(self, ax: Axes, one: ForceMap, name: str, scale: tuple[float, float, float]) -> None:
        low, top, shear = scale
        self.name, self.quiet = name, QUIET * max(top, shear)
        self.image = surface(ax, one, np.zeros(len(one.nodes)), **colours(low, top))
        colour_bar(ax, self.image, "pressure [kPa]")
        self.at, step = spread_evenly(one.nodes[:, :2])
        xy = MM * one.nodes[self.at, :2]
        size = shear if shear > 0 else 1.0
        zero = np.zeros(len(xy))
        self.arrows = ax.quiver(*xy.T, zero, zero, angles="xy", scale_units="xy", scale=size / (LONGEST * MM * step),
                                units="width", width=0.004, minlength=0.0, color=INK)  # fmt: skip
        if shear > QUIET * top:
            arrow_key(ax, self.arrows, shear, 0.62)
        dress(ax)
        self.title = ax.set_title(f"{name}, {'0' * 8}", loc="left", fontsize=9)
        self.moving: list[Artist] = [self.image, self.arrows, self.title, ax.spines["left"], ax.spines["bottom"]]

    def show(self, t: Array, name: str) -> None:
        """Show the tractions (P, 3) of a frame."""
        self.image.set_array(-t[:, 2] * KPA)
        tx, ty = KPA * t[self.at, 0], KPA * t[self.at, 1]
        loud = np.hypot(tx, ty) > self.quiet
        self.arrows.set_UVC(np.where(loud, tx, 0.0), np.where(loud, ty, 0.0))
        self.title.set_text(f"{self.name}, {name}")


CODECS = {".mp4": "mp4v", ".avi": "MJPG"}
GIF = ".gif"
FPS = 10.0


def require_video(path: str | os.PathLike[str]) -> str:
    """Suffix of a video that can be written here: one that needs OpenCV is refused where that is not installed."""
    suffix = as_path(path).suffix.lower()
    if suffix == GIF:
        return suffix
    if suffix not in CODECS:
        raise InputError("no kind of video", where=str(path), found=suffix or "no suffix",
                         expected=", ".join((*CODECS, GIF)), hint="end the name with .mp4 or .gif")  # fmt: skip
    if not installed():
        raise InputError(f"a {suffix} video needs OpenCV", where=str(path),
                         hint='pip install "loadid[vision]"; or end the name with .gif')  # fmt: skip
    return suffix


def write_video(path: str | os.PathLike[str], images: Iterable[NDArray[np.uint8]], *, fps: float = FPS) -> int:
    """Write pictures (H, W, 3), uint8, red first, all of one size, as a video, and return their number.

    ``.mp4``, ``.avi`` (both need OpenCV) or ``.gif``, at `fps` pictures a second. The old file is untouched by an
    error.
    """
    target = as_path(path)
    content, count = encoded(images, require_video(path), fps=fps, where=str(target))
    replace(target, content)
    return count


def encoded(
    images: Iterable[NDArray[np.uint8]], suffix: str, *, fps: float = FPS, where: str = "video"
) -> tuple[bytes, int]:
    """Content of the video file that `write_video` writes, and the number of its pictures."""
    rate = positive("fps", fps, where="video", unit="Hz")
    checked = _checked(images, where)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"video{suffix}"
        count = (_gif if suffix == GIF else _coded)(path, checked, rate)
        return path.read_bytes(), count


def film(
    path: str | os.PathLike[str],
    force: ForceMap,
    *,
    truth: ArrayLike | None = None,
    fps: float = FPS,
    progress: Any = None,
) -> int:
    """Write the maps of a sequence as a video, as `pictures` and `write_video`."""
    return write_video(path, pictures(force, truth=truth, progress=progress), fps=fps)


def _checked(images: Iterable[Any], where: str) -> Iterator[NDArray[np.uint8]]:
    """The pictures, all of one size; the first is asked for before a file is opened."""
    coming = iter(images)
    first = next(coming, None)
    if first is None:
        raise InputError("no pictures", where=where, expected="at least one")
    shape = np.shape(first)
    for k, image in enumerate(itertools.chain([first], coming)):
        if np.shape(image) != shape or len(shape) != 3 or shape[2] != 3 or np.asarray(image).dtype != np.uint8:
            raise InputError("a picture that does not fit", where=f"{where}: picture {k + 1}",
                             found=f"{np.asarray(image).dtype} {np.shape(image)}",
                             expected=f"uint8 (H, W, 3), all of {shape[:2]}")  # fmt: skip
        yield np.asarray(image)


def _coded(path: Path, images: Iterator[NDArray[np.uint8]], fps: float) -> int:
    cv2, writer, count = opencv(), None, 0
    try:
        for image in images:
            height, width = (n - n % 2 for n in image.shape[:2])  # codecs take even sides
            if writer is None:
                code = cv2.VideoWriter_fourcc(*CODECS[path.suffix])
                writer = cv2.VideoWriter(str(path), code, fps, (width, height))
                if not writer.isOpened():
                    raise InputError("OpenCV cannot write this kind of video here", where=str(path.suffix),
                                     hint="end the name with .gif or .avi")  # fmt: skip
            writer.write(np.ascontiguousarray(image[:height, :width, ::-1]))
            count += 1
    finally:
        if writer is not None:
            writer.release()
    return count


def _gif(path: Path, images: Iterator[NDArray[np.uint8]], fps: float) -> int:
    from PIL import Image

    first = Image.fromarray(next(images)).quantize(128)
    rest = [Image.fromarray(image).quantize(128, palette=first) for image in images]  # one palette: nothing flickers
    duration = max(20, round(1000 / fps))  # ms; viewers slow down what is shorter
    first.save(path, format="GIF", save_all=True, append_images=rest, duration=duration, loop=0, optimize=False)
    return 1 + len(rest)
