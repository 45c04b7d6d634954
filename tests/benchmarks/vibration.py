"""The vibration laboratory beside forcefinder, sdynpy and pyFBS: the same cases, the same figures, one table.

``python -m tests.benchmarks.vibration``, with ``--forcefinder PYTHON`` and ``--pyfbs PYTHON`` (or LOADID_FORCEFINDER
and LOADID_PYFBS), the Python of an environment where forcefinder with sdynpy, or pyFBS, is installed; else it says "not
installed". A field and a laboratory (`tests.lab`): the tools get FRFs that are 2 % of every entry wrong, the exact ones
judge. Then a source on a plate with blocked forces in closed form (`tests.mounted`).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import Record, Spectra
from loadid.vibration import (
    Drives,
    Limit,
    Target,
    VirtualPoint,
    buzz,
    by_buzz,
    find_drives,
    split_record,
    transfer_paths,
)
from loadid.vibration._paths import at_points
from structures import CrossSpectra, FrfModel

from .. import lab, mounted
from ..linecases import normals

PEER = Path(__file__).with_name("vibration_peer.py")
ERROR = 0.02  # of every entry of the FRFs that the tools get
HALF = 80.0  # N rms that shaker 2 may have; without a limit it takes about 160
UP = (0.0, 0.0, 1.0)
COUNT = len(lab.TARGET)
ORDER = [*lab.TARGET, *lab.KEPT]


def known() -> FrfModel:
    """The FRFs that the tools get."""
    exact = lab.part(lab.shaken(), tuple(ORDER))
    H = exact.H * (1 + ERROR * normals(np.random.default_rng(0), *exact.H.shape))
    return FrfModel(exact.frequencies, H, sensors=exact.sensors, loads=exact.loads)


def judged(S: NDArray[Any]) -> tuple[float, float, float, float]:
    """Errors on the target and on the sensors kept out (dB rms), power (N^2), largest density of the limit channel."""
    exact = lab.part(lab.shaken(), tuple(ORDER))
    made = np.einsum("ksi,kij,ksj->ks", exact.H, S, exact.H.conj()).real
    field = lab.field().restricted(ORDER).autospectra
    error = 10 * np.log10(made / field)
    off = [float(np.sqrt(np.mean(part**2))) for part in (error[:, :COUNT], error[:, COUNT:])]
    step = float(np.diff(exact.frequencies)[0])
    return off[0], off[1], step * float(np.einsum("kii->", S).real), float(made[:, COUNT].max())


def timed(run: Callable[[], Any]) -> tuple[Any, float]:
    """What a call returns, and the least of three CPU times."""
    spent, found = [], None
    for _ in range(3):
        start = time.process_time()
        found = run()
        spent.append(time.process_time() - start)
    return found, min(spent)


def turned_down(drives: Drives, limits: list[Limit]) -> Drives:
    """The drives with one factor that keeps the limit of a single drive: what a gain knob does."""
    (limit,) = limits
    assert limit.rms is not None
    now = float(drives.rms[[c.label for c in drives.loads].index(limit.channel)])
    assert drives.matrix is not None
    return replace(drives, matrix=drives.matrix * min(1.0, limit.rms / now) ** 2)


def ours(most: float, most_of_shaker: float) -> dict[str, tuple[Any, float]]:
    """Case and method -> drives or forces, and CPU seconds."""
    m, field = known(), lab.field().restricted(list(lab.TARGET))
    target = Target(field.frequencies, field.autospectra, field.channels)
    predicted = buzz(m.with_sensors(range(COUNT)), field.frequencies)
    halved = [Limit("shaker 2", rms=most_of_shaker)]
    calls: dict[str, Callable[[], Drives]] = {
        "asd|loadid, autospectra alone": lambda: find_drives(m, target),
        "asd|loadid, buzz": lambda: find_drives(m, by_buzz(target, predicted)),
        "asd|loadid, buzz, match trace": lambda: find_drives(m, by_buzz(target, predicted)).match_trace(),
        "cpsd|loadid": lambda: find_drives(m, field),
        "limit|loadid, autospectra alone": lambda: find_drives(m, target, limits=[Limit("k1", density=most)]),
        "drive|loadid, autospectra alone": lambda: find_drives(m, target, limits=halved),
        "drive|loadid, buzz": lambda: find_drives(m, by_buzz(target, predicted), limits=halved),
        "drive|all drives turned down": lambda: turned_down(find_drives(m, by_buzz(target, predicted)), halved),
        "limit|loadid, buzz": lambda: find_drives(m, by_buzz(target, predicted), limits=[Limit("k1", density=most)]),
    }
    found = {name: timed(call) for name, call in calls.items()}
    return {name: (drives.matrix, seconds) for name, (drives, seconds) in found.items()}


def shared(case: mounted.Mounted, most: float) -> dict[str, Any]:
    """What the peers get."""
    m = known()
    order = [*(n for n in mounted.SEEN if n not in mounted.KEPT), *mounted.KEPT]
    rows = [list(mounted.SEEN).index(n) for n in order]
    return {
        "f": m.frequencies, "H": m.H, "S": lab.field().restricted(ORDER).matrix, "training": COUNT, "most": most,
        "tpa_f": case.model.frequencies, "tpa_H": case.model.H[:, rows], "tpa_Y": case.operation[:, rows],
        "tpa_T": at_points(case.model, [foot()]).T, "tpa_training": len(rows) - len(mounted.KEPT),
        "tpa_hits": np.array(list(mounted.HITS.values())),
    }  # fmt: skip


def foot() -> VirtualPoint:
    """The virtual point of the source."""
    return VirtualPoint("foot", {n: (p, UP) for n, p in mounted.HITS.items()}, motions=("Z", "RX", "RY"))


def peers(python: str | None, package: str, data: dict[str, Any]) -> dict[str, tuple[Any, float]]:
    """Answers of a package in its own environment; none where there is none."""
    if not python or subprocess.run([python, "-c", f"import {package}"], capture_output=True,
                                    env={**os.environ, "QT_QPA_PLATFORM": "offscreen"}).returncode:  # fmt: skip
        sys.stdout.write(f"{package}: not installed (--{package} PYTHON)\n")
        return {}
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "cases.npz", Path(folder) / "answers.npz"
        np.savez(source, **data)
        subprocess.run([python, str(PEER), package, str(source), str(target)], check=True,
                       stderr=sys.stderr, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"})  # fmt: skip
        found = np.load(target)
        return {name: (found[name], float(found[f"{name}|s"])) for name in found.files if not name.endswith("|s")}


def of_paths(case: mounted.Mounted) -> dict[str, tuple[Any, float]]:
    """Our blocked forces."""
    data = Spectra(case.model.frequencies, case.operation, case.model.sensors)
    found, seconds = timed(lambda: transfer_paths(case.model, data, points=[foot()], validation=mounted.KEPT))
    return {"tpa|loadid": (found.estimate.load, seconds)}


def judged_paths(case: mounted.Mounted, force: NDArray[Any]) -> tuple[float, float, float]:
    """Relative error of the blocked loads (median of the lines), error on the sensors kept out (dB rms), idle load."""
    exact = at_points(mounted.made(noise=0.0).model, [foot()])
    rows = [list(mounted.SEEN).index(n) for n in mounted.KEPT]
    clean = mounted.made(noise=0.0).operation[:, rows]
    made = np.einsum("ksj,kj->ks", exact.frf(case.model.frequencies)[:, rows], force)
    scale = np.array([1.0, 0.03, 0.03])  # moments by an arm of 30 mm
    off = np.linalg.norm((force[:, :3] - case.blocked) / scale, axis=1) / np.linalg.norm(case.blocked / scale, axis=1)
    error = 20 * np.log10(np.abs(made) / np.abs(clean))
    idle = float(np.sqrt(np.mean(np.abs(force[:, 3]) ** 2) / np.mean(np.abs(case.blocked[:, 0]) ** 2)))
    return float(np.median(off)), float(np.sqrt(np.mean(error**2))), idle


def halves() -> str:
    """Sample splitting: drives from one half of a record, their response held against the other half."""
    rng, field = np.random.default_rng(1), lab.field(480)
    S = field.restricted(list(lab.TARGET)).matrix
    step = float(np.diff(field.frequencies)[0])
    lines = int(np.ceil(1000 / step))
    first = round(field.frequencies[0] / step)
    blocks, n = 60, 2 * lines
    w, V = np.linalg.eigh(S)
    root = V * np.sqrt(np.maximum(w, 0))[:, None, :]
    spectrum = np.zeros((lines * blocks + 1, COUNT), complex)
    for k in range(len(S)):  # every fine line beside a coarse one
        at = (first + k) * blocks + np.arange(blocks) - blocks // 2
        spectrum[at] = normals(rng, blocks, COUNT) @ root[k].T
    record = Record(np.fft.irfft(spectrum, axis=0) * np.sqrt(n * blocks * lines * step), 1 / (2 * lines * step),
                    [*field.restricted(list(lab.TARGET)).channels])  # fmt: skip
    one, two = split_record(record, 2, segment=n)
    inside = (one.frequencies > 70) & (one.frequencies < 890)
    parts = [x.lines(inside) for x in (one, two)]
    model = FrfModel.of(lab.part(lab.shaken(480), lab.TARGET), lab.shaken(480).frequencies)
    near = [int(np.argmin(np.abs(model.frequencies - f))) for f in parts[0].frequencies]
    table = FrfModel(parts[0].frequencies, model.H[near], sensors=model.sensors, loads=model.loads)
    rows, one = [], parts[0]
    alone = Target(one.frequencies, one.autospectra, model.sensors)
    whole = CrossSpectra(one.frequencies, one.matrix, channels=model.sensors, averages=one.averages)
    targets: dict[str, Target | CrossSpectra] = {"its autospectra": alone, "its cross spectra": whole}
    for name, target in targets.items():
        drives = find_drives(table, target)
        held = np.sqrt(np.mean(drives.errors_on(table, parts[1].autospectra) ** 2))
        rows.append(f"{name}: {drives.rms_error:.2f} dB on that half, {held:.2f} on the other")
    apart = 10 * np.log10(parts[0].autospectra / parts[1].autospectra)
    return f"{'; '.join(rows)}; the halves differ by {np.sqrt(np.mean(apart**2)):.2f} dB"


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--forcefinder", default=os.environ.get("LOADID_FORCEFINDER"), help="Python that has it")
    options.add_argument("--pyfbs", default=os.environ.get("LOADID_PYFBS"), help="Python that has it")
    chosen = options.parse_args()
    most = 0.2 * float(lab.field().restricted(["k1"]).autospectra.max())
    case = mounted.made()
    data = shared(case, most)
    found = {**ours(most, HALF), **of_paths(case)}
    found |= peers(chosen.forcefinder, "forcefinder", data) | peers(chosen.pyfbs, "pyfbs", data)
    titles = {"asd": "autospectra of eight sensors are given", "cpsd": "their cross spectra are given",
              "drive": f"as the first, and shaker 2 stays below {HALF:g} N rms",
              "limit": f"as the first, and k1 stays below {most:.3g} (m/s^2)^2/Hz"}  # fmt: skip
    for key, title in titles.items():
        sys.stdout.write(f"\n{title}\n{'':34s}{'target dB':>10s}{'kept dB':>9s}{'power N^2':>11s}"
                         f"{'k1 most':>10s}{'CPU s':>8s}\n")  # fmt: skip
        for name, (S, seconds) in found.items():
            if name.startswith(f"{key}|"):
                on, kept, power, k1 = judged(S)
                sys.stdout.write(
                    f"{name.split('|')[1]:34s}{on:10.2f}{kept:9.2f}{power:11.3g}{k1:10.3g}{seconds:8.3f}\n"
                )
    sys.stdout.write(f"\nblocked forces of a source\n{'':34s}{'forces':>10s}{'kept dB':>9s}{'idle':>8s}{'CPU s':>8s}\n")
    for name, (force, seconds) in found.items():
        if name.startswith("tpa|"):
            off, kept, idle = judged_paths(case, force)
            sys.stdout.write(f"{name.split('|')[1]:34s}{off:10.1%}{kept:9.2f}{idle:8.1%}{seconds:8.3f}\n")
    sys.stdout.write(f"\nsample splitting: {halves()}\n")


if __name__ == "__main__":
    main()
