"""Frames from wherever they are: folders of images, NPY and NPZ stacks, videos, cameras, any iterator of arrays."""

from __future__ import annotations

import contextlib
import io
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from structures._advice import Advice, Spelling
from structures._flags import Flag
from structures.errors import InputError, whole

from .._arrays import UnusableFrame
from .._guards import lossy, missing_frames
from ._images import Grey, grey, installed, opencv
from ._pipe import Pipe

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
    except (
        Exception
    ) as error:  # numpy parses the header by the tokenizer of Python, archives by zlib: anything may come
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


GONE = 10  # reads of a camera without a frame, one after another, from which on it is taken for gone


class Capture:
    """Frames (H, W, 3) of an OpenCV capture, red first, a file or a camera: an iterator.

    `count` is the number that a file states, None of a camera; `time` the stamp (s) of the last frame, None where the
    source gives none. A file that ends early is refused; a frame that a camera fails to give is an `UnusableFrame`, ten
    of them one after another are its end.
    """

    def __init__(self, cv2: Any, capture: Any, name: str, *, owned: bool) -> None:
        self._cv2, self._capture, self._name, self._owned = cv2, capture, name, owned
        stated = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.count = stated if stated > 0 else None
        self._read = self._delivered = self._failed = 0
        self._over = False
        self.time: float | None = None

    @property
    def flags(self) -> tuple[Flag, ...]:
        """W406 for a lossy codec."""
        if self.count is None:
            return ()
        four = int(self._capture.get(self._cv2.CAP_PROP_FOURCC))
        codec = four.to_bytes(4, "little", signed=False).decode("latin-1")
        return () if codec.upper() in LOSSLESS else (lossy(codec),)

    def __iter__(self) -> Capture:
        return self

    def __next__(self) -> np.ndarray:
        if self._over:
            raise StopIteration
        there, image = self._capture.read()
        self._read += 1
        if not there:
            raise self._ended()
        self._delivered, self._failed = self._delivered + 1, 0
        stamp = float(self._capture.get(self._cv2.CAP_PROP_POS_MSEC))
        self.time = 1e-3 * stamp if stamp > 0 or (stamp == 0 and self._delivered == 1 and self.count) else None
        return np.asarray(image if image.ndim == 2 else image[..., ::-1])

    def _ended(self) -> Exception:
        """What a read without a frame means."""
        where, self.time = f"{self._name}: frame {self._read}", None
        if self.count is None and self._read == 1 and not self._capture.isOpened():
            self.close()
            return InputError("the capture is not open", where=self._name, hint="look at its index and its cable")
        if self.count is None and self._failed + 1 < GONE and self._capture.isOpened():
            self._failed += 1
            return UnusableFrame("the camera gave no frame", where=where, hint="look at its cable and the light")
        self.close()
        if self.count is None:
            return InputError(
                "the camera gives no more frames", where=where, found=f"{self._delivered} frames, then {GONE} failures",
                hint="look at its cable, and at what else uses it; the frames before may be used",
            )  # fmt: skip
        if self._delivered and self._delivered >= self.count - 1:  # a container without an index may state one too many
            return StopIteration()
        return InputError(
            "the video ends early", where=where, found=f"{self._delivered} frames",
            expected=f"{self.count} frames, as the file states",
            hint="transfer it again; the frames before may be used",
        )  # fmt: skip

    def close(self) -> None:
        """Give no more frames; a capture that was opened here is released."""
        self._over = True
        if self._owned:
            self._capture.release()


def open_video(path: Path) -> Capture:
    """Frames of a video file."""
    _require_opencv("a video", str(path), "; or export the frames as PNG images into a folder")
    cv2 = opencv()
    with _quiet(cv2):
        capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise InputError(
            "the video cannot be read", where=str(path), found=f"{path.stat().st_size} bytes",
            expected="a video that OpenCV can decode",
            hint="convert it with ffmpeg, or export its frames as PNG images into a folder",
        )  # fmt: skip
    return Capture(cv2, capture, str(path), owned=True)


def open_camera(index: int | str) -> Capture:
    """Frames of a camera by its number or device."""
    _require_opencv("a camera", f"camera {index}", "; or pass an iterable of images")
    cv2 = opencv()
    with _quiet(cv2):
        capture = cv2.VideoCapture(index)
    if not capture.isOpened():
        raise InputError(
            "the camera cannot be opened", where=f"camera {index}", expected="the number of a camera, from 0",
            hint="look at its cable, at rights on its device and at what else uses it",
        )  # fmt: skip
    return Capture(cv2, capture, f"camera {index}", owned=True)


def _require_opencv(what: str, where: str, otherwise: str) -> None:
    if not installed():
        raise InputError(f"{what} needs OpenCV", where=where, hint=f'pip install "loadid[vision]"{otherwise}')


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


IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm")
VIDEOS = (".avi", ".mp4", ".mkv", ".mov", ".m4v", ".mpg", ".mpeg", ".webm", ".wmv")
NUMBERS = re.compile(r"(\d+)")


