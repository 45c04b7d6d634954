"""Source and path tools: contributions, synthesis and its errors, correlation, validation on other sensors."""

from __future__ import annotations

from .bands import BandPower, Bands, band_power, octave_bands
from .comparison import BandLevels, Comparison, compare, compare_estimate
from .contributions import Contributions, Shares, contributions
from .correlation import csac, csf, faac, frac, lac, mac, trac
from .levels import RunningLevel, decibels, running_level, running_rms, time_weighted
from .split import Split, split
from .synthesis import Response, synthesise
from .transfer import Transfer, validate_on

__all__ = [
    "BandLevels",
    "BandPower",
    "Bands",
    "Comparison",
    "Contributions",
    "Response",
    "RunningLevel",
    "Shares",
    "Split",
    "Transfer",
    "band_power",
    "compare",
    "compare_estimate",
    "contributions",
    "csac",
    "csf",
    "decibels",
    "faac",
    "frac",
    "lac",
    "mac",
    "octave_bands",
    "running_level",
    "running_rms",
    "split",
    "synthesise",
    "time_weighted",
    "trac",
    "validate_on",
]
