"""The page in a browser: what it says, stale marks, what was not done, and that it stands alone."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser import chromium

from .jobs import guide


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


def text_of(folder: Path) -> str:
    assert guide("page") == 0
    return re.sub(r"<style>.*?</style>|<script>.*?</script>", "", (folder / "wing.guide.html").read_text("utf-8"),
                  flags=re.S)  # fmt: skip


def test_a_finished_job_says_who_signed_what_on_which_files(wing: Path) -> None:
    from loadid._guide.job import Guide

    page, ledger = text_of(wing), Guide.open("wing.toml").ledger
    assert "10 of 10" in page
    assert "All ten steps are signed" in page
    assert ledger.seal in page
    for one in ledger.signatures:
        assert one.checksum in page
        for digest in [*one.files.values(), *one.evidence.values()]:
            assert digest in page
    assert page.count("signed by A. Engineer on ") == 10
    assert "wing of &lt;b&gt;6 m&lt;/b&gt;" in page
    assert "<b>6 m</b>" not in page
    assert "LID-W105 note" in page
    assert "1 of 12 loads next to a support" in page
    assert "Signed with cautions" not in page  # notes are none


def test_stale_steps_and_what_was_not_done_are_named(begun: Path) -> None:
    page = text_of(begun)
    assert "The forward model is not verified" in page
    assert "0 of 10" in page
    assert page.count(" is locked. It needs: ") == 8


def test_a_change_is_written_at_the_head_by_name(wing: Path) -> None:
    (wing / "service.csv").write_text((wing / "service.csv").read_text().replace("g1,", "g1, "))
    page = text_of(wing)
    assert "Step 4 SVD, Picard and recoverable modes is stale: service.csv has changed since it was signed" in page
    assert "So are those after it: 5 physical constraints; 6 penalty; " in page  # each by name, the reason once
    assert "3 of 10" in page
    assert "must be signed again" in page


@pytest.mark.parametrize(("width", "dark"), [(1200, False), (320, False), (1200, True)])
def test_it_stands_alone_and_fits_the_screen(wing: Path, browser: Any, width: int, dark: bool) -> None:
    assert guide("page") == 0
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light")
    page, said, asked = context.new_page(), [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("request", lambda request: asked.append(request.url))
    page.goto((wing / "wing.guide.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator("h2", has_text=re.compile(r"^Step \d")).count() == 10
    assert page.locator("svg.plot").count() == 1
    assert said == []
    assert asked == [(wing / "wing.guide.html").as_uri()]
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    found = axe.Axe().run(page).response["violations"]
    assert [one["id"] for one in found if one["impact"] in ("serious", "critical")] == []
    context.close()
