"""Sensors that contradict each other: W214 names one, W215 where there are too few to name it."""

from __future__ import annotations

import numpy as np

from loadid import StaticInversion
from structures import Flag

from .cases import Case

H = np.array([[1.0, 0.2], [0.8, 0.6], [0.5, 1.0], [0.3, 0.9], [0.9, 0.4]])


def readings(sensors: int, turned: float) -> tuple[Flag, ...]:
    """Two loads, as many sensors, the second of them with this gain."""
    y = H[:sensors] @ [3.0, 2.0] * np.where(np.arange(sensors) == 1, turned, 1.0)
    return StaticInversion(H[:sensors], penalty=None, noise=0.01).estimate(y).flags


CASES = [
    Case("W214", lambda: readings(5, -1.0), lambda: readings(5, 1.0), r"sensor fault: .* has the wrong sign"),
    Case("W215", lambda: readings(3, -1.0), lambda: readings(3, 1.0), r"one of .* is wrong, and the data cannot say"),
]
