"""What a frozen inverse costs per reading. `python -m tests.benchmarks.frozen`.

60 sensors, 1000 loads: the frozen inverse, the bare product of the same size, the whole estimate, and ridge regression
solved anew as a user would write it. Median over many readings, one thread; microseconds.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable
from time import perf_counter

import numpy as np

from loadid import Noise, StaticInversion

SENSORS, LOADS = 60, 1000


def median(action: Callable[[], object], repeats: int) -> float:
    """Median time of one call, in microseconds."""
    times = []
    for _ in range(repeats):
        start = perf_counter()
        action()
        times.append(perf_counter() - start)
    return 1e6 * float(np.median(times))


def main() -> None:
    """Print the table."""
    x, s = np.linspace(0, 1, LOADS), np.linspace(0, 1, SENSORS)
    H = 0.05 / np.pi / (0.05**2 + (s[:, None] - x) ** 2) / LOADS
    y = H @ np.exp(-(((x - 0.4) / 0.1) ** 2)) + 1e-3 * np.random.default_rng(0).standard_normal(SENSORS)
    family = StaticInversion(H, noise=Noise(1e-3, source="repeatability"), choice=1e-2)
    frozen, A = family.freeze(), np.ascontiguousarray(family.at_rest().inverse(1e-2))
    L = 1e-2 * np.linalg.norm(H, 2) * np.eye(LOADS)
    rows = [
        ("frozen(y)", median(lambda: frozen(y), 2000)),
        ("A @ y, the bare product", median(lambda: A @ y, 2000)),
        ("StaticInversion.estimate(y)", median(lambda: family.estimate(y), 3)),
        (
            "numpy lstsq of [H; lambda I]",
            median(lambda: np.linalg.lstsq(np.vstack([H, L]), np.r_[y, np.zeros(LOADS)]), 2),
        ),
    ]
    print(f"{SENSORS} sensors, {LOADS} loads; microseconds per reading")
    for name, time in rows:
        print(f"  {name:32s} {time:12.1f}")


if __name__ == "__main__":
    main()
