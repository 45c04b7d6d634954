"""A day of a tactile sensor that is kept running: what happens to it, what it says, and how wrong its force is.

A camera is simulated frame by frame: the dots of a gel pad (16 x 12 x 3 mm) under presses of known force, moved by a
finer mesh than that of the maps, with blur and two grey levels of noise, and beside it a depth map with 5 um of noise,
as in-plane dots alone hardly tell the pressure. In the course of the day the light falls by a third, frames are black,
dots wear off, a hand covers a third of the view, the camera is knocked by a pixel and a half, an object slides, and the
process is stopped under a load and started again from its state. `tactile.live.Live` sees these frames and nothing
else. For each part of the day stand what was said in it, and the force of its last frames beside the truth.

Run ``python -m case_studies.live_day``: prints the table and draws the day.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile import DepthMap, Eye, MultilayerPad, Pad, Press, View
from tactile.live import Live, LiveFrame, State

Array = NDArray[np.float64]
SIZE, THICKNESS, E, NU, PITCH = (16e-3, 12e-3), 3e-3, 147e3, 0.45, 1e-3
PIXELS, DOT, SPACING, BLUR, NOISE = (240, 320), 0.22e-3, 1e-3, 1.0, 2.0
DEPTH, DEPTH_NOISE = 0.25e-3, 5e-6  # pixel of a depth map and its noise, m
GEL, INK = 165.0, 60.0  # grey levels
RATE, QUIET, LAST = 30.0, 1.0, 10  # frames a second; s of a quiet time; frames over which a force is compared
FORCE, MU, RADIUS = 0.4, 0.5, 2.2e-3


@dataclass(frozen=True)
class Scenery:
    """One part of the day.

    Parameters
    ----------
    name : str
    presses : tuple of Press or None
        One for each frame, None where nothing touches.
    light : float
        Over that of the morning.
    black : bool
        No picture at all.
    worn : int
        Dots that are gone.
    hand : float
        Share of the width of the view that is covered.
    knocked : float
        Pixels by which the camera has moved.
    restart : bool
        The process was stopped before it, and starts again from its state.
    """

    name: str
    presses: tuple[Press | None, ...]
    light: float = 1.0
    black: bool = False
    worn: int = 0
    hand: float = 0.0
    knocked: float = 0.0
    restart: bool = False


@dataclass(frozen=True, eq=False)
class Part:
    """What came of a part of the day.

    Parameters
    ----------
    name : str
    frames, maps : int
        That came, and that were answered.
    said : list of str
        Kinds of what began (+), ended (-) or happened.
    error : float
        Largest length of the error of the force (N) over its last frames; NaN where none has a map.
    force : float
        Length of the true force then (N).
    """

    name: str
    frames: int
    maps: int = 0
    said: list[str] = field(default_factory=list)
    error: float = np.nan
    force: float = 0.0


@dataclass(frozen=True, eq=False)
class Day:
    """The parts of the day, the friction that was learned with its std, and what was counted.

    `pressed` (frames, 2) is the normal force of every frame in N, true and found; NaN where there is no map.
    """

    parts: list[Part]
    friction: tuple[float, float]
    counts: dict[str, int]
    pressed: Array

    def __getitem__(self, name: str) -> Part:
        return next(part for part in self.parts if part.name == name)


class Bench:
    """Pad, camera and dots, and the pictures of presses."""

    def __init__(self) -> None:
        self.pad = Pad(size=SIZE, thickness=THICKNESS, E=E, nu=NU, pitch=PITCH, layers=4)
        self.fine = Pad(size=SIZE, thickness=THICKNESS, E=E, nu=NU, pitch=PITCH / 2, layers=6)
        self.view = View.camera(focal=430, centre=(160, 120), distance=22e-3, depth=THICKNESS, gamma=1.4, tilt=0.15)
        x, y = np.meshgrid(np.arange(-6.5e-3, 6.6e-3, SPACING), np.arange(-4.5e-3, 4.6e-3, SPACING))
        self.dots = np.column_stack([x.ravel(), y.ravel()])
        self._rows = self.fine.from_surface(self.dots)
        lines = [(np.arange(round(side / DEPTH)) + 0.5) * DEPTH - side / 2 for side in SIZE]
        self._shape = len(lines[1]), len(lines[0])
        pixels = np.column_stack([a.ravel() for a in np.meshgrid(*lines)])
        self._deep = self.fine.from_surface(pixels)[2::3]
        self.worn = np.random.default_rng(5).permutation(len(self.dots))

    def motion(self, press: Press | None) -> tuple[Array, Array]:
        """Motion of the dots (N, 3), and normal motion of the surface (H, W), under a press, by the finer mesh."""
        if press is None:
            return np.zeros((len(self.dots), 3)), np.zeros(self._shape)
        U = self.fine.displacements(self.fine.surface.forces(press.traction(self.fine.nodes2d))).ravel()
        return np.asarray(self._rows @ U).reshape(-1, 3), np.asarray(self._deep @ U).reshape(self._shape)

    def depth(self, deep: Array, seed: int) -> DepthMap:
        """What is measured of the normal motion."""
        noise = DEPTH_NOISE * np.random.default_rng(seed + 1_000_000).standard_normal(deep.shape)
        return DepthMap(deep + noise, DEPTH, DEPTH_NOISE)

    def picture(self, moved: Array, scene: Scenery, seed: int) -> NDArray[np.uint8]:
        """What the camera gives."""
        if scene.black:
            return np.zeros(PIXELS, np.uint8)
        kept = self.worn[scene.worn :]
        places = np.column_stack([self.dots + moved[:, :2], moved[:, 2]])[kept]
        centres = self.view.to_pixels(places) + np.array([scene.knocked, 0.4 * scene.knocked])
        share = np.zeros(PIXELS)
        radius = DOT * np.linalg.norm(np.diff(self.view.to_pixels(np.array([[0, 0], [1e-3, 0]])), axis=0)) / 1e-3
        reach = int(radius + 4 * BLUR) + 1
        offset = np.arange(-reach, reach + 1)
        for cx, cy in centres:
            column, row = round(cx) + offset, round(cy) + offset
            column = column[(column >= 0) & (column < PIXELS[1])]
            row = row[(row >= 0) & (row < PIXELS[0])]
            away = np.hypot(column[None, :] - cx, row[:, None] - cy)
            disc = 1 / (1 + np.exp((away - radius) / (0.55 * BLUR)))
            here = np.ix_(row, column)
            share[here] = np.maximum(share[here], disc)
        grey = scene.light * (GEL + share * (INK - GEL))
        grey[:, : int(scene.hand * PIXELS[1])] = 0.6 * GEL * scene.light
        grey += NOISE * np.random.default_rng(seed).standard_normal(PIXELS)
        return np.clip(np.round(grey), 0, 255).astype(np.uint8)

    def eye(self) -> Eye:
        """An eye on the unloaded pad of the morning."""
        rest = [self.picture(self.motion(None)[0], Scenery("", ()), 10_000 + k) for k in range(8)]
        return Eye(self.view, rest[0], unloaded=rest[1:], size=SIZE)

    def sensor(self, eye: Eye, lam: float | None = None) -> MultilayerPad:
        """A sensor on this pad, with a ridge; lambda chosen on two presses, or as it was."""
        deep = self.depth(np.zeros(self._shape), 0)
        made = MultilayerPad(self.pad, eye=eye, depth=deep, choice=lam, penalty="identity")
        if lam is None:
            seen, depths = [], []
            for k, press in enumerate((_press(0.6, (0.1, 0.0)), _press(0.4, (0.0, 0.15)))):
                moved, deep = self.motion(press)
                seen.append(eye.read(self.picture(moved, Scenery("", ()), 20_000 + k))[0])
                depths.append(self.depth(deep, 20_000 + k))
            made.calibrate(seen, depths)
        return made


def _press(force: float = FORCE, shear: tuple[float, float] = (0.08, 0.0), x: float = 0.0) -> Press:
    return Press(at=(x, 0.0), radius=RADIUS, force=force, shear=shear)


def scenes(short: bool = False) -> list[Scenery]:
    """The day: rest and presses, and what else happens."""
    rest, held = (None,) * (60 if short else 90), (_press(),) * (20 if short else 45)
    slide = [_press(shear=(min(MU * FORCE * k / 15, MU * FORCE), 0.0), x=1e-3 * max(k - 15, 0) / 15 - 1.5e-3)
             for k in range(60)]  # fmt: skip
    return [
        Scenery("rest", rest),
        Scenery("press", held),
        Scenery("light falls by a third", held, light=0.67),
        Scenery("light is back", held),
        Scenery("black frames", (_press(),) * 10, black=True),
        Scenery("frames are back", held),
        Scenery("eight dots are worn off", held, worn=8),
        Scenery("hand over a third", held, worn=8, hand=0.33),
        Scenery("hand is gone", held, worn=8),
        Scenery("let go", rest, worn=8),
        Scenery("camera is knocked", rest, worn=8, knocked=1.5),
        Scenery("press after it", held, worn=8, knocked=1.5),
        Scenery("object slides", tuple(slide), worn=8, knocked=1.5),
        Scenery("stopped and started under a load", held, worn=8, knocked=1.5, restart=True),
    ]


def taken(bench: Bench, day: list[Scenery], start: int) -> Iterator[tuple[NDArray[np.uint8], DepthMap]]:
    """Frames and depth maps of some parts, one after another."""
    known: dict[Press | None, tuple[Array, Array]] = {}
    for scene in day:
        for press in scene.presses:
            if press not in known:
                known[press] = bench.motion(press)
            moved, deep = known[press]
            yield bench.picture(moved, scene, start), bench.depth(deep, start)
            start += 1


def lived(sensor: MultilayerPad, frames: Iterator[tuple[NDArray[np.uint8], DepthMap]], state: Path) -> Live:
    """The sensor on these frames."""
    pictures, depths = itertools.tee(frames)
    return Live(sensor, (p for p, _ in pictures), depths=(d for _, d in depths), rate=RATE, quiet=QUIET, state=state)


def live_day(short: bool = False) -> Day:
    """All of it."""
    bench, day = Bench(), scenes(short)
    cut = next(k for k, scene in enumerate(day) if scene.restart)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "state.h5"
        live = lived(bench.sensor(bench.eye()), taken(bench, day[:cut], 0), path)
        found = list(live)
        state = State.read(path)
        again = bench.sensor(state.rebuilt(bench.view, SIZE), state.lam)
        live = lived(again, taken(bench, day[cut:], 50_000), path)
        found += list(live)
    known = live.friction
    learned = (np.nan, np.nan) if known is None else (known.value, known.std)
    counts = {name: int(value) for name, value in live.counts.items()}
    return Day(_parts(day, found), learned, counts, _pressed(day, found))


def _pressed(day: list[Scenery], found: list[LiveFrame]) -> Array:
    """Normal forces (frames, 2), true and found."""
    true = [-_true(press)[2] for scene in day for press in scene.presses]
    pressed = np.column_stack([true, np.full(len(true), np.nan)])
    for frame in found:
        pressed[frame.number - 1, 1] = -frame.map.resultant().value[2]
    return pressed


def _parts(day: list[Scenery], found: list[LiveFrame]) -> list[Part]:
    """Frames, events and errors of each part."""
    parts, first = [], 1
    by_number = {frame.number: frame for frame in found}
    events = [event for frame in found for event in frame.events]
    for scene in day:
        end = first + len(scene.presses)
        inside = [by_number[k] for k in range(first, end) if k in by_number]
        sign = {"begins": "+", "ends": "-", "once": ""}
        said = [f"{sign[e.state]}{e.kind}" for e in events if first <= e.number < end]
        errors = [np.linalg.norm(f.map.resultant().value - _true(scene.presses[f.number - first]))
                  for f in inside if f.number >= end - LAST]  # fmt: skip
        last = float(np.linalg.norm(_true(scene.presses[-1])))
        worst = float(max(errors)) if errors else np.nan
        parts.append(Part(scene.name, len(scene.presses), len(inside), said, worst, last))
        first = end
    return parts


def _true(press: Press | None) -> Array:
    return np.zeros(3) if press is None else np.array(press.vector)


def show(found: Day) -> str:
    """The table in text."""
    lines = [f"{'what happened':33s} {'frames':>6s} {'maps':>5s} {'true N':>7s} {'error mN':>9s}  said"]
    for part in found.parts:
        error = "" if np.isnan(part.error) else f"{1e3 * part.error:.1f}"
        lines.append(f"{part.name:33s} {part.frames:6d} {part.maps:5d} {part.force:7.3f} {error:>9s}  "
                     f"{', '.join(part.said)}")  # fmt: skip
    value, std = found.friction
    lines.append(f"friction learned {value:.3f} +- {std:.3f}, true {MU}; {found.counts}")
    return "\n".join(lines)


def picture(found: Day, path: Path) -> None:
    """The normal force over the day, true and found, and its error, through the parts of the day."""
    from matplotlib.figure import Figure

    fig = Figure(figsize=(12.5, 7.0), layout="constrained")
    top, low = fig.subplots(2, 1, sharex=True, height_ratios=(5, 2))
    time = np.arange(len(found.pressed)) / RATE
    true, force = found.pressed.T
    top.plot(time, force, color="#0072b2", lw=1.3, label="found")
    top.plot(time, true, color="black", ls=(0, (5, 3)), lw=1, label="true")
    low.plot(time, 1e3 * (force - true), color="#0072b2", lw=1)
    low.axhline(0, color="grey", lw=0.8)
    start = 0
    for k, part in enumerate(found.parts):
        end = start + part.frames
        for ax in (top, low):
            ax.axvspan(start / RATE, end / RATE, color="grey", alpha=0.12 * (k % 2), lw=0)
        top.text((start + end) / 2 / RATE, 0.46, part.name, rotation=90, ha="center", va="bottom", fontsize=8.5)
        start = end
    top.set_ylim(-0.05, 1.15)
    top.set_yticks(np.arange(0, 0.5, 0.1))
    top.set_ylabel("normal force (N)", loc="bottom")
    top.legend(loc="lower left", fontsize=8)
    low.set_ylabel("error (mN)")
    low.set_xlabel("time (s)")
    low.set_xlim(0, time[-1])
    fig.savefig(path, dpi=110)


def main() -> None:
    """Print the table and save the picture."""
    found = live_day()
    print(show(found))
    target = Path("live_day.png")
    picture(found, target)
    print(f"picture: {target}")


if __name__ == "__main__":
    main()
