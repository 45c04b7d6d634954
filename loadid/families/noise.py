"""The noise of the channels that are inverted: how large, and who says so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.model import Model

from .data import Data


@dataclass(frozen=True)
class Noise:
    """Noise of the used channels.

    Parameters
    ----------
    level : array
        Std per sensor (sensors,) or covariance (sensors, sensors); where it is not known, a scale per channel.
    known : bool
        Whether `level` is the noise, or only a scale.
    source : str
    """

    level: NDArray[np.float64]
    known: bool
    source: str

    @property
    def sigma(self) -> float | None:
        """Noise level of the whitened data."""
        return 1.0 if self.known else None


def resolve(given: ArrayLike | None, source: str | None, model: Model, data: Data) -> Noise:
    """Noise level by the first that tells: the user, the model, the record's channels, its quiet segment; else a scale.

    Raises
    ------
    InputError
        A level that does not fit the channels.
    """
    count = len(data.rows)
    if given is not None:
        level = np.asarray(given, float)
        level = np.full(count, float(level)) if level.ndim == 0 else level
        if level.shape not in {(count,), (count, count)} or not np.all(np.isfinite(level)):
            raise InputError(
                "the noise does not fit the sensors",
                where="noise",
                found=f"shape {level.shape}",
                expected=f"a number, ({count},) or ({count}, {count})",
            )
        return Noise(level, True, source or ("covariance" if level.ndim == 2 else "a guess of the user"))
    declared = model.noise
    if declared is not None:
        pick = declared[data.rows] if declared.ndim == 1 else declared[np.ix_(data.rows, data.rows)]
        return Noise(pick, True, "data sheet (declared with the sensors)")
    from ..quality import noise_std

    found = noise_std(data.record.select([c.label for c in data.channels]))
    if found is not None and np.all(found[0] > 0):
        stated = found[1].startswith("stated")
        return Noise(
            found[0], True, "data sheet (stated with the channels)" if stated else f"quiet segment ({found[1]})"
        )
    scale = np.sqrt(np.mean(data.values**2, axis=0))
    if len({c.unit for c in data.channels}) < 2:
        scale = np.full(count, float(np.sqrt(np.mean(scale**2))))
    if np.any(scale == 0):
        raise InputError(
            "a channel is zero throughout",
            where="record",
            found=[c.label for c, s in zip(data.channels, scale, strict=True) if s == 0],
            expected="a response",
            hint="leave the channel out (sensors=[...])",
        )
    return Noise(scale, False, "not known")


@dataclass(frozen=True)
class LineNoise:
    """Noise of the used channels line by line.

    Parameters
    ----------
    power : array, shape (lines, sensors)
        Expected energy of the noise in the transform of each channel.
    excess : array, shape (lines, sensors), or None
        Energy beyond `power` on single lines, for the band only.
    source : str
    known : bool
    """

    power: NDArray[np.float64]
    excess: NDArray[np.float64] | None
    source: str
    known: bool = True

    @property
    def noise(self) -> Noise:
        """What remains to be said once lines are whitened."""
        return Noise(np.ones(self.power.shape[1]), self.known, self.source)


def white(noise: Noise, samples: int, lines: int) -> LineNoise:
    """The same level on every line.

    Raises
    ------
    InputError
        A covariance between channels.
    """
    if noise.level.ndim == 2:
        raise InputError(
            "a long record takes a noise std per sensor, not a covariance",
            where="noise",
            found=f"covariance {noise.level.shape}",
            expected="(sensors,)",
            hint="use a window of the record",
        )
    return LineNoise(np.tile(samples * noise.level**2, (lines, 1)), None, noise.source, noise.known)
