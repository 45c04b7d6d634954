"""The answer of every family: numbers, words and files."""

import copy
import json
import pickle

import numpy as np
import pytest

from loadid import LoadEstimate
from loadid._results import estimate as module
from loadid._results.estimate import Axis
from loadid._results.summary import plus_minus, quantity
from structures.errors import InputError
from structures.files import _storage as storage
from tests.loadid.made import CERTIFICATE, Gaussian, impact, static


@pytest.fixture
def posterior_module(monkeypatch):
    """Stands in for what rebuilds posteriors."""
    monkeypatch.setattr("loadid._results.archive.from_arrays", lambda arrays: Gaussian(**arrays))


def test_arrays_and_mappings_cannot_be_changed():
    own = np.ones((5, 1))
    e = LoadEstimate(load=own, std=own, labels=["a"], units=["N"], axis=Axis("time", "s", np.arange(5.0)))
    own[0] = 7  # the caller's array is apart
    assert e.load[0, 0] == 1
    for array in (e.load, e.std, e.axis.values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 2
    with pytest.raises(TypeError):
        e.facts["rank"] = 3
    with pytest.raises(AttributeError):
        e.load = own


def test_copies_and_other_processes_get_the_whole_estimate():
    e = impact()
    for other in (copy.deepcopy(e), pickle.loads(pickle.dumps(e))):
        np.testing.assert_array_equal(other.load, e.load)
        assert other.provenance == e.provenance
        assert other.summary(details=True) == e.summary(details=True)
        assert not other.load.flags.writeable


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"std": np.ones((3, 1))}, "std does not fit"),
        ({"labels": ["a", "b"]}, "labels or units"),
        ({"load": np.full((400, 1), np.nan)}, "not finite"),
        ({"std": np.full((400, 1), -1.0)}, "no std"),
        ({"axis": None}, "axis does not fit"),
        ({"axis": Axis("time", "s", np.arange(7.0))}, "axis does not fit"),
        ({"sensors": ["a"]}, "sensors do not fit"),
        ({"residual": np.full((400, 3), np.inf)}, "residual is not finite"),
        ({"allowed": ["hello"]}, "guard code"),
        ({"load": np.zeros((0, 1))}, "no load"),
    ],
)
def test_what_does_not_fit_together_is_refused(changes, word):
    with pytest.raises(InputError, match=word):
        impact(**changes)


def test_band_is_the_normal_quantile():
    e = impact()
    lower, upper = e.band()
    np.testing.assert_allclose(upper - e.load, 1.959963984540054 * 15)
    np.testing.assert_allclose(e.load - lower, 1.959963984540054 * 15)
    np.testing.assert_allclose(e.band(0.5)[1] - e.load, 0.6744897501960817 * 15)
    with pytest.raises(InputError, match="probability"):
        e.band(95)


def test_impulse_and_mean_of_a_half_sine():
    t = np.arange(400) * 1e-4
    pulse = np.where((t >= 0.01) & (t <= 0.012), 1000 * np.sin(np.pi * (t - 0.01) / 0.002), 0)
    e = impact(load=pulse[:, None])
    impulse = e.functional("impulse")
    assert impulse.value == pytest.approx(2 / np.pi * 1000 * 0.002, rel=3e-3)  # closed form 2 P T / pi
    assert impulse.std == pytest.approx(1e-4 * 15 * np.sqrt(400))
    assert impulse.unit == "N s"
    mean = e.functional("mean", window=(0.01, 0.012))
    assert mean.value == pytest.approx(2 / np.pi * 1000 * 20 / 21, rel=3e-3)
    assert mean.std == pytest.approx(15 / np.sqrt(21))
    assert "impulse 1.27" in str(impulse)


def test_functionals_see_the_correlation_and_agree_with_samples():
    rng = np.random.default_rng(1)
    root = rng.standard_normal((12, 12))
    e = LoadEstimate(
        load=rng.standard_normal((6, 2)), std=np.ones((6, 2)), labels=["a", "b"], units=["N", "N m"],
        axis=Axis("time", "s", np.arange(6) * 0.5), posterior=Gaussian(root @ root.T),
    )  # fmt: skip
    draws = (rng.standard_normal((200_000, 12)) @ root.T).reshape(-1, 6, 2)
    assert e.functional("impulse", load="b").std == pytest.approx(np.std(0.5 * draws[:, :, 1].sum(1)), rel=0.01)
    w = rng.standard_normal((6, 2))
    assert e.functional(w).std == pytest.approx(np.std((w * draws).sum((1, 2))), rel=0.01)
    assert e.functional(w).value == pytest.approx(np.sum(w * e.load))
    assert e.functional(w[:, 1], load=1).value == pytest.approx(w[:, 1] @ e.load[:, 1])
    assert e.functional("impulse", load=-1).unit == "N m s"


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"load": "zz"}, "no such load"),
        ({"load": 3}, "no such load"),
        ({"window": (5, 6)}, "holds no sample"),
        ({"w": "median"}, "no such functional"),
        ({"w": "sum", "window": (0.0, 0.01)}, "no window"),
        ({"w": np.ones(3)}, "do not fit"),
    ],
)
def test_functionals_that_make_no_sense_are_refused(arguments, word):
    with pytest.raises(InputError, match=word):
        impact().functional(**arguments)


