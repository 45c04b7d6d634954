"""The guards of measuring, inverting and validating: each takes numbers and returns a flag, or None."""

from __future__ import annotations

from .base import allowed, collect
from .bookkeeping import absolute_lambda, changing_lambda, diagonal
from .choice import (
    at_the_end,
    correlated_noise,
    disagreement,
    gcv_minimum,
    needs_white_noise,
    no_corner,
    noise_source,
    not_testable,
    parameter,
    unexplained,
)
from .constraints import fighting, pulling, stopped
from .dynamics import aliased, drifting, in_motion, memory, unfinished
from .inversion import (
    index_offset,
    nodal_as_pressure,
    over_smoothed,
    overridden,
    recoverable,
    refined,
    resolution,
    resolution_law,
)
from .measurement import gaps, high_pass, interpolated, lost_channels, mixed_kinds, not_apart, null_space
from .model import not_verified
from .validation import inverse_crime, no_coverage, resultant_only, used_for_training

__all__ = [
    "absolute_lambda",
    "aliased",
    "allowed",
    "at_the_end",
    "changing_lambda",
    "collect",
    "correlated_noise",
    "diagonal",
    "disagreement",
    "drifting",
    "fighting",
    "gaps",
    "gcv_minimum",
    "high_pass",
    "in_motion",
    "index_offset",
    "interpolated",
    "inverse_crime",
    "lost_channels",
    "memory",
    "mixed_kinds",
    "needs_white_noise",
    "no_corner",
    "no_coverage",
    "nodal_as_pressure",
    "noise_source",
    "not_apart",
    "not_testable",
    "not_verified",
    "null_space",
    "over_smoothed",
    "overridden",
    "parameter",
    "pulling",
    "recoverable",
    "refined",
    "resolution",
    "resolution_law",
    "resultant_only",
    "stopped",
    "unexplained",
    "unfinished",
    "used_for_training",
]
