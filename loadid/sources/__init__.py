"""Source and path tools: contributions, synthesis and its errors, correlation, validation on other sensors."""

from __future__ import annotations

from ._comparison import BandLevels, ResponseComparison, compare, compare_estimate
from ._contributions import Contributions, Shares, contributions
from ._correlation import csac, csf, faac, frac, lac, mac, trac
from ._levels import (
    BandPower,
    Bands,
    RunningLevel,
    band_power,
    decibels,
    octave_bands,
    running_level,
    running_rms,
    time_weighted,
)
from ._split import Split, split
from ._synthesis import SynthesisedResponse, synthesise
from ._transfer import Transfer, validate_on

__all__ = [
    "BandLevels", "BandPower", "Bands", "Contributions", "ResponseComparison", "RunningLevel", "Shares", "Split",
    "SynthesisedResponse", "Transfer", "band_power", "compare", "compare_estimate", "contributions", "csac", "csf",
    "decibels", "faac", "frac", "lac", "mac", "octave_bands", "running_level", "running_rms", "split", "synthesise",
    "time_weighted", "trac", "validate_on",
]  # fmt: skip
