"""Sensors parted into those that loads are identified from and those that they are validated on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._channels import Channel
from structures._model import Model
from structures._models.mapped import StandingOn
from structures._models.statespace import StateSpace
from structures.errors import InputError, digest

from ._synthesis import rows_of


@dataclass(frozen=True, eq=False)
class Split:
    """One model as two: the same loads, and on each side its own sensors.

    Parameters
    ----------
    training, validation : Model
        Models of the two sets; their labels choose the columns of a record, ``record.select(split.labels[0])``.
    rows : tuple of array
        Rows of the training and of the validation sensors in the model that was parted.
    """

    training: Model
    validation: Model
    rows: tuple[NDArray[np.intp], NDArray[np.intp]]

    @property
    def labels(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of the training and of the validation sensors."""
        one, two = self.training.sensors, self.validation.sensors
        return tuple(s.label for s in one), tuple(s.label for s in two)

    def columns(self, values: ArrayLike) -> tuple[NDArray[Any], NDArray[Any]]:
        """Columns (..., sensors) of the training and of the validation sensors.

        Raises
        ------
        InputError
            Another number of sensors.
        """
        table, count = np.asarray(values), sum(map(len, self.rows))
        if table.ndim == 0 or table.shape[-1] != count:
            raise InputError(
                "the columns are not those of the model", where="split", found=f"shape {table.shape}",
                expected=f"(..., {count})", hint="one column per sensor, in the order of model.sensors",
            )  # fmt: skip
        return table[..., self.rows[0]], table[..., self.rows[1]]


def split(model: Model, validation: Sequence[str | int]) -> Split:
    """Part the sensors of a model: `validation` are kept out of the identification.

    Parameters
    ----------
    model : Model
    validation : sequence of str or int
        Labels or indices.

    Raises
    ------
    InputError
        A sensor that is not there or named twice, or none left on one side.
    """
    held = rows_of(model, validation)
    kept = [i for i in range(len(model.sensors)) if i not in held]
    if len(set(held)) < len(held) or not kept:
        raise InputError(
            "the sensors cannot be parted so", where="split", found=f"validation={list(validation)}",
            expected="each sensor once, and some left to identify from",
            hint="keep two or three sensors for the validation, of the kind and place that matter",
        )  # fmt: skip
    rows = np.array(kept, np.intp), np.array(held, np.intp)
    return Split(subset(model, rows[0]), subset(model, rows[1]), rows)


def subset(model: Model, rows: NDArray[np.intp]) -> Model:
    """The same model with some of its sensors, in the order given; a model from measurement stays one."""
    return model.with_sensors(rows) if model.gives("with_sensors") else SensorSubset(model, rows)


class SensorSubset(StandingOn):
    """Some sensors of another model, which answers for them.

    Parameters
    ----------
    model : Model
    rows : array of int
        Which of its sensors, in this order.
    """

    def __init__(self, model: Model, rows: NDArray[np.intp]) -> None:
        self.model, self.rows = model, np.asarray(rows, np.intp)
        self.sensors: tuple[Channel, ...] = tuple(model.sensors[i] for i in self.rows)
        self.loads, self.flags = model.loads, model.flags
        self.dt, self.frequencies = model.dt, model.frequencies

    def static(self) -> NDArray[np.float64]:
        """As the model, some rows."""
        return self.model.static()[self.rows]

    def frf(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """As the model, some rows."""
        return self.model.frf(frequencies)[:, self.rows]

    def frf_variance(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """As the model, some rows; None where it knows none."""
        found = self.model.frf_variance(frequencies)
        return None if found is None else np.asarray(found, float)[:, self.rows]

    def noise_spectrum(self, frequencies: ArrayLike) -> NDArray[np.float64] | None:
        """As the model, some columns; None where it knows none."""
        found = self.model.noise_spectrum(frequencies)
        return None if found is None else found[:, self.rows]

    def impulse_response(self, dt: float, samples: int, hold: str = "foh") -> NDArray[np.float64]:
        """As the model, some rows."""
        return self.model.impulse_response(dt, samples, hold)[:, self.rows]

    def predict(self, load: ArrayLike, dt: float, hold: str | None = None) -> NDArray[np.float64]:
        """As the model, some columns."""
        return self.model.predict(load, dt, hold)[:, self.rows]

    def state_space(self, dt: float, hold: str = "foh") -> Any:
        """As the model, with some rows of C and D."""
        s = self.model.state_space(dt, hold)
        D = s.D[..., self.rows, :]
        return StateSpace(s.A, s.B, s.C[self.rows], D, s.dt, s.hold, sensors=self.sensors, loads=self.loads)

    def perturbed(self, parameter: str, factor: float) -> SensorSubset:
        """The perturbed model, the same rows."""
        return SensorSubset(self.model.perturbed(parameter, factor), self.rows)

    @property
    def fingerprint(self) -> str:
        """Digest of the model's own and of the rows."""
        return digest("SensorSubset", self.model.fingerprint, self.rows)
