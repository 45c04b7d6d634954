"""An estimate asked at another lambda is what its family answers with that lambda from the start."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import loadid
import structures
from loadid import Deconvolution, FieldDeconvolution, HarmonicInversion, InputError, StaticInversion, datasets
from loadid.constraints import NonNegative


def beam(sensors: int = 5, loads: int = 3) -> structures.ForwardModel:
    made = structures.beams.simply_supported(
        length=1.0, elements=12, section=structures.beams.Section.rectangle(0.04, 0.01),
        material=structures.beams.Material(E=210e9, rho=7850.0), damping=structures.damping.Modal(0.03),
    )  # fmt: skip
    places = [(k + 1) / (sensors + 1) for k in range(sensors)]
    at = [(k + 0.7) / (loads + 0.5) for k in range(loads)]
    return structures.ForwardModel(
        made, [structures.sensors.Displacement(at=x, direction="+Z", label=f"d{k}") for k, x in enumerate(places)],
        [structures.loads.Point(at=x, direction="+Z", label=f"f{k}") for k, x in enumerate(at)], modes=6,
    )  # fmt: skip


def history(samples: int = 240) -> tuple[Any, Any]:
    model, dt = beam(loads=1), 1 / 4000
    force = np.zeros((samples, 1))
    force[40:60, 0] = 30 * np.sin(np.pi * np.arange(20) / 20)
    clean = model.predict(force, dt)
    noise = 0.02 * clean.std() * np.random.default_rng(0).standard_normal(clean.shape)
    return model, loadid.Record(clean + noise, dt, [replace(s) for s in model.sensors])


def same(one: loadid.LoadEstimate, other: loadid.LoadEstimate, rtol: float = 1e-7) -> None:
    size = np.abs(other.load).max()
    np.testing.assert_allclose(one.load, other.load, atol=1e-9 * size)
    np.testing.assert_allclose(one.std, other.std, rtol=rtol, atol=1e-9 * size)
    np.testing.assert_allclose(one.residual, other.residual, atol=1e-9 * np.abs(other.response).max())
    assert one.codes == other.codes
    assert one.choice is not None
    assert other.choice is not None
    assert (one.choice.lam, one.choice.rule, one.choice.verdict) == (
        other.choice.lam, other.choice.rule, other.choice.verdict
    )  # fmt: skip
    assert one.choice.spread == pytest.approx(other.choice.spread)
    assert one.facts.get("edf") == pytest.approx(other.facts.get("edf"), rel=10 * rtol)
    assert one.provenance["settings"] == other.provenance["settings"]


@pytest.mark.parametrize("lam", [3e-4, 2e-2, 0.3])
def test_a_history(lam: float) -> None:
    model, record = history()
    found = Deconvolution(model).estimate(record)
    same(found.at(lam), Deconvolution(model, choice=lam).estimate(record))
    same(found.at(0.5).at(lam), Deconvolution(model, choice=lam).estimate(record))


def test_a_history_over_states_and_one_that_only_pushes() -> None:
    model, record = history()
    over = Deconvolution(model, choice=loadid.Lambda(path="statespace")).estimate(record)
    given = Deconvolution(model, choice=loadid.Lambda(2e-2, path="statespace")).estimate(record)
    same(over.at(2e-2), given, rtol=1e-4)  # the trace between lambdas of a sweep is interpolated
    pushing = Deconvolution(model, constraints=[NonNegative()]).estimate(record)
    assert pushing.again is not None
    assert pushing.again.quick is None
    same(pushing.at(2e-2), Deconvolution(model, constraints=[NonNegative()], choice=2e-2).estimate(record))


def test_the_quick_answer_is_that_of_the_whole_one() -> None:
    model, record = history()
    found = Deconvolution(model).estimate(record)
    assert found.again is not None
    assert found.again.quick is not None
    for lam in (1e-3, 5e-2):
        quick, whole = found.again.quick(lam), found.at(lam)
        np.testing.assert_array_equal(quick.load, whole.load)
        np.testing.assert_array_equal(quick.std, whole.std)


@pytest.mark.parametrize("constraints", [[], [NonNegative()]])
def test_static_readings(constraints: list[Any]) -> None:
    given = datasets.wing_strains()
    readings = dict(zip(given.record.labels, given.record.values[0].tolist(), strict=True))
    found = StaticInversion(given.model, penalty="gradient", constraints=constraints).estimate(readings)
    other = StaticInversion(given.model, penalty="gradient", constraints=constraints, choice=0.05)
    same(found.at(0.05), other.estimate(readings))


def test_a_line_and_a_field() -> None:
    model = beam()
    rng = np.random.default_rng(1)
    Y = (model.frf([61.0])[0] @ np.array([3.0, 1.0 - 2j, 0.5])) * (1 + 0.01 * rng.standard_normal(5))
    same(HarmonicInversion(model, 61.0).estimate(Y).at(0.01), HarmonicInversion(model, 61.0, choice=0.01).estimate(Y))
    one, record = history()
    field = FieldDeconvolution(one).estimate(record)
    same(field.at(0.01), FieldDeconvolution(one, choice=0.01).estimate(record))


def test_copies_and_files_have_no_problem_and_say_so(tmp_path: Any) -> None:
    model, record = history()
    found = Deconvolution(model).estimate(record)
    found.save(tmp_path / "load.h5")
    for other in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found), loadid.load(tmp_path / "load.h5")):
        assert other.again is None
        with pytest.raises(InputError, match="no problem that could be solved"):
            other.at(0.1)
    assert Deconvolution(model, penalty=None).estimate(record).again is None
    for wrong in (0.0, -1.0, float("nan"), "gcv"):
        with pytest.raises(InputError):
            found.at(wrong)  # type: ignore[arg-type]
