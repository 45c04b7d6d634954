"""Plans as users write them: each fault is refused in one line that names it."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import pytest

from loadid._batch import plan
from structures.errors import InputError
from tests.halfsine import system

GOOD = """
output = "out"
[job]
choice = "gcv"
penalty = "first_difference"
allow = ["E306", "E213"]
[reading]
fs = 100
unit = { acc = "g" }
[fatigue]
exponents = [3, 10]
[run]
workers = 2
memory = "1.5 GB"
[every]
model = "{name}.h5"
records = ["{name}_*.csv", "more/{name}.csv"]
start = "{name}_%Y%m%d.csv"
[[asset]]
name = "b1"
limits = { F = 10.0, M = [-5, 7] }
response = ["acc", 1]
from = 2026-03-01
reading = { fs = 200 }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    system().save(tmp_path / "b1.h5")
    (tmp_path / "more").mkdir()
    for name in ("b1_20260302.csv", "b1_20260301.csv", "more/b1.csv"):
        (tmp_path / name).write_text("x")
    return tmp_path


def read(folder: Path, text: str) -> plan.Plan:
    (folder / "plan.toml").write_text(text)
    return plan.read(folder / "plan.toml")


def test_a_plan(folder: Path) -> None:
    found = read(folder, GOOD)
    (asset,) = found.assets
    assert found.output == folder / "out"
    assert found.job == {"family": "deconvolution", "choice": "gcv", "penalty": "first_difference",
                         "allow": ["E306", "E213"]}  # fmt: skip
    assert found.fatigue == plan.Fatigue((3.0, 10.0))
    assert (found.run.workers, found.run.memory, found.run.retries) == (2, 1.5e9, 3)
    assert [Path(one).name for one in asset.records] == ["b1_20260301.csv", "b1_20260302.csv", "b1.csv"]
    assert asset.limits == {"F": (-10.0, 10.0), "M": (-5.0, 7.0)}
    assert asset.response == ("acc", "1")
    assert asset.reading == {"fs": 200.0, "units": {"acc": "g"}}
    assert asset.first == dt.datetime(2026, 3, 1, tzinfo=dt.UTC)
    assert asset.begins(asset.records[0]) == dt.datetime(2026, 3, 1, tzinfo=dt.UTC).timestamp()
    with pytest.raises(InputError, match="does not tell when the record begins"):
        asset.begins(asset.records[2])


def test_the_command_line_goes_first(folder: Path) -> None:
    read(folder, GOOD)
    assert plan.read(folder / "plan.toml", workers=7).run.workers == 7
    assert plan.read(folder / "plan.toml", workers=None).run.workers == 2


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('output = "out"', "", "'output' is missing"),
        ('choice = "gcv"', 'choise = "gcv"', r"\[job\]: there is no such key.*'choise'.*did you mean 'choice'"),
        ('choice = "gcv"', 'choice = "gvc"', r"\[job\].*gvc.*is no rule"),
        ('choice = "gcv"', 'family = "frequency"', r"\[job\], family.*deconvolution or sparse"),
        ('penalty = "first_difference"', 'leak = 2', "leak"),
        ("fs = 100", "fs = -1", "sampling frequency"),
        ("limits = { F = 10.0,", "limts = { F = 10.0,", "did you mean 'limits'"),
        ("limits = { F = 10.0,", "limits = { F = -1,", "limits, F"),
        ("exponents = [3, 10]", 'exponents = ["a"]', r"\[fatigue\], exponents"),
        ("exponents = [3, 10]", "exponent = [3]", "did you mean 'exponents'"),
        ('memory = "1.5 GB"', 'memory = "lots"', r"\[run\], memory.*2 GB"),
        ("workers = 2", "workers = 0", r"\[run\], workers"),
        ("workers = 2", "workrs = 2", "did you mean 'workers'"),
        ('model = "{name}.h5"', 'model = "no.h5"', r"no such model.*no\.h5"),
        ('records = ["{name}_*.csv",', 'records = ["{name}_?.csv",', r"no record is there.*b1_\?\.csv"),
        ('records = ["{name}_*.csv",', 'records = ["missing.csv",', r"no record is there.*missing\.csv"),
        ('start = "{name}_%Y%m%d.csv"', "", "range of dates needs to know"),
        ("from = 2026-03-01", 'from = "yesterday"', "a date or a time"),
        ("[[asset]]", "[asset]", "no asset"),
        ('name = "b1"', "name = 3", "name of"),
        ('name = "b1"', 'name = "b1"\nrecords = ["b1.h5"]\n[[asset]]\nname = "b1"', "two assets have one name"),
        ("[job]", "[job", "no TOML"),
        ("[job]", "jobs = 1\n[job]", "did you mean 'job'"),
    ],
)  # fmt: skip
def test_bad_plans(folder: Path, old: str, new: str, said: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError, match=said) as error:
        read(folder, GOOD.replace(old, new))
    assert "plan.toml" in str(error.value)
    assert "\n" not in error.value.command


def test_no_plan(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="plan cannot be read"):
        plan.read(tmp_path / "plan.toml")
