"""Histories behind a table of FRFs, against the true force filtered by another route."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from loadid import FrequencyInversion, InputError, LoadEstimate
from structures import ForwardModel, FrfModel, beams, damping, loads, sensors

RATE, N, FINE = 2048, 2048, 8


@cache
def structure() -> ForwardModel:
    own = beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=24,
        damping=damping.Modal(0.04),
    )  # fmt: skip
    seen = [sensors.Accelerometer(at=x, direction="+Z", label=f"a{i}") for i, x in enumerate((0.3, 0.9, 1.5))]
    return ForwardModel(own, seen, [loads.Point(at=0.7, direction="+Z", label="F")], modes=8)


@cache
def hit() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Record (N, 3), its noise, and the force on a step eight times finer."""
    t = np.arange(N * FINE) / (RATE * FINE)
    force = np.where((t >= 0.1) & (t < 0.108), 100 * np.sin(np.pi * (t - 0.1) / 0.008) ** 2, 0.0)
    y = structure().predict(force[:, None], 1 / (RATE * FINE))[::FINE]
    noise = 0.01 * y.std(axis=0)
    return y + noise * np.random.default_rng(0).standard_normal(y.shape), noise, force


def filtered(low: float, high: float) -> np.ndarray:
    """The force in a band, half cosines over a tenth of it, below over an octave at most: sums of cosines."""
    force = hit()[2]
    F = np.arange(0, N // 2) * RATE / N
    keep = (low <= F) & (high >= F)
    edge, line = 0.1 * (F[keep][-1] - F[keep][0]), RATE / N
    below = min(edge, F[keep][0])
    ramp = np.minimum((F - F[keep][0] + line / 2) / below, (F[keep][-1] + line / 2 - F) / edge).clip(0, 1)
    weight = np.where(keep, np.sin(np.pi / 2 * ramp) ** 2, 0.0)
    t = np.arange(N * FINE) / (RATE * FINE)
    out = np.zeros(N)
    for f, w in zip(F[keep], weight[keep], strict=True):
        amplitude = 2 * np.mean(force * np.exp(-2j * np.pi * f * t))
        out += w * np.real(amplitude * np.exp(2j * np.pi * f * np.arange(N) / RATE))
    return out


def table(low: float = 20.0, high: float = 300.0) -> FrfModel:
    f = np.arange(N // 2) * RATE / N
    return FrfModel.of(structure(), f[(f >= low) & (f <= high)])


@pytest.mark.parametrize(("band", "ends"), [(None, (20.0, 300.0)), ((40.0, 200.0), (40.0, 200.0))])
def test_the_force_in_the_band(band: tuple[float, float] | None, ends: tuple[float, float], tmp_path) -> None:
    y, noise, _ = hit()
    e = FrequencyInversion(table(), signal="transient", noise=noise, band=band).estimate(y, 1 / RATE)
    truth = filtered(*ends)
    off = e.load[:, 0] - truth
    assert np.linalg.norm(off) < 0.03 * np.linalg.norm(truth)
    assert np.mean(np.abs(off) < 1.96 * e.std[:, 0]) > 0.9
    assert np.sqrt(np.mean(e.std**2)) < 5 * np.sqrt(np.mean(off**2)) + 1e-9
    assert e.facts.history_band == f"{ends[0]:g} to {ends[1]:g} Hz"
    assert f"state: what the load does in {ends[0]:g} to {ends[1]:g} Hz" in e.summary()
    F = np.fft.rfftfreq(N, 1 / RATE)
    for shown in (e.load, e.response, e.residual):  # nothing of what lies outside
        beyond = np.abs(np.fft.rfft(shown, axis=0))[(ends[0] - 0.5 > F) | (ends[1] + 0.5 < F)]
        assert beyond.max() < 1e-9 * np.abs(np.fft.rfft(e.load, axis=0)).max() + 1e-9 * np.abs(y).max() * N
    e.save(tmp_path / "r.h5")
    assert LoadEstimate.read(tmp_path / "r.h5").facts.history_band == e.facts.history_band


def test_a_table_from_zero_to_nyquist_needs_no_taper() -> None:
    y, noise, force = hit()
    f = np.arange(N // 2 + 1) * RATE / N
    e = FrequencyInversion(FrfModel.of(structure(), f[1:]), signal="transient", noise=noise).estimate(y, 1 / RATE)
    assert "no end" in e.facts.history_ends
    truth = force[::FINE]
    assert np.linalg.norm(e.load[:, 0] - truth) < 0.25 * np.linalg.norm(truth)  # accelerometers hear little at 1 Hz


@pytest.mark.parametrize("cut", ["long", "step", "few"])
def test_lines_that_make_no_history(cut: str) -> None:
    y, noise, _ = hit()
    model = table(20.0, 24.0) if cut == "few" else table()
    data = np.vstack([y, y]) if cut == "long" else y
    rate = RATE * 1.003 if cut == "step" else RATE
    with pytest.raises(InputError) as caught:
        FrequencyInversion(model, signal="transient", noise=noise).estimate(data, 1 / rate)
    assert caught.value.where == "signal"


def test_a_table_that_interpolates_takes_longer_records() -> None:
    y, noise, _ = hit()
    longer = np.vstack([y, noise * np.random.default_rng(1).standard_normal(y.shape)])
    f = np.arange(80, 1200) * RATE / N / 4
    model = FrfModel(f, structure().frf(f), sensors=structure().sensors, loads=structure().loads, interpolate=True)
    e = FrequencyInversion(model, signal="transient", noise=noise).estimate(longer, 1 / RATE)
    assert np.linalg.norm(e.load[:N, 0] - filtered(20.0, 299.75)) < 0.06 * np.linalg.norm(filtered(20.0, 299.75))


def test_lines_off_the_grid_of_a_transform_are_named() -> None:
    y, noise, _ = hit()
    f = 20.3 + np.arange(280.0)
    with pytest.raises(InputError, match=r"lines from 20\.3 to 299\.3 Hz, 1 Hz apart"):
        FrequencyInversion(FrfModel.of(structure(), f), signal="transient", noise=noise).estimate(y, 1 / RATE)
