"""Source and path tools: contributions, synthesis and its errors, correlation, validation on other sensors.

The classes of the answers and the pieces that these are made of can be imported too.
"""

from ._comparison import BandLevels as BandLevels
from ._comparison import ResponseComparison as ResponseComparison
from ._comparison import compare
from ._comparison import compare_estimate as compare_estimate
from ._contributions import Contributions as Contributions
from ._contributions import Shares as Shares
from ._contributions import contributions
from ._correlation import csac, csf, faac, frac, lac, mac, trac
from ._levels import BandPower as BandPower
from ._levels import Bands as Bands
from ._levels import RunningLevel as RunningLevel
from ._levels import band_power, octave_bands, running_level
from ._levels import decibels as decibels
from ._levels import running_rms as running_rms
from ._levels import time_weighted as time_weighted
from ._synthesis import SynthesisedResponse as SynthesisedResponse
from ._synthesis import synthesise
from ._transfer import Split as Split
from ._transfer import Transfer as Transfer
from ._transfer import split, validate_on

__all__ = [
    "band_power", "compare", "contributions", "csac", "csf", "faac", "frac", "lac", "mac",
    "octave_bands", "running_level", "split", "synthesise", "trac", "validate_on",
]  # fmt: skip
