"""What a tracker makes of loads larger than those of its fit, after a rest: share of samples within 2 std, and flags.

`python -m tests.benchmarks.louder [records]`. Six tones of 20 to 80 Hz act on the beam of `noise_alone`, seen by two
displacement sensors, or by one and an accelerometer. The tracker is tuned on a record of such a load of some rms, then
follows one of 300 samples at rest and 600 of a load of 20 N rms. Each line: rms of the fit; coverage of the first 100
samples of the load and of the rest; rms of error over stated std; how many records have a flag of samples in service
(W521, W526, W529, W534).
"""

from __future__ import annotations

import sys
import warnings

import numpy as np

from loadid import LoadTracker, Noise

from .noise_alone import ACC, DISP, DT, on

STILL, MOVING, FITTED, RMS = 300, 600, 2000, 20.0
IN_SERVICE = {"LID-W521", "LID-W526", "LID-W529", "LID-W534"}


def tones(samples: int, rng: np.random.Generator) -> np.ndarray:
    """A load (samples, 1) of unit rms."""
    each = rng.uniform(20, 80, 6)[:, None] * DT * np.arange(samples) + rng.uniform(0, 1, 6)[:, None]
    return np.sin(2 * np.pi * each).sum(axis=0)[:, None] / np.sqrt(3)


def main(records: int) -> None:
    """Print the table."""
    warnings.simplefilter("ignore")
    sets = {"displacements": (on(DISP), np.array([1e-6, 1e-6])), "both": (on([ACC[0], DISP[1]]), np.array([1.0, 1e-6]))}
    for name, (model, std) in sets.items():
        for rms in (2.0, 7.0, 20.0):
            near, late, ratio, flagged = [], [], [], 0
            for seed in range(records):
                rng = np.random.default_rng([61, seed])
                quiet = model.predict(rms * tones(FITTED, rng), DT) + std * rng.standard_normal((FITTED, 2))
                load = np.vstack([np.zeros((STILL, 1)), RMS * tones(MOVING, rng)])
                read = model.predict(load, DT) + std * rng.standard_normal((len(load), 2))
                found = LoadTracker(model, noise=Noise(std)).fit(quiet, DT).track(read)
                off = np.abs(found.load - load)[:, 0] / found.std[:, 0]
                near.append(np.mean(off[STILL : STILL + 100] < 2))
                late.append(np.mean(off[STILL + 100 :] < 2))
                ratio.append(np.sqrt(np.mean(off[STILL:] ** 2)))
                flagged += bool(IN_SERVICE & {f.code for f in found.flags})
            print(f"{name:14s} {rms:4.0f} N   {np.mean(near):4.0%} {np.mean(late):4.0%}   {np.median(ratio):5.1f}   "
                  f"{flagged} of {records}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 6)
