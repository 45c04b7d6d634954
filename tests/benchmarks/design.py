"""Sensor placement against what else could be done: ``python -m tests.benchmarks.design``.

2000 candidates, 60 loads, 40 sensors. Alternatives: column-pivoted QR of the whitened rows (what sparse-sensing
packages do; it knows no prior and places at most as many sensors as there are loads), greedy search that factors every
trial set anew, the best of 1000 random sets. CPU seconds; the quality is the geometric-mean posterior std, and the
worst one, over their amplitudes.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from loadid import design

CANDIDATES, LOADS, CHOSEN, SNR = 2000, 60, 40, 100.0


def cases() -> dict[str, np.ndarray]:
    """Transfer matrices: a smooth kernel on the unit square, and one without structure."""
    rng = np.random.default_rng(0)
    x, z = rng.uniform(0, 1, (CANDIDATES, 2)), rng.uniform(0.05, 0.95, (LOADS, 2))
    smooth = 1 / (0.05**2 + np.sum((x[:, None] - z) ** 2, axis=-1))
    return {"smooth": smooth, "random": rng.standard_normal((CANDIDATES, LOADS))}


def pivoted(A: np.ndarray) -> list[int]:
    """Rows by column-pivoted QR."""
    from scipy.linalg import qr

    return qr(A.T, mode="economic", pivoting=True)[2][:CHOSEN].tolist()


def plain(A: np.ndarray, steps: int) -> list[int]:
    """The first steps of a greedy search that factors every trial set."""
    chosen: list[int] = []
    eye = np.eye(LOADS)
    for _ in range(steps):
        best = max(
            (i for i in range(len(A)) if i not in chosen),
            key=lambda i: np.sum(np.log(np.abs(np.diag(np.linalg.qr(np.vstack([A[[*chosen, i]], eye]), mode="r"))))),
        )
        chosen.append(best)
    return chosen


def luck(A: np.ndarray) -> list[int]:
    """Best of 1000 random sets."""
    rng = np.random.default_rng(1)
    sets = [rng.choice(len(A), CHOSEN, replace=False) for _ in range(1000)]
    return max(sets, key=lambda s: np.sum(np.log1p(np.linalg.svd(A[s], compute_uv=False) ** 2))).tolist()


def timed(work: Callable[[], list[int]]) -> tuple[list[int], float]:
    """Answer and CPU seconds."""
    start = time.process_time()
    found = work()
    return found, time.process_time() - start


def main() -> None:
    """Print the table."""
    print(f"{'case':8} {'method':34} {'CPU s':>9} {'mean std':>9} {'worst std':>10}")
    for name, H in cases().items():
        A = H * SNR / np.abs(H).max()
        rows = {
            "design.place, D": lambda H=H: list(design.place(H, CHOSEN, snr=SNR).chosen),
            "design.place, worst": lambda H=H: list(design.place(H, CHOSEN, snr=SNR, criterion="worst").chosen),
            "pivoted QR": lambda A=A: pivoted(A),
            "best of 1000 random sets": lambda A=A: luck(A),
        }
        for method, work in rows.items():
            chosen, seconds = timed(work)
            one = design.compare({"": chosen}, candidates=H, noise=1.0, amplitude=SNR / np.abs(H).max()).layouts[0]
            print(f"{name:8} {method:34} {seconds:9.2f} {one.mean_share:9.2%} {one.share.max():10.1%}")
        _, seconds = timed(lambda A=A: plain(A, 1))
        print(f"{name:8} {'plain greedy, 40 x its first step':34} {40 * seconds:9.1f}")


if __name__ == "__main__":
    main()
