"""W609: readings unlike those that a map was learned from."""

from __future__ import annotations

import numpy as np

from structures import Flag

from ..learning.made import presses, static_map
from .cases import Case


def flags(shift: float) -> tuple[Flag, ...]:
    """Of a press, its readings moved as no load moves them."""
    y, _ = presses(1, 3)
    return static_map().estimate(y[0] + np.linspace(-shift, shift, 8)).flags


CASES = [Case("W609", lambda: flags(3.0), lambda: flags(0.0), r"distance of the readings [\d.e+]+ \(limit [\d.]+\)")]
