import dataclasses
import hashlib

import numpy as np
import pytest

from loadid import Record
from structures import Channel
from structures.errors import InputError

RNG = np.random.default_rng(1)


def record(**settings):
    force = Channel(label="F", quantity="force", unit="N")
    return Record(RNG.normal(size=(50, 3)), 0.01, [force, "a", "b"], **settings)


def test_shapes_and_names():
    r = record(name="hit 1", source="log.csv")
    assert (r.values.shape, r.labels, r.dt, len(r)) == ((50, 3), ("F", "a", "b"), 0.01, 50)
    assert r.units == ("N", "arbitrary", "arbitrary")
    assert r.time[-1] == pytest.approx(0.49)
    assert "hit 1" in repr(r)
    one = Record([1, 2, 3], 0.5, "F")
    assert (one.values.shape, one.labels) == ((3, 1), ("F",))
    assert Record(np.ones((4, 2)), 1.0).labels == ("ch1", "ch2")


def test_frozen_and_independent_of_the_callers_array():
    x = np.zeros((5, 1))
    r = Record(x, 1.0, "F")
    x[:] = 7
    assert np.all(r.values == 0)
    with pytest.raises(ValueError, match="read-only"):
        r.values[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        r.dt = 2.0


@pytest.mark.parametrize("dt", [0, -1.0, np.nan, np.inf, "fast", None, 1e-320])
def test_step_must_be_positive(dt):
    with pytest.raises(InputError, match="step is not positive"):
        Record([1.0, 2.0], dt, "F")


@pytest.mark.parametrize(
    "values", [[], [[]], np.zeros((2, 2, 2)), 3.0, ["a"], [1 + 2j], [[1], [1, 2]], None, [object()]]
)
def test_values_must_be_a_table(values):
    with pytest.raises(InputError, match="values are no table"):
        Record(values, 1.0)


@pytest.mark.parametrize(("labels", "match"), [(["F"], "do not fit"), (["F", "F"], "doubled"), (["F", " "], "empty")])
def test_labels(labels, match):
    with pytest.raises(InputError, match=match):
        Record(np.ones((3, 2)), 1.0, labels)


def test_infinite_refused_with_its_place_and_nan_kept():
    with pytest.raises(InputError, match=r"channel b.*sample 4"):
        Record(np.where(np.arange(10)[:, None] == 4, [0, -np.inf], 0.0), 1.0, ["a", "b"])
    r = Record([0.0, np.nan, 1.0], 1.0, "a")
    assert np.isnan(r.values[1, 0])
    assert [f.evidence.name for f in r.health()] == ["missing"]


def test_select_and_index():
    r = record(units=["kN", "g", "V"])
    s = r.select(["b", 0])
    assert (s.labels, s.units) == (("b", "F"), ("V", "kN"))
    np.testing.assert_array_equal(s.values, r.values[:, [2, 0]])
    np.testing.assert_array_equal(r["a"], r.values[:, 1])
    assert (r.index("2"), r.index(-1), r.select("a").labels) == (2, 2, ("a",))
    for bad in (3, "Force", None, True, 1.0, "99999999999999"):
        with pytest.raises(InputError, match="0: F, 1: a, 2: b"):
            r.index(bad)
    with pytest.raises(InputError, match="did you mean 'F'"):
        r.index("f")
    with pytest.raises(InputError, match="doubled"):
        r.select(["F", 0])


def test_window():
    r = record()
    w = r.window(0.1, 0.2)
    np.testing.assert_array_equal(w.values, r.values[10:20])
    np.testing.assert_array_equal(r.window(0.3).values, r.values[30:])
    np.testing.assert_array_equal(r.window(-5, 1e300).values, r.values)
    for bad in ((0.2, 0.2), (3, 4), (np.nan, 1)):
        with pytest.raises(InputError, match="window"):
            r.window(*bad)


def test_units_say_what_was_recorded():
    r = Record([[1.0, 2.0]], 1.0, ["F", "a"]).apply_units({"F": "kN", 1: "g"})
    np.testing.assert_allclose(r.values, [[1000.0, 2 * 9.80665]])
    assert r.units == ("kN", "g")
    assert [(c.quantity, c.unit) for c in r.channels] == [("force", "N"), ("acceleration", "m/s^2")]
    back = r.apply_units({"F": "arbitrary"})
    assert (back.values[0, 0], back.channels[0].unit) == (1.0, "arbitrary")
    with pytest.raises(InputError, match="did you mean"):
        r.apply_units({"Fx": "N"})
    with pytest.raises(InputError, match="unknown unit"):
        r.apply_units({"F": "stone"})


def test_digest_depends_on_values_step_and_labels_only():
    a = Record([1.0, 2.0], 1.0, "F", name="x")
    same = Record([1.0, 2.0], 1.0, "F", name="y")
    others = [Record([1.0, 2.1], 1.0, "F"), Record([1.0, 2.0], 2.0, "F"), Record([1.0, 2.0], 1.0, "G")]
    assert a.sha256 == same.sha256
    assert len({a.sha256, *(o.sha256 for o in others)}) == 4
    text = repr(((2, 1), 1.0, ("F",))).encode()
    assert a.sha256 == hashlib.sha256(np.array([1.0, 2.0], "<f8").tobytes() + text).hexdigest()
