"""``loadid learn`` from a job to an answer, and ``loadid identify`` with a map in place of a model."""

import json
import logging
import signal
import subprocess
import sys

import numpy as np
import pytest

import loadid
from loadid import load_map
from loadid._learning.network.training import KIND
from loadid.cli import main
from structures.files import _storage as storage

from .made import DT, SAMPLES, chain, history_map, seen, slow

LOADS = f"""
dt = {DT}
samples = {SAMPLES}

[[load]]
kind = "random"
level = [0.5, 2.0]
frequency = [0.5, 10.0]

[model]
stiffness = [0.99, 1.01]

[sensors]
relative = [0.01, 0.01]
"""
JOB = """
model = "chain.h5"
set = "{name}"
draws = 120
seed = {seed}
workers = 1
declaration = "loads.toml"

[map]
engine = "linear"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two jobs, their sets, and the map of the first."""
    place = tmp_path_factory.mktemp("learned")
    chain().save(place / "chain.h5")
    (place / "loads.toml").write_text(LOADS)
    for seed, name in enumerate(("training", "other")):
        (place / f"{name}.toml").write_text(JOB.format(name=name, seed=seed))
        assert main(["learn", "generate", str(place / f"{name}.toml")]) == 0
    assert main(["learn", "fit", str(place / "training.toml"), "-o", str(place / "map.h5")]) == 0
    history_map().save(place / "own.h5")
    rng = np.random.default_rng(1)
    for name, load in (("log", slow(rng)), ("strange", np.sin(2 * np.pi * 40 * DT * np.arange(SAMPLES)))):
        rows = np.column_stack([np.arange(SAMPLES) * DT, seen(load, rng)])
        head = "time [s],a1 [m/s^2],a3 [m/s^2],u2 [m]"
        np.savetxt(place / f"{name}.csv", rows, delimiter=",", header=head, comments="", fmt="%.17g")
    return place


def test_a_map_is_checked_on_a_set_of_another_seed(folder, capsys):
    assert main(["learn", "check", str(folder / "map.h5"), str(folder / "other"), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert row["draws"] == 120
    assert row["error"] < 0.5  # starts of records included
    assert 0.92 <= row["coverage"] <= 0.98
    assert row["alarms"] <= 0.03
    assert main(["learn", "check", str(folder / "map.h5"), str(folder / "other"), "--draws", "5"]) == 0
    assert "coverage promised: 0.95" in capsys.readouterr().out


KILLED = """
import os, signal, sys
from loadid._learning.network import engine, training
from loadid.cli import main

keep, brief = training._keep, engine.Schedule(epochs=2)

def killed(path, name, state):
    keep(path, name, state)
    if state.epoch == 1:
        os.kill(os.getpid(), signal.SIGKILL)

training._keep, engine.Schedule = killed, lambda: brief
main(sys.argv[1:])
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_a_killed_training_goes_on_when_the_command_is_run_again(folder, tmp_path, monkeypatch, caplog, capsys):
    """It is killed behind its first epoch of two: the second alone is left. Settings that were changed are refused."""
    pytest.importorskip("torch")
    from loadid._learning.network import engine

    brief, longer = engine.Schedule(epochs=2), engine.Schedule(epochs=3)
    monkeypatch.setattr(engine, "Schedule", lambda: brief)
    job, kept = folder / "network.toml", tmp_path / "map.training.h5"
    told = JOB.format(name="brief", seed=2).replace('"loads.toml"', '"brief_loads.toml"').replace("120", "100")
    job.write_text(told.replace('"linear"', '"torch"'))
    (folder / "brief_loads.toml").write_text(LOADS.replace(f"samples = {SAMPLES}", "samples = 100"))
    assert main(["learn", "generate", str(job)]) == 0
    words = ["learn", "fit", str(job), "-o", str(tmp_path / "map.h5")]
    assert subprocess.run([sys.executable, "-c", KILLED, *words], check=False).returncode == -signal.SIGKILL
    assert [p.name for p in tmp_path.iterdir()] == [kept.name]
    first = storage.read(kept, KIND)["losses"]
    with monkeypatch.context() as edited:
        edited.setattr(engine, "Schedule", lambda: longer)
        assert main(words) == 3
    assert "a checkpoint of another training" in capsys.readouterr().err
    np.testing.assert_array_equal(storage.read(kept, KIND)["losses"], first)
    with caplog.at_level(logging.INFO, "loadid._learning.network.training"):
        assert main(words) == 0
    assert [record.args[0] for record in caplog.records] == [2]
    losses = load_map(tmp_path / "map.h5").engine.losses
    assert len(losses) == 2
    np.testing.assert_array_equal(losses[:1], first)
    assert not kept.exists()


def test_a_map_is_not_checked_on_what_it_was_learned_from(folder, capsys):
    assert main(["learn", "check", str(folder / "map.h5"), str(folder / "training")]) == 3
    assert "learned from this set" in capsys.readouterr().err


@pytest.mark.parametrize(("log", "who"), [("log", "learned map"), ("strange", "physics")])
def test_a_log_is_answered(folder, tmp_path, capsys, log, who):
    learned, given = str(folder / "own.h5"), str(folder / f"{log}.csv")
    main(["learn", "run", learned, given, "-o", str(tmp_path / "a.h5"), "--report", str(tmp_path / "a.html")])
    main(["identify", given, "--model", learned, "-o", str(tmp_path / "b.h5")])
    a, b = loadid.load(tmp_path / "a.h5"), loadid.load(tmp_path / "b.h5")
    np.testing.assert_array_equal(a.load, b.load)
    assert a.facts.answered_by == b.facts.answered_by == who
    assert ("W609" in a.codes) == (who == "physics")
    assert ("W609" in (tmp_path / "a.html").read_text("utf-8")) == (who == "physics")
    assert "W609" in capsys.readouterr().out or who != "physics"


@pytest.mark.parametrize(("words", "told"), [
    (["identify", "log.csv", "--model", "own.h5", "-o", "x.h5", "--noise", "0.1"], "a learned map has its settings"),
    (["learn", "fit", "nothing.toml", "-o", "x.h5"], "cannot be read"),
    (["learn", "check", "chain.h5", "other"], "another kind of file"),
    (["learn", "check", "map.h5", "nowhere"], "found"),
])  # fmt: skip
def test_mistakes_are_refused(folder, monkeypatch, capsys, words, told):
    monkeypatch.chdir(folder)
    assert main(words) == 3
    assert told in capsys.readouterr().err
    assert not (folder / "x.h5").exists()


def test_actions_say_what_they_need(capsys):
    assert main(["learn", "fit", "job.toml"]) == 2
    assert "needs -o" in capsys.readouterr().err


def test_wrong_keys_of_a_job_are_named(folder, tmp_path, capsys):
    (tmp_path / "job.toml").write_text('modle = "chain.h5"\n')
    assert main(["learn", "fit", str(tmp_path / "job.toml"), "-o", str(tmp_path / "x.h5")]) == 3
    assert "did you mean 'model'" in capsys.readouterr().err
