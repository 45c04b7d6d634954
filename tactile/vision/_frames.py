"""Frames from wherever they are: folders of images, NPY and NPZ stacks, video files, any iterator of arrays."""

from __future__ import annotations

import contextlib
import re
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from structures._advice import Advice, Spelling
from structures._flags import Flag
from structures.errors import InputError

from .._guards import lossy, missing_frames
from ._images import Grey, grey, installed, opencv

PIXELS = "uifb"
SMALLEST = 8  # px along an axis, below which an array is no image


def read_stack(path: Path, key: str | None = None) -> np.ndarray:
    """Array of images of an NPY file (mapped, not loaded) or of an NPZ file, without Python objects inside."""
    try:
        if path.suffix.lower() == ".npy":
            return _checked(np.load(path, mmap_mode="r", allow_pickle=False), path)
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return _checked(archive[_member(archive, path, key)], path)
    except InputError:
        raise
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile, NotImplementedError) as error:
        raise InputError(
            "the file cannot be read", where=str(path), found=str(error)[:200],
            expected="arrays of numbers, undamaged and without Python objects",
            hint="export it again with numpy.save or numpy.savez of plain arrays; objects are never unpickled",
        ) from None  # fmt: skip


def _member(archive: Any, path: Path, key: str | None) -> str:
    if key is not None:
        if key not in archive.files:
            raise InputError("there is no such array", where=str(path), found=key, expected=", ".join(archive.files))
        return key
    images = [name for name in archive.files if _may_be_images(archive[name])]
    if len(images) > 1:
        eight = [name for name in images if archive[name].dtype == np.uint8]
        images = eight or images
    if len(images) != 1:
        raise InputError(
            "no images in the archive" if not images else "several arrays may be the images", where=str(path),
            found=", ".join(images or archive.files), expected="one array (T, H, W), (T, H, W, 3) or one image",
            hint=Advice(Spelling("key= names it", "save the images alone in a file")),
        )  # fmt: skip
    return str(images[0])


def _may_be_images(array: np.ndarray) -> bool:
    shape = array.shape[:-1] if array.ndim >= 3 and array.shape[-1] in (1, 3, 4) else array.shape
    return array.dtype.kind in PIXELS and len(shape) in (2, 3) and min(shape[-2:]) >= SMALLEST


def _checked(array: np.ndarray, path: Path) -> np.ndarray:
    if array.dtype.kind not in PIXELS or array.ndim < 2:
        raise InputError(
            "no images", where=str(path), found=f"{array.dtype} of shape {array.shape}",
            expected="numbers, (T, H, W), (T, H, W, 3) or one image",
        )  # fmt: skip
    return array


LOSSLESS = ("FFV1", "HFYU", "FFVH", "DIB ", "RGBA", "I420", "YV12", "Y800", "GREY", "RAW ", "\0\0\0\0", "ULRG", "LAGS")


def open_video(path: Path) -> tuple[Iterator[np.ndarray], int | None, tuple[Flag, ...]]:
    """Frames (H, W, 3) with red first, their number where the file states it, and W406 for a lossy codec.

    While iterating, a video that ends early is refused.
    """
    if not installed():
        raise InputError(
            "a video needs OpenCV",
            where=str(path),
            hint='pip install "loadid[vision]"; or export the frames as PNG images into a folder',
        )
    cv2 = opencv()
    capture = _opened(cv2, path)
    count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    codec = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=False).decode("latin-1")
    flags = () if codec.upper() in LOSSLESS else (lossy(codec),)
    return _images(cv2, capture, path, count), count if count > 0 else None, flags


def _opened(cv2: Any, path: Path) -> Any:
    with _quiet(cv2):
        capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise InputError(
            "the video cannot be read", where=str(path), found=f"{path.stat().st_size} bytes",
            expected="a video that OpenCV can decode",
            hint="convert it with ffmpeg, or export its frames as PNG images into a folder",
        )  # fmt: skip
    return capture


@contextlib.contextmanager
def _quiet(cv2: Any) -> Iterator[None]:
    """OpenCV prints nothing: what it would say is in the error that follows."""
    logs = getattr(getattr(cv2, "utils", None), "logging", None)
    if logs is None:
        yield
        return
    level = logs.getLogLevel()
    logs.setLogLevel(logs.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        logs.setLogLevel(level)


def _images(cv2: Any, capture: Any, path: Path, count: int) -> Iterator[np.ndarray]:
    delivered = 0
    try:
        while True:
            there, image = capture.read()
            if not there:
                break
            delivered += 1
            yield image if image.ndim == 2 else image[..., ::-1]
    finally:
        capture.release()
    if delivered == 0 or delivered < count - 1:  # a container without an index may state one too many
        raise InputError(
            "the video ends early", where=f"{path}: frame {delivered + 1}", found=f"{delivered} frames",
            expected=f"{count} frames, as the file states" if count > 0 else "at least one",
            hint="transfer it again; the frames before may be used",
        )  # fmt: skip


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
                "a frame of another size", where=where, found=f"{found.shape[1]} x {found.shape[0]} px",
                expected=f"{self._size[1]} x {self._size[0]} px, as the first",
                hint="frames of one camera at one setting make a sequence: split it where the size changes",
            )  # fmt: skip
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
        return _from_stack(read_stack(path, key), path.name)
    if suffix in VIDEOS:
        images, count, flags = open_video(path)
        return Frames(images, name=path.name, count=count, flags=flags)
    if suffix in IMAGES:
        return Frames([read_image(path)], name=path.name, count=1)
    raise InputError(
        "no frames in a file of this kind", where=str(path), found=suffix or "no suffix",
        expected=", ".join((".npy", ".npz", *IMAGES, *VIDEOS)),
    )  # fmt: skip


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
    """Pixels of one image file, (H, W) or (H, W, 3)."""
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
