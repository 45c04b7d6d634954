"""Whether readings are like those that a map was learned from: scores, and limits that draws kept apart set.

- distance: mean squared Mahalanobis distance of the readings, or of short windows of a record, with a covariance that
  is shrunk towards that of the noise; `burst` is the same of the worst stretch of a record.
- outside: power of a record on lines where the examples have hardly any but noise, over what they have there.
- residual: rms of what the model's response to the map's load leaves of the readings, in noise.
- offset: mean of that over a record, sensor by sensor over its spread among the examples: a sensor that is off by a
  constant. Where no response is known, of the readings.

Every score has a limit of its own, such that together they raise `FALSE_ALARMS` on readings like the examples.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .linear import windows
from .training import Lesson
from .triangle import Triangle

Array = NDArray[np.float64]

FALSE_ALARMS = 0.001  # of records like the examples: far below the 1 % that is promised, as limits of some hundred
# draws are uncertain themselves (measured on 100: 0.6 % on average)
HALF = 16  # samples of the windows whose distance is taken, before and after their middle
WIDEST = 240  # features of such a window
LINES = 128  # lines of the spectra
IN_BAND = 3.0  # power over that of the noise, from which a line is in the band of the examples
TAIL = 0.2  # share of the scores whose excess tells the limit
HIGH = 0.9  # quantile that tells the spread of a score above its median
ENOUGH = 60  # rows for each feature
WORDS = {
    "distance": "distance of the readings", "burst": "distance of the worst stretch of the record",
    "outside": "power outside the band", "offset": "mean of the residual over the record",
    "residual": "residual of the answer over the noise",
}  # fmt: skip


@dataclass(frozen=True)
class Verdict:
    """What readings scored.

    Parameters
    ----------
    scores, limits : mapping of str to float
        By the names in `WORDS`.
    """

    scores: Mapping[str, float]
    limits: Mapping[str, float]

    @property
    def worst(self) -> str:
        """The score that is largest beside its limit."""
        return max(self.scores, key=lambda name: self.scores[name] / self.limits[name])

    @property
    def value(self) -> float:
        """The worst score over its limit: above 1 is an alarm."""
        return self.scores[self.worst] / self.limits[self.worst]

    @property
    def alarm(self) -> bool:
        """Whether the readings are outside the training set."""
        return not self.value <= 1


@dataclass(frozen=True, eq=False)
class Novelty:
    """Scores of readings, fitted to examples; no limits yet before `judged`.

    Parameters
    ----------
    mean, whiten : array (features,), (features, features)
        Of the readings, or of windows of them: ``(x - mean) @ whiten`` has unit variance among the examples.
    half : int
        Samples of a window before and after its middle; 0 of static readings.
    outside : array of bool (lines, sensors)
        Lines that are outside the band of the examples.
    floor : float
        Power of the examples there.
    centre, spread : mapping of str to float
        Of the logarithm of each score: median, and how far its upper quantile lies above.
    excess : array
        Largest standardised log scores of draws kept apart, ascending, from which limits come.
    samples : int
        Of the records that these were, 0 of static readings.
    steady : array (sensors,)
        Rms of the mean of the residual of a record of the examples; empty of static readings.
    """

    mean: Array
    whiten: Array
    half: int
    outside: NDArray[np.bool_]
    floor: float
    centre: Mapping[str, float]
    spread: Mapping[str, float]
    excess: Array
    samples: int
    steady: Array

    @classmethod
    def learn(cls, lesson: Lesson) -> Self:
        """Fit the scores to the examples of a lesson."""
        sensors = len(lesson.fitting.sensors)
        shortest = lesson.fitting.samples or min((len(x) for x, _ in _records(lesson)), default=0)
        half = 0 if lesson.dt is None else max(1, min(HALF, (WIDEST // sensors - 1) // 2, (shortest - 1) // 8))
        examples = Triangle.of(_features(lesson, half))
        p, n = examples.features, examples.rows
        _, s, Vt = np.linalg.svd(examples.own)
        kept = p / (n + p)  # the noise counts as much as one example for each feature
        variance = (1 - kept) * s**2 / max(n - 1, 1) + kept
        whiten = Vt.T / np.sqrt(np.maximum(variance, 1e-12))
        outside, floor = np.zeros((0, sensors), bool), 1.0
        if lesson.dt is not None:
            power = np.mean([_spectrum(x) for x, _ in _first(_records(lesson), 64)], axis=0)
            noise = np.quantile(power, 0.1, axis=0)
            outside = power <= IN_BAND * noise
            floor = float(np.mean(power[outside])) if outside.any() else 1.0
        return cls(examples.mean[:p], whiten, half, outside, floor, {}, {}, np.zeros(0), lesson.fitting.samples or 0,
                   np.zeros(0))  # fmt: skip

    def settled(self, means: Sequence[Array], samples: int) -> Self:
        """With the spread of means (sensors,) of residuals of records of `samples`, at least what noise leaves."""
        return replace(self, steady=np.hypot(np.sqrt(np.mean(np.square(means), axis=0)), samples**-0.5))

    def judged(self, scores: Sequence[Mapping[str, float]], samples: int) -> Self:
        """With limits set by the scores of draws that were kept apart, records of `samples` (0: static readings)."""
        logs = {name: _logs(scores, name) for name in scores[0]}
        centre = {name: float(np.median(x)) for name, x in logs.items()}
        spread = {name: max(float(np.quantile(x, HIGH)) - centre[name], 1e-6) for name, x in logs.items()}
        standard = np.stack([(x - centre[k]) / spread[k] for k, x in logs.items()])
        return replace(self, centre=centre, spread=spread, excess=np.sort(np.max(standard, axis=0)), samples=samples)

    def widened(self, scores: Sequence[Mapping[str, float]]) -> Self:
        """With limits that readings of a real sensor meet, of which these are the scores."""
        logs = {name: _logs(scores, name) for name in self.centre}
        centre = {name: max(c, float(np.mean(logs[name]))) for name, c in self.centre.items()}
        spread = {name: float(np.hypot(s, np.std(logs[name]))) for name, s in self.spread.items()}
        return replace(self, centre=centre, spread=spread)

    def scores(self, data: Array, residual: Array | None) -> dict[str, float]:
        """Scores of one reading (sensors,) or record (samples, sensors), whitened."""
        found = {}
        if data.ndim == 1:
            found["distance"] = float(np.mean(((data - self.mean) @ self.whiten) ** 2))
        else:
            d2 = np.concatenate(
                [np.mean(((rows - self.mean) @ self.whiten) ** 2, axis=1) for _, rows in windows(data, self.half)]
            )
            width = min(2 * self.half + 1, len(d2))
            runs = np.convolve(d2, np.full(width, 1 / width), mode="valid")
            found = {"distance": float(np.mean(d2)), "burst": float(np.max(runs))}
            if self.outside.any():
                found["outside"] = float(np.mean(_spectrum(data)[self.outside])) / self.floor
        if data.ndim == 2 and self.steady.size and len(data) >= self.samples:  # shorter ones scatter by more
            left = data if residual is None else residual
            found["offset"] = float(np.sqrt(np.mean((left.mean(axis=0) / self.steady) ** 2)))
        if residual is not None:
            found["residual"] = float(np.sqrt(np.mean(residual**2)))
        return found

    def verdict(self, data: Array, residual: Array | None) -> Verdict:
        """Scores of one reading or record, and their limits."""
        scores = self.scores(data, residual)
        longer = max(1.0, len(data) / self.samples) if self.samples and data.ndim == 2 else 1.0
        level = self.threshold(FALSE_ALARMS / longer)
        names = [name for name in scores if name in self.centre]
        limits = {name: float(np.exp(self.centre[name] + level * self.spread[name])) for name in names}
        return Verdict({name: scores[name] for name in names}, limits)

    def threshold(self, share: float) -> float:
        """Standardised score that this share of draws exceeds: by an exponential tail over the draws kept apart.

        Its mean is taken one standard error above what these show.
        """
        start = float(np.quantile(self.excess, 1 - TAIL))
        beyond = self.excess[self.excess > start] - start
        mean = float(np.mean(beyond)) * (1 + len(beyond) ** -0.5) if len(beyond) else float(np.std(self.excess))
        return start + mean * float(np.log(TAIL / share))

    def arrays(self) -> dict[str, Any]:
        """What a file keeps."""
        return {name: dict(v) if isinstance(v, Mapping) else v for name, v in vars(self).items()}

    @classmethod
    def from_arrays(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `arrays`."""
        return cls(**tree)


