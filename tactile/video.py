"""Videos of force maps, and of any pictures: MP4 and AVI by OpenCV, GIF by Pillow; written whole or not at all."""

from __future__ import annotations

import itertools
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.storage import as_path, replace
from structures.values import positive

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .forcemap import ForceMap

CODECS = {".mp4": "mp4v", ".avi": "MJPG"}
GIF = ".gif"
FPS = 10.0


def require_video(path: str | os.PathLike) -> str:
    """Suffix of a video that can be written here.

    Raises
    ------
    InputError
        Another suffix; one that needs OpenCV where it is not installed.
    """
    suffix = as_path(path).suffix.lower()
    if suffix == GIF:
        return suffix
    if suffix not in CODECS:
        raise InputError("no kind of video", where=str(path), found=suffix or "no suffix",
                         expected=", ".join((*CODECS, GIF)), hint="end the name with .mp4 or .gif")  # fmt: skip
    from .vision.backend import installed

    if not installed():
        raise InputError(f"a {suffix} video needs OpenCV", where=str(path),
                         hint='pip install "loadid[vision]"; or end the name with .gif')  # fmt: skip
    return suffix


def write_video(path: str | os.PathLike, images: Iterable[NDArray[np.uint8]], *, fps: float = FPS) -> int:
    """Write pictures as a video, and return their number.

    Parameters
    ----------
    path : path
        ``.mp4``, ``.avi`` (both need OpenCV) or ``.gif``.
    images : iterable of arrays (H, W, 3), uint8
        Red first, all of one size.
    fps : float
        Pictures a second.

    Raises
    ------
    InputError
        No pictures, pictures of different sizes, a suffix that names no video, a file that cannot be written. The old
        file is untouched then.
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
    path: str | os.PathLike, force: ForceMap, *, truth: ArrayLike | None = None, fps: float = FPS, progress: Any = None
) -> int:
    """Write the maps of a sequence as a video; see `write_video` and `tactile.plots.film`.

    Parameters
    ----------
    truth : array (frames, P, 3), optional
        Known tractions (Pa), shown beside the maps.
    progress : callable, optional
        Called as ``progress(fraction, text)``.
    """
    from .plots.film import pictures

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
    from .vision.backend import opencv

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
