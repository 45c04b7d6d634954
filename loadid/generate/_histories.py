"""Load histories through a forward model that is not the one of the inverse, and what its sensors read."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._channels import Channel
from structures._model import Model, as_model, convolved, impulse_of
from structures.errors import InputError, integer, one_of, positive, shown

from .. import _toml
from ._loads import LoadRange
from ._ranges import Range, Ranges, halton, within
from ._trainingset import TrainingSet
from ._work import Drawn, generate

Array = NDArray[np.float64]
MODELS = 16  # sets of parameters that are drawn from, evenly over their ranges


@dataclass(frozen=True)
class ModelRange(Ranges):
    """What the model may be wrong by.

    Parameters
    ----------
    stiffness, mass, damping : range
        Of the structure, over those of the model.
    gain : range
        Of each sensor.
    """

    stiffness: Range = field(default=(1.0, 1.0), metadata=within("", 0.01, 100.0))
    mass: Range = field(default=(1.0, 1.0), metadata=within("", 0.01, 100.0))
    damping: Range = field(default=(1.0, 1.0), metadata=within("", 0.001, 1000.0))
    gain: Range = field(default=(1.0, 1.0), metadata=within("", 0.01, 100.0))

    @property
    def parameters(self) -> dict[str, Range]:
        """Ranges of the parameters of the structure."""
        return {"stiffness": self.stiffness, "mass": self.mass, "damping": self.damping}

    @property
    def exact(self) -> bool:
        """Whether nothing is wrong."""
        return all(getattr(self, one.name) == (1.0, 1.0) for one in fields(self))


@dataclass(frozen=True)
class ReadingRange(Ranges):
    """What befalls the readings.

    Parameters
    ----------
    noise : range, optional
        Std over that of each sensor, which its model states.
    relative : range, optional
        Or std over the root mean square of what each sensor reads.
    lost : range
        Share of the sensors that read nothing.
    """

    noise: Range | None = field(default=None, metadata=within("", 0.0, 1e6))
    relative: Range | None = field(default=None, metadata=within("", 0.0, 100.0))
    lost: Range = field(default=(0.0, 0.0), metadata=within("", 0.0, 0.9))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.noise is not None and self.relative is not None:
            raise InputError("two levels of noise", where="ReadingRange", found="noise and relative",
                             expected="one of them")  # fmt: skip


@dataclass(frozen=True)
class HistoryDeclaration:
    """A distribution of load histories.

    Parameters
    ----------
    load : sequence of LoadRange
        One is drawn for each load that acts.
    dt : float
        Step (s).
    samples : int
    hold : {"foh", "zoh"}, optional
        What a load does between its samples; as the model has it where not stated.
    acting : int, optional
        How many loads act at a time, drawn anew each time; all where not stated.
    model : ModelRange
    sensors : ReadingRange

    Raises
    ------
    InputError
        No loads, ranges that histories of this step and length cannot hold.
    """

    load: Sequence[LoadRange]
    dt: float
    samples: int
    hold: str | None = None
    acting: int | None = None
    model: ModelRange = ModelRange()
    sensors: ReadingRange = ReadingRange()

    def __post_init__(self) -> None:
        kinds = (self.load,) if isinstance(self.load, LoadRange) else tuple(self.load)
        object.__setattr__(self, "load", kinds)
        if not kinds or not all(isinstance(one, LoadRange) for one in kinds):
            raise InputError("no loads", where="HistoryDeclaration", found=shown(self.load),
                             expected="one LoadRange at least")  # fmt: skip
        positive("dt", self.dt, where="HistoryDeclaration", unit="s")
        if integer("samples", self.samples, where="HistoryDeclaration", limit=10**8) < 8:
            raise InputError("histories are too short", where="HistoryDeclaration", found=self.samples,
                             expected="8 samples at least")  # fmt: skip
        if self.hold is not None:
            one_of("no hold", self.hold, ("foh", "zoh"), where="HistoryDeclaration, hold")
        for one in kinds:
            one.fits(self.dt, self.samples)

    @property
    def plain(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "load": [one.plain for one in self.load], "dt": float(self.dt), "samples": int(self.samples),
            "hold": self.hold or "", "acting": self.acting or 0, "model": self.model.plain,
            "sensors": self.sensors.plain,
        }  # fmt: skip

    @classmethod
    def of(cls, given: HistoryDeclaration | Mapping[str, Any] | str | os.PathLike[str]) -> HistoryDeclaration:
        """What was given, or the declaration of a file or of its tables.

        Raises
        ------
        InputError
            As `read`.
        """
        if isinstance(given, HistoryDeclaration):
            return given
        return cls.of_tables("declaration", given) if isinstance(given, Mapping) else cls.read(given)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> HistoryDeclaration:
        """The declaration of a TOML file: ``dt``, ``samples``, ``hold``, ``acting``, ``[[load]]``, ``[model]``, ...

        Numbers are SI.

        Raises
        ------
        InputError
            No such file; a key that is none, with the nearest; a range that is not possible.
        """
        return cls.of_tables(str(path), _toml.read(path, "declaration"))

    @classmethod
    def of_tables(cls, where: str, tree: Mapping[str, Any]) -> HistoryDeclaration:
        """The declaration of the tables of a file.

        Raises
        ------
        InputError
            As `read`.
        """
        names = {kind.__name__: [one.name for one in fields(kind)] for kind in (ModelRange, ReadingRange, LoadRange)}
        said = _toml.PlanReader(where, {"plan": [one.name for one in fields(cls)], **names})
        said.known(tree, "plan", where)
        listed = tree.get("load", [])
        if not isinstance(listed, list) or not all(isinstance(one, Mapping) for one in listed):
            said.refused("load", listed, "[[load]] tables")
        given: dict[str, Any] = {k: v for k, v in tree.items() if k not in ("load", "model", "sensors")}
        for name, kind in (("model", ModelRange), ("sensors", ReadingRange)):
            if name in tree:
                given[name] = _table(said, said.table(tree, name), kind, f"[{name}]")
        given["load"] = [_table(said, one, LoadRange, f"[[load]] {k + 1}") for k, one in enumerate(listed)]
        return _made(said, cls, given, "")


def _table(said: _toml.PlanReader, table: Mapping[str, Any], kind: Any, place: str) -> Any:
    said.known(table, kind.__name__, place)
    return _made(said, kind, table, place)


def _made(said: _toml.PlanReader, kind: Any, given: Mapping[str, Any], place: str) -> Any:
    """What a table declares; a refusal names the file and the table."""
    where = ", ".join(filter(None, (said.where, place)))
    missing = [one.name for one in fields(kind) if one.default is MISSING and one.name not in given]
    if missing:
        raise InputError("a key is missing", where=where, found=", ".join(given) or "nothing",
                         expected=", ".join(missing))  # fmt: skip
    try:
        return kind(**given)
    except InputError as error:
        parts = {name: getattr(error, name) for name in ("found", "expected", "hint", "code")}
        raise InputError(error.what, where=f"{where}: {error.where}", **parts) from None


class HistoryMaker:
    """Draws load histories and what the sensors of a model read of them.

    Parameters
    ----------
    model : Model
        Of the inverse: its sensors and loads are those of the set.
    declared : HistoryDeclaration
    truth : sequence of Model
        Through which loads pass, one of them each time; empty: the model, with what is declared wrong of it.

    Raises
    ------
    InputError
        Models whose sensors and loads differ; a truth that is the model itself; a noise that nobody states.
    """

    def __init__(self, model: Model, declared: HistoryDeclaration, truth: Sequence[Model] = ()) -> None:
        as_model(model, "histories", "impulse_response", "state_space")
        self.model, self.declared, self.truth = model, declared, tuple(truth) or (model,)
        for one in self.truth:
            as_model(one, "histories, truth", "impulse_response", "state_space")
            for name in ("sensors", "loads"):
                mine, other = ([(c.label, c.unit) for c in getattr(m, name)] for m in (model, one))
                if mine != other:
                    raise InputError(f"the {name} of the truth are not those of the model", where="histories, truth",
                                     found=", ".join(c for c, _ in other)[:80],
                                     expected=", ".join(c for c, _ in mine)[:80])  # fmt: skip
        if declared.model.exact and any(one.fingerprint == model.fingerprint for one in self.truth):
            raise InputError("the truth would be the model of the inverse itself", where="histories",
                             found="one model, and nothing declared wrong of it",
                             expected="truth= a finer model, or one with more modes; or ranges of [model]")  # fmt: skip
        if declared.acting is not None:
            integer("loads that act", declared.acting, where="histories, acting", limit=len(model.loads))
        self.hold = declared.hold or model.default_hold
        self._noise = _levels(model, declared)
        self._pulses: dict[tuple[int, int], Array] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_pulses": {}}

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """Of the model."""
        return tuple(self.model.sensors)

    @property
    def loads(self) -> tuple[Channel, ...]:
        """Of the model."""
        return tuple(self.model.loads)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds that may be drawn; several loads of different kinds are mixed."""
        names = tuple(dict.fromkeys(one.kind for one in self.declared.load))
        several = (self.declared.acting or len(self.loads)) > 1 and len(names) > 1
        return (*names, "mixed") if several else names

    @property
    def dt(self) -> float:
        """Step (s)."""
        return float(self.declared.dt)

    @property
    def samples(self) -> int:
        """Length."""
        return int(self.declared.samples)

    @property
    def declaration(self) -> dict[str, Any]:
        """What was declared, as plain data."""
        return {"histories": self.declared.plain}

    @property
    def inverse(self) -> str:
        """Fingerprint of the model of the inverse."""
        return self.model.fingerprint

    @property
    def models(self) -> tuple[str, ...]:
        """Fingerprints of the model and of its truth."""
        return (self.model.fingerprint, *(one.fingerprint for one in self.truth))

    def draw(self, rng: np.random.Generator) -> Drawn:
        """One example: its loads from rest, and what is read of them."""
        d = self.declared
        which = int(rng.integers(len(self.truth))), int(rng.integers(self._variants))
        load, names = np.zeros((self.samples, len(self.loads))), set()
        weights = np.array([one.weight for one in d.load], float)
        for j in np.sort(rng.permutation(len(self.loads))[: d.acting or len(self.loads)]):
            chosen = d.load[int(rng.choice(len(weights), p=weights / weights.sum()))]
            load[:, j] = chosen.history(rng, self.dt, self.samples)
            names.add(chosen.kind)
        gain = rng.uniform(*d.model.gain, len(self.sensors))
        clean = convolved(self._pulse(*which), load) * gain
        std = self._std(clean, rng)
        data = clean + std * rng.standard_normal(clean.shape)
        lost = rng.random(len(self.sensors)) < d.sensors.draw(rng, "lost")
        data[:, lost] = np.nan
        told = {"truth": float(which[0]), **self._factors(which[1]), "lost": float(lost.sum())}
        return Drawn(data, load, names.pop() if len(names) == 1 else "mixed", std, told)

    def _std(self, clean: Array, rng: np.random.Generator) -> Array:
        sensors = self.declared.sensors
        if sensors.relative is not None:
            return np.asarray(sensors.draw(rng, "relative") * np.sqrt(np.mean(clean**2, axis=0)))
        return self._noise * (1.0 if sensors.noise is None else sensors.draw(rng, "noise"))

    @property
    def _variants(self) -> int:
        wide = any(low < high for low, high in self.declared.model.parameters.values())
        return MODELS if wide else 1

    def _factors(self, number: int) -> dict[str, float]:
        """Factors of stiffness, mass and damping, which fill their ranges evenly (Halton)."""
        found = {}
        for (name, (low, high)), base in zip(self.declared.model.parameters.items(), (2, 3, 5), strict=True):
            found[name] = float(low + (high - low) * halton(number + 1, base))
        return found

    def _pulse(self, truth: int, number: int) -> Array:
        """Impulse response of a truth with one set of parameters; kept."""
        if (truth, number) not in self._pulses:
            model = self.truth[truth]
            for name, factor in self._factors(number).items():
                model = model if factor == 1.0 else model.perturbed(name, factor)
            self._pulses[truth, number] = impulse_of(model, self.dt, self.samples, self.hold)
        return self._pulses[truth, number]


