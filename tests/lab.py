"""A part in the field and on shakers in the laboratory: the truth is made by another route than the drives.

In the field the plate (24 x 18 elements, 60 modes) lies under 35 forces whose coherence falls with distance and which
are carried along it. In the laboratory a coarser mesh (12 x 9, 30 modes, 3 % stiffer, damping of 1.3 % where the field
has 1 %) stands on four shakers. Eight accelerometers are the target, three more are kept out.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from structures import Channel, CrossSpectra, ForwardModel, FrfModel, beams, damping, loads, plates, sensors

LX, LY = 0.6, 0.4
SEEN = {
    "a1": (0.08, 0.07), "a2": (0.22, 0.31), "a3": (0.33, 0.10), "a4": (0.41, 0.24), "a5": (0.52, 0.33),
    "a6": (0.14, 0.20), "a7": (0.47, 0.08), "a8": (0.28, 0.19), "k1": (0.19, 0.12), "k2": (0.37, 0.33),
    "k3": (0.53, 0.17),
}  # fmt: skip
TARGET, KEPT = tuple(SEEN)[:8], tuple(SEEN)[8:]
SHAKERS = {"shaker 1": (0.12, 0.29), "shaker 2": (0.26, 0.08), "shaker 3": (0.45, 0.30), "shaker 4": (0.38, 0.15)}
Complex = NDArray[np.complex128]


def plate(elements: tuple[int, int], stiffer: float, zeta: float, pushed: dict, modes: int) -> ForwardModel:
    """Simply supported aluminium plate under forces at some places."""
    metal = beams.materials.aluminium
    metal = type(metal)(E=metal.E * stiffer, nu=metal.nu, rho=metal.rho)
    structure = plates.plate(
        lengths=(LX, LY), thickness=4e-3, material=metal, elements=elements, damping=damping.Modal(zeta)
    )
    seen = [sensors.Accelerometer(at=p, direction="Z", label=name) for name, p in SEEN.items()]
    forces = [loads.Point(at=p, direction="Z", label=name) for name, p in pushed.items()]
    return ForwardModel(structure, seen, forces, modes=modes)


@lru_cache(maxsize=2)
def field(lines: int = 120) -> CrossSpectra:
    """Response of all sensors under the pressure, from 60 to 900 Hz."""
    f = np.linspace(60.0, 900.0, lines)
    x, y = np.meshgrid((np.arange(7) + 0.5) / 7 * LX, (np.arange(5) + 0.5) / 5 * LY, indexing="ij")
    at = np.stack([x.ravel(), y.ravel()], axis=1)
    model = plate((24, 18), 1.0, 0.010, {f"p{i}": tuple(p) for i, p in enumerate(at)}, 60)
    apart = np.linalg.norm(at[:, None] - at, axis=2)
    wave = 2 * np.pi * f[:, None, None] * (at[:, None, 0] - at[None, :, 0]) / 200.0  # carried along at 200 m/s
    level = (2.0 / (1 + (f / 300.0) ** 2))[:, None, None]
    S = level * np.exp(-apart / 0.15) * np.exp(-1j * wave)
    H = model.frf(f)
    return CrossSpectra(f, H @ S @ H.conj().swapaxes(1, 2), channels=model.sensors, averages=np.inf)


@lru_cache(maxsize=2)
def shaken(lines: int = 120, volts: bool = False) -> FrfModel:
    """FRFs of all sensors over the four shakers, per newton or per volt."""
    model = plate((12, 9), 1.03, 0.013, SHAKERS, 30)
    f = field(lines).frequencies
    H = model.frf(f)
    drives = model.loads
    if volts:  # an amplifier of some N/V, and the armature's resonance at 40 Hz
        gain = np.array([12.0, 9.0, 15.0, 11.0]) / (1 - (40 / f[:, None]) ** 2 - 0.3j * 40 / f[:, None])
        H = H * gain[:, None, :]
        drives = tuple(Channel(label=c.label, quantity="voltage", unit="V") for c in drives)
    return FrfModel(f, H, sensors=model.sensors, loads=drives)


def part(model: FrfModel, names: tuple[str, ...]) -> FrfModel:
    """The model of some sensors."""
    return model.with_sensors([list(SEEN).index(n) for n in names])


def decibels(made: NDArray, wanted: NDArray) -> float:
    """Rms over lines and sensors of 10 log10."""
    return float(np.sqrt(np.mean((10 * np.log10(made / wanted)) ** 2)))
