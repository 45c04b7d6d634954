"""``loadid modes``: from FRFs and from logs to a table, a picture and a model that the other commands take."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loadid import cli
from structures import FrfModel
from structures.files._modelfile import load_model
from tests.structures.test_modes import INSIDE, F, Z, table


@pytest.fixture(scope="module")
def folder(tmp_path_factory: Any) -> Path:
    where = tmp_path_factory.mktemp("modes")
    data = table(0.003, count=1)
    data.save(where / "frf.h5")
    bare = FrfModel(
        data.frequencies, data.H[:, 1:], sensors=data.sensors[1:], loads=data.loads, variance=data.variance[:, 1:]
    )
    bare.save(where / "bare.h5")
    return where


@pytest.fixture
def run(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> Any:
    group = EntryPoints([EntryPoint("modes", "loadid._commands.modes:command", cli.GROUP)])
    monkeypatch.setattr(cli, "entry_points", lambda group=None, found=group: found)
    monkeypatch.chdir(folder)

    def call(words: str) -> tuple[int, str, str]:
        code = cli.main(["modes", *words.split()])
        out = capsys.readouterr()
        return code, out.out, out.err

    return call


def test_frfs_to_a_table_a_picture_and_a_model(run: Any, folder: Path) -> None:
    code, out, err = run("frf.h5 --json -o model.h5 --plot picture.png")
    assert code == 0, err
    data = json.loads(out)
    np.testing.assert_allclose([m["frequency"] for m in data["modes"]], F[:INSIDE], rtol=1e-3)
    np.testing.assert_allclose([m["damping"] for m in data["modes"]], Z[:INSIDE], rtol=0.05)
    assert data["scaled"]
    assert all(m["modal_mass"] > 0 for m in data["modes"])
    assert data["written"] == ["model.h5", "picture.png"]
    assert (folder / "picture.png").read_bytes()[:4] == b"\x89PNG"
    model = load_model(folder / "model.h5")
    np.testing.assert_allclose(model.natural_frequencies, [m["frequency"] for m in data["modes"]])


def test_what_people_read(run: Any) -> None:
    code, out, _ = run("bare.h5 --band 20:140")
    assert code == 0
    assert "5 modes in the band of 20 to 140 Hz; 4 sensors, 1 load\n" in out
    assert "no driven point" in out


def test_refusals(run: Any, folder: Path) -> None:
    for words, says in (
        ("frf.h5 --response a", "a response needs a force|without a force"),
        ("frf.h5 --driven a", "is not SENSOR,LOAD"),
        ("frf.h5 -o frf.h5", "reads"),
        ("frf.h5 --band 10:11", "too few lines"),
        ("none.h5", "none.h5"),
    ):
        code, _, err = run(words)
        assert code in (2, 3), words
        assert any(part in err for part in says.split("|")), (words, err)
