"""A tracker's file: goes on bit for bit from any sample, and is refused where it is not whole or not the model's."""

import os

import numpy as np
import pytest

from loadid._families.tracking import fit as packing
from loadid._families.tracking import tracker as checkpoint
from loadid._families.tracking.tracker import Tracker
from structures.errors import InputError
from structures.files import _storage as storage
from tests.killed import fitted


@pytest.fixture(scope="module")
def tracker():
    return fitted(800)


@pytest.fixture(scope="module")
def file(tracker, tmp_path_factory):
    path = tmp_path_factory.mktemp("tracker") / "model.h5"
    tracker[0].save(path)
    return path


def troubled(Y):
    """A gap, a wrong channel and a step: everything that leaves the settled gain."""
    Y = Y.copy()
    Y[300:340, 3], Y[450, 0], Y[600:] = np.nan, Y[450, 0] + 1e3, np.where(np.arange(4) == 1, np.nan, Y[600:])
    return Y


@pytest.mark.parametrize("cut", [0, 1, 5, 320, 339, 451, 455, 601, 799])
def test_a_tracker_goes_on_bit_for_bit(tracker, file, tmp_path, cut):
    Y = troubled(tracker[1])
    whole = Tracker.load(file)
    expected = whole.run(Y)
    first = Tracker.load(file)
    a = first.run(Y[:cut])
    first.save(tmp_path / "state.h5")
    second = Tracker.load(tmp_path / "state.h5", first.fitted.fingerprint)
    assert second.phase == first.phase
    b = second.run(Y[cut:])
    for x, y, z in zip(a, b, expected, strict=True):
        assert np.concatenate([x, y]).tobytes() == z.tobytes()
    assert second.counts == whole.counts


def test_a_loaded_tracker_is_the_one_that_was_fitted(tracker, file):
    own, found = tracker[0], Tracker.load(file)
    own.reset()
    assert own.run(tracker[1])[0].tobytes() == found.run(tracker[1])[0].tobytes()
    assert found.flags == own.flags
    assert found.certificate == own.certificate
    assert [c.label for c in found.fitted.sensors] == [c.label for c in own.fitted.sensors]
    assert found.fitted.settled.K.tobytes() == own.fitted.settled.K.tobytes()


def test_models_that_are_wrong_as_declared_go_on_too(tracker, tmp_path):
    fit, Y = tracker[0].fitted, tracker[1]
    several = Tracker(type(fit)(**{**vars(fit), "bank": ((1 / 6, fit.model, fit.settled), (1 / 6, fit.model, None))}))
    expected = several.run(Y[:80])[1]
    several.reset()
    several.run(Y[:30])
    several.save(tmp_path / "state.h5")
    assert np.array_equal(Tracker.load(tmp_path / "state.h5").run(Y[30:80])[1], expected[30:])


def test_every_truncation_is_refused(file, tmp_path):
    data, torn = file.read_bytes(), tmp_path / "torn.h5"
    for size in (0, 1, 100, 511, 512, 513, len(data) // 2, len(data) - 1):
        torn.write_bytes(data[:size])
        with pytest.raises(InputError):
            Tracker.load(torn)


def test_another_model_format_or_kind_is_refused(file, tmp_path):
    with pytest.raises(InputError, match="another model"):
        Tracker.load(file, "0" * 64)
    tree = storage.read(file, checkpoint.KIND)
    storage.write(tmp_path / "new.h5", {**tree, "format": 99}, checkpoint.KIND)
    with pytest.raises(InputError, match="another format"):
        Tracker.load(tmp_path / "new.h5")
    storage.write(tmp_path / "kind.h5", tree, "load estimate")
    with pytest.raises(InputError, match="another kind"):
        Tracker.load(tmp_path / "kind.h5")
    del tree["running"]
    storage.write(tmp_path / "less.h5", tree, checkpoint.KIND)
    with pytest.raises(InputError, match="not what this release expects"):
        Tracker.load(tmp_path / "less.h5")


def test_a_file_that_cannot_be_written_leaves_the_old_one(tracker, file, tmp_path, monkeypatch):
    path = tmp_path / "state.h5"
    path.write_bytes(file.read_bytes())

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="cannot be written"):
        tracker[0].save(path)
    monkeypatch.undo()
    assert path.read_bytes() == file.read_bytes()
    assert list(tmp_path.iterdir()) == [path]


def test_values_come_back_with_their_type_and_their_order_in_memory():
    turned = np.asfortranarray(np.random.default_rng(0).standard_normal((3, 4)))
    value = {
        "a": turned,
        "b": (1, 2.5, None, "x"),
        "c": [True, np.inf, -0.0],
        "d": np.array([True, False]),
        "e": turned,
    }
    found = packing.unpack(packing.pack(value))
    assert found["a"].flags.f_contiguous
    assert not found["a"].flags.c_contiguous
    assert np.array_equal(found["a"], turned)
    assert found["e"] is found["a"]
    assert found["b"] == value["b"]
    assert isinstance(found["b"], tuple)
    assert found["d"].dtype == bool
    assert str(found["c"]) == str(value["c"])
    with pytest.raises(InputError, match="does not hold"):
        packing.pack({"f": {1, 2}})
