"""W609 and W616: readings unlike those that a map was learned from, and loads that it was never shown."""

from __future__ import annotations

import numpy as np

from loadid import LearnedMap
from loadid.generate import Examples, TrainingSet
from structures import Flag

from ..learning.made import NOISE, plate, presses, static_map
from .cases import Case


def flags(shift: float) -> tuple[Flag, ...]:
    """Of a press, its readings moved as no load moves them."""
    y, _ = presses(1, 3)
    return static_map().estimate(y[0] + np.linspace(-shift, shift, 8)).flags


def shown(still: bool) -> tuple[Flag, ...]:
    """Of a map whose examples have one load at rest, or none."""
    if not still:
        return flags(0.0)
    model, _ = plate()
    y, g = presses(300, 0)
    g[:, 2] = 0.0
    y = g @ model.static().T + NOISE * np.random.default_rng(1).standard_normal(y.shape)
    training = TrainingSet.of(Examples.measured(y, g, noise=NOISE), sensors=model.sensors, loads=model.loads)
    return LearnedMap(model).fit(training).estimate(y[0]).flags


CASES = [
    Case("W609", lambda: flags(3.0), lambda: flags(0.0), r"distance of the readings [\d.e+]+ \(limit [\d.]+\)"),
    Case("W616", lambda: shown(True), lambda: shown(False), r"answered by their mean: p2"),
]
