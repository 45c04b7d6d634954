"""Guards of loads over space and time, reached through their family."""

from __future__ import annotations

import numpy as np

from loadid import FieldDeconvolution
from loadid._spellings import folded
from structures import ForwardModel, bases, beams, sensors

from .cases import Case, refused

DT = 1 / 400
BEAM = beams.simply_supported(
    length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=10, damping=0.05
)
GAUGES = [sensors.StrainGauge(at=x, fibre=0.005) for x in (0.31, 0.77, 1.63)]


def inverted(grid, **settings):
    model = ForwardModel(BEAM, GAUGES, bases.hats(BEAM, grid), modes=6)
    y = np.random.default_rng(0).standard_normal((40, 3)) * 1e-6
    return (
        FieldDeconvolution(model, noise=1e-6, **folded(FieldDeconvolution, {"choice": 0.1, **settings}))
        .estimate(y, DT)
        .flags
    )


CASES = [
    Case(
        "E514", lambda: refused(lambda: inverted(5)), lambda: inverted(2),
        "3 sensors tell 3 of 6 places apart.*rank 120 for 240 unknowns, nullity 120", "more places than sensors",
    ),
    Case("E514", lambda: inverted(5, allow=["E514"]), lambda: inverted(5, space="gradient"), "3", "allowed"),
]  # fmt: skip
