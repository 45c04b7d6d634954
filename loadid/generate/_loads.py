"""Load histories that are drawn: impact, slow, harmonic, random, switched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, one_of, positive

from ._ranges import Range, Ranges, within

Array = NDArray[np.float64]
NEEDS = {  # kind of load -> what it is told beside its level
    "impact": ("duration",), "slow": ("frequency",), "harmonic": ("frequency",), "random": ("frequency",),
    "switched": ("duration",),
}  # fmt: skip
COUNTED = ("impact", "harmonic")


@dataclass(frozen=True)
class LoadRange(Ranges):
    """A kind of load history, and what of it is drawn.

    Parameters
    ----------
    kind : {"impact", "slow", "harmonic", "random", "switched"}
        Half sines; smooth below a frequency; sines; noise in a band; constant between switches.
    level : range
        In the unit of the load: peak of an impact, largest value of a slow load, amplitude of a sine, std of noise, and
        largest value of a switched one. Either sign is as likely.
    weight : float
        How often it is drawn, beside the others.
    duration : range, optional
        Of an impact, and between two switches (s).
    frequency : range, optional
        Highest frequency of a slow load, that of a sine, and the band of noise, which is its lowest and highest (Hz).
    count : range
        Of impacts, and of sines.

    Raises
    ------
    InputError
        Another kind, a range that is missing, not possible or none of its kind.
    """

    kind: str
    level: Range = field(metadata=within("", 0.0))
    weight: float = 1.0
    duration: Range | None = field(default=None, metadata=within("", 1e-9))
    frequency: Range | None = field(default=None, metadata=within("", 0.0))
    count: Range = field(default=(1, 1), metadata=within("", 1, 1000))

    def __post_init__(self) -> None:
        one_of("no kind of load history", self.kind, NEEDS, where="LoadRange, kind")
        positive("weight", self.weight, where="LoadRange")
        super().__post_init__()
        for name in ("duration", "frequency"):
            stated, needed = getattr(self, name) is not None, name in NEEDS[self.kind]
            if stated != needed:
                raise InputError(f"the range {name} is {'missing' if needed else 'none of this kind'}",
                                 where=f"LoadRange, {self.kind}", found=name if stated else "nothing",
                                 expected=", ".join(NEEDS[self.kind]))  # fmt: skip

    def fits(self, dt: float, samples: int) -> None:
        """Refuse what histories of a step and length cannot hold.

        Raises
        ------
        InputError
        """
        span, nyquist = dt * samples, 0.5 / dt
        if self.frequency is not None and self.frequency[1] > nyquist * (1 + 1e-9):
            raise InputError("a load above half the sampling rate", where=f"LoadRange, {self.kind}",
                             found=f"{self.frequency[1]:g} Hz", expected=f"up to {nyquist:g} Hz")  # fmt: skip
        if self.duration is not None and (self.duration[1] > span or self.duration[0] < dt):
            raise InputError("a duration that the histories cannot hold", where=f"LoadRange, {self.kind}",
                             found=f"{self.duration[0]:g} to {self.duration[1]:g} s",
                             expected=f"{dt:g} to {span:g} s")  # fmt: skip
        if self.kind == "random" and len(_band(self, dt, samples)) == 0:
            raise InputError("no line of the histories lies in the band", where="LoadRange, random",
                             found=f"{self.frequency} Hz", expected=f"lines every {1 / span:g} Hz")  # fmt: skip

    def history(self, rng: np.random.Generator, dt: float, samples: int) -> Array:
        """One history (samples,)."""
        made: Callable[[LoadRange, np.random.Generator, Array], Array] = _MADE[self.kind]
        return made(self, rng, np.asarray(dt * np.arange(samples), float))

    def amount(self, rng: np.random.Generator) -> float:
        """A level, of either sign."""
        return self.draw(rng, "level") * (1.0 if rng.random() < 0.5 else -1.0)


def _impact(of: LoadRange, rng: np.random.Generator, t: Array) -> Array:
    out = np.zeros(len(t))
    for _ in range(round(of.draw(rng, "count"))):
        duration = of.draw(rng, "duration")
        since = t - float(rng.uniform(0.0, max(t[-1] - duration, 0.0)))
        on = (since >= 0) & (since <= duration)
        out[on] += of.amount(rng) * np.sin(np.pi * since[on] / duration)
    return out


def _slow(of: LoadRange, rng: np.random.Generator, t: Array) -> Array:
    """Sines below a frequency and a constant, of random phase; scaled to its largest value."""
    highest = of.draw(rng, "frequency")
    f = highest * rng.random(6)
    out = rng.standard_normal() * np.ones(len(t)) + _sines(f, rng.standard_normal(6), rng, t)
    return out * of.amount(rng) / np.abs(out).max()


def _harmonic(of: LoadRange, rng: np.random.Generator, t: Array) -> Array:
    count = round(of.draw(rng, "count"))
    f = [of.draw(rng, "frequency") for _ in range(count)]
    return _sines(np.array(f), np.array([of.draw(rng, "level") for _ in range(count)]), rng, t)


def _random(of: LoadRange, rng: np.random.Generator, t: Array) -> Array:
    """Every line of the band with random amplitude and phase."""
    lines = _band(of, float(t[1] - t[0]), len(t))
    spectrum = np.zeros(len(t) // 2 + 1, complex)
    spectrum[lines] = rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines))
    out = np.fft.irfft(spectrum, len(t))
    return np.asarray(out * of.draw(rng, "level") / out.std())


def _switched(of: LoadRange, rng: np.random.Generator, t: Array) -> Array:
    out, at = np.zeros(len(t)), 0.0
    largest = of.draw(rng, "level")
    while at <= t[-1]:
        out[t >= at] = largest * rng.uniform(-1.0, 1.0)
        at += of.draw(rng, "duration")
    return out


def _sines(f: Any, amplitude: Any, rng: np.random.Generator, t: Array) -> Array:
    phase = rng.uniform(0, 2 * np.pi, len(f))
    return np.asarray(np.sin(2 * np.pi * np.outer(t, f) + phase) @ amplitude)


def _band(of: LoadRange, dt: float, samples: int) -> NDArray[np.int64]:
    """Lines of the transform of a history that lie in the band, but the first and the last."""
    f = np.fft.rfftfreq(samples, dt)
    low, high = of.frequency or (0.0, 0.0)
    inside = (f > 0) & (f < 0.5 / dt * (1 - 1e-9)) & (f >= low * (1 - 1e-9)) & (f <= high * (1 + 1e-9))
    return np.flatnonzero(inside)


_MADE = {"impact": _impact, "slow": _slow, "harmonic": _harmonic, "random": _random, "switched": _switched}
