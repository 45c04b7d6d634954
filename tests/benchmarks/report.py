"""CPU time and size of a report. `python -m tests.benchmarks.report [RUNS]`.

A hit on a beam, three accelerometers, 6000 samples: its estimate is made once and kept as a file. Each run is a fresh
interpreter that reads the file and calls `LoadEstimate.report` twice: the first call loads what it needs, the second
does not. User plus system time of the calls alone, best of the runs; one BLAS thread. 1 where the first takes longer
than `LIMIT`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 1.5  # s
MAKE = """
from loadid._commands.demo import model, simulate
from loadid import Deconvolution
Deconvolution(model()).estimate(simulate().record).save("hit.h5")
"""
TIME = """
import time
from loadid import LoadEstimate
estimate = LoadEstimate.read("hit.h5")
said = []
for _ in range(2):
    start = time.process_time()
    estimate.report("hit.html")
    said.append(time.process_time() - start)
start = time.process_time()
estimate._repr_html_()
print(*said, time.process_time() - start)
"""


def run(code: str, folder: str) -> str:
    """What a fresh interpreter prints that runs `code` in a folder."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    env = {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, "-c", code], env=env, cwd=folder, capture_output=True, text=True, check=True
    ).stdout


def main(runs: int) -> int:
    """Print the table; 1 where the report costs more than the limit."""
    with tempfile.TemporaryDirectory() as folder:
        run(MAKE, folder)
        times = [[float(word) for word in run(TIME, folder).split()] for _ in range(runs)]
        size = (Path(folder) / "hit.html").stat().st_size
    first, again, short = (min(column) for column in zip(*times, strict=True))
    print(f"report of 3 channels x 6000 samples, CPU s, best of {runs} fresh interpreters")
    print(f"first in its process {first:.2f}, again {again:.2f}, in a notebook {short:.2f}; {size / 1e3:.0f} kB")
    return int(first > LIMIT)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 3))