def _levels(model: Model, declared: HistoryDeclaration) -> Array:
    """Std of each sensor as the model states it; zero where noise is declared relative, or to be none."""
    sensors = declared.sensors
    if sensors.relative is not None or sensors.noise == (0.0, 0.0):
        return np.zeros(len(model.sensors))
    given = [c.noise for c in model.sensors]
    if any(v is None for v in given):
        raise InputError("the noise of the sensors is not known", where="histories, sensors",
                         found="sensors without a noise", expected="relative noise, or noise = 0",
                         hint="state noise= of each sensor, or [sensors] relative = [0.01, 0.05]")  # fmt: skip
    return np.array(given, float)


def histories(
    model: Model,
    declaration: HistoryDeclaration | Mapping[str, Any] | str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    draws: int,
    seed: int,
    truth: Model | Sequence[Model] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> TrainingSet:
    """Load histories and what sensors read of them, as a training set in a folder.

    Loads act on a structure at rest, through `truth`, or through the model with what is declared wrong of it. Called
    again, it makes what is missing.

    Parameters
    ----------
    model : Model
        That the inverse will use: its sensors and loads are those of the set.
    declaration : HistoryDeclaration, path or mapping
        What is drawn, or a TOML file, or its tables, that say so.
    folder : path
    draws, seed : int
        How many, and what they follow from: the same draw is the same history, whatever else is asked.
    truth : Model or sequence of Model, optional
        With the same sensors and loads, better than the model: a finer mesh, more modes, a sensor beside its place.
    workers : int, optional
        Processes of this machine; all its cores where nothing is said.
    scheduler : str, optional
        Address of a dask scheduler instead.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Returns
    -------
    TrainingSet

    Raises
    ------
    InputError
        Models that do not go together, a truth that is the model itself; a folder that holds another set, or a damaged
        shard.
    """
    told = HistoryDeclaration.of(declaration)
    others = () if truth is None else (truth,) if isinstance(truth, Model) else tuple(truth)
    return generate(
        HistoryMaker(model, told, others), folder, draws=draws, seed=seed, workers=workers, scheduler=scheduler,
        progress=progress,
    )  # fmt: skip
