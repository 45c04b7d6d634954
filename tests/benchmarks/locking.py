"""Volumetric and shear locking of the bricks, beside the figures of the literature page and a mixed reference.

Run ``python -m tests.benchmarks.locking``. Pad 20 x 20 x 4 mm bonded at its base, 12 x 12 x nz cells, Gaussian traction
of sigma = 2.5 mm: compliance f.u over that of a Taylor-Hood solution (Q2/Q1, 12 x 12 x 2, by scikit-fem), normal and
tangential. Cantilever 100 x 10 x 2 mm, 20 x 2 x 1 cells: tip deflection over that of Euler and Bernoulli.
"""

from __future__ import annotations

import time

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from structures import Structure, solids
from structures._elements.members import Material
from structures._system.factor import Factor

E, SIGMA, LENGTHS = 1e6, 2.5e-3, (20e-3, 20e-3, 4e-3)
COLUMNS = (("standard", 2), ("standard", 4), ("bbar", 2), ("bbar", 4), ("incompatible", 2))
# nu -> (normal, tangential) of each column
PAGE = {
    0.3: ((0.949, 0.952), (0.977, 0.978), (0.976, 0.967), (0.998, 0.984), (0.971, 0.962)),
    0.45: ((0.872, 0.924), (0.936, 0.960), (0.970, 0.967), (1.001, 0.984), (0.953, 0.958)),
    0.49: ((0.621, 0.856), (0.776, 0.904), (0.964, 0.966), (1.001, 0.983), (0.934, 0.952)),
    0.4999: ((0.022, 0.664), (0.069, 0.678), (0.962, 0.966), (1.001, 0.983), (0.754, 0.840)),
}
# what taylor_hood(nu) gives, so that a quick test need not solve it four times
REFERENCE = {
    0.3: (5.661782789e-14, 1.212811144e-13),
    0.45: (3.925770794e-14, 1.28347642e-13),
    0.49: (3.304777095e-14, 1.298861781e-13),
    0.4999: (3.138843573e-14, 1.302420071e-13),
}
BENDING = {
    "standard": {0.3: 0.273, 0.4999: 0.086},
    "bbar": {0.3: 0.345, 0.4999: 0.398},
    "incompatible": {0.3: 0.988, 0.4999: 0.806},
}


def block(element: str, nu: float, elements: tuple[int, int, int], **settings: object) -> Structure:
    """A block of a soft material, whatever the guards say."""
    settings = {"lengths": LENGTHS, **settings}
    material = Material(E=E, rho=1000.0, nu=nu)
    return solids.block(elements=elements, element=element, material=material, allow=("E109",), **settings)


