"""A skin that learned its presses from simulation: force maps by a network, beside the best linear map and the physics.

After Sferrazza, Wahlsten, Trueeb & D'Andrea, Ground truth force distribution for learning-based tactile sensing, IEEE
Access 7 (2019), and FEATS (arXiv 2411.03315): finite elements label images, a network maps them. Here the images are
rendered (2 grey levels of noise, blur, a tilted camera), the labels are those of rigid bodies of eight kinds in contact
with friction, and the gel that moves is a finer mesh than the inverse has, whose modulus and Poisson's ratio are not
exactly those that the inverse believes in. The map is judged on presses of another seed, on bodies that it never saw
(square, ring, bar), and on gels that it never saw (20 % stiffer, nu .40). Maps for any gel learned from presses on
gels whose modulus and nu nobody measured: their band holds what motion does not tell.

A map's error is the L2 norm of what is wrong with its tractions at all nodes over that of the truth: the median over
the presses. In the plane alone the pressure is hardly seen; with a depth map it is.

Run ``python -m case_studies.learned_skin [DRAWS]``: prints the table and saves ``learned_skin.png``. 5000 draws take a
quarter of an hour of one core; what was drawn and learned stays in the folder ``learned_skin``, and a second run takes
it from there.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from loadid.generate import TrainingSet
from structures.errors import InputError
from tactile import ContactLaw, DepthMap, Eye, LearnedSensor, MultilayerPad, Pad, View
from tactile.generate import (
    CameraRange,
    ContactRange,
    GelRange,
    ImageRange,
    IndenterRange,
    PressDeclaration,
    presses,
)

from .learned_chain import auc

Array = np.ndarray
E, NU, SIZE, THICKNESS = 147e3, 0.45, (16e-3, 14e-3), 3e-3
IMAGE = (360, 400)
DOT = 4.5  # px, radius of a dot
PIXEL, PIXEL_NOISE = 0.25e-3, 10e-6  # of the depth map
KNOWN = (
    IndenterRange("sphere", 2.0, radius=(2e-3, 8e-3)),
    IndenterRange("cylinder", radius=(2e-3, 5e-3), length=(3e-3, 6e-3)),
    IndenterRange("flat", radius=(1e-3, 2.5e-3)),
    IndenterRange("cone", slope=(0.15, 0.6)),
    IndenterRange("edge", slope=(0.2, 0.8), length=(3e-3, 6e-3)),
    IndenterRange("polygon", radius=(1.2e-3, 2.6e-3), corners=(3, 7)),
)
UNSEEN = {
    "square": IndenterRange("bar", length=3e-3, width=3e-3),
    "ring": IndenterRange("ring", outer=(1.8e-3, 2.5e-3), inner=(0.9e-3, 1.4e-3)),
    "bar": IndenterRange("bar", length=(4e-3, 5.5e-3), width=(1e-3, 1.5e-3)),
}
GELS = (0.65, 1.35), (0.36, 0.49)  # modulus over what is believed, and nu, of gels that nobody measured
TESTED, OFTENER = 200, 5  # presses of each row; times as many in the set, whose median is compared with a goal


def pad(nu: float = NU, finer: int = 1) -> Pad:
    """The gel: a mesh of 1 mm for the inverse, of 0.5 mm for the truth."""
    counts = (round(SIZE[0] * 1e3) * finer, round(SIZE[1] * 1e3) * finer)
    return Pad(size=SIZE, thickness=THICKNESS, E=E, nu=nu, elements=counts, layers=3 * finer, allow=("W115",))


def eye() -> Eye:
    """A camera that looks at 195 dots, slightly tilted, and frames of the untouched gel."""
    x, y = np.meshgrid(np.arange(-7, 8) * 1e-3, np.arange(-6, 7) * 1e-3)
    view = View.camera(focal=560, centre=(200, 180), distance=22e-3, depth=3e-3, gamma=1.4, tilt=0.06)
    dots = view.to_pixels(np.column_stack([x.ravel(), y.ravel()]))
    pixels = np.stack(np.meshgrid(np.arange(IMAGE[1]), np.arange(IMAGE[0])), axis=-1)
    cover = np.clip(DOT - cKDTree(dots).query(pixels)[0] + 0.5, 0, 1)
    light, rng = gaussian_filter(160 - 100 * cover, 1.0), np.random.default_rng(0)
    frames = [np.clip(light + 2 * rng.standard_normal(IMAGE), 0, 255).astype(np.uint8) for _ in range(6)]
    return Eye(view, frames[0], unloaded=frames[1:], size=SIZE)


def sensor(deep: bool, camera: Eye | None = None) -> MultilayerPad:
    """The sensor that a user believes in: markers in the plane, with a depth map or without."""
    template = DepthMap(np.zeros((48, 56)), PIXEL, PIXEL_NOISE)
    return MultilayerPad(pad(), eye=camera or eye(), depth=template if deep else None)


def declared(
    bodies: Sequence[IndenterRange], stiffness: tuple[float, float] = (0.95, 1.05),
    nu: tuple[float, float] | None = None,
) -> PressDeclaration:  # fmt: skip
    """Presses up to .5 mm deep, dragged up to .35 mm, under a camera that was mounted again."""
    return PressDeclaration(
        bodies,
        ContactRange(x=(-4e-3, 4e-3), y=(-3e-3, 3e-3), depth=(0.1e-3, 0.5e-3), shear=(0.0, 0.35e-3),
                     twist=(-0.05, 0.05), friction=(0.3, 0.9)),
        GelRange(E=stiffness, nu=nu),
        CameraRange(shift=(-1.0, 1.0), turn=(-0.005, 0.005)),
        ImageRange(size=IMAGE, blur=(0.8, 1.3)),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Sets:
    """Training set, and the presses of each row of the table."""

    training: TrainingSet
    tests: dict[str, TrainingSet]

    def without_depth(self, of: MultilayerPad) -> Sets:
        """The same presses as a sensor without a depth map reads them."""
        return Sets(_fewer(self.training, of), {name: _fewer(kept, of) for name, kept in self.tests.items()})


def _fewer(kept: TrainingSet, of: MultilayerPad) -> TrainingSet:
    seen, count = kept.read(), len(of.model.sensors)
    less = replace(seen, data=seen.data[:, :count], noise=seen.noise[..., :count],
                   missing=None if seen.missing is None else seen.missing[:, :count])  # fmt: skip
    return TrainingSet.of(less, sensors=of.model.sensors, loads=of.model.loads)


def drawn(of: MultilayerPad, folder: Path, draws: int, tested: int = TESTED, workers: int | None = None) -> Sets:
    """All presses, from a folder or made by so many processes."""
    truth, strange = [pad(nu, 2) for nu in (0.44, 0.45, 0.46)], pad(0.40, 2)

    def some(name: str, bodies: Sequence[IndenterRange], seed: int, gel: Any = truth, E: Any = (0.95, 1.05)) -> Any:
        count = {"training": draws, "in the set": OFTENER * tested}.get(name, tested)
        told = declared(bodies, E)
        return presses(of, told, folder / name, draws=count, seed=seed, truth=gel, workers=workers)

    tests = {"in the set": some("in the set", KNOWN, 1)}
    tests |= {name: some(name, [body], 2 + k) for k, (name, body) in enumerate(UNSEEN.items())}
    tests["other gel"] = some("other gel", KNOWN, 9, strange, (1.2, 1.2))
    return Sets(some("training", KNOWN, 0), tests)


@dataclass(frozen=True, eq=False)
class Row:
    """What one way made of some presses.

    Parameters
    ----------
    way, presses : str
    error : float
        Of the map, median.
    normal, shear : float
        Error of the normal force over the true one, median, and mean error of the shear over the mean normal force.
    covered, loaded : float
        Share of all tractions in their 95 % band, and of those that carry a load.
    wrench : float
        Share of the forces in their band, all axes.
    flagged : float
        Share of the presses that were taken for others than those learned.
    """

    way: str
    presses: str
    error: float
    normal: float
    shear: float
    covered: float
    loaded: float
    wrench: float
    flagged: float


def judged(
    way: str, name: str, of: MultilayerPad, answer: Callable[[Array], Any], kept: TrainingSet, count: int | None = None
) -> Row:
    """A row of the table, of the first `count` presses of a set or of all."""
    seen = kept.read(slice(0, count))
    R = np.asarray(of.geometry["resultant"])[:3]
    rows = []
    for y, load in zip(seen.data, seen.loads, strict=True):
        found = answer(y)
        force, off = R @ load, np.abs(found.load - load)
        inside, on = off <= 1.96 * found.std, np.abs(load) > 0.05 * np.abs(load).max()
        told = found.resultant()
        rows.append([
            np.linalg.norm(off) / np.linalg.norm(load), abs(told.value[2] / force[2] - 1),
            np.abs(told.value[:2] - force[:2]).mean(), abs(force[2]), inside.mean(), inside[on].mean(),
            np.mean(np.abs(told.value - force) <= 1.96 * told.std), found.facts.answered_by == "physics",
        ])  # fmt: skip
    x = np.array(rows, float)
    mean = x.mean(axis=0)
    middle = np.median(x[:, :2], axis=0)
    return Row(way, name, float(middle[0]), float(middle[1]), mean[2] / mean[3], *map(float, mean[4:]))


def of_any_gel(of: MultilayerPad, folder: Path, draws: int, tested: int = TESTED) -> Sets:
    """Presses on gels whose modulus and nu nobody measured: to learn from, and to judge on."""
    told = declared(KNOWN, *GELS)
    training, test = (presses(of, told, folder / name, draws=count, seed=seed, truth=pad(NU, 2))
                      for name, count, seed in (("gels", draws, 0), ("gels, in the set", tested, 1)))  # fmt: skip
    return Sets(training, {"any gel": test})


def learned(
    of: MultilayerPad, sets: Sets, engine: str, progress: Any = None, folder: Path | None = None,
    name: str = "", **settings: Any,
) -> LearnedSensor:  # fmt: skip
    """The map of an engine; one that a folder keeps, where it was learned from these presses."""
    kept = None if folder is None else folder / f"{engine}, {'plane' if of.depth is None else 'depth'}{name}.h5"
    if kept is not None and kept.exists():
        one = LearnedSensor.read(kept, of)
        if one.fitted.facts["training"] == sets.training.fingerprint:
            return one
    start = time.process_time()
    one = LearnedSensor.fit(of, sets.training, engine=engine, progress=progress, **settings)
    if kept is not None:
        one.save(kept)
        print(f"{kept.stem}: learned in {time.process_time() - start:.0f} s of processor", flush=True)
    return one


def by_map(name: str, one: LearnedSensor, sets: Sets) -> list[Row]:
    """A map on every kind of press."""
    return [judged(name, row, one.sensor, one.explained, kept) for row, kept in sets.tests.items()]


def by_physics(of: MultilayerPad, sets: Sets, count: int) -> list[Row]:
    """The sensor's own answers to the first presses of each kind, lambda from some presses of the training set."""
    choice = of.choice_on(sets.training.read(slice(0, 6)).data)
    depth = None if of.depth is None else of.depth.template
    rows = []
    for way, law in (("physics", ContactLaw()), ("physics, no pull", ContactLaw(no_pull=True))):
        one = MultilayerPad(of.pad, eye=of.eye, depth=depth, contact=law, choice=float(choice.lam))
        for name, kept in sets.tests.items():
            rows.append(judged(way, name, one, one.explained, kept, count))
    return rows


