"""Sensors to identify from and sensors to validate on; loads held against the latter, or against another assembly."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._channels import Channel
from structures._flags import Flag
from structures._model import Model
from structures._models.mapped import StandingOn
from structures._models.statespace import StateSpace
from structures.errors import InputError, digest, digests, plain

from .. import _guards as guards
from .._record import Record
from .._results.estimate import Axis, LoadEstimate
from ..validate._checks import SensorCheck, Validation
from ..validate._validation import RECORD, held_out
from . import _comparison as comparison
from ._comparison import ResponseComparison
from ._synthesis import DENSITIES, HISTORIES, SPECTRA, SynthesisedResponse, kind_of, reliable, rows_of, synthesise

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Real = NDArray[np.float64]
POINTS = 8  # samples of a history at which its band is found
ON_A_LINE = 1e-6  # of the spacing


@dataclass(frozen=True, eq=False)
class Transfer:
    """Prediction of responses that took no part in the identification.

    Parameters
    ----------
    comparison : ResponseComparison
        Measured and predicted responses; its std is that of their difference: loads, FRFs of the model, noise, and of
        measured densities what their number of averages leaves open.
    level : float
        Probability of the band.
    flags : tuple of Flag
        W704 where a channel or a record took part in the identification after all.
    left_out : int
        Lines of the estimate at which nothing was measured, or whose prediction is not trusted.
    noise : array, shape (sensors,) or (lines, sensors), or None
        Noise std of the measurement, where it is stated.
    source : str
        What it was validated on.
    """

    comparison: ResponseComparison
    level: float
    flags: tuple[Flag, ...]
    left_out: int
    noise: Real | None
    source: str

    @cached_property
    def inside(self) -> tuple[float, ...] | None:
        """Share of the lines (or of the points of a history) at which the band holds the measured value, per sensor.

        None where no std is known. A complex amplitude lies in a disc: its error is taken as circular and normal.
        """
        c = self.comparison
        if c.std is None or not len(c.points):
            return None
        off = np.abs(c.synthesised - c.measured)[c.points]
        factor = np.sqrt(-np.log1p(-self.level)) if c.kind == SPECTRA else NormalDist().inv_cdf(0.5 + self.level / 2)
        return tuple(np.mean(off <= factor * c.std, axis=0).tolist())

    @property
    def validation(self) -> Validation:
        """The check in the form that ``estimate.validated(...)`` keeps, at the level of held-out sensors."""
        c = self.comparison
        ratio = None
        if self.noise is not None and c.kind != DENSITIES:
            off = np.abs(c.synthesised - c.measured) / self.noise
            ratio = tuple(np.sqrt(np.mean(off**2, axis=0)).tolist())
        check = SensorCheck(c.sensors, c.error, ratio, self.source)
        return Validation((check,), self.flags, datetime.now(UTC).isoformat(timespec="seconds"))

    def table(self, fraction: int = 1) -> str:
        """One line per sensor: overall error in dB, correlation, errors by band; then what the bands hold."""
        lines = [self.comparison.table(fraction)]
        if self.inside is not None:
            held = ", ".join(f"{n} {x:.0%}" for n, x in zip(self.comparison.sensors, self.inside, strict=True))
            bare = (
                "" if self.noise is not None or self.comparison.kind == DENSITIES else ", without noise of the sensors"
            )
            lines.append(f"the {self.level:.0%} band of the prediction{bare} holds the measured response: {held}")
        if self.left_out:
            lines.append(f"{self.left_out} lines of the estimate left out")
        return "\n".join([*lines, *(str(f) for f in self.flags)])

    def __str__(self) -> str:
        return f"prediction on {self.source}\n{self.table()}"

    def plot(
        self,
        kind: str = "bands",
        *,
        sensor: int | str | None = None,
        fraction: int = 3,
        path: str | os.PathLike[str] | None = None,
        show: bool = False,
    ) -> Figure:
        """Picture of measured against predicted responses with the band, as `ResponseComparison.plot`."""
        from .._plots.sources import draw_comparison

        return draw_comparison(
            self.comparison, kind, sensor=sensor, fraction=fraction, level=self.level, path=path, show=show
        )


def validate_on(
    estimate: LoadEstimate,
    model: Model,
    measured: Any,
    *,
    noise: ArrayLike | None = None,
    trust: float | None = None,
    covariance: ArrayLike | None = None,
    level: float = 0.95,
    source: str = "held-out sensors",
) -> Transfer:
    """Predict responses from identified loads through another model, and compare them with what was measured there.

    Parameters
    ----------
    estimate : LoadEstimate
        Loads identified on one set of sensors, on one structure: complex or cross spectra, or histories.
    model : Model
        From the same loads to the validation sensors: of the same structure, or of another assembly that the same
        source drives. Loads carry over to another assembly where they are blocked forces of the source, identified at
        its interface; contact forces do not.
    measured : spectra, cross spectra, Record or array
        Object with ``frequencies`` and ``values`` (lines, sensors) or ``matrix`` (lines, sensors, sensors), and
        ``channels``; a Record over time; or a bare array in the order of ``model.sensors``, on the axis of the
        estimate (densities: (lines, sensors)).
    noise : float or array (sensors,) or (lines, sensors), optional
        Noise std of the measured values; default what the measurement or the channels of the model state.
    trust : float, optional
        Only lines on which the std of the prediction lies below this share of it, over all sensors together.
    covariance : array, optional
        As in `synthesise`.
    level : float
        Probability of the band.
    source : str
        Name of the comparison, as it is printed.

    Raises
    ------
    InputError
        No line in common, channels or units that do not fit, NaN, or as `synthesise`.

    Notes
    -----
    In-situ blocked forces: A. T. Moorhouse, A. S. Elliott, T. A. Evans, "In situ measurement of the blocked force of
    structure-borne sound sources", J. Sound Vib. 325 (2009) 679-685; on-board and transferability validation as in ISO
    20270:2019.
    """
    if isinstance(level, bool) or not isinstance(level, int | float) or not 0 < level < 1:
        raise InputError(
            "no probability", where="level", found=repr(level), expected="between 0 and 1", hint="level=0.95"
        )
    if kind_of(estimate) == HISTORIES:
        return _over_time(estimate, model, measured, noise, level, source)
    response = synthesise(model, estimate, covariance=covariance)
    values, lines, own = _over_frequency(measured, model, response)
    keep = np.ones(len(lines), bool) if trust is None else _reliable(response, trust)[lines]
    known = _noise(noise if noise is not None else own, model, response.kind, len(lines))
    known = known[keep] if known is not None and known.ndim == 2 else known
    values, lines = values[keep], lines[keep]
    std = None if response.std is None else response.std[lines]
    if known is not None and response.kind == SPECTRA:
        std = known * np.ones(values.shape) if std is None else np.hypot(std, known)
    averages = getattr(measured, "averages", None)
    if std is not None and response.kind == DENSITIES and averages is not None:
        std = np.hypot(std, values / np.sqrt(averages))  # what so many averages leave open
    axis = Axis("frequency", "Hz", response.axis.values[lines])
    names, units = [c.label for c in model.sensors], [c.unit for c in model.sensors]
    made = comparison.checked(
        axis, values, response.values[lines], response.kind, names, units, estimate, std, np.arange(len(lines))
    )
    left = len(response.axis.values) - len(lines)
    return Transfer(made, level, _shared(estimate, names, values), left, known, source)


def _over_time(
    estimate: LoadEstimate, model: Model, record: Any, noise: ArrayLike | None, level: float, source: str
) -> Transfer:
    found = held_out(estimate, model, record)
    response = synthesise(model, estimate, points=POINTS)
    known = _noise(noise, model, HISTORIES, 0)
    points = response.points[response.points < len(found.measured)]
    std = None if response.std is None else response.std[: len(points)]
    if known is not None and std is not None:
        std = np.hypot(std, known)
    assert estimate.axis is not None
    axis = Axis("time", "s", estimate.axis.values[: len(found.measured)])
    made = comparison.checked(
        axis, found.measured, found.predicted, HISTORIES, found.labels, [c.unit for c in model.sensors], estimate, std,
        points,
    )  # fmt: skip
    return Transfer(made, level, found.flags, 0, known, source)


def _over_frequency(
    measured: Any, model: Model, response: SynthesisedResponse
) -> tuple[NDArray[Any], NDArray[np.intp], Any]:
    """Measured values (lines, sensors), the lines of the estimate that they belong to, and the stated noise."""
    density, f = response.kind == DENSITIES, np.asarray(response.axis.values, float)
    if isinstance(measured, Record):
        raise InputError(
            "spectra are compared with spectra", where="validate_on", found="a record over time",
            expected="spectra or cross spectra on the lines of the estimate",
            hint="structures.cross_spectra(record) for densities",
        )  # fmt: skip
    if not hasattr(measured, "frequencies"):
        return _table(measured, (len(f), len(model.sensors)), density), np.arange(len(f)), None
    matrix = getattr(measured, "matrix", None)
    if density != (matrix is not None):
        raise InputError(
            "amplitudes and densities cannot be compared", where="validate_on",
            found="cross spectra" if matrix is not None else "complex amplitudes",
            expected="cross spectra" if density else "complex amplitudes", hint="what the loads were identified from",
        )  # fmt: skip
    table = measured.values if matrix is None else np.einsum("lii->li", np.asarray(matrix)).real
    channels = tuple(getattr(measured, "channels", None) or ())
    columns = _columns(channels, model, np.asarray(table).shape[-1])
    rows, lines = common(np.asarray(measured.frequencies, float), f)
    values = _table(np.asarray(table)[rows][:, columns], (len(rows), len(columns)), density)
    own = getattr(measured, "noise", None)
    if own is not None:
        own = np.asarray(own, float)
        own = own[rows][:, columns] if own.ndim == 2 else own[columns] if own.size > 1 else own
    return values, lines, own


def common(measured: Real, wanted: Real) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Lines that two ascending axes share: indices into the first and into the second.

    Raises
    ------
    InputError
        None.
    """
    at = np.clip(np.searchsorted(measured, wanted), 1, max(len(measured) - 1, 1))
    at = at - (np.abs(wanted - measured[at - 1]) <= np.abs(measured[np.minimum(at, len(measured) - 1)] - wanted))
    at = np.clip(at, 0, len(measured) - 1)
    step = np.min(np.diff(wanted)) if len(wanted) > 1 else max(float(np.abs(wanted).max()), 1.0)
    same = np.abs(measured[at] - wanted) <= ON_A_LINE * step
    if not same.any():
        raise InputError(
            "no line in common", where="validate_on",
            found=f"{len(measured)} lines, {measured[0]:.6g} to {measured[-1]:.6g} Hz",
            expected=f"lines of the estimate: {wanted[0]:.6g} to {wanted[-1]:.6g} Hz",
            hint="take the spectra with the same record length",
        )  # fmt: skip
    return at[same], np.flatnonzero(same)