def test_the_peak_of_a_window():
    e = impact()
    late = e.axis.values >= 0.012
    assert e.functional("peak", window=(0.012, 1.0)).value == pytest.approx(max(e.load[late, 0], key=abs))
    assert abs(e.functional("peak").value) > abs(e.functional("peak", window=(0.012, 1.0)).value)


def test_a_static_load_has_no_impulse_but_sums():
    e = static()
    with pytest.raises(InputError, match="no window"):
        e.functional("sum", window=(0, 1))
    with pytest.raises(InputError, match="static load"):
        e.functional("impulse")
    total = e.functional(np.ones(4))
    assert total.value == pytest.approx(80)
    assert total.std is None


def test_peak_keeps_the_sign():
    e = impact(load=-impact().load)
    assert e.peaks[0].value == pytest.approx(-1000, abs=50)
    assert e.peaks[0].at == pytest.approx(0.011, abs=3e-4)


def test_summary_says_what_must_be_known():
    text = impact(allowed=["w407"]).summary(details=True)
    for word in ("peak 10", "impulse", "forward model not verified", "allowed: LID-W407", "LID-W114",
                 "hang a known mass", "robust_gcv", "determined", "9 of 10", "sigma is not known", "rank 400",
                 "nullity 0", "quiet segment", "white noise"):  # fmt: skip
        assert word in text, word
    verified = impact(certificate=CERTIFICATE).summary(details=True)
    assert "not verified" not in verified
    assert "hanging mass 2 kg" in verified
    assert "flags: none" in static().summary(details=True)


@pytest.mark.parametrize(
    "make", [impact, static, lambda: impact(3), lambda: impact(certificate=CERTIFICATE, choice=None)]
)
def test_files_bring_everything_back(tmp_path, posterior_module, make):
    e = make()
    e.save(tmp_path / "e.h5")
    other = LoadEstimate.read(tmp_path / "e.h5")
    assert other.summary(details=True) == e.summary(details=True)
    assert other.to_dict() == e.to_dict()
    assert other.flags == e.flags
    assert other.certificate == e.certificate
    np.testing.assert_array_equal(other.load, e.load)
    if e.choice is not None:
        assert other.choice.rules == e.choice.rules
        np.testing.assert_array_equal(other.choice.sweep.edf, e.choice.sweep.edf)
    if e.posterior is not None:
        assert other.functional("impulse") == e.functional("impulse")
    assert module.load(tmp_path / "e.h5").labels == e.labels


def test_a_file_of_another_release_is_refused_by_name(tmp_path):
    storage.write(tmp_path / "e.h5", {"axis": None}, "load estimate")
    with pytest.raises(InputError, match="this release"):
        LoadEstimate.read(tmp_path / "e.h5")
    storage.write(tmp_path / "m.h5", {}, "measured model")
    with pytest.raises(InputError, match="another kind"):
        LoadEstimate.read(tmp_path / "m.h5")


def test_json_is_strict_and_complete():
    e = impact(facts={"kappa": np.inf, "ids": np.arange(2), "x": np.float64(2)}, certificate=CERTIFICATE)
    text = json.dumps(e.to_dict(), allow_nan=False)
    back = json.loads(text)
    assert back["facts"] == {"kappa": None, "ids": [0, 1], "x": 2.0}
    assert back["flags"][1]["code"] == "LID-W114"
    np.testing.assert_array_equal(back["load"], e.load)


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (1003.4, 12.3, "1003 ± 12"),
        (0.63712, 0.00312, "0.6371 ± 0.0031"),
        (1234.0, 340.0, "1230 ± 340"),
        (-2.5, None, "-2.5"),
        (3.0, 0.0, "3 ± 0"),
        (2.0e6, 1.3e3, "2.0000e+06 ± 1.3e+03"),
        (2e-5, 3e-7, "2.000e-05 ± 3.0e-07"),
        (0.0, 0.5, "0.00 ± 0.50"),
    ],
)
def test_numbers_are_rounded_by_their_std(value, std, text):
    assert plus_minus(value, std) == text


def test_times_are_readable():
    assert [quantity(x, "s") for x in (0.00512, 2.0, 0.0, 2e-5)] == ["5.12 ms", "2 s", "0 s", "20 µs"]
    assert quantity(0.3, "Hz") == "0.3 Hz"
