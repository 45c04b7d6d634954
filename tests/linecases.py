"""Frequency lines with a known truth: a structure of random modes, its noise, and models made of plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures import Channel, FrfModel

BAND95 = float(np.sqrt(-np.log(0.05)))  # half width of the 95 % band of a circular error, in sqrt(E|error|^2)


def normals(rng: np.random.Generator, *shape: int) -> NDArray[np.complex128]:
    """Complex normals of unit variance."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def model(frequencies: NDArray, H: NDArray, variance: NDArray | None = None) -> FrfModel:
    """Accelerometers s0, s1 ... and forces f0, f1 ..."""
    sensors = [Channel(label=f"s{i}", quantity="acceleration", unit="m/s^2") for i in range(H.shape[1])]
    loads = [Channel(label=f"f{j}", quantity="force", unit="N") for j in range(H.shape[2])]
    return FrfModel(frequencies, H, sensors=sensors, loads=loads, variance=variance)


@dataclass(frozen=True)
class Case:
    """FRF (lines, sensors, loads), noisy response (lines, sensors), truth (lines, loads), noise std, FRF variance."""

    f: NDArray[np.float64]
    H: NDArray[np.complex128]
    Y: NDArray[np.complex128]
    truth: NDArray[np.complex128]
    sigma: float
    variance: NDArray[np.float64] | None = None

    def inside(self, estimate) -> NDArray[np.bool_]:
        """Whether the truth is inside the 95 % band, (lines, loads)."""
        return np.abs(estimate.load - self.truth) <= BAND95 * estimate.std


def frf(lines: int, sensors: int, loads: int, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    """Lines from 20 to 400 Hz and an accelerance of 12 modes at random places."""
    f = np.linspace(20.0, 400.0, lines)
    natural, left, right = (
        np.sort(rng.uniform(25, 420, 12)), rng.standard_normal((sensors, 12)), rng.standard_normal((loads, 12))
    )  # fmt: skip
    q = -(f[:, None] ** 2) / (natural**2 - f[:, None] ** 2 + 0.02j * natural * f[:, None])
    return f, np.einsum("sm,km,lm->ksl", left, q, right)


def case(
    lines: int = 120, sensors: int = 6, loads: int = 3, *, seed: int = 1, noise: float = 0.03, error: float = 0.0,
    truth: NDArray | None = None, quiet: float | None = None,
) -> Case:  # fmt: skip
    """Random loads of unit variance unless said; noise and errors of the FRF relative to root mean squares and entries.

    `quiet` is the noise std itself.
    """
    rng = np.random.default_rng(seed)
    f, H = frf(lines, sensors, loads, rng)
    truth = normals(rng, lines, loads) if truth is None else np.asarray(truth, complex)
    clean = np.einsum("ksl,kl->ks", H, truth)
    sigma = noise * float(np.sqrt(np.mean(np.abs(clean) ** 2))) if quiet is None else quiet
    Y = clean + sigma * normals(rng, lines, sensors)
    if not error:
        return Case(f, H, Y, truth, sigma)
    spread = error * np.abs(H)
    return Case(f, H + spread * normals(rng, *H.shape), Y, truth, sigma, spread**2)
