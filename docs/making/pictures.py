"""Pictures of the pages of Start: `python -m docs.making.pictures` runs their blocks and keeps what users see.

Pictures are those that the blocks write; pages of HTML are photographed in the system's Chromium, as far down as a
screen shows.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests import blocks

from .gallery import ROOT, small

START = ROOT / "docs" / "start"
CHROMIUM = "/usr/bin/chromium"
SCREEN = {"width": 900, "height": 760}
MADE = {
    "impact": {"impact_force.png": "force.png", "impact_report.png": "result.html"},
    "sources": {"sources.png": "sources.png", "sources_report.png": "forces.html"},
    "online": {"wind.png": "wind.png", "wind_report.png": "wind.html"},
    "static": {"lift.png": "lift.png", "picard.png": "picard.png", "lift_report.png": "lift.html"},
    "gel": {"map.png": "map.png", "map_report.png": "map.html"},
}


def make(page: str, taken: dict[str, str]) -> None:
    """Run a page in an empty folder and keep some of what it writes."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            scope: dict[str, Any] = {}
            for block in blocks.blocks(f"docs/start/{page}.md"):
                if block.runs:
                    blocks.run(block, scope)
            for name, source in taken.items():
                path = Path(source)
                content = path.read_bytes() if path.suffix == ".png" else photographed(path)
                (START / name).write_bytes(small(content, 900))
        finally:
            os.chdir(before)


def photographed(page: Path) -> bytes:
    """What a screen shows of a page."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        shown = browser.new_page(viewport=SCREEN, color_scheme="light")
        shown.goto(page.resolve().as_uri())
        taken: bytes = shown.screenshot()
        browser.close()
    return taken


if __name__ == "__main__":
    for page, taken in MADE.items():
        if page in sys.argv[1:] or not sys.argv[1:]:
            make(page, taken)
