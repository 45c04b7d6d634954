"""How fast the lab answers in a browser, what it sends, and whether random bodies ever get through.

``python -m tests.benchmarks.lab``: time from the start of the command to its address; for each page first paint,
until it can be used, from the input of a slider to the next frame after the new numbers are drawn (p50, p95 of 30;
where a page makes answers ahead, when it has), and kB over the wire, once open and with 30 moves of its first slider.
``python -m tests.benchmarks.lab fuzz [COUNT]``: random bodies (10 000) for every call.
"""

from __future__ import annotations

import http.client
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from loadid._lab.pages import pages
from loadid._lab.server import Lab
from tests.browser import chromium
from tests.lab_pages.client import requested
from tests.lab_pages.fuzz import accepted, bodies

SLIDERS = {"contact": ("lam", "t", "eta", "spacing"), "lcurve": ("lam",)}
AHEAD = ("gelpad", "own")  # pages that make the answers at the stops of their slider while nothing is to do
STEPS = 30
MOVED = """([id, value]) => new Promise(done => {
  const slider = document.getElementById(id), root = document.documentElement, before = Number(root.dataset.drawn);
  const begin = performance.now();
  slider.value = value;
  slider.dispatchEvent(new Event("input", { bubbles: true }));
  const watch = new MutationObserver(() => {
    if (Number(root.dataset.drawn) === before) return;
    watch.disconnect();
    requestAnimationFrame(() => done(performance.now() - begin));
  });
  watch.observe(root, { attributes: true });
})"""


def waited(page: Any, expression: str, seconds: float = 60) -> None:
    """Until it is true."""
    end = time.monotonic() + seconds
    while not page.evaluate(expression) and time.monotonic() < end:
        time.sleep(0.01)


def started() -> float:
    """Seconds from the start of `loadid lab` to the line with its address."""
    loadid = Path(sys.executable).with_name("loadid")
    begin = time.perf_counter()
    with subprocess.Popen([loadid, "lab", "--no-browser"], stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        run.stdout.readline()
        found = time.perf_counter() - begin
        run.terminate()
    return found


def visited(browser: Any, lab: Lab, name: str, first: str = "") -> list[tuple[str, ...]]:
    """Rows of one page: paint and use, then each slider.

    `first` is a box to be ticked before: usable is then when the answers at all stops of the slider are made ahead.
    """
    context = browser.new_context(viewport={"width": 1200, "height": 900})
    page, sizes, wrong = context.new_page(), [0, 0], []

    def weighed(request: Any) -> None:
        if request.url.startswith(lab.http.address):
            found = request.sizes()
            sizes[0] += 1
            sizes[1] += sum(found.values())
        elif not request.url.startswith("data:"):
            wrong.append(request.url)

    page.on("requestfinished", weighed)
    page.on("console", lambda m: wrong.append(m.text) if m.type == "error" else None)
    begin = time.perf_counter()
    page.goto(lab.page(name))
    while not page.evaluate("document.documentElement.dataset.drawn >= 1"):
        time.sleep(0.002)
    usable = 1e3 * (time.perf_counter() - begin)
    paint = page.evaluate("performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? NaN")
    page.wait_for_timeout(3000)
    if name in AHEAD:
        waited(page, "document.documentElement.dataset.ahead !== undefined")
    if first:
        page.check(f"[name={first}]")
        begin = time.perf_counter()
        waited(page, f"(document.documentElement.dataset.ahead ?? '').includes('{first}\":true')")
        usable = 1e3 * (time.perf_counter() - begin)
    opened, used, rows = sizes[1], 0, []
    for slider in SLIDERS.get(name, ()):
        ends = [float(page.get_attribute(f"#{slider}", end) or 0) for end in ("min", "max")]
        took = [page.evaluate(MOVED, [slider, value]) for value in np.linspace(ends[0], ends[1], STEPS)]
        page.wait_for_timeout(600)
        used = used or sizes[1]
        rows.append(("", "", "", slider, f"{np.median(took):.1f}", f"{np.percentile(took, 95):.1f}"))
    context.close()
    head = (name, f"{paint:.0f}", f"{usable:.0f}")
    table = [(*head, *rows[0][3:]), *rows[1:]] if rows else [(*head, "", "", "")]
    weight = f"{opened / 1e3:.0f}", f"{max(used, opened) / 1e3:.0f}", str(len(wrong))
    return [(*row, *(weight if k == 0 else ("", "", ""))) for k, row in enumerate(table)]


def timed() -> None:
    """Print the table of times."""
    print(f"from the start of the command to its address: {1e3 * started():.0f} ms")
    head = (
        "page",
        "first paint ms",
        "usable ms",
        "slider",
        "p50 ms",
        "p95 ms",
        "kB opened",
        "kB with 30 moves",
        "wrong",
    )
    rows = [head]
    with Lab(pages()) as lab, chromium() as browser:
        requested(lab, lab.address.removeprefix(lab.http.address))
        for name in lab.pages:
            if name in SLIDERS or not any(call.upload for call in lab.pages[name].calls.values()):
                rows += visited(browser, lab, name)
    widths = [max(len(row[k]) for row in rows) for k in range(len(head))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def fuzzed(count: int) -> None:
    """Send random bodies, and print what was answered."""
    with Lab(pages()) as lab:
        begin, codes = time.perf_counter(), Counter[int]()
        line = http.client.HTTPConnection("127.0.0.1", lab.http.server_address[1], timeout=120)
        for one in bodies(lab, count, seed=0):
            codes[accepted(lab, line, *one)] += 1
        alive = requested(lab, lab.address.removeprefix(lab.http.address))[0]
        print(f"{count} bodies in {time.perf_counter() - begin:.0f} s: {dict(codes)}; then the list of pages: {alive}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["fuzz"]:
        fuzzed(int(sys.argv[2]) if len(sys.argv) > 2 else 10_000)
    else:
        timed()
