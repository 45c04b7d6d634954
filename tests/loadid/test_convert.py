"""Files converted by the command line come back the same; sensors are placed where the best of all sets has them."""

import itertools
import json

import numpy as np
import pytest

from loadid import LoadEstimate, read
from loadid._commands import convert, load_model
from structures import ForwardModel, Structure, beams, files, loads, sensors
from tests.loadid.test_cli import installed, logs, model, run

__all__ = ["installed", "logs", "model", "run"]


@pytest.mark.parametrize("suffix", list(convert.RECORDS))
def test_a_log_comes_back(run, logs, tmp_path, suffix):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    target = tmp_path / f"new{suffix}"
    code, out, err = run("convert", logs[0], "-o", target)
    assert code == 0, err
    assert out.startswith("log ")
    old, new = read(logs[0]), read(target)
    assert new.labels == old.labels
    assert [c.unit for c in new.channels] == [c.unit for c in old.channels]
    assert new.dt == pytest.approx(old.dt, rel=1e-12)
    np.testing.assert_array_equal(new.values, old.values)


def test_a_rate_that_the_file_contradicts_is_said(run, logs, tmp_path):
    assert "contradict" in run("convert", logs[0], "-o", tmp_path / "new.csv", "--fs", "100")[1]


def test_a_result_is_its_loads_and_stds(run, logs, model, tmp_path):
    assert run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5")[0] == 0
    assert run("convert", tmp_path / "r.h5", "-o", tmp_path / "load.npz")[0] == 0
    found, known = read(tmp_path / "load.npz"), LoadEstimate.read(tmp_path / "r.h5")
    assert found.labels == ("F", "F std")
    np.testing.assert_array_equal(found["F"], known.load[:, 0])
    np.testing.assert_array_equal(found["F std"], known.std[:, 0])
    assert found.channels[0].unit == "N"


def test_models_are_arrays(run, model, tmp_path):
    assert run("convert", model, "-o", tmp_path / "m.npz")[0] == 0
    known = load_model(model)
    with np.load(tmp_path / "m.npz") as data:
        np.testing.assert_array_equal(data["frf"], known.frf(known.frequencies))
        assert data["sensor_units"].tolist() == ["m/s^2", "m/s^2"]
    beam = beams.cantilever(length=1.0, EI=10.0, mass_per_length=2.0, elements=4)
    ForwardModel(beam, [sensors.Displacement("3+Z")], [loads.Point("4+Z")]).save(tmp_path / "b.h5")
    assert run("convert", tmp_path / "b.h5", "-o", tmp_path / "b.npz")[0] == 0
    found = files.load(tmp_path / "b.npz")
    assert isinstance(found, Structure)
    np.testing.assert_allclose(found.K.toarray(), beam.K.toarray(), rtol=1e-12)


@pytest.mark.parametrize(("name", "code"), [("o.xlsx", 3), ("o", 3), ("hit0.csv", 3)])
def test_what_is_not_written(run, logs, tmp_path, name, code):
    before = sorted(p.name for p in tmp_path.iterdir())
    found, out, err = run("convert", logs[0], "-o", tmp_path / name)
    assert (found, out) == (code, ""), err
    assert sorted(p.name for p in tmp_path.iterdir()) == before


# -- design ------------------------------------------------------------------------------------------------------------
@pytest.fixture
def candidates(tmp_path):
    beam = beams.cantilever(length=1.0, EI=100.0, mass_per_length=1.0, elements=10)
    heard = [sensors.Displacement(f"{k}+Z", noise=1e-4 * (1 + 0.1 * k)) for k in range(2, 10)]
    made = ForwardModel(beam, heard, [loads.Point("4+Z"), loads.Point("10+Z")])
    made.save(tmp_path / "c.h5")
    return tmp_path / "c.h5", made


def test_the_best_of_all_sets_is_found(run, candidates, tmp_path):
    path, made = candidates
    code, out, err = run("design", path, "-n", "3", "--amplitude", "5", "--plot", tmp_path / "l.png", "--json")
    assert code == 0, err
    found = json.loads(out)
    noise = np.array([s.noise for s in made.sensors])
    A = made.static() / noise[:, None] * 5

    def gain(rows):
        return np.linalg.slogdet(np.eye(2) + A[list(rows)].T @ A[list(rows)])[1]

    best = max(itertools.combinations(range(8), 3), key=gain)
    assert set(found["sensors"]) == {made.sensors[k].label for k in best}
    assert found["layout"]["logdet"] == pytest.approx(gain(best), rel=1e-6)
    assert (tmp_path / "l.png").read_bytes()[:4] == b"\x89PNG"
    assert run("design", path, "-n", "3", "--amplitude", "5")[1].startswith("place ")


def test_wrong_wishes(run, candidates):
    path, _ = candidates
    for words, code in (
        (["-n", "0"], 2),
        (["-n", "99"], 3),
        (["-n", "2", "--keep", "x"], 3),
        (["-n", "2", "--snr", "0"], 2),
    ):
        assert run("design", path, *words)[0] == code
