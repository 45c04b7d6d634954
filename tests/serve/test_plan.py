"""Plans of `loadid serve`: what they may say, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from loadid._serve import plan
from structures.errors import InputError

GOOD = """
states = "states"
[run]
latency = 0.05
http = 0
[every]
model = "{name}.h5"
source = "mqtt://me:secret@broker/shm/{name}"
sinks = ["loads/{name}.csv", "kafka://127.0.0.1/loads-{name}"]
unit = { top = "g" }
[[asset]]
name = "mast"
[[asset]]
name = "roof"
source = "tcp://[::1]:5000"
"""


def written(folder: Path, text: str) -> Path:
    for name in ("mast", "roof"):
        (folder / f"{name}.h5").touch()
    (folder / "plan.toml").write_text(text)
    return folder / "plan.toml"


def test_a_plan_is_read(tmp_path: Path) -> None:
    found = plan.read(written(tmp_path, GOOD))
    mast, roof = found.assets
    assert (mast.source.host, mast.source.port, mast.source.path) == ("broker", 1883, "shm/mast")
    assert (mast.source.user, mast.source.password) == ("me", "secret")
    assert "secret" not in f"{mast.source} {mast.source!r}"
    assert (roof.source.scheme, roof.source.host, roof.source.port) == ("tcp", "::1", 5000)
    assert mast.sinks[0].path == str(tmp_path / "loads" / "mast.csv")
    assert (mast.sinks[1].port, mast.sinks[1].path) == (9092, "loads-mast")
    assert dict(mast.unit) == {"top": "g"}
    assert (found.run.latency, found.run.checkpoint, found.run.http) == (0.05, 60.0, 0)
    assert found.state(mast) == tmp_path / "states" / "mast.h5"


def test_a_password_may_stand_in_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(plan.SECRET, "hidden")
    found = plan.read(written(tmp_path, GOOD.replace("me:secret@", "me@")))
    assert found.assets[0].source.password == "hidden"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("latency", "latencey", "did you mean 'latency'"),
        ("[[asset]]", "[[assets]]", "did you mean 'asset'"),
        ("source = \"mqtt", "sources = \"mqtt", "did you mean 'source'"),
        ("0.05", "0", "from 0.001 to 60"),
        ("http = 0", "http = 99999", "below 65536"),
        ('name = "roof"', 'name = "mast"', "two assets have one name"),
        ('name = "roof"', 'name = "../roof"', "a name that a file can have"),
        ('model = "{name}.h5"', 'model = "no.h5"', "no such model"),
        ("/shm/{name}", "", "with the topic of this asset"),
        ("/shm/{name}", "/shm/#", "without wildcards"),
        ("mqtt://me", "http://me", "a path, tcp://HOST:PORT"),
        ("tcp://[::1]:5000", "tcp://127.0.0.1", "tcp://HOST:PORT"),
        ("tcp://[::1]:5000", "tcp://127.0.0.1:99999", "tcp://HOST:PORT"),
        ("loads/{name}.csv", "loads/{name}.xls", ".csv, .parquet, .h5"),
        ('"loads/{name}.csv", ', "", "no table on the disk"),
        ("loads/{name}.csv", "loads/all.csv", "two assets share a place"),
        ('{ top = "g" }', "{ top = 3 }", "a unit such as"),
        ("states = ", "states = [", "no TOML"),
    ],
)  # fmt: skip
def test_what_is_no_plan_is_refused_by_its_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError) as refused:
        plan.read(written(tmp_path, GOOD.replace(old, new)))
    assert words in str(refused.value)
    assert "secret" not in str(refused.value)


def test_a_plan_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        plan.read(tmp_path / "no.toml")
