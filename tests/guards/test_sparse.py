"""Guards of the sparse family: the prior that does not fit, heights that the data do not tell, what is not solved."""

from __future__ import annotations

from functools import cache
from unittest import mock

import numpy as np

from loadid import Deconvolution, Noise, Penalty, SparseDeconvolution
from loadid._guards import families as sparsity
from loadid._guards.choice import impulsive
from loadid._inverse.sparse import lasso as workingset
from loadid._spellings import folded
from structures import Flag, ForwardModel, ImpulseModel, loads, sensors
from tests import halfsine

from .cases import Case, refused
from .test_expected import beam

DT = 1 / halfsine.RATE
N = 600


def model() -> ImpulseModel:
    """The struck beam of the half-sine benchmark, its first samples."""
    return ImpulseModel(halfsine.impulse_response(N), DT, kind="held")


def record(load: np.ndarray, noise: float = 0.01) -> tuple[np.ndarray, float]:
    """Noisy response to a load, and the std of its noise."""
    clean = halfsine.respond(load)
    std = noise * float(np.sqrt(np.mean(clean**2)))
    return clean + std * np.random.default_rng(0).standard_normal(len(load)), std


def pulse(width: int) -> np.ndarray:
    """One half-sine of 100 N."""
    load = np.zeros(N)
    load[200 : 200 + width] = 100 * np.sin(np.pi * (np.arange(width) + 0.5) / width)
    return load


@cache
def flags(width: int, noise: float = 0.01, **settings) -> tuple[Flag, ...]:
    """Flags of a sparse inversion of one pulse."""
    y, std = record(pulse(width), noise)
    return (
        SparseDeconvolution(
            model(), noise=Noise(std, source="unloaded record"), **folded(SparseDeconvolution, settings)
        )
        .estimate(y, DT)
        .flags
    )


def dense(settings: dict) -> tuple[Flag, ...]:
    """Flags for a load that acts all the time, seen by a sensor that answers at once."""
    h, rng = np.zeros(200), np.random.default_rng(1)
    h[:3] = 1.0, 0.5, 0.2
    load = np.sin(np.arange(200) / 9) if settings["slow"] else np.eye(200)[50] * 20
    y = np.convolve(h, load)[:200] + 0.01 * rng.standard_normal(200)
    return (
        SparseDeconvolution(ImpulseModel(h, DT, kind="held"), noise=Noise(0.01, source="unloaded record"))
        .estimate(y, DT)
        .flags
    )


def noise_alone(level: float) -> tuple[Flag, ...]:
    y, std = record(pulse(11), 0.01)
    return refused(lambda: SparseDeconvolution(model(), noise=level * std).estimate(y, DT))


def unsolved(rounds: int) -> tuple[Flag, ...]:
    """The refusal where the solver may take a few rounds only."""
    y, std = record(pulse(3), 0.01)
    with mock.patch.object(workingset, "ROUNDS", rounds):
        return refused(lambda: SparseDeconvolution(model(), noise=std, choice=0.001).estimate(y, DT))


def smooth(kind: str) -> tuple[Flag, ...]:
    """Two hits of one sample under Tikhonov: displacements smear them, accelerations show them as they are."""
    structure = beam(8).structure
    seen = [getattr(sensors, kind)(f"{node}+Z") for node in (8, 26)]
    own = ForwardModel(structure, seen, [loads.Point("13+Z", label="p")], modes=10)
    g = np.zeros(200)
    g[[40, 110]] = 300, 400
    y = own.predict(g, 1 / 2000)
    level = 0.01 * float(np.sqrt(np.mean(y**2)))
    y = y + level * np.random.default_rng(0).standard_normal(y.shape)
    family = Deconvolution(own, penalty=Penalty(variance="constant"), noise=Noise(level, source="known"))
    return family.estimate(y, 1 / 2000).flags


def found(flag: Flag | None) -> tuple[Flag, ...]:
    return () if flag is None else (flag,)


CASES = [
    Case("W311", lambda: flags(41), lambda: flags(41, dictionary="bspline"), r"knots every (4|8|16) samples", "pulses"),
    Case("W311", lambda: dense({"slow": True}), lambda: dense({"slow": False}), r"\d+ of 200 waveforms", "dense"),
    Case(
        "W311",
        lambda: flags(3, dictionary="bspline", knots=16),
        lambda: flags(41, dictionary="bspline", knots=8),
        r"residual is \d+\.?\d* times the stated noise",
        "misfit",
    ),
    Case(
        "W311",
        lambda: found(impulsive(25.0, "white noise")),
        lambda: found(impulsive(3.0, "white noise")),
        "kurtosis 25",
        "smooth prior",
    ),
    Case("W311", lambda: smooth("Displacement"), lambda: smooth("Accelerometer"), r"3 and 3\.\d+ samples", "smeared"),
    Case("W304", lambda: flags(1, 0.2), lambda: flags(11, dictionary="bspline"), r"± \d+% only", "heights"),
    Case(
        "W510",
        lambda: flags(11, dictionary="bspline", load_class="service"),
        lambda: flags(11, dictionary="bspline", load_class="impact"),
        "load class says service",
    ),
    Case(
        "W410",
        lambda: found(sparsity.stopped_gap(3e-6, 1e-6)),
        lambda: found(sparsity.stopped_gap(3e-7, 1e-6)),
        "3e-06",
        "gap",
    ),
    Case("E312", lambda: noise_alone(1000.0), lambda: noise_alone(1.0), "nothing beyond its noise"),
    Case("E410", lambda: unsolved(1), lambda: unsolved(200), r"gap \d"),
]
