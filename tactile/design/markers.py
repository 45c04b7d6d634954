"""How many markers count, where neighbours share part of their noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.values import reals

from .parameters import Skin

Array = NDArray[np.float64]
REACH = 8.0  # correlation lengths summed over


def common(skin: Skin, kx: ArrayLike, ky: ArrayLike) -> Array:
    """Noise of a wave's amplitude over that of independent markers: 1 - s + s f(kx) f(ky), f a sum over the lattice.

    The sum is exact for an endless square lattice, from independent markers (pitch beyond the correlation length) to a
    continuum.
    """
    x, y = np.broadcast_arrays(reals(kx, where="kx"), reals(ky, where="ky"))
    if skin.correlated == 0:
        return np.ones(x.shape)
    f = [_lattice(skin.pitch, skin.correlation, np.abs(k)) for k in (x, y)]
    return 1 - skin.correlated + skin.correlated * f[0] * f[1]


def effective_markers(skin: Skin, kx: ArrayLike = 0.0, ky: ArrayLike = 0.0) -> Array:
    """Independent markers that would know a wave's amplitude as well; default the mean over the pad.

    Without correlation it is the number of markers. With it, it grows no further than the area over the area of
    correlation, 2 pi l^2 times the share.
    """
    return skin.markers / common(skin, kx, ky)


def _lattice(pitch: float, length: float, k: Array) -> Array:
    steps = max(1, int(np.ceil(REACH * length / pitch)))
    if steps > 200:  # a continuum: the sum is its integral to machine precision
        return np.sqrt(2 * np.pi) * length / pitch * np.exp(-((k * length) ** 2) / 2)
    j = np.arange(1, steps + 1)
    weight = np.exp(-((j * pitch / length) ** 2) / 2)
    values, back = np.unique(k, return_inverse=True)
    found = 1 + 2 * np.cos(np.outer(values, j * pitch)) @ weight
    return np.maximum(found, 0.0)[back].reshape(k.shape)  # below zero by rounding only
