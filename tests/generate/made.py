"""A maker of draws that costs next to nothing, and a chain with its truth, for tests."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from loadid.generate import DrawMaker, Drawn
from structures import Channel, ForwardModel, NotIdentifiable, chains, damping, loads, sensors


@dataclass(frozen=True)
class Coins(DrawMaker):
    """Two loads and three sensors that read sums of them; a fifth of the draws has no answer at first."""

    name: str = "coins"
    pause: float = 0.0

    sensors = tuple(Channel(label=f"s{i}", quantity="strain", unit="m/m", noise=1e-3) for i in range(3))
    loads = tuple(Channel(label=f"f{i}", quantity="force", unit="N", measure=2.0) for i in range(2))
    kinds = ("head", "tail")
    dt = None
    samples = None

    @property
    def declaration(self) -> dict:
        return {"name": self.name}

    @property
    def models(self) -> tuple[str, ...]:
        return ("coins",)

    def draw(self, rng: np.random.Generator) -> Drawn:
        if rng.random() < 0.2:
            raise NotIdentifiable("on its edge", advice="throw again", code="LID-E306")
        time.sleep(self.pause)
        load = rng.standard_normal(2)
        data = np.array([load[0], load[1], load.sum()])
        data[rng.random(3) < 0.1] = np.nan
        return Drawn(data, load, "head" if load[0] > 0 else "tail", np.full(3, 1e-3), {"first": float(load[0])})


def chain(factor: float = 1.0, damped: float = 2e-4, renamed: str = "a") -> ForwardModel:
    """Three masses with a force on the second, accelerometers on the first and the last."""
    structure = chains.chain(masses=np.ones(3), springs=factor * 2e4, damping=damping.Rayleigh(0.0, damped))
    places = [sensors.Accelerometer(f"{n}+X", label=f"{renamed}{n}", noise=0.01) for n in (1, 3)]
    return ForwardModel(structure, sensors=places, loads=[loads.Point("2+X")])
