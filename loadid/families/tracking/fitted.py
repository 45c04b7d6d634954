"""What a fit of a tracker has settled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.channels import Channel
from structures.flags import Flag

from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.steady import Steady
from ...inverse.noise_source import NOT_KNOWN, NoiseSource
from .certificate import Certificate
from .recipe import Recipe


@dataclass(frozen=True, eq=False)
class Fitted:
    """What a fit has settled; everything that a tracker needs to run.

    Parameters
    ----------
    model : FilterModel
    settled : Steady or None
    bank : tuple of (weight, FilterModel, Steady or None)
        Models that are wrong by what was declared.
    dt : float
    sensors, loads : tuple of Channel
    words : str
        The priors of the loads.
    numbers : mapping
        What was tuned.
    noise_source : NoiseSource
        Or its text, as files of release 0.1 have it.
    certificate : Certificate or None
    flags : tuple of Flag
    fingerprint : str
        Of the model of the structure.
    settings : mapping
    inputs : mapping
        Digest of the record of the fit.
    limits : array (sensors, 2), optional
        Ends of the range of each sensor, infinite where it has none: a sample at them is not believed.
    recipe : Recipe, optional
        How the filter was made of the model, for another one.
    stale : bool
        The certificate is that of another model.
    """

    model: FilterModel
    settled: Steady | None
    bank: tuple[tuple[float, FilterModel, Steady | None], ...]
    dt: float
    sensors: tuple[Channel, ...]
    loads: tuple[Channel, ...]
    words: str
    numbers: Mapping[str, float]
    noise_source: NoiseSource
    certificate: Certificate | None
    flags: tuple[Flag, ...]
    fingerprint: str
    settings: Mapping[str, Any]
    inputs: Mapping[str, str]
    limits: NDArray[np.float64] | None = None
    recipe: Recipe | None = None
    stale: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "noise_source", NoiseSource.of(self.noise_source) or NOT_KNOWN)
