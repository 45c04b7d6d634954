"""Source and path tools: contributions, synthesis and its errors, correlation, validation on other sensors."""

from __future__ import annotations

from .comparison import BandLevels, ResponseComparison, compare, compare_estimate
from .contributions import Contributions, Shares, contributions
from .correlation import csac, csf, faac, frac, lac, mac, trac
from .levels import (
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
from .split import Split, split
from .synthesis import SynthesisedResponse, synthesise
from .transfer import Transfer, validate_on

__all__ = [
    "BandLevels", "BandPower", "Bands", "Contributions", "ResponseComparison", "RunningLevel", "Shares", "Split",
    "SynthesisedResponse", "Transfer", "band_power", "compare", "compare_estimate", "contributions", "csac", "csf",
    "decibels", "faac", "frac", "lac", "mac", "octave_bands", "running_level", "running_rms", "split", "synthesise",
    "time_weighted", "trac", "validate_on",
]  # fmt: skip
