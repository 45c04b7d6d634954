"""The simulated hit of ``loadid demo``, with the noise of other seeds: a finer mesh, more modes and a finer step."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from loadid import Deconvolution
from loadid._commands.demo import model, simulate

from .impacts import Problem, scored
from .scores import Scored

ERRORS = ("none",)


def run(problems: int, seed: int, error: str = "none", **settings: Any) -> Iterator[Scored | str]:
    """Score of the demo with each seed from ``1000 * seed`` on."""
    known = model()
    for number in range(problems):
        made = simulate(1000 * seed + number)
        record = made.record
        given = Problem(
            known, record.values, record.dt, np.zeros(record.values.shape[1]), False, made.force[:, None], ()
        )
        yield scored(given, Deconvolution(known, **settings).estimate(record))
