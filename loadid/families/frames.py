"""Frames that each choose their own lambda: possible, and flagged."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .. import flags as guards
from ..estimate import LoadEstimate
from ..inverse.faceposterior import FramesPosterior
from .readings import Readings

if TYPE_CHECKING:
    from .static import StaticInversion


def each_frame(family: StaticInversion, given: Readings) -> LoadEstimate:
    """One estimate of several frames, each with its own lambda (flag W409).

    The choice, the diagnosis and the other facts are those of the last frame.
    """
    singles = []
    for row in given.values:
        one = replace(given, values=row[None], axis=None)
        posed = family.pose(one)
        singles.append(family.answer(one, posed, family.choose(posed)))
    last = singles[-1]
    lams = [e.choice.lam for e in singles if e.choice is not None]
    bias = None if last.bias is None else np.stack([e.bias for e in singles if e.bias is not None])
    flags = [f for e in singles for f in e.flags if f.code != "LID-N303"] + [f for f in last.flags if "N303" in f.code]
    unique = {f.code: f for f in flags}
    return replace(
        last,
        load=np.stack([e.load for e in singles]),
        std=np.stack([e.std for e in singles]),
        bias=bias,
        axis=given.axis,
        response=given.values,
        residual=np.stack([e.residual for e in singles if e.residual is not None]),
        posterior=FramesPosterior([e.posterior for e in singles]),
        flags=guards.collect([guards.changing_lambda(lams), *unique.values()]),
        facts={**last.facts, "frames": len(singles)},
    )
