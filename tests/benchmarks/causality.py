"""How often a band of an FRF is called turned although it is right, and how often a conjugated one is missed.

Run with ``python -m tests.benchmarks.causality [models]``. Random models of 1 to 20 modes at 0.2 to 1.5 times the
upper end of the band, damping 0.1 to 5 %, modal constants of any sign, as receptance, mobility or accelerance; the band
begins anywhere below the half of its upper end.
"""

from __future__ import annotations

import sys

import numpy as np

from structures._testing.kinds import TURNED, before_zero

COLUMNS = "   lines  noise      told  called turned  conjugated missed"


def random_frf(rng: np.random.Generator, count: int, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Lines (Hz) and FRF (lines,) of one random model; `noise` relative to its rms."""
    f = np.linspace(max(rng.uniform(0, 500), 1), 1000, count)
    modes = rng.integers(1, 21)
    w, own = 2 * np.pi * f[:, None], 2 * np.pi * rng.uniform(0.2, 1.5, modes) * 1000
    damping, constants = 10 ** rng.uniform(-3, np.log10(0.05), modes), rng.standard_normal((2, modes)).prod(axis=0)
    H = np.sum(constants / (own**2 - w**2 + 2j * damping * own * w), axis=1) * (2j * np.pi * f) ** rng.integers(3)
    error = rng.standard_normal((2, count))
    return f, H + noise * np.sqrt(np.mean(np.abs(H) ** 2) / 2) * (error[0] + 1j * error[1])


def rates(count: int, models: int, noise: float = 0.0, seed: int = 0) -> tuple[float, float, float]:
    """Share of the models that are told, of these called turned, and of their conjugates not called turned."""
    rng = np.random.default_rng(seed)
    told, alarms, missed = 0, 0, 0
    for _ in range(models):
        f, H = random_frf(rng, count, noise)
        share, sure = before_zero(f, np.stack([H, H.conj()], axis=1)[..., None])
        if sure[0, 0]:
            told += 1
            alarms += bool(share[0, 0] > TURNED)
            missed += not (sure[1, 0] and share[1, 0] > TURNED)
    return told / models, alarms / max(told, 1), missed / max(told, 1)


def main(models: int = 2000) -> None:
    """Print the table."""
    print(COLUMNS)
    for noise in (0.0, 0.1, 0.5):
        total = np.zeros(3)
        for count in (64, 128, 256, 500, 2000):
            row = rates(count, models, noise)
            total += np.array([row[0], row[0] * row[1], row[0] * row[2]]) / 5
            print(f"{count:8d} {noise:6.1f} {row[0]:9.1%} {row[1]:14.2%} {row[2]:18.2%}")
        print(f"     all {noise:6.1f} {total[0]:9.1%} {total[1] / total[0]:14.2%} {total[2] / total[0]:18.2%}")
    rng, pure = np.random.default_rng(1), 0
    for _ in range(models):
        H = rng.standard_normal((500, 1, 1)) + 1j * rng.standard_normal((500, 1, 1))
        share, sure = before_zero(np.arange(500.0), H)
        pure += bool(sure.any() and share.max() > TURNED)
    print(f"noise alone, 500 lines: {pure} of {models} called turned")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
