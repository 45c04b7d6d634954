"""A page of the lab asked over HTTP, as its script does it, and in a browser."""

from __future__ import annotations

import http.client
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest

from loadid._lab.server import Lab


def posted(lab: Lab, path: str, body: bytes, headers: Mapping[str, str]) -> tuple[int, Any]:
    """Status and answer: JSON, or bytes of a download."""
    link = http.client.HTTPConnection("127.0.0.1", lab.http.server_address[1], timeout=60)
    try:
        link.request("POST", path, body, {"X-Lab-Token": lab.token, **headers})
        got = link.getresponse()
        data = got.read()
        return got.status, json.loads(data) if got.headers["Content-Type"].startswith("application/json") else data
    finally:
        link.close()


def asked(lab: Lab, path: str, **given: Any) -> tuple[int, Any]:
    """A call of a page, ``page/call``."""
    return posted(lab, f"/{path}", json.dumps(given).encode(), {"Content-Type": "application/json"})


def sent(lab: Lab, path: str, content: bytes | Path, name: str = "", **given: str) -> tuple[int, Any]:
    """A file sent to a call of a page."""
    data = content.read_bytes() if isinstance(content, Path) else content
    name = name or (content.name if isinstance(content, Path) else "file")
    told = {"X-Lab-File": quote(name), "X-Lab-Parameters": quote(json.dumps(given))}
    return posted(lab, f"/{path}", data, {"Content-Type": "application/octet-stream", **told})


@contextmanager
def opened(browser: Any, address: str, *, width: int = 1200, dark: bool = False) -> Iterator[Any]:
    """A page in a window of its own; what went wrong in it, and whom it asked, is in ``page.wrong``."""
    window = browser.new_context(viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light")
    page, wrong = window.new_page(), []
    home = address.split("/?")[0].rsplit("/", 1)[0]
    page.on("console", lambda said: wrong.append(said.text) if said.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda sent: None if sent.url.startswith((home, "data:", "blob:")) else wrong.append(sent.url))
    page.wrong = wrong
    page.goto(address)
    try:
        yield page
    finally:
        window.close()


def drawn(page: Any) -> int:
    """How many pictures the page has drawn."""
    return int(page.evaluate("document.documentElement.dataset.drawn || '0'"))


def until(page: Any, count: int) -> None:
    """Wait until so many pictures are drawn."""
    for _ in range(3000):
        if drawn(page) >= count:
            return
        page.wait_for_timeout(10)
    raise AssertionError("the page does not draw")


def serious(page: Any) -> list[str]:
    """Serious violations that axe-core finds."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    found = axe.Axe().run(page).response["violations"]
    return [f"{one['id']}: {one['nodes'][0]['html']}" for one in found if one["impact"] in ("serious", "critical")]
