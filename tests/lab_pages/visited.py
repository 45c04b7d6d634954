"""Pages of the lab in a browser, and what goes wrong on them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

READY = "document.documentElement.dataset.drawn >= 1"
SERIOUS = ("serious", "critical")
SIZES = ("responseBodySize", "responseHeadersSize", "requestBodySize", "requestHeadersSize")


def wait(page: Any, expression: str, seconds: float = 30) -> None:
    """Until it is true; asked from outside, as the policy of the page lets no text be run in it."""
    end = time.monotonic() + seconds
    while not page.evaluate(expression):
        assert time.monotonic() < end, expression
        time.sleep(0.01)


class Visit:
    """A page of the lab in a window, and what went wrong or over the wire meanwhile.

    `ready` is what to wait for, "" for nothing.
    """

    def __init__(self, browser: Any, address: str, ready: str = READY, **settings: Any) -> None:
        self.home, self.wrong, self.bytes = address.split("?")[0].rsplit("/", 1)[0], list[str](), 0
        self.context = browser.new_context(**{"viewport": {"width": 1200, "height": 900}, **settings})
        self.page = self.context.new_page()
        self.page.on("console", lambda m: self.wrong.append(m.text) if m.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda e: self.wrong.append(str(e)))
        self.page.on("request", self._asked)
        self.page.on("requestfinished", self._weighed)
        self.page.goto(address)
        if ready:
            wait(self.page, ready)

    def _asked(self, request: Any) -> None:
        if not request.url.startswith((self.home + "/", "data:", f"blob:{self.home}/")):
            self.wrong.append(f"asks {request.url}")

    def _weighed(self, request: Any) -> None:
        sizes = request.sizes() if request.url.startswith("http") else {}
        self.bytes += sum(sizes.get(k, 0) for k in SIZES)

    def again(self, action: Callable[[], Any]) -> None:
        """An action, and the picture after it."""
        before = self.page.evaluate("Number(document.documentElement.dataset.drawn ?? 0)")
        action()
        wait(self.page, f"document.documentElement.dataset.drawn > {before}")

    def tabbed(self, found: str, most: int = 30) -> None:
        """Press the tabulator until this is true of the element that has the focus."""
        for _ in range(most):
            if self.page.evaluate(f"document.activeElement.{found}"):
                return
            self.page.keyboard.press("Tab")
        raise AssertionError(f"no key reaches {found}")

    def text(self, selector: str) -> str:
        return str(self.page.inner_text(selector))

    def number(self, name: str) -> str:
        """Readout of that name."""
        return str(self.page.locator("dl.numbers > div", has_text=name).first.locator("dd").inner_text())

    @property
    def width(self) -> int:
        """How wide the page is, px."""
        return int(self.page.evaluate("document.documentElement.scrollWidth"))

    def serious(self) -> list[str]:
        """Serious violations that axe-core finds."""
        axe = pytest.importorskip("axe_playwright_python.sync_playwright")
        told = axe.Axe().run(self.page).response["violations"]
        return [f"{v['id']}: {[n['html'] for n in v['nodes']][:3]}" for v in told if v["impact"] in SERIOUS]

    def close(self) -> None:
        self.context.close()
        assert self.wrong == []
