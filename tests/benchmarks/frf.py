"""Inversion of 2000 FRF lines beside what users take. `python -m tests.benchmarks.frf [--quick] [--peer PYTHON]`.

The plate of `tests.frfplate`: 20 responses, 5 forces of which two are close and one is silent, 30 dB of noise and an
FRF that errs by 0.2 % in frequency and 10 % in damping, as accelerance, mobility and receptance. Relative load error of
a line: median (med); of all lines (glob); what leaks into the silent force (leak). CPU seconds of one thread, medians
of some runs, ours before and after those of the peer. Nobody tells the noise level. "Loads and std" is the default rule
alone; "whole estimate" is the public interface, which asks all other rules too and raises its flags. forcefinder
(GPL-3) runs in its own environment, whose interpreter ``--peer`` or the variable FORCEFINDER_PYTHON names; ``--quick``
leaves out its cross-validation.

Ends with 1 if a figure misses its limit.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import FrequencyInversion, Spectra
from loadid._families.posing.fitting import LineRule, fit
from loadid._inverse import rules
from loadid._inverse.spectral import LinesPath, compress, factor
from loadid.paths import Sweep
from loadid.settings import Lambda
from structures import FrfModel
from tests import frfplate
from tests.frfplate import KINDS, Lines

DEFAULT, CORE = "loadid, whole estimate", "loadid, loads and std"
OURS: dict[str, dict[str, Any]] = {
    DEFAULT: {},
    "loadid, GCV of neighbours": {"choice": "gcv"},
    "loadid, GCV per line": {"choice": Lambda("gcv", over="line")},
    "loadid, L-curve per line": {"choice": Lambda("l_curve", over="line")},
    "loadid, TSVD by GCV": {"choice": Lambda(method="tsvd")},
}
PEER_DEFAULT, PEER_VALIDATION = "forcefinder, L-curve (default)", "forcefinder, LOO cross-validation"
LIMITS = {"accelerance": (0.145, 0.40), "mobility": (0.200, 0.26), "receptance": (0.75, 1.0)}  # med, glob
FASTER = {PEER_DEFAULT: 3.0, PEER_VALIDATION: 60.0}
PINVS, SCALES, SAME = 6.0, (1e-6, 1e-3, 1e3, 1e6), 1e-9


@dataclass(frozen=True)
class Row:
    """Scores of one method for each kind of FRF, and its CPU seconds (median over the kinds; nan: not a method)."""

    name: str
    scores: dict[str, dict[str, float]]
    seconds: float

    def __str__(self) -> str:
        cells = [f"{s['med']:6.3f}{s['glob']:7.3f}{s['leak']:6.2f}" for s in self.scores.values()]
        return f"{self.name:34s}{self.seconds:8.3f}   " + "   ".join(cells)


def cpu(action: Callable[[], object], repeat: int) -> float:
    """Median of CPU seconds over some runs."""
    taken = []
    for _ in range(repeat):
        start = time.process_time()
        action()
        taken.append(time.process_time() - start)
    return float(np.median(taken))


def made(kind: str, case: Lines) -> tuple[FrfModel, Spectra]:
    """Model and data as the package takes them."""
    return FrfModel.from_frf(case.frequencies, case.H, kind=kind), Spectra(case.frequencies, case.Y)


def ours(kind: str, case: Lines, **settings: Any) -> NDArray[np.complex128]:
    """The load by the public interface, which also gives std, flags, and the voices of all rules."""
    model, spectra = made(kind, case)
    return FrequencyInversion(model, **settings).estimate(spectra).load


def plain(cases: dict[str, Lines], repeat: int) -> list[Row]:
    """The best that the truth allows, and what a user writes with numpy."""
    methods: dict[str, Callable[[Lines], NDArray]] = {
        "best lambda of each line (truth)": frfplate.oracle,
        "numpy pinv": lambda c: frfplate.pinv(c.H, c.Y),
        "numpy Tikhonov, L-curve": lambda c: frfplate.l_curve(c.H, c.Y),
        "numpy Tikhonov, GCV": lambda c: frfplate.gcv(c.H, c.Y),
    }
    rows = []
    for name, run in methods.items():
        scores = {kind: case.scores(run(case)) for kind, case in cases.items()}
        timed = [] if run is frfplate.oracle else [cpu(partial(run, case), repeat) for case in cases.values()]
        rows.append(Row(name, scores, float(np.median(timed)) if timed else float("nan")))
    return rows


def core(case: Lines) -> NDArray[np.complex128]:
    """Loads, with the std of every line and load, by the default rule and nothing else."""
    scale = np.full(case.Y.shape, np.mean(np.abs(case.Y) ** 2))
    found = fit(case.H, case.Y[..., None], scale, known=False, rule=LineRule())
    assert found.variance.shape == case.truth.shape
    return found.load[..., 0]


def package(cases: dict[str, Lines], repeat: int) -> list[Row]:
    """The package's methods."""
    runs: dict[str, Callable[[str], NDArray]] = {CORE: lambda kind: core(cases[kind])}
    for name, settings in OURS.items():
        ready = {kind: made(kind, case) for kind, case in cases.items()}
        runs[name] = partial(_estimated, ready, settings)
    return [
        Row(name, {kind: case.scores(run(kind)) for kind, case in cases.items()},
            float(np.median([cpu(partial(run, kind), repeat) for kind in cases])))
        for name, run in runs.items()
    ]  # fmt: skip


