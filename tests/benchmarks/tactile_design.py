"""Skin design by waves against what else could be done: ``python -m tests.benchmarks.tactile_design``.

One pad (20 x 16 mm, 1 mm patches and markers), the same noise and the same expected load. Alternatives that a user
would pick: the singular values of a dense matrix of the exact layer (finite area, no periodic repeat), and those of a
finite-element pad with free edges, 4 layers of B-bar (its unknowns are means over hats, twice as wide as patches: its
std is lower for that). CPU seconds, medians of three runs. Then the design table.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from tactile import LayerGrid, Pad, design
from tactile.design import Skin

GEL = {"h": 3e-3, "E": 0.147e6, "nu": 0.3223}
Row = tuple[float, int, float, float]


def waves(s: Skin) -> Row:
    d = design.skin(s)
    return d.kappa, d.recoverable, d.pressure_std, d.shear_std


def judged(H: np.ndarray, s: Skin) -> Row:
    """Dense matrix (3 n, 3 n), motion per traction: singular values and the posterior of the patch in the middle."""
    n = len(H) // 3
    A = H * s.load / np.tile([s.noise, s.noise, s.noise_z or np.inf], n)[:, None]
    _, values, V = np.linalg.svd(A)
    std = s.load * np.sqrt(np.sum(V.T**2 / (1 + values**2), axis=1)).reshape(n, 3)[n // 2]
    return float(values[0] / values[-1]), int(np.sum(values > 1)), float(std[2]), float(std[:2].max())


def dense(s: Skin) -> Row:
    grid = LayerGrid(s.layer, (16, 20), 1e-3)
    return judged(grid.influence(grid.nodes.reshape(-1, 2)), s)


def elements(s: Skin) -> Row:
    pad = Pad(size=(20e-3, 16e-3), thickness=s.h, E=s.E, nu=s.nu, pitch=1e-3, layers=4)
    areas = np.repeat(np.asarray(pad.surface.areas), 3)
    return judged(pad.compliance * areas, s)


def timed(work: Callable[[Skin], Row], s: Skin) -> tuple[Row, float]:
    """Answer and CPU seconds, median of three."""
    spent = []
    for _ in range(3):
        start = time.process_time()
        row = work(s)
        spent.append(time.process_time() - start)
    return row, float(np.median(spent))


def main() -> None:
    s = Skin(**GEL)
    print(f"{'method':34s} {'condition':>10s} {'above noise':>12s} {'std p, Pa':>10s} {'std q, Pa':>10s} {'CPU s':>7s}")
    for name, work in (("waves (design.skin, all numbers)", waves), ("dense matrix of the layer", dense),
                       ("finite elements, free edges", elements)):  # fmt: skip
        (kappa, above, p, q), spent = timed(work, s)
        print(f"{name:34s} {kappa:10.1f} {above:12d} {p:10.0f} {q:10.0f} {spent:7.2f}")
    skins = [
        Skin(**GEL, name="3 mm"),
        Skin(**(GEL | {"E": 1.47e6}), name="10 E"),
        Skin(**(GEL | {"h": 1.5e-3}), name="1.5 mm"),
        Skin(**(GEL | {"nu": 0.49}), name="nu .49"),
        Skin(**GEL, depth=1e-3, name="1 mm deep"),
        Skin(**GEL, pitch=0.5e-3, name="4 x markers"),
        Skin(**GEL, pitch=0.5e-3, correlated=0.9, correlation=1e-3, name="4 x, correlated"),
        Skin(**GEL, noise_z=None, name="in-plane only"),
    ]
    print()
    print(design.compare(skins).table())
    print("\nplain Hex-8 over B-bar, depth of a pressed patch, 16 x 16 x 4 bricks:")
    print("  ".join(f"nu {nu:g}: {design.locking(nu):.3f}" for nu in (0.3, 0.45, 0.49, 0.499, 0.4999)))


if __name__ == "__main__":
    main()
