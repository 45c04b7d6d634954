"""Rational Krylov reduction beside a direct solve per line and beside modes, on the cantilever plate of 10 200 DOFs.

Run ``python -m tests.benchmarks.krylov``; it prints tables, CPU seconds, medians. The direct sweep is measured on the
lines that test most: some over the band, every natural frequency, and the deepest antiresonance of every entry;
``--all`` solves all 1000 (minutes). One thread: set OPENBLAS_NUM_THREADS=1.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from structures import ForwardModel, Structure

from .forward import model, plate

LINES = np.linspace(1.0, 1000.0, 1000)
REPEAT = 3


def median(work: Callable[[], Any], repeat: int = REPEAT) -> tuple[float, Any]:
    """Median CPU time of some runs, and the last result."""
    times = []
    for _ in range(repeat):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return float(np.median(times)), result


def fresh(structure: Structure, **settings: Any) -> ForwardModel:
    """A model that has computed nothing yet."""
    return model(structure.with_damping(structure.damping), **settings)


def telling(H: NDArray, natural: NDArray) -> NDArray[np.intp]:
    """Lines that test a reduction most: spread ones, resonances, and the deepest antiresonance of every entry."""
    spread = np.linspace(0, len(LINES) - 1, 14).round().astype(int)
    peaks = [int(np.argmin(np.abs(LINES - f))) for f in natural]
    return np.unique(np.concatenate([spread, peaks, np.abs(H).argmin(axis=0).ravel()]))


def bare(structure: Structure, m: ForwardModel, f: float) -> NDArray[np.complex128]:
    """One line as a user writes it with scipy: symmetric ordering, one factor, one solve."""
    omega = 2 * np.pi * f
    D = structure.K_free - omega**2 * structure.M_free + 1j * omega * structure.C_free
    factor = splu(
        sparse.csc_matrix(D), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return m._S @ factor.solve(m.columns.toarray().astype(complex))


def sweep(cells: int = 50, every: bool = False) -> dict[str, float]:
    """Speed and error of the reductions against the direct sweep; returns the figures of the Krylov one."""
    structure = plate(cells)
    setup, _ = median(lambda: fresh(structure, reduction="krylov", band=1000.0).reduced)
    krylov = fresh(structure, reduction="krylov", band=1000.0)
    total, H = median(lambda: fresh(structure, reduction="krylov", band=1000.0).frf(LINES))
    checked = np.arange(len(LINES)) if every else telling(H, krylov.natural_frequencies)
    times, exact = [], []
    for f in LINES[checked]:
        seconds, line = median(lambda f=f: krylov.frf([f], method="direct")[0], repeat=1)
        times.append(seconds)
        exact.append(line)
    D, direct = np.array(exact), float(np.median(times)) * len(LINES)
    plain = len(LINES) * float(np.median([median(lambda f=f: bare(structure, krylov, f), 1)[0] for f in LINES[::80]]))
    shown = "all lines" if every else f"{len(checked)} lines measured, median per line x {len(LINES)}"
    print(f"\nPlate of {structure.free.size} DOFs, lines 1, 2 .. 1000 Hz, {H.shape[1]} sensors, {H.shape[2]} loads")
    print(f"direct, frf(method='direct'): {direct:7.1f} s ({shown})")
    print(f"direct, bare scipy splu:      {plain:7.1f} s (13 lines measured)")
    heads = ("set-up s", "all s", "direct/all", "splu/all", "entry", "99 %", "line")
    print("{:>26} {:>9} {:>7} {:>11} {:>9} {:>9} {:>9} {:>9}".format("reduction", *heads))

    def row(name: str, ready: float, all_: float, got: NDArray) -> float:
        error = np.abs(got[checked] - D)
        entry = error / np.abs(D)
        line = np.linalg.norm(error, axis=(1, 2)) / np.linalg.norm(D, axis=(1, 2))
        print(
            f"{name:>26} {ready:9.2f} {all_:7.2f} {direct / all_:11.0f} {plain / all_:9.0f} {entry.max():9.1e} "
            f"{np.quantile(entry, 0.99):9.1e} {line.max():9.1e}"
        )
        return float(entry.max())

    entry = row("krylov", setup, total, H)
    for count in (30, 60, 120):
        once, _ = median(lambda count=count: fresh(structure, modes=count).reduced, repeat=1)
        both, got = median(lambda count=count: fresh(structure, modes=count).frf(LINES), repeat=1)
        row(f"{count} modes + static residual", once, both, got)
    depth = np.abs(H).max(axis=0) / np.abs(H).min(axis=0)
    print(f"antiresonances: the entries fall to between 1/{depth.min():.0f} and 1/{depth.max():.0f} of their peaks")
    error = krylov.reduction_error(LINES)
    true = np.abs(H[checked] - D)
    ratio = error.bound[checked] / true
    print(f"krylov: depth {krylov.krylov.depth}, {krylov.krylov.projection.theta.size} vectors")
    print(
        f"stated on all {len(LINES)} lines: entry {error.entrywise.max():.1e} (truncation "
        f"{(error.truncation / error.size).max():.1e}), line {error.normwise.max():.1e}; "
        f"stated over true error {ratio.min():.1f} to {np.median(ratio):.0f} (median)"
    )
    return {"direct": direct / total, "splu": plain / total, "entry": entry, "stated": float(ratio.min())}


def growth(counts: tuple[int, ...] = (1, 5, 10, 20, 40), cells: int = 36) -> None:
    """Set-up over the number of loads: where modes take over."""
    structure = plate(cells)
    modal, _ = median(lambda: fresh(structure, modes=120).reduced, repeat=1)
    print(f"\nSet-up over the loads ({structure.free.size} DOFs, 60 sensors, band 1000 Hz); 120 modes: {modal:.2f} s")
    print(f"{'loads':>6} {'vectors':>8} {'set-up s':>9} {'stated entry error':>19}")
    for count in counts:
        m = model(structure, 60, count, reduction="krylov", band=1000.0)
        seconds, basis = median(lambda m=m: m.krylov, repeat=1)
        print(f"{count:6d} {basis.projection.theta.size:8d} {seconds:9.2f} {basis.estimate:19.1e}")


if __name__ == "__main__":
    sweep(every="--all" in sys.argv[1:])
    growth()