def told_apart(one: LearnedSensor, sets: Sets) -> dict[str, float]:
    """How well the novelty tells presses of each row from those of the first (AUC)."""
    novelty = {name: [v.value for v in one.fitted.predict(kept.read().data).verdicts]
               for name, kept in sets.tests.items()}  # fmt: skip
    known, *others = novelty
    return {name: auc(novelty[known], novelty[name]) for name in others}


def of_the_gel(one: LearnedSensor, kept: TrainingSet) -> tuple[float, float]:
    """By how much of the normal force, in the median, its error goes with modulus and nu of the gel, and what is left.

    No reading tells these: by least squares over the presses, of the values that were drawn.
    """
    seen, R = kept.read(), one.sensor.resultant[2]
    off = one.fitted.mean(seen.data) @ R / (seen.loads @ R) - 1
    gel = np.column_stack([seen.parameters["E"] / E - 1, seen.parameters["nu"] - NU])
    found = np.linalg.lstsq(np.column_stack([gel, np.ones(len(off))]), off, rcond=None)[0]
    by_gel = gel @ found[:2]
    return float(np.median(np.abs(by_gel))), float(np.median(np.abs(off - by_gel)))


def rate(one: LearnedSensor, y: Array, times: int = 50) -> float:
    """Maps a second of one core, from readings."""
    one.explained(y)
    start = time.process_time()
    for _ in range(times):
        one.explained(y)
    return times / (time.process_time() - start)


