"""One lab and one browser for all that is tested here."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from loadid._lab.pages import pages
from loadid._lab.server import Lab
from tests.browser import chromium

from .visited import READY, Visit


@pytest.fixture(scope="package")
def served() -> Iterator[Lab]:
    """All pages."""
    with Lab(pages()) as lab:
        yield lab


@pytest.fixture(scope="package")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.fixture
def visit(served: Lab, browser: Any) -> Iterator[Callable[..., Visit]]:
    """Open pages; at the end of the test nothing may have gone wrong on any of them."""
    opened: list[Visit] = []

    def open_(name: str, ready: str = READY, **settings: Any) -> Visit:
        address = name if name.startswith("http") else served.page(name) if name else served.address
        opened.append(Visit(browser, address, ready if name else "", **settings))
        return opened[-1]

    yield open_
    for one in opened:
        one.close()
