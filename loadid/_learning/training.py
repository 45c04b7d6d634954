"""What a map learns from: whitened readings and the outputs that belong to them, part by part of a training set."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from structures._channels import Channel
from structures._model import Model
from structures.errors import InputError

Array = NDArray[np.float64]

NOISELESS = 1e-3  # of the readings: taken for the noise where none was added
BATCH = 256  # examples that are read at once


class ExampleBatch(Protocol):
    """Some examples in memory, as a training set gives them; 0 where a reading is missing."""

    @property
    def data(self) -> Array: ...
    @property
    def missing(self) -> NDArray[np.bool_] | None: ...
    @property
    def loads(self) -> Array: ...
    @property
    def noise(self) -> Array: ...
    @property
    def parameters(self) -> Mapping[str, Array]: ...


class Training(Protocol):
    """What is asked of a training set (`loadid.generate.TrainingSet`)."""

    @property
    def sensors(self) -> Sequence[Channel]: ...
    @property
    def loads(self) -> Sequence[Channel]: ...
    @property
    def dt(self) -> float | None: ...
    @property
    def samples(self) -> int | None: ...
    @property
    def fingerprint(self) -> str: ...
    @property
    def model(self) -> str: ...
    @property
    def places(self) -> Array | None: ...
    def __len__(self) -> int: ...
    def batches(self, size: int) -> Iterator[Any]:
        """Examples, at most `size` at once, in the order of their draws."""

    def split(self, fractions: Sequence[float], seed: int) -> tuple[Any, ...]:
        """Parts of the set, by draw."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """A training set as an engine sees it: whitened readings in, outputs in SI out.

    Parameters
    ----------
    fitting, choosing, calibrating : Training
        Parts by draw: for the parameters, for what is chosen beside them (length, ridge, when to stop), and for the
        std and the thresholds. An engine reads the first two alone.
    scale : array (sensors,)
        Std of each sensor's noise, by which readings are divided.
    resultant : array (outputs, loads) or None
        Outputs of loads; None where they are the loads.
    dt : float or None
        Step in s of histories; None of static readings.
    unseen : tuple of str
        Drawn parameters that no reading tells.
    """

    fitting: Training
    choosing: Training
    calibrating: Training
    scale: Array
    resultant: Array | None = None
    dt: float | None = None
    unseen: tuple[str, ...] = ()

    @property
    def outputs(self) -> int:
        """How many."""
        return len(self.fitting.loads) if self.resultant is None else len(self.resultant)

    def batches(self, part: Training, size: int = BATCH) -> Iterator[tuple[Array, Array]]:
        """Whitened data (n, [samples,] sensors) and outputs (n, [samples,] outputs), batch by batch."""
        for batch in part.batches(size):
            yield np.asarray(batch.data, float) / self.scale, self.of(np.asarray(batch.loads, float))

    def of(self, loads: Array) -> Array:
        """Outputs of loads (..., loads)."""
        return loads if self.resultant is None else loads @ self.resultant.T


def drawn(part: Training, names: Sequence[str]) -> list[Array]:
    """Values (draws,) of those of some parameters that vary in a part of a training set."""
    seen = [batch.parameters for batch in part.batches(BATCH)]
    kept = [name for name in names if all(name in one for one in seen)]
    values = [np.concatenate([np.asarray(one[name], float) for one in seen]) for name in kept]
    return [x for x in values if np.ptp(x) > 0]


def parameter_names(training: Training) -> tuple[str, ...]:
    """Names of what was drawn beside the loads."""
    return tuple(next(iter(training.batches(1))).parameters)


def require_drawn(training: Training, names: Sequence[str]) -> None:
    """Nothing, if parameters of these names were drawn.

    Raises
    ------
    InputError
    """
    known = parameter_names(training)
    given = [names] if isinstance(names, str) else list(names)
    unknown = [str(name) for name in given if name not in known]
    if unknown or isinstance(names, str):
        raise InputError(
            "no parameters of the draws", where="unseen", found=", ".join(unknown) or repr(names),
            expected=f"names among {', '.join(known) or 'none: nothing was drawn beside the loads'}",
            hint="unseen=[...], or leave it out",
        )  # fmt: skip


def require_fit(training: Training, model: Model) -> None:
    """Nothing, if a training set has the sensors and the loads of a model, in their units and order.

    Raises
    ------
    InputError
        It has others.
    """
    require_channels(training.sensors, model.sensors, "sensor", "training")
    require_channels(training.loads, model.loads, "load", "training")


def require_model(training: Training, model: Model) -> None:
    """Nothing, if a training set was drawn for a model, as far as it says.

    Raises
    ------
    InputError
        It was drawn for another one of the same sensors and loads.
    """
    if training.model and training.model not in (model.fingerprint, model.described):
        raise InputError("the training set was drawn for another model", where="training", found=training.model[:12],
                         expected=model.fingerprint[:12], hint="generate and learn for this model")  # fmt: skip


def require_channels(found: Sequence[Channel], own: Sequence[Channel], what: str, where: str) -> None:
    """Nothing, if channels are those of a model, in their units and order.

    Raises
    ------
    InputError
        They are others.
    """
    hint = "generate and learn for this model"
    if len(found) != len(own):
        raise InputError(f"another number of {what}s than the model has", where=where, found=len(found),
                         expected=len(own), hint=hint)  # fmt: skip
    for a, b in zip(found, own, strict=True):
        if (a.label, a.unit) != (b.label, b.unit):
            raise InputError(f"another {what} than the model has", where=where, found=f"{a.label} in {a.unit}",
                             expected=f"{b.label} in {b.unit}", hint=hint)  # fmt: skip


def has_gaps(training: Training) -> bool:
    """Whether readings are missing among the first examples."""
    missing = next(iter(training.batches(BATCH))).missing
    return missing is not None and bool(np.any(missing))


def scale_of(training: Training, model: Model) -> Array:
    """Std of the noise of each sensor (sensors,): of the examples, else of the model, else a small share of the data.

    Raises
    ------
    InputError
        Readings or loads that are no numbers, or a sensor that reads nothing.
    """
    batch = next(iter(training.batches(BATCH)))
    data, loads = np.asarray(batch.data, float), np.asarray(batch.loads, float)
    if not (np.all(np.isfinite(data)) and np.all(np.isfinite(loads))):
        raise InputError("NaN or infinity in the training set", where="training", expected="numbers",
                         hint="mark what is missing, or leave these draws out")  # fmt: skip
    size = np.sqrt(np.mean(data.reshape(-1, data.shape[-1]) ** 2, axis=0))
    if not np.all(size > 0):
        dead = [c.label for c, s in zip(training.sensors, size, strict=True) if not s > 0]
        raise InputError("a sensor reads nothing in the training set", where="training", found=", ".join(dead),
                         expected="readings of every sensor")  # fmt: skip
    noise = np.asarray(batch.noise, float)
    noise = np.sqrt(np.mean(np.atleast_2d(noise) ** 2, axis=0)) if noise.size else np.zeros(len(size))
    if np.all(noise > 0):
        return np.asarray(np.broadcast_to(noise, size.shape).copy())
    known = model.noise
    if known is not None and np.ndim(known) == 1 and np.all(known > 0):
        return np.asarray(known, float)
    return np.asarray(NOISELESS * size)
