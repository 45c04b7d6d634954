"""The README runs from top to bottom in an empty folder, and what its examples find is the truth behind their data."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from loadid import datasets
from tests import blocks

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Folder, and of every block its text, the names that it left, what it printed and its CPU seconds."""
    folder, scope, answers = tmp_path_factory.mktemp("readme"), {}, []
    before = Path.cwd()
    os.chdir(folder)
    try:
        for block in blocks.blocks("README.md"):
            if block.runs:
                said, seconds = blocks.run(block, scope)
                answers.append((block, dict(scope), said, seconds))
    finally:
        os.chdir(before)
    return folder, answers


@pytest.fixture
def after(ran, monkeypatch):
    """The names, and what was printed, after the block that holds a text; in the folder that it ran in."""
    monkeypatch.chdir(ran[0])

    def found(text):
        ((_, scope, said, _),) = [answer for answer in ran[1] if text in answer[0].text]
        return scope, said

    return found


def test_every_block_takes_little(ran):
    took = {str(block): round(seconds, 1) for block, *_, seconds in ran[1]}
    assert len(took) >= 8
    assert max(took.values()) < blocks.LIMIT, took


def test_the_commands_find_the_unknown_hit(after):
    _, said = after("loadid calibrate")
    truth = datasets.hammer_test().load
    import loadid

    found = loadid.load("result.h5")
    assert abs(found.peaks[0].value / truth.max() - 1) < 0.05
    assert np.linalg.norm(found.load - truth) < 0.1 * np.linalg.norm(truth)
    assert "grade" in said
    assert Path("result.html").stat().st_size > 10_000


def test_the_python_example(after):
    """A hit of 200 N, simulated with a finer mesh, comes back within its band."""
    scope, said = after("estimate.report")
    estimate, loud = scope["estimate"], datasets.impact().load[:, 0]
    peak = estimate.peaks[0]
    assert abs(peak.value - 200) < 0.1 * 200
    assert abs(peak.value - 200) < 3 * peak.std
    assert "model not verified" in said
    assert "grade A" in said
    assert np.linalg.norm(estimate.load[:, 0] - loud) < 0.1 * np.linalg.norm(loud)
    assert Path("impact.html").stat().st_size > 10_000


def test_other_priors_and_places(after):
    scope, said = after("recommend(model, record")
    for name in ("push", "hits"):
        assert abs(scope[name].peaks[0].value - 200) < 0.15 * 200, name
    assert scope["push"].load.min() >= 0
    assert "SparseDeconvolution: the load looks impulsive" in said
    assert "place" in scope["place"].summary()


def test_the_frequency_example(after):
    """A random force on a beam: its power comes back, the sensor that was kept out is predicted."""
    from structures import cross_spectra

    scope, said = after("FrequencyInversion(model")
    found = scope["sources"]
    inside = (found.axis.values > 20) & (found.axis.values < 200)
    known = cross_spectra(datasets.beam_sources().load, 1 / 1024, segment=2048)
    truth = np.interp(found.axis.values, known.frequencies, known.autospectra[:, 0])
    assert abs(found.load[inside].sum() / truth[inside].sum() - 1) < 0.05
    assert "LID-W412" not in found.codes
    assert found.facts["held_out"][0].startswith("14+Z")
    assert "peak 13+Z" in said
    assert "not tell" in found.summary(details=True)
    assert found.grade.letter < "D"
    assert Path("sources.png").stat().st_size > 10_000


def test_the_tracking_example(after):
    """A gusty load on a mast, simulated finer, is followed within its band from a saved commissioning record on."""
    scope, said = after("LoadTracker(model)")
    force = datasets.mast_wind().load
    assert abs(scope["load"].item() - force[-1].item()) < 4 * scope["std"].item()
    assert "NIS per channel" in said
    assert Path("mast.h5").stat().st_size > 1000
    _the_tracking_commands(scope, force[3000:])


def _the_tracking_commands(scope, force):
    """The two command lines below the example, on the files of the example."""
    from loadid import cli

    saving, *others = re.findall(r"`(model\.save\([^`]*\))`", README)
    assert not others
    exec(saving, {"model": scope["model"]})
    commands = [line.split() for line in re.findall(r"`loadid (track [^`]*)`", README)]
    assert len(commands) == 2
    for words in commands:
        assert cli.main([*words, "--idle", "0"]) == 0
        table = np.loadtxt(words[words.index("--out") + 1], delimiter=",", skiprows=1)
        off = (table[200:, 1] - force[200:, 0]) / table[200:, 2]
        assert np.mean(np.abs(off) < 1.96) > 0.85
        assert np.linalg.norm(table[200:, 1] - force[200:, 0]) < 0.1 * np.linalg.norm(force[200:])


def test_the_static_example(after):
    """The lift of a wing on a finer mesh comes back: its moment within 3 %, its distribution within its band."""
    scope, said = after("StaticInversion(")
    found, places = scope["lift"], np.linspace(0, 6, 121)
    lift = 900 * np.sqrt(np.maximum(1 - (places / 6) ** 2, 0.0))
    moment = next(r.value for r in found.resultants if r.name == "M")
    assert abs(moment / np.trapezoid(lift * places, places) - 1) < 0.03
    assert np.mean(np.abs(found.load - datasets.wing_strains().load) < 2 * found.std) > 0.8
    assert "M " in said
    assert Path("picard.png").stat().st_size > 10_000


def test_the_tactile_example(after, capsys):
    """A press of 1 N with 0.25 N of shear, photographed, comes back within 5 %."""
    scope, said = after("MultilayerPad(")
    force = scope["force"]
    assert np.allclose(force.resultant().value, [0.25, 0.0, -1.0], atol=0.05)
    assert abs(force.contact().radius / 2.2e-3 - 1) < 0.1
    assert "N" in said
    assert Path("map.h5").stat().st_size > 10_000


def test_the_parallel_example(after):
    scope, _ = after("Parallel(")
    assert [round(e.peaks[0].value, -1) for e in scope["estimates"]] == pytest.approx([200] * 4, rel=0.1)


def test_the_two_commands_stand_on_their_own_lines():
    lines = [line.strip() for line in README.splitlines()]
    assert "python -m pip install -e . && loadid demo" in lines
    assert 'python -m pip install -e ".[test]" && python -m pytest' in lines


def test_links_and_pictures_exist():
    root = Path(__file__).resolve().parents[1]
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (root / target).exists(), target
