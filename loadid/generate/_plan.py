"""A training set by one job file: a model or a sensor, what is drawn, how many, and where it goes.

Sensors of other packages are drawn by what they register under the entry point `GROUP`, by the table that names them:
``[sensor]`` by a gel pad.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError

from .. import _toml
from ._trainingset import TrainingSet
from ._work import DrawMaker, generate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GROUP = "loadid.generators"
KEYS = ("model", "truth", "sensor", "set", "draws", "seed", "workers", "declaration", "map", "page")


def generate_from(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    draws: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> TrainingSet:
    """Make the training set of a job, or what is missing of it, and its page ``set.html``.

    Parameters
    ----------
    path : path
        TOML: ``model`` and ``truth`` (files) or a table ``[sensor]``; ``declaration`` (a file or a table); ``set``, the
        folder; ``draws``; ``seed``. Paths count from its folder.
    out : path, optional
        Folder of the set, instead of ``set``.
    draws, seed, workers : int, optional
        Instead of those of the job.
    scheduler : str, optional
        Address of a dask scheduler.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Raises
    ------
    InputError
        A job, model, sensor or declaration that is none; a folder that holds another set.
    """
    from ._overview import overview

    job, file = _toml.read(path, "job"), Path(path).resolve()
    said = _toml.PlanReader(str(path), {"plan": KEYS})
    said.known(job, "plan", str(path))
    if ("model" in job) == ("sensor" in job):
        raise InputError("a job names a model or a sensor", where=str(path),
                         found="both" if "model" in job else "neither",
                         expected='model = "model.h5", or a table [sensor]')  # fmt: skip
    for name in ("draws", "seed", "workers"):
        if name in job and (isinstance(job[name], bool) or not isinstance(job[name], int) or job[name] < 0):
            said.refused(name, job[name], "a whole number")
    many = draws if draws is not None else job.get("draws")
    if many is None:
        said.refused("draws", None, "how many")
    place = Path(out) if out is not None else file.parent / said.text(job, "set", str(path))
    number = seed if seed is not None else int(job.get("seed", 0))
    maker, pictures = of_sensor(job, said, file)[:2] if "sensor" in job else _of_model(job, said, file)
    found = generate(
        maker, place, draws=many, seed=number, workers=workers or job.get("workers"), scheduler=scheduler,
        progress=progress,
    )  # fmt: skip
    overview(found, place / "set.html", pictures(number, many))
    return found


Pictures = Callable[[int, int], "list[Figure]"]


def _of_model(job: Mapping[str, Any], said: _toml.PlanReader, file: Path) -> tuple[DrawMaker, Pictures]:
    from structures.files._modelfile import load_model

    from ._histories import HistoryDeclaration, HistoryMaker

    given = job.get("declaration")
    if isinstance(given, Mapping):
        declared = HistoryDeclaration.of_tables(f"{said.where}, [declaration]", given)
    else:
        declared = HistoryDeclaration.read(said.file(job, "declaration", said.where, file.parent))
    names = job.get("truth", [])
    names = [names] if isinstance(names, str) else names
    if not isinstance(names, list):
        said.refused("truth", names, "a file, or a list of files")
    others = [load_model(said.file({"truth": one}, "truth", said.where, file.parent)) for one in names]
    model = load_model(said.file(job, "model", said.where, file.parent))
    return HistoryMaker(model, declared, others), lambda seed, draws: []


def of_sensor(
    job: Mapping[str, Any], said: _toml.PlanReader, file: Path
) -> tuple[DrawMaker, Pictures, Callable[..., Any]]:
    """What draws for the sensor of a job, its pictures, and what learns its map: of a training set and settings.

    Raises
    ------
    InputError
        No package here knows such sensors; from that package.
    """
    found = {one.name: one for one in entry_points(group=GROUP)}
    if "sensor" not in found:
        raise InputError("nothing here draws for sensors", where=said.where, found="no generator of sensors",
                         expected=f"a package with the entry point {GROUP}",
                         hint="install loadid again: pip install --force-reinstall loadid")  # fmt: skip
    made: tuple[DrawMaker, Pictures, Callable[..., Any]] = found["sensor"].load()(job, file)
    return made
