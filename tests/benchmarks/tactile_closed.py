"""Closed forms of the tactile package: their error and CPU time beside the routes that a user would write.

Run ``python -m tests.benchmarks.tactile_closed``. Pad h = 3 mm, E = 0.147 MPa, nu = 0.3223; a Hertz press of 2.5 mm
with shear. Alternatives: SciPy's adaptive quadrature of the Hankel integrals point by point, and the Fourier sum of the
kernels on a periodic plane. On a grid: transforms against the dense influence matrix. Medians of several runs.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
from scipy.integrate import quad
from scipy.special import jv

from tactile import Layer, LayerGrid, Press
from tactile._closed.gridded import influence
from tactile._closed.profiles import PROFILES

LAYER = Layer(3e-3, 147e3, 0.3223)
PRESS = Press(radius=2.5e-3, force=1.0, shear=(0.25, 0.1))


def median(run: Callable[[], object], repeat: int = 5) -> float:
    """Median CPU seconds; the first run, which works out the Gauss rules, is left out."""
    run()
    spent = []
    for _ in range(repeat):
        start = time.process_time()
        run()
        spent.append(time.process_time() - start)
    return statistics.median(spent)


def adaptive(points: np.ndarray) -> np.ndarray:
    """Displacements by scipy.integrate.quad of each Hankel integral at each point."""
    found = np.empty((len(points), 3))
    z = points[0, 2] if points.shape[1] == 3 else None
    for row, (x, y) in zip(found, points[:, :2], strict=True):
        r = np.hypot(x, y)

        def integral(part: Callable, m: int, r: float = r) -> float:
            def f(s: float) -> float:
                k = s / LAYER.h
                g = PROFILES["hertz"].transform(np.array(k * PRESS.radius))
                return float(part(LAYER.components(np.array(k), z)) * g * jv(m, k * r) * k / (2 * np.pi))

            return quad(f, 0, 60, limit=400, epsabs=0, epsrel=1e-8)[0] / LAYER.h

        zz, kz, zk = (integral(lambda c, n=n: getattr(c, n), m) for n, m in (("zz", 0), ("kz", 1), ("zk", 1)))
        mean, split = integral(lambda c: (c.kk + c.tt) / 2, 0), integral(lambda c: (c.kk - c.tt) / 2, 2)
        fx, fy, fz = PRESS.vector
        ex, ey = x / r, y / r
        along = ex * fx + ey * fy
        row[:] = (
            kz * fz * ex + mean * fx - split * (2 * ex * along - fx),
            kz * fz * ey + mean * fy - split * (2 * ey * along - fy),
            zz * fz - zk * along,
        )
    return found


def fourier(n: int, side: float, z: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Points and displacements of the Fourier sum on a periodic plane of n x n points."""
    k = 2 * np.pi * np.fft.fftfreq(n, side / n)
    kx, ky = np.meshgrid(k, k)
    load = PROFILES["hertz"].transform(np.hypot(kx, ky) * PRESS.radius)[..., None] * np.array(PRESS.vector)
    waves = np.einsum("yxij,yxj->yxi", LAYER.interior(kx, ky, z), load)
    x = np.fft.fftfreq(n, 1 / n) * side / n
    return np.stack(np.meshgrid(x, x), axis=-1), np.fft.ifft2(waves, axes=(0, 1)).real * (n / side) ** 2


def presses() -> dict[str, float]:
    """Print the table of press displacements; returns CPU seconds of ours at 2000 points."""
    rng = np.random.default_rng(0)
    flat = rng.uniform(-12e-3, 12e-3, (2000, 2))
    deep = np.column_stack([flat, np.full(2000, 2e-3)])
    any_ = np.column_stack([flat, rng.uniform(0, 3e-3, 2000)])
    print("\nDisplacement of a press at 2000 points: CPU s, worst error over the largest motion")
    found = {}
    for name, points in (("surface", flat), ("one depth", deep), ("2000 depths", any_)):
        found[name] = median(lambda points=points: PRESS.displacement(LAYER, points))
        print(f"{'ours, ' + name:>34} {found[name]:9.4f}")
    few = deep[:10]
    start = time.process_time()
    truth = adaptive(few)
    spent = (time.process_time() - start) * 200
    error = np.abs(PRESS.displacement(LAYER, few) - truth).max() / np.abs(truth).max()
    print(f"{'scipy quad, one depth (10 points)':>34} {spent:9.1f}  ours against it {error:.1e}")
    for n, side in ((256, 60e-3), (512, 60e-3)):
        start = time.process_time()
        at, motion = fourier(n, side, None)
        spent = time.process_time() - start
        near = np.hypot(*np.moveaxis(at, -1, 0)) < 10e-3
        error = np.abs(motion[near] - PRESS.displacement(LAYER, at[near])).max() / np.abs(motion).max()
        print(f"{f'Fourier sum {n} x {n}, surface':>34} {spent:9.3f}  its error {error:.1e}")
    return found


def grids() -> None:
    """Print the table of the layer on a grid."""
    grid = LayerGrid(LAYER, (43, 43), 0.5e-3)
    places = grid.nodes.reshape(-1, 2)
    loads = PRESS.traction(places).reshape(43, 43, 3)
    start = time.process_time()
    u = grid.displacements(loads)
    first = time.process_time() - start
    start = time.process_time()
    H = influence(LAYER, places[::15], places, grid.pitch)
    rows = time.process_time() - start
    dense = np.zeros((3 * len(places), H.shape[1]))
    print("\nLayer on a grid of 43 x 43 nodes (5547 unknowns): CPU s")
    print(f"{'displacements, first time':>34} {first:9.4f}")
    print(f"{'displacements':>34} {median(lambda: grid.displacements(loads)):9.4f}")
    print(f"{'dense product':>34} {median(lambda: dense @ loads.ravel()):9.4f}")
    print(f"{'dense matrix, filled':>34} {rows * 15:9.2f}")
    print(f"{'tractions, lam = 0.01':>34} {median(lambda: grid.tractions(u, lam=0.01)):9.4f}")
    error = np.abs(H @ loads.ravel() - u.reshape(-1, 3)[::15].ravel()).max() / np.abs(u).max()
    print(f"{'transforms against dense':>34} {error:9.1e}")


if __name__ == "__main__":
    presses()
    grids()
