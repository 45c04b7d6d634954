"""W318, W609 and W616 of learned maps: noise alone, readings unlike the examples, and loads that were never shown."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from loadid import LearnedMap, LoadEstimate
from loadid._families.detection import PULSE, half_sine
from loadid.generate import Examples, TrainingSet
from structures import Flag

from ..learning.made import DT, NOISE, SAMPLES, history_map, plate, presses, seen, static_map
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


def read(size: float, seed: int = 4) -> LoadEstimate:
    """Of noise and one load of the plate."""
    white = np.random.default_rng([41, seed]).standard_normal(8)
    return static_map().estimate(NOISE * white + size * plate()[0].static()[:, 2])


def recorded(size: float, seed: int = 4) -> LoadEstimate:
    """Of noise and a hit on the chain."""
    hit = np.zeros((SAMPLES, 1))
    hit[SAMPLES // 2 : SAMPLES // 2 + PULSE, 0] = size * half_sine()
    return history_map().estimate(seen(hit, np.random.default_rng([42, seed])), DT)


@pytest.mark.parametrize("answered", [read, recorded])
def test_noise_is_told_as_such_and_a_load_of_the_size_that_is_named_is_not(answered: Callable[..., Any]) -> None:
    """Of 20 each at most 2 of noise pass for a load, at a chance of 1 %, and at most 4 loads for noise, at 5 %."""

    def told(size: float, first: int) -> int:
        return sum("LID-W318" not in [f.code for f in answered(size, first + k).flags] for k in range(20))

    empty = answered(0.0)
    assert empty.grade.letter == "D"
    size = empty.facts.told_from[2 if answered is read else 0]
    assert told(0.0, 100) <= 2
    assert told(size, 200) >= 16
    assert told(size / 4, 300) <= 5


CASES = [
    Case("W318", lambda: read(0.0).flags, lambda: read(1.0).flags, r"at p\d a load of \d\S* N alone", "learned"),
    Case(
        "W318",
        lambda: recorded(0.0).flags,
        lambda: recorded(1.0).flags,
        r"half sine of 50 ms\) of \d",
        "learned record",
    ),
    Case("W609", lambda: flags(3.0), lambda: flags(0.0), r"distance of the readings [\d.e+]+ \(limit [\d.]+\)"),
    Case("W616", lambda: shown(True), lambda: shown(False), r"answered by their mean: p2"),
]