class Frames:
    """Grey frames of one size, one after the other.

    An iterator of uint8 images (H, W). A frame that cannot be read, or has another size than the first, raises an error
    that names it; the next call goes on with the frame after it.

    Attributes
    ----------
    flags : tuple of Flag
        Frames missing in a folder, a lossy codec.
    count : int or None
        Number of frames, where it is known before they are read.
    delivered : int
        Frames given so far.
    time : float or None
        Stamp (s) of the last frame, where the source has one: of a video from its start, of a camera by its own clock.
    origin : int, str or None
        Number or device of a camera that was opened for these frames, by which it can be opened again.
    """

    def __init__(
        self, images: Iterable[Any], *, name: str = "frames", count: int | None = None, flags: Iterable[Flag] = ()
    ) -> None:
        self._images = iter(images)
        self._name = name
        self._size: tuple[int, ...] | None = None
        self._unusable = 0
        self.count, self.flags, self.delivered = count, tuple(flags), 0
        self.origin: int | str | None = None

    @property
    def time(self) -> float | None:
        """Stamp (s) of the last frame, where the source has one."""
        return self._images.time if isinstance(self._images, Capture) else None

    @property
    def camera(self) -> bool:
        """Whether the source does not wait to be read: a camera, no file."""
        return isinstance(self._images, Capture) and self.count is None

    def close(self) -> None:
        """Release a camera or video that was opened for these frames."""
        if isinstance(self._images, Capture):
            self._images.close()

    def __iter__(self) -> Iterator[Grey]:
        return self

    def __next__(self) -> Grey:
        try:
            found = self._next(f"{self._name}: frame {self.delivered + self._unusable + 1}")
        except UnusableFrame:
            self._unusable += 1
            raise
        self.delivered += 1
        return found

    def _next(self, where: str) -> Grey:
        try:
            image = next(self._images)
        except StopIteration:
            if self.delivered + self._unusable == 0:
                raise InputError("there are no frames", where=self._name) from None
            raise
        found = grey(image, where=where)
        self._size = self._size or found.shape
        if found.shape != self._size:
            raise UnusableFrame(
                "a frame of another size", where=where, found=f"{found.shape[1]} x {found.shape[0]} px",
                expected=f"{self._size[1]} x {self._size[0]} px, as the first",
                hint="frames of one camera at one setting make a sequence: split it where the size changes",
            )  # fmt: skip
        return found


def each(source: Iterable[Any]) -> Iterator[Any]:
    """Every frame of a source; in the place of one that cannot be used, the error that says why."""
    coming = iter(source)
    while True:
        try:
            frame = next(coming)
        except StopIteration:
            return
        except UnusableFrame as error:
            if not isinstance(coming, Frames | Capture):
                raise  # any other iterator is over once it has raised
            frame = error
        yield frame


def frames(source: Any, *, key: str | None = None) -> Frames:
    """Frames of a source, as grey uint8 images of one size.

    Parameters
    ----------
    source : path, array, number of a camera, cv2.VideoCapture or iterable
        Folder of images (PNG, JPEG, BMP, TIFF, PGM), taken in the natural order of their names; one image; NPY or NPZ
        file with an array (T, H, W), (T, H, W, 3) or one image; video file (needs OpenCV); array of these shapes; a
        camera by its number, 0 the first, or by its device (``"/dev/video0"``), or a capture that is open, which stays
        yours to release (need OpenCV); ``"-"`` or a binary file for images that come through a pipe, one after another
        (PGM, PPM, PNG, JPEG, NPY); any iterable of images.
    key : str, optional
        Array of an NPZ file; needed where several could be frames.

    Raises
    ------
    InputError
        Nothing there, not readable, no images; later, while iterating: a frame that cannot be read, of another size,
        or a video that ends early. The message names the frame.
    """
    if source == "-" if isinstance(source, str) else isinstance(source, io.BufferedIOBase | io.RawIOBase):
        return Frames(Pipe(sys.stdin.buffer if source == "-" else source), name="pipe")
    if isinstance(source, str | Path):
        return _from_path(Path(source), key)
    if isinstance(source, np.ndarray):
        return _from_stack(source, "array")
    if isinstance(source, Frames):
        return source
    if whole(source) is not None:
        return _from_camera(int(source))
    if type(source).__module__.partition(".")[0] == "cv2":
        return _from_capture(Capture(opencv(), source, "capture", owned=False), "capture")
    if not isinstance(source, Iterable):
        raise InputError(
            "no frames", where="frames", found=type(source).__name__, expected="a path, array, camera or iterable"
        )
    return Frames(source)


def _from_path(path: Path, key: str | None) -> Frames:
    if path.is_dir():
        return _from_folder(path)
    if path.is_char_device():
        return _from_camera(str(path))
    if not path.is_file():
        raise InputError("there is no such file or folder", where=str(path))
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        return _from_stack(read_stack(path, key), path.name)
    if suffix in VIDEOS:
        return _from_capture(open_video(path), path.name)
    if suffix in IMAGES:
        return Frames([read_image(path)], name=path.name, count=1)
    raise InputError(
        "no frames in a file of this kind", where=str(path), found=suffix or "no suffix",
        expected=", ".join((".npy", ".npz", *IMAGES, *VIDEOS)),
    )  # fmt: skip


def _from_camera(which: int | str) -> Frames:
    found = _from_capture(open_camera(which), f"camera {which}")
    found.origin = which
    return found


def _from_capture(capture: Capture, name: str) -> Frames:
    return Frames(capture, name=name, count=capture.count, flags=capture.flags)


def _from_folder(folder: Path) -> Frames:
    files = sorted((p for p in folder.iterdir() if p.suffix.lower() in IMAGES), key=natural)
    if not files:
        raise InputError("the folder holds no images", where=str(folder), expected=f"files {', '.join(IMAGES)}")
    flag = missing_frames(missing_numbers([p.stem for p in files]), folder.name)
    return Frames(map(read_image, files), name=folder.name, count=len(files), flags=(flag,) if flag else ())


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
        raise UnusableFrame(
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
