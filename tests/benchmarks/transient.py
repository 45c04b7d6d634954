"""Histories of five loads from one record: which family to take. `python -m tests.benchmarks.transient [--full]`.

The plate of `tests.frfplate.record`: 20 accelerations, half sines of 5 ms at four places and a random force at a fifth,
8192 samples at 2 kHz, 30 dB, exact impulse response. Relative error over the four (impacts), over the fifth (random),
worst error of the four peaks; share of the samples inside the stated 95 % band. CPU seconds of one thread. Every method
has one automatic rule and is not told the noise level, unless the row says so. ``--full`` adds the exact state-space
path in time (ten seconds, once its loops are compiled).

Ends with 1 if a figure of the default rule misses its limit.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from loadid import Deconvolution, FrequencyInversion, Lambda, LoadEstimate
from loadid.settings import Noise
from structures import ImpulseModel, StateSpace
from tests import frfplate
from tests.frfplate import RATE, SAMPLES, TAPS, Transient

DT = 1 / RATE
LIMITS = {"impacts": 0.30, "random": 0.17}
LINES, TIME = "loadid, FrequencyInversion", "loadid, Deconvolution"


@dataclass(frozen=True)
class Row:
    """Figures of one method."""

    name: str
    scores: dict[str, float]
    seconds: float
    covered: float
    codes: tuple[str, ...] = ()

    def __str__(self) -> str:
        s = self.scores
        figures = f"{s['impacts']:9.3f}{s['random']:9.3f}{s['peak']:9.1%}{self.covered:9.1%}"
        return f"{self.name:50s}{self.seconds:8.2f}{figures}".replace("nan%", " -  ")


def impulses(case: Transient) -> ImpulseModel:
    """The impulse response, zero after its 2048 samples."""
    rest = np.zeros((SAMPLES - TAPS, *case.h.shape[1:]))
    return ImpulseModel(np.concatenate([case.h, rest]), DT, "held", "zoh")


def states() -> StateSpace:
    """The same plate as 50 states."""
    A, B, C, D = frfplate.oscillators()
    left, right = frfplate.timed_places()
    inputs = np.einsum("ki,lk->kil", B, right).reshape(-1, right.shape[0])
    outputs = np.einsum("sk,ki->ski", left, C).reshape(left.shape[0], -1)
    return StateSpace(block_diag(*A), inputs, outputs, (left * D) @ right.T, DT, "zoh")


def plain(case: Transient) -> list[Row]:
    """What a user writes with numpy, and the best that one lambda over all lines can do."""
    rows = []
    start = time.process_time()
    load = frfplate.fourier(case)
    spent = time.process_time() - start
    rows.append(Row("numpy, zero-padded FFT, lambda by hand", case.scores(load), spent, np.nan))
    best = min(
        (case.scores(frfplate.fourier(case, s)) for s in np.geomspace(1e-6, 1e-2, 33)), key=lambda s: s["impacts"]
    )
    return [*rows, Row("numpy, one lambda best for the impacts (truth)", best, np.nan, np.nan)]


def estimated(name: str, case: Transient, run: Callable[[], LoadEstimate]) -> Row:
    """Figures of an estimate."""
    start = time.process_time()
    found = run()
    spent = time.process_time() - start
    low, high = found.band(0.95)
    inside = float(np.mean((case.truth >= low) & (case.truth <= high)))
    return Row(name, case.scores(found.load), spent, inside, tuple(sorted(found.codes)))


def package(case: Transient, full: bool) -> list[Row]:
    """Both families on the record."""
    model, told = impulses(case), {"noise": Noise(case.sigma, source="known")}

    def lines(**settings: Any) -> Callable[[], LoadEstimate]:
        return lambda: FrequencyInversion(model, signal="transient", **settings).estimate(case.y, DT)

    def timed(rule: str | None = None, **settings: Any) -> Callable[[], LoadEstimate]:
        return lambda: Deconvolution(model, choice=Lambda(rule, path="fft"), **settings).estimate(case.y, DT)

    runs = {
        LINES: lines(),
        f"{LINES}, noise told": lines(**told),
        f"{LINES}, one lambda by GCV": lines(choice=Lambda("gcv", over="band")),
        TIME: timed(),
        f"{TIME}, noise told": timed(**told),
        f"{TIME}, GCV": timed("gcv"),
        f"{TIME}, robust GCV": timed("robust_gcv"),
    }
    if full:
        system = states()
        runs[f"{TIME}, over states"] = lambda: Deconvolution(system, choice=Lambda(path="statespace")).estimate(
            case.y, DT
        )
    return [estimated(name, case, run) for name, run in runs.items()]


def advice(rows: list[Row]) -> str:
    """Which family to take for such a record, each with its default rule, and why."""
    found = {row.name: row for row in rows}
    lines, timed = found[LINES], found[TIME]
    wrong = [float(np.hypot(r.scores["impacts"], r.scores["random"])) for r in (lines, timed)]
    if "W505" in lines.codes:
        return "take Deconvolution: the response has not decayed within the record"
    if wrong[0] > wrong[1]:
        return f"take Deconvolution: error of both kinds of load together {wrong[1]:.3f} against {wrong[0]:.3f}"
    return (
        f"take FrequencyInversion(signal='transient'): error of both kinds of load together {wrong[0]:.3f} against "
        f"{wrong[1]:.3f},\nas each load has its own spectrum, which one lambda cannot follow; "
        f"{timed.seconds / lines.seconds:.1f} times as fast. Deconvolution where\nthe record ends in motion, for loads "
        f"that only push, for missing samples, and for other penalties"
    )


def main(arguments: list[str]) -> int:
    """Print the table."""
    case = frfplate.record()
    heads = "".join(f"{h:>9s}" for h in ("impacts", "random", "peak", "in 95 %"))
    print(f"{'8192 samples, 20 responses, 5 forces':50s}{'CPU s':>8s}{heads}")
    rows = plain(case) + package(case, "--full" in arguments)
    for row in rows:
        print(row)
    print("\n" + advice(rows))
    scores = next(row.scores for row in rows if row.name == LINES)
    missed = [f"{k} {scores[k]:.3f} > {limit}" for k, limit in LIMITS.items() if scores[k] > limit]
    print("limits: impacts <= 0.30, random <= 0.17: " + (", ".join(missed) + " MISSED" if missed else "met"))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
