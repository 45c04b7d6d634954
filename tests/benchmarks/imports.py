"""CPU time of `import loadid` beside `import numpy`. `python -m tests.benchmarks.imports [RUNS]`.

Each row is the best of several fresh interpreters: user plus system time of the whole process, and the same less that
of an interpreter that imports nothing. The limit of 2.5 holds for both ratios.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 2.5
ROWS = {
    "nothing": "pass",
    "numpy": "import numpy",
    "structures": "import structures",
    "loadid": "import loadid",
    "loadid --version": "import contextlib, io\nfrom loadid.cli import main\n"
    "with contextlib.redirect_stdout(io.StringIO()): main(['--version'])",
    "loadid.Deconvolution": "import loadid; loadid.Deconvolution",
    "scipy.signal": "import scipy.signal",
    "matplotlib.pyplot": "import matplotlib; matplotlib.use('agg'); import matplotlib.pyplot",
    "scipy.signal + matplotlib": "import scipy.signal, matplotlib; matplotlib.use('agg'); import matplotlib.pyplot",
}


def cpu_seconds(code: str) -> float:
    """User plus system time of one fresh interpreter that runs `code`, its own start included."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    probe = f"{code}\nimport time\nprint(time.process_time())"
    run = subprocess.run(
        [sys.executable, "-c", probe],
        env={**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return float(run.stdout.split()[-1])


def best(runs: int) -> dict[str, float]:
    """Best CPU time of each row; the rows take turns, so that a busy spell hits all of them."""
    for code in ROWS.values():  # compiles what is not compiled yet
        cpu_seconds(code)
    times = [{name: cpu_seconds(code) for name, code in ROWS.items()} for _ in range(runs)]
    return {name: min(t[name] for t in times) for name in ROWS}


def main(runs: int) -> int:
    """Print the table; 1 where `import loadid` costs more than the limit."""
    found = best(runs)
    bare, numpy = found["nothing"], found["numpy"]
    print(f"CPU time of an import, best of {runs} fresh interpreters")
    print(f"{'':28}{'process ms':>12}{'/ numpy':>9}{'import ms':>12}{'/ numpy':>9}")
    for name, seconds in found.items():
        own = seconds - bare
        ratio = "" if name == "nothing" else f"{own / (numpy - bare):9.2f}"
        print(f"{name:28}{1e3 * seconds:12.1f}{seconds / numpy:9.2f}{1e3 * own:12.1f}{ratio}")
    ratio = max(found["loadid"] / numpy, (found["loadid"] - bare) / (numpy - bare))
    print(f"import loadid / import numpy = {ratio:.2f} (at most {LIMIT})")
    return int(ratio > LIMIT)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 7))
