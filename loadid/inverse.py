"""Where release 0.1 has constraints and priors: ``from loadid.inverse.constraints import NonNegative`` still works."""

import sys
import warnings

from . import constraints, priors
from ._inverse.gaussian import augment

warnings.warn(
    "loadid.inverse is private now: import from loadid.constraints and loadid.priors", DeprecationWarning, stacklevel=2
)
kalman = sys.modules[__name__]
sys.modules |= {
    f"{__name__}.constraints": constraints,
    f"{__name__}.kalman": kalman,
    f"{__name__}.kalman.augment": augment,
    f"{__name__}.kalman.priors": priors,
}

__all__ = ["augment", "constraints", "kalman", "priors"]
