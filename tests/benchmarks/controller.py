"""A tracker in C beside the tracker: agreement, size, time. `python -m tests.benchmarks.controller [SAMPLES]`.

The building of ten storeys (22 states, 4 sensors, 1 load) and a beam of eight modes under ambient loads (17 states, 4
sensors, noises correlated), each with 5 % of its cells missing and spikes in 3 of 1000 cells, between ten and 1e5 std
of the noise: SAMPLES (100 000) through the tracker without its watch, and through the C file in double and single
precision. Largest difference of the load over the load that nine of ten samples stay below, and of the std over itself;
then of the same record with the watch, which the C has not. Bytes of code and tables (`size`), of one tracker, and of
all frames of the stack as the compiler tells them; ns of a sample on this machine by kind, the least of five runs, and
cycles of its time stamp counter where it has one. Needs a C compiler.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.compiled import CC, Controller
from tests.families.test_tracking_controller import Case, beam, building, python, soiled
from tests.tracked import bm2, bm3

TIMER = """
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "roof.h"
#if defined(__x86_64__) || defined(__i386__)
#include <x86intrin.h>
#define TICKS() ((double)__rdtsc())
#else
#define TICKS() 0.0
#endif
static roof_tracker tracker;
int main(int argc, char **argv) {
  roof_real y[ROOF_SENSORS], load[ROOF_LOADS], std[ROOF_LOADS];
  double row[ROOF_SENSORS];
  FILE *file = fopen(argv[argc - 1], "rb");
  fprintf(stderr, "%zu\\n", sizeof tracker);
  roof_reset(&tracker);
  while (fread(row, sizeof row, 1, file) == 1) {
    struct timespec a, b;
    double ticks;
    unsigned said;
    for (int i = 0; i < ROOF_SENSORS; ++i) y[i] = (roof_real)row[i];
    clock_gettime(CLOCK_MONOTONIC, &a);
    ticks = TICKS();
    said = roof_step(&tracker, y, load, std);
    ticks = TICKS() - ticks;
    clock_gettime(CLOCK_MONOTONIC, &b);
    printf("%u %.0f %.0f\\n", said, 1e9 * (double)(b.tv_sec - a.tv_sec) + (double)(b.tv_nsec - a.tv_nsec), ticks);
  }
  return 0;
}
"""
KINDS = ("settled gain", "channels missing", "two filters", "slowest 1 of 1000")


def differences(case: Case, y: np.ndarray, folder: Path) -> None:
    """Print how far C and Python are apart."""
    tracker = case[1]
    source = tracker.to_c(folder / "roof.c", "roof")
    start = time.perf_counter()
    load, std = python(tracker, y)
    usually = np.quantile(np.abs(load), 0.9)
    took = (time.perf_counter() - start) / len(y)
    print(f"  Python, a block: {1e6 * took:.1f} us a sample")
    tracker.reset()
    with_watch = tracker.run(y)[:2]
    for dtype in ("double", "float"):
        ours = Controller(source, "roof", y.shape[1], load.shape[1], dtype).run(y)
        apart = np.abs(ours[0] - load).max() / usually, np.abs(ours[1] / std - 1).max()
        usual = np.median(np.abs(ours[0] - load)) / usually
        print(f"  C in {dtype}: load {apart[0]:.1e}, std {apart[1]:.1e} at most; load {usual:.1e} in the median")
    same = np.mean(np.all(np.abs(ours[0] - with_watch[0]) < 1e-4 * usually, axis=1))
    named = f"{len(tracker.faults)} channels named"
    print(f"  beside the tracker with its watch ({named}): {100 * same:.1f} % of answers alike")


def sizes(folder: Path) -> None:
    """Print bytes of code and tables, of the stack."""
    for dtype in ("DOUBLE", "FLOAT"):
        made = folder / "roof.o"
        flags = ["-std=c99", "-Os", f"-DROOF_{dtype}", "-fstack-usage", "-c", "-o", str(made), str(folder / "roof.c")]
        subprocess.run([str(CC), *flags], check=True)
        text, data, bss = subprocess.run(
            ["size", str(made)], capture_output=True, text=True, check=True
        ).stdout.splitlines()[1].split()[:3]  # fmt: skip
        tables = sum(int(n) for n in re.findall(r"static const real \w+\[(\d+)\]", (folder / "roof.c").read_text()))
        tables *= 8 if dtype == "DOUBLE" else 4
        frames = (folder / "roof.su").read_text() if (folder / "roof.su").exists() else ""
        stack = sum(int(line.split("\t")[1]) for line in frames.splitlines())
        print(f"  {dtype.lower()}, -Os: code {int(text) - tables}, tables {tables}, variables {int(data) + int(bss)}, "
              f"all frames of the stack together {stack} bytes")  # fmt: skip


def times(y: np.ndarray, folder: Path) -> None:
    """Print ns and cycles of a sample."""
    (folder / "timer.c").write_text(TIMER)
    y.tofile(folder / "y.bin")
    for dtype in ("DOUBLE", "FLOAT"):
        program = folder / f"timer{dtype}"
        flags = ["-O2", f"-DROOF_{dtype}", "-o", str(program), str(folder / "timer.c"), str(folder / "roof.c"), "-lm"]
        subprocess.run([str(CC), *flags], check=True)
        runs = []
        for _ in range(5):  # the least of each sample: what else the machine does is not counted
            done = subprocess.run([str(program), str(folder / "y.bin")], capture_output=True, text=True, check=True)
            runs.append(np.array([line.split() for line in done.stdout.splitlines()], float).T)
        said, ns, ticks = np.min(runs, axis=0)
        said = said.astype(int)
        of = (said & 1) > 0, (said & 19) == 2, (said & 16) > 0, ns >= np.quantile(ns, 0.999)
        parts = [f"{name} {np.median(ns[at]):.0f} ns ({np.median(ticks[at]):.0f} cycles)"
                 for name, at in zip(KINDS, of, strict=True) if at.any()]  # fmt: skip
        print(f"  {dtype.lower()}, -O2, a tracker of {done.stderr.strip()} bytes: {', '.join(parts)}")


def main(samples: int = 100_000) -> None:
    """Print all of it."""
    if CC is None:
        raise SystemExit("no C compiler")
    for name, case, record in (
        ("building", building(), bm2("matern", 0, samples=samples)), ("beam", beam(), bm3(0, samples)),
    ):  # fmt: skip
        model = case[1].fitted.model
        print(f"{name}: {model.n} states, {model.m} sensors, {model.p} loads, {samples} samples")
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            differences(case, soiled(record, 1), folder)
            sizes(folder)
            times(np.vstack([soiled(record, 1), soiled(record, 2, 0.0005, 0.0)])[:200_000], folder)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
