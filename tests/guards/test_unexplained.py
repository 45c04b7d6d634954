"""W412: an answer that does not explain its data has the worst grade, in every family that has a lambda."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from loadid import (
    Deconvolution,
    FrequencyInversion,
    HarmonicInversion,
    Lambda,
    LoadEstimate,
    SparseDeconvolution,
    Spectra,
    StaticInversion,
)
from loadid._inverse.agreement import GRADES
from loadid._inverse.noise_level import CLEARLY, unexplained
from loadid._results.report import fragment
from structures import ForwardModel, beams, damping, loads, sensors

from .cases import Case

DT, SAMPLES = 2e-4, 300
CODE = "LID-W412"


def model(at: tuple[float, ...] = (0.5,), gauges: tuple[float, ...] = (0.2, 0.35, 0.45, 0.6)) -> ForwardModel:
    """A steel cantilever with lasers and loads across."""
    beam = beams.cantilever(
        length=0.6,
        section=beams.Section.rectangle(width=0.04, height=0.01),
        material=beams.materials.steel,
        elements=20,
        damping=damping.Modal(0.02),
    )
    return ForwardModel(
        beam,
        [sensors.Displacement(at=x, direction="Z") for x in gauges],
        [loads.Point(at=x, direction="Z") for x in at],
        modes=5,
    )


def noisy(clean: NDArray, seed: int = 0) -> tuple[NDArray, NDArray]:
    """With 1 % noise, and its std (sensors,)."""
    sigma = 0.01 * np.sqrt(np.mean(clean**2, axis=0))
    return clean + sigma * np.random.default_rng(seed).standard_normal(clean.shape), sigma


def pulse(samples: int = SAMPLES) -> NDArray[np.float64]:
    """One half sine (samples, 1)."""
    load = np.zeros((samples, 1))
    load[75:125, 0] = np.sin(np.pi * (np.arange(50) + 0.5) / 50)
    return load


def in_time(family: Callable, place: float, samples: int = SAMPLES) -> LoadEstimate:
    """A load at `place` inverted as one at 0.5 m."""
    clean = model((place,)).state_space(DT).simulate(pulse(samples))
    y, sigma = noisy(clean)
    return family(model(), noise=sigma).estimate(y, DT)


def static(place: float) -> LoadEstimate:
    y, sigma = noisy((model((place,)).static() @ [[10.0]]).T)
    return StaticInversion(model(), noise=sigma).estimate(y[0])


def harmonic(place: float) -> LoadEstimate:
    clean = model((place,)).frf([40.0])[0, :, 0] * (1 + 2j)
    sigma = 0.01 * np.abs(clean)
    draws = np.random.default_rng(0).standard_normal((2, len(clean))) / np.sqrt(2)
    return HarmonicInversion(model(), 40.0, noise=sigma).estimate(clean + sigma * (draws[0] + 1j * draws[1]))


def in_frequency(place: float) -> LoadEstimate:
    load = np.zeros((12_000, 1))  # until the structure has come to rest: a transform cannot hold an unfinished record
    load[:SAMPLES] = np.random.default_rng(1).standard_normal((SAMPLES, 1))
    y, sigma = noisy(model((place,)).state_space(DT).simulate(load))
    return FrequencyInversion(model(), noise=sigma, signal="transient").estimate(y, DT)


FAMILIES = {
    "deconvolution": lambda place: in_time(Deconvolution, place),
    "dense, a lambda of the user": lambda place: in_time(lambda *a, **k: Deconvolution(*a, choice=1e-3, **k), place),
    "convolved": lambda place: in_time(
        lambda *a, **k: Deconvolution(*a, choice=Lambda(path="toeplitz"), **k), place, samples=150
    ),
    "sparse": lambda place: in_time(SparseDeconvolution, place),
    "static": static,
    "harmonic": harmonic,
    "frequency": in_frequency,
}


@pytest.mark.parametrize("case", FAMILIES)
def test_a_load_at_another_place_is_not_explained(case: str) -> None:
    """Four sensors see that the load is not where the model has it: no rule may call that usable."""
    found = FAMILIES[case](0.3)
    assert found.choice is not None
    assert found.choice.verdict == GRADES[-1]
    flag = found.flags[0]
    assert flag.code == CODE
    assert f"{flag.evidence.value:.3g} times the noise" in flag.message
    assert found.summary().startswith("NOT TO BE USED: the load does not explain its data")


@pytest.mark.parametrize("case", FAMILIES)
def test_the_right_place_is_explained(case: str) -> None:
    found = FAMILIES[case](0.5)
    assert CODE not in [f.code for f in found.flags]
    assert "NOT TO BE USED" not in found.summary()


def on_lines(place: float, stated: bool) -> LoadEstimate:
    """Spectra whose noise is five times as large on the lower half of the lines."""
    f, rng = np.linspace(10, 400, 300), np.random.default_rng(3)
    sigma = np.where(f < 200, 5e-3, 1e-3)[:, None] * np.abs(model((place,)).frf(f)[..., 0]).mean(axis=0)
    noise = sigma[..., None] * rng.standard_normal((*sigma.shape, 2)) @ np.array([1, 1j]) / np.sqrt(2)
    spectra = Spectra(f, model((place,)).frf(f)[..., 0] + noise, noise=sigma if stated else None, noise_source="known")
    return FrequencyInversion(model()).estimate(spectra)


@pytest.mark.parametrize("stated", [True, False])
def test_lines_whose_noise_varies_are_explained(stated: bool) -> None:
    """Where nobody states the noise it may be larger here than there; a load elsewhere is told all the same."""
    right, wrong = on_lines(0.5, stated), on_lines(0.3, stated)
    assert CODE not in right.codes
    assert right.grade.letter < "C"
    assert np.median(np.abs(right.load - 1)) < 0.02
    assert wrong.flags[0].code == CODE
    assert wrong.grade.letter == "D"
    assert ("fair model" in wrong.flags[0].message) != stated


def test_lambda_far_too_large_is_not_usable() -> None:
    """A lambda that takes the load away leaves the response in the residual."""
    y, sigma = noisy(model().state_space(DT).simulate(pulse()))
    found = Deconvolution(model(), noise=sigma, choice=300.0).estimate(y, DT)
    assert found.flags[0].code == CODE
    shown = fragment(found).partition("</style>")[2].lstrip()
    assert shown.startswith('<p class="notice" role="alert">NOT TO BE USED')


def test_chance_is_allowed_for() -> None:
    """Noise alone is called unexplained in fewer than one of a thousand draws, for few data and for many."""
    rng = np.random.default_rng(0)
    for m in (2, 5, 40, 1000):
        residual2 = np.sum(rng.standard_normal((4000, m)) ** 2, axis=1)
        assert sum(unexplained(float(r), m, 1.0) is not None for r in residual2) <= 12  # 4 expected
    assert unexplained(1000 * (CLEARLY * 1.01) ** 2, 1000, 1.0) is not None
    assert unexplained(1e-12 * 1000 * 1.5**2, 1000, 1e-6) == pytest.approx(1.5)


CASES = [Case("W412", lambda: static(0.3).flags, lambda: static(0.5).flags, r"\d times the noise")]