def show(rows: Sequence[Row]) -> str:
    """The table in text."""
    lines = [
        f"{'':29s}  map     force off         in their 95 % band       taken for",
        f"{'way':17s} {'presses':11s} error  normal  shear    all  loaded  forces   strange",
    ]
    lines += [
        f"{r.way:17s} {r.presses:11s} {r.error:5.2f} {r.normal:7.1%} {r.shear:6.1%} {r.covered:7.1%} {r.loaded:6.1%} "
        f"{r.wrench:7.1%} {r.flagged:8.0%}"
        for r in rows
    ]
    return "\n".join(lines)


def picture(maps: Sequence[tuple[str, LearnedSensor]], sets: Sets, path: Path) -> None:
    """Pressure, true and found, of the first press of each kind; a cross where the map would not answer."""
    from matplotlib.figure import Figure

    fig = Figure(figsize=(2.4 * len(sets.tests), 2.2 * (1 + len(maps))), layout="constrained")
    panels = fig.subplots(1 + len(maps), len(sets.tests), sharex=True, sharey=True, squeeze=False)
    for column, (name, kept) in enumerate(sets.tests.items()):
        seen = kept.read(slice(0, 1))
        truth = -1e-3 * seen.loads[0].reshape(-1, 3)[:, 2]
        found = [(way, one.explained(seen.data[0])) for way, one in maps]
        shown = [(f"{name}, true", truth), *((_title(way, f), 1e-3 * f.pressure()) for way, f in found)]
        x, y = 1e3 * found[0][1].nodes[:, :2].T
        for ax, (title, pressure) in zip(panels[:, column], shown, strict=True):
            image = ax.tripcolor(x, y, pressure, cmap="RdBu_r", vmin=-truth.max(), vmax=truth.max(), shading="gouraud",
                                 rasterized=True)  # fmt: skip
            ax.set_title(title, fontsize=8)
            ax.set_aspect("equal")
        fig.colorbar(image, ax=panels[:, column], shrink=0.5, location="bottom").set_label("pressure (kPa)")
    fig.supxlabel("x (mm)")
    fig.supylabel("y (mm)")
    fig.savefig(path, dpi=110)


