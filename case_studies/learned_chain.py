"""A chain whose load a learned map gives within one per cent, and loads of which it says that they are not its own.

In place of Yang et al., Mech. Syst. Signal Process. 185 (2023) 109757 (load identification by a deep network), of which
no figure is compared; the case is ours. Five masses of 1 kg on springs of 2e4 N/m, fixed at one end, damping 0.002 K;
one force on the third mass; accelerometers on masses 1, 3 and 5, displacement sensors on 3 and 5, with noise of 1 % of
what they read; 200 Hz, 4000 samples. A map learns from records of random loads between 0.2 and 20 Hz. Then come loads
that it knows and loads that it does not: in the band, a sine and a constant; outside, a sine of 40 Hz and an impact of
two samples, and the chain with stiffness 10 % up or down. Errors are taken without the first and last 100 samples, and
are medians over records that no map has seen.

Two columns show what the map alone would say and what is answered: where the alarm is raised, by Tikhonov on the same
record, so that no answer is worse than that. With a network (extra ``learn``) its row is printed too.

Run ``python -m case_studies.learned_chain``: prints the table and saves ``learned_chain.png``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import Deconvolution, LearnedMap, Record
from loadid.generate import Examples, TrainingSet
from structures import ForwardModel, chains, damping, loads, sensors

Array = NDArray[np.float64]

FS, SAMPLES, EDGE = 200.0, 4000, 100
NOISE, STIFFNESS, BAND = 0.01, 2e4, (0.2, 20.0)
DRAWS = 500  # records of the training set
KINDS = ("in distribution", "sine 5 Hz", "constant", "sine 40 Hz", "impact", "stiffness + 10 %", "stiffness - 10 %")
OUTSIDE = KINDS[3:]


def chain(factor: float = 1.0) -> ForwardModel:
    """The chain, its stiffness multiplied; the displacements are read in units in which the first spring gives 1 N."""
    structure = chains.chain(masses=np.ones(5), springs=factor * STIFFNESS, damping=damping.Rayleigh(0.0, 0.002))
    places = [sensors.Accelerometer(f"{n}+X", label=f"a{n}") for n in (1, 3, 5)]
    places += [sensors.Displacement(f"{n}+X", label=f"u{n}") for n in (3, 5)]
    return ForwardModel(structure, sensors=places, loads=[loads.Point("3+X")])


def random_load(rng: np.random.Generator) -> Array:
    """Lines of random amplitude and phase in the band, unit std."""
    lines = np.fft.rfftfreq(SAMPLES, 1 / FS)
    inside = (lines >= BAND[0]) & (lines <= BAND[1])
    spectrum = inside * (rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines)))
    load = np.fft.irfft(spectrum, SAMPLES)
    return load / np.std(load)


def load_of(kind: str, rng: np.random.Generator) -> Array:
    """One load of a kind, unit std or unit size."""
    t = np.arange(SAMPLES) / FS
    if kind.startswith("sine"):
        return np.sqrt(2) * np.sin(2 * np.pi * float(kind.split()[1]) * t + rng.uniform(0, 2 * np.pi))
    if kind == "constant":
        return np.ones(SAMPLES)
    if kind == "impact":
        load, at = np.zeros(SAMPLES), int(rng.integers(1000, 3000))
        load[at : at + 2] = 10.0
        return load
    return random_load(rng)
