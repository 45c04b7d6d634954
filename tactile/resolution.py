"""What a bonded layer lets through: its strongest wave, its finest, where pressure changes the way it drags, and noise.

Wave numbers k are in rad/m, wavelengths 2 pi / k in m. Everything scales with the thickness; E is a pure gain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import integer, number, positive, shown

from .layer import HalfSpace, Layer
from .waves import Components, turned

Array = NDArray[np.float64]
NAMES = {"zz": "pressure", "kk": "shear along the wave", "tt": "shear across the wave"}


@dataclass(frozen=True)
class Peak:
    """The wave that moves the surface most.

    Parameters
    ----------
    compliance : float
        Motion per traction (m/Pa).
    wavelength : float
        Of that wave (m); infinite where uniform traction moves the surface most.
    uniform : float
        Compliance under uniform traction over that of the peak: 0 means that the layer does not see it.
    """

    compliance: float
    wavelength: float
    uniform: float


def peak(layer: Layer, component: str = "zz") -> Peak:
    """The strongest wave of a layer.

    Parameters
    ----------
    layer : Layer
        The layer.
    component : {"zz", "kk", "tt"}
        Pressure, shear along the wave, shear across it.

    Raises
    ------
    InputError
        If there is no such component.
    """
    from scipy.optimize import minimize_scalar

    h = layer.h
    x = np.geomspace(1e-3, 100, 400)
    values = _one(layer, component, x / h)
    still = float(_one(layer, component, np.zeros(1))[0])
    i = int(values.argmax())
    if i == 0 or values[i] <= still * (1 + 1e-12):
        return Peak(still, np.inf, 1.0)
    best = minimize_scalar(
        lambda s: -_one(layer, component, np.array([s / h]))[0] / values[i],
        bounds=(x[i - 1], x[i + 1]),
        method="bounded",
        options={"xatol": 1e-10},
    ).x
    top = float(_one(layer, component, np.array([best / h]))[0])
    return Peak(top, float(2 * np.pi * h / best), still / top)


def cutoff(layer: Layer, component: str = "zz", share: float = 0.1) -> float:
    """The wavelength (m) below which a component moves the surface less than `share` of its strongest wave.

    Parameters
    ----------
    layer : Layer
        The layer.
    component : {"zz", "kk", "tt"}
        As in `peak`.
    share : float
        Above 0 and below 1; noise over signal, for example.

    Raises
    ------
    InputError
        If an argument is not possible.
    """
    from scipy.optimize import brentq

    share = positive("share", share, where="cutoff")
    if share >= 1:
        raise InputError("share must be below 1", where="cutoff", found=share, expected="0 < share < 1")
    top = peak(layer, component)
    least = share * top.compliance
    low = np.log(1e-6) if np.isinf(top.wavelength) else np.log(2 * np.pi * layer.h / top.wavelength)
    # beyond its peak a component falls at least as 1/k of the half-space, from at most 4 times its value
    high = np.log(8 / share) + max(low, 0.0)
    found = brentq(lambda s: _one(layer, component, np.exp([s]) / layer.h)[0] / least - 1, low, high, xtol=1e-12)
    return float(2 * np.pi * layer.h * np.exp(-found))


def sign_change(layer: Layer) -> float | None:
    """The wave number k (rad/m) at which pressure changes the way it drags the surface sideways; None: nowhere.

    Longer waves push the surface out from under the pressure, shorter ones draw it in as on a half-space. Below
    nu = 0.25 all waves draw in, at nu = 0.5 all push out.
    """
    from scipy.optimize import brentq

    gain = layer.kappa * (1 - 2 * layer.nu)
    if gain <= 0 or gain >= 1:
        return None
    # sinh(x) / x = gain^(-1/2)
    target = gain**-0.5
    end = 2.0
    while np.sinh(end) / end < target:
        end *= 2
    return float(brentq(lambda x: np.sinh(x) / x - target, 1e-9, end, xtol=1e-12) / layer.h)


def sideways(layer: Layer | HalfSpace, k: ArrayLike) -> Array:
    """|C| / G_zz at wave numbers k > 0: sideways motion caused by a wave of pressure over its normal motion."""
    f = layer.components(k)
    return np.abs(f.kz) / f.zz


def mistaken_shear(layer: Layer | HalfSpace, k: ArrayLike) -> Array:
    """|C| / G_kk at wave numbers k > 0: shear read per pressure when the in-plane motion is inverted with t_z = 0."""
    f = layer.components(k)
    return np.abs(f.kz) / f.kk


def noise_std(
    layer: Layer, pitch: float, sigma_u: float, sigma_z: float, *, coupled: bool = True, nodes: int = 64
) -> tuple[float, float]:
    """Noise of an unregularised traction map on a square grid: std of one shear component and of the pressure (Pa).

    Parameters
    ----------
    layer : Layer
        The layer.
    pitch : float
        Distance of the nodes (m).
    sigma_u, sigma_z : float
        Std of the motion of a node in the plane and along the normal (m), independent from node to node.
    coupled : bool
        Shear and pressure are inverted together; else each by its own compliance, as if the other were absent.
    nodes : int
        Nodes along each side of the grid.

    Raises
    ------
    InputError
        If a value is not possible.

    Notes
    -----
    Noise goes as 1/pitch: each wave costs its stiffness, which grows with k. For pitches well below h and uncoupled it
    is mu k_rms times sigma_u (1/2 + 1/2 (1 - nu)^-2)^(1/2), and sigma_z / (1 - nu), k_rms = (2/3)^(1/2) pi / pitch.
    """
    pitch = positive("pitch", pitch, where="noise_std", unit="m")
    spread = [number(name, s, where="noise_std", unit="m") for name, s in (("sigma_u", sigma_u), ("sigma_z", sigma_z))]
    if min(spread) < 0:
        raise InputError("a std must not be negative", where="noise_std", found=min(spread), expected="metres")
    n = integer("nodes", nodes, where="noise_std", limit=4096)
    k = 2 * np.pi * np.fft.fftfreq(n, pitch)
    kx, ky = (c.ravel()[1:] for c in np.meshgrid(k, k))  # uniform motion costs nothing, or has no bound at nu = 0.5
    if coupled:
        K = layer.stiffness(kx, ky)
    else:
        f = layer.components(np.hypot(kx, ky))
        none = np.zeros_like(f.kk)
        K = turned(kx, ky, Components(kk=1 / f.kk, zz=1 / f.zz, kz=none, zk=none, tt=1 / f.tt))
    variance = (np.abs(K) ** 2).sum(axis=0) / n**2 @ np.array([spread[0], spread[0], spread[1]]) ** 2
    return float(np.sqrt(variance[0])), float(np.sqrt(variance[2]))


def _one(layer: Layer, component: str, k: Array) -> Array:
    if component not in NAMES:
        raise InputError(
            "no component of the compliance",
            where="component",
            found=shown(component),
            expected=", ".join(f"{name} ({what})" for name, what in NAMES.items()),
        )
    return getattr(layer.components(k), component)
