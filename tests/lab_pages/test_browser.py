"""The lab in a real browser: silent, offline, by keyboard alone, on a phone, in the dark, for a screen reader."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from typing import Any

import pytest

from loadid._lab.pages import pages
from loadid._lab.server import Lab

from .visited import READY, Visit, wait

OWN = ("contact", "lcurve", "cards")


# -- for everybody -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", OWN)
def test_a_page_fits_a_phone_and_the_dark(visit: Callable[..., Visit], name: str) -> None:
    found = visit(name, viewport={"width": 320, "height": 640}, color_scheme="dark", reduced_motion="reduce")
    assert found.width <= 320
    assert found.page.locator("#old").count() == 0
    ink, paper = found.page.evaluate(
        "[getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
    )
    light, dark = (sum(map(int, re.findall(r"\d+", text)[:3])) for text in (ink, paper))
    assert light > 500 > 200 > dark


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", OWN)
def test_axe_finds_nothing_serious(visit: Callable[..., Visit], name: str, scheme: str) -> None:
    found = visit(name, color_scheme=scheme)
    if name == "contact":
        found.page.click("[data-which='4']")
        found.page.wait_for_selector("#outcome:not([hidden])")
    elif name == "cards":
        found.page.click("#turn")
        found.page.wait_for_selector("#answer:not([hidden])")
    assert found.serious() == []


def test_the_list_of_pages_leads_to_each(visit: Callable[..., Visit]) -> None:
    found = visit("")
    for page in OWN:
        link = found.page.locator(f".pages a[href^='/{page}?']")
        assert link.count() == 1
    link.click()
    wait(found.page, READY)
    assert found.page.title().startswith("Flashcards")


def test_a_session_stays_below_300_kb(visit: Callable[..., Visit]) -> None:
    found = visit("contact")
    for _ in range(30):
        found.again(lambda: found.page.press("#lam", "ArrowLeft"))
    assert found.bytes < 300_000


# -- by keyboard alone -------------------------------------------------------------------------------------------------
def test_the_contact_page_by_keyboard(visit: Callable[..., Visit]) -> None:
    found = visit("contact")
    page, reached = found.page, []
    for _ in range(30):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.id || document.activeElement.textContent.trim()"))
        if page.evaluate("document.activeElement.dataset.which") == "5":
            break
    order = ["profile", "t", "spacing", "every", "occluded", "eta", "redraw", "method", "lam"]
    assert [one for one in reached if one in order] == order
    shown = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
    assert shown == "solid"
    page.keyboard.press("Enter")
    page.wait_for_selector("#outcome:not([hidden])")
    assert "71.5 % against 32.4 %" in found.text("#outcome")
    for _ in range(3):  # the steps that show it lie next: the third is at lambda = 1
        page.keyboard.press("Tab")
    found.again(lambda: page.keyboard.press("Enter"))
    wait(page, "document.querySelector('#errors dd').textContent.startsWith('71.5')")
    assert (found.number("error of the resultant"), found.number("error of the map")) == ("71.5 %", "32.4 %")


def test_a_slider_tells_its_value_and_moves_the_picture(visit: Callable[..., Visit]) -> None:
    found = visit("contact")
    before = found.page.get_attribute("#map svg[role=img] path.estimate", "d")
    found.again(lambda: found.page.press("#lam", "Home"))
    assert found.page.get_attribute("#lam", "aria-valuetext") == "1e−8"
    assert found.page.inner_text("output[for=lam]") == "1e−8"
    wait(found.page, "document.querySelector('#map .note').textContent.includes('leaves the picture')")
    assert found.page.get_attribute("#map svg[role=img] path.estimate", "d") != before
    wait(found.page, "document.querySelector('#said').textContent.includes('off, map')")


def test_what_leaves_a_picture_is_said_for_each_side(visit: Callable[..., Visit]) -> None:
    found = visit("contact")
    drawn = """async values => {
      const { plot } = await import("/lab.js"), figure = document.getElementById("map");
      plot(figure, { x: {}, y: { low: -1, high: 1 }, series: [{ x: values.map((_, i) => i), y: values }] });
      return figure.querySelector(".note").textContent;
    }"""
    both = "its largest value is 2, its smallest value is −5."
    for values, said in (
        ([0, -2, 1], "its smallest value is −2."),
        ([3, 4], "its largest value is 4."),
        ([-5, 2], both),
    ):
        assert found.page.evaluate(drawn, values) == f"The curve leaves the picture: {said}"
    assert found.page.evaluate(drawn, [0, 1, -1]) == ""


def test_the_l_curve_page_by_click_and_by_keyboard(visit: Callable[..., Visit]) -> None:
    found = visit("lcurve")
    page = found.page
    assert "σ₁ = 0.8146, σ₄₈ = 5.97e−7, condition number 1.36e6" in found.text("#singular")
    box = page.locator("#lplot svg[role=img]").bounding_box()
    found.again(lambda: page.mouse.click(box["x"] + 75, box["y"] + 30))
    assert float(page.input_value("#lam")) < -3
    page.focus("#jumps button")
    found.again(lambda: page.keyboard.press("Enter"))
    wait(page, "document.querySelector('output[for=lam]').textContent === '0.0309'")
    found.again(lambda: page.press("#correlated", "Space"))
    wait(page, "document.querySelector('#draws').textContent.includes('correlated noise')")
    assert re.search(r"GCV 1e−6 \(error 9\.\d+ times", found.text("#draws"))
    assert page.locator("#rules tr", has_text="oracle").count() == 1


def test_cards_are_kept_and_come_back(visit: Callable[..., Visit]) -> None:
    found = visit("cards")
    page = found.page
    first = found.text("#question")
    page.keyboard.press(" ")
    page.wait_for_selector("#answer:not([hidden])")
    assert "5.97" in found.text("#answer") or "6.0e-7" in found.text("#answer")
    page.keyboard.press("3")
    wait(page, f"document.querySelector('#question').textContent !== {json.dumps(first)}")
    page.keyboard.press(" ")
    page.wait_for_selector("#answer:not([hidden])")
    page.keyboard.press("1")
    kept = dict(
        card.split("~", 1) for card in page.evaluate("document.cookie").removeprefix("loadid-lab-cards=").split("!")
    )
    assert set(kept) == {"smoothing", "half-width"}
    days, _, due = kept["smoothing"].split("~")
    assert (days, kept["half-width"].split("~")[0]) == ("1", "0")
    assert int(due, 36) == pytest.approx((time.time() + 86400) / 60, abs=2)
    page.reload()
    wait(page, READY)
    assert found.number("due") == "52"
    with Lab(pages()) as other:  # started again, at another port
        again = found.context.new_page()
        again.goto(other.page("cards"))
        wait(again, READY)
        assert again.locator("dl.numbers dd").first.inner_text() == "52"
    page.evaluate("document.cookie = 'loadid-lab-cards=smoothing~1~2.5~1!bad~x; path=/cards'")  # due since 1970
    page.reload()
    wait(page, READY)
    assert found.number("due") == "53"
    page.select_option("#topic", "shortcut")
    assert found.number("cards") == "5"


def test_colour_is_not_the_only_carrier(visit: Callable[..., Visit]) -> None:
    found = visit("lcurve")
    marks = found.page.evaluate("""() => [...document.querySelectorAll('#lplot figcaption path')]
        .map(p => `${p.getAttribute('d')} ${getComputedStyle(p).strokeDasharray} ${p.classList.contains('solid')}`)""")
    assert len(marks) == 13
    assert len(set(marks)) == len(marks)
    for one, other in (("#load path.truth", "#load path.estimate"), ("#gcvplot path.other1", "#gcvplot path.truth")):
        dashes = {
            found.page.evaluate(f"getComputedStyle(document.querySelector('{s}')).strokeDasharray")
            for s in (one, other)
        }
        assert len(dashes) == 2


# -- when things go wrong ----------------------------------------------------------------------------------------------
def test_a_refusal_and_a_dead_server_are_told_on_the_page(browser: Any) -> None:
    lab = Lab(pages()).start()
    found = Visit(browser, lab.page("contact"))
    found.page.evaluate("document.querySelector('#t').max = 9; document.querySelector('#t').value = 9")
    found.again(lambda: found.page.dispatch_event("#t", "input"))  # or the rules, which follow the first picture
    wait(found.page, "document.querySelector('#fault').textContent.includes('out of range')")
    found.page.evaluate("document.querySelector('#t').value = 0.1")
    found.again(lambda: found.page.dispatch_event("#t", "input"))
    wait(found.page, "document.querySelector('#fault').hidden")
    lab.close()
    found.page.wait_for_timeout(100)
    found.again(lambda: found.page.press("#lam", "Home"))
    wait(found.page, "!document.querySelector('#fault').hidden")
    found.context.close()


def test_without_javascript_the_page_says_what_it_needs(served: Lab, browser: Any) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(served.page("contact"))
    assert "need JavaScript" in page.inner_text("noscript")
    context.close()


def test_a_browser_that_cannot_run_the_script_is_told_so(served: Lab, browser: Any) -> None:
    context = browser.new_context(reduced_motion="reduce")
    page = context.new_page()
    page.route("**/lab.js", lambda route: route.abort())
    page.goto(served.page("contact"))
    page.wait_for_selector("#old", state="visible", timeout=20_000)
    assert "2021 or later" in page.inner_text("#old")
    context.close()


def test_a_page_says_that_it_is_computing(served: Lab, browser: Any) -> None:
    """While an answer takes more than a moment, and no longer."""
    context = browser.new_context()
    page = context.new_page()
    held: list[Any] = []
    page.route("**/contact/picture", lambda route: held.append(route))
    page.goto(served.page("contact"))
    page.wait_for_selector("#working:has-text('computing')")
    held[0].continue_()
    wait(page, READY)
    wait(page, "document.getElementById('working').textContent === ''")
    context.close()
