"""The FE pad beside the figures of the literature page, and what its condensation costs.

Run ``python -m tests.benchmarks.tactile_pad``; parts by name: ``waves hertz locking forward mesh cost``.

waves    traction that an endless mesh returns for the exact motion of a plane wave of the bonded layer
hertz    exact motion under 1 N on a Hertz patch (a = h = 3 mm), F = K U: map error, peak, resultant
locking  patch on a pad 16 x 16 x 4 mm, plain bricks and B-bar; single-layer case and its model trap
forward  depth under the Hertz patch against the exact layer
mesh     the published gel (ten-node tetrahedra, domed) as it is and rebuilt from bricks, under one smooth traction
cost     stiffness and compliance of 43 x 43 surface nodes on 4 layers: CPU seconds and memory, against splu
"""

from __future__ import annotations

import resource
import sys
import time

import numpy as np

from structures import factor
from structures._system.factor import Factor
from tactile import Pad, Press
from tactile._pad.meshfiles import elastic
from tests.data import data_folder
from tests.tactile.padtruth import consistent, map_error, recovered
from tests.tactile.test_pad_layer import HERTZ, PRESS, WAVES, pad


def waves() -> None:
    """Plane-wave table, and the fine mesh over all nu."""
    print("recovered / true pressure at kh = 1, 2, 4 | shear / pressure at kh = 2 (page)")
    for (layers, side, element), rows in WAVES.items():
        for nu, row in zip((0.3223, 0.45, 0.49), rows, strict=True):
            t = [recovered(kh, nu, layers=layers, side=side, element=element) for kh in (1, 2, 4)]
            found = " ".join(f"{abs(x[2]):.3f}" for x in t) + f" | {abs(t[1][0]):.3f}"
            print(f"  {layers} x {element:8} a = h/{1 / side:.0f}  nu {nu:<6} {found}   ({row})")
    print("8 layers of B-bar, a = h/8: worst error of the traction vector: pressure, both shears; along x, at 45 deg")
    for nu in (0.3, 0.3223, 0.4, 0.45, 0.475, 0.49, 0.499):
        worst = []
        for kh in (0.25, 0.5, 1, 2, 4):
            errors = []
            for angle in (0.0, np.pi / 4):
                along = np.array([np.cos(angle), np.sin(angle), 0])
                for t in (np.array([0, 0, 1.0]), along, np.array([-along[1], along[0], 0])):
                    errors.append(np.linalg.norm(recovered(kh, nu, layers=8, side=1 / 8, traction=t, angle=angle) - t))
            worst.append(max(errors))
        print(f"  nu {nu:<6}  kh .25 .5 1 2 4: " + " ".join(f"{100 * e:.2f} %" for e in worst))


def hertz() -> None:
    """Hertz table."""
    print("Hertz patch, F = K U: Fz (N), map error, peak (page: map error, peak)")
    for column, nu in enumerate((0.3223, 0.475, 0.49)):
        for (layers, element), rows in HERTZ.items():
            force, error, peak = map_error(pad(nu, layers, element), PRESS)
            name = f"{layers} x {element:8} 1 mm  "
            print(f"  nu {nu:<6} {name}  {-force[2]:.3f}  {error:.3f}  {peak:.3f}   {rows[column]}")
        force, error, peak = map_error(pad(nu, 8, pitch=0.5e-3), PRESS)
        page = (0.023, 0.025, 0.028)[column]
        print(f"  nu {nu:<6} 8 x bbar     0.5 mm  {-force[2]:.3f}  {error:.3f}  {peak:.3f}   {page}")


def locking() -> None:
    """Locking, the single-layer case, its trap."""
    print("1 N over r < 3.1 mm, pad 16 x 16 x 4 mm; mm: plain 8x8x2 largest |u|, plain and B-bar 16x16x4 centre")
    page = {0.3: (0.600, 0.701, 0.708), 0.45: (0.410, 0.515, 0.534), 0.49: (0.238, 0.374, 0.469)}
    page |= {0.499: (0.056, 0.148, 0.454), 0.4999: (0.0087, 0.029, 0.452)}
    for nu, row in page.items():
        found = []
        for n, layers, element in ((8, 2, "standard"), (16, 4, "standard"), (16, 4, "bbar")):
            gel = Pad(
                size=(16e-3, 16e-3), thickness=4e-3, E=147e3, nu=nu, elements=(n, n), layers=layers, element=element,
                allow=("E109", "W115"),
            )  # fmt: skip
            r = np.linalg.norm(gel.nodes2d, axis=1)
            f = np.zeros((gel.points, 3))
            f[r < 3.1e-3, 2] = -1 / np.count_nonzero(r < 3.1e-3)
            u = gel.displacements(f)
            found.append(1e3 * (np.abs(u).max() if n == 8 else -u[np.argmin(r), 2]))
        print(
            f"  nu {nu:<6} "
            + " ".join(f"{x:.4f}" for x in found)
            + f"   plain / B-bar {found[1] / found[2]:.2f}   {row}"
        )


