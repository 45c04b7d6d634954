"""Where marker motion comes from: images and an eye, places that somebody else tracked, or motion in metres."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loadid._inverse.problem import NoiseSource
from structures._flags import Flag
from structures.errors import InputError

from .._arrays import Array, UnusableFrame
from .._pad.padfile import DepthKind, SensorFile
from .._sensors.observation import DepthMap, Markers
from ..vision._eye import Eye, View
from ..vision._frames import IMAGES, each, frames, natural, read_image, read_stack
from ..vision._motion import MarkerMotion, MarkerMotions, jitter, read_motions

if TYPE_CHECKING:
    from .._pad.pad import Pad


ARRAYS = (".npy", ".npz")


def is_motion(path: Path) -> bool:
    """Whether a file, which must exist, holds marker motions (T, N, 2 or 3) and no images."""
    if not path.exists():
        raise InputError("there is no such file or folder", where=str(path),
                         expected="a folder of images, an NPY or NPZ stack, a video, or marker motions (CSV, NPY)",
                         hint="loadid tactile demo writes an example")  # fmt: skip
    if path.suffix.lower() == ".csv":
        return True
    if path.suffix.lower() != ".npy":
        return False
    found = read_stack(path)
    return found.ndim == 3 and found.shape[2] in (2, 3) and found.dtype.kind == "f"


@dataclass(frozen=True)
class DepthMaps:
    """Depth maps of frames, read one at a time: `load` gives the numbers in the file of a frame, from 0.

    `zero` is what the unloaded pad shows (m).
    """

    load: Callable[[int], NDArray[Any]]
    count: int
    kind: DepthKind
    name: str
    zero: Array | float = 0.0

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, k: int) -> DepthMap:
        values = np.asarray(self.load(k))
        if values.ndim != 2:
            raise InputError("no depth map", where=f"{self.name}: frame {k + 1}", found=f"shape {values.shape}",
                             expected="(H, W): one number per pixel")  # fmt: skip
        return self.kind.map(values, self.zero)

    def __iter__(self) -> Iterator[DepthMap]:
        return (self[k] for k in range(self.count))

    def zeroed(self, unloaded: int) -> DepthMaps:
        """The same maps with the mean of the first `unloaded` ones as zero, where the file says they are absolute."""
        if not self.kind.absolute:
            return self
        if unloaded < 1:
            raise InputError("absolute depth maps need unloaded frames", where=self.name,
                             expected="an input that begins with the unloaded pad", hint="--unloaded N")  # fmt: skip
        mean = np.mean([self[k].values for k in range(unloaded)], axis=0)
        return DepthMaps(self.load, self.count, self.kind, self.name, mean)


def depth_maps(path: Path, kind: DepthKind | None, pad_file: Path) -> DepthMaps:
    """Depth maps of an NPY or NPZ stack (T, H, W), or of a folder of NPY files or 16-bit images, in natural order."""
    if kind is None:
        raise InputError("the depth maps are not described", where=str(pad_file), found="no table [depth]",
                         expected="[depth] with pixel, noise, and the unit of the numbers")  # fmt: skip
    if path.is_dir():
        return _folder(path, kind)
    if not path.is_file():
        raise InputError("there is no such file or folder", where=str(path), expected="a folder, NPY or NPZ")
    if path.suffix.lower() not in ARRAYS:
        raise InputError("no depth maps in a file of this kind", where=str(path), found=path.suffix or "no suffix",
                         expected="NPY, NPZ, or a folder of NPY files or 16-bit images")  # fmt: skip
    stack = read_stack(path)
    stack = stack[None] if stack.ndim == 2 else stack
    if stack.ndim != 3:
        raise InputError("no depth maps", where=str(path), found=f"shape {stack.shape}", expected="(T, H, W)")
    return DepthMaps(lambda k: stack[k], len(stack), kind, path.name)


def _folder(folder: Path, kind: DepthKind) -> DepthMaps:
    files = sorted((p for p in folder.iterdir() if p.suffix.lower() in (*IMAGES, ".npy")), key=natural)
    if not files:
        raise InputError("the folder holds no depth maps", where=str(folder), expected="NPY files or 16-bit images")

    def load(k: int) -> NDArray[Any]:
        return np.asarray(read_stack(files[k])) if files[k].suffix.lower() == ".npy" else read_image(files[k])

    return DepthMaps(load, len(files), kind, folder.name)


@dataclass(frozen=True)
class Unloaded:
    """Frames of the unloaded pad (images, or places (N, 2)), which they are, how many the input begins with."""

    frames: list[Any]
    words: str
    inside: int
    flags: tuple[Flag, ...] = ()


FIRST = 5  # frames that are taken as unloaded where nothing else is said
LEAST = 3  # frames from which noise can be measured
AS_STATED = NoiseSource("stated", "as stated")
MOVED = 5.0  # stds of a mean motion that unloaded frames may show


@dataclass(frozen=True)
class MarkerSource:
    """Marker motion by frames: ``read(frame, depth) -> (motion (N, 2 or 3) in m, flags)``, and what is known of it.

    `reference` says which frames are the rest, `noise_size` the noise in px and um where there is an image, `inside`
    how many unloaded frames the input begins with, `count` how many frames it has, where known.
    """

    frames: Iterator[Any]
    read: Callable[[Any, DepthMap | None], tuple[Array, list[Flag | None]]]
    markers: Markers
    reference: str
    noise_size: str
    noise_source: NoiseSource
    inside: int
    count: int | None
    flags: tuple[Flag, ...] = ()
    notes: list[str] = field(default_factory=list)

    @property
    def noise_words(self) -> str:
        """Size of the noise, and where it comes from."""
        return ", ".join(part for part in (self.noise_size, self.noise_source.text) if part)


def look(source: Path, settings: SensorFile, pad: Pad, unloaded: str | None, allow: tuple[str, ...]) -> MarkerSource:
    """Motion of the markers of an input.

    `unloaded` is the number of frames that it begins with, or a path; default the first frame where the noise is
    stated, else the first five.
    """
    if not is_motion(source):
        return _images(source, settings, pad, unloaded, allow)
    found = read_motions(source)
    return (
        _pixels(source, found, settings, pad, unloaded, allow)
        if settings.unit == "px"
        else _metres(source, found, settings, unloaded)
    )


# -- images -----------------------------------------------------------------------------------------------------------
def _images(source: Path, settings: SensorFile, pad: Pad, unloaded: str | None, allow: tuple[str, ...]) -> MarkerSource:
    coming = frames(source)
    chosen, rest = _unloaded(each(coming), source.name, settings, unloaded, frames)
    eye = first_eye(settings, pad, chosen.frames, allow)
    flags = (*coming.flags, *chosen.flags)
    notes = _moved(eye, chosen.frames) if chosen.inside > 1 and unloaded is None else []
    return _seen(eye, rest, eye.read, settings, chosen, coming.count, flags, notes)


def _eye(settings: SensorFile, pad: Pad, reference: Any, still: list[Any], allow: tuple[str, ...]) -> Eye:
    noise = None if settings.noise is None else settings.noise[0]
    if settings.noise is not None and settings.noise[1] != "px":
        raise InputError("the noise of markers in images is in px", where=f"{settings.path}: [markers] noise",
                         found=f"{settings.noise[0]:g} m", expected='noise = "0.02 px"')  # fmt: skip
    eye = Eye(_view(settings), reference, unloaded=still if noise is None else None, noise=noise, size=pad.size,
              allow=allow, **settings.tracking)  # fmt: skip
    if noise is not None and len(still) > 1:
        eye.tracker.zero(still)
    return eye


def first_eye(settings: SensorFile, pad: Pad, still: list[Any], allow: tuple[str, ...]) -> Eye:
    """The eye whose reference is the first of some unloaded frames that shows its markers."""
    for reference in still[:-1]:
        try:
            return _eye(settings, pad, reference, still, allow)
        except UnusableFrame:
            continue
    return _eye(settings, pad, still[-1], still, allow)


def _view(settings: SensorFile) -> View:
    if settings.view is None:
        raise InputError("the camera is not described", where=str(settings.path), found="no table [camera]",
                         expected="[camera] with a lens, a homography, or points and their pixels",
                         hint="loadid tactile demo writes an example")  # fmt: skip
    return settings.view


def _moved(eye: Eye, frames: list[Any]) -> list[str]:
    """Whether frames that nobody called unloaded move: then they were not, and the rest is wrong."""
    last = eye.tracker.step(frames[-1])
    if not last.tracked[eye.kept].any():
        return []
    moved = np.abs(np.nanmean(last.moved[eye.kept], axis=0))
    level = eye.noise_px / np.sqrt(max(int(last.tracked.sum()), 1))
    if np.all(moved < MOVED * level):
        return []
    words = f"the first {len(frames)} frames were taken as unloaded, but the markers move by {moved.max():.2g} px from"
    return [f"{words} their mean to the last of them: state unloaded frames with --unloaded"]


# -- places that somebody else tracked --------------------------------------------------------------------------------
class PlaceTracker:
    """A tracker whose markers come told apart: takes their places (N, 2) in px, NaN where one is lost."""

    def __init__(self, points: Array) -> None:
        self.points = points
        self._frame = 0

    def step(self, places: Array) -> MarkerMotion:
        """Motion of the markers in a frame."""
        self._frame += 1
        return MarkerMotion.of(self.points, places, self._frame)


def _pixels(
    source: Path, found: MarkerMotions, settings: SensorFile, pad: Pad, unloaded: str | None, allow: tuple[str, ...]
) -> MarkerSource:
    """Places in px through a view."""
    if found.heights is not None:
        raise InputError("marker motion in px has two coordinates", where=str(source), found="three",
                         expected="x and y", hint='[markers] unit = "mm" for places in a length')  # fmt: skip
    kept = np.isfinite(found.points).all(axis=1)
    places = found.places[:, kept]
    chosen, rest = _unloaded(
        iter(places), source.name, settings, unloaded, lambda p: iter(read_motions(p).places[:, kept])
    )
    eye = _eye(settings, pad, found.points[kept], chosen.frames, allow)
    eye.tracker = PlaceTracker(eye.tracker.points)  # type: ignore[assignment]  # it asks for points and step only
    return _seen(eye, rest, eye.read, settings, chosen, len(places), found.flags, list(found.notes))


def _metres(source: Path, found: MarkerMotions, settings: SensorFile, unloaded: str | None) -> MarkerSource:
    """Places in a length, in two or three coordinates: no camera."""
    factor = float(settings.unit)
    kept = np.isfinite(found.points).all(axis=1)
    places = factor * (found.places if found.heights is None else np.dstack([found.places, found.heights]))[:, kept]
    chosen, rest = _unloaded(iter(places), source.name, settings, unloaded, _no_other)
    stack = np.array(chosen.frames)
    zero = np.nanmean(stack, axis=0)
    noise, origin = _noise_in_metres(settings, stack)

    def read(frame: Array, depth: DepthMap | None) -> tuple[Array, list[Flag | None]]:
        return frame - zero, []

    markers = Markers(zero[:, :2], noise, "XY" if found.heights is None else "XYZ")
    return MarkerSource(
        rest, read, markers, chosen.words, "", origin, chosen.inside, len(places), found.flags, list(found.notes)
    )


def _no_other(path: Path) -> Iterator[Any]:
    raise InputError("unloaded frames of marker motion are in the same file", where=f"--unloaded {path}",
                     expected="how many frames the input begins with", hint="--unloaded 5")  # fmt: skip


def _noise_in_metres(settings: SensorFile, stack: Array) -> tuple[Any, NoiseSource]:
    if settings.noise is not None:
        if settings.noise[1] == "px":
            raise InputError("the noise of markers is in px, their motion in a length",
                             where=f"{settings.path}: [markers] noise", expected='noise = "5 um"')  # fmt: skip
        return settings.noise[0], AS_STATED
    found = jitter(stack)
    if not np.all(found.std > 0):
        raise InputError("the unloaded frames show no noise at all", where="--unloaded", found="repeated places",
                         expected="frames as they were measured",
                         hint='or state it: [markers] noise = "5 um"')  # fmt: skip
    return found.std, _measured(len(stack))


def _measured(count: int) -> NoiseSource:
    return NoiseSource("quiet", f"measured on {count} unloaded frames")


# -- shared -----------------------------------------------------------------------------------------------------------
def _seen(
    eye: Eye, frames: Iterator[Any], read: Any, settings: SensorFile, chosen: Unloaded, count: int | None,
    flags: tuple[Flag, ...], notes: list[str],
) -> MarkerSource:  # fmt: skip
    px = " x ".join(f"{s:.3g}" for s in eye.noise_px)
    um = " x ".join(f"{1e6 * s:.3g}" for s in np.median(eye.noise, axis=0))
    source = AS_STATED if settings.noise is not None else _measured(len(chosen.frames))
    size = f"{px} px = {um} um"
    markers = Markers(eye.markers, eye.noise, slope=eye.slope)
    return MarkerSource(frames, read, markers, chosen.words, size, source, chosen.inside, count, flags, notes)


def _unloaded(
    coming: Iterator[Any], name: str, settings: SensorFile, asked: str | None, opened: Callable[[Path], Any]
) -> tuple[Unloaded, Iterator[Any]]:
    """Unloaded frames, and all frames of the input again."""
    if asked is not None and not asked.strip().isdecimal():
        path = Path(asked)
        others = opened(path)
        listed = [frame for frame in each(others) if not isinstance(frame, UnusableFrame)]
        _enough(len(listed), settings, f"--unloaded {path}")
        return Unloaded(listed, f"{_frames(len(listed))} of {path}", 0, getattr(others, "flags", ())), coming
    many = int(asked) if asked is not None else FIRST if settings.noise is None else 1
    if many < 1:
        raise InputError("no unloaded frame", where="--unloaded", found=asked, expected="a number >= 1, or a path")
    taken: list[Any] = []
    first: list[Any] = []
    while len(taken if asked is not None else first) < many and (frame := next(coming, None)) is not None:
        taken.append(frame)
        first += [] if isinstance(frame, UnusableFrame) else [frame]
    if not first:
        raise taken[0] if taken else InputError("there are no frames", where=name)
    if len(taken) < many and asked is not None:
        raise InputError("the input has fewer frames", where=f"--unloaded {asked}", found=len(taken), expected=many)
    _enough(len(first), settings, name)
    words = f"first {_frames(len(taken))} of {name}" if len(taken) > 1 else f"first frame of {name}"
    words += f", {len(taken) - len(first)} of them unusable" if len(first) < len(taken) else ""
    return Unloaded(first, words, len(taken)), itertools.chain(taken, coming)


def _frames(count: int) -> str:
    return f"{count} frame{'s' if count > 1 else ''}"


def _enough(count: int, settings: SensorFile, where: str) -> None:
    if settings.noise is None and count < LEAST:
        raise InputError(
            "too few unloaded frames to measure the noise on", where=where, found=count, expected=f"at least {LEAST}",
            hint='record a second of the untouched sensor, or state it: [markers] noise = "0.02 px"',
        )  # fmt: skip
