"""A gel pad in a job file: its pad file, where its markers are, whether there are images, and what moves in truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structures.errors import InputError

from .._arrays import Array
from .._pad import padfile
from .._pad.pad import Pad
from .._pad.table import TomlTable
from .._sensors.multilayer import MultilayerPad
from .._sensors.observation import Markers
from ..vision._detect import Detector
from ..vision._eye import Eye
from ..vision._images import Scene, grid
from ._declared import PressDeclaration
from ._maker import PressMaker
from ._pictures import sheet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from loadid import FittedMap
    from loadid.generate import TrainingSet

QUIET = 6  # unloaded images whose jitter is the noise, where none is stated


def maker(
    job: Mapping[str, Any], file: Path
) -> tuple[PressMaker, Callable[[int, int], list[Figure]], Callable[..., FittedMap]]:
    """What draws for the ``[sensor]`` of a job, its pictures by seed and number of draws, and what learns its map.

    Raises
    ------
    InputError
        A table that is none, a pad file or a declaration that is none.
    """
    given = job.get("declaration")
    if isinstance(given, Mapping):
        declared = PressDeclaration.of_tables(file, given)
    elif isinstance(given, str):
        declared = PressDeclaration.read(file.parent / given)
    else:
        raise InputError("what is drawn?", where=str(file), found="no declaration",
                         expected='declaration = "presses.toml", or tables under [declaration]')  # fmt: skip
    table = TomlTable(file, "sensor", job["sensor"])
    sensor, truth = _sensor(table, declared)
    found = PressMaker(sensor, declared, truth)
    return found, partial(_sheets, found), partial(_learned, sensor)


def _learned(sensor: MultilayerPad, training: TrainingSet, *, engine: str = "linear", **settings: Any) -> FittedMap:
    """The map of a sensor, as `LearnedSensor.fit` learns it."""
    from .._sensors.learned import LearnedSensor

    return LearnedSensor.fit(sensor, training, engine=engine, **settings).fitted


def _sheets(found: PressMaker, seed: int, draws: int) -> list[Figure]:
    return [sheet(found, seed, draws)]


def _sensor(t: TomlTable, declared: PressDeclaration) -> tuple[MultilayerPad, list[Pad]]:
    settings = padfile.read(t.beside(t.text("pad")))
    pad = Pad.from_settings(settings)
    dots = grid(t.count("rows"), t.count("columns"), t.positive("pitch", "displacement"))
    rendered = t.flag("images", settings.view is not None)
    finer, layers = t.positive("truth_pitch", "displacement", None), t.count("truth_layers", None)
    t.end()
    if np.abs(dots).max(axis=0)[0] >= pad.size[0] / 2 or np.abs(dots).max(axis=0)[1] >= pad.size[1] / 2:
        raise t.refused("pitch", "markers beside the pad", f"{len(dots)} markers", f"a pattern within {pad.size} m")
    truth = []
    if finer is not None or layers is not None:
        count = layers or 2 * pad.layers
        truth = [Pad(E=pad.E, nu=pad.nu, size=pad.size, thickness=pad.thickness, pitch=finer, layers=count)]
    known: dict[str, Any] = {"penalty": "identity", "tolerances": settings.tolerances}
    if settings.view is None:
        if rendered:
            raise t.refused("images", "no camera takes them", "a pad file without [camera]", "images = false")
        return MultilayerPad(pad, Markers(dots, _metres(t, settings)), **known), truth
    eye = _eye(settings, declared, dots)
    if rendered:
        return MultilayerPad(pad, eye=eye, **known), truth
    return MultilayerPad(pad, Markers(eye.markers, eye.noise, slope=eye.slope), **known), truth


def _metres(t: TomlTable, settings: padfile.SensorFile) -> float:
    if settings.noise is None or settings.noise[1] != "m":
        raise t.refused("pad", "the noise of the markers is not known in m", "no camera",
                        '[markers] noise = "5 um" in the pad file')  # fmt: skip
    return settings.noise[0]


def _eye(settings: padfile.SensorFile, declared: PressDeclaration, dots: Array) -> Eye:
    """The eye of a camera that sees the unloaded pad, as the middle of what is declared of images."""
    view, image = settings.view, declared.image
    assert view is not None
    middle = {name: float(np.mean(getattr(image, name))) for name in
              ("radius", "blur", "noise", "background", "dot", "shading")}  # fmt: skip
    places = view.to_pixels(dots)
    beside = view.to_pixels(dots + np.array([middle["radius"], 0.0]))
    radius = float(np.median(np.hypot(*(beside - places).T)))
    told = {"radius": radius, "pitch": _apart(places), **settings.tracking}
    more = {"gate": told.pop("gate")} if "gate" in told else {}
    detector, size = Detector(**told), settings.body.get("size")
    if settings.noise is not None and settings.noise[1] == "px":
        return Eye(view, places, noise=settings.noise[0], size=size, detector=detector, **more)
    rest, scene = np.column_stack([dots, np.zeros(len(dots))]), Scene(image.size, **middle)
    quiet = [scene.photograph(view, rest, seed=k) for k in range(QUIET)]
    return Eye(view, places, unloaded=quiet, size=size, detector=detector, **more)


def _apart(places: Array) -> float:
    """Median distance of neighbouring dots (px)."""
    from scipy.spatial import cKDTree

    return float(np.median(cKDTree(places).query(places, k=2)[0][:, 1]))
