"""One job file makes a set and its page: of a model, and of a gel pad that its package registers."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

import pytest

from loadid import InputError, _toml
from loadid.generate import TrainingSet, generate_from, histories, overview
from loadid.generate._work import head_of
from tactile.generate import _plan as plan

from .made import chain
from .test_histories import TEXT

JOB = """\
model = "model.h5"
truth = "truth.h5"
declaration = "loads.toml"
set = "training"
draws = 6
seed = 2
workers = 1
"""
PAD = """\
[pad]
size = ["12 mm", "12 mm"]
thickness = "2 mm"
E = "0.15 MPa"
nu = 0.4
pitch = "1.5 mm"
layers = 3

[camera]
focal = 560
centre = [160, 120]
distance = "22 mm"
depth = "2 mm"
gamma = 1.4
"""
PRESSES = """\
set = "presses"
draws = 3
workers = 1
[sensor]
pad = "pad.toml"
rows = 8
columns = 9
pitch = "1.2 mm"
[[declaration.indenter]]
kind = "sphere"
radius = "3 mm"
[declaration.contact]
depth = ["0.05 mm", "0.1 mm"]
[declaration.image]
size = [240, 320]
radius = "0.18 mm"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    chain().save(tmp_path / "model.h5")
    chain(1.05).save(tmp_path / "truth.h5")
    (tmp_path / "loads.toml").write_text(TEXT)
    (tmp_path / "job.toml").write_text(JOB)
    (tmp_path / "pad.toml").write_text(PAD)
    (tmp_path / "presses.toml").write_text(PRESSES)
    return tmp_path


def test_a_job_makes_a_set_and_its_page(folder: Path) -> None:
    found = generate_from(folder / "job.toml")
    assert len(found) == 6
    assert TrainingSet.open(folder / "training").fingerprint == found.fingerprint
    page = (folder / "training" / "set.html").read_text()
    for word in ("impact", "random", found.fingerprint[:16], "stiffness", "6 draws"):
        assert word in page
    other = generate_from(folder / "job.toml", folder / "other", draws=2, seed=5)
    assert len(other) == 2
    assert other.fingerprint != found.fingerprint


@pytest.mark.skipif(not entry_points(group="loadid.generators"), reason="installed before generators were registered")
def test_a_gel_pad_is_drawn_for_too(folder: Path) -> None:
    found = generate_from(folder / "presses.toml")
    assert (len(found.sensors), found.kinds) == (2 * 8 * 9, ("sphere",))
    assert "sphere" in (folder / "presses" / "set.html").read_text()


def test_the_large_set_is_pinned() -> None:
    """5000 rendered presses by ``generate_from("tests/generate/skin.toml")``: who they are, without making them."""
    path = Path(__file__).with_name("skin.toml")
    job = _toml.read(path)
    maker, _, _ = plan.maker(job, path)
    assert job["draws"] == 5000
    assert head_of(maker, job["draws"], job["seed"]).fingerprint.startswith("8ef12e142df84a0b")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("draws = 6", "draw = 6", "did you mean 'draws'"),
        ('model = "model.h5"\n', "", "model or a sensor"),
        ('"model.h5"', '"none.h5"', "no such model"),
        ("draws = 6", "draws = -6", "no such value"),
        ("draws = 6\n", "", "no such value"),
        ('"loads.toml"', '"no.toml"', "no such declaration"),
    ],
)
def test_a_job_that_is_none_is_refused(folder: Path, old: str, new: str, said: str) -> None:
    (folder / "job.toml").write_text(JOB.replace(old, new))
    with pytest.raises(InputError, match=said):
        generate_from(folder / "job.toml")
    assert not (folder / "training").exists()


def test_a_page_of_a_damaged_set_is_not_written(folder: Path) -> None:
    found = histories(chain(), folder / "loads.toml", folder / "training", draws=3, seed=0, workers=1)
    shard = folder / "training" / "shards" / "00000.h5"
    shard.write_bytes(shard.read_bytes()[:-1])
    with pytest.raises(InputError, match="damaged"):
        overview(found.open(folder / "training"), folder / "page.html")
    assert not (folder / "page.html").exists()
