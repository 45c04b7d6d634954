"""What a designer chooses: pad, markers, camera, and the loads that are expected."""

from __future__ import annotations

from dataclasses import dataclass

from structures.errors import InputError
from structures.values import number, pair, positive

from ..layer import Layer


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
