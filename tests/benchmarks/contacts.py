"""What a frame costs whose contacts are found by their evidence: ``python -m tests.benchmarks.contacts [frames]``.

Presses on a gel of other finite elements, one or two flat bodies, under 182 markers in the plane, along all axes, and
beside a depth map. `estimate` fits loads about the contacts; `follow`, one product, is what else a user would take.
CPU seconds a frame of the public call, and the error of the normal force over it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from case_studies.bodies import Patch, surfaces
from structures._threads import one_thread
from tactile import DepthMap, Markers, MultilayerPad, Pad

E, NU, SIZE, THICKNESS, NOISE = 147e3, 0.45, (14e-3, 12e-3), 3e-3, 3e-6
PIXEL, DEPTH = 0.25e-3, 5e-6
POINTS = np.stack(np.meshgrid(*(np.arange(-s / 2 + 0.5e-3, s / 2, 1e-3) for s in SIZE)), axis=-1).reshape(-1, 2)
GRID = np.stack(np.meshgrid(*((np.arange(s / PIXEL) + 0.5) * PIXEL - s / 2 for s in SIZE)), axis=-1)


def presses(frames: int) -> tuple[list[Any], np.ndarray]:
    """Motion of the surface, a function of places, and normal forces (frames,)."""
    rng, drawn = np.random.default_rng(1), []
    for k in range(frames):
        drawn.append(tuple(
            Patch("flat", (rng.uniform(-4e-3, 4e-3), rng.uniform(-3e-3, 3e-3)), (rng.uniform(0.8e-3, 2e-3), 0.0), 0.0,
                  (rng.normal(0, 0.03), rng.normal(0, 0.03), -rng.uniform(0.05, 0.3)))
            for _ in range(1 + k % 2)))  # fmt: skip
    return surfaces(drawn, "fe", SIZE, THICKNESS, NU), np.array([sum(p.force[2] for p in one) for one in drawn])


def read(moved: Callable[[np.ndarray], np.ndarray], kind: str, seed: int) -> tuple[np.ndarray, DepthMap | None]:
    """Markers (n, 2 or 3) and depth map of a frame."""
    rng = np.random.default_rng(seed)
    y = moved(POINTS) / E + NOISE * rng.standard_normal((len(POINTS), 3))
    deep = moved(GRID.reshape(-1, 2))[:, 2].reshape(GRID.shape[:2]) / E + DEPTH * rng.standard_normal(GRID.shape[:2])
    return y if kind == "all axes" else y[:, :2], DepthMap(deep, PIXEL, DEPTH) if kind == "and depth" else None


@one_thread()
def main(frames: int = 20) -> None:
    """Print the table."""
    moved, force = presses(frames)
    print(f"{frames} frames, CPU s: median and largest; error of the normal force over it: median")
    print(f"  {'':14} {'estimate':>17} {'error':>8} {'follow':>17} {'error':>8}")
    for kind in ("in the plane", "all axes", "and depth"):
        shown = [read(one, kind, k) for k, one in enumerate(moved)]
        markers = Markers(POINTS, NOISE, "XYZ" if kind == "all axes" else "XY")
        sensor = MultilayerPad(Pad(size=SIZE, thickness=THICKNESS, E=E, nu=NU), markers, depth=shown[0][1], choice=0.03)
        row = f"  {kind:14}"
        for call in (sensor.estimate, sensor.follow):
            call(*shown[0])
            took, off = [], []
            for frame, true in zip(shown, force, strict=True):
                start = time.process_time()
                found = call(*frame)
                took.append(time.process_time() - start)
                off.append(abs(found.resultant().value[2] / true - 1))
            row += f" {np.median(took):9.3f} {np.max(took):7.3f} {100 * np.median(off):6.1f} %"
        print(row, flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
