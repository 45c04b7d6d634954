"""The whole chain, images included: what comes back of a press that slides; fewer markers, constraints, no depth.

Run ``python -m tests.benchmarks.tactile_chain [--elements 24]``. Pad 24 x 24 x 3 mm, E = 0.147 MPa, nu = 0.3223; a
Hertz press of 2.5 mm radius to 1 N, sliding to 0.25 N; 520 markers, 640 x 480, 2 grey levels of noise, blur,
perspective and refraction; normal motion from a depth map with 10 um noise. Truth from the kernels of the layer; the
inversion knows a finite-element pad. Lambda is chosen over four presses, then frozen. Printed: the last frame and the
worst of the second half of the frames.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactile import ContactLaw, ForceMap, MultilayerPad, Press
from tactile.vision._images import Scene, grid

from .tactile_rate import SIDE, Rig, rig


@dataclass(frozen=True)
class Row:
    """What came back of one frame: relative error of the force, ratios of peak and radius, cosine, readings lost."""

    force: float
    peak: float
    radius: float
    cosine: float
    lost: int


def judged(found: ForceMap, press: Press) -> Row:
    """A map beside its truth."""
    t, truth = found.traction(), press.traction(found.nodes)
    touch = found.contact()
    return Row(
        float(np.linalg.norm(found.resultant().value - press.vector) / np.linalg.norm(press.vector)),
        touch.peak / press.peak,
        touch.radius / press.radius,
        float(np.sum(t * truth) / np.linalg.norm(t) / np.linalg.norm(truth)),
        int(found.facts["lost"]),
    )


def fewer(r: Rig, share: float, seed: int = 1) -> list[np.ndarray]:
    """The same frames with some dots removed."""
    markers = grid(20, 26, 0.9e-3)
    keep = np.sort(np.random.default_rng(seed).permutation(len(markers))[: round((1 - share) * len(markers))])
    flat, scene = np.column_stack([markers, np.zeros(len(markers))]), Scene(radius=0.22e-3, blur=1.0, noise=2.0)
    moved = [flat + p.displacement(r.pad.layer, markers) for p in r.presses]
    return [scene.photograph(r.eye.view, m[keep], seed=300 + k) for k, m in enumerate(moved)]


def run(sensor: MultilayerPad, r: Rig, images: Sequence[np.ndarray], depth: bool) -> list[Row]:
    """All frames in their order."""
    return [
        judged(sensor.estimate(image, d if depth else None), p)
        for image, d, p in zip(images, r.depths, r.presses, strict=True)
    ]


def show(name: str, rows: Sequence[Row]) -> None:
    """One line: the last frame, and the worst of the second half."""
    last, half = rows[-1], rows[len(rows) // 2 :]
    worst = Row(
        max(x.force for x in half),
        max((x.peak for x in half), key=lambda v: abs(v - 1)),
        max((x.radius for x in half), key=lambda v: abs(v - 1)),
        min(x.cosine for x in half),
        max(x.lost for x in half),
    )
    for word, x in (("last", last), ("worst", worst)):
        print(
            f"{name:28s} {word:6s} {100 * x.force:8.2f} {x.peak:8.3f} {x.radius:8.3f} {x.cosine:8.4f} {x.lost:6d}",
            flush=True,
        )


def fresh(r: Rig) -> Rig:
    """The same rig with an eye that has seen nothing yet."""
    from dataclasses import replace

    from tactile import Eye

    flat = np.column_stack([grid(20, 26, 0.9e-3), np.zeros(520)])
    scene = Scene(radius=0.22e-3, blur=1.0, noise=2.0)
    unloaded = [scene.photograph(r.eye.view, flat, seed=k) for k in range(6)]
    return replace(r, eye=Eye(r.eye.view, unloaded[0], unloaded=unloaded[1:], size=(SIDE, SIDE)))


def table(elements: int = 24, frames: int = 16) -> dict[str, list[Row]]:
    """Print the table."""
    base = rig(elements, frames)
    print(f"{base.pad!r}, {len(base.eye.kept)} markers, noise {np.round(base.eye.noise_px, 4)} px")
    head = f"{'frame':6s} {'force %':>8s} {'peak':>8s} {'radius':>8s} {'cosine':>8s} {'lost':>6s}"
    first = MultilayerPad(base.pad, eye=base.eye, depth=base.depths[0])
    chosen = first.calibrate(list(base.images[:8:2]), list(base.depths[:8:2]))
    print(chosen)
    print(f"{'':28s} {head}")
    found = {}
    for name, settings, share, depth in (
        ("all markers, depth", {}, 0.0, True),
        ("10 % of markers removed", {}, 0.1, True),
        ("no pull", {"contact": ContactLaw(no_pull=True)}, 0.0, True),
        ("friction cones", {"contact": ContactLaw(friction=0.6)}, 0.0, True),
        ("in-plane markers alone", {}, 0.0, False),
    ):
        r = fresh(base)
        given = {"depth": r.depths[0]} if depth else {}
        sensor = MultilayerPad(r.pad, eye=r.eye, choice=chosen.lam, **given, **settings)  # type: ignore[arg-type]
        images = list(r.images) if share == 0 else fewer(r, share)
        found[name] = run(sensor, r, images, depth)
        show(name, found[name])
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--elements", type=int, default=24)
    parser.add_argument("--frames", type=int, default=16)
    given = parser.parse_args(arguments)
    table(given.elements, given.frames)


if __name__ == "__main__":
    main()
