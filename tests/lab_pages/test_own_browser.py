"""The pages of the gel pad and of one's own data in a real browser: keyboard, narrow, dark, and for screen readers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from loadid import Deconvolution, datasets
from loadid._lab.own import page_of
from loadid._lab.server import Lab
from tactile._lab.gelpad import page as gelpad
from tests.browser import chromium

from .asked import drawn, opened, serious, until

WIDTH = "document.documentElement.scrollWidth"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def lab() -> Iterator[Lab]:
    with Lab([gelpad, page_of()]) as found:
        yield found


def written(page: Any, place: str) -> str:
    return str(page.inner_text(place))


def test_the_gel_pad_by_keyboard_alone(browser: Any, lab: Lab) -> None:
    with opened(browser, lab.page("gelpad")) as page:
        until(page, 1)
        right = written(page, "#numbers")
        assert "1.8" in right
        page.keyboard.press("Tab")  # the link to the page, then the pages, then the first switch
        for _ in range(20):
            if page.evaluate("document.activeElement.name") == "naive":
                break
            page.keyboard.press("Tab")
        page.keyboard.press("Space")
        until(page, 2)
        assert written(page, "#numbers") != right
        assert "W112" in written(page, "#flags")
        for _ in range(10):
            if page.evaluate("document.activeElement.name") == "noise":
                break
            page.keyboard.press("Tab")
        count = drawn(page)
        page.keyboard.press("ArrowRight")
        until(page, count + 1)
        for _ in range(3):
            if page.evaluate("document.activeElement.id") == "right":
                break
            page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        until(page, count + 2)
        assert written(page, "#numbers") == right
        assert page.wrong == []


@pytest.mark.parametrize(("width", "dark"), [(1200, False), (320, True)])
def test_the_gel_pad_narrow_dark_and_read_aloud(browser: Any, lab: Lab, width: int, dark: bool) -> None:
    with opened(browser, lab.page("gelpad"), width=width, dark=dark) as page:
        until(page, 1)
        assert page.evaluate(WIDTH) <= width
        assert serious(page) == []
        names = page.eval_on_selector_all(
            "figure svg[role=img]", "all => all.map(one => one.getAttribute('aria-label'))"
        )
        assert len(names) >= 12
        assert all(names)
        assert page.wrong == []


def test_own_data_from_two_files_to_a_saved_estimate(browser: Any, lab: Lab, tmp_path: Path) -> None:
    hit = datasets.impact(tmp_path)
    hit.model.save(tmp_path / "beam.h5")
    with opened(browser, lab.page("own"), width=320, dark=True) as page:
        page.wait_for_selector("html[data-ready]", state="attached")
        assert serious(page) == []
        page.set_input_files("#logfile", [])
        page.set_input_files("#modelfile", {"name": "beam.h5", "mimeType": "x/y", "buffer": b"no model"})
        page.wait_for_selector("#fault:not([hidden])")
        assert "beam.h5" in written(page, "#fault")
        page.wrong.clear()  # the browser itself logs a refusal
        page.set_input_files("#modelfile", str(tmp_path / "beam.h5"))
        page.wait_for_selector("#reading:not([disabled])")
        assert page.is_hidden("#fault")
        page.set_input_files("#logfile", str(tmp_path / "log.csv"))
        page.wait_for_selector("#asking:not([disabled])")
        page.focus("#identify")
        page.keyboard.press("Enter")
        until(page, 1)
        found = written(page, "#numbers")
        assert "205" in found
        page.focus("#lam")
        count = drawn(page)
        page.keyboard.press("ArrowRight")
        until(page, count + 1)
        assert written(page, "#numbers") != found
        page.wait_for_timeout(400)  # what is said of it comes when the slider rests
        page.focus("#save")
        with page.expect_download() as kept:
            page.keyboard.press("Enter")
        assert kept.value.suggested_filename == "load.h5"
        assert page.evaluate(WIDTH) <= 320
        assert serious(page) == []
        page.focus("#back")
        page.keyboard.press("Enter")
        until(page, count + 2)
        assert written(page, "#numbers") == found
        assert page.wrong == []


def test_an_estimate_that_explores_itself(browser: Any) -> None:
    hit = datasets.impact()
    estimate = Deconvolution(hit.model).estimate(hit.record)
    with estimate.explore(browser=False) as shown, opened(browser, shown.address) as page:
        until(page, 1)
        assert page.is_hidden("#files")
        assert f"{estimate.peaks[0].value:.1f}" in written(page, "#numbers")
        assert serious(page) == []
        assert page.wrong == []
