"""Antiresonances: lines that are flagged, and lines that are wrong. `python -m tests.benchmarks.antiresonance [SEEDS]`.

Accelerance of a simply supported steel beam under one force (`tests.frfplate.beam`), 797 lines from 1 to 200 Hz, 1 % of
noise, whose level is told. The first table is one draw, the errors those of least squares per line, which shows them;
beside them the error of the default estimate. The second counts over SEEDS (50) draws: lines with more than 20 % error
that were flagged (caught), the largest error of a line that was not, the share of flags on lines with less than 20 %
error (needless), and the predicted std of the least-squares load over its scatter, in the middle of the lines and from
the 5th to the 95th percentile. All at a predicted std of 10 %, the size of the load known from the data alone.

Ends with 1 if a figure misses its limit.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from loadid import FrequencyInversion, LoadEstimate, Noise, Spectra
from structures import FrfModel
from tests import frfplate
from tests.frfplate import LAYOUTS, Lines

LEVEL, WRONG = 0.10, 0.20
TABLE = {  # median and largest error, lines flagged, largest unflagged error, caught and all lines with more than 20 %
    (13,): (0.025, 4.27, 142, 0.196, 65, 65),
    (8,): (0.024, 1.85, 77, 0.222, 33, 34),
    (8, 20): (0.016, 0.99, 11, 0.094, 7, 7),
    (8, 13, 20, 31): (0.011, 0.77, 10, 0.089, 4, 4),
}
CAUGHT, UNFLAGGED, NEEDLESS, RATIO = 0.97, 0.30, 0.13, (0.9, 1.1)


@lru_cache(maxsize=8)
def model(nodes: tuple[int, ...]) -> FrfModel:
    """FRFs of one layout at the 797 lines."""
    return FrfModel.of(frfplate.beam_model(*nodes), frfplate.beam(*nodes).frequencies)


@dataclass(frozen=True)
class Draw:
    """One noisy draw: what was estimated, and the relative errors (lines,) of least squares and of the estimate."""

    estimate: LoadEstimate
    naive: NDArray[np.float64]
    shown: NDArray[np.float64]

    @property
    def flagged(self) -> NDArray[np.bool_]:
        """Lines that are not to be trusted."""
        return ~self.estimate.trust(LEVEL)[:, 0]

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """Lines on which least squares are off by more than 20 %."""
        return self.naive > WRONG


def draw(nodes: tuple[int, ...], seed: int = 0) -> Draw:
    """Estimate of one draw."""
    case: Lines = frfplate.beam(*nodes, seed=seed)
    spectra = Spectra(case.frequencies, case.Y, noise=case.drawn, noise_source="known")
    estimate = FrequencyInversion(model(nodes), noise=Noise(frf=0.0)).estimate(spectra)  # it is exact
    return Draw(estimate, case.errors(estimate.spectrum.naive), case.errors(estimate.load))


def row(d: Draw) -> tuple[float, float, int, float, int, int]:
    """The figures of the table for one draw."""
    flagged, naive = d.flagged, d.naive
    worst = float(naive[~flagged].max())
    caught = int(np.sum(flagged & d.wrong))
    return float(np.median(naive)), float(naive.max()), int(flagged.sum()), worst, caught, int(d.wrong.sum())


@dataclass(frozen=True)
class Counts:
    """Rates over many draws."""

    caught: float
    unflagged: float
    needless: float
    ratio: float
    low: float
    high: float

    def met(self) -> bool:
        """All limits."""
        good = self.caught >= CAUGHT and self.unflagged <= UNFLAGGED and self.needless <= NEEDLESS
        return good and RATIO[0] <= self.ratio <= RATIO[1]


def counted(nodes: tuple[int, ...], seeds: int) -> Counts:
    """Rates over the first `seeds` draws."""
    draws = [draw(nodes, seed) for seed in range(seeds)]
    flagged, wrong, naive = (np.array([getattr(d, name) for d in draws]) for name in ("flagged", "wrong", "naive"))
    predicted = np.mean([d.estimate.spectrum.naive_std[:, 0] for d in draws], axis=0)
    scatter = frfplate.AMPLITUDE * np.sqrt(np.mean(naive**2, axis=0))
    ratio = predicted / scatter
    low, high = np.percentile(ratio, [5, 95])
    return Counts(
        caught=float(np.sum(flagged & wrong) / max(np.sum(wrong), 1)),
        unflagged=float(naive[~flagged].max()),
        needless=float(np.sum(flagged & ~wrong) / np.sum(~wrong)),
        ratio=float(np.median(ratio)),
        low=float(low),
        high=float(high),
    )


def main(seeds: int = 50) -> int:
    """Print both tables."""
    print("one draw                 least squares per line, flags of the package                     estimate")
    print("sensor nodes           median    max  flagged  max unflagged  caught    (published)          max")
    good = True
    for nodes, known in TABLE.items():
        d = draw(nodes)
        found = row(d)
        med, most, count, worst, caught, wrong = found
        print(f"{', '.join(map(str, nodes)):22s}{med:7.3f}{most:7.2f}{count:9d}{worst:15.3f}{caught:5d}/{wrong:<3d}"
              f" {known[2:4]!s:>14s}{known[4]:4d}/{known[5]:<3d}{d.shown.max():9.2f}")  # fmt: skip
    print(f"\n{seeds} draws               caught  max unflagged  needless   predicted / scatter: median (5 to 95 %)")
    for nodes in LAYOUTS:
        c = counted(nodes, seeds)
        good &= c.met()
        print(f"{', '.join(map(str, nodes)):22s}{c.caught:8.1%}{c.unflagged:15.3f}{c.needless:10.1%}{c.ratio:22.3f}"
              f" ({c.low:.2f} to {c.high:.2f}){'' if c.met() else '   MISSED'}")  # fmt: skip
    print(f"limits                {CAUGHT:>7.0%}+{UNFLAGGED:15.3f}{NEEDLESS:10.1%}{RATIO[0]:18.1f} to {RATIO[1]}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:2])))
