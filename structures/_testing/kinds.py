"""Receptance, mobility, accelerance, the way between them, and W207: FRFs that answer before the force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._channels import Channel, Dof
from .._flags import Evidence, Flag
from ..errors import InputError

KINDS = {"receptance": 0, "mobility": 1, "accelerance": 2}
QUANTITY = {"receptance": "displacement", "mobility": "velocity", "accelerance": "acceleration"}
UNIT = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}
ORDER = {QUANTITY[kind]: order for kind, order in KINDS.items()}


def check(kind: str | None, where: str) -> str:
    """The kind itself.

    Raises
    ------
    InputError
        Code LID-W208, if it is missing or none of the three.
    """
    if kind not in KINDS:
        raise InputError(
            "receptance, mobility or accelerance?",
            where=where,
            found=f"kind={kind!r}",
            expected=" or ".join(KINDS),
            hint="pass kind=",
            code="LID-W208",
        )
    return kind


def rows(sensors: Sequence[str | Channel] | None, count: int, kind: str) -> tuple[tuple[Channel, ...], list[Flag]]:
    """Sensors of an FRF of this kind, and a flag W208 for each whose unit does not fit it."""
    quantity = QUANTITY[kind]
    given = sensors or [f"sensor {i + 1}" for i in range(count)]
    described = [
        s if isinstance(s, Channel) else Channel(label=str(s), quantity=quantity, unit=UNIT[quantity]) for s in given
    ]
    described = [replace(s, quantity=quantity) if s.quantity == s.unit == "arbitrary" else s for s in described]
    flags = [
        Flag(
            "W208",
            Evidence(f"unit of {s.label}", s.unit, UNIT[quantity]),
            f"kind={kind!r} and the unit {s.unit} of {s.label} do not fit",
            "receptance is m/N, mobility m/s/N, accelerance m/s^2/N: correct the kind or the unit",
        )
        for s in described
        if s.unit not in (UNIT[quantity], "arbitrary")
    ]
    return tuple(described), flags


def convert(sensor: Channel, kind: str) -> Channel:
    """A motion sensor as it is called in another kind; others as they are."""
    if sensor.quantity not in ORDER or sensor.quantity == QUANTITY[kind]:
        return sensor
    quantity = QUANTITY[kind]
    unit = "arbitrary" if sensor.unit == "arbitrary" else UNIT[quantity]
    # a plain channel: an accelerometer that reads displacements would be a contradiction
    return Channel(label=sensor.label, quantity=quantity, unit=unit, highpass=sensor.highpass, measure=sensor.measure)


def factors(sensors: Sequence[Channel], frequencies: NDArray[Any], kind: str) -> NDArray[np.complex128]:
    """``(i omega)^k`` that takes each sensor to another kind, shape (lines, sensors); 0 at 0 Hz where k is not 0."""
    power = np.array([KINDS[kind] - ORDER[s.quantity] if s.quantity in ORDER else 0 for s in sensors])
    omega = 2j * np.pi * np.where(frequencies > 0, frequencies, 1.0)[:, None]
    return np.asarray(np.where(frequencies[:, None] > 0, omega**power, (power == 0).astype(complex)))


def conversion(
    sensors: Sequence[Channel], frequencies: NDArray[Any], kind: str
) -> tuple[NDArray[np.complex128], NDArray[np.float64], list[Flag]]:
    """What takes an FRF, and what takes its variance, to another kind; and a flag W211 where a line is lost by it.

    Parameters
    ----------
    sensors : sequence of Channel
    frequencies : array, shape (lines,)
        Hz, ascending from 0 or above.
    kind : str
        As `check` passes it.

    Returns
    -------
    factor : array, shape (lines, sensors), complex
        ``(i omega)^k``; 0 at 0 Hz where k is not 0.
    size : array, shape (lines, sensors)
        ``omega^(2 k)`` for the variance. At 0 Hz that of the line beside it: the FRF is not known there.
    flags : list of Flag
        Not empty where an integration divides by 0 Hz: that line becomes 0 and tells nothing.
    """
    factor = factors(sensors, frequencies, kind)
    size = np.abs(factor) ** 2
    if len(frequencies) > 1:
        size[0] = np.where(factor[0] == 0, size[1], size[0])
    lost = [s.label for s in sensors if frequencies[0] == 0 and KINDS[kind] < ORDER.get(s.quantity, 0)]
    flag = Flag(
        "W211",
        Evidence("first line, Hz", 0.0),
        f"the line at 0 Hz is lost in the conversion to {kind} and set to 0 for {', '.join(lost[:8])}",
        f"leave 0 Hz out, or measure the {kind} there",
    )
    return factor, size, [flag] if lost else []


BEFORE_ZERO = 0.1  # share of the energy of an impulse response that may lie at negative times
MEDIAN_SQUARE = 0.4549  # median of the square of a standard normal variable
MEDIAN_POWER = np.log(2)  # and of the squared modulus of a complex one of unit power
TURNED = 0.75  # share before zero of an entry that a band of lines shows to be turned
BAND = 64  # uniform lines from which on a band tells the two sides of zero apart
NEAR = 4  # times closest to zero that the window of the band fills on both sides
RINGS = 1e-3  # share of the energy that must lie further from zero: poles in the band
CHANCE = 6.0  # standard deviations above what noise alone puts there
WRONG_SIGN = 0.75  # share of a drive-point FRF that feeds energy back


def whole(
    frequencies: NDArray[Any], H: NDArray[Any], sensors: Sequence[Channel], loads: Sequence[Channel]
) -> tuple[Flag, ...]:
    """W207 on a full grid: share of the impulse response's energy at negative times (0 if causal, 1 if conjugated).

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz.
    H : array, shape (lines, sensors, loads), complex
        From 0 Hz to the Nyquist frequency.
    sensors, loads : sequence of Channel

    Notes
    -----
    A response that rings longer than the inverse of the line spacing wraps round, but never by more than half. Noise
    fills all times alike: its level, seen furthest from zero on both sides, is taken off.
    """
    h = np.fft.irfft(H, axis=0)
    half, skip = len(h) // 2, max(4, len(h) // 200)  # an anti-alias filter rings a little before zero
    floor = np.median(h[half - half // 4 : half + half // 4] ** 2, axis=0) / MEDIAN_SQUARE
    before, after = (
        np.maximum(np.sum(x[skip : half - skip] ** 2, axis=0) - (half - 2 * skip) * floor, 0.0) for x in (h[::-1], h)
    )
    tiny = np.finfo(float).tiny
    each, share = before / np.maximum(before + after, tiny), before.sum() / max((before + after).sum(), tiny)
    turned = _pairs(each > 0.9, sensors, loads)
    signs = _signs(feeds_back(frequencies, H, sensors, loads), each > 0.9, np.ones(each.shape, bool), sensors, loads)
    if share <= BEFORE_ZERO and not turned:
        return signs
    worst = float(max(share, each.max()))
    flag = Flag(
        "W207",
        Evidence("energy at negative times", worst, BEFORE_ZERO),
        f"the FRF is not causal: {worst:.0%} of its impulse response lies before zero"
        + (f" ({', '.join(turned[:8])})" if turned else ""),
        "conjugate it, or correct the sign convention at import (e^{+i omega t})"
        if turned
        else "check the sign convention (e^{+i omega t}), and whether the lines are narrower than the peaks",
    )
    return (flag, *signs)


def lines(
    frequencies: NDArray[Any], H: NDArray[Any], sensors: Sequence[Channel], loads: Sequence[Channel]
) -> tuple[Flag, ...]:
    """W207 on any lines: what rings before zero in a band, and drive points that feed energy back; or a note N207.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, ascending.
    H : array, shape (lines, sensors, loads), complex
    sensors, loads : sequence of Channel
        A sensor and a load are a drive point where both labels name the same DOF (``12+Z``).

    Returns
    -------
    tuple of Flag
        W207 for entries that are turned; N207 where no entry can be judged; empty where all is well.
    """
    share, told = before_zero(frequencies, H)
    turned = told & (share > TURNED)
    back = feeds_back(frequencies, H, sensors, loads)
    flags = list(_signs(back, turned, told, sensors, loads))
    if np.any(turned):
        flag = Flag(
            "W207",
            Evidence("energy at negative times", float(share[turned].max()), TURNED),
            f"the FRF is not causal: {int(turned.sum())} of the {int(told.sum())} entries that tell ring before zero "
            f"({', '.join(_pairs(turned, sensors, loads)[:8])})",
        )
        flags.insert(0, flag)
    if not np.any(told) and np.all(np.isnan(back)):
        flags.append(_untold(frequencies))
    return tuple(flags)


def before_zero(frequencies: NDArray[Any], H: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Share of the energy before zero of each entry on its longest run of uniform lines, and whether that tells it.

    Returns
    -------
    share : array, shape (sensors, loads)
        0 for a causal response, 1 for a conjugated one; near a half where peaks are narrower than the lines.
    told : array of bool, shape (sensors, loads)
        Whether enough energy rings away from zero.

    Notes
    -----
    A Hann window over the band convolves the impulse response with a pulse that is symmetric about zero and dies out
    after four steps of 1/bandwidth on either side: whatever lies further off are the decays of the poles in the band,
    and they have one side. Powers of omega between the kinds change neither. Over 10 000 random models of 1 to 20
    modes (damping 0.1 to 5 %, at 0.2 to 1.5 times the upper end of the band, entries of any sign, all kinds), 30 % of
    the entries are told on 64 lines and 95 % on 500. None of those is called turned, and 0.5 % of their conjugates
    are missed; with noise of half the rms, 1 in 5000 and 3.5 % (``python -m tests.benchmarks.causality``).
    """
    start, stop = uniform_run(frequencies)
    band = H[start:stop]
    if len(band) < BAND:
        return np.zeros(H.shape[1:]), np.zeros(H.shape[1:], bool)
    energy = np.abs(np.fft.ifft(band * np.hanning(len(band) + 2)[1:-1, None, None], axis=0)) ** 2
    half = len(energy) // 2
    after, before = energy[NEAR:half], energy[:-half:-1][NEAR - 1 :]
    floor = np.median(energy[half - half // 4 : half + half // 4], axis=0) / MEDIAN_POWER
    later, earlier = (np.maximum(x.sum(axis=0) - len(x) * floor, 0.0) for x in (after, before))
    rings = later + earlier
    chance = CHANCE * floor * np.sqrt(len(after) + len(before))
    told = (rings > RINGS * energy.sum(axis=0)) & (rings > chance)
    return np.divide(earlier, rings, out=np.zeros(rings.shape), where=rings > 0), told


def feeds_back(
    frequencies: NDArray[Any], H: NDArray[Any], sensors: Sequence[Channel], loads: Sequence[Channel]
) -> NDArray[np.float64]:
    """Share of each drive-point FRF whose imaginary part, as a receptance, is positive; NaN for other entries.

    A force does positive work on a passive structure wherever it acts: the receptance of a drive point has no positive
    imaginary part, on any line (Ewins, Modal Testing, 2nd ed., 2000, section 2.7). Squares of the part that tells
    weigh the lines, so that peaks decide and noise in between does not.
    """
    share = np.full(H.shape[1:], np.nan)
    for i, sensor in enumerate(sensors):
        for j, load in enumerate(loads):
            polarity = drive_point(sensor, load)
            if polarity and sensor.quantity in ORDER:
                part = polarity * (H[:, i, j] * (-1j) ** ORDER[sensor.quantity]).imag[frequencies > 0]
                total = float(np.sum(part**2))
                share[i, j] = np.sum(part[part > 0] ** 2) / total if total > 0 else np.nan
    return share


def drive_point(sensor: Channel, load: Channel) -> int:
    """1 where sensor and load sit on the same DOF, -1 where they point against each other, 0 elsewhere or unknown.

    The voltage of a shaker is no force: its phase is that of amplifier and coil.
    """
    if load.quantity == "voltage":
        return 0
    try:
        here, there = Dof.parse(sensor.label), Dof.parse(load.label)
    except InputError:
        return 0
    return here.sign * there.sign if here.key == there.key else 0


def uniform_run(frequencies: NDArray[Any]) -> tuple[int, int]:
    """First line and end of the longest run of evenly spaced lines."""
    step = np.diff(frequencies)
    if len(step) < 2:
        return 0, len(frequencies)
    breaks = np.flatnonzero(np.abs(np.diff(step)) > 1e-3 * np.minimum(step[1:], step[:-1])) + 1
    ends = np.concatenate([[0], breaks, [len(step)]])
    k = int(np.argmax(np.diff(ends)))
    return int(ends[k]), int(ends[k + 1]) + 1


def _signs(
    back: NDArray[Any], turned: NDArray[Any], told: NDArray[Any], sensors: Sequence[Channel], loads: Sequence[Channel]
) -> tuple[Flag, ...]:
    """W207 for drive points of the wrong sign that are not known to be conjugated."""
    only = (back > WRONG_SIGN) & ~turned
    if not np.any(only):
        return ()
    sure = bool(np.all(told[only]))
    flag = Flag(
        "W207",
        Evidence("share of a drive point that feeds energy back", float(back[only].max()), WRONG_SIGN),
        f"a drive point feeds energy back: {', '.join(_pairs(only, sensors, loads)[:8])} has the wrong sign"
        + ("" if sure else " or is conjugated"),
        "turn the polarity of the sensor or of the force"
        + ("" if sure else ", or conjugate the FRF (sign convention e^{+i omega t})"),
    )
    return (flag,)


def _untold(frequencies: NDArray[Any]) -> Flag:
    start, stop = uniform_run(frequencies)
    return Flag(
        "N207",
        Evidence("evenly spaced lines", float(stop - start), float(BAND)),
        "whether the FRF is causal was not told: no peak rings in its band"
        if stop - start >= BAND
        else "whether the FRF is causal was not told: too few evenly spaced lines",
    )


def _pairs(mask: NDArray[Any], sensors: Sequence[Channel], loads: Sequence[Channel]) -> list[str]:
    return [f"{sensors[i].label} / {loads[j].label}" for i, j in np.argwhere(mask).tolist()]
