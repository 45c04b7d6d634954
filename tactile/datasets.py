"""A small set of data to try tactile sensors with: simulated by a seed, from a closed form and no mesh of a pad."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Photographed", "press"]

SHARES = (0, 0, 0, 0, 0, 0.3, 0.6, 0.8, 1.0)  # of the force, frame by frame


@dataclass(frozen=True, eq=False)
class Photographed:
    """Frames of a press.

    Parameters
    ----------
    images : array, shape (frames, 480, 640), uint8
    depths : array, shape (frames, 160, 180)
        Heights of the surface in m, 0.1 mm a pixel, with 10 um of noise.
    forces : array, shape (frames, 3)
        N on the pad, in x, y, z.
    files : tuple of Path
        What was written.
    """

    images: NDArray[Any]
    depths: NDArray[Any]
    forces: NDArray[Any]
    files: tuple[Path, ...] = ()


def press(folder: str | os.PathLike[str] | None = None, *, seed: int = 0) -> Photographed:
    """A ball that presses a gel pad with 1 N and shears it with 0.25 N: five quiet frames, then four of the press.

    Parameters
    ----------
    folder : path, optional
        Where ``press.npy`` (frames, 480, 640) and ``depth.npy`` (frames, 160, 180) are written.
    seed : int
        Of the noise of camera and depth map.

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    import numpy as np

    from . import Layer, Press, View
    from .vision._images import Scene, grid

    layer, dots = Layer(3e-3, 147e3, 0.3223), grid(17, 20, 0.85e-3)
    view = View.camera(focal=640, centre=(320, 240), distance=25e-3, depth=3e-3, gamma=1.4)
    rest, scene = np.column_stack([dots, np.zeros(len(dots))]), Scene(radius=0.22e-3)
    line = [(np.arange(n) - (n - 1) / 2) * 1e-4 for n in (180, 160)]
    places = np.array(np.meshgrid(*line)).reshape(2, -1).T
    images, depths, rng = [], [], np.random.default_rng(seed)
    for k, share in enumerate(SHARES):
        ball = Press(radius=2.2e-3, force=share, shear=(0.25 * share, 0.0))
        images.append(scene.photograph(view, rest + ball.displacement(layer, dots), seed=100 * seed + k))
        heights = ball.displacement(layer, places)[:, 2].reshape(160, 180)
        depths.append(heights + 1e-5 * rng.standard_normal(heights.shape))
    forces = np.array(SHARES)[:, None] * [0.25, 0.0, -1.0]
    found = Photographed(np.array(images), np.array(depths), forces)
    return found if folder is None else _kept(found, Path(folder))


def _kept(found: Photographed, folder: Path) -> Photographed:
    from dataclasses import replace
    from io import BytesIO

    import numpy as np

    from structures.files import _storage

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("the folder cannot be made", where=str(folder), found=error.strerror or error) from error
    files = (folder / "press.npy", folder / "depth.npy")
    for path, array in zip(files, (found.images, found.depths), strict=True):
        content = BytesIO()
        np.save(content, array, allow_pickle=False)
        _storage.replace(path, content.getvalue())
    return replace(found, files=files)
