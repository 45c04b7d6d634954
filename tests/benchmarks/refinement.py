"""Refinement of a pad: what grows, what converges, and what added candidates bring.

Run ``python -m tests.benchmarks.refinement``. Pad 20 x 20 x 5 mm bonded at its base, B-bar, cells halved again and
again; 9 x 9 markers x 3 at a fixed depth below the top face, forces on all nodes of the top face as candidates.

The condition number grows as h^-2. It is taken of the stiffness with unit diagonal: without that, nodes of the free
face count half as much as those inside, an error that falls only as h (slope -1.8 at eight layers), and a block that
is bonded all round, without a free face, has -2 plainly. The singular values of H for tractions (in the L2 norm of the
face, through its boundary mass) converge; how many lie above the noise stays, however many candidates are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.linalg import solve_triangular
from scipy.sparse.linalg import LinearOperator, eigsh

from structures import Structure, sensors, solids
from structures._elements.members import Material
from structures._system.factor import Factor

LENGTHS, DEPTH, NOISE = (20e-3, 20e-3, 5e-3), 2.5e-3, 1e-2  # noise over the largest singular value
MATERIAL = Material(E=1e5, rho=1000.0, nu=0.45)


def pad(level: int) -> Structure:
    """Cells of 5 mm / 2^level."""
    n = 2**level
    return solids.block(lengths=LENGTHS, elements=(4 * n, 4 * n, n), material=MATERIAL)


def condition(structure: Structure, scaled: bool) -> float:
    """Largest over smallest eigenvalue of the stiffness on the free DOFs, with unit diagonal or as it is."""
    K = structure.K_free
    if scaled:
        scale = sparse.diags_array(1 / np.sqrt(K.diagonal()))
        K = (scale @ K @ scale).tocsr()
    factor = Factor(K)
    inverse = LinearOperator(K.shape, matvec=factor.solve, dtype=float)
    start = np.random.default_rng(0).standard_normal(K.shape[0])
    ends = [eigsh(op, 1, which="LA", return_eigenvectors=False, v0=start, tol=1e-6)[0] for op in (K, inverse)]
    return float(ends[0] * ends[1])


def responses(structure: Structure, markers: int = 9, depth: float = DEPTH) -> np.ndarray:
    """H of nodal forces on the top face: markers x markers x 3 rows at one depth."""
    places = np.linspace(2e-3, 18e-3, markers)
    rows = [
        sensors.Displacement(at=(x, y, LENGTHS[2] - depth), direction=d, label=f"{x} {y} {d}").row(structure)
        for x in places
        for y in places
        for d in ("+X", "+Y", "+Z")
    ]
    top = structure.field.surface("top").nodes  # type: ignore[union-attr]
    dofs = np.searchsorted(structure.free, (3 * top[:, None] + np.arange(3)).ravel())
    S = sparse.csr_array(np.array(rows)[:, structure.free])
    return Factor.of(structure).solve(S.T.toarray()).T[:, dofs]


def singular_values(structure: Structure, H: np.ndarray, cells: int) -> np.ndarray:
    """Singular values (m per Pa m) of the map from tractions, bilinear on cells x cells of the top face, to markers."""
    G = structure.field.surface("top").mass  # type: ignore[union-attr]
    x = np.linspace(0, cells, round(np.sqrt(G.shape[0])))
    hats = np.maximum(0, 1 - np.abs(x[:, None] - np.arange(cells + 1)))
    P = np.kron(hats, hats)  # traction at the nodes from that at the points of the coarser grid
    forces = G @ P
    # ||t||^2 = t^T P^T G P t = |C^T t|^2
    C = np.linalg.cholesky(P.T @ forces)
    B = solve_triangular(C, forces.T, lower=True).T
    return np.linalg.svd(H @ np.kron(B, np.eye(3)), compute_uv=False)


def growth(levels: Sequence[int], encased: bool = False) -> float:
    """Print the condition numbers; returns the slope over h of the two finest meshes."""
    faces = ("bottom", "top", "left", "right", "front", "back")
    print(f"\n{'Block bonded all round, K' if encased else 'Pad bonded at its base, K with unit diagonal'}")
    found, slope = [], np.nan
    for level in levels:
        structure = solids.block(
            lengths=(5e-3,) * 3 if encased else LENGTHS,
            elements=(2**level,) * 3 if encased else (4 * 2**level, 4 * 2**level, 2**level),
            material=MATERIAL,
            fixed=faces if encased else "bottom",
        )
        found.append(condition(structure, scaled=not encased))
        slope = -float(np.log2(found[-1] / found[-2])) if len(found) > 1 else np.nan
        print(f"h {5 / 2**level:6.4f} mm  cond(K) {found[-1]:8.1f}  slope {slope:5.2f}", flush=True)
    return slope


def meshes(levels: Sequence[int] = (1, 2, 3)) -> list[float]:
    """Print the leading values as mesh and candidates are refined; returns the largest changes over the first."""
    print("\nMesh refined: singular values of H, 9 x 9 markers x 3")
    values = []
    for level in levels:
        structure = pad(level)
        values.append(singular_values(structure, responses(structure), 4 * 2**level)[:10])
        leading = " ".join(f"{values[-1][k]:.4e}" for k in (0, 2, 5, 9))
        print(f"h {5 / 2**level:6.3f} mm  first, third, sixth, tenth: {leading}", flush=True)
    change = [float(np.abs(b - a).max() / b[0]) for a, b in pairwise(values)]
    print("largest change of the first ten, over the first: " + ", ".join(f"{c:.1e}" for c in change))
    return change


def candidates(
    level: int = 3,
    markers: int = 13,
    cells: Sequence[int] = (4, 8, 16, 32),
    depth: float = DEPTH,
    noise: float = NOISE,
) -> list[int]:
    """Print how many values lie above the noise as candidates are added on one mesh; returns the counts."""
    structure = pad(level)
    H = responses(structure, markers, depth)
    print(f"\nCandidates added on one mesh: {len(H)} readings, noise {noise:g} of the first singular value")
    counts: list[int] = []
    for c in cells:
        v = singular_values(structure, H, c)
        counts.append(int(np.sum(v > noise * v[0])))
        print(f"{3 * (c + 1) ** 2:6d} candidates, {counts[-1]:4d} values above the noise", flush=True)
    return counts


if __name__ == "__main__":
    growth((1, 2, 3))
    growth((2, 3, 4), encased=True)
    meshes()
    candidates()
