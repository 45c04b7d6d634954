"""The noise of the channels: how large, who says so, and above which residual the load explains nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, Spelling
from structures._model import Model
from structures.errors import InputError

from .._inverse.choice import Choice
from .._inverse.noise_level import residual_level, shown_level
from .._inverse.path import PathPoint, RegularizationPath
from .._inverse.problem import NOT_KNOWN, STATED, Cholesky, NoiseSource
from .._quality import noise_std
from ..settings import Noise
from .data import Data, Readings

COVARIANCE = NoiseSource("repeatability", "covariance")
LEFT_OUT = 2.1  # variances of the noise in the error that a spline makes at samples that were left out, and chance
SLIGHT = 0.01
DECLARED = NoiseSource("datasheet", "data sheet (declared with the sensors)")


@dataclass(frozen=True)
class NoiseLevel:
    """Noise of the used channels, as it was found.

    Parameters
    ----------
    level : array or Cholesky
        Std per sensor (sensors,), covariance (sensors, sensors) or its factor; where it is not known, a scale per
        channel.
    known : bool
        Whether `level` is the noise, or only a scale.
    source : NoiseSource
    """

    level: Any
    known: bool
    source: NoiseSource

    @property
    def sigma(self) -> float | None:
        """Noise level of the whitened data."""
        return 1.0 if self.known else None

    @property
    def std(self) -> NDArray[np.float64]:
        """Std of each sensor (sensors,), or its scale where the noise is not known."""
        if isinstance(self.level, Cholesky):
            return np.asarray(np.linalg.norm(np.asarray(self.level.factor, float), axis=1))
        level = np.asarray(self.level, float)
        return level if level.ndim == 1 else np.asarray(np.sqrt(np.diag(level)))


def resolve(given: Noise, model: Model, data: Data) -> NoiseLevel:
    """Noise level by the first that tells: the user, the model, the record's channels, its quiet segment; else a scale.

    A level that is known has the error of an interpolation beside it, where the samples were interpolated.

    Raises
    ------
    InputError
        A level that does not fit the channels.
    """
    found = _of_samples(given, model, data)
    errors = np.array([c.interpolation or 0.0 for c in data.channels])
    if not found.known or not np.any(errors) or not isinstance(found.level, np.ndarray):
        return found
    own = found.level**2 if found.level.ndim == 1 else np.diag(found.level)
    more = np.maximum(errors**2 - LEFT_OUT * own, 0.0)
    if not np.any(more > SLIGHT * own):
        return found
    level = np.sqrt(own + more) if found.level.ndim == 1 else found.level + np.diag(more)
    return NoiseLevel(level, True, NoiseSource(found.source.kind, f"{found.source.text}, and the interpolation"))


def _of_samples(given: Noise, model: Model, data: Data) -> NoiseLevel:
    count = len(data.rows)
    if given.stated:
        return _stated(given, count)
    declared = model.noise
    if declared is not None:
        pick = declared[data.rows] if declared.ndim == 1 else declared[np.ix_(data.rows, data.rows)]
        return NoiseLevel(pick, True, DECLARED)
    found = noise_std(data.record.select([c.label for c in data.channels]))
    if found is not None and np.all(found[0] > 0):
        return NoiseLevel(found[0], True, found[1])
    recorded = np.where(data.missing, np.nan, data.values)
    dead = np.nanmax(recorded, axis=0) == np.nanmin(recorded, axis=0)
    if np.any(dead) and len(data.values) > 1 and (not np.all(dead) or not np.any(data.values)):
        raise InputError(
            "a channel is the same throughout",
            where="record",
            found=[c.label for c, still in zip(data.channels, dead, strict=True) if still],
            expected="a response",
            hint=Advice(Spelling("leave the channel out (sensors=[...])", "calibrate a model without this channel")),
        )
    scale = data.rms
    if len({c.unit for c in data.channels}) < 2:
        scale = np.full(count, float(np.sqrt(np.mean(scale**2))))
    return NoiseLevel(scale, False, NOT_KNOWN)


def steady(given: Noise, model: Model, found: Readings) -> NoiseLevel:
    """Noise of static readings, by the first that tells: the user, the model, the record's quiet segment; else a scale.

    Parameters
    ----------
    given : Noise
        With an interpolation W the readings are ``W z`` of raw markers z, and their noise is correlated, ``W R W^T``.
    model : Model
    found : Readings

    Raises
    ------
    InputError
        A level that does not fit the channels, an interpolation without the noise of its markers.
    """
    count = len(found.rows)
    if given.interpolation is not None:
        return _interpolated(given, count)
    if isinstance(given.std, Cholesky):
        return NoiseLevel(given.std, True, given.origin or COVARIANCE)
    if given.stated:
        return _stated(given, count)
    if found.data is not None:
        return resolve(given, model, found.data)
    declared = model.noise
    if declared is not None:
        pick = declared[found.rows] if declared.ndim == 1 else declared[np.ix_(found.rows, found.rows)]
        return NoiseLevel(pick, True, DECLARED)
    return NoiseLevel(_scales(found), False, NOT_KNOWN)


def _stated(given: Noise, count: int) -> NoiseLevel:
    level = _level(given.std, count, "sensors")
    return NoiseLevel(level, True, given.origin or (COVARIANCE if level.ndim == 2 else STATED))


def _level(std: Any, count: int, what: str) -> NDArray[np.float64]:
    level = np.full(count, std) if isinstance(std, float) else std
    if np.shape(level) not in {(count,), (count, count)}:
        raise InputError(
            f"the noise does not fit the {what}",
            where="noise",
            found=f"shape {np.shape(level)}",
            expected=f"a number, ({count},) or ({count}, {count})",
        )
    return np.asarray(level, float)


def _interpolated(given: Noise, count: int) -> NoiseLevel:
    """Covariance of readings that were interpolated from markers."""
    W = np.asarray(given.interpolation, float)
    if W.ndim != 2 or W.shape[0] != count or not np.all(np.isfinite(W)) or not given.stated:
        raise InputError(
            "the interpolation does not fit the readings, or its markers have no noise",
            where="interpolation",
            found=f"shape {W.shape}, {'' if np.all(np.isfinite(W)) else 'NaN or infinity in it, '}"
            f"noise {'given' if given.stated else 'missing'}",
            expected=f"({count}, markers), with the noise of the markers: Noise(std, interpolation=W)",
        )
    level = _level(given.std, W.shape[1], "markers")
    half = W * level if level.ndim == 1 else W @ np.linalg.cholesky(level)
    source = given.origin or NoiseSource("repeatability", "covariance of the interpolated markers")
    return NoiseLevel(half @ half.T, True, source)


def _scales(found: Readings) -> NDArray[np.float64]:
    """Scale of each channel where no noise is known: the rms of all channels of its unit."""
    size2, units = np.mean(found.values**2, axis=0), [c.unit for c in found.channels]
    scale = np.array([np.sqrt(np.mean([s for s, u in zip(size2, units, strict=True) if u == v])) for v in units])
    if np.any(scale == 0):
        raise InputError(
            "all readings of a kind are zero", where="readings",
            found=[c.label for c, s in zip(found.channels, scale, strict=True) if s == 0][:8], expected="a response",
            hint="state the noise of the sensors (noise=): a load of zero within its band is then an answer",
        )  # fmt: skip
    return scale


@dataclass(frozen=True)
class LineNoise:
    """Noise of the used channels line by line.

    Parameters
    ----------
    power : array, shape (lines, sensors)
        Expected energy of the noise in the transform of each channel.
    excess : array, shape (lines, sensors), or None
        Energy beyond `power` on single lines, for the band only.
    source : NoiseSource
    known : bool
    """

    power: NDArray[np.float64]
    excess: NDArray[np.float64] | None
    source: NoiseSource
    known: bool = True

    @property
    def noise(self) -> NoiseLevel:
        """What remains to be said once lines are whitened."""
        return NoiseLevel(np.ones(self.power.shape[1]), self.known, self.source)


def white(noise: NoiseLevel, samples: int, lines: int) -> LineNoise:
    """The same level on every line.

    Raises
    ------
    InputError
        A covariance between channels.
    """
    if noise.level.ndim == 2:
        raise InputError(
            "a long record takes a noise std per sensor, not a covariance", where="noise",
            found=f"covariance {noise.level.shape}", expected="(sensors,)", hint="use a window of the record",
        )  # fmt: skip
    return LineNoise(np.tile(samples * noise.level**2, (lines, 1)), None, noise.source, noise.known)


CHANCE = 0.05  # a residual this unlikely under the stated noise is model error


def noise_level(path: RegularizationPath, choice: Choice, noise: NoiseLevel) -> float:
    """Stated level of the whitened noise; what the residual shows where that is clearly more or nothing was stated."""
    point = path.at(choice.lam)
    seen = shown_level(point, path.m)
    if noise.sigma is None:
        return seen or _last_resort(path, choice)
    if seen is None or seen <= noise.sigma * _margin(point):
        return noise.sigma
    return seen


def _margin(point: PathPoint) -> float:
    """How far the residual level exceeds the noise by chance, for the freedom that the fit leaves."""
    from scipy.special import gammaincinv

    freedom = 1.0 if point.left is None else max(float(point.left), 1.0)
    return float(np.sqrt(2 * gammaincinv(freedom / 2, 1 - CHANCE) / freedom))


def _last_resort(path: RegularizationPath, choice: Choice) -> float:
    """Noise level where the fit leaves too little to tell: of the nearest larger lambda that leaves enough."""
    lam = np.geomspace(max(choice.lam, path.range[0]), max(10 * choice.lam, 1.0), 60)
    levels = (residual_level(path, float(x)) for x in lam)
    return next((level for level in levels if level), float(np.sqrt(path.at(1.0).residual2 / path.m)))