def _columns(channels: Sequence[Any], model: Model, count: int) -> list[int]:
    labels, want = [getattr(c, "label", str(c)) for c in channels], [s.label for s in model.sensors]
    if not channels and count == len(want):
        return list(range(count))
    missing = [w for w in want if w not in labels]
    if missing:
        raise InputError(
            "a sensor of the model was not measured", where="validate_on", found=labels[:12], expected=want[:12],
            hint="name the channels as the sensors of the model",
        )  # fmt: skip
    columns = [labels.index(w) for w in want]
    for sensor, i in zip(model.sensors, columns, strict=True):
        unit = getattr(channels[i], "unit", "arbitrary")
        if "arbitrary" not in (unit, sensor.unit) and unit != sensor.unit:
            raise InputError(
                "the unit of a channel does not fit the sensor of the model", where=f"channel {sensor.label}",
                found=unit, expected=sensor.unit, hint="state the unit in which the channel was recorded",
            )  # fmt: skip
    return columns


def _table(values: Any, shape: tuple[int, int], density: bool) -> NDArray[Any]:
    table = np.asarray(plain(values))
    if table.dtype.kind not in "iufc" or table.shape != shape or not np.all(np.isfinite(table)):
        raise InputError(
            "the measured responses do not fit the estimate and the model", where="validate_on",
            found=f"{table.dtype} of shape {table.shape}", expected=f"finite numbers of shape {shape}",
            hint="lines of the estimate first, then the sensors of the model",
        )  # fmt: skip
    if density and table.dtype.kind == "c":
        raise InputError(
            "densities are real", where="validate_on", found="complex numbers",
            expected="autospectra (lines, sensors), or cross spectra with their lines",
            hint="take the diagonal of the cross spectra",
        )  # fmt: skip
    return table.astype(float if density else complex)


