"""Time and silence: universal files read beside pyuff. `python -m tests.benchmarks.universal`.

The first table gives CPU seconds for a million samples, medians of three; the second what each reader makes of a file
that is cut at every byte: refused, whole, or shorter than it was without a word.
"""

from __future__ import annotations

import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from structures.errors import InputError
from structures.files._uff import read_uff
from tests.structures.uff_made import binary58, text58

SAMPLES = 1_000_000


def theirs(path: Path) -> list[int]:
    """Samples of every function that pyuff delivers."""
    import pyuff

    sets = pyuff.UFF(str(path)).read_sets()
    return [len(s.get("data", ())) for s in (sets if isinstance(sets, list) else [sets])]


def ours(path: Path) -> list[int]:
    """Samples of every function that our reader delivers."""
    return [len(f.values) for f in read_uff(path).functions]


def cpu(action: Callable[[Path], object], path: Path) -> float:
    """Median CPU seconds of three runs."""
    spent = []
    for _ in range(3):
        start = time.process_time()
        action(path)
        spent.append(time.process_time() - start)
    return float(np.median(spent))


def cuts(action: Callable[[Path], list[int]], data: bytes, path: Path) -> Counter[str]:
    """What becomes of a file of one function that is cut at every byte before its last line feed."""
    path.write_bytes(data)
    whole, told = action(path), Counter[str]()
    for k in range(len(data) - 1):
        path.write_bytes(data[:k])
        try:
            told["whole" if action(path) == whole else "shorter"] += 1
        except (InputError, Exception):  # pyuff raises bare exceptions
            told["refused"] += 1
    return told


def main() -> None:
    """Print both tables."""
    warnings.simplefilter("ignore")
    values = np.random.default_rng(0).normal(size=SAMPLES)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.uff"
        print(f"{'CPU s':22}{'ours':>9}{'pyuff':>9}{'ratio':>8}")
        for name, write in (("58, text, double", text58), ("58b, binary, double", binary58)):
            path.write_bytes(write(values, function=1, abscissa=("time", "s")))
            a, b = cpu(ours, path), cpu(theirs, path)
            print(f"{name:22}{a:9.3f}{b:9.3f}{b / a:8.1f}")
        print(f"\n{'cut at every byte':22}{'bytes':>7}{'reader':>8}{'refused':>9}{'shorter':>9}{'whole':>7}")
        for name, write in (("58, text", text58), ("58b, binary", binary58)):
            data = write(values[:64], function=1, abscissa=("time", "s"))
            for reader, action in (("ours", ours), ("pyuff", theirs)):
                told = cuts(action, data, path)
                row = f"{name:22}{len(data) - 1:7}{reader:>8}{told['refused']:9}{told['shorter']:9}{told['whole']:7}"
                print(row)


if __name__ == "__main__":
    main()
