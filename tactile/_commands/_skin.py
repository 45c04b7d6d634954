"""A demonstration of learned maps that needs no file: a small skin, its presses, maps by physics and learning."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from loadid._commands import require_outputs
from loadid._learning.network import Schedule
from loadid._plots import rendered
from loadid.generate import TrainingSet
from structures.errors import InputError
from structures.files._storage import replace

from .._arrays import Array
from .._pad.pad import Pad
from .._results.forcemap import ForceMap
from .._sensors.learned import LearnedSensor
from .._sensors.linear import MultilayerPad
from .._sensors.observation import Markers
from ..generate import ContactRange, IndenterRange, PressDeclaration, presses
from ..vision._images import grid

DRAWS, TESTED, CHOSEN = 1500, 8, 6
SIZE, THICKNESS, E, NU, NOISE = (12e-3, 12e-3), 2.5e-3, 147e3, 0.45, 2e-6
KNOWN = (
    IndenterRange("sphere", 2.0, radius=(2e-3, 6e-3)),
    IndenterRange("flat", radius=(0.8e-3, 1.8e-3)),
    IndenterRange("cylinder", radius=(2e-3, 4e-3), length=(2e-3, 4e-3)),
    IndenterRange("polygon", radius=(1e-3, 2e-3), corners=(3, 6)),
)
RING = IndenterRange("ring", outer=(1.6e-3, 2e-3), inner=(1e-3, 1.3e-3))
PLATE = IndenterRange("flat", radius=(3e-3, 3.4e-3), depth=(1.1e-3, 1.3e-3))
PLAN = Schedule(epochs=20, batch=32)
WITHIN, MIDDLE = (-3e-3, 3e-3), (-1e-3, 1e-3)
FILES = {"map": "map.h5", "plot": "map.png"}


@dataclass(frozen=True)
class Line:
    """What one way made of presses: median error of the maps, mean error of the normal force, share called strange."""

    way: str
    presses: str
    error: float
    normal: float
    strange: float


@dataclass(frozen=True)
class Learned:
    """What the demonstration found; seconds of its steps, files written, and what was left out, if anything."""

    lines: list[Line]
    seconds: dict[str, float]
    written: list[str]
    without: str

    @property
    def data(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return {
            "maps": [vars(line) for line in self.lines], "seconds": self.seconds, "written": self.written,
            "left_out": self.without,
        }  # fmt: skip


def demo(
    folder: str | Path = "learn-demo", *, draws: int = DRAWS, seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Learned:  # fmt: skip
    """Draw presses, learn maps of a small skin, and hold them against presses and a ring that they never saw.

    Leaves the training set, the best map and a picture in a folder.

    Raises
    ------
    InputError
        A folder that cannot be made, or that holds another set.
    """
    tell, place = progress or (lambda share, words: None), Path(folder)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("the folder cannot be made", where=str(place), found=error.strerror or error) from error
    files = {name: place / file for name, file in FILES.items()}
    require_outputs({name: str(path) for name, path in files.items()})
    clock = [time.perf_counter()]
    of = skin()
    training = _drawn(of, KNOWN, place / "training", draws, seed, lambda f, w: tell(0.5 * f, w))
    of = skin(float(of.choice_on(training.read(slice(0, CHOSEN)).data).lam))
    tests = {
        "presses like these": _drawn(of, KNOWN, place / "test", TESTED, seed + 1, None),
        "a ring, never seen": _drawn(of, [RING], place / "ring", TESTED, seed + 2, None),
        "a plate, far too deep": _drawn(of, [PLATE], place / "plate", TESTED, seed + 3, None, MIDDLE),
    }
    clock.append(time.perf_counter())
    learned, without = _learned(of, training, seed, lambda f, w: tell(0.5 + 0.4 * f, w))
    clock.append(time.perf_counter())
    samples = {name: (kept.read().data, kept.read().loads) for name, kept in tests.items()}
    lines = [line for name, sample in samples.items() for line in _lines(name, sample, of, learned)]
    figure = picture({name: (y[0], g[0]) for name, (y, g) in samples.items()}, of, learned)
    replace(files["plot"], rendered(figure, str(files["plot"])))
    next(reversed(learned.values())).save(files["map"])
    clock.append(time.perf_counter())
    seconds = dict(zip(("drawing", "learning", "answering"), np.diff(clock).tolist(), strict=True))
    return Learned(lines, seconds, [str(path) for path in files.values()], without)


def skin(choice: float | None = None) -> MultilayerPad:
    """A pad of 12 x 12 x 2.5 mm with 121 markers, whose motion is seen in the plane."""
    sides = tuple(round(1e3 * side) for side in SIZE)
    gel = Pad(size=SIZE, thickness=THICKNESS, E=E, nu=NU, elements=(sides[0], sides[1]), layers=3, allow=("W115",))
    return MultilayerPad(gel, Markers(grid(11, 11, 1e-3), NOISE), choice=choice)


def _drawn(
    of: MultilayerPad, bodies: Sequence[IndenterRange], folder: Path, draws: int, seed: int, progress: Any,
    within: tuple[float, float] = WITHIN,
) -> TrainingSet:  # fmt: skip
    contact = ContactRange(x=within, y=within, depth=(0.1e-3, 0.4e-3), shear=(0.0, 0.25e-3), friction=(0.3, 0.9))
    return presses(of, PressDeclaration(bodies, contact), folder, draws=draws, seed=seed, progress=progress)


def _learned(
    of: MultilayerPad, training: TrainingSet, seed: int, progress: Callable[[float, str], None]
) -> tuple[dict[str, LearnedSensor], str]:
    """The best linear map, and the network where there is something to train it with."""
    found = {"linear": LearnedSensor.fit(of, training, engine="linear", seed=seed)}
    if find_spec("torch") is None:
        return found, "the network: torch is not installed (pip install 'loadid[learn]')"
    found["network"] = LearnedSensor.fit(of, training, engine="torch", seed=seed, schedule=PLAN, progress=progress)
    return found, ""


def _lines(name: str, sample: tuple[Array, Array], of: MultilayerPad, learned: dict[str, LearnedSensor]) -> list[Line]:
    normal = np.asarray(of.geometry["resultant"])[2]
    ways: dict[str, Callable[[Array], ForceMap]] = {"physics": of.explained}
    ways |= {way: one.explained for way, one in learned.items()}
    out = []
    for way, answer in ways.items():
        maps = [answer(y) for y in sample[0]]
        error = [np.linalg.norm(m.load - g) / np.linalg.norm(g) for m, g in zip(maps, sample[1], strict=True)]
        force = [abs(m.load @ normal / (g @ normal) - 1) for m, g in zip(maps, sample[1], strict=True)]
        strange = np.mean([m.facts.answered_by == "physics" for m in maps])
        out.append(Line(way, name, float(np.median(error)), float(np.mean(force)), float(strange)))
    return out


def picture(shown: dict[str, tuple[Array, Array]], of: MultilayerPad, learned: dict[str, LearnedSensor]) -> Any:
    """Pressure, true and found, of one press of each kind; a frame round what the physics answered instead."""
    from matplotlib.figure import Figure

    names = ["truth", "physics", *learned]
    fig = Figure(figsize=(2.7 * len(names), 2.7 * len(shown)), layout="constrained")
    panels = fig.subplots(len(shown), len(names), sharex=True, sharey=True, squeeze=False)
    x, y = 1e3 * np.asarray(of.geometry["coordinates"])[:, :2].T
    for row, (name, (data, truth)) in zip(panels, shown.items(), strict=True):
        maps: list[ForceMap | None] = [None, of.explained(data), *(one.explained(data) for one in learned.values())]
        true = -1e-3 * truth.reshape(-1, 3)[:, 2]
        for ax, way, found in zip(row, names, maps, strict=True):
            value = true if found is None else 1e-3 * found.pressure()
            image = ax.tripcolor(x, y, value, cmap="RdBu_r", vmin=-true.max(), vmax=true.max(), shading="gouraud",
                                 rasterized=True)  # fmt: skip
            ax.set_aspect("equal")
            said = way if found is None else f"{way}: error {_off(found, truth):.2f}"
            ax.set_title(said, fontsize=9)
            if found is not None and way in learned and found.facts.answered_by == "physics":
                ax.set_xlabel("W609: answered by physics", color="tab:red", fontsize=9)
                for side in ax.spines.values():
                    side.set(color="tab:red", linewidth=2.5)
        row[0].set_ylabel(name)
        fig.colorbar(image, ax=row, shrink=0.8).set_label("pressure (kPa)")
    return fig


def _off(found: ForceMap, truth: Array) -> float:
    return float(np.linalg.norm(found.load - truth) / np.linalg.norm(truth))


def text(done: Learned) -> str:
    """The whole story as lines."""
    seconds = ", ".join(f"{name} {value:.0f} s" for name, value in done.seconds.items())
    return "\n".join([
        "A small skin, seen in its plane: maps of presses that were simulated, by the physics and by what it taught.",
        f"{'presses':20s} {'by':8s} error of the map  of the normal force  strange",
        *(f"{one.presses:20s} {one.way:8s} {one.error:16.2f} {one.normal:20.1%} {one.strange:8.0%}"
          for one in done.lines),
        *([f"left out: {done.without}"] if done.without else []),
        seconds,
        f"written: {', '.join(done.written)}",
    ])  # fmt: skip
