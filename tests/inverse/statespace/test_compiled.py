"""The same numbers with compiled loops and without: one small problem in a process that compiles nothing."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from .cases import beam, case, holes

ROOT = Path(__file__).resolve().parents[3]


def numbers() -> dict[str, list[float]]:
    """What a path computes, flat, for two records: one with gaps and an unknown start, one long enough to settle."""
    found = {}
    for name, samples, missing in (("gaps", 120, holes), ("settled", 700, None)):
        record = case(beam("ds", "foh", 2), samples, missing, moving=missing is not None)
        path = record.path("first_difference", unknown_start=missing is not None)
        solution, w = path.solution(1e-2, 1.3), np.cos(np.arange(2 * samples)).reshape(samples, 2)
        posterior = solution.posterior
        found |= {
            f"{name}, load": solution.load, f"{name}, std": posterior.std,
            f"{name}, weights": posterior.bias_weights(w), f"{name}, scalars": path.scalars(1e-2).array(),
            f"{name}, sums": np.array([posterior.variance(w), posterior.noise_variance(w), path.scale]),
            f"{name}, small": path.solution(1e-5, None).load,
        }  # fmt: skip
    return {key: np.asarray(value).reshape(-1).tolist() for key, value in found.items()}


def test_compiled_loops_change_no_number() -> None:
    code = "import json; from tests.inverse.statespace.test_compiled import numbers; print(json.dumps(numbers()))"
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    plain, own = json.loads(ran.stdout), numbers()
    for key, values in own.items():
        limit = 1e-10 if "small" in key else 1e-12
        assert np.max(np.abs(np.array(plain[key]) - values)) <= limit * np.max(np.abs(values)), key
