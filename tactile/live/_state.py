"""What a sensor learned while it ran, in a file that a kill leaves whole: written anew, synced, and renamed.

It is of one pad: the next start must see the same markers, so it is given the eye of the state and no new reference,
which an object in the grip would spoil.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structures.errors import InputError
from structures.files import _storage as storage

from .._arrays import Array
from .._sensors.linear import LinearSensor
from .._sensors.marked import MarkedSensor
from ..vision._detect import Detector
from ..vision._eye import Eye

if TYPE_CHECKING:
    from ..vision._eye import View

KIND = "tactile state"
SAME = 1e-9  # m, between places of markers that are the same


@dataclass(frozen=True, eq=False)
class State:
    """What a running sensor knows.

    Parameters
    ----------
    about : mapping
        Kind of the sensor, pad, axes and places of its markers (N, 2 or 3) in m: what it must find again.
    number : int
        Of the last frame.
    counts : mapping of str to int
        What was counted, of earlier runs too.
    offset, anchor : array (m,)
        Zero of the readings, and the rest that it is held against (m).
    friction : mapping
        Ratios of shear to normal force that were kept.
    eye : mapping, optional
        Places of the markers at rest (px), noise (px) and detector.
    lam : float, optional
        Relative lambda.
    """

    about: Mapping[str, Any]
    number: int
    counts: Mapping[str, int]
    offset: Array
    anchor: Array
    friction: Mapping[str, Any] = field(default_factory=dict)
    eye: Mapping[str, Any] | None = None
    lam: float | None = None

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> State:
        """State of a file.

        Raises
        ------
        InputError
            No such file, damaged, of another kind.
        """
        return cls(**storage.read(path, KIND))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Put it into a file, whole or not at all."""
        storage.write(path, {name: _plain(value) for name, value in vars(self).items()}, KIND)

    def rebuilt(self, view: View, size: tuple[float, float] | None = None) -> Eye:
        """The eye as it was: its markers at rest, not those of frames that may show a load.

        Parameters
        ----------
        view : View
            How the camera sees the markers.
        size : (a, b), optional
            Sides of the pad (m), as the first eye had them.

        Raises
        ------
        InputError
            Of a sensor that had no eye.
        """
        if self.eye is None:
            raise InputError("this sensor had no eye", where="state", expected="a sensor that reads images")
        known = dict(self.eye)
        places, noise, gate = known.pop("places"), known.pop("noise"), known.pop("gate")
        return Eye(view, places, noise=tuple(noise), size=size, gate=gate, detector=Detector(**known))

    def require(self, sensor: MarkedSensor, path: str | os.PathLike[str]) -> None:
        """Refuse a sensor that is another one than that of the state, and say what differs."""
        now, hint = about(sensor), "name another file for this pad, or remove this one where the pad was changed"
        for name, word in (("kind", "sensor"), ("pad", "pad"), ("axes", "axes")):
            if now[name] != self.about[name]:
                raise InputError(f"the state is of another {word}", where=str(path), found=self.about[name],
                                 expected=now[name], hint=hint)  # fmt: skip
        before, places = np.asarray(self.about["places"]), now["places"]
        if before.shape != places.shape or np.abs(before - places).max() > SAME:
            raise InputError(
                "the markers of the state are others than those of the sensor", where=str(path),
                found=f"{len(before)} markers", expected=f"the {len(places)} of the sensor, at the same places",
                hint=f"build the sensor on the eye of the state, State.read(path).rebuilt(view, size=), or {hint}",
            )  # fmt: skip
        if len(self.offset) != len(sensor.offset):
            raise InputError("the state is of a sensor with other readings", where=str(path),
                             found=len(self.offset), expected=len(sensor.offset), hint=hint)  # fmt: skip


def about(sensor: MarkedSensor) -> dict[str, Any]:
    """What tells one sensor from another."""
    pad = sensor.pressed_body.body if isinstance(sensor, LinearSensor) else sensor
    return {"kind": sensor.name, "pad": repr(pad), "axes": sensor.markers.axes, "places": sensor.markers.points}


def state_of(sensor: MarkedSensor, number: int, counts: Mapping[str, int], anchor: Array,
             friction: Mapping[str, Any]) -> State:  # fmt: skip
    """Everything that the next start needs."""
    lam = sensor.inverse.lam if isinstance(sensor, LinearSensor) and sensor.frozen else None
    return State(about(sensor), number, dict(counts), sensor.offset, anchor, friction, _eye(sensor.eye), lam)


def _eye(eye: Eye | None) -> dict[str, Any] | None:
    detector = None if eye is None else eye.tracker.detector
    if eye is None or detector is None:
        return None
    return {"places": eye.tracker.points, "noise": eye.noise_px, "gate": eye.tracker.gate, **vars(detector)}


def _plain(value: Any) -> Any:
    return {k: _plain(v) for k, v in value.items()} if isinstance(value, Mapping) else value


def kept(path: str | os.PathLike[str] | None) -> State | None:
    """The state of a file, where there is one."""
    return None if path is None or not Path(path).exists() else State.read(path)
