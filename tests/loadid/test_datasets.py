"""Sets of data to try with: one seed makes one set, files read back, and the truth is not the model that inverts."""

import numpy as np
import pytest

from loadid import cli, datasets, read
from structures.errors import InputError
from structures.files import read_frfs

SETS = [name for name in datasets.__all__ if name not in ("Dataset", "fleet")]


@pytest.mark.parametrize("name", SETS)
def test_a_seed_makes_the_same_files_and_another_one_others(name, tmp_path):
    make = getattr(datasets, name)
    first, again, other = (make(tmp_path / k, seed=seed) for k, seed in (("a", 1), ("b", 1), ("c", 2)))
    assert first.files
    assert [f.name for f in first.files] == [f.name for f in other.files]
    same = [(a.read_bytes() == b.read_bytes()) for a, b in zip(first.files, again.files, strict=True)]
    assert all(same)
    new = [f.name for f, g in zip(first.files, other.files, strict=True) if f.read_bytes() != g.read_bytes()]
    assert new == [
        f.name for f in first.files if f.name not in ("frfs.uff", "test.uff")
    ]  # FRFs of the beam have no noise


@pytest.mark.parametrize("name", SETS)
def test_no_set_is_more_than_a_few_seconds_of_data(name):
    made = getattr(datasets, name)()
    assert not made.files
    assert made.record.values.nbytes < 2e6
    assert made.record.simulated_by
    labels = [c.label for c in made.record.channels]
    assert [c.label for c in made.model.sensors] == [one for one in labels if one not in ("hammer", "F")]


FILES = [("impact", "log.csv"), ("hammer_test", "unknown.csv"), ("wing_strains", "strains.csv"),
         ("beam_sources", "operating.uff")]  # fmt: skip


@pytest.mark.parametrize(("name", "file"), FILES)
def test_what_is_read_is_what_was_made(name, file, tmp_path):
    made = getattr(datasets, name)(tmp_path)
    back = read(tmp_path / file)
    assert [(c.label, c.unit, c.quantity) for c in back.channels] == [
        (c.label, c.unit, c.quantity) for c in made.record.channels
    ]
    assert back.dt == pytest.approx(made.record.dt, rel=1e-9)
    np.testing.assert_allclose(back.values, made.record.values, rtol=1e-9, atol=1e-12)


def test_another_library_reads_the_universal_files(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    made = datasets.beam_sources(tmp_path)
    sets = [s for s in pyuff.UFF(str(tmp_path / "frfs.uff")).read_sets() if s["type"] == 58]
    H = made.model.frf(np.arange(1, 512) * 0.5)[:, :, 0]
    for k, one in enumerate(sets):
        np.testing.assert_allclose(one["data"], H[:, k], rtol=1e-9)
        np.testing.assert_allclose(one["x"], np.arange(1, 512) * 0.5)
        assert (one["rsp_dir"], one["ref_node"], one["ref_dir"], one["func_type"]) == (3, 13, 3, 4)
    assert [one["rsp_node"] for one in sets] == [5, 12, 14, 31]
    assert [c.label for c in read_frfs(tmp_path / "frfs.uff").sensors] == ["5+Z", "12+Z", "14+Z", "31+Z"]


def test_the_model_of_an_engineer_is_near_the_truth_and_is_not_it():
    """A coarser mesh and fewer modes: what it predicts of the true load is off by more than the noise, by not much."""
    made = datasets.impact()
    y = made.record.values
    off = np.linalg.norm(y - made.model.predict(made.load, made.record.dt)) / np.linalg.norm(y)
    assert 0.005 < off < 0.1
    assert made.model.fingerprint != made.record.simulated_by


def test_the_fleet_has_a_plan_that_runs(tmp_path, monkeypatch, capsys):
    made = datasets.fleet(tmp_path)
    assert [f.relative_to(tmp_path).as_posix() for d in made for f in d.files] == [
        f"beam-{k}/2026-03-0{day}T0000.csv" for k in (1, 2) for day in (1, 2)
    ]
    monkeypatch.chdir(tmp_path)
    assert cli.main(["batch", "plan.toml", "--estimate"]) == 0
    assert (tmp_path / "march").is_dir()


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="the folder cannot be made"):
        datasets.impact(tmp_path / "file" / "below")


def test_sets_written_to_one_folder_keep_each_other_s_files(tmp_path):
    names = [f.name for name in SETS for f in getattr(datasets, name)(tmp_path).files]
    assert len(names) == len(set(names)) == len(list(tmp_path.iterdir()))
