"""Flags stay silent on clean data, and speak where there is something to say: what they once got wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loadid import Deconvolution, LoadEstimate, Noise, StaticInversion
from loadid._guards.choice import parameter
from loadid._guards.inversion import cut_off, memory
from loadid.constraints import NonNegative
from loadid.paths import LinearProblem, SVDPath
from structures import ForwardModel, ImpulseModel, beams, damping, loads, sensors
from structures._flags import Evidence, Flag, cautions

H = np.random.default_rng(3).standard_normal((8, 3)) + 3 * np.eye(8, 3)
PULLING, PUSHING = np.array([100.0, -50.0, 80.0]), np.array([100.0, 50.0, 80.0])


def three(truth: np.ndarray, sensors: int = 8, level: float = 0.01, **settings) -> LoadEstimate:
    """Three loads."""
    clean = H[:sensors] @ truth
    sigma = level * float(np.sqrt(np.mean(clean**2)))
    y = clean + sigma * np.random.default_rng(0).standard_normal(sensors)
    return StaticInversion(H[:sensors], noise=Noise(sigma, source="repeatability"), **settings).estimate(y)


def named(estimate: LoadEstimate) -> set[str]:
    return {f.code.removeprefix("LID-") for f in estimate.cautions}


def test_three_loads_that_the_data_determine_raise_nothing() -> None:
    found = three(PULLING)
    assert named(found) == set()
    assert found.grade.letter == "A"
    assert "W412" in named(three(PULLING, choice=30.0))


@pytest.mark.parametrize("sensors", [3, 8])
def test_a_sign_constraint_that_fights_the_data_is_named(sensors: int) -> None:
    found = three(PULLING, sensors, constraints=[NonNegative()])
    assert "W308" in named(found)
    assert "W406" not in named(found)  # the noise level is not what is wrong
    assert found.grade.letter == "D"
    assert "W308" not in three(PUSHING, sensors, constraints=[NonNegative()]).codes


def test_a_sign_constraint_is_judged_by_the_noise_that_is_left_where_nobody_stated_it() -> None:
    for truth, fights in ((PULLING, True), (PUSHING, False)):
        clean = H @ truth
        y = clean + 0.01 * np.sqrt(np.mean(clean**2)) * np.random.default_rng(0).standard_normal(len(H))
        found = StaticInversion(H, constraints=[NonNegative()]).estimate(y)
        assert ("W308" in named(found)) == fights
        assert (found.grade.letter == "D") == fights


@pytest.mark.parametrize("size", [3, 8, 22])
def test_as_many_sensors_as_loads_do_not_contradict_the_noise_level(size: int) -> None:
    """Every fit that leaves something smooths too much: what it leaves tells the load, not the noise."""
    for seed in range(20):
        rng = np.random.default_rng([size, seed])
        G = rng.standard_normal((size, size)) * 10 ** rng.uniform(-1, 1, size)
        clean = G @ rng.standard_normal(size)
        sigma = 10 ** rng.uniform(-3, -1.5) * float(np.sqrt(np.mean(clean**2)))
        y = clean + sigma * rng.standard_normal(size)
        found = StaticInversion(G, noise=Noise(sigma, source="repeatability")).estimate(y)
        assert found.choice.shown is None
        assert not {"W406", "W412"} & named(found)


def test_rules_that_disagree_matter_where_the_load_differs() -> None:
    """`tests/guards/test_histories.py` has a record on which they do."""
    choice = three(PULLING).choice
    apart = replace(choice, verdict="rules disagree", spread=1.5)
    path = SVDPath(LinearProblem.whitened(H, H @ PULLING, np.ones(8), None))
    assert [f.code for f in parameter(apart)] == ["LID-W407"]
    assert parameter(apart, path, path, 10.0) == ()
    at_odds = [replace(r, lam=10.0 * choice.lam if r.lam else None, edge=False) for r in choice.rules]
    found = parameter(replace(apart, rules=tuple(at_odds), correlated=True), path, path, 1e-9)
    assert next(f.code for f in cautions(found)) == "LID-W407"
    assert "times the std apart" in cautions(found)[0].message


def beam(noise: float = 0.01, samples: int = 256, at: int = 60) -> LoadEstimate:
    """A half sine on a lightly damped beam, two accelerometers."""
    structure = beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=40,
        damping=damping.Modal(0.01),
    )  # fmt: skip
    model = ForwardModel(
        structure, [sensors.Accelerometer(f"{n}+Z") for n in (8, 26)], [loads.Point("13+Z", label="p")], modes=10
    )
    k = np.arange(samples) - at
    g = np.where((k >= 0) & (k <= 12), 100 * np.sin(np.pi * k / 12), 0.0)
    y = np.asarray(model.predict(g, 1 / 2000))
    sigma = noise * float(np.sqrt(np.mean(y**2)))
    y = y + sigma * np.random.default_rng(0).standard_normal(y.shape)
    return Deconvolution(model, noise=Noise(sigma, source="unloaded record")).estimate(y, 1 / 2000)


def test_a_short_record_from_rest_is_no_fault_and_a_pulse_at_its_end_is() -> None:
    clean = beam()
    assert "W505" in clean.codes  # a note
    assert named(clean) == set()
    assert "W505" in named(beam(at=248))


def test_periodic_transforms_need_the_response_to_end() -> None:
    at_rest, periodic = memory(1.0, 1.0), memory(1.0, 1.0, periodic=True)
    assert (at_rest.level, periodic.level) == ("note", "warning")
    assert memory(10.0, 1.0) is None
    assert cut_off(None, np.ones((64, 1)), np.ones((64, 1))) is None


def test_a_model_that_was_not_checked_is_a_state_and_no_caution() -> None:
    found = three(PULLING)
    assert {"W114", "W703"} <= found.codes
    assert {f.level for f in found.flags if f.code in ("LID-W114", "LID-W703")} == {"note"}
    assert "state: forward model not verified; band not tested; noise level: repeatability" in found.summary()


def test_cautions_are_ranked_by_their_effect_and_survive_files() -> None:
    e = Evidence("x", 1.0, 0.0)
    flags = [Flag("W405", e, "a", state=True), Flag("W402", e, "b", effect=3.0), Flag("W403", e, "c"),
             Flag("W407", e, "d", effect=9.0), Flag("E506", e, "f")]  # fmt: skip
    assert [f.code[4:] for f in cautions(flags)] == ["E506", "W407", "W402", "W403"]
    assert [Flag.from_dict(f.to_dict()) for f in flags] == flags


def test_a_summary_has_eight_lines_and_its_details_have_all() -> None:
    for found in (three(PULLING), three(PULLING, constraints=[NonNegative()]), beam(), truncated()):
        short, whole = found.summary(), found.summary(details=True)
        assert len(short.splitlines()) <= 8
        assert f"grade {found.grade.letter}" in short.splitlines()[bool("NOT TO BE USED" in short)]
        assert all(f.code in whole for f in found.flags)
        assert "lambda" in whole


def truncated() -> LoadEstimate:
    """Two loads that no sensor tells apart, and a level that the data contradict."""
    n = np.arange(64)
    h = np.exp(-n / 40) * np.sin((n + 1) / 5)
    model = ImpulseModel(np.stack([h, 2 * h], axis=1)[:, None, :], 1e-3, kind="held")
    y = np.convolve(h, np.hanning(9), "full")[:64]
    y = y + 0.05 * y.std() * np.random.default_rng(0).standard_normal(64)
    return Deconvolution(model, noise=1e-3 * y.std()).estimate(y, dt=1e-3)