def _title(way: str, found: Any) -> str:
    return f"{way}: {'strange, by physics' if found.facts.answered_by == 'physics' else 'answered'}"


def main(draws: int = 5000) -> None:
    """Print the table, and save the picture."""
    whole = sensor(deep=True)
    flat, folder = sensor(deep=False), Path("learned_skin")
    sets, gels = drawn(whole, folder, draws), of_any_gel(whole, folder, draws)
    for title, of in (("markers in the plane", flat), ("and a depth map", whole)):
        own, other = (sets, gels) if of is whole else (sets.without_depth(flat), gels.without_depth(flat))
        judging = Sets(own.training, {**own.tests, **other.tests})
        rows, ways = by_physics(of, judging, 8), {}
        for name, engine in (("best linear map", "linear"), ("network", "torch")):
            try:
                ways[name] = learned(of, own, engine, folder=folder, unseen=())  # one band: this gel is known
            except InputError as error:
                print(f"{name}: {error.what}")
                continue
            rows += by_map(name, ways[name], judging)
            if engine == "linear" or of is flat:
                rows += by_map(f"{engine}, any gel", learned(of, other, engine, folder=folder, name=", gels"), judging)
        print(f"{title}, {draws} presses:", show(rows), sep="\n", flush=True)
        for name, one in ways.items():
            print(f"{name}: {rate(one, own.tests['in the set'].read([0]).data[0]):.0f} maps a second of one core")
            gel, rest = of_the_gel(one, own.tests["in the set"])
            print(
                f"normal force in the set: off by {gel:.1%} by the gel, which no reading tells, {rest:.1%} without it"
            )
            apart = ", ".join(f"{row} {value:.2f}" for row, value in told_apart(one, own).items())
            print(f"told from presses of the set by novelty (AUC): {apart}")
        path = Path(f"learned_skin{'_depth' if of is whole else ''}.png")
        picture(list(ways.items()), own, path)
        print(f"picture: {path}\n", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
