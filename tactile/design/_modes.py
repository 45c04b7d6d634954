"""What a designer chooses (pad, markers, camera, loads), and the waves of traction that the markers then see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, number, pair, positive, reals

from .._arrays import Array
from .._closed.layer import Layer


@dataclass(frozen=True)
class Skin:
    """One design of a skin.

    Parameters
    ----------
    h, E, nu : float
        Thickness (m), Young's modulus (Pa) and Poisson's ratio of the pad.
    size : (a, b)
        Sides of the sensing area (m).
    pitch : float
        Distance of the markers (m), on a square grid.
    depth : float
        Depth of the markers below the loaded surface (m).
    noise : float
        Std of the in-plane motion of a marker (m): camera noise over magnification. 0.03 px at 14 px/mm is 2.1 um.
    noise_z : float or None
        Std of the normal motion (m), from a depth map; None where nothing measures it.
    correlated : float
        Share of the noise variance that neighbours have in common: vibration, refraction, haze. It moves noise from
        short waves to long ones; the variance of a marker stays. Motion interpolated onto nodes is no such noise: give
        the pitch of the markers.
    correlation : float
        Length over which they have it in common (m); its correlation is exp(-r^2 / 2 l^2).
    patch : float
        Size of the load features that are asked for (m).
    load : float
        Std of the mean traction on such a patch, before any reading (Pa).
    radius, force : float
        Reference press: Hertz pressure of that contact radius (m) and force (N).
    name : str

    Raises
    ------
    InputError
        If a value is not possible.
    """

    h: float
    E: float
    nu: float
    size: tuple[float, float] = (20e-3, 16e-3)
    pitch: float = 1e-3
    depth: float = 0.0
    noise: float = 2.1e-6
    noise_z: float | None = 10e-6
    correlated: float = 0.0
    correlation: float = 0.0
    patch: float = 1e-3
    load: float = 10e3
    radius: float = 2e-3
    force: float = 1.0
    name: str = ""

    def __post_init__(self) -> None:
        put = object.__setattr__
        for key in ("h", "E", "pitch", "noise", "patch", "load", "radius", "force"):
            put(self, key, positive(key, getattr(self, key), where="Skin"))
        if self.noise_z is not None:
            put(self, "noise_z", positive("noise_z", self.noise_z, where="Skin", unit="m"))
        put(self, "size", tuple(positive("size", s, where="Skin") for s in pair("size", self.size, where="Skin")))
        put(self, "nu", Layer(h=self.h, E=self.E, nu=self.nu).nu)
        for key in ("depth", "correlated", "correlation"):
            put(self, key, number(key, getattr(self, key), where="Skin"))
        if not 0 <= self.depth < self.h:
            raise InputError(
                "markers outside the pad", where="Skin, depth", found=self.depth,
                expected=f"0 (the surface) to below {self.h:g} m", hint="a depth below the surface",
            )  # fmt: skip
        if not 0 <= self.correlated < 1 or self.correlation < 0 or (self.correlated > 0) != (self.correlation > 0):
            raise InputError(
                "correlated noise needs a share and a length", where="Skin",
                found=f"correlated={self.correlated:g}, correlation={self.correlation:g}",
                expected="a share in (0, 1) and a length in m, or neither",
                hint="for motion interpolated onto nodes, give the pitch of the markers and no correlation",
            )  # fmt: skip
        if min(self.size) < 4 * max(self.patch, self.pitch):
            raise InputError(
                "a pad of fewer than four patches or markers across", where="Skin, size", found=self.size,
                expected=f"at least {4 * max(self.patch, self.pitch):g} m", hint="all in metres",
            )  # fmt: skip

    @property
    def layer(self) -> Layer:
        """The pad as a bonded layer."""
        return Layer(h=self.h, E=self.E, nu=self.nu)

    @property
    def height(self) -> float:
        """Height of the markers above the bonded base (m)."""
        return self.h - self.depth

    @property
    def markers(self) -> float:
        """Markers on the sensing area."""
        return self.size[0] * self.size[1] / self.pitch**2


REACH = 8.0  # correlation lengths summed over


def common(skin: Skin, kx: ArrayLike, ky: ArrayLike) -> Array:
    """Noise of a wave's amplitude over that of independent markers: 1 - s + s f(kx) f(ky), f a sum over the lattice.

    Exact for an endless square lattice, from independent markers (pitch beyond the correlation length) to a continuum.
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
        return np.asarray(np.sqrt(2 * np.pi) * length / pitch * np.exp(-((k * length) ** 2) / 2))
    j = np.arange(1, steps + 1)
    weight = np.exp(-((j * pitch / length) ** 2) / 2)
    values, back = np.unique(k, return_inverse=True)
    found = 1 + 2 * np.cos(np.outer(values, j * pitch)) @ weight
    return np.asarray(np.maximum(found, 0.0)[back].reshape(k.shape))  # below zero by rounding only


