"""The guards of measuring, inverting and validating: each takes numbers and returns a flag, or None."""

from __future__ import annotations

from structures._flags import allowed, collect

from .choice import (
    absolute_lambda,
    at_the_end,
    changing_lambda,
    correlated_noise,
    diagonal,
    disagreement,
    fighting,
    gcv_minimum,
    needs_white_noise,
    no_corner,
    noise_source,
    not_testable,
    parameter,
    pulling,
    stopped,
    unexplained,
)
from .families import not_in_the_set, outside_training
from .inversion import (
    aliased,
    between_gauges,
    cut_off,
    drifting,
    in_motion,
    index_offset,
    memory,
    nodal_as_pressure,
    not_told,
    over_smoothed,
    overridden,
    recoverable,
    refined,
    resolution,
    unfinished,
    window_missed,
)
from .measurement import (
    BESIDE_GAP,
    contradicting,
    gaps,
    high_pass,
    hit_beside_gap,
    interpolated,
    inverse_crime,
    lost_channels,
    lost_response,
    mixed_kinds,
    no_coverage,
    not_apart,
    not_verified,
    null_space,
    resultant_only,
    used_for_training,
)

__all__ = [
    "BESIDE_GAP", "absolute_lambda", "aliased", "allowed", "at_the_end", "between_gauges", "changing_lambda", "collect",
    "contradicting", "correlated_noise", "cut_off", "diagonal", "disagreement", "drifting", "fighting", "gaps",
    "gcv_minimum",
    "high_pass", "hit_beside_gap", "in_motion", "index_offset", "interpolated", "inverse_crime", "lost_channels",
    "lost_response", "memory", "mixed_kinds",
    "needs_white_noise", "no_corner", "no_coverage", "nodal_as_pressure", "noise_source", "not_apart", "not_in_the_set",
    "not_testable",
    "not_told", "not_verified", "null_space", "outside_training", "over_smoothed", "overridden", "parameter", "pulling",
    "recoverable", "refined", "resolution", "resultant_only", "stopped", "unexplained", "unfinished",
    "used_for_training", "window_missed",
]  # fmt: skip
