"""Pages of Start, Concepts and of pools of processes run, and what they find is the truth behind their data."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from loadid import datasets
from tests import blocks
from tests.ran import Ran, ran

START = ("impact", "sources", "online", "static", "gel")
CONCEPTS = ("data", "lambda", "priors", "bands")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory):
    """A page by its name, run once."""
    return cache(lambda name: ran(f"docs/{name}.md", tmp_path_factory.mktemp(Path(name).name)))


@pytest.mark.parametrize("name", [*(f"start/{n}" for n in START), *(f"concepts/{n}" for n in CONCEPTS), "parallel"])
def test_every_block_takes_little(page, name):
    found: Ran = page(name)
    assert found.took
    assert max(found.took.values()) < blocks.LIMIT, found.took


@pytest.mark.parametrize("name", CONCEPTS)
def test_what_a_page_prints_stands_on_it(page, name):
    """Below each block of Python that prints stands what it prints."""
    text = (blocks.ROOT / "docs" / "concepts" / f"{name}.md").read_text("utf-8")
    shown = re.findall(r"```python\n(.*?)```\n\n```text\n(.*?)```", text, re.DOTALL)
    printed = {block.text: said for block, _, said, _ in page(f"concepts/{name}").answers}
    assert shown
    assert all(printed[code] == said for code, said in shown), printed
    assert sum(bool(said) for said in printed.values()) == len(shown)


@pytest.mark.parametrize("name", START)
def test_pictures_that_a_page_shows_are_there_and_are_made_by_it(name):
    from docs.making.pictures import MADE

    text = (blocks.ROOT / "docs" / "start" / f"{name}.md").read_text("utf-8")
    assert set(re.findall(r"\]\((\w+\.png)\)", text)) == set(MADE[name])


def test_the_hammer_test(page):
    page("start/impact").finds_the_unknown_hit("loadid identify")


def test_the_hit_of_200_newtons(page):
    page("start/impact").finds_the_hit_of_200_newtons()


def test_other_priors_and_places(page):
    scope, said = page("start/impact").after("recommend(model, record")
    for name in ("push", "hits"):
        assert abs(scope[name].peaks[0].value - 200) < 0.15 * 200, name
    assert scope["push"].load.min() >= 0
    assert "SparseDeconvolution: the load looks impulsive" in said
    assert "place" in scope["place"].summary()


def test_sources(page):
    """A random force on a beam: its power comes back, the sensor that was kept out is predicted."""
    from structures import cross_spectra

    scope, said = page("start/sources").after("FrequencyInversion(model")
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
    assert page("start/sources").size("sources.png") > 10_000


def test_online(page):
    """A gusty load on a mast, simulated finer, is followed within its band from a saved commissioning record on."""
    found = page("start/online")
    scope, said = found.after("tracker.step")
    force = datasets.mast_wind().load
    assert abs(scope["load"].item() - force[-1].item()) < 4 * scope["std"].item()
    assert "NIS per channel" in said
    assert found.size("mast.h5") > 1000
    assert found.size("wind.html") > 10_000
    today = found.after("whole.track")[0]["today"]
    assert np.linalg.norm(today.load - force[3000:]) < 0.1 * np.linalg.norm(force[3000:])


@pytest.mark.parametrize("table", ["loads.csv", "wind.csv"])
def test_the_tracking_commands(page, table):
    force = datasets.mast_wind().load[3000:]
    found = np.loadtxt(page("start/online").folder / table, delimiter=",", skiprows=1)
    off = (found[200:, 1] - force[200:, 0]) / found[200:, 2]
    assert np.mean(np.abs(off) < 1.96) > 0.85
    assert np.linalg.norm(found[200:, 1] - force[200:, 0]) < 0.1 * np.linalg.norm(force[200:])


def test_static(page):
    """The lift of a wing on a finer mesh comes back: its moment within 3 %, its distribution within its band."""
    scope, said = page("start/static").after("StaticInversion(")
    found, places = scope["lift"], np.linspace(0, 6, 121)
    lift = 900 * np.sqrt(np.maximum(1 - (places / 6) ** 2, 0.0))
    moment = next(r.value for r in found.resultants if r.name == "M")
    assert abs(moment / np.trapezoid(lift * places, places) - 1) < 0.03
    assert np.mean(np.abs(found.load - datasets.wing_strains().load) < 2 * found.std) > 0.8
    assert "M " in said
    assert page("start/static").size("picard.png") > 10_000


def test_static_from_the_shell_is_the_same_load(page):
    import loadid

    found = page("start/static")
    lift, shell = found.after("StaticInversion(")[0]["lift"], loadid.load(found.folder / "lift.h5")
    np.testing.assert_allclose(shell.load.ravel(), lift.load, rtol=1e-3, atol=1e-3 * np.abs(lift.load).max())


def test_gel(page):
    """A press of 1 N with 0.25 N of shear, photographed, comes back within 5 %."""
    scope, said = page("start/gel").after("MultilayerPad(")
    force = scope["force"]
    assert np.allclose(force.resultant().value, [0.25, 0.0, -1.0], atol=0.05)
    assert abs(force.contact().radius / 2.2e-3 - 1) < 0.1
    assert "N" in said
    assert page("start/gel").size("map.h5") > 10_000


def test_pools(page):
    scope, _ = page("parallel").after("Parallel(")
    assert [round(e.peaks[0].value, -1) for e in scope["estimates"]] == pytest.approx([200] * 4, rel=0.1)
