"""Compliance of all surface DOFs of a pad: condensation against the routes that SciPy offers; reciprocity; memory.

Run ``python -m tests.benchmarks.pad``. Pad of 40 x 40 x 2 bricks bonded at its base, 10 086 free DOFs, 5043 of them on
the top face. Each route runs in a process of its own: CPU seconds, peak resident memory, and the error of three random
combinations of columns against conjugate gradients.
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from collections.abc import Callable

import numpy as np
from scipy import sparse
from scipy.linalg import blas, lapack
from scipy.sparse.linalg import LinearOperator, cg, splu

from structures import ForwardModel, Structure, sensors, solids
from structures._elements.members import Material
from structures._system.factor import Factor

CELLS = (40, 40, 2)
SYMMETRIC = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}


def pad(cells: tuple[int, int, int] = CELLS) -> Structure:
    """A silicone pad, B-bar."""
    return solids.block(lengths=(20e-3, 20e-3, 4e-3), elements=cells, material=Material(E=1e6, rho=1000.0, nu=0.48))


def surface(structure: Structure) -> np.ndarray:
    """Rows of the top DOFs among the free ones."""
    top = structure.field.surface("top").nodes  # type: ignore[union-attr]
    return np.searchsorted(structure.free, (3 * top[:, None] + np.arange(3)).ravel())


def schur(K: sparse.csc_array, s: np.ndarray) -> np.ndarray:
    """The best SciPy route: splu of the interior, potrf and potri of the dense rest; lower triangle only."""
    i = np.setdiff1d(np.arange(K.shape[0]), s)
    Kis, S = K[i][:, s].tocsc(), K[s][:, s].toarray(order="F")
    Ksi, lu = Kis.T.tocsr(), splu(K[i][:, i].tocsc(), **SYMMETRIC)
    for b in range(0, len(s), 128):
        S[:, b : b + 128] -= Ksi @ lu.solve(Kis[:, b : b + 128].toarray(order="F"))
    c, _ = lapack.dpotrf(S, lower=1, overwrite_a=1)
    A, _ = lapack.dpotri(c, lower=1, overwrite_c=1)
    return A


def all_solves(K: sparse.csc_array, s: np.ndarray, block: int, **settings: object) -> np.ndarray:
    """One sparse solve for each surface DOF, in blocks; only the surface rows are kept."""
    lu, A = splu(K, **settings), np.empty((len(s), len(s)), order="F")
    for b in range(0, len(s), block):
        columns = s[b : b + block]
        B = np.zeros((K.shape[0], len(columns)), order="F")
        B[columns, np.arange(len(columns))] = 1.0
        A[:, b : b + block] = lu.solve(B)[s]
    return A


ROUTES: dict[str, Callable] = {
    "Factor.compliance (ours)": lambda K, s: Factor(K).compliance(s),
    "Schur: splu + potrf/potri": schur,
    "splu, MMD_AT_PLUS_A, symmetric": lambda K, s: all_solves(K, s, 512, **SYMMETRIC),
    "splu, default COLAMD": lambda K, s: all_solves(K, s, 512),
    "Factor.transfer (ours)": lambda K, s: Factor(K).transfer(_units(K, s).T, _units(K, s)),
}


def _units(K: sparse.csc_array, s: np.ndarray) -> sparse.csc_array:
    return sparse.csc_array((np.ones(len(s)), (s, np.arange(len(s)))), shape=(K.shape[0], len(s)))


def independent(K: sparse.csc_array, B: np.ndarray) -> np.ndarray:
    """Conjugate gradients with a block of each node as preconditioner, to 1e-13."""
    n = K.shape[0] // 3
    blocks = sparse.bsr_array(K, blocksize=(3, 3))
    inner = np.zeros((n, 3, 3))
    for row in range(n):
        here = slice(blocks.indptr[row], blocks.indptr[row + 1])
        inner[row] = blocks.data[here][blocks.indices[here] == row][0]
    M = LinearOperator(K.shape, lambda v: np.linalg.solve(inner, v.reshape(n, 3, 1)).ravel())
    return np.column_stack([cg(K, b, rtol=1e-13, M=M, maxiter=20_000)[0] for b in B.T])


def measure(name: str, cells: tuple[int, int, int]) -> tuple[float, float, float]:
    """CPU seconds, peak memory (MB) above that of the model, worst relative error of one route."""
    structure = pad(cells)
    K, s = structure.K_free.tocsc(), surface(structure)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    A = ROUTES[name](K, s)
    spent, peak = time.process_time() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    b = np.random.default_rng(1).standard_normal((len(s), 3))
    B = np.zeros((K.shape[0], 3))
    B[s] = b
    X = independent(K, B)[s]
    error = blas.dsymm(1.0, A, b, lower=1) - X
    return spent, peak / 1024, float((np.linalg.norm(error, axis=0) / np.linalg.norm(X, axis=0)).max())


def compliance(cells: tuple[int, int, int] = CELLS, repeat: int = 2) -> dict[str, float]:
    """Print the table of all routes; returns their CPU seconds, best of `repeat`."""
    structure = pad(cells)
    print(f"\nSurface compliance, pad {cells}, {structure.free.size} free DOFs, {len(surface(structure))} on top")
    print(f"{'route':>32} {'CPU s':>7} {'peak MB':>8} {'error':>8}")
    found = {}
    for name in ROUTES:
        with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
            runs = [pool.apply(measure, (name, cells)) for _ in range(repeat)]
        found[name] = min(run[0] for run in runs)
        print(f"{name:>32} {found[name]:7.2f} {runs[0][1]:8.0f} {max(run[2] for run in runs):8.1e}", flush=True)
    ours = found["Factor.compliance (ours)"]
    best = min(value for name, value in found.items() if "splu" in name)
    print(f"ours over the best SciPy route: {ours / best:.2f} (to reach: at most 1.20)")
    return found


def reciprocity(solves: float, cells: tuple[int, int, int] = CELLS) -> float:
    """20 markers x 3 against all candidates on the top face, over the time of a solve for each candidate."""
    structure = pad(cells)
    K, s = structure.K_free.tocsc(), surface(structure)
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(4e-3, 16e-3, (20, 2)), np.full(20, 4e-3)])
    markers = [
        sensors.Displacement(at=tuple(x), direction=d, label=f"{i}{d}")
        for i, x in enumerate(places)
        for d in ("+X", "+Y", "+Z")
    ]
    S = sparse.csr_array(np.array([m.row(structure)[structure.free] for m in markers]))
    start = time.process_time()
    H = Factor(K).transfer(S, _units(K, s))
    spent = time.process_time() - start
    print(f"\n{len(markers)} marker rows against {len(s)} candidates: {spent:.2f} s with the factor, H {H.shape}")
    print(f"over a solve for each candidate: {spent / solves:.3f} (to reach: below 0.1)")
    return spent / solves


def forward(cells: tuple[int, int, int] = CELLS) -> float:
    """The same through ForwardModel with the nodal basis of the top face: CPU seconds from structure to H."""
    from structures import bases

    structure = pad(cells)
    basis = bases.nodal(structure, region="top", components=("+X", "+Y", "+Z"))
    markers = [
        sensors.Displacement(f"{node}{d}")
        for node in structure.field.surface("top").nodes[:: len(basis) // 63][:20]  # type: ignore[union-attr]
        for d in ("+X", "+Y", "+Z")
    ]
    start = time.process_time()
    H = ForwardModel(structure, markers, basis).static()
    spent = time.process_time() - start
    print(f"ForwardModel(pad, {len(markers)} rows, {len(basis)} candidates).static(): {spent:.2f} s, H {H.shape}")
    return spent


if __name__ == "__main__":
    times = compliance()
    reciprocity(times["splu, MMD_AT_PLUS_A, symmetric"])
    forward()
