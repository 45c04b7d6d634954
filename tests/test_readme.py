"""The README runs from top to bottom in an empty folder, and what its examples find is the truth behind their data."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests import blocks
from tests.ran import Ran, ran

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return ran("README.md", tmp_path_factory.mktemp("readme"))


def test_every_block_takes_little(page: Ran):
    assert len(page.took) >= 2
    assert max(page.took.values()) < blocks.LIMIT, page.took


def test_the_commands_find_the_unknown_hit(page: Ran):
    page.finds_the_unknown_hit("loadid calibrate")


def test_the_python_example(page: Ran):
    page.finds_the_hit_of_200_newtons()


def test_it_is_short(page: Ran):
    """One screen and a half."""
    assert len(README.splitlines()) <= 90


def test_the_two_commands_stand_on_their_own_lines():
    lines = [line.strip() for line in README.splitlines()]
    assert "python -m pip install -e . && loadid demo" in lines
    assert 'python -m pip install -e ".[test]" && python -m pytest' in lines


def test_links_and_pictures_exist():
    root = Path(__file__).resolve().parents[1]
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (root / target).exists(), target
