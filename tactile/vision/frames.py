"""Frames from wherever they are: a folder of images, NPY and NPZ stacks, video files, any iterator of arrays."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from structures.errors import InputError
from structures.flags import Flag

from ..guards.vision import missing_frames
from .grey import Grey, grey

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm")
VIDEOS = (".avi", ".mp4", ".mkv", ".mov", ".m4v", ".mpg", ".mpeg", ".webm", ".wmv")
NUMBERS = re.compile(r"(\d+)")


class Frames:
    """Grey frames of one size, one after the other.

    An iterator of uint8 images (H, W); a frame that cannot be read, or has another size than the first, raises an error
    that names it.

    Attributes
    ----------
    flags : tuple of Flag
        Frames missing in a folder, a lossy codec.
    count : int or None
        Number of frames, where it is known before they are read.
    delivered : int
        Frames given so far.
    """

    def __init__(
        self, images: Iterable[Any], *, name: str = "frames", count: int | None = None, flags: Iterable[Flag] = ()
    ) -> None:
        self._images = iter(images)
        self._name = name
        self._size: tuple[int, ...] | None = None
        self.count, self.flags, self.delivered = count, tuple(flags), 0

    def __iter__(self) -> Iterator[Grey]:
        return self

    def __next__(self) -> Grey:
        where = f"{self._name}: frame {self.delivered + 1}"
        try:
            image = next(self._images)
        except StopIteration:
            if self.delivered == 0:
                raise InputError("there are no frames", where=self._name) from None
            raise
        found = grey(image, where=where)
        self._size = self._size or found.shape
        if found.shape != self._size:
            raise InputError(
                "a frame of another size",
                where=where,
                found=f"{found.shape[1]} x {found.shape[0]} px",
                expected=f"{self._size[1]} x {self._size[0]} px, as the first",
                hint="frames of one camera at one setting make a sequence: split it where the size changes",
            )
        self.delivered += 1
        return found


def frames(source: Any, *, key: str | None = None) -> Frames:
    """Frames of a source, as grey uint8 images of one size.

    Parameters
    ----------
    source : path, array or iterable
        Folder of images (PNG, JPEG, BMP, TIFF, PGM), taken in the natural order of their names; one image; NPY or NPZ
        file with an array (T, H, W), (T, H, W, 3) or one image; video file (needs OpenCV); array of these shapes; any
        iterable of images.
    key : str, optional
        Array of an NPZ file; needed where several could be frames.

    Raises
    ------
    InputError
        Nothing there, not readable, no images; later, while iterating: a frame that cannot be read, of another size,
        or a video that ends early. The message names the frame.
    """
    if isinstance(source, str | Path):
        return _from_path(Path(source), key)
    if isinstance(source, np.ndarray):
        return _from_stack(source, "array")
    if isinstance(source, Frames):
        return source
    if not isinstance(source, Iterable):
        raise InputError(
            "no frames", where="frames", found=type(source).__name__, expected="a path, an array or an iterable"
        )
    return Frames(source)


def _from_path(path: Path, key: str | None) -> Frames:
    if path.is_dir():
        return _from_folder(path)
    if not path.is_file():
        raise InputError("there is no such file or folder", where=str(path))
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        from .stacks import read_stack

        return _from_stack(read_stack(path, key), path.name)
    if suffix in VIDEOS:
        from .video import open_video

        images, count, flags = open_video(path)
        return Frames(images, name=path.name, count=count, flags=flags)
    if suffix in IMAGES:
        return Frames([read_image(path)], name=path.name, count=1)
    raise InputError(
        "no frames in a file of this kind",
        where=str(path),
        found=suffix or "no suffix",
        expected=", ".join((".npy", ".npz", *IMAGES, *VIDEOS)),
    )


def _from_folder(folder: Path) -> Frames:
    files = sorted((p for p in folder.iterdir() if p.suffix.lower() in IMAGES), key=natural)
    if not files:
        raise InputError("the folder holds no images", where=str(folder), expected=f"files {', '.join(IMAGES)}")
    flag = missing_frames(missing_numbers([p.stem for p in files]), folder.name)
    images = (read_image(path) for path in files)
    return Frames(images, name=folder.name, count=len(files), flags=(flag,) if flag else ())


def _from_stack(array: np.ndarray, name: str) -> Frames:
    one = array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (3, 4) and array.shape[0] > 4)
    if not one and not (array.ndim == 3 or (array.ndim == 4 and array.shape[3] in (1, 3, 4))):
        raise InputError(
            "no stack of images", where=name, found=f"shape {array.shape}", expected="(T, H, W) or (T, H, W, 3)"
        )
    return Frames([array] if one else array, name=name, count=1 if one else len(array))


def read_image(path: Path) -> np.ndarray:
    """Pixels of one image file, (H, W) or (H, W, 3).

    Raises
    ------
    InputError
        Damaged, or no image.
    """
    from PIL import Image

    try:
        with Image.open(path) as image:
            sixteen = image.mode.startswith("I;16")
            return (
                np.asarray(image) if sixteen or image.mode in ("L", "RGB", "RGBA") else np.asarray(image.convert("RGB"))
            )
    except Exception as error:  # a damaged file may raise anything in a decoder
        raise InputError(
            "the image cannot be read", where=str(path), found=str(error)[:200], hint="copy or export it again"
        ) from None


def natural(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Order in which ``frame10`` comes after ``frame9``."""
    parts = NUMBERS.split(path.name)
    return tuple((1, int(part), "") if k % 2 else (0, 0, part.lower()) for k, part in enumerate(parts))


def missing_numbers(stems: list[str]) -> list[int]:
    """Numbers missing in names that differ in one number only, which counts by one; else none."""
    parts = [NUMBERS.split(stem) for stem in stems]
    if len(stems) < 2 or len({len(p) for p in parts}) != 1:
        return []
    varying = [k for k in range(len(parts[0])) if len({p[k] for p in parts}) > 1]
    if len(varying) != 1 or varying[0] % 2 == 0:
        return []
    numbers = sorted(int(p[varying[0]]) for p in parts)
    return _gaps(numbers)


def _gaps(numbers: list[int]) -> list[int]:
    """What lacks between the first and the last; nothing where the usual step is not one."""
    steps = np.diff(numbers)
    usual = int(np.median(steps))
    if usual < 1 or len(steps) < 2 or numbers[-1] - numbers[0] > 100 * len(numbers) * usual:
        return []
    expected = range(numbers[0], numbers[-1] + 1, usual)
    return sorted(set(expected) - set(numbers))
