"""A small fleet on disk: beams with half-sine hits, records as NPZ files, and a plan of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.halfsine import RATE, pulses, respond, system

LABEL = "u0"


def record(path: Path, samples: int, seed: int, noise: float = 0.02, gaps: float = 0.0) -> NDArray[np.float64]:
    """A record of the half-sine beam as an NPZ file; the load (samples,)."""
    rng = np.random.default_rng(seed)
    g = pulses(41, samples) * rng.uniform(0.5, 2.0)
    y = respond(g)
    y = y + noise * y.std() * rng.standard_normal(samples)
    y[rng.random(samples) < gaps] = np.nan
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, **{system().sensors[0].label: y, "fs": RATE})
    return g


def fleet(folder: Path, assets: int = 2, records: int = 3, samples: int = 1500, more: str = "") -> Path:
    """Plan of some assets with records of successive minutes."""
    folder.mkdir(parents=True, exist_ok=True)
    system().save(folder / "beam.h5")
    for a in range(assets):
        for k in range(records):
            record(folder / f"b{a}" / f"20260301_00{k:02d}.npz", samples, 100 * a + k)
    lines = [
        'output = "out"', more, "[every]", 'model = "beam.h5"', 'records = ["{name}/*.npz"]',
        'start = "%Y%m%d_%H%M.npz"',
        'reading = { unit = { y0 = "arbitrary" } }', *(f'[[asset]]\nname = "b{a}"' for a in range(assets)),
    ]  # fmt: skip
    plan = folder / "plan.toml"
    plan.write_text("\n".join(lines) + "\n")
    return plan


def written(output: Path) -> dict[str, bytes]:
    """Every file of results and parts, and the page."""
    kept = [*(output / "results").rglob("part.*"), *(output / "parts").rglob("*.json"), output / "fleet.html"]
    return {str(path.relative_to(output)): path.read_bytes() for path in sorted(kept)}
