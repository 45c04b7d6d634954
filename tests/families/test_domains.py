"""One transient in both domains: which is recommended is the one that is nearer the truth."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import FrequencyInversion, InputError, compare_domains
from structures import Channel, ForwardModel, beams, damping, loads, sensors

DT = 1 / 2000


@pytest.fixture(scope="module")
def beam() -> ForwardModel:
    structure = beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=20,
        damping=damping.Modal(0.05),
    )  # fmt: skip
    seen = [sensors.Accelerometer(f"{n}+Z") for n in (5, 12)]
    return ForwardModel(structure, seen, [loads.Point("8+Z", label="hit")], modes=6, residual=False)


def record(model: ForwardModel, samples: int, at: int = 60) -> tuple[np.ndarray, np.ndarray]:
    force = np.zeros((samples, 1))
    force[at : at + 10, 0] = 100 * np.sin(np.pi * np.arange(10) / 10)
    y = model.predict(force, DT)
    return y + 0.01 * y.std() * np.random.default_rng(1).standard_normal(y.shape), force


def test_a_record_that_is_cut_goes_to_the_time_domain(beam: ForwardModel) -> None:
    y, force = record(beam, 400)
    found = compare_domains(beam, y, DT)
    assert found.take == "time"
    assert "W50" in found.reason
    error = [np.linalg.norm(e.load - force) for e in (found.frequency, found.time)]
    assert error[1] < 0.5 * error[0]
    assert found.estimate is found.time


def test_the_two_agree_on_a_complete_record(beam: ForwardModel) -> None:
    y, force = record(beam, 9000)
    found = compare_domains(beam, y, DT)
    error = {"frequency": np.linalg.norm(found.frequency.load - force), "time": np.linalg.norm(found.time.load - force)}
    assert error[found.take] <= 1.2 * min(error.values())
    assert found.apart < 0.01
    assert found.take in ("time", "frequency")
    assert str(found).startswith("take ")


def test_progress_runs_to_the_end(beam: ForwardModel) -> None:
    seen: list[float] = []
    compare_domains(beam, record(beam, 400)[0], DT, progress=lambda share, text: seen.append(share))
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0)


def test_gaps_are_for_the_time_domain(beam: ForwardModel) -> None:
    from loadid import Record

    y, _ = record(beam, 400)
    y[100:110, 0] = np.nan
    with pytest.raises(InputError, match="gaps"):
        compare_domains(
            beam, Record(y, DT, [Channel(label=s.label, quantity=s.quantity, unit=s.unit) for s in beam.sensors])
        )


def test_settings_that_a_history_cannot_have_are_refused(beam: ForwardModel) -> None:
    y, _ = record(beam, 400)
    with pytest.raises(InputError, match="all lines"):
        FrequencyInversion(beam, signal="transient", band=(10.0, 100.0)).estimate(y, DT)
    for wrong in (5, "text", None):
        with pytest.raises(InputError):
            compare_domains(beam, wrong, DT)
    with pytest.raises(InputError, match="no such kind"):
        FrequencyInversion(beam, signal="impact")
