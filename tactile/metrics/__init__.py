"""How good a force map is: resultants, distribution, leakage, and what marker noise does to them.

Every number of a distribution is invariant to the units of force and length. Accuracy, fidelity and noise resistance
are words that papers define in their own ways; the formulas here are those of each function's docstring. What `compare`
and `benchmark` are made of can be imported from here too.
"""

from __future__ import annotations

# isort: off
from ._benchmark import BenchmarkRow, BenchmarkTable, Case, NoiseSlope, benchmark, cases, noise_slope  # noqa: F401
from ._mapped import CellErrors, MapMetrics, ResultantErrors, resultant, to_cells  # noqa: F401
from ._mapped import cell_errors, compare, compare_resultants, resultant_errors  # noqa: F401
from ._measures import centroid, centroid_error, cosine, dma, dtma, dtmb, iou, means, patches  # noqa: F401
from ._measures import known, peak_ratio, relative_error, snr, spread  # noqa: F401
# isort: on

__all__ = ["Case", "benchmark", "cases", "compare", "compare_resultants", "known", "resultant_errors"]
