"""Offsets of sensors: accelerometers lose theirs, what a constant load may have made is refused."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from loadid import Deconvolution, Lambda, SparseDeconvolution
from loadid.constraints import NonNegative
from structures import Flag, ForwardModel, beams, damping, loads, sensors
from structures.errors import NotIdentifiable

from ..inverse.statespace.dense import operator
from .cases import Case, refused

DT, SAMPLES = 2e-4, 1500


def model(gauges: Sequence[sensors.Sensor], modes: int) -> ForwardModel:
    """A steel cantilever struck near its tip."""
    beam = beams.cantilever(
        length=0.6,
        section=beams.Section.rectangle(width=0.04, height=0.01),
        material=beams.materials.steel,
        elements=20,
        damping=damping.Modal(0.01),
    )
    return ForwardModel(beam, gauges, [loads.Point(at=0.5, direction="Z")], modes=modes)


ACCELEROMETERS = [sensors.Accelerometer(at=x, direction="Z") for x in (0.3, 0.6)]
LASERS = [sensors.Displacement(at=x, direction="Z") for x in (0.3, 0.6)]


def hit(quiet: int = 300) -> NDArray[np.float64]:
    """Half sine of 2 ms."""
    load = np.zeros((SAMPLES, 1))
    load[quiet : quiet + 10, 0] = 50 * np.sin(np.pi * (np.arange(10) + 0.5) / 10)
    return load


def measured(gauges: Sequence[sensors.Sensor], load: NDArray, offset: float = 0.0) -> tuple[NDArray, NDArray]:
    """Response of more modes than the inversion has, 1 % noise, an offset as a share of the rms; noise std."""
    clean = model(gauges, 8).state_space(DT).simulate(load)
    rms = np.sqrt(np.mean(clean**2, axis=0))
    noise = 0.01 * rms * np.random.default_rng(3).standard_normal(clean.shape)
    return clean + noise + offset * rms * np.array([1.0, -0.7]), 0.01 * rms


def off(found: NDArray, load: NDArray) -> float:
    """Relative error."""
    return float(np.linalg.norm(found - load[: len(found)]) / np.linalg.norm(load))


@pytest.mark.parametrize("share", [0.02, 0.1, 0.5])
def test_an_accelerometer_loses_its_offset(share: float) -> None:
    load = hit()
    clean, sigma = measured(ACCELEROMETERS, load)
    shifted, _ = measured(ACCELEROMETERS, load, share)
    family = Deconvolution(model(ACCELEROMETERS, 6), noise=sigma)
    best, found = family.estimate(clean, DT), family.estimate(shifted, DT)
    assert off(found.load, load) < 2 * off(best.load, load)
    said = [f for f in found.flags if f.code == "LID-W206"]
    assert ["subtracted" in f.message for f in said] == [True, True]
    assert not [f for f in best.flags if f.code == "LID-W206"]


@pytest.mark.parametrize("penalty", ["identity", "first_difference"])
@pytest.mark.parametrize("gap", [False, True])
def test_an_offset_is_an_unknown_of_the_problem(penalty: str, gap: bool) -> None:
    """Load and band of least squares over the loads and one constant a channel."""
    load = hit()[220:]
    shifted, sigma = measured(ACCELEROMETERS, load, 0.2)
    shifted, load = shifted[:240], load[:240]
    if gap:
        shifted[150:160, 1] = np.nan
    mass = model(ACCELEROMETERS, 6)
    found = Deconvolution(mass, noise=sigma, penalty=penalty, choice=Lambda(1e-3, path="statespace")).estimate(
        shifted, DT
    )
    there = ~np.isnan(shifted.reshape(-1))
    H = operator(mass.state_space(DT), len(load)).reshape(-1, len(load))
    weight = np.tile(1 / sigma, len(load))
    A = (np.hstack([H, np.tile(np.eye(2), (len(load), 1))]) * weight[:, None])[there]
    lam = found.choice.lam * found.choice.scale
    L = np.eye(len(load)) if penalty == "identity" else np.diff(np.eye(len(load)), axis=0)
    stack = np.vstack([A, np.hstack([lam * L, np.zeros((len(L), 2))])])
    data = np.r_[(shifted.reshape(-1) * weight)[there], np.zeros(len(L))]
    exact = np.linalg.lstsq(stack, data)[0]
    assert np.linalg.norm(found.load[:, 0] - exact[:-2]) < 1e-9 * np.linalg.norm(exact[:-2])
    R = np.linalg.qr(stack, mode="r")
    level = np.sqrt(np.sum(np.linalg.inv(R) ** 2, axis=1))[:-2]
    ratio = found.posterior.std[:, 0] / level
    assert np.ptp(ratio) < 1e-8 * ratio.min()


@pytest.mark.parametrize("start", ["rest", "unknown"])
def test_loads_that_only_push_take_it_out_too(start: str) -> None:
    load = hit()
    (clean, sigma), (shifted, _) = measured(ACCELEROMETERS, load), measured(ACCELEROMETERS, load, 0.3)
    family = Deconvolution(model(ACCELEROMETERS, 6), noise=sigma, constraints=[NonNegative()], initial=start)
    best, found = family.estimate(clean, DT), family.estimate(shifted, DT)
    assert off(found.load, load) < 2 * off(best.load, load)
    # the offset is in the prediction: what is left is noise
    assert np.sqrt(np.mean((found.residual / sigma) ** 2)) < 1.1


def test_without_a_quiet_part_the_velocity_tells() -> None:
    """Random loads from the first sample: an offset of a tenth of the rms would carry the velocity away."""
    load = np.random.default_rng(0).standard_normal((SAMPLES, 1))
    clean, sigma = measured(ACCELEROMETERS, load)
    shifted, _ = measured(ACCELEROMETERS, load, 0.1)
    family = Deconvolution(model(ACCELEROMETERS, 8), noise=sigma)
    best, found = family.estimate(clean, DT), family.estimate(shifted, DT)
    assert off(found.load, load) < 2 * off(best.load, load)
    assert not [f for f in best.flags if f.code == "LID-W206"]


def test_other_families_take_it_out_too() -> None:
    load = hit()
    (clean, sigma), (shifted, _) = measured(ACCELEROMETERS, load), measured(ACCELEROMETERS, load, 0.3)
    family = SparseDeconvolution(model(ACCELEROMETERS, 6), noise=sigma)
    best, found = (family.estimate(y, DT) for y in (clean, shifted))
    assert off(found.load, load) < 2 * off(best.load, load)


def test_a_constant_that_a_load_may_have_made_is_refused() -> None:
    load = hit()
    shifted, sigma = measured(LASERS, load, 0.3)
    family = Deconvolution(model(LASERS, 6), noise=sigma)
    with pytest.raises(NotIdentifiable, match="off zero before the response") as refused:
        family.estimate(shifted, DT)
    assert refused.value.code == "LID-E213"
    assert "initial='unknown'" in str(refused.value)
    family.estimate(measured(LASERS, load)[0], DT)
    Deconvolution(model(LASERS, 6), noise=sigma, initial="unknown").estimate(shifted, DT)
    Deconvolution(model(LASERS, 6), noise=sigma, allow=["E213"]).estimate(shifted, DT)


def lasers(offset: float) -> tuple[Flag, ...]:
    """Refusal of lasers with an offset."""
    y, sigma = measured(LASERS, hit(), offset)
    return refused(lambda: Deconvolution(model(LASERS, 6), noise=sigma).estimate(y, DT))


def struck_at_once(offset: float) -> tuple[Flag, ...]:
    """Accelerometers without a quiet part."""
    y, sigma = measured(ACCELEROMETERS, hit(5), offset)
    return Deconvolution(model(ACCELEROMETERS, 6), noise=sigma).estimate(y[:400], DT).flags


CASES = [
    Case(
        "W206",
        lambda: struck_at_once(0.2),
        lambda: struck_at_once(0.0),
        r"channel .+: an offset of \S+ \+- \S+ m/s\^2 was estimated with the load and subtracted",
    ),
    Case("E213", lambda: lasers(0.3), lambda: lasers(0.0), r"off zero before the response \(\d+ quiet samples\)"),
]
