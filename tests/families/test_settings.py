"""Settings that belong together: what they hold, how they print, and the spellings of release 0.1."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest

import loadid
from loadid import (
    Deconvolution,
    FieldDeconvolution,
    FrequencyInversion,
    Guards,
    InputError,
    Lambda,
    LoadTracker,
    ModelErrors,
    Noise,
    NoiseSource,
    Online,
    Penalty,
    Priors,
    Search,
    Signal,
    Sparsity,
    StaticInversion,
)
from loadid._spellings import ARGUMENTS, folded
from structures import ImpulseModel

EVERY = [
    Noise(0.1, source="datasheet"), Noise([0.1, 0.2], source=("quiet", "a still night"), bias=1e-3), Noise(),
    Lambda("gcv", method="tsvd"), Lambda(0.01, path="dense"), Lambda(loadid.Absolute(2.0)),
    Penalty("first_difference", leak=0.9), Penalty(None), Penalty(size=[1.0, 2.0], from_zero=True),
    Guards(["E306"], load_class="impact"), Signal("stationary", segment=64), Sparsity("loads", nonnegative=True),
    Search(2, places=[[0.0], [1.0]]), Priors("ou", start="static", dummy=1e-3), Online("auto", limits={"a": 3.0}),
    ModelErrors({"mass": 0.1}, scales=["stiffness"]),
]  # fmt: skip
H = np.random.default_rng(0).standard_normal((6, 3))
Y = H @ [1.0, 2.0, 3.0] + 0.01 * np.random.default_rng(1).standard_normal(6)
T = np.arange(60)
MODEL = ImpulseModel(
    np.stack([np.exp(-T / 9) * np.sin(T / 3 + 1), np.exp(-T / 5)], axis=1)[..., None], 0.01, kind="held"
)
RECORD = MODEL.predict(np.sin(T / 7)[:, None], 0.01) + 0.01 * np.random.default_rng(2).standard_normal((60, 2))


@pytest.mark.parametrize("one", EVERY, ids=repr)
def test_a_setting_is_immutable_and_prints_as_it_is_pasted(one):
    again = eval(repr(one), {**vars(loadid), **{type(x).__name__: type(x) for x in EVERY}, "Absolute": loadid.Absolute})
    assert again == one
    assert hash(again) == hash(one)
    assert type(one).of(one) is one
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.new = 1
    for value in vars(one).values():
        if isinstance(value, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                value[...] = 0
    assert pickle.loads(pickle.dumps(one)) == one
    assert one != object()


def test_the_array_of_a_user_is_copied():
    std = np.array([0.1, 0.2])
    noise = Noise(std)
    std[0] = 9.0
    assert noise.std[0] == 0.1
    assert Noise([0.1, 0.2]) != Noise([0.1, 0.3])


@pytest.mark.parametrize(
    ("kind", "given", "where"),
    [
        (Noise, {"std": "loud"}, "noise"), (Noise, {"std": np.nan}, "noise"), (Noise, {"source": 3}, "noise_source"),
        (Lambda, {"choice": True}, "choice"), (Lambda, {"method": "magic"}, "method"), (Lambda, {"path": "x"}, "path"),
        (Lambda, {"over": "all"}, "over"), (Lambda, {"neighbours": -1}, "neighbours"), (Lambda, {"count": 0}, "count"),
        (Penalty, {"L": "smooth"}, "penalty"), (Penalty, {"size": -1.0}, "size"), (Penalty, {"leak": "x"}, "leak"),
        (Penalty, {"from_zero": 2}, "from_zero"), (Guards, {"allow": "W114"}, "allow"),
        (Guards, {"load_class": "wind"}, "load_class"), (Signal, {"kind": "loud"}, "signal"),
        (Sparsity, {"groups": "x"}, "groups"), (Sparsity, {"tol": 0.1}, "tol"),
        (Sparsity, {"reweighted": -1}, "reweighted"), (Search, {"impacts": 0}, "impacts"),
        (Search, {"workers": 1.5}, "workers"), (Priors, {"start": "soon"}, "start"), (Priors, {"dummy": -1}, "dummy"),
        (Online, {"lag": -1}, "lag"), (Online, {"replay": 0.5}, "replay"), (Online, {"engine": "x"}, "engine"),
        (ModelErrors, {"relative": {"length": 0.1}}, "model_error"), (ModelErrors, {"scales": "mass"}, "scales"),
    ],
)  # fmt: skip
def test_settings_are_checked_where_they_are_made(kind, given, where):
    with pytest.raises(InputError) as caught:
        kind(**given)
    assert caught.value.where == where


def test_both_spellings_give_one_answer():
    new = StaticInversion(H, choice=Lambda("gcv", method="tsvd"), noise=Noise(0.01, source="datasheet")).estimate(Y)
    with pytest.warns(DeprecationWarning, match=r"choice=Lambda\('gcv', method='tsvd'\)") as told:
        old = StaticInversion(H, choice="gcv", method="tsvd", noise=0.01, noise_source="datasheet").estimate(Y)
    assert "noise=Noise(0.01, source='datasheet')" in str(told[0].message)
    assert told[0].filename == __file__
    np.testing.assert_array_equal(old.load, new.load)
    np.testing.assert_array_equal(old.std, new.std)
    assert old.provenance["settings"] == new.provenance["settings"]
    assert old.facts["noise_kind"] == "datasheet"
    new = Deconvolution(MODEL, choice=Lambda(0.01, path="toeplitz"), allow=Guards(load_class="service"), noise=0.01)
    with pytest.warns(DeprecationWarning, match=r"path=, load_class=.*allow=Guards\(load_class='service'\)"):
        old = Deconvolution(MODEL, choice=0.01, path="toeplitz", load_class="service", noise=0.01)
    a, b = (family.estimate(RECORD, 0.01) for family in (old, new))
    np.testing.assert_array_equal(a.load, b.load)
    assert a.codes == b.codes


def test_what_family_passes_on_is_converted_once():
    with pytest.warns(DeprecationWarning, match="FieldDeconvolution") as told:
        FieldDeconvolution(MODEL, time="first_difference", leak=0.9, path="auto", noise=0.01, noise_source="datasheet")
    assert len(told) == 1
    with pytest.raises(TypeError, match="Deconvolution has no setting 'constraint'; did you mean 'constraints'"):
        FieldDeconvolution(MODEL, constraint=[])


def test_a_setting_that_is_a_guard_code_now():
    assert folded(LoadTracker, {"allow_drift": True, "allow": ["W401"]})["allow"].codes == ("LID-W401", "LID-E501")
    assert folded(LoadTracker, {"allow_drift": False})["allow"] == Guards()
    with pytest.raises(TypeError, match=r"allow=\['LID-E501'\]"):
        folded(LoadTracker, {"alow_drift": True})


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({"noise": Noise(0.1), "noise_source": "datasheet"}, "noise_source="),
        ({"choice": Lambda(0.1), "path": "dense"}, "path="),
        ({"allow": Guards(), "coverage": None}, "coverage="),
    ],
)
def test_both_spellings_at_once_are_refused(given, found):
    with pytest.raises(InputError, match="two spellings") as caught:
        Deconvolution(MODEL, **given)
    assert found in str(caught.value)


@pytest.mark.parametrize(
    ("family", "given", "words"),
    [
        (Deconvolution, {"penalti": "identity"}, "did you mean 'penalty'"),
        (Deconvolution, {"noise_sorce": "x"}, r"did you mean noise=Noise\(source=...\)"),
        (FrequencyInversion, {"neighbors": 3}, r"did you mean choice=Lambda\(neighbours=...\)"),
        (StaticInversion, {"xyzzy": 1}, "it has model, penalty, choice"),
    ],
)
def test_an_unknown_name_ends_in_the_nearest_one(family, given, words):
    with pytest.raises(TypeError, match=words):
        family(MODEL, **given)


def test_a_field_that_a_family_does_not_know_is_refused():
    with pytest.raises(InputError, match=r"does not know this setting.*over='line'.*Lambda\(choice, method, path\)"):
        Deconvolution(MODEL, choice=Lambda(over="line"))
    with pytest.raises(InputError, match="interpolation"):
        Deconvolution(MODEL, noise=Noise(0.1, interpolation=np.eye(2)))


def test_every_former_argument_is_a_field():
    for name, written in ARGUMENTS.items():
        for old, (argument, field) in written.former.items():
            kind = written.kinds[argument][0]
            assert field in {f.name for f in dataclasses.fields(kind)}, (name, old)
    assert ARGUMENTS["Deconvolution"].former["noise_source"] == ("noise", "source")
    assert Noise(0.1, source=NoiseSource("quiet")) == Noise(0.1, "quiet")
