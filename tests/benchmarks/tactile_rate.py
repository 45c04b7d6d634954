"""From image to force map: time of every stage, with and without friction cones, beside what else a user might take.

Run ``python -m tests.benchmarks.tactile_rate``. Images of 640 x 480 with 520 markers (blur, perspective, refraction,
noise of 2 grey levels) of a press that slides; a pad of 24 x 24 x 3 mm with 42 x 42 x 4 bricks, 1849 nodes on its
surface, 5547 unknown tractions. Median wall and mean CPU milliseconds per frame; frames per second of the chain.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactile import ContactLaw, DepthMap, Eye, MultilayerPad, Pad, Press, View
from tactile.vision._images import Scene, grid

SIDE, THICKNESS, E, NU = 24e-3, 3e-3, 0.147e6, 0.3223
PIXELS, PIXEL, DEPTH_NOISE = 240, 1e-4, 1e-5
FRAMES = 24


@dataclass(frozen=True)
class Rig:
    """What is simulated: markers, view, images and depth maps of a press that slides."""

    pad: Pad
    eye: Eye
    presses: tuple[Press, ...]
    images: tuple[Any, ...]
    depths: tuple[DepthMap, ...]


def presses(count: int = FRAMES) -> tuple[Press, ...]:
    """A press to 1 N that then slides by a millimetre with 0.25 N."""
    half = count // 2
    down = [Press(radius=2.5e-3, force=f) for f in np.linspace(1 / half, 1, half)]
    slide = [
        Press(at=(s * 1e-3, 0.0), radius=2.5e-3, force=1.0, shear=(0.25 * min(3 * s, 1), 0.0))
        for s in np.linspace(1 / (count - half), 1, count - half)
    ]
    return (*down, *slide)


def rig(elements: int, count: int = FRAMES, backend: str | None = None) -> Rig:
    """Everything, simulated."""
    pad = Pad(size=(SIDE, SIDE), thickness=THICKNESS, E=E, nu=NU, elements=(elements, elements), layers=4)
    view = View.camera(
        focal=640, centre=(320, 240), distance=25e-3, depth=THICKNESS, gamma=1.4, tilt=np.deg2rad(12), azimuth=0.3
    )
    markers, scene = grid(20, 26, 0.9e-3), Scene(radius=0.22e-3, blur=1.0, noise=2.0)
    flat = np.column_stack([markers, np.zeros(len(markers))])
    unloaded = [scene.photograph(view, flat, seed=k) for k in range(6)]
    eye = Eye(view, unloaded[0], unloaded=unloaded[1:], size=(SIDE, SIDE), backend=backend)
    images, depths, rng = [], [], np.random.default_rng(0)
    line = (np.arange(PIXELS) - (PIXELS - 1) / 2) * PIXEL
    places = np.array(np.meshgrid(line, line)).reshape(2, -1).T
    for k, press in enumerate(presses(count)):
        images.append(scene.photograph(view, flat + press.displacement(pad.layer, markers), seed=100 + k))
        z = press.displacement(pad.layer, places)[:, 2].reshape(PIXELS, PIXELS)
        depths.append(DepthMap(z + DEPTH_NOISE * rng.standard_normal(z.shape), PIXEL, DEPTH_NOISE))
    return Rig(pad, eye, presses(count), tuple(images), tuple(depths))


def timed(work: Callable[[int], Any], count: int) -> tuple[float, float]:
    """Median wall and mean CPU milliseconds of one call; frames there and back again, as a camera sees them."""
    work(count - 1)  # what is factored once is not the cost of a frame
    wall, cpu = [], time.process_time()
    there = list(range(count))
    for k in [*there[::-1], *there]:
        start = time.perf_counter()
        work(k)
        wall.append(time.perf_counter() - start)
    return 1e3 * float(np.median(wall)), 1e3 * (time.process_time() - cpu) / (2 * count)


def table(elements: int = 42, count: int = FRAMES) -> dict[str, tuple[float, float]]:
    """Print the table; returns wall and CPU milliseconds of every row."""
    r = rig(elements, count)
    found: dict[str, tuple[float, float]] = {}

    def row(name: str, work: Callable[[int], Any], n: int = count, note: str = "") -> None:
        found[name] = timed(work, n)
        print(f"{name:48s} {found[name][0]:9.2f} {found[name][1]:9.2f}  {note}", flush=True)

    print(f"{r.pad.points} surface nodes, {len(r.eye.kept)} markers, {count} frames")
    print(f"{'per frame':48s} {'wall ms':>9s} {'CPU ms':>9s}")
    row("detect and match", lambda k: r.eye.tracker.step(r.images[k]))
    row("image to motion (eye)", lambda k: r.eye.read(r.images[k], r.depths[k]))
    plain = MultilayerPad(r.pad, eye=r.eye, choice=0.02)
    plain.inverse  # noqa: B018  (built before it is timed)
    row("image to map, markers alone", lambda k: plain.estimate(r.images[k]))
    deep = MultilayerPad(r.pad, eye=r.eye, depth=r.depths[0], choice=0.02)
    deep.inverse  # noqa: B018
    row("image and depth to map", lambda k: deep.estimate(r.images[k], r.depths[k]))
    cones = MultilayerPad(r.pad, eye=r.eye, depth=r.depths[0], choice=0.02, contact=ContactLaw(friction=0.6))
    cones.inverse  # noqa: B018
    row("image and depth to map, friction cones", lambda k: cones.estimate(r.images[k], r.depths[k]))
    _alternatives(r, deep, row)
    for name in [n for n in found if n.startswith(("image and", "image to map"))]:
        print(f"{name}: {1e3 / found[name][0]:.0f} frames/s")
    return found


def _alternatives(r: Rig, deep: MultilayerPad, row: Callable[..., None]) -> None:
    """What a user would write: FE solve per frame, a dense least squares per frame, bounded least squares."""
    from scipy.sparse.linalg import lsmr

    u = r.presses[-1].displacement(r.pad.layer, r.pad.nodes2d)
    r.pad.forces(u)
    row("F = K U on this mesh, given all nodes (sparse FE)", lambda k: r.pad.forces(u), 3)
    y = deep._readings(r.images[-1], r.depths[-1])[0]
    spread = np.array([c.noise for c in deep.model.sensors])
    seen = np.isfinite(y)
    A, b = deep.model.H[seen] / spread[seen, None], y[seen] / spread[seen]
    lam = deep.inverse.lam * deep.inverse.scale
    row("scipy lsmr, same matrix and lambda, 1e-6", lambda k: lsmr(A, b, damp=lam, atol=1e-6, btol=1e-6), 1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--elements", type=int, default=42)
    parser.add_argument("--frames", type=int, default=FRAMES)
    given = parser.parse_args(arguments)
    table(given.elements, given.frames)


if __name__ == "__main__":
    main()
