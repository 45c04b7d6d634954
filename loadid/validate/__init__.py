"""What was validated, and at which level: held-out sensors, resultants, distributions, and coverage of the bands."""

from __future__ import annotations

from .checks import DistributionCheck, ResultantCheck, SensorCheck
from .coverage import Coverage, coverage
from .held_out import HeldOut, held_out
from .levels import Validation, validate
from .references import Known, PressureMat, Wrench

__all__ = [
    "Coverage",
    "DistributionCheck",
    "HeldOut",
    "Known",
    "PressureMat",
    "ResultantCheck",
    "SensorCheck",
    "Validation",
    "Wrench",
    "coverage",
    "held_out",
    "validate",
]
