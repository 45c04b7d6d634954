"""What `loadid check` expects of a model before anything is measured, against what simulated records then give."""

from __future__ import annotations

import json

import numpy as np
import pytest

import loadid
import structures
from loadid._commands import check as checking
from loadid._commands import demo as demonstration
from loadid._record import Record
from loadid.cli import main
from loadid.design._forecast import Pulse, forecast
from structures import Channel
from structures.errors import InputError


def scatter(model, told, j=0, records=20):
    """Rms error over the rms of the pulse, of what Deconvolution makes of simulated records of the same noise."""
    samples = round(told.duration / told.dt)
    force = np.zeros((samples, len(model.loads)))
    force[:, j] = told.pulse.at((np.arange(samples) - samples // 4) * told.dt)
    clean, std = model.predict(force, told.dt), np.array(told.noise)
    family, errors = loadid.Deconvolution(model, noise=std), []
    for seed in range(records):
        noisy = clean + std * np.random.default_rng(seed).standard_normal(clean.shape)
        channels = [Channel(label=c.label, quantity=c.quantity, unit=c.unit) for c in model.sensors]
        errors.append(family.estimate(Record(noisy, told.dt, channels)).load - force)
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=(1, 2))) / np.sum(force**2)))


def wing(sensors=(0.2, 2.0, 4.0), noise=None):
    beam = structures.beams.cantilever(
        length=6.0, elements=12, section=structures.beams.Section.rectangle(0.2, 0.1),
        material=structures.beams.Material(E=70e9, rho=2700.0), damping=structures.damping.Modal(0.02),
    )  # fmt: skip
    gauges = [structures.sensors.StrainGauge(at=x, fibre=0.05, label=f"e{x:g}", noise=noise) for x in sensors]
    return structures.ForwardModel(
        beam, gauges, [structures.loads.Point(at=x, direction="+Z", label=f"F{x:g}") for x in (3.0, 5.5)], modes=8
    )


@pytest.mark.parametrize(("share", "records"), [(0.003, 20), (0.03, 6)])
def test_the_expected_error_is_that_of_simulated_records(share, records):
    model = demonstration.model()
    level = forecast(model)
    told = forecast(model, pulse=Pulse(0.001, 100.0), noise=np.array(level.noise) / 0.01 * share)
    assert told.noise_source == "stated"
    assert told.hits[0].error == pytest.approx(scatter(model, told, records=records), rel=0.35)


def test_each_of_several_loads_has_its_own():
    model = wing()
    told = forecast(model, pulse=Pulse(0.02, 100.0))
    found = [scatter(model, told, j, 4) for j in range(2)]
    for hit, one in zip(told.hits, found, strict=True):
        assert hit.error == pytest.approx(one, rel=0.5)


def test_static_loads_scatter_as_expected():
    model = wing(noise=2e-6)
    found = checking.check(model=model, pulse=(0.02, 100.0)).static
    rng = np.random.default_rng(0)
    H, load = model.static(), np.array([100.0, -50.0])
    fits = [np.linalg.lstsq(H, H @ load + 2e-6 * rng.standard_normal(3), rcond=None)[0] for _ in range(2000)]
    spread = np.std(fits, axis=0)
    prior = 1 / np.sqrt(1 / spread**2 + 1 / 100.0**2)  # of one load, where the two are found apart
    assert np.all(found.std <= spread * 1.05)
    assert np.all(found.std >= 0.7 * prior)


def test_less_noise_and_more_sensors_promise_more():
    errors = [forecast(wing(), pulse=Pulse(0.02, 100.0), noise=s).worst.error for s in (1e-8, 1e-7, 1e-6)]
    assert errors == sorted(errors)
    more = forecast(wing((0.2, 1.0, 2.0, 3.0, 4.0)), pulse=Pulse(0.02, 100.0), noise=1e-7).worst.error
    assert more < errors[1]


def test_a_pulse_that_no_step_resolves_is_refused():
    with pytest.raises(InputError, match="too short"):
        forecast(demonstration.model(), pulse=Pulse(1e-3, 1.0), dt=1e-3)
    with pytest.raises(InputError, match="noise"):
        forecast(demonstration.model(), noise=[1.0, 2.0])


def kinds():
    whole = demonstration.model()
    f = np.arange(10.0, 1500.0, 5.0)
    table = structures.FrfModel(f, whole.frf(f), sensors=whole.sensors, loads=whole.loads)
    return {"FE": whole, "state space": whole.state_space(5e-5), "FRFs": table}


@pytest.mark.parametrize("kind", ["FE", "state space", "FRFs"])
def test_every_kind_of_model_is_checked_alone_and_with_a_log(kind, tmp_path, capsys):
    model = kinds()[kind]
    model.save(tmp_path / "model.h5")
    assert main(["check", "--model", str(tmp_path / "model.h5")]) == 0
    out = capsys.readouterr().out
    assert "expected: a hit of 1 ms and 100 N on hit" in out
    assert "assumed: 1% of the largest response" in out
    assert "see no load that stands still" in out
    dt = 5e-5
    force = Pulse().at((np.arange(2000) - 200) * dt)
    clean = kinds()["FE"].predict(force, dt)
    noisy = clean + 0.5 * np.random.default_rng(0).standard_normal(clean.shape)
    head = ",".join(f"{c.label} [m/s^2]" for c in model.sensors)
    np.savetxt(tmp_path / "log.csv", noisy, delimiter=",", header=head, comments="")
    log = [str(tmp_path / "log.csv"), "--fs", "20000"]
    assert main(["check", *log, "--model", str(tmp_path / "model.h5"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert "quiet segment" in told["forecast"]["noise_source"]
    assert told["forecast"]["noise"] == pytest.approx([0.5] * 3, rel=0.25)
    assert "LID-W214" not in {f["code"] for f in told["flags"]}


def test_frfs_that_a_test_knows_poorly_promise_less():
    whole = demonstration.model()
    f = np.arange(10.0, 1500.0, 5.0)
    H = whole.frf(f)
    exact = forecast(structures.FrfModel(f, H, sensors=whole.sensors, loads=whole.loads), noise=0.1)
    poor = forecast(
        structures.FrfModel(f, H, sensors=whole.sensors, loads=whole.loads, variance=0.1**2 * np.abs(H) ** 2), noise=0.1
    )
    assert exact.worst.model == 0
    assert poor.worst.model > 0.02
    assert poor.worst.error > exact.worst.error
    assert 0.5 < exact.inside < 1


def test_a_contradicting_sensor_is_named_by_check():
    model = demonstration.model()
    record = demonstration.simulate().record
    wrong = record.values.copy()
    wrong[:, 1] *= -1
    fired = {f.code: f for _, f in checking.check(Record(wrong, record.dt, record.channels), model).flags}
    assert "A2" in fired["LID-W214"].message
    assert "LID-W214" not in {f.code for _, f in checking.check(record, model).flags}


def test_loads_that_look_the_same_are_named():
    model = wing().with_loads([structures.loads.Point(at=x, direction="+Z", label=f"F{x:g}") for x in (2.0, 5.0, 5.5)])
    alike = checking.check(model=model, pulse=(0.05, 100.0)).layout["alike"]
    assert alike["loads"] == ["F5", "F5.5"]
    assert 0.9 < alike["cosine"] <= 1
