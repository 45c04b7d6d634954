"""What was validated, and at which level: held-out sensors, resultants, distributions, and coverage of the bands."""

from __future__ import annotations

from ._checks import DistributionCheck, ResultantCheck, SensorCheck, Validation
from ._coverage import Coverage, coverage
from ._references import Known, PressureMat, ReferenceWrench
from ._validation import HeldOut, held_out, validate

__all__ = [
    "Coverage", "DistributionCheck", "HeldOut", "Known", "PressureMat", "ReferenceWrench", "ResultantCheck",
    "SensorCheck", "Validation", "coverage", "held_out", "validate",
]  # fmt: skip
