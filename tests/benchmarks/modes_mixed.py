"""How true the stated std of modes is where accelerometers and displacement sensors stand in one test.

Run ``python -m tests.benchmarks.modes_mixed [SEEDS]`` (150 by default, five minutes of processor time): errors of
frequencies and damping over their stated std (rms, 1 is right) and the share inside 1.96 std, for accelerometers and
displacement sensors in one test and each alone, with the variance of the FRFs stated and not. The lines share their
noises: 40 of them leave an rms uncertain by 7 %, and all lines alike.

The noise is white over the band, and as large as 2 % of the rms of each channel. The truth is a closed form: the modes
of a simply supported beam, and what is beyond the band is left out of it.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from structures import Channel, FrfModel, identify_modes
from structures.errors import InputError

F = np.arange(10.0, 330.0, 1.0)
FREQUENCIES, DAMPING = 25.0 * np.array([1.0, 4.0, 9.0]), np.array([0.04, 0.03, 0.02])
PLACES, FORCE = np.array([0.3, 0.45, 0.62, 0.81]), 0.3
KINDS = {"both": "adad", "accelerometers": "aaaa", "displacement sensors": "dddd"}
UNITS = {"a": ("acceleration", "m/s^2"), "d": ("displacement", "m")}
LOAD = Channel(label="F", quantity="force", unit="N")
NOISE, ORDER = 0.02, 12
FIRST = 1000  # seed


def shapes() -> NDArray[np.float64]:
    """Mode shapes at the sensors (sensors, modes)."""
    return np.sin(np.pi * np.outer(PLACES, np.arange(1, 4)))


def truth(kinds: str) -> NDArray[np.complex128]:
    """FRFs (lines, sensors, 1) of a beam of 4 kg."""
    w, w0 = 2 * np.pi * F[:, None], 2 * np.pi * FREQUENCIES
    modal = np.sin(np.pi * FORCE * np.arange(1, 4)) / 2.0 / (w0**2 - w**2 + 2j * DAMPING * w0 * w)
    H = modal @ shapes().T
    return np.where([kind == "a" for kind in kinds], -(w**2), 1.0)[..., None] * H[..., None]


def errors(kinds: str, seed: int, stated: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Errors over stated std of frequencies and of damping ratios; None where a mode was missed."""
    H, rng = truth(kinds), np.random.default_rng([41, FIRST + seed])
    std = NOISE * np.sqrt(np.mean(np.abs(H) ** 2, axis=0, keepdims=True))
    noisy = H + std / np.sqrt(2) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    channels = [Channel(label=f"s{k}", quantity=UNITS[kind][0], unit=UNITS[kind][1]) for k, kind in enumerate(kinds)]
    variance = np.broadcast_to(std**2, H.shape) if stated else None
    model = FrfModel(F, noisy, sensors=channels, loads=[LOAD], variance=variance)
    try:
        found = identify_modes(model, band=(float(F[0]), float(F[-1])), order=ORDER)
    except InputError:
        return None
    f = np.asarray(found.frequencies)
    near = [int(np.argmin(np.abs(f - one))) for one in FREQUENCIES]
    if np.any(np.abs(f[near] / FREQUENCIES - 1) > 0.01):
        return None
    return (
        (f[near] - FREQUENCIES) / np.asarray(found.frequency_std)[near],
        (np.asarray(found.damping)[near] - DAMPING) / np.asarray(found.damping_std)[near],
    )


def main(seeds: int) -> None:
    """Print the table."""
    print(f"{'sensors':22}{'variance':12}{'missed':>8}  frequency: rms z, inside   damping: rms z, inside")
    for name, kinds in KINDS.items():
        for stated in (True, False):
            found = [one for seed in range(seeds) if (one := errors(kinds, seed, stated)) is not None]
            z = [np.array([one[k] for one in found]) for k in (0, 1)]
            rms, inside = ([float(fun(part)) for part in z] for fun in (
                lambda x: np.sqrt(np.mean(x**2)), lambda x: np.mean(np.abs(x) < 1.96)))  # fmt: skip
            print(f"{name:22}{'stated' if stated else 'not stated':12}{seeds - len(found):8}"
                  f"{rms[0]:17.2f}, {inside[0]:6.0%}{rms[1]:17.2f}, {inside[1]:6.0%}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 150)