def _noise(given: Any, model: Model, kind: str, lines: int) -> Real | None:
    """Noise std per sensor, or per line and sensor; of densities none: it is part of them."""
    if kind == DENSITIES:
        return None
    if given is None:  # the noise of a channel is that of its samples, and no spectrum's
        stated = model.noise if kind == HISTORIES else None
        return None if stated is None else stated if stated.ndim == 1 else np.sqrt(np.diagonal(stated))
    array, count = np.asarray(plain(given), float), len(model.sensors)
    fits = array.shape in ((), (1,), (count,), (lines, count))
    if not fits or not np.all(np.isfinite(array)) or np.any(array <= 0):
        raise InputError(
            "no noise std per sensor", where="noise", found=f"shape {array.shape}",
            expected=f"one positive number, or {count}", hint="in the units of the measured values",
        )  # fmt: skip
    return array if array.ndim == 2 else np.broadcast_to(array, (count,))


def _reliable(response: SynthesisedResponse, trust: float) -> NDArray[np.bool_]:
    """Lines whose prediction is trusted; every sensor counts by its own rms."""
    assert response.std is not None
    size = np.sqrt(np.mean(np.abs(response.values) ** 2, axis=0))
    scale = np.where(size > 0, size, 1.0)
    return reliable(response.values / scale, response.std / scale, trust)


def _shared(estimate: LoadEstimate, names: Sequence[str], values: NDArray[Any]) -> tuple[Flag, ...]:
    """W704: a channel, or the very numbers, took part in the identification."""
    flag = guards.used_for_training("a validation channel", set(names) & set(estimate.sensors))
    if flag is None and estimate.response is not None and len(values) >= RECORD:
        flag = guards.used_for_training("the validation record", _digests(values) & _digests(estimate.response))
    return guards.collect([flag])


def _digests(columns: NDArray[Any]) -> set[str]:
    wide = np.asarray(columns, complex)
    return set(digests(np.concatenate([wide.real, wide.imag])))


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
        gains = model.gain_covariance
        self.gain_covariance = None if gains is None else gains[np.ix_(self.rows, self.rows)]

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