def gaussian(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The traction, 1 Pa in the middle of the top face."""
    return np.exp(-((x - LENGTHS[0] / 2) ** 2 + (y - LENGTHS[1] / 2) ** 2) / 2 / SIGMA**2)


def compliances(element: str, nu: float, layers: int, cells: int = 12) -> np.ndarray:
    """f.u of a normal and of a tangential Gaussian traction on a pad of bricks, (2,)."""
    pad = block(element, nu, (cells, cells, layers))
    top = pad.field.surface("top")  # type: ignore[union-attr]
    # consistent forces: four Gauss points along each side of each cell
    xi, w = np.polynomial.legendre.leggauss(4)
    t, w = (xi + 1) / 2, w / 2
    h = LENGTHS[0] / cells
    hats = np.zeros((cells + 1, cells * 4))
    for c in range(cells):
        hats[c, 4 * c : 4 * c + 4], hats[c + 1, 4 * c : 4 * c + 4] = (1 - t) * w * h, t * w * h
    x = ((np.arange(cells)[:, None] + t) * h).ravel()
    forces = hats @ gaussian(x[:, None], x[None, :]) @ hats.T
    f = np.zeros((pad.n, 2))
    f[3 * top.nodes + 2, 0] = f[3 * top.nodes, 1] = forces.T.ravel()
    u = Factor.of(pad).solve(f[pad.free])
    return np.einsum("ij,ij->j", f[pad.free], u)


def taylor_hood(nu: float, cells: tuple[int, int, int] = (12, 12, 2)) -> np.ndarray:
    """The same compliances by quadratic displacements and linear pressures, with scikit-fem, (2,)."""
    from skfem import (
        Basis,
        BilinearForm,
        ElementHex1,
        ElementHex2,
        ElementVector,
        FacetBasis,
        LinearForm,
        MeshHex,
    )  # fmt: skip
    from skfem.helpers import ddot, div, eye, sym_grad, trace

    mu, kappa = E / 2 / (1 + nu), E / 3 / (1 - 2 * nu)
    mesh = MeshHex.init_tensor(*(np.linspace(0, a, n + 1) for a, n in zip(LENGTHS, cells, strict=True)))
    u, p = Basis(mesh, ElementVector(ElementHex2()), intorder=4), Basis(mesh, ElementHex1(), intorder=4)

    @BilinearForm
    def shear(u, v, _):
        e = sym_grad(u)
        return 2 * mu * ddot(e - eye(trace(e), 3) / 3, sym_grad(v))

    K = shear.assemble(u)
    D = BilinearForm(lambda u, q, _: div(u) * q).assemble(u, p)
    V = BilinearForm(lambda p, q, _: p * q).assemble(p)
    A = sparse.block_array([[K, D.T], [D, -V / kappa]], format="csc")
    faces = FacetBasis(
        mesh,
        ElementVector(ElementHex2()),
        facets=mesh.facets_satisfying(lambda x: abs(x[2] - LENGTHS[2]) < 1e-9),
        intorder=8,
    )
    held = u.get_dofs(lambda x: abs(x[2]) < 1e-9).all()
    free = np.setdiff1d(np.arange(A.shape[0]), held)
    F = np.zeros((A.shape[0], 2))
    for k, axis in enumerate((2, 0)):
        F[: K.shape[0], k] = LinearForm(lambda v, w, axis=axis: gaussian(w.x[0], w.x[1]) * v[axis]).assemble(faces)
    x = splu(A[free][:, free]).solve(F[free])
    return np.einsum("ij,ij->j", F[free], x)


def tip(element: str, nu: float) -> float:
    """Tip deflection of a cantilever of bricks under a tip force, over that of Euler and Bernoulli."""
    beam = block(element, nu, (20, 2, 1), lengths=(0.1, 0.01, 0.002), fixed="left")
    nodes = beam.field.surface("right").nodes  # type: ignore[union-attr]
    f = np.zeros(beam.n)
    f[3 * nodes + 2] = 1 / len(nodes)
    u = Factor.of(beam).solve(f[beam.free])
    return float(f[beam.free] @ u / (0.1**3 / 3 / (E * 0.01 * 0.002**3 / 12)))


def table(nus: tuple[float, ...] = tuple(PAGE), columns: tuple = COLUMNS) -> float:
    """Print the table; returns the largest difference from the page."""
    heads = [f"{element[:8]} nz{layers}" for element, layers in columns]
    print("\nCompliance over Taylor-Hood, normal/tangential: ours (page)")
    print(f"{'nu':>7} " + " ".join(f"{h:>27}" for h in heads) + "    CPU s")
    worst = 0.0
    for nu in nus:
        start = time.process_time()
        reference, cells = taylor_hood(nu), []
        for column in columns:
            known = np.array(PAGE[nu][COLUMNS.index(column)])
            ours = compliances(column[0], nu, column[1]) / reference
            worst = max(worst, float(np.abs(ours - known).max()))
            cells.append("{:.3f}/{:.3f} ({:.3f}/{:.3f})".format(*ours, *known))
        print(f"{nu:7g} " + " ".join(f"{c:>27}" for c in cells) + f" {time.process_time() - start:8.1f}")
    print(f"largest difference {worst:.4f}")
    return worst


def bending() -> float:
    """Print the bending figures; returns the largest difference from the page."""
    print("\nCantilever tip over Euler-Bernoulli: ours (page)")
    worst = 0.0
    for element, known in BENDING.items():
        ours = {nu: tip(element, nu) for nu in known}
        worst = max(worst, *(abs(ours[nu] - known[nu]) for nu in known))
        print(f"{element:>13} " + "  ".join(f"nu {nu:g}: {ours[nu]:.3f} ({known[nu]:.3f})" for nu in known))
    print(f"largest difference {worst:.4f}")
    return worst


if __name__ == "__main__":
    table()
    bending()
