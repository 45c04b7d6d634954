"""CPU time and memory of a sweep with all rules against the factorisation. `python -m tests.benchmarks.sweep [N]`.

One N x N problem (2000), L = I and first difference; one process for each measurement, one thread. CPU seconds and peak
memory (resident set above that of the interpreter with the problem in it) of: scipy's SVD of the operator, which is
what a user would start from; the path, its factorisation; the path with a sweep of 150 lambdas and all rules, with
their comparison and verdict. Half a minute on an idle core.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

PENALTIES = ("identity", "first_difference")
LAMBDAS = 150
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def resident() -> float:
    """Resident set now, MiB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def measure(what: str, penalty: str, n: int) -> None:
    """Run one measurement in this process, and print CPU seconds and MiB."""
    import scipy.linalg

    from loadid._inverse import penalties, rules
    from loadid._inverse.choice import decide
    from loadid.paths import LinearProblem, SVDPath

    from .fredholm import PROBLEMS

    H, load = PROBLEMS["heat"](n)
    clean = H @ load
    y = clean + 1e-3 * np.sqrt(np.mean(clean**2)) * np.random.default_rng(0).standard_normal(n)
    problem = LinearProblem.whitened(H, y, L=None if penalty == "identity" else penalties.matrix(penalty, n))
    del H
    scipy.linalg.svd(problem.H[:50, :50])
    floor, start = resident(), time.process_time()
    if what == "svd":
        scipy.linalg.svd(problem.H)
    else:
        path = SVDPath(problem)
        if what == "rules":
            sweep = rules.Sweep.over(path, 1e-3 * float(np.sqrt(np.mean(clean**2))), LAMBDAS)
            decide(sweep, None, {name: rules.run(name, sweep) for name in rules.RULES})
    print(time.process_time() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - floor)


def main(n: int) -> None:
    """Print the table."""
    environment = os.environ | dict.fromkeys(THREADS, "1")
    print(f"{n} x {n}, {LAMBDAS} lambdas, one thread: CPU s, peak MiB (over the SVD's, over the factorisation's)")
    for penalty in PENALTIES:
        found: list[tuple[float, float]] = []
        for what in ("svd", "path", "rules"):
            command = [sys.executable, "-m", "tests.benchmarks.sweep", what, penalty, str(n)]
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
            cpu, memory = map(float, done.stdout.split())
            found.append((cpu, memory))
            svd, path = found[0], found[min(1, len(found) - 1)]
            print(
                f"  {penalty:18s}{what:6s}{cpu:8.2f} ({cpu / svd[0]:.2f}, {cpu / path[0]:.2f})"
                f"{memory:9.0f} ({memory / svd[1]:.2f}, {memory / path[1]:.2f})"
            )


if __name__ == "__main__":
    if len(sys.argv) == 4:
        measure(sys.argv[1], sys.argv[2], int(sys.argv[3]))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
