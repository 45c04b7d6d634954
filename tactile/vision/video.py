"""Frames of video files, through OpenCV."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from structures.errors import InputError
from structures.flags import Flag

from ..guards.vision import lossy
from .backend import installed, opencv

LOSSLESS = ("FFV1", "HFYU", "FFVH", "DIB ", "RGBA", "I420", "YV12", "Y800", "GREY", "RAW ", "\0\0\0\0", "ULRG", "LAGS")


def open_video(path: Path) -> tuple[Iterator[np.ndarray], int | None, tuple[Flag, ...]]:
    """Frames (H, W, 3) with red first, their number where the file states it, and W406 for a lossy codec.

    Raises
    ------
    InputError
        OpenCV is not installed; no video, or damaged; while iterating, a video that ends early.
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
            "the video cannot be read",
            where=str(path),
            found=f"{path.stat().st_size} bytes",
            expected="a video that OpenCV can decode",
            hint="convert it with ffmpeg, or export its frames as PNG images into a folder",
        )
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
            "the video ends early",
            where=f"{path}: frame {delivered + 1}",
            found=f"{delivered} frames",
            expected=f"{count} frames, as the file states" if count > 0 else "at least one",
            hint="transfer it again; the frames before may be used",
        )