def _estimated(ready: dict[str, tuple[FrfModel, Spectra]], settings: dict[str, Any], kind: str) -> NDArray:
    model, spectra = ready[kind]
    return FrequencyInversion(model, **settings).estimate(spectra).load


def both(first: list[Row], again: list[Row]) -> list[Row]:
    """Rows with the mean time of two passes."""
    return [replace(a, seconds=0.5 * (a.seconds + b.seconds)) for a, b in zip(first, again, strict=True)]


def peer_python(arguments: list[str]) -> Path | None:
    """Interpreter of the environment where forcefinder is installed, if anybody named one."""
    named = arguments[arguments.index("--peer") + 1] if "--peer" in arguments[:-1] else None
    found = named or os.environ.get("FORCEFINDER_PYTHON")
    return Path(found) if found else None


def peer(cases: dict[str, Lines], python: Path, quick: bool) -> list[Row]:
    """forcefinder's methods, run as a child on the same numbers."""
    data: dict[str, Any] = {"names": np.array(list(cases)), "frequencies": cases["mobility"].frequencies}
    data |= {f"{k}:{part}": getattr(c, part) for k, c in cases.items() for part in ("H", "Y")}
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "problems.npz"), Path(folder, "loads.npz")
        np.savez(source, **data)
        script = Path(__file__).with_name("frf_peer.py")
        run = [str(python), str(script), str(source), str(target), *(["--quick"] if quick else [])]
        subprocess.run(run, check=True, capture_output=True)
        with np.load(target) as found:
            loads = dict(found)
    methods = dict.fromkeys(key.split(":")[1] for key in loads)
    return [
        Row(
            f"forcefinder, {m}",
            {k: c.scores(loads[f"{k}:{m}:load"]) for k, c in cases.items()},
            float(np.median([loads[f"{k}:{m}:seconds"][0] for k in cases])),
        )
        for m in methods
    ]


def every_rule(case: Lines) -> dict[str, NDArray]:
    """Lambda of every line by each of the rules, each line on its own, from bare arrays."""
    whitened = case.H / case.sigma, case.Y / case.sigma
    lines = factor(compress(*whitened), np.ones((len(case.H), case.H.shape[2])))
    sweep = Sweep.over(LinesPath(lines), 1.0)
    asked = {name: rules.run(name, sweep) for name in rules.RULES}
    return {name: found.lines for name, found in asked.items() if found.lines is not None}


def moved(cases: dict[str, Lines]) -> dict[str, float]:
    """Largest relative change of the load when FRF and data are scaled, over kinds and scales, of each method."""
    out = {}
    for name, settings in OURS.items():
        worst = 0.0
        for kind, case in cases.items():
            load = ours(kind, case, **settings)
            for scale in SCALES:
                other = ours(kind, case.scaled(scale), **settings)
                worst = max(worst, float(np.linalg.norm(other - load) / np.linalg.norm(load)))
        out[name] = worst
    return out


def judged(rows: dict[str, Row], change: dict[str, float], rules: float) -> list[tuple[str, float, str, float, bool]]:
    """Every figure with its limit: name, figure, sign, limit, met."""
    found, mine, solved = [], rows[DEFAULT], rows[CORE].seconds
    for kind, (med, glob) in LIMITS.items():
        for score, limit in (("med", med), ("glob", glob)):
            found.append((f"{kind}, {score}", mine.scores[kind][score], "<=", limit))
    for name, limit in FASTER.items():
        if name in rows:
            found.append((f"{name} over loads and std, time", rows[name].seconds / solved, ">=", limit))
    found.append(
        ("whole estimate with all rules over pinv, time", mine.seconds / rows["numpy pinv"].seconds, "<=", PINVS)
    )
    found.append(("every rule on every line over pinv, time", rules / rows["numpy pinv"].seconds, "<=", PINVS))
    found.append(("change of the load with the units", max(change.values()), "<=", SAME))
    return [(n, v, s, limit, v <= limit if s == "<=" else v >= limit) for n, v, s, limit in found]


def main(arguments: list[str]) -> int:
    """Print the tables."""
    quick, repeat = "--quick" in arguments, 5
    cases = {kind: frfplate.lines(kind) for kind in KINDS}
    heads = "   ".join(f"{kind:>19s}" for kind in KINDS)
    print(f"{'2000 lines, 20 responses, 5 forces':34s}{'CPU s':>8s}   {heads}")
    print(" " * 45 + "   ".join(["   med   glob  leak"] * 3))
    rows, python = plain(cases, repeat) + package(cases, repeat), peer_python(arguments)
    if python is not None:
        beside = peer(cases, python, quick)
        rows = both(rows, plain(cases, repeat) + package(cases, repeat)) + beside
    for row in rows:
        print(row)
    if python is None:
        print("forcefinder: no environment was named (--peer PYTHON or FORCEFINDER_PYTHON): not run")
    rules = float(np.median([cpu(partial(every_rule, case), repeat) for case in cases.values()]))
    table = judged({row.name: row for row in rows}, moved(cases), rules)
    print()
    for name, value, sign, limit, met in table:
        print(f"{name:58s}{value:10.3g}  {sign} {limit:<8g}{'' if met else 'MISSED'}")
    return 0 if all(row[-1] for row in table) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
