"""The pages of the gel pad and of one's own data in a real browser: keyboard, narrow, dark, and for screen readers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from loadid import Deconvolution, datasets

from .visited import Visit, wait

NARROW = {"viewport": {"width": 320, "height": 640}, "color_scheme": "dark"}


def test_the_gel_pad_by_keyboard_alone(visit: Callable[..., Visit]) -> None:
    found = visit("gelpad")
    page, right = found.page, found.text("#numbers")
    assert "1.83" in right
    found.tabbed("name === 'naive'")  # behind the link to the page, the pages, the first switch
    found.again(lambda: page.keyboard.press("Space"))
    assert found.text("#numbers") != right
    told = [found.text(f"#after{k}") for k in range(1, 7)]
    assert [("1.83" in one, "W112" in one) for one in told] == [(True, False)] + 5 * [(False, True)]
    assert "What to do" in told[1]  # where it is new
    assert "As after step 2: W112" in told[2]
    still = page.eval_on_selector_all("figure svg image", "all => all.map(one => one.getAttribute('href'))")
    found.tabbed("name === 'noise'")
    found.again(lambda: page.keyboard.press("End"))
    assert [found.text(f"#after{k}") for k in range(1, 6)] == told[:5]  # noise is that of step 6
    assert found.text("#after6") != told[5]
    now = page.eval_on_selector_all("figure svg image", "all => all.map(one => one.getAttribute('href'))")
    assert sum(a != b for a, b in zip(still, now, strict=True)) == 1
    found.tabbed("id === 'right'")
    found.again(lambda: page.keyboard.press("Enter"))
    assert found.text("#numbers") == right


def test_answers_at_every_noise_of_the_gel_pad_are_made_ahead(visit: Callable[..., Visit]) -> None:
    found = visit("gelpad")
    asked: list[str] = []
    found.page.on("request", lambda request: asked.append(request.url))
    wait(found.page, "document.documentElement.dataset.ahead !== undefined")
    assert 0 < len(asked) < 10
    asked.clear()
    found.page.focus("#noise")
    right = found.text("#after6")
    for _ in range(9):
        found.again(lambda: found.page.keyboard.press("ArrowRight"))
    assert asked == []
    assert found.text("#after6") != right
    assert found.bytes < 200_000


@pytest.mark.parametrize("settings", [{}, NARROW])
def test_the_gel_pad_narrow_dark_and_read_aloud(visit: Callable[..., Visit], settings: dict[str, Any]) -> None:
    found = visit("gelpad", **settings)
    assert found.width <= settings.get("viewport", {"width": 1200})["width"]
    assert found.serious() == []
    names = found.page.eval_on_selector_all("figure svg[role=img]", "all => all.map(one => one.ariaLabel)")
    assert len(names) >= 18
    assert all(names)


def test_own_data_from_two_files_to_a_saved_estimate(visit: Callable[..., Visit], tmp_path: Path) -> None:
    hit = datasets.impact(tmp_path)
    hit.model.save(tmp_path / "beam.h5")
    found = visit("own", "document.documentElement.dataset.ready !== undefined", **NARROW)
    page = found.page
    assert found.serious() == []
    page.set_input_files("#logfile", [])
    page.set_input_files("#modelfile", {"name": "beam.h5", "mimeType": "x/y", "buffer": b"no model"})
    page.wait_for_selector("#fault:not([hidden])")
    assert "beam.h5" in found.text("#fault")
    found.wrong.clear()  # the browser itself logs a refusal
    page.set_input_files("#modelfile", str(tmp_path / "beam.h5"))
    page.wait_for_selector("#reading:not([disabled])")
    assert page.is_hidden("#fault")
    page.set_input_files("#logfile", str(tmp_path / "log.csv"))
    page.wait_for_selector("#asking:not([disabled])")
    page.focus("#identify")
    found.again(lambda: page.keyboard.press("Enter"))
    numbers = found.text("#numbers")
    assert "205" in numbers
    page.focus("#lam")
    found.again(lambda: page.keyboard.press("ArrowRight"))
    assert found.text("#numbers") != numbers
    page.wait_for_timeout(400)  # what is said of it comes when the slider rests
    page.focus("#save")
    with page.expect_download() as kept:
        page.keyboard.press("Enter")
    assert kept.value.suggested_filename == "load.h5"
    assert found.width <= 320
    assert found.serious() == []
    page.focus("#back")
    found.again(lambda: page.keyboard.press("Enter"))
    assert found.text("#numbers") == numbers


def test_an_estimate_that_explores_itself_makes_pictures_ahead(visit: Callable[..., Visit]) -> None:
    hit = datasets.impact()
    estimate = Deconvolution(hit.model).estimate(hit.record)
    again, made = estimate.again, list[float]()
    assert again is not None
    assert again.quick is not None
    quick = again.quick

    def counted(lam: float) -> Any:
        made.append(lam)
        return quick(lam)

    with replace(estimate, again=replace(again, quick=counted)).explore(browser=False) as shown:
        found = visit(shown.address)
        assert found.page.is_hidden("#files")
        assert f"{estimate.peaks[0].value:.1f}" in found.text("#numbers")
        assert found.serious() == []
        wait(found.page, "document.documentElement.dataset.ahead !== undefined")
        stops = sorted(made)
        for _ in range(5):
            found.again(lambda: found.page.press("#lam", "ArrowLeft"))
        assert sorted(made) == stops
        assert 90 < len(set(stops)) == len(stops) < 100
        assert found.bytes < 130_000
        found.page.close()  # before its server ends: what it still asks would fail