FINEST, IMAGES = 3, 3  # markers per patch and direction; images summed on each side
TINY = 1e-13  # share of the largest singular value below which a wave is not seen at all


@dataclass(frozen=True, eq=False)
class SkinModes:
    """All waves that a grid of patches can hold, by wave number (n,) in rad/m.

    `signal` (n, 3) are the singular values of each wave's three components of traction: the displacement of a wave of
    the expected amplitude over the noise of that wave, zero where markers cannot tell the wave from a longer one.
    `posterior` (3,) is the std of the mean traction X, Y, Z on a patch after the reading (Pa), with the expected load
    as prior; `unregularised` the same without a prior, None where a wave is not seen.
    """

    k: Array
    signal: Array
    posterior: Array
    unregularised: Array | None

    @property
    def recoverable(self) -> int:
        """Components whose signal exceeds their noise."""
        return int(np.sum(self.signal > 1))

    @property
    def rank(self) -> int:
        """Components that are seen at all."""
        return int(np.sum(self.signal > TINY * self.signal.max()))

    @property
    def nullity(self) -> int:
        """Components that are not."""
        return self.signal.size - self.rank

    @property
    def kappa(self) -> float:
        """Condition number of what is seen."""
        seen = self.signal[self.signal > TINY * self.signal.max()]
        return float(seen.max() / seen.min())


def modes(skin: Skin) -> SkinModes:
    """Waves of a periodic pad whose tractions are constant on patches; each is a 3 x 3 problem of its own.

    What markers of a lattice read of such loads is exact, aliases included, where the marker pitch divides the patch
    once, twice or three times; other pitches take the nearest of these lattices and their own density. Markers further
    apart than patches tell no wave beyond their own limit, and what those waves add to the longer ones is left out. So
    are the edges.
    """
    counts = [max(4, round(s / skin.patch)) for s in skin.size]
    lines = [2 * np.pi * np.fft.fftfreq(n, s / n) for n, s in zip(counts, skin.size, strict=True)]
    kx, ky = (k.ravel() for k in np.meshgrid(*lines, indexing="ij"))
    limit = np.pi / skin.pitch * (1 + 1e-9)
    seen = (np.abs(kx) <= limit) & (np.abs(ky) <= limit)
    A = _read(skin, kx, ky) * np.where(seen, 1.0, 0.0)[:, None, None]
    _, s, V = np.linalg.svd(A, full_matrices=False)
    if A.shape[1] < 3:  # the third direction of traction is seen by nothing
        _, s, V = np.linalg.svd(np.concatenate([A, np.zeros_like(A[:, :1])], axis=1))
    shares = np.abs(V) ** 2  # (n, singular, component): each row of V is a direction of traction
    posterior = skin.load * np.sqrt(np.mean(np.einsum("nsc,ns->nc", shares, 1 / (1 + s**2)), axis=0))
    raw = None
    if (s > TINY * s.max()).all():
        raw = skin.load * np.sqrt(np.mean(np.einsum("nsc,ns->nc", shares, 1 / s**2), axis=0))
    return SkinModes(np.hypot(kx, ky), s, posterior, raw)


