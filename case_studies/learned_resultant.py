"""The force on a skin, on bodies that no map has seen: a network for the resultant beside every other way to it.

After FeelAnyForce (ICRA 2025), which regresses the resultant from images; here presses, gels and camera are those of
`case_studies.learned_skin`, markers are seen in the plane alone, and all ways stand in one table: `MultilayerPad` by
itself and with pressures that may not pull, the best linear map and the network, as maps whose tractions are summed and
as maps of the resultant itself, learned for a gel that is known within 5 % and for any gel. Errors are means over
presses with square, ring and bar, which are in no training set, over the range of each force in that set.

Run ``python -m case_studies.learned_resultant [DRAWS]``: prints the table and saves ``learned_resultant.png``; draws
and maps are kept in the folder ``learned_skin``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loadid import LearnedMap
from loadid.generate import TrainingSet
from structures.errors import InputError
from tactile import ContactLaw, MultilayerPad

from .learned_skin import UNSEEN, Sets, drawn, learned, of_any_gel, sensor

Array = np.ndarray
AXES = ("Fx", "Fy", "Fz")
GIVEN = 8  # presses of each kind that the slow ways are asked for
Forces = Callable[[Array], tuple[Array, Array, Array]]


@dataclass(frozen=True, eq=False)
class Answers:
    """Forces of one way: true and found (n, 3) in N, their std, and which were taken for strange (n,)."""

    way: str
    presses: str
    true: Array
    found: Array
    std: Array
    strange: Array

    def off(self, span: Array) -> Array:
        """Mean absolute error over a range (3,)."""
        return np.asarray(np.abs(self.found - self.true).mean(axis=0) / span)

    @property
    def covered(self) -> float:
        """Share of the forces in their 95 % band."""
        return float(np.mean(np.abs(self.found - self.true) <= 1.96 * self.std))


def span(of: MultilayerPad, sets: Sets) -> Array:
    """Range (3,) of the forces of the training set, from the 1st to the 99th of 100 (N)."""
    low, high = np.quantile(_true(of, sets.training.read().loads), [0.01, 0.99], axis=0)
    return np.asarray(high - low)


def _true(of: MultilayerPad, loads: Array) -> Array:
    return np.asarray(loads @ np.asarray(of.geometry["resultant"])[:3].T)


def of_maps(answer: Callable[[Array], Any]) -> Forces:
    """Forces of force maps."""

    def forces(data: Array) -> tuple[Array, Array, Array]:
        maps = [answer(y) for y in data]
        told = [m.resultant() for m in maps]
        strange = [m.facts.answered_by == "physics" for m in maps]
        return np.array([t.value for t in told]), np.array([t.std for t in told]), np.array(strange)

    return forces


def of_resultants(fitted: Any) -> Forces:
    """Forces of a map of the resultant."""

    def forces(data: Array) -> tuple[Array, Array, Array]:
        told = fitted.predict(data)
        return told.mean[:, :3], told.std[:, :3], np.array([v.alarm for v in told.verdicts])

    return forces


def answered(way: str, of: MultilayerPad, forces: Forces, sets: Sets, count: int | None = None) -> list[Answers]:
    """What one way says of all presses, or of the first of each kind."""
    out = []
    for name, kept in sets.tests.items():
        seen = kept.read(slice(0, count))
        out.append(Answers(way, name, _true(of, seen.loads), *forces(seen.data)))
    return out


def by_physics(of: MultilayerPad, sets: Sets, count: int = GIVEN) -> list[Answers]:
    """The sensor by itself, and with pressures that may not pull; lambda from presses of the training set."""
    lam = float(of.choice_on(sets.training.read(slice(0, 6)).data).lam)
    out = []
    for way, law in (("MultilayerPad", ContactLaw()), ("no pull", ContactLaw(no_pull=True))):
        one = MultilayerPad(of.pad, eye=of.eye, contact=law, choice=lam)
        out += answered(way, one, of_maps(one.explained), sets, count)
    return out


def by_learning(of: MultilayerPad, sets: Sets, engine: str, folder: Path | None = None, gels: TrainingSet | None = None,
                **settings: Any) -> list[Answers]:  # fmt: skip
    """Maps of an engine, their tractions summed, and its map of the resultant; of a known gel, or of any."""
    name = {"linear": "LMMSE", "torch": "network"}[engine] + ("" if gels is None else ", any gel")
    own = sets if gels is None else Sets(gels, sets.tests)
    told = {"unseen": ()} | settings if gels is None else settings  # a known gel has one band
    summed = learned(of, own, engine, folder=folder, name="" if gels is None else ", gels", **told)
    direct = LearnedMap(of.model, engine=engine, output="resultant").fit(own.training, **settings)
    return [
        *answered(f"{name}, summed", of, of_maps(summed.explained), sets),
        *answered(f"{name}, direct", of, of_resultants(direct), sets),
    ]


def show(rows: Sequence[Answers], span: Array) -> str:
    """The table in text."""
    lines = [
        f"range {', '.join(f'{a} {r:.3g} N' for a, r in zip(AXES, span, strict=True))}",
        f"{'way':24s} {'presses':11s} {'n':>4s}   Fx     Fy     Fz   in the band  taken for strange",
    ]
    for r in rows:
        x, y, z = r.off(span)
        lines.append(f"{r.way:24s} {r.presses:11s} {len(r.true):4d} {x:6.1%} {y:6.1%} {z:6.1%} {r.covered:9.1%} "
                     f"{np.mean(r.strange):12.0%}")  # fmt: skip
    for way in dict.fromkeys(r.way for r in rows):
        off = np.mean([r.off(span) for r in rows if r.way == way and r.presses in UNSEEN], axis=0)
        lines.append(f"{way:24s} unseen bodies    {off[0]:6.1%} {off[1]:6.1%} {off[2]:6.1%}")
    return "\n".join(lines)


def picture(rows: Sequence[Answers], path: Path) -> None:
    """Normal force found over the true one, for each way; bodies that no set had in red."""
    from matplotlib.figure import Figure

    ways = list(dict.fromkeys(r.way for r in rows))
    columns = min(len(ways), 5)
    lines = -(-len(ways) // columns)
    fig = Figure(figsize=(2.5 * columns, 0.5 + 2.4 * lines), layout="constrained")
    panels = fig.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for ax in panels[len(ways) :]:
        ax.remove()
    for ax, way in zip(panels, ways, strict=False):
        for r in (r for r in rows if r.way == way):
            colour = "tab:red" if r.presses in UNSEEN else "tab:gray" if "gel" in r.presses else "tab:blue"
            ax.plot(-r.true[:, 2], -r.found[:, 2], ".", color=colour, markersize=3)
        top = max(-r.true[:, 2].min() for r in rows)
        ax.plot([0, top], [0, top], color="k", linewidth=0.8)
        ax.set_title(way, fontsize=9)
        ax.set_ylim(-0.3 * top, 1.5 * top)
    fig.supxlabel("true normal force (N); blue: bodies of the set, red: never seen, grey: other gels", fontsize=9)
    fig.supylabel("found (N)", fontsize=9)
    fig.savefig(path, dpi=110)


def main(draws: int = 5000) -> None:
    """Print the table, and save the picture."""
    flat, folder = sensor(deep=False), Path("learned_skin")
    whole = sensor(deep=True)
    sets, gels = (kept(whole, folder, draws).without_depth(flat) for kept in (drawn, of_any_gel))
    sets = Sets(sets.training, {**sets.tests, **gels.tests})
    rows = by_physics(flat, sets)
    for engine in ("linear", "torch"):
        try:
            for training in (None, gels.training):
                rows += by_learning(flat, sets, engine, folder, training)
        except InputError as error:
            print(f"{engine}: {error.what}")
    print(show(rows, span(flat, sets)))
    picture(rows, Path("learned_resultant.png"))
    print("picture: learned_resultant.png")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
