"""Learned maps as files: HDF5 with checksums, the map, its model and what they were made from. None of it is code."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from structures._channels import CHANNEL, Channel
from structures._model import Model
from structures._models.arrays import MatrixModel
from structures.errors import InputError
from structures.files import _modelfile as modelfile
from structures.files import _storage as storage

from .adaptation import Adaptation
from .calibration import Factors
from .engine import engine
from .novelty import Novelty
from .outputs import Outputs
from .training import require_channels

KIND = "learned map"
VERSION = 5


class KeptResponse(MatrixModel):
    """The static response of a model that is kept in no file itself, known by what that one was.

    Parameters
    ----------
    tree : mapping
        Of the file of a map.
    """

    def __init__(self, tree: Mapping[str, Any]) -> None:
        sensors, loads = (_channels(tree[name]) for name in ("sensors", "loads"))
        super().__init__(tree["static"], sensors=sensors, loads=loads)
        self._of = str(tree["fingerprint"])

    @property
    def fingerprint(self) -> str:
        """That of the model."""
        return self._of

    @property
    def described(self) -> str:
        """That of the model."""
        return self._of


def save(fitted: Any, path: Any) -> None:
    """Write a `FittedMap`, whole or not at all.

    Raises
    ------
    InputError
        No place to write to.
    """
    model = fitted.model
    kept = _bytes(model)
    tree = {
        "version": VERSION, "engine": fitted.engine.name, "map": dict(fitted.engine.arrays()),
        "outputs": vars(fitted.outputs), "factors": vars(fitted.factors), "novelty": fitted.novelty.arrays(),
        "scale": fitted.scale, "dt": fitted.dt, "facts": dict(fitted.facts), "adaptation": vars(fitted.adaptation),
        "along": fitted.along, "sums": fitted.sums,
        "sensors": _table(model.sensors), "loads": _table(model.loads),
        "fingerprint": model.fingerprint, "model": kept,
        "static": model.static() if kept is None and fitted.dt is None else None,
    }  # fmt: skip
    storage.write(path, tree, KIND)


def load(path: Any, model: Model | None, *, alone: bool = False) -> dict[str, Any]:
    """What a `FittedMap` is made of, physics aside; `alone`, where it need not answer what is strange.

    Raises
    ------
    InputError
        A file that is missing, damaged, of another kind or version; a model of other channels, or another one.
    """
    tree = storage.read(path, KIND)
    if tree.get("version") != VERSION:
        raise InputError("a learned map of another version", where=str(path), found=tree.get("version"),
                         expected=VERSION, hint="read it with the release that wrote it")  # fmt: skip
    if model is not None:
        for what, own in (("sensor", model.sensors), ("load", model.loads)):
            require_channels(_channels(tree[f"{what}s"]), own, what, str(path))
    if model is None:
        bare = alone and tree["model"] is None and tree["static"] is not None
        model = KeptResponse(tree) if bare else _model(tree["model"], str(path))
    if model.fingerprint != tree["fingerprint"]:
        raise InputError("the map was learned for another model", where=str(path), found=model.fingerprint[:12],
                         expected=tree["fingerprint"][:12], hint="learn a map for this model")  # fmt: skip
    outputs = {**tree["outputs"], **{k: tuple(tree["outputs"][k]) for k in ("labels", "units", "sum_labels")}}
    return {
        "model": model, "engine": engine(tree["engine"]).from_arrays(tree["map"]), "outputs": Outputs(**outputs),
        "factors": Factors(**tree["factors"]), "novelty": Novelty.from_arrays(tree["novelty"]), "scale": tree["scale"],
        "dt": tree["dt"], "facts": _plain(tree["facts"]), "adaptation": Adaptation.from_arrays(tree["adaptation"]),
        "along": tree["along"], "sums": float(tree["sums"]),
    }  # fmt: skip


def _table(channels: Sequence[Channel]) -> dict[str, Any]:
    """Channels column by column, None of what none has: a file of some thousand of them is read in a moment."""
    columns = {name: [getattr(one, name) for one in channels] for name in CHANNEL}
    return {name: None if all(value is None for value in column) else column for name, column in columns.items()}


def _channels(table: Mapping[str, Any]) -> list[Channel]:
    """Inverse of `_table`."""
    count = len(table["label"])
    columns = [[None] * count if table[name] is None else table[name] for name in CHANNEL]
    return [Channel(**dict(zip(CHANNEL, values, strict=True))) for values in zip(*columns, strict=True)]


def _plain(tree: Mapping[str, Any]) -> dict[str, Any]:
    return dict(tree)


def _bytes(model: Model) -> Any:
    """A model as the bytes of its file; None of one that is kept in none."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "model.h5"
        try:
            model.save(place)
        except InputError:
            return None
        return np.frombuffer(place.read_bytes(), np.uint8).astype(np.int64)


def _model(data: Any, where: str) -> Model:
    if data is None:
        raise InputError("the model of this map is not kept in a file", where=where, expected="model=",
                         hint="build the model, and give it: load_map(path, model=...)")  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "model.h5"
        place.write_bytes(np.asarray(data).astype(np.uint8).tobytes())
        return modelfile.load_model(place)
