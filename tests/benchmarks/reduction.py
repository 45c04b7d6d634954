"""Reduction of large structures: CPU time, memory, and the stated error against the full model at small sizes.

    python -m tests.benchmarks.reduction             the error at small sizes, against the full model, both methods
    python -m tests.benchmarks.reduction plate 272   a plate of 272 x 272 cells, four unknowns a node: 297 024 DOFs
    python -m tests.benchmarks.reduction solid 220 150 2   trilinear bricks, clamped at x = 0: 298 980 DOFs
    python -m tests.benchmarks.reduction order plate 272   the factor alone, in both orders of elimination

CPU seconds of one thread; memory is the largest resident set of the process, assembly included.
"""

from __future__ import annotations

import os

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")

import resource
import sys
import time
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from structures import ForwardModel, Structure, beams, damping, loads, plates, sensors
from structures._models.substructure import METHODS, reduce

STEEL = beams.materials.steel
LIGHT = damping.Structural(0.02)


def plate(cells: int) -> tuple[Structure, list[str], float]:
    """A cantilever plate of 1 m and 2 mm, ten DOFs to keep, and a band with some thirty modes."""
    made = plates.plate(lengths=(1.0, 1.0), thickness=0.002, material=STEEL, elements=cells, edges="CFFF",
                        damping=LIGHT)  # fmt: skip
    rows = np.linspace(0.13, 0.97, 10) * cells
    keep = [f"{round(x) + (cells + 1) * round(y)}+Z" for x, y in zip(rows, np.roll(rows, 3), strict=True)]
    return made, keep, 100.0


def solid(*cells: int) -> tuple[Structure, list[str], float]:
    """Bricks of 5 mm, clamped at x = 0."""
    from skfem import Basis, ElementHex1, ElementVector, MeshHex
    from skfem.models.elasticity import lame_parameters, linear_elasticity
    from skfem.models.poisson import mass

    sides = [np.linspace(0, 0.005 * n, n + 1) for n in cells]
    mesh = MeshHex.init_tensor(*sides)
    basis = Basis(mesh, ElementVector(ElementHex1()), intorder=2)
    order = basis.nodal_dofs.T.ravel()
    K = linear_elasticity(*lame_parameters(STEEL.E, STEEL.nu)).assemble(basis)[order][:, order]
    M = sparse.kron(STEEL.rho * mass.assemble(Basis(mesh, ElementHex1(), intorder=2)), sparse.eye_array(3))
    held = np.flatnonzero(mesh.p[0] == 0)
    made = Structure.from_matrices(
        K, M, dofs=[(n, a) for n in range(mesh.p.shape[1]) for a in (1, 2, 3)],
        supports=[(int(n), a) for n in held for a in (1, 2, 3)], coordinates=mesh.p.T, damping=LIGHT,
    )  # fmt: skip
    top = np.flatnonzero(mesh.p[2] == mesh.p[2].max())
    spots = top[np.linspace(len(top) // 4, len(top) - 1, 10).astype(int)]
    return made, [f"{n}+Z" for n in spots], 400.0


def large(kind: str, *cells: int) -> None:
    """One large structure: time and memory of its reduction by modes."""
    started = time.process_time()
    structure, keep, band = (plate if kind == "plate" else solid)(*cells)
    print(f"{kind} {cells}: {structure.free.size} free DOFs, assembled in {time.process_time() - started:.0f} CPU s, "
          f"{memory():.2f} GB", flush=True)  # fmt: skip
    started = time.process_time()
    made = reduce(structure, keep, band, progress=lambda text: print(
        f"  {time.process_time() - started:6.1f} s  {memory():.2f} GB  {text}", flush=True))  # fmt: skip
    print(f"  {time.process_time() - started:6.1f} s  {memory():.2f} GB  done: {made}, "
          f"{np.sum(made.frequencies < band)} modes in the band")  # fmt: skip
    error = made.error()
    print(f"  bound over {band:g} Hz: worst line {error.normwise.max():.1e}, median {np.median(error.normwise):.1e}")


def memory() -> float:
    """Largest resident set so far (GB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def small() -> None:
    """The bound against the truth, on structures whose every line is solved for."""
    print("structure           method          vectors   true worst  median    bound worst  median    covered")
    for name, (structure, keep, band) in {"plate 24 x 24": plate(24), "bricks 20 x 12 x 1": solid(20, 12, 1)}.items():
        f = band * (np.arange(60) + 0.5) / 60
        S, B = [sensors.Displacement(k) for k in keep], [loads.Point(k) for k in keep]
        H = ForwardModel(structure, S, B).frf(f, method="direct")
        for method in METHODS:
            made = reduce(structure, keep, band, method=method)
            off = ForwardModel(made.structure, S, B).frf(f) - H
            true = np.linalg.norm(off, axis=(1, 2)) / np.linalg.norm(H, axis=(1, 2))
            bound = made.error(f)
            print(f"{name:19} {method:15} {made.structure.n:7}   {true.max():10.1e}  {np.median(true):.1e}   "
                  f"{bound.normwise.max():11.1e}  {np.median(bound.normwise):.1e}   "
                  f"{100 * np.mean(np.abs(off) <= bound.bound):.1f} %")  # fmt: skip


def order(kind: str, *cells: int) -> None:
    """Factor of the stiffness in minimum degree order and by nested dissection."""
    structure: Any = (plate if kind == "plate" else solid)(*cells)[0]
    K = structure.K_free.tocsc()
    options = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    for name in ("nested dissection", "minimum degree"):
        started = time.process_time()
        p = structure.elimination.order if name.startswith("nested") else None
        ordered = time.process_time() - started
        A, spec = (K, "MMD_AT_PLUS_A") if p is None else (K[p][:, p].tocsc(), "NATURAL")
        lu = splu(A, permc_spec=spec, **options)
        print(f"{name:18} {time.process_time() - started:6.1f} CPU s ({ordered:.1f} s to order), "
              f"{lu.nnz / 1e6:.0f} million entries, {memory():.2f} GB", flush=True)  # fmt: skip
        del lu


if __name__ == "__main__":
    words = sys.argv[1:]
    if not words:
        small()
    else:
        said = [int(w) if w.isdecimal() else w for w in words if w != "order"]
        (order if words[0] == "order" else large)(*said)
