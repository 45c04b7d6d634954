"""Receptance, mobility, accelerance: the three kinds of FRF of a motion sensor, and the way between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .channels import Channel
from .errors import InputError
from .flags import Evidence, Flag

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


def factors(sensors: Sequence[Channel], frequencies: NDArray, kind: str) -> NDArray[np.complex128]:
    """``(i omega)^k`` that takes each sensor to another kind, shape (lines, sensors); 0 at 0 Hz where k is not 0."""
    power = np.array([KINDS[kind] - ORDER[s.quantity] if s.quantity in ORDER else 0 for s in sensors])
    omega = 2j * np.pi * np.where(frequencies > 0, frequencies, 1.0)[:, None]
    return np.where(frequencies[:, None] > 0, omega**power, (power == 0).astype(complex))


def conversion(
    sensors: Sequence[Channel], frequencies: NDArray, kind: str
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
