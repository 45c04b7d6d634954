"""How fast the gel pad and an estimate that explores itself answer in a browser, and what they send.

``python -m tests.benchmarks.lab_pages``: the table of `tests.benchmarks.lab` for the noise of the gel pad (with a ridge
usable is when its answers at all noises have been made ahead, after the tick), and for lambda of the hit of
``loadid demo`` (6000 samples) and of `loadid.datasets.impact` (400), both over states; then CPU ms of the answer alone,
without HTTP and browser.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from loadid import Deconvolution, datasets
from loadid._commands import demo
from loadid._lab.contract import Call
from loadid._lab.explore import page_with
from loadid._lab.server import Lab
from loadid._lab.shown import Shown
from structures._threads import one_thread
from tactile._lab.gelpad import page as gelpad
from tests.browser import chromium

from . import lab as base

base.SLIDERS |= {"gelpad": ("noise",), "own": ("lam",)}
LAMBDAS = 60


def shown() -> dict[str, Shown]:
    """Estimates, ready to be shown."""
    hit, simulated = datasets.impact(), demo.simulate(0)
    return {
        "demo, 6000 samples": Shown(Deconvolution(demo.model()).estimate(simulated.record)),
        "impact, 400 samples": Shown(Deconvolution(hit.model).estimate(hit.record)),
    }


def answers(one: Shown) -> Any:
    """CPU ms of a picture and of all that is said, at lambdas that nobody asked for before."""
    again = one.estimate.again
    assert again is not None
    lams = np.geomspace(*again.path.range, LAMBDAS)
    found = []
    for ask in (lambda lam: one.picture(lam, 0), one.at):
        times = []
        for lam in lams[1:-1]:
            begin = time.process_time()
            with one_thread():
                ask(float(lam))
            times.append(1e3 * (time.process_time() - begin))
        found.append((np.median(times), np.percentile(times, 95)))
    return found


def main() -> None:
    """Print the tables."""
    estimates, rows = shown(), []
    state = {"model": None, "log": None, "found": True, "given": True}
    with chromium() as browser:
        with Lab([gelpad]) as lab:
            for name, first in (("gel pad, multiplied", ""), ("gel pad, with a ridge", "ridge")):
                rows += [(name, *row) for row in base.visited(browser, lab, "gelpad", first)]
        for name, one in estimates.items():
            page = page_with(lambda one=one: one, {"state": Call(lambda: state)})  # type: ignore[misc]
            with Lab([page]) as lab:
                rows += [(name, *row) for row in base.visited(browser, lab, "own")]
    print("what, page, first paint ms, usable ms, slider, p50 ms, p95 ms, kB opened, kB all (requests), wrong")
    for row in rows:
        print(", ".join(row))
    for name, one in estimates.items():
        fresh = Shown(one.estimate)
        (quick, slow), (all_quick, all_slow) = answers(fresh)
        print(f"{name}: picture {quick:.1f} / {slow:.1f} CPU ms, all that is said {all_quick:.1f} / {all_slow:.1f}")


if __name__ == "__main__":
    main()
