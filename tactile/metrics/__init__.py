"""How good a force map is: resultants, distribution, leakage, and what marker noise does to them.

Every number of a distribution is invariant to the units of force and length. Accuracy, fidelity and noise resistance
are words that papers define in their own ways; the formulas here are those of each function's docstring.
"""

from __future__ import annotations

from ._benchmark import BenchmarkRow, BenchmarkTable, Case, NoiseSlope, benchmark, cases, noise_slope
from ._mapped import (
    CellErrors,
    MapMetrics,
    ResultantErrors,
    cell_errors,
    compare,
    compare_resultants,
    resultant,
    resultant_errors,
    to_cells,
)
from ._measures import (
    centroid,
    centroid_error,
    cosine,
    dma,
    dtma,
    dtmb,
    iou,
    known,
    means,
    patches,
    peak_ratio,
    relative_error,
    snr,
    spread,
)

__all__ = [
    "BenchmarkRow",
    "BenchmarkTable",
    "Case",
    "CellErrors",
    "MapMetrics",
    "NoiseSlope",
    "ResultantErrors",
    "benchmark",
    "cases",
    "cell_errors",
    "centroid",
    "centroid_error",
    "compare",
    "compare_resultants",
    "cosine",
    "dma",
    "dtma",
    "dtmb",
    "iou",
    "known",
    "means",
    "noise_slope",
    "patches",
    "peak_ratio",
    "relative_error",
    "resultant",
    "resultant_errors",
    "snr",
    "spread",
    "to_cells",
]