# -- helpers ----------------------------------------------------------------------------------------------------------
def _logs(scores: Sequence[Mapping[str, float]], name: str) -> Array:
    return np.log(np.maximum([s[name] for s in scores], 1e-300))


def _records(lesson: Lesson) -> Iterator[tuple[Array, Array]]:
    for data, outputs in lesson.batches(lesson.fitting):
        yield from zip(data, outputs, strict=True)


def _first(items: Iterator[tuple[Array, Array]], count: int) -> Iterator[tuple[Array, Array]]:
    return (item for item, _ in zip(items, range(count), strict=False))


def _features(lesson: Lesson, half: int) -> Iterator[tuple[Array, Array]]:
    """Features of the distance, and no outputs."""
    have, sensors = 0, len(lesson.fitting.sensors)
    if half == 0:
        for data, _ in lesson.batches(lesson.fitting):
            yield data, np.zeros((len(data), 0))
        return
    for record, _ in _records(lesson):
        for _at, rows in windows(record, half):
            yield rows, np.zeros((len(rows), 0))
            have += len(rows)
        if have >= ENOUGH * (2 * half + 1) * sensors:
            return


def _spectrum(record: Array) -> Array:
    """Power (lines, sensors) of a record (samples, sensors): Welch's, with Hann windows that overlap by half."""
    from scipy import signal

    n = min(2 * LINES, len(record))
    _, power = signal.welch(record, nperseg=n, noverlap=n // 2, detrend=False, axis=0)
    if n < 2 * LINES:  # on the same lines as any other
        power = np.stack(
            [np.interp(np.linspace(0, 1, LINES + 1), np.linspace(0, 1, len(power)), c) for c in power.T], 1
        )
    return np.asarray(power)
