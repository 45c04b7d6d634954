"""What was validated, and at which level: held-out sensors, resultants, distributions, and coverage of the bands.

The classes of the answers can be imported for types; nobody makes them by hand.
"""

from ._checks import DistributionCheck as DistributionCheck
from ._checks import ResultantCheck as ResultantCheck
from ._checks import SensorCheck as SensorCheck
from ._checks import Validation as Validation
from ._references import Known, PressureMat, ReferenceWrench
from ._validation import Coverage as Coverage
from ._validation import HeldOut as HeldOut
from ._validation import coverage, held_out, validate

__all__ = ["Known", "PressureMat", "ReferenceWrench", "coverage", "held_out", "validate"]
