"""Solids assembled by scikit-fem and by ours, values and time: ``python -m tests.benchmarks.assembly``.

One process, CPU seconds, the best of three; stiffness and mass together, from nodes and cells. ``apart`` is the largest
difference of an entry over the largest entry.

====================  ======  ========  ========  =====  =======  =======
solid                   DOFs    ours s  skfem s   ratio  K apart  M apart
====================  ======  ========  ========  =====  =======  =======
block, standard        16575      0.31      1.90   6.14  3.6e-15  4.3e-15
hexahedra, standard    16575      0.41      1.59   3.91  3.2e-15  3.3e-15
block, bbar            16575      0.29      1.47   5.17  3.2e-15  4.3e-15
hexahedra, bbar        16575      0.39      1.48   3.79  3.0e-15  3.3e-15
tetrahedra             16575      0.45      1.24   2.73  3.9e-15  4.2e-15
====================  ======  ========  ========  =====  =======  =======

The values agree to rounding, and scikit-fem takes 2.7 to 6 times as long: ours carries the solids, and scikit-fem is
what tests hold it against (`tests/structures/test_assembly.py`). A block has one matrix for all its cells.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

from structures import Structure, solids
from structures._elements.cells import HEX8
from structures._elements.members import Material

GEL = Material(E=2e5, rho=1e3, nu=0.45)
ORDER = [0, 1, 3, 2, 4, 5, 7, 6]  # corners i + 2 j + 4 k in cyclic order


def hexahedra(block: Structure) -> np.ndarray:
    """The cells of a block in the order of Abaqus."""
    field: Any = block.field
    i, j, k = (m.ravel() for m in np.meshgrid(*(np.arange(line.elements) for line in field.lines), indexing="ij"))
    return field.corners(i, j, k)[:, ORDER]


def tetrahedra(n: tuple[int, int, int], sides: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """A box of ten-node tetrahedra: six for each of n boxes (Kuhn), nodes in the middle of all sides."""
    boxes = np.array(n)
    lattice = np.array(list(np.ndindex(*(2 * boxes + 1))))
    number = {tuple(p): i for i, p in enumerate(lattice)}
    cells = []
    for corner in np.ndindex(*boxes):
        start = 2 * np.array(corner)
        for path in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
            p = [start]
            for axis in path:
                p.append(p[-1] + 2 * np.eye(3, dtype=int)[axis])
            if np.linalg.det(np.array([p[1] - p[0], p[2] - p[0], p[3] - p[0]])) < 0:
                p[1], p[2] = p[2], p[1]
            middles = [(p[a] + p[b]) // 2 for a, b in ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))]
            cells.append([number[tuple(q)] for q in (*p, *middles)])
    used, local = np.unique(cells, return_inverse=True)
    return lattice[used] / (2 * boxes) * sides, local.reshape(-1, 10)


def skewed(places: np.ndarray, step: float, seed: int = 0, share: float = 0.12) -> np.ndarray:
    """Nodes moved at random by a share of a step, everything sheared: no cell stays a box."""
    rng = np.random.default_rng(seed)
    moved = places + share * step * rng.uniform(-1, 1, places.shape)
    return moved @ np.array([[1, 0.1, 0], [0, 1, 0.2], [0.1, 0, 1]])


# -- scikit-fem -------------------------------------------------------------------------------------------------------
def basis_of(places: np.ndarray, cells: np.ndarray) -> Any:
    """The vector basis of scikit-fem on the same nodes and cells, with the quadrature of ours for the stiffness."""
    import skfem

    if cells.shape[1] == 10:
        corners, local = np.unique(cells[:, :4], return_inverse=True)
        grid = skfem.MeshTet(places[corners].T, local.reshape(-1, 4).T)
        return skfem.Basis(grid, skfem.ElementVector(skfem.ElementTetP2()), intorder=2)
    ours = {tuple(s): i for i, s in enumerate((HEX8.points > 0).astype(int))}
    order = [ours[tuple(p)] for p in skfem.refdom.RefHex.p.T.astype(int)]
    return skfem.Basis(skfem.MeshHex(places.T, cells.T[order]), skfem.ElementVector(skfem.ElementHex1()), intorder=3)


def assembled(places: np.ndarray, cells: np.ndarray, element: str = "standard") -> tuple[Any, Any, Any]:
    """Stiffness and mass by scikit-fem, in its own order of DOFs, and its basis."""
    from skfem import Basis, BilinearForm, ElementHex0
    from skfem.helpers import ddot, div, dot, eye, sym_grad, trace

    basis = basis_of(places, cells)
    mu, kappa = GEL.E / 2 / (1 + GEL.nu), GEL.E / 3 / (1 - 2 * GEL.nu)
    bulk = kappa if element == "standard" else 0.0

    @BilinearForm
    def stiffness(u, v, _):
        e = sym_grad(u)
        return 2 * mu * ddot(e - eye(trace(e), 3) / 3, sym_grad(v)) + bulk * div(u) * div(v)

    K = stiffness.assemble(basis)
    if element == "bbar":
        means = basis.with_element(ElementHex0())
        D = BilinearForm(lambda u, q, _: div(u) * q).assemble(basis, means)
        volume = BilinearForm(lambda p, q, _: p * q).assemble(means).diagonal()
        K = K + D.T @ sparse.diags_array(kappa / volume) @ D
    # products of quadratic functions want more points than the stiffness
    whole = Basis(basis.mesh, basis.elem, intorder=4) if cells.shape[1] == 10 else basis
    return K, GEL.rho * BilinearForm(lambda u, v, _: dot(u, v)).assemble(whole), basis


def apart(ours: Structure, K: Any, M: Any, basis: Any) -> tuple[float, float]:
    """Largest difference of an entry of K and of M, over the largest entry; DOFs are matched by their place."""
    axes = np.empty(basis.N, int)
    for group in (basis.nodal_dofs, basis.edge_dofs):
        for k, dofs in enumerate(group):
            axes[dofs] = k % 3
    assert ours.coordinates is not None
    away, node = KDTree(ours.coordinates).query(basis.doflocs.T)
    assert away.max() < 1e-9 * np.ptp(ours.coordinates)
    rows = 3 * node + axes
    pairs = ((ours.K, K), (ours.M, M))
    first, second = (float(abs(mine[rows][:, rows] - theirs).max() / abs(theirs).max()) for mine, theirs in pairs)
    return first, second


# -- the comparison ---------------------------------------------------------------------------------------------------
def cases(n: tuple[int, int, int]) -> dict[str, tuple[Callable[[], Structure], np.ndarray, np.ndarray, str]]:
    """Name -> what builds ours, nodes, cells, element; hexahedra fill n boxes, tetrahedra those of half as many."""
    sides = (6e-3, 4e-3, 3e-3)
    out: dict[str, tuple[Callable[[], Structure], np.ndarray, np.ndarray, str]] = {}
    for element in ("standard", "bbar"):
        block = solids.block(lengths=sides, elements=n, material=GEL, element=element, fixed=None)
        places, cells = np.asarray(block.coordinates), hexahedra(block)
        moved = skewed(places, min(side / count for side, count in zip(sides, n, strict=True)))

        def regular(element: str = element) -> Structure:
            return solids.block(lengths=sides, elements=n, material=GEL, element=element, fixed=None)

        def general(places: np.ndarray = moved, cells: np.ndarray = cells, element: str = element) -> Structure:
            return solids.mesh(places, cells, material=GEL, element=element, fixed=None)

        out[f"block, {element}"] = regular, places, cells, element
        out[f"hexahedra, {element}"] = general, moved, cells, element
    half = tuple(max(1, count // 2) for count in n)
    places, cells = tetrahedra((half[0], half[1], half[2]), sides)
    out["tetrahedra"] = (
        lambda: solids.mesh(places, cells, material=GEL, kind="C3D10", fixed=None), places, cells, "standard",
    )  # fmt: skip
    return out


def seconds(work: Callable[[], Any], times: int = 3) -> float:
    """CPU seconds of the fastest of some runs."""
    taken = []
    for _ in range(times):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return min(taken)


def main(n: tuple[int, int, int] = (24, 16, 12)) -> None:
    """Print the table."""
    for name, (build, places, cells, element) in cases(n).items():
        ours = build()
        difference = apart(ours, *assembled(places, cells, element))
        mine, theirs = seconds(build), seconds(lambda p=places, c=cells, e=element: assembled(p, c, e))
        print(
            f"{name:20}  {ours.n:6}  {mine:8.2f}  {theirs:8.2f}  {theirs / mine:5.2f}"
            f"  {difference[0]:.1e}  {difference[1]:.1e}"
        )


if __name__ == "__main__":
    main()
