"""What is wrong with a sensor that contradicts the others: gain, sign, delay, offset, drift, or nothing read at all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .leave_one_out import LeftOut, SensorLines
from .suspects import Suspicion, suspect

Array = NDArray[Any]
Real = NDArray[np.float64]

UNITS = (9.80665, 1e3, 1e6, 1e2, 10.0, np.sqrt(2.0), 0.0254, 4.4482216, 2 * np.pi, 180 / np.pi)
NEAR = 4.0  # errors of the gain within which it is a factor of units ...
BEYOND = 0.03  # ... and of the gain
FOLLOWS = 0.8  # correlation with the prediction, from which a sensor follows it
DEAD = 0.2  # of the gain, below which a sensor does not follow
QUIET = 0.3  # of the prediction, below which a sensor is dead
EXPLAINED = 0.35  # of the misfit that a gain or a delay may leave
SLOW = 0.8  # of the misfit on slow lines: an offset or a drift
MATTERS = 0.2  # of the reading, from which a slow misfit is told
CONSTANT = 0.9  # of the slow misfit that a constant explains


@dataclass(frozen=True)
class LineFault:
    """What is wrong with one sensor.

    Parameters
    ----------
    kind : str
        ``gain, unit, polarity, delay, dead, offset, drift`` or ``other``.
    size : float
        Gain over what it should be, delay in samples, offset in the unit of the sensor; 0 where nothing is to be said.
    std : float
        Of the size.
    gain : float
        Gain, for whatever else is wrong.
    """

    kind: str
    size: float
    std: float
    gain: float = 1.0


@dataclass(frozen=True, eq=False)
class LineTimes:
    """What lines have to do with time.

    Parameters
    ----------
    phase : array, shape (lines,)
        Angle per sample of delay.
    constant : array, shape (lines,), complex, or None
        Transform of a constant of one, where the lines hold it.
    slow : array of bool, shape (lines,)
        Lines of what an offset or a drift is made of.
    longest : float
        Delay, samples, up to which one is sought.
    """

    phase: Real
    constant: Array | None
    slow: NDArray[np.bool_]
    longest: float


def told_apart(lines: SensorLines, suspicion: Suspicion, clock: LineTimes | None) -> tuple[int, LineFault] | None:
    """The sensor that is wrong, and its fault: of several suspects the one whose fault is one that sensors have."""
    if suspicion.found is None or not suspicion.sensors:
        return None
    faults = {i: _named(lines, suspicion, suspicion.found, i, clock) for i in suspicion.sensors}
    for usual in (("polarity", "unit", "dead", "delay"), ("polarity", "unit", "dead", "delay", "gain", "offset")):
        left = {i: f for i, f in faults.items() if f.kind in usual}
        if len(faults) == 1:
            return next(iter(faults.items()))
        if len(left) == 1 and lines.spare > 1:
            return next(iter(left.items()))
    return None


def drifting(lines: SensorLines, clock: LineTimes) -> tuple[Suspicion, int, LineFault] | None:
    """A sensor with an offset or a drift, which few of the `prepared` lines hold: these are asked alone."""
    if clock.slow.sum() < 2:
        return None
    slow = lines.on(clock.slow)
    found = suspect(slow)
    if found is None or found.swap or len(found.sensors) != 1 or found.found is None:
        return None
    (i,) = found.sensors
    alone = replace(clock, phase=clock.phase[clock.slow], constant=None, slow=np.ones(int(clock.slow.sum()), bool))
    fault = _named(slow, found, found.found, i, alone)
    if fault.kind in ("gain", "unit", "polarity", "dead", "delay"):
        return found, i, fault
    rest = found.found.rest[:, i]
    if np.sum(np.abs(rest) ** 2) < MATTERS**2 * np.sum(np.abs(lines.y[:, i]) ** 2):
        return None
    return found, i, _slow(rest, None if clock.constant is None else clock.constant[clock.slow])


def _named(lines: SensorLines, suspicion: Suspicion, found: LeftOut, i: int, clock: LineTimes | None) -> LineFault:
    """The fault of a sensor that is wrong."""
    y, p = lines.y[:, i], lines.y[:, i] - found.rest[:, i]
    told, own = found.precision[:, i] > 0, lines.noise[:, i] + suspicion.delta**2 * lines.size[:, i]
    spread = np.divide(1.0, found.precision[:, i], out=np.full(len(y), np.inf), where=told)
    # the variance of the sensor is taken as that of one that follows the prediction
    ratio = min(1.0, float(np.sum(np.abs(p[told]) ** 2) / max(np.sum(np.abs(y[told]) ** 2), 1e-300)))
    w = lines.worth / np.maximum(spread - (1 - ratio) * own, 1e-12 * spread)[:, None]
    size = float(np.sum(w * np.abs(p) ** 2))
    chance = float(np.sqrt(suspicion.scale))
    if size <= 0:
        return LineFault("other", 0.0, 0.0)
    gain = float(np.sum(w * (p.conj() * y).real)) / size
    # a gain is known to what noise and errors of the model leave of it
    std = chance * float(np.sqrt(1 / size + suspicion.delta**2 * max(1.0, gain**2)))
    before = float(np.sum(w * np.abs(y - p) ** 2))
    after = float(np.sum(w * np.abs(y - gain * p) ** 2))
    late = None if clock is None else _delayed(y, p, w, clock)
    if late is not None and late[2] < EXPLAINED * after and 1 / 3 < abs(late[1]) < 3:
        return LineFault("delay", late[0], late[3] * chance, late[1])
    power = float(np.sum(w * np.abs(y) ** 2))
    follows = np.size(y) > 3 and gain**2 * size > FOLLOWS**2 * power
    if abs(gain) < DEAD and power < QUIET**2 * size + np.size(y) * lines.worth * chance**2 and not follows:
        return LineFault("dead", 0.0, std, gain)
    if clock is None and lines.y.shape[2] > 3 and (steady := _constant(y, p, w, after)) is not None:
        return steady
    if after > EXPLAINED * before and clock is not None and clock.constant is not None:
        energy = np.sum(np.abs(y - p) ** 2, axis=1)
        if np.sum(energy[clock.slow]) > SLOW * np.sum(energy):
            return _slow(y - p, clock.constant)
    if after > EXPLAINED * before and not follows:
        return LineFault("other", 0.0, 0.0, gain)
    return _of_gain(gain, std)


def _of_gain(gain: float, std: float) -> LineFault:
    """A gain as polarity, as a mistaken unit, or as what it is."""
    room = max(NEAR * std, BEYOND) * max(1.0, abs(gain)) if abs(gain) >= 1 else max(NEAR * std, BEYOND * abs(gain))
    if abs(gain + 1) <= max(NEAR * std, 0.25):
        return LineFault("polarity", gain, std, gain)
    near = [f for u in UNITS for f in (u, 1 / u, -u, -1 / u) if abs(f - gain) <= min(room, 0.15 * abs(f))]
    if near and (abs(gain) > 1.2 or abs(gain) < 0.8):
        return LineFault("unit", min(near, key=lambda f: abs(f - gain)), std, gain)
    return LineFault("gain", gain, std, gain)


def _delayed(y: Array, p: Array, w: Real, clock: LineTimes) -> tuple[float, float, float, float] | None:
    """Delay, its gain, what it leaves, its std: the best of a fine grid, refined by a parabola."""
    step = 0.125
    lags = np.arange(-clock.longest, clock.longest + step / 2, step)
    c = np.sum(w * p.conj() * y, axis=1)
    used = np.flatnonzero(np.abs(c) > 0)
    if not len(used):
        return None
    like = np.array([np.sum(c[used] * np.exp(1j * clock.phase[used] * lag)).real for lag in lags])
    size, own = float(np.sum(w * np.abs(p) ** 2)), float(np.sum(w * np.abs(y) ** 2))
    k = int(np.argmax(like))
    if k in (0, len(lags) - 1) or abs(lags[k]) < 0.2:
        return None
    bend = like[k - 1] - 2 * like[k] + like[k + 1]
    lag = lags[k] + (0.5 * step * (like[k - 1] - like[k + 1]) / bend if bend < 0 else 0.0)
    std = float(np.sqrt(1 / max(np.sum(w * np.abs(clock.phase[:, None] * p) ** 2), 1e-300)))
    return float(lag), float(like[k] / size), own - float(like[k]) ** 2 / size, std


def _slow(rest: Array, constant: Array | None) -> LineFault:
    """An offset, or a drift: whether the transform of a constant explains what is left on slow lines."""
    if constant is None:
        return LineFault("drift", 0.0, 0.0)
    c = constant[:, None]
    offset = float(np.sum((c.conj() * rest).real) / np.sum(np.abs(c) ** 2))
    left = float(np.sum(np.abs(rest - offset * c) ** 2))
    return (
        LineFault("offset", offset, 0.0)
        if left < (1 - CONSTANT) * np.sum(np.abs(rest) ** 2)
        else LineFault("drift", 0.0, 0.0)
    )


def _constant(y: Array, p: Array, w: Real, after: float) -> LineFault | None:
    """An offset over frames."""
    offset = float(np.sum(w * (y - p)) / np.sum(w))
    left = float(np.sum(w * (y - p - offset) ** 2))
    return LineFault("offset", offset, float(np.sqrt(1 / np.sum(w) / y.shape[1]))) if left < 0.5 * after else None
