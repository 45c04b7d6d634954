"""The guard of shape sensing: a load with detail between the gauges, and a smooth one on the same gauges."""

from __future__ import annotations

from functools import cache

import numpy as np

from loadid import ShapeSensing
from structures import Flag

from ..benchmarks.shape_routes import FINE, PLATE, gauges, under
from .cases import Case

LEVEL = 1e-3


@cache
def family() -> ShapeSensing:
    return ShapeSensing(PLATE, gauges(5), noise=LEVEL)


def flags(width: float) -> tuple[Flag, ...]:
    """Of two humps of this width (m), at gauges 0.2 m apart."""
    humps = [np.exp(-((FINE[:, None] - a) ** 2 + (FINE - b) ** 2) / 2 / width**2) for a, b in ((0.4, 0.55), (0.7, 0.3))]
    y, _ = under(humps[0] - 0.7 * humps[1], family().gauges)
    y = y / np.abs(y).max() + LEVEL * np.random.default_rng(5).standard_normal(len(y))
    return family().estimate(y).flags


CASES = [
    Case("W320", lambda: flags(0.05), lambda: flags(0.25), r"detail as narrow as the distance of the gauges, 0\.2 m"),
]
