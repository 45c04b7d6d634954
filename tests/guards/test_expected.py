"""Guards on published set-ups: those that must fire, and no other. A false alarm is a fault.

An impact on a clamped circular plate (after Jacquelin, Bennani & Hamelin, J. Sound Vib. 265 (2003) 81-107), and hammer
blows and an impact on a steel beam; white noise of 1 %, its level stated, data made by the model that inverts them.
"""

from __future__ import annotations

import numpy as np
import pytest

from loadid import Deconvolution, Guards, Noise, Record
from structures import ForwardModel, beams, circular, damping, loads, sensors

from .test_histories import COVERED

ALWAYS = {"W114", "W702", "N303"}  # no check against a known load; data and inversion share the model


def plate(sensor: str, place: float) -> tuple[ForwardModel, float, np.ndarray]:
    """A half sine of 1 kN and 1 ms at the centre, 400 samples at 20 kHz; five modes lie above the Nyquist frequency."""
    structure = circular.plate(
        radius=0.25, thickness=4e-3, material=beams.Material(E=70e9, rho=2700.0, nu=0.33), harmonics=1, elements=40,
        damping=damping.Modal(0.005),
    )  # fmt: skip
    at = (place * 0.25, 0.0)
    seen = sensors.Displacement(at=at) if sensor == "displacement" else sensors.StrainGauge(at=at, fibre=2e-3)
    model = ForwardModel(structure, [seen], [loads.Point(at=(0.0, 0.0), direction="Z", label="p")], modes=36)
    k = np.arange(400) - 20
    return model, 1 / 20e3, np.where((k >= 0) & (k <= 20), 1000 * np.sin(np.pi * k / 20), 0.0)


def beam(*nodes: int) -> ForwardModel:
    """Accelerometers on a simply supported beam of 2 m, one force at node 13."""
    structure = beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=40,
        damping=damping.Modal(0.01),
    )  # fmt: skip
    return ForwardModel(
        structure, [sensors.Accelerometer(f"{n}+Z") for n in nodes], [loads.Point("13+Z", label="p")], modes=10
    )


def blows() -> tuple[ForwardModel, float, np.ndarray]:
    g = np.zeros(400)
    g[[60, 61, 180]] = 300, 200, 400
    return beam(8, 26), 1 / 2000, g


def impact(*nodes: int) -> tuple[ForwardModel, float, np.ndarray]:
    k = np.arange(200) - 20
    return beam(*nodes), 1 / 2000, np.where((k >= 0) & (k <= 10), 100 * np.sin(np.pi * k / 10), 0.0)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("case", "must", "may"),
    [
        (lambda: plate("displacement", 0.0), {"W505", "W509"}, {"W201", "W407"}),
        (lambda: plate("displacement", 0.5), {"W201", "W505", "W509"}, {"W407"}),
        (lambda: plate("strain", 0.5), {"W201", "W505", "W509"}, {"W407"}),
        (blows, {"W505"}, set()),
        (lambda: impact(5, 17, 29), {"W505"}, set()),
        (lambda: impact(5, 17), {"W505"}, set()),
    ],
    ids=["plate, deflection at centre", "plate, deflection", "plate, strain", "blows", "impact, 3", "impact, 2"],
)
def test_expected_guards_and_no_other(case, must, may, seed):
    model, dt, g = case()
    y = model.predict(g, dt)
    e = np.random.default_rng(seed).standard_normal(y.shape)
    e *= 0.01 * np.linalg.norm(y) / np.linalg.norm(e)
    record = Record(y + e, dt, model.sensors, simulated_by=model.fingerprint)
    level = float(np.linalg.norm(e) / np.sqrt(e.size))
    estimate = Deconvolution(
        model, noise=Noise(level, source="unloaded record"), allow=Guards(coverage=COVERED)
    ).estimate(record)
    assert must | ALWAYS <= estimate.codes <= must | may | ALWAYS


def test_a_well_conditioned_problem_does_not_contradict_its_noise_level():
    """One accelerometer, an impact: the fit takes nearly all data; what a smoother one leaves is load, not noise."""
    model, dt, g = impact(20)
    y = model.predict(g, dt)
    level = 0.01 * float(np.linalg.norm(y)) / np.sqrt(y.size)
    for seed in range(3):
        record = y + level * np.random.default_rng(seed).standard_normal(y.shape)
        estimate = Deconvolution(model, noise=Noise(level, source="unloaded record")).estimate(record, dt)
        assert "W406" not in estimate.codes
        assert np.linalg.norm(estimate.load[:, 0] - g) < 0.1 * np.linalg.norm(g)
