"""One sensor that contradicts the others: named, corrected, and nobody accused where all is well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loadid import Deconvolution, FrequencyInversion, Record, StaticInversion
from loadid._inverse.diagnosis import leave_one_out, suspects
from loadid._results.estimate import LoadEstimate
from loadid._results.faults import SensorFault
from structures import ForwardModel, InputError, beams, damping, loads, sensors

from ..campaigns import faults as campaign

DT, SAMPLES, LATE = 2e-4, 800, 20
PLACES = (0.1, 0.22, 0.33, 0.45, 0.57)


def model() -> ForwardModel:
    beam = beams.beam(length=0.6, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel,
                      left="clamped", right="free", elements=24, damping=damping.Modal(0.02))  # fmt: skip
    gauges = [sensors.Displacement(at=x, direction="Z", label=f"d{i}") for i, x in enumerate(PLACES)]
    return ForwardModel(beam, gauges, [loads.Point(at=x, direction="Z") for x in (0.3, 0.5)], modes=6)


MODEL = model()


def record() -> Record:
    load = np.zeros((SAMPLES, 2))
    load[100:140, 0] = 50 * np.sin(np.pi * np.arange(40) / 40)
    load[300:330, 1] = 30 * np.sin(np.pi * np.arange(30) / 30)
    clean = MODEL.predict(load, DT)
    noise = 0.01 * np.sqrt(np.mean(clean**2, axis=0)) * np.random.default_rng(5).standard_normal(clean.shape)
    return Record(clean + noise, DT, list(MODEL.sensors))


RECORD = record()


def spoilt(kind: str) -> Record:
    y = np.array(RECORD.values)
    if kind == "swap":
        y[:, [1, 3]] = y[:, [3, 1]]
    elif kind == "delay":
        y[:, 3] = np.concatenate([np.full(LATE, y[0, 3]), y[:-LATE, 3]])
    elif kind == "dead":
        y[:, 3] = 1e-3 * np.std(y[:, 3]) * np.random.default_rng(1).standard_normal(SAMPLES)
    elif kind == "drift":
        y[:, 3] += np.linspace(0, 2, SAMPLES) * np.std(y[:, 3])
    else:
        y[:, 3] *= {"gain": 0.6, "unit": 9.80665, "polarity": -1.0}[kind]
    return replace(RECORD, values=y)


KINDS = ("gain", "unit", "polarity", "delay", "swap", "dead", "drift")


@pytest.mark.parametrize("kind", KINDS)
def test_a_record_names_its_fault(kind: str) -> None:
    found = Deconvolution(MODEL, choice=1e-3).estimate(spoilt(kind))
    (fault,) = found.faults
    assert fault.kind == kind
    assert "W214" in found.codes
    assert set(fault.channels) == ({"d1", "d3"} if kind == "swap" else {"d3"})
    if fault.correctable:
        off = fault.correct(spoilt(kind)).values - RECORD.values
        assert np.linalg.norm(off[20:-20]) < 0.05 * np.linalg.norm(RECORD.values)
    else:
        with pytest.raises(InputError, match="leave the sensor out"):
            fault.correct(spoilt(kind))


def test_nobody_is_accused_where_all_is_well() -> None:
    for known in (None, 0.01 * np.sqrt(np.mean(RECORD.values**2, axis=0))):
        assert not Deconvolution(MODEL, choice=1e-3, noise=known).estimate(RECORD).faults
    assert not FrequencyInversion(MODEL, signal="transient").estimate(RECORD).faults


@pytest.mark.parametrize("kind", ["polarity", "delay"])
def test_lines_name_the_same_fault(kind: str) -> None:
    (fault,) = FrequencyInversion(MODEL, signal="transient").estimate(spoilt(kind)).faults
    assert (fault.kind, fault.channels) == (kind, ("d3",))
    if kind == "delay":
        assert fault.size == pytest.approx(LATE * DT, rel=0.05)


def static(kind: str = "", count: int = 5) -> LoadEstimate:
    H = MODEL.static()
    y = H @ [40.0, -25.0]
    y += 0.005 * np.abs(y).max() * np.random.default_rng(2).standard_normal(5)
    y[4] *= {"": 1.0, "polarity": -1.0, "gain": 0.5, "dead": 0.0}[kind]
    names = [s.label for s in MODEL.sensors][5 - count :]
    return StaticInversion(MODEL, penalty=None, sensors=names).estimate(y[5 - count :])


@pytest.mark.parametrize("kind", ["polarity", "gain", "dead"])
def test_static_readings_name_their_fault(kind: str) -> None:
    (fault,) = static(kind).faults
    assert (fault.kind, fault.channels) == (kind, ("d4",))


def test_static_readings_in_order_accuse_nobody() -> None:
    assert not static().faults


def test_without_a_sensor_to_spare_nothing_is_said() -> None:
    assert not static("polarity", count=2).faults


def test_a_fault_is_kept_with_the_result(tmp_path) -> None:
    from loadid import load

    found = static("polarity")
    found.save(tmp_path / "result.h5")
    assert load(tmp_path / "result.h5").faults == found.faults


def test_corrections_of_all_kinds_of_readings() -> None:
    fault = SensorFault(("b",), "gain", 2.0, 0.1, 9.0, 0.1, 5.0, ("a",))
    assert fault.correct({"a": 1.0, "b": 4.0}) == {"a": 1.0, "b": 2.0}
    np.testing.assert_allclose(fault.correct(np.array([1.0, 4.0]), sensors=["a", "b"]), [1, 2])
    assert SensorFault.from_dict(fault.to_dict()) == fault
    with pytest.raises(InputError, match="no such channel"):
        fault.correct(np.array([1.0, 4.0]))


def test_a_slice_of_the_campaign() -> None:
    found = list(campaign.run(3, 21, fault="polarity", corrected=False))
    assert sum(f.named for f in found if not isinstance(f, str)) >= 2
    assert not any(f.said for f in campaign.run(3, 21, fault="none") if not isinstance(f, str))


@pytest.mark.parametrize("lines", [1, 7])
@pytest.mark.parametrize("kind", [float, complex])
def test_what_one_factorisation_says_of_every_hypothesis_is_what_solving_it_anew_says(kind: type, lines: int) -> None:
    rng = np.random.default_rng(1)

    def drawn(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape) + (1j * rng.standard_normal(shape) if kind is complex else 0)

    H = drawn(lines, 8, 3)
    y = H @ drawn(lines, 3, 2) + 0.1 * drawn(lines, 8, 2)
    y[:, 2] *= 1.7
    noise, size = rng.uniform(0.01, 0.03, (lines, 8)), np.mean(np.abs(y) ** 2, axis=2)
    read = leave_one_out.SensorLines(H, y, noise, size, True, 1.0 if kind is complex else 0.5)
    whole = leave_one_out.left_out(read, 0.03)
    without = [suspects._without(read, 0.03, whole, i) for i in range(8)]
    for told in (*without, *suspects._exchanges(read, 0.03, whole)):
        anew = leave_one_out.left_out(told.lines, 0.03)
        assert told.misfit == pytest.approx(anew.misfit, rel=1e-9)
        for name in ("rest", "precision", "limit", "excess"):
            np.testing.assert_allclose(getattr(told.left, name), getattr(anew, name), rtol=1e-7, atol=1e-10)


def test_a_sensor_that_the_others_do_not_determine_is_said() -> None:
    """Beyond the loads a cantilever has no strain: a gauge there tells nothing, and nothing tells of it."""
    beam = beams.beam(length=0.6, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel,
                      left="clamped", right="free", elements=24)  # fmt: skip
    gauges = [sensors.StrainGauge(at=x, fibre=0.005, label=f"e{i}") for i, x in enumerate((0.05, 0.12, 0.2, 0.5))]
    m = ForwardModel(beam, gauges, [loads.Point(at=0.3, direction="Z")])
    clean = m.static() @ [100.0]
    noise = np.full(4, 0.01 * np.abs(clean).max())
    readings = clean + noise * np.random.default_rng(0).standard_normal(4)
    e = StaticInversion(m, noise=noise).estimate(readings)
    assert e.facts.untested_sensors == ("e3",)
    assert not e.faults
    assert "others do not determine" in e.summary(details=True)


@pytest.mark.parametrize("gain", [0.93, 1.07])
def test_a_gain_that_errors_of_a_model_have_is_no_fault(gain: float) -> None:
    y = np.array(RECORD.values)
    y[:, 3] *= gain
    e = Deconvolution(MODEL).estimate(replace(RECORD, values=y))
    assert not e.faults
