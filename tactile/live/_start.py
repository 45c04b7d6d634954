"""From a pad file and a camera to a sensor that runs."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from loadid.codes import GUARDS
from structures.errors import InputError, integer

from .._arrays import UnusableFrame
from .._closed.presses import Press
from .._commands._sources import first_eye
from .._pad import padfile
from .._pad.pad import Pad
from .._sensors.marked import ContactLaw
from .._sensors.multilayer import MultilayerPad
from .._sensors.prior import penalty
from ..vision._eye import Eye
from ..vision._frames import Frames, each, frames
from ._loop import Live
from ._state import kept

UNLOADED = 10  # frames of the unloaded pad that are taken where there is no state
STRAIN, SHEAR = 0.03, 0.2  # of the press on which lambda is chosen: mean pressure over E; shear over normal force


def start(
    pad: str | os.PathLike[str],
    camera: Any,
    *,
    state: str | Path | None = None,
    unloaded: int = UNLOADED,
    lam: float | str | None = None,
    friction: float | None = None,
    no_pull: bool = False,
    allow: Iterable[str] = (),
    **settings: Any,
) -> Live:
    """A sensor of a pad file on a camera, its markers alone (a depth map beside them: build the sensor, and `Live`).

    Parameters
    ----------
    pad : path
        Pad file (TOML) with a camera.
    camera : number, path, cv2.VideoCapture or iterable of images
        As `tactile.frames` takes it.
    state : path, optional
        As `Live`: where it is there, the eye is that of the state, and no frame need be unloaded.
    unloaded : int
        Frames of the unloaded pad that it begins with, where there is no state; they have no map.
    lam : float or str, optional
        Relative lambda, or the rule that chooses it on a press that is simulated; default that of the state, or of the
        file, or as the sensors choose it.
    friction, no_pull
        Override those of the file.
    allow : sequence of str
        Guard codes whose refusal is overridden.
    **settings
        Of `Live`.

    Raises
    ------
    InputError
        A file, camera or state that does not fit.
    """
    codes = tuple(code.upper().removeprefix("LID-") for code in allow)
    found, before = padfile.read(pad), kept(state)
    if found.view is None:
        raise InputError("the camera is not described", where=str(found.path), found="no table [camera]",
                         expected="[camera] with a lens, a homography, or points and their pixels")  # fmt: skip
    body = Pad.from_settings(found, allow=[c for c in codes if c[1:2] == "1"])
    coming = frames(camera)
    contact = {**found.contact, **({"no_pull": True} if no_pull else {})}
    contact |= {name: v for name, v in (("friction", friction), ("lam", lam)) if v is not None}
    if before is not None and before.eye is not None:
        eye = before.rebuilt(found.view, body.size)
    else:
        eye = _first(coming, unloaded, found, body, codes)
    chosen = contact.get("lam")
    sensor = MultilayerPad(
        body, eye=eye, penalty=penalty(contact), allow=[c for c in codes if c in GUARDS],
        contact=ContactLaw(contact.get("no_pull", False), contact.get("friction")),
        choice=before.lam if chosen is None and before is not None else chosen, tolerances=found.tolerances,
    )  # fmt: skip
    if not sensor.frozen:
        _calibrate(sensor)
    return Live(sensor, coming, state=state, **settings)


def _first(coming: Frames, count: int, found: padfile.SensorFile, pad: Pad, codes: tuple[str, ...]) -> Eye:
    """The eye of the first frames, which nothing touches."""
    seen = (frame for frame in each(coming) if not isinstance(frame, UnusableFrame))
    still = list(itertools.islice(seen, integer("unloaded", count, where="start", limit=10**6)))
    if not still:
        raise InputError("there are no frames", where="camera", found="none that can be used",
                         expected=f"{count} of the unloaded pad to begin with")  # fmt: skip
    return first_eye(found, pad, still, codes)


def _calibrate(sensor: MultilayerPad) -> None:
    """Lambda for a press of moderate strain, by the kernels of the layer, with the noise of the markers."""
    pad, markers = sensor.pad, sensor.markers
    radius = min(pad.thickness, 0.25 * min(pad.size))
    force = STRAIN * pad.E * np.pi * radius**2
    u = Press(radius=radius, force=force, shear=(SHEAR * force, 0.0)).displacement(pad.layer, markers.points[:, :2])
    seen = u[:, :2] if markers.slope is None else u[:, :2] + markers.slope * u[:, 2:]
    sensor.calibrate([seen + markers.noise * np.random.default_rng(0).standard_normal(seen.shape)])
