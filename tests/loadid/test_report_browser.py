"""The report in a real browser: a phone, the dark, the printer; charts zoom, tell what is pointed at, and are saved."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from loadid._results.report import page
from tests.browser import chromium
from tests.loadid.made import half_sine, impact


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    path: Path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(page(impact(), truth=half_sine()[1]), "utf-8")
    return path.as_uri()


def opened(browser: Any, address: str, **settings: Any) -> tuple[Any, list[str]]:
    """The page, and what went wrong or was asked for from elsewhere."""
    wrong: list[str] = []
    shown = browser.new_context(**settings).new_page()
    shown.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else None)
    shown.on("pageerror", lambda e: wrong.append(str(e)))
    shown.on("request", lambda r: wrong.append(r.url) if r.url not in (address,) and r.url[:5] == "http:" else None)
    shown.goto(address)
    return shown, wrong


def test_a_phone_in_the_dark(browser: Any, address: str) -> None:
    shown, wrong = opened(browser, address, viewport={"width": 320, "height": 640}, color_scheme="dark")
    shown.evaluate("for (const part of document.querySelectorAll('details')) part.open = true")
    assert shown.evaluate("document.documentElement.scrollWidth") <= 320
    ink, paper = shown.evaluate(
        "[getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
    )
    light, dark = (sum(map(int, re.findall(r"\d+", text)[:3])) for text in (ink, paper))
    assert light > 500 > 200 > dark
    assert wrong == []


def test_charts_zoom_and_say_what_is_under_the_pointer(browser: Any, address: str) -> None:
    shown, wrong = opened(browser, address, viewport={"width": 1000, "height": 900})
    plot = shown.locator("svg.plot").first
    plot.scroll_into_view_if_needed()
    box, before = plot.bounding_box(), shown.locator("figure.chart").first.inner_text()
    shown.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"])
    over = shown.locator("figure.chart").first.inner_text()
    assert over != before
    shown.mouse.down()
    shown.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.5 * box["height"], steps=4)
    shown.mouse.up()
    shown.mouse.move(5, 5)
    zoomed = shown.locator("figure.chart").first.inner_text()
    assert zoomed != before
    shown.mouse.dblclick(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    shown.mouse.move(5, 5)
    assert shown.locator("figure.chart").first.inner_text() != zoomed  # the whole axis
    figure = shown.locator("figure.chart").first
    figure.locator("button[title='show what is around the peak']").click()
    shown.mouse.move(5, 5)
    assert figure.inner_text() == before
    for name, begin in (("SVG", b"<svg"), ("CSV", b"time")):
        with shown.expect_download() as saved:
            figure.locator("button", has_text=name).click()
        assert begin in Path(saved.value.path()).read_bytes()[:200]
    assert wrong == []


def test_it_prints_whole_on_paper(browser: Any, address: str) -> None:
    """On light paper whatever the screen is, with what is folded."""
    shown, wrong = opened(browser, address, color_scheme="dark")
    data = shown.pdf(format="A4")
    assert data.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", data)) >= 2
    shown.emulate_media(media="print")
    paper = shown.evaluate("getComputedStyle(document.body).backgroundColor")
    ink = shown.evaluate("getComputedStyle(document.body).color")
    assert sum(map(int, re.findall(r"\d+", ink)[:3])) < 300
    assert paper == "rgba(0, 0, 0, 0)" or sum(map(int, re.findall(r"\d+", paper)[:3])) > 700
    assert wrong == []