def _read(skin: Skin, kx: Array, ky: Array) -> NDArray[np.complex128]:
    """What the markers' lattice reads of waves of patches, whitened (n, rows, 3).

    A wave of patches holds all waves k + 2 pi m / patch, by the transform of a patch. The lattice tells r x r of them
    apart; each of those it reads together with its own images.
    """
    b = skin.patch
    r = int(np.clip(round(b / skin.pitch), 1, FINEST))
    step, own = 2 * np.pi * r / b, 2 * np.pi / b
    sign = -1.0 if r % 2 == 0 else 1.0  # markers lie about the middle of a patch
    rows = []
    for i in np.arange(r) - (r - 1) // 2:
        for j in np.arange(r) - (r - 1) // 2:
            x, y = kx + i * own, ky + j * own
            total = np.zeros((len(kx), 3, 3), complex)
            for m in range(-IMAGES, IMAGES + 1):
                for n in range(-IMAGES, IMAGES + 1):
                    qx, qy = x + m * step, y + n * step
                    share = np.sinc(qx * b / (2 * np.pi)) * np.sinc(qy * b / (2 * np.pi)) * sign ** (m + n)
                    total += skin.layer.interior(qx, qy, skin.height) * share[:, None, None]
            rows.append(_over_noise(skin, total, x, y))
    return np.concatenate(rows, axis=1)


def _over_noise(skin: Skin, G: NDArray[np.complex128], kx: Array, ky: Array) -> NDArray[np.complex128]:
    """Displacement of waves of the expected traction over the noise of their amplitude.

    A white load of std `load` on patches has the spectral density load^2 patch^2; white noise of the markers has
    noise^2 pitch^2.
    """
    std = [skin.noise, skin.noise] + ([] if skin.noise_z is None else [skin.noise_z])
    scale = skin.load * skin.patch / (skin.pitch * np.sqrt(common(skin, kx, ky)))
    return np.asarray(G[:, : len(std)] * (scale[:, None, None] / np.array(std)[:, None]))


@dataclass(frozen=True, eq=False)
class SkinSpectrum:
    """What is learnt of waves of growing wave number k (n,) in rad/m, along one direction.

    `pressure` and `shear` (n,) are the share of the expected variance that a reading removes, 1 known, 0 not seen,
    shear being the worse of its two kinds; `singular` (n, 3) is signal over noise.
    """

    k: Array
    pressure: Array
    shear: Array
    singular: Array


def spectrum(skin: Skin, points: int = 400) -> SkinSpectrum:
    """Waves from the pad's length down to a fiftieth of its thickness, without the limits of markers and patches."""
    k = np.geomspace(np.pi / max(skin.size), 100 * np.pi / min(skin.h, skin.patch), points)
    A = _over_noise(skin, skin.layer.interior(k, 0 * k, skin.height), k, 0 * k)
    _, s, V = np.linalg.svd(A)
    s = np.concatenate([s, np.zeros((len(s), 3 - s.shape[1]))], axis=1)
    known = np.einsum("nsc,ns->nc", np.abs(V) ** 2, s**2 / (1 + s**2))
    return SkinSpectrum(k, known[:, 2], np.minimum(known[:, 0], known[:, 1]), s)


def resolution(found: SkinSpectrum, known: Array) -> float | None:
    """Half the shortest wave of which half the variance is known (m); None where there is no such wave."""
    above = np.flatnonzero(known >= 0.5)
    if not len(above):
        return None
    last = int(above[-1])
    if last == len(known) - 1:
        return float(np.pi / found.k[last])
    x, y = np.log(found.k[last : last + 2]), known[last : last + 2]
    return float(np.pi / np.exp(x[0] + (x[1] - x[0]) * (y[0] - 0.5) / (y[0] - y[1])))
