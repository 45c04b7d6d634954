"""Guards of frequency lines: antiresonances, leakage, harmonics that look alike, a noise level that is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import FrequencyInversion, Noise, Signal, Spectra
from structures import Flag, ForwardModel, FrfModel, beams, damping, loads, sensors

from .. import frfplate
from ..linecases import case, frf, model, normals
from .cases import Case

QUIET = {"LID-W114", "LID-W703"}
DT = 1e-3


def level(factor: float, sensors: int = 6) -> tuple[Flag, ...]:
    """Flags of lines whose stated noise is a factor too low; None where nobody states it."""
    c = case(200, sensors, 3)
    noise = None if factor == 0 else c.sigma / factor
    data = Spectra(c.f, c.Y, noise=noise, noise_source="covariance")
    return tuple(FrequencyInversion(model(c.f, c.H), noise=Noise(frf=0)).estimate(data).flags)


def deep(seen: int) -> tuple[Flag, ...]:
    """Flags of a plate with its antiresonances, or of lines that all are as loud (an FRF that jumps from one to the
    next would be a wrong one)."""
    rng = np.random.default_rng(0)
    f, H = frf(200, seen, 1, rng)
    H = H if seen == 1 else np.tile(normals(rng, 1, seen, 1), (200, 1, 1))
    Y = 3 * H[:, :, 0] + 0.03 * normals(rng, 200, seen)
    return tuple(FrequencyInversion(model(f, H)).estimate(Spectra(f, Y, noise=0.03, noise_source="covariance")).flags)


def beam() -> ForwardModel:
    structure = beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=20,
        damping=damping.Modal(0.03),
    )  # fmt: skip
    seen = [sensors.Accelerometer(at=x, direction="Z", label=f"s{x}") for x in (0.3, 0.8, 1.1)]
    return ForwardModel(structure, seen, [loads.Point(at=0.65, direction="Z", label="p")], modes=4)


def hit(samples: int, noise: float = 0.05) -> tuple[Flag, ...]:
    """Flags of a hit whose record ends after so many samples."""
    m = beam()
    g = np.zeros(samples)
    g[100:111] = 100 * np.sin(np.pi * np.arange(11) / 10)
    h = m.impulse_response(DT, samples)[:, :, 0]
    y = np.stack([np.convolve(g, h[:, i])[:samples] for i in range(3)], axis=1)
    y += noise * np.random.default_rng(0).standard_normal(y.shape)
    return tuple(FrequencyInversion(m, signal="transient").estimate(y, DT).flags)


def stationary(segment: int) -> tuple[Flag, ...]:
    """Flags of a record that is averaged in segments."""
    y = np.random.default_rng(0).standard_normal((30_000, 3))
    return tuple(FrequencyInversion(beam(), signal=Signal("stationary", segment=segment)).estimate(y, DT).flags)


def alone(stated: float | None) -> tuple[Flag, ...]:
    """Flags of one sensor and one load to 4 %, where the error of the FRF is stated or not."""
    c = case(200, 1, 1, noise=0.01)
    noise = None if stated is None else Noise(frf=stated)
    data = Spectra(c.f, c.Y, noise=c.sigma, noise_source="covariance")
    return tuple(FrequencyInversion(model(c.f, c.H), noise=noise, level=0.04).estimate(data).flags)


def harmonic(apart: float, background: float = 0.02) -> tuple[Flag, ...]:
    """Flags of three harmonics of two loads, that look alike but for a share of `apart`."""
    rng = np.random.default_rng(4)
    H = normals(rng, 200, 6, 2)
    H[:, :, 1] = H[:, :, 0] + apart * H[:, :, 1]
    truth = background * normals(rng, 200, 2)
    truth[[50, 100, 150]] = [10, -8j]
    Y = np.einsum("ksl,kl->ks", H, truth) + 0.2 * normals(rng, 200, 6)
    f = np.linspace(1.0, 200.0, 200)
    return tuple(FrequencyInversion(model(f, H)).estimate(Spectra(f, Y)).flags)


CASES = [
    Case("W406", lambda: level(5), lambda: level(1), r"lines show 5(\.\d)? times", "too low"),
    Case("W406", lambda: level(0, 3), lambda: level(0, 4), r"no sensor is left over", "unknown"),
    Case(
        "W406", lambda: alone(None), lambda: alone(0.02), r"nothing tells how wrong the FRF is.*threshold 0\.5", "FRF"
    ),
    Case("W507", lambda: deep(1), lambda: deep(4), r"of 200 lines do not tell.*threshold 0\.1"),
    Case("W508", lambda: hit(1000), lambda: hit(4000), r"leakage.*threshold 0\.01", "end"),
    Case("W508", lambda: stationary(1024), lambda: stationary(8192), r"the window averages over", "window"),
    Case("W516", lambda: harmonic(0.005), lambda: harmonic(1.0), r"not separable on 3 of 3 excited lines.*f0, f1"),
]


@pytest.mark.parametrize("nodes", frfplate.LAYOUTS, ids=str)
def test_antiresonances_of_a_beam_raise_no_other_flag(nodes):
    for seed in range(3):
        c = frfplate.beam(*nodes, seed=seed)
        m = FrfModel.of(frfplate.beam_model(*nodes), c.frequencies)
        data = Spectra(c.frequencies, c.Y, noise=c.sigma, noise_source="covariance")
        found = {f.code for f in FrequencyInversion(m).estimate(data).flags}
        assert found - QUIET == {"LID-W507"}


@pytest.mark.parametrize("kind", ["random", "flat", "silent"])
@pytest.mark.parametrize("known", [True, False])
def test_loads_of_all_sorts_raise_no_false_alarm(kind, known):
    for seed in range(6):
        truth = normals(np.random.default_rng(seed), 400, 3)
        truth = truth[:1] * np.ones((400, 1)) if kind == "flat" else truth * [1, 1, kind != "silent"]
        c = case(400, (8, 5)[seed % 2], 3, seed=seed + 50, truth=truth)
        data = Spectra(c.f, c.Y, noise=c.sigma if known else None, noise_source="covariance")
        found = {f.code for f in FrequencyInversion(model(c.f, c.H)).estimate(data).flags}
        assert found - QUIET == {"LID-W507"}, seed


@pytest.mark.parametrize("noise", [0.02, 0.5])
def test_a_hit_that_has_decayed_is_silent_whatever_its_noise(noise):
    assert not [f for f in hit(4000, noise) if f.code == "LID-W508"]


def test_a_harmonic_at_one_place_is_no_matter_of_separation():
    for seed in range(4):
        truth = np.zeros((300, 2), complex)
        truth[[50, 150, 250], 0] = 10
        loud = case(300, 6, 2, seed=seed, truth=truth, noise=0)
        quiet = 0.02 * float(np.sqrt(np.mean(np.abs(loud.Y[[50, 150, 250]]) ** 2, axis=1)).min())
        c = case(300, 6, 2, seed=seed, truth=truth, quiet=quiet)
        found = FrequencyInversion(model(c.f, c.H)).estimate(Spectra(c.f, c.Y)).codes
        assert "W516" not in found
