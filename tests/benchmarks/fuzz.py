"""Damage small files and read them: only an InputError may leave a reader. `python -m tests.benchmarks.fuzz [COUNT]`.

Each mutant is a seeded truncation (35 %), an overwriting of a few bytes (40 %) or of a block (15 %), or an insertion.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from loadid import read_all
from structures._flags import codes
from structures.errors import InputError

STATED = {"fs": 1000.0, "units": {0: "N", 1: "g"}}


def mutant(data: bytes, seed: int) -> tuple[str, bytes]:
    """Kind and bytes of one damaged file."""
    rng = np.random.default_rng(seed)
    kind = rng.choice(["truncated", "bytes", "block", "inserted"], p=[0.35, 0.4, 0.15, 0.1])
    at = int(rng.integers(len(data)))
    if kind == "truncated":
        return kind, data[:at]
    if kind == "inserted":
        return kind, data[:at] + data[max(0, at - 50) : at] + data[at:]
    if kind == "block":
        return kind, data[:at] + rng.bytes(int(rng.integers(1, 64))) + data[at + 16 :]
    size = int(rng.choice([1, 2, 4, 16]))
    fill = rng.choice(["0", "255", "127", "128", "random", "digit"])
    new = rng.bytes(size) if fill == "random" else b"7" * size if fill == "digit" else bytes([int(fill)]) * size
    return str(kind), data[:at] + new + data[at + size :]


def outcomes(path: Path, count: int, folder: Path) -> Iterator[tuple[str, str, float]]:
    """Kind of damage, what came of it and the seconds it took; an exception other than InputError passes through."""
    data = path.read_bytes()
    whole = read_all(path, **STATED)
    for seed in range(count):
        kind, damaged = mutant(data, seed)
        place = folder / f"mutant{path.suffix}"
        place.write_bytes(damaged)
        start = time.perf_counter()
        try:
            records = read_all(place, **STATED)
        except InputError:
            yield kind, "refused", time.perf_counter() - start
            continue
        seconds = time.perf_counter() - start
        same = len(records) == len(whole) and all(
            np.array_equal(a.values, b.values) for a, b in zip(records, whole, strict=True)
        )
        fewer = sum(map(len, records)) < sum(map(len, whole))
        flagged = any("W209" in codes(r.flags) for r in records)
        yield kind, "same" if same else "flagged" if flagged else "shorter" if fewer else "other values", seconds


def main(count: int) -> None:
    """Print one line per format."""
    from tests.loadid.readers.files import small_files

    print(
        f"{'format':8}{'mutants':>9}{'refused':>9}{'flagged':>9}{'same':>7}{'shorter':>9}{'other':>7}{'slowest s':>11}"
    )
    with tempfile.TemporaryDirectory() as name:
        for suffix, path in small_files(Path(name)).items():
            told: Counter[str] = Counter()
            slowest = 0.0
            for _, outcome, seconds in outcomes(path, count, Path(name)):
                told[outcome] += 1
                slowest = max(slowest, seconds)
            print(
                f"{suffix:8}{count:9}{told['refused']:9}{told['flagged']:9}{told['same']:7}{told['shorter']:9}"
                f"{told['other values']:7}{slowest:11.3f}"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