def forward() -> None:
    """Depth under the patch against the exact layer."""
    print(
        "depth at the centre over that of the layer - 1 (page: +.5 / +.8 % for 0.5 mm x 6, +3.1 / +5.1 % for 1 mm x 4)"
    )
    for nu in (0.3223, 0.49):
        for layers, pitch in ((4, 1e-3), (6, 0.5e-3)):
            gel = pad(nu, layers, pitch=pitch)
            depth = gel.displacements(consistent(gel, PRESS))[np.argmin(np.linalg.norm(gel.nodes2d, axis=1)), 2]
            exact = PRESS.displacement(gel.layer, np.zeros((1, 2)))[0, 2]
            print(f"  nu {nu:<6} {1e3 * pitch:g} mm x {layers}: {100 * (depth / exact - 1):+.2f} %")


def mesh() -> None:
    """The published gel: two unlike meshes of one body."""
    folder = data_folder()
    if folder is None:
        print("measured records not found (set LOADID_DATA)")
        return
    file = folder / "gelsight_dots" / "gelsight_miniMesh.inp.gz"
    E = 1e6 * elastic(folder / "gelsight_dots" / "materials.inp")["E"]
    points = np.array([[0.0, 0.0], [3e-3, 0.0], [5e-3, 3e-3], [0.0, 8e-3]])
    print("gel of a camera sensor, 1 kPa and 0.4 kPa of shear, Gaussian of 3 mm: um along X, Y, Z at four points")
    for pitch in (None, 1.5e-3, 0.75e-3):
        start = time.process_time()
        gel = Pad.from_mesh(file, E=E, nu=0.475, pitch=pitch, layers=4)
        w = np.exp(-np.sum(gel.nodes2d**2, axis=1) / (3e-3) ** 2)
        t = w[:, None] * np.array([400.0, 0.0, -1000.0])
        f = gel.surface.areas[:, None] * t if pitch is None else gel.surface.forces(t)
        u = 1e6 * (gel.rows(points) @ gel.solve(f))
        name = "C3D10 as it is" if pitch is None else f"bricks {1e3 * pitch:g} mm x 4"
        print(f"  {name:18} {gel.points} nodes, {-f[:, 2].sum():.4f} N: " + " ".join(f"{x:6.2f}" for x in u), end="")
        print(f"   {time.process_time() - start:.1f} CPU s")
    print("  " + repr(Pad.from_mesh(file, E=E, nu=0.475, pitch=3e-3).mesh))


def cost() -> None:
    """CPU time and memory of the condensed stiffness, and the route of one sparse solve per surface DOF."""
    gel = Pad(size=(24e-3, 24e-3), thickness=3e-3, E=147e3, nu=0.49, elements=(42, 42), layers=4)
    start = time.process_time()
    assert gel.stiffness.shape == (3 * gel.points,) * 2
    ours, memory = time.process_time() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    f = np.random.default_rng(0).standard_normal((gel.points, 3))
    U = gel.displacements(f).ravel()
    error = np.abs(gel.compliance @ f.ravel() - U).max() / np.abs(U).max()
    print(
        f"stiffness and compliance, {len(U)} surface DOFs, 4 layers: {ours:.1f} CPU s, peak {memory:.2f} GB, "
        f"error {error:.0e}"
    )
    start = time.process_time()
    s = np.searchsorted(gel.structure.free, gel.dofs)
    factor.compliance(factor.schur(gel.structure.K_free, s, Factor))
    print(f"  by a sparse factor of the interior and {len(U)} solves: {time.process_time() - start:.1f} CPU s")
    points = np.random.default_rng(1).uniform(-11e-3, 11e-3, (520, 2))
    start = time.process_time()
    gel.transfer(points, "XY")
    print(f"  transfer to 520 markers on the surface, compliance there: {time.process_time() - start:.2f} CPU s")
    press = Press(radius=2.5e-3, force=1.0)
    start = time.process_time()
    gel.forces(press.displacement(gel.layer, gel.nodes2d))
    print(f"  F = K U of one symmetric press without the dense matrix: {time.process_time() - start:.2f} CPU s")


PARTS = {"waves": waves, "hertz": hertz, "locking": locking, "forward": forward, "mesh": mesh, "cost": cost}


def main() -> None:
    """Print the parts that are asked for, or all."""
    for name in sys.argv[1:] or PARTS:
        PARTS[name]()


if __name__ == "__main__":
    main()
