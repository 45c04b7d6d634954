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
from structures._threads import one_thread
from structures.errors import InputError
from structures.files._storage import replace

from .._arrays import Array
from .._pad.pad import Pad
from .._results.forcemap import ForceMap
from .._sensors.learned import LearnedSensor
from .._sensors.multilayer import MultilayerPad
from .._sensors.observation import Markers
from ..generate import ContactRange, IndenterRange, PressDeclaration, presses
from ..vision._images import grid

DRAWS, CHOSEN = 1500, 6
TESTED, ASKED, DEEP = 48, 4, 2  # presses that maps answer, those of them that the physics does, too deep ones
LEAST = 100  # draws, of which a fifth calibrates
SIZE, THICKNESS, E, NU, NOISE = (12e-3, 12e-3), 2.5e-3, 147e3, 0.45, 2e-6
KNOWN = (
    IndenterRange("sphere", 2.0, radius=(2e-3, 6e-3)),
    IndenterRange("flat", radius=(0.8e-3, 1.8e-3)),
    IndenterRange("cylinder", radius=(2e-3, 4e-3), length=(2e-3, 4e-3)),
    IndenterRange("polygon", radius=(1e-3, 2e-3), corners=(3, 6)),
)
RING = IndenterRange("ring", outer=(1.6e-3, 2e-3), inner=(1e-3, 1.3e-3))
PLATE = IndenterRange("flat", radius=(3.4e-3, 3.8e-3), depth=(1.4e-3, 1.6e-3))
PLAN = Schedule(epochs=12, batch=32, rate=3e-3)
WITHIN, MIDDLE = (-3e-3, 3e-3), (-1e-3, 1e-3)
LOADED = 0.05  # of the largest traction: nodes that carry a load
NOTES = (
    "in band: tractions of loaded nodes within the 95 % band that was told.",
    "strange: presses that the map leaves to the physics. The alarm tells readings that are unlike, not bodies: a ring",
    "that was never seen is answered too. The plate was chosen to set it off: it is pressed four times as deep as",
    "any press that was learned.",
)
FILES = {"map": "map.h5", "plot": "map.png"}


