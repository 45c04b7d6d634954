"""Where release 0.1 has the priors of loads: ``from loadid.inverse.kalman.priors import Matern32`` goes on working."""

import sys

from .gaussian import augment, priors

__all__ = ["augment", "priors"]

sys.modules |= {f"{__name__}.{name}": sys.modules[f"{__package__}.gaussian.{name}"] for name in __all__}
