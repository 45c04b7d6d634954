"""Pairs a CPU second that generators make, and what the quick contact gives up against a settled one on a finer grid.

Run ``python -m tests.benchmarks.generate [N]``: N draws of each row (60), about two minutes for 60.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from loadid.generate import DrawMaker, HistoryDeclaration, LoadRange
from loadid.generate._histories import HistoryMaker
from loadid.generate._work import drawn_as
from structures._threads import one_thread
from tactile import Eye, Markers, MultilayerPad, Pad, RigidBody, View, shapes
from tactile.generate import (
    CameraRange,
    ContactRange,
    GelRange,
    ImageRange,
    IndenterRange,
    MarkerRange,
    PressDeclaration,
    PressMaker,
)
from tactile.generate._truth import CELLS, Ground, Move
from tactile.vision._images import Scene, grid

from ..generate.made import chain

E, NU, H, SIZE = 147e3, 0.45, 3e-3, (24e-3, 24e-3)
SHALLOW = (0.05e-3, 0.25e-3)
BODIES = (
    IndenterRange("sphere", 2.0, radius=(2e-3, 8e-3)),
    IndenterRange("cylinder", radius=(2e-3, 6e-3), length=(3e-3, 8e-3)),
    IndenterRange("flat", radius=(1e-3, 3e-3), depth=SHALLOW),
    IndenterRange("ring", outer=(2e-3, 3e-3), inner=(1e-3, 1.5e-3), depth=SHALLOW),
    IndenterRange("bar", length=(2e-3, 5e-3), width=(1e-3, 2e-3), depth=SHALLOW),
    IndenterRange("edge", slope=(0.2, 0.8), length=(3e-3, 6e-3)),
    IndenterRange("cone", slope=(0.15, 0.6)),
    IndenterRange("polygon", radius=(1.5e-3, 3e-3), corners=(3, 7), depth=SHALLOW),
)
CONTACT = ContactRange(depth=(0.1e-3, 0.5e-3), shear=(0.0, 0.3e-3), twist=(-0.05, 0.05), friction=(0.3, 0.9), bodies=3,
                       several=0.15, apart=(4e-3, 6e-3))  # fmt: skip
GEL = GelRange(E=(0.9, 1.1), nu=(0.44, 0.46), thickness=(0.95, 1.05))
CAMERA = CameraRange(shift=(-1, 1), turn=(-0.01, 0.01), tilt=(-0.01, 0.01), scale=(0.99, 1.01))
IMAGE = ImageRange(noise=(1, 3), blur=(0.8, 1.4))
MOVES = {  # body -> heights, depth (m)
    "sphere": (partial(shapes.sphere, radius=5e-3), 0.4e-3),
    "flat": (partial(shapes.flat, radius=2e-3), 0.2e-3),
    "ring": (partial(shapes.ring, outer=2.5e-3, inner=1.2e-3), 0.2e-3),
    "edge": (partial(shapes.edge, slope=0.4, length=5e-3, angle=0.4), 0.4e-3),
    "cone": (partial(shapes.cone, slope=0.3), 0.4e-3),
}


def pad(pitch: float = 1e-3, layers: int = 4) -> Pad:
    return Pad(E=E, nu=NU, size=SIZE, thickness=H, pitch=pitch, layers=layers)


def makers() -> dict[str, DrawMaker]:
    """What is timed."""
    dots = grid(20, 24, 0.9e-3)
    view = View.camera(focal=640, centre=(320, 240), distance=25e-3, depth=3e-3, gamma=1.4, tilt=0.2)
    image = Scene(radius=0.22e-3).photograph(view, np.column_stack([dots, np.zeros(len(dots))]))
    marked = MultilayerPad(pad(), Markers(dots, 1e-6), penalty="identity")
    seeing = MultilayerPad(pad(), eye=Eye(view, image, noise=0.05, size=SIZE), penalty="identity")
    whole = PressDeclaration(BODIES, CONTACT, GEL, CAMERA, IMAGE, MarkerRange(lost=(0, 0.03)))
    fixed = PressDeclaration(BODIES, CONTACT, GelRange(E=(0.9, 1.1)), CAMERA, IMAGE, MarkerRange(lost=(0, 0.03)))
    loads = HistoryDeclaration([LoadRange("random", 1.0, frequency=(1.0, 20.0))], 5e-3, 4000)
    return {
        "480 markers, layer": PressMaker(marked, whole),
        "480 markers, finer pad": PressMaker(marked, fixed, [pad(0.75e-3, 5)]),
        "480 x 640 images, layer": PressMaker(seeing, whole),
        "480 x 640 images, finer pad": PressMaker(seeing, fixed, [pad(0.75e-3, 5)]),
        "4000 samples of a chain": HistoryMaker(chain(), loads, [chain(1.05)]),
    }


def rate(maker: DrawMaker, draws: int) -> tuple[float, float, float]:
    """CPU seconds until every gel is known, draws a CPU second then, and draws that had no answer, for each."""
    start = time.process_time()
    for k in range(draws):
        drawn_as(maker, 0, k)
    first = time.process_time() - start
    start = time.process_time()
    drawn = [drawn_as(maker, 1, k) for k in range(draws)]
    seconds = time.process_time() - start
    return first - seconds, draws / seconds, float(np.mean([one.parameters["redrawn"] for one in drawn]))


def given_up(heights: Callable[..., Any], depth: float) -> list[str]:
    """Errors of force and motion of the quick contact, of the settled one on its grid, and CPU seconds of each."""
    move = Move((0.1e-3, 0.2e-3), depth, None, (0.1e-3, 0.05e-3), 0.02, 0.5)
    points = grid(9, 9, 0.9e-3)
    quick = Ground(pad().layer, SIZE, 11e-3, H / CELLS)
    quick.press(partial(heights, at=move.at), move)
    start = time.process_time()
    found = quick.press(partial(heights, at=move.at), move)
    times = [time.process_time() - start]
    forces = [found.tractions.sum(axis=(0, 1)) * quick.grid.pitch**2]
    motions = [quick.motion(found.tractions, points, None)]
    for cells in (CELLS, 2 * CELLS):
        ground = Ground(pad().layer, (12e-3, 12e-3), 6e-3, H / cells)
        body = RigidBody(ground.grid, heights(ground.grid.nodes, at=move.at), friction=0.5)
        shift = np.array(move.shift) + move.turn * np.array([move.at[1], -move.at[0]])
        body.grid.displacements(np.zeros((*ground.grid.shape, 3)))
        start = time.process_time()
        contact = body.press(depth=depth).drag((float(shift[0]), float(shift[1])), move.turn, 8)
        times.append(time.process_time() - start)
        forces.append(contact.force)
        motions.append(contact.motion(points))

    def off(values: list[Any], k: int, to: int) -> str:
        return f"{100 * np.linalg.norm(values[k] - values[to]) / np.linalg.norm(values[to]):.2f} %"

    return [off(forces, 0, 1), off(motions, 0, 1), off(forces, 0, 2), off(motions, 0, 2),
            *(f"{t:.3f}" for t in times)]  # fmt: skip


def main(draws: int = 60) -> None:
    """Both tables."""
    with one_thread():
        print(f"{'pairs of':30s} {'a CPU second':>13s} {'first (s)':>10s} {'drawn anew':>11s}")
        for name, maker in makers().items():
            first, each, again = rate(maker, draws)
            print(f"{name:30s} {each:13.1f} {max(first, 0.0):10.1f} {again:11.2f}")
        print("\nquick contact against the settled one: on its own grid, and on one twice as fine; CPU s of the three")
        head = ("force", "motion", "force", "motion", "quick", "settled", "fine")
        print(f"{'':10s}" + "".join(f"{word:>10s}" for word in head))
        for name, (heights, depth) in MOVES.items():
            print(f"{name:10s}" + "".join(f"{word:>10s}" for word in given_up(heights, depth)))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