@dataclass(frozen=True)
class Line:
    """What one way made of so many presses: median errors of map and normal force, shares in the band and strange."""

    way: str
    presses: str
    count: int
    error: float
    normal: float
    held: float
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
        Too few draws, a folder that cannot be made, or that holds another set.
    """
    if draws < LEAST:
        raise InputError("too few draws for a map that states its std", where="--draws", found=draws,
                         expected=f"at least {LEAST}", hint="leave --draws out, for a map of use")  # fmt: skip
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
        "a plate, far too deep": _drawn(of, [PLATE], place / "plate", DEEP, seed + 3, None, MIDDLE),
    }
    clock.append(time.perf_counter())
    learned, without = _learned(of, training, seed, lambda f, w: tell(0.5 + 0.4 * f, w))
    clock.append(time.perf_counter())
    loads = {name: kept.read().loads for name, kept in tests.items()}
    with one_thread():  # its matrices are too small to be shared
        answers = {name: _answers(kept.read().data, of, learned) for name, kept in tests.items()}
    lines = [line for name, found in answers.items() for line in _lines(name, found, loads[name])]
    replace(files["plot"], rendered(picture(loads, answers), str(files["plot"])))
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
    several: dict[str, Any] = {"bodies": 3, "several": 0.3, "apart": (1.2e-3, 2.5e-3)} if bodies is KNOWN else {}
    contact = ContactRange(x=within, y=within, depth=(0.1e-3, 0.4e-3), shear=(0.0, 0.25e-3), friction=(0.3, 0.9),
                           **several)  # fmt: skip
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


def _answers(data: Array, of: MultilayerPad, learned: dict[str, LearnedSensor]) -> dict[str, list[ForceMap]]:
    """Maps of presses by each way; by the physics, which takes seconds for each, of the first."""
    by_physics = {"physics": [of.explained(y) for y in data[:ASKED]]}
    return by_physics | {way: [one.explained(y) for y in data] for way, one in learned.items()}


def _lines(name: str, answers: dict[str, list[ForceMap]], loads: Array) -> list[Line]:
    out = []
    for way, maps in answers.items():
        own = list(zip(maps, loads, strict=False))  # the physics was asked for the first alone
        normal = np.asarray(maps[0].geometry["resultant"])[2]  # type: ignore[index]
        error = [_off(found, truth) for found, truth in own]
        force = [abs(found.load @ normal / (truth @ normal) - 1) for found, truth in own]
        held = np.mean([_held(found, truth) for found, truth in own])
        strange = np.mean([found.facts.answered_by == "physics" for found in maps])
        out.append(Line(way, name, len(own), *map(float, (np.median(error), np.median(force), held, strange))))
    return out


def picture(loads: dict[str, Array], answers: dict[str, dict[str, list[ForceMap]]]) -> Any:
    """Pressure, true and found, of one press of each kind; a frame round what the physics answered instead."""
    from matplotlib.figure import Figure

    ways = list(next(iter(answers.values())))
    fig = Figure(figsize=(2.7 * (1 + len(ways)), 2.7 * len(loads)), layout="constrained")
    panels = fig.subplots(len(loads), 1 + len(ways), sharex=True, sharey=True, squeeze=False)
    for row, (name, maps) in zip(panels, answers.items(), strict=True):
        truth = loads[name][0]
        true = -1e-3 * truth.reshape(-1, 3)[:, 2]
        shown = [("truth", true), *((f"{way}: error {_off(maps[way][0], truth):.2f}", 1e-3 * maps[way][0].pressure())
                                    for way in ways)]  # fmt: skip
        x, y = 1e3 * maps[ways[0]][0].nodes[:, :2].T
        for ax, (title, value) in zip(row, shown, strict=True):
            image = ax.tripcolor(x, y, value, cmap="RdBu_r", vmin=-true.max(), vmax=true.max(), shading="gouraud",
                                 rasterized=True)  # fmt: skip
            ax.set_aspect("equal")
            ax.set_title(title, fontsize=9)
        for ax, way in zip(row[1:], ways, strict=True):
            if way != "physics" and maps[way][0].facts.answered_by == "physics":
                ax.set_xlabel("W609: answered by physics", color="tab:red", fontsize=9)
                for side in ax.spines.values():
                    side.set(color="tab:red", linewidth=2.5)
        row[0].set_ylabel(f"{name}\ny (mm)")
        fig.colorbar(image, ax=row, shrink=0.8).set_label("pressure (kPa)")
    fig.supxlabel("x (mm)", fontsize="medium")
    return fig


def _off(found: ForceMap, truth: Array) -> float:
    return float(np.linalg.norm(found.load - truth) / np.linalg.norm(truth))


def _held(found: ForceMap, truth: Array) -> float:
    acts = np.abs(truth) > LOADED * np.abs(truth).max()
    return float(np.mean(np.abs(found.load - truth)[acts] <= 1.96 * found.std[acts]))


def text(done: Learned) -> str:
    """The whole story as lines."""
    seconds = ", ".join(f"{name} {value:.0f} s" for name, value in done.seconds.items())
    return "\n".join([
        "A small skin, seen in its plane: maps of presses that were simulated, by the physics and by what it taught.",
        f"{'presses':21s} {'by':8s} {'of':>3s}  error of the map  of the normal force  in band  strange",
        *(f"{one.presses:21s} {one.way:8s} {one.count:3d} {one.error:17.2f} {one.normal:20.1%} {one.held:8.0%} "
          f"{one.strange:8.0%}" for one in done.lines),
        *NOTES,
        *([f"left out: {done.without}"] if done.without else []),
        seconds,
        f"written: {', '.join(done.written)}",
    ])  # fmt: skip
