"""What the command reads: images or marker motions, and depth maps beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from ..padfile import DepthKind

if TYPE_CHECKING:
    from structures.flags import Flag

    from ..reading import DepthMap
    from ..vision.frames import Frames
    from ..vision.motions import Motions

Array = NDArray[np.float64]
ARRAYS = (".npy", ".npz")


def is_motion(path: Path) -> bool:
    """Whether a file holds marker motions (T, N, 2 or 3) and no images.

    Raises
    ------
    InputError
        There is no such file or folder.
    """
    if not path.exists():
        raise InputError("there is no such file or folder", where=str(path),
                         expected="a folder of images, an NPY or NPZ stack, a video, or marker motions (CSV, NPY)",
                         hint="loadid tactile demo writes an example")  # fmt: skip
    if path.suffix.lower() == ".csv":
        return True
    if path.suffix.lower() != ".npy":
        return False
    from ..vision.stacks import read_stack

    found = read_stack(path)
    return found.ndim == 3 and found.shape[2] in (2, 3) and found.dtype.kind == "f"


def images(path: Path) -> Frames:
    """Frames of a folder, a stack or a video."""
    from ..vision.frames import frames

    return frames(path)


def motions(path: Path) -> Motions:
    """Marker motions of a file."""
    from ..vision.motions import read_motions

    return read_motions(path)


@dataclass(frozen=True)
class DepthMaps:
    """Depth maps of frames, read one at a time.

    Parameters
    ----------
    load : callable
        Takes the number of a frame, from 0, and gives the numbers in the file.
    count : int
    kind : DepthKind
    name : str
    zero : array or float
        What the unloaded pad shows (m).
    """

    load: Callable[[int], NDArray]
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
        """The same maps with the mean of the first `unloaded` ones as zero, where the file says they are absolute.

        Raises
        ------
        InputError
            If none of them is unloaded.
        """
        if not self.kind.absolute:
            return self
        if unloaded < 1:
            raise InputError("absolute depth maps need unloaded frames", where=self.name,
                             expected="an input that begins with the unloaded pad", hint="--unloaded N")  # fmt: skip
        mean = np.mean([self[k].values for k in range(unloaded)], axis=0)
        return DepthMaps(self.load, self.count, self.kind, self.name, mean)


def depth_maps(path: Path, kind: DepthKind | None, pad_file: Path) -> DepthMaps:
    """Depth maps of an NPY or NPZ stack (T, H, W), or of a folder of NPY files or 16-bit images, in natural order.

    Raises
    ------
    InputError
        No such maps, or the pad file has no table [depth].
    """
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
    from ..vision.stacks import read_stack

    stack = read_stack(path)
    stack = stack[None] if stack.ndim == 2 else stack
    if stack.ndim != 3:
        raise InputError("no depth maps", where=str(path), found=f"shape {stack.shape}", expected="(T, H, W)")
    return DepthMaps(lambda k: stack[k], len(stack), kind, path.name)


def _folder(folder: Path, kind: DepthKind) -> DepthMaps:
    from ..vision.frames import IMAGES, natural, read_image
    from ..vision.stacks import read_stack

    files = sorted((p for p in folder.iterdir() if p.suffix.lower() in (*IMAGES, ".npy")), key=natural)
    if not files:
        raise InputError("the folder holds no depth maps", where=str(folder), expected="NPY files or 16-bit images")

    def load(k: int) -> NDArray:
        return np.asarray(read_stack(files[k])) if files[k].suffix.lower() == ".npy" else read_image(files[k])

    return DepthMaps(load, len(files), kind, folder.name)


@dataclass(frozen=True)
class Unloaded:
    """Frames of the unloaded pad.

    Parameters
    ----------
    frames : list
        Images, or places of the markers (N, 2).
    words : str
        Which they are.
    inside : int
        How many of them the input begins with.
    flags : tuple of Flag
    """

    frames: list[Any]
    words: str
    inside: int
    flags: tuple[Flag, ...] = ()
