"""Jobs to guide, their data from a finer mesh: a wing with strain gauges in single readings, a beam that is hit."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from loadid import cli, datasets
from structures import ForwardModel, bases, beams, sensors

NOISE = 1.5e-6
PLACES = (0.2, 0.6, 1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 5, 5.5)
PATCHES = 12


def wing(elements: int, patches: int) -> ForwardModel:
    body = beams.cantilever(
        length=6.0, EI=lambda x: 9e5 * (1 - x / 12) ** 3, mass_per_length=20.0, elements=elements
    )  # fmt: skip
    gauges = [
        sensors.StrainGauge(at=x, fibre=0.08 * (1 - x / 12), noise=NOISE, label=f"g{k}")
        for k, x in enumerate(PLACES, 1)
    ]
    return ForwardModel(body, gauges, bases.patches(body, patches))


def coarse(fine: np.ndarray) -> np.ndarray:
    """What the patches of the model carry of a load on ten times as many."""
    return np.asarray(fine.reshape(PATCHES, -1).mean(axis=1))


def static_job(folder: Path) -> ForwardModel:
    """``wing.toml`` with its model, its log, and records of known loads; 120 elements and patches behind the data."""
    model, truth, rng = wing(40, PATCHES), wing(120, 120), np.random.default_rng(0)
    model.save(folder / "wing.h5")
    H, x, last = truth.static(), np.arange(0.025, 6, 0.05), model.loads[-1].label
    hang = np.where(x > 5.5, 400.0, 0.0)
    lift, sand = 900 * np.sqrt(1 - (x / 6) ** 2), 600 * (1 - x / 6)
    sacks = list(zip((c.label for c in model.loads), coarse(sand), strict=True))
    files: dict[str, tuple[np.ndarray, list[Any]]] = {
        "hang.csv": (hang, [(last, 400.0)]), "service.csv": (lift, []), "sand.csv": (sand, sacks),
        "cell.csv": (0.7 * lift, [("sum", coarse(0.7 * lift).sum())]), "later.csv": (hang, [(last, 400.0)]),
        "aged.csv": (1.3 * hang, [(last, 400.0)]), "swapped.csv": (-hang, [(last, 400.0)]), "plain.csv": (sand, []),
    }  # fmt: skip
    for name, (load, known) in files.items():
        readings = H @ load + NOISE * rng.standard_normal(len(PLACES))
        rows = [*((c.label, y) for c, y in zip(model.sensors, readings, strict=True)), *known]
        (folder / name).write_text("sensor,reading\n" + "".join(f"{label},{float(y)!r}\n" for label, y in rows))
    (folder / "wing.toml").write_text(
        'log = "service.csv"\nmodel = "wing.h5"\nfamily = "static"\npenalty = "second_difference"\n'
    )
    (folder / "report.pdf").write_bytes(b"%PDF tensile test")
    return model


def beam_job(folder: Path) -> None:
    """``model.h5``, ``log.csv`` and three hits with their hammer, simulated on twice the elements and more modes."""
    for seed in range(3):
        made = datasets.impact(seed=seed)
        table = np.column_stack([np.arange(len(made.record)) * made.record.dt, made.load, made.record.values])
        rows = "\n".join(",".join(repr(float(v)) for v in row) for row in table)
        (folder / f"hit{seed}.csv").write_text(f"time [s],hammer [N],12+Z [m/s^2]\n{rows}\n")
    datasets.impact(folder, seed=7).model.save(folder / "model.h5")
    (folder / "drawing.pdf").write_bytes(b"%PDF drawing")


def guide(*argv: object) -> int:
    """``loadid guide`` in this process."""
    return cli.main(["guide", *map(str, argv)])


def signed(folder: Path, steps: Iterable[int] = range(1, 11), *, evidence: dict[int, list[str]]) -> None:
    """Sign steps of the only job of a folder, which is the current one."""
    for number in steps:
        files = ["--evidence", *evidence[number]] if number in evidence else []
        assert guide("sign", number, *files, "--by", "A. Engineer") == 0, number


WING = {1: ["report.pdf"], 2: ["hang.csv"], 9: ["sand.csv", "cell.csv"], 10: ["later.csv"]}
