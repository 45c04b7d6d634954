"""Stacks of images in NumPy files, never unpickled."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from structures.advice import Advice, Spelling
from structures.errors import InputError

PIXELS = "uifb"
SMALLEST = 8  # px along an axis, below which an array is no image


def read_stack(path: Path, key: str | None = None) -> np.ndarray:
    """Array of images of an NPY file (mapped, not loaded) or of an NPZ file.

    Raises
    ------
    InputError
        Damaged; Python objects inside; no array, or several, that could be images.
    """
    try:
        if path.suffix.lower() == ".npy":
            return _checked(np.load(path, mmap_mode="r", allow_pickle=False), path)
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return _checked(archive[_member(archive, path, key)], path)
    except InputError:
        raise
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile, NotImplementedError) as error:
        raise InputError(
            "the file cannot be read",
            where=str(path),
            found=str(error)[:200],
            expected="arrays of numbers, undamaged and without Python objects",
            hint="export it again with numpy.save or numpy.savez of plain arrays; objects are never unpickled",
        ) from None


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
            "no images in the archive" if not images else "several arrays may be the images",
            where=str(path),
            found=", ".join(images or archive.files),
            expected="one array (T, H, W), (T, H, W, 3) or one image",
            hint=Advice(Spelling("key= names it", "save the images alone in a file")),
        )
    return images[0]


def _may_be_images(array: np.ndarray) -> bool:
    shape = array.shape[:-1] if array.ndim >= 3 and array.shape[-1] in (1, 3, 4) else array.shape
    return array.dtype.kind in PIXELS and len(shape) in (2, 3) and min(shape[-2:]) >= SMALLEST


def _checked(array: np.ndarray, path: Path) -> np.ndarray:
    if array.dtype.kind not in PIXELS or array.ndim < 2:
        raise InputError(
            "no images",
            where=str(path),
            found=f"{array.dtype} of shape {array.shape}",
            expected="numbers, (T, H, W), (T, H, W, 3) or one image",
        )
    return array
