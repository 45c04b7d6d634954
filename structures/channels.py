"""What one row (sensor) or one column (load) of a forward model is called and measured in."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .errors import InputError


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One sensor or one load, described.

    Parameters
    ----------
    label : str
        Name, unique within the model.
    quantity : str
        ``displacement, velocity, acceleration, strain, force, moment, pressure, line_load`` or ``arbitrary``.
    unit : str
        SI unit of the numbers that the model takes and gives (``m/s^2``, ``N``), or ``arbitrary``.
    noise : float, optional
        Standard deviation of the noise of a sensor, in `unit`.
    highpass : float, optional
        Corner frequency of a first-order high-pass (AC coupling) in Hz.
    measure : float, optional
        Tributary length (m) or area (m^2) of a load.
    """

    label: str
    quantity: str = "arbitrary"
    unit: str = "arbitrary"
    noise: float | None = None
    highpass: float | None = None
    measure: float | None = None

    def __post_init__(self) -> None:
        for name in ("noise", "highpass", "measure"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise InputError(f"{name} must be positive", where=f"channel {self.label}", found=value, expected="> 0")
