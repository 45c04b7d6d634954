"""Priors by name: what is tuned of each, and where the search begins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from ...inverse.kalman import priors

LONGEST = 0.1  # of the record: a correlation length beyond is not seen in it
SHORTEST = 2.0  # samples
FORGETS = 1e4  # samples in which a stand-in for a walk forgets


@dataclass(frozen=True)
class Named:
    """A prior whose numbers are found by likelihood.

    Parameters
    ----------
    name : str
    parameters : tuple of str
        ``"sd"`` (N) or ``"rate"`` (N per root of a second), ``"length"`` (s).
    make : callable
        Prior of the parameters.
    """

    name: str
    parameters: tuple[str, ...]
    make: Callable[..., Any]

    def starts(self, size: float, dt: float, samples: int) -> list[NDArray[np.float64]]:
        """Logarithms of the parameters from which the search begins, for a load of about this size (std, if white).

        A slow load moves the sensors less than a white one of its std: what a Matern-3/2 process has at high
        frequencies stays the same where its std grows with its length to the power of 3/2.
        """
        lengths = np.geomspace(SHORTEST * 2 * dt, LONGEST * samples * dt, 4)
        if self.parameters == ("sd", "length"):
            slow = (lengths / lengths[0]) ** 1.5
            return [
                np.log([size * s, length])
                for length, most in zip(lengths, slow, strict=True)
                for s in np.geomspace(0.3, 3.0 * most, 3)
            ]
        if self.parameters == ("rate",):
            return [np.log([size * s / np.sqrt(length)]) for length in lengths for s in (0.3, 3.0)]
        return [np.log([size * s]) for s in (0.1, 0.3, 1.0, 3.0)]


NAMES: dict[str, Named] = {
    found.name: found
    for found in (
        Named("random_walk", ("rate",), priors.RandomWalk),
        Named("white", ("sd",), priors.White),
        Named("ou", ("sd", "length"), priors.OU),
        Named("matern32", ("sd", "length"), priors.Matern32),
        Named("matern52", ("sd", "length"), priors.Matern52),
    )
}


def named(given: Any) -> Named | Any:
    """A prior by its name, or the prior itself.

    Raises
    ------
    InputError
        An unknown name, or no prior.
    """
    if isinstance(given, str):
        if given not in NAMES:
            raise InputError("unknown prior of a load", where="prior", found=repr(given), expected=", ".join(NAMES),
                             hint="or a prior of loadid.inverse.kalman.priors")  # fmt: skip
        return NAMES[given]
    if not isinstance(given, priors.Prior):
        raise InputError("no prior of a load", where="prior", found=type(given).__name__,
                         expected=f"{', '.join(NAMES)}, or a prior such as Matern32(100, 0.1)")  # fmt: skip
    return given


def leaky(given: Any, dt: float) -> Any:
    """A walk that forgets in `FORGETS` samples, for the walk; other priors as they are."""
    length = FORGETS * dt

    def process(rate: float) -> priors.OU:
        return priors.OU(rate * float(np.sqrt(length / 2)), length)

    if isinstance(given, Named) and given.name == "random_walk":
        return Named(given.name, given.parameters, process)
    return process(given.rate) if isinstance(given, priors.RandomWalk) else given
