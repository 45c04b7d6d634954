"""Validation against references of every kind, held-out channels included, and the level that it reaches.

Coverage of the stated bands: readings of known loads are simulated with fresh noise and rebuilt.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag
from structures._model import Model
from structures.errors import InputError, digests, plain

from .. import _guards as guards
from .._quality import require_finite
from .._record import Record
from .._results.estimate import LoadEstimate
from .._results.facts import STATIC
from ..constraints import Resultant
from ._checks import Check, SensorCheck, Validation
from ._pairs import against_known, against_mat, against_wrench
from ._references import Known, PressureMat, ReferenceWrench, numbers

Array = NDArray[np.float64]

RECORD = 8  # frames from which equal columns are the same record, and no coincidence


@dataclass(frozen=True)
class HeldOut:
    """Prediction of channels from an estimated load.

    Parameters
    ----------
    predicted, measured : array, shape (samples, sensors); static, (frames, sensors) or (sensors,)
    error : tuple of float
        Per channel, norm of the difference over norm of the measured. Of a single static reading, over the rms of all
        channels of its unit: one channel may well read nothing.
    labels : tuple of str
    flags : tuple of Flag
        W704 where a channel was used in the inversion, or the record in making the model.
    noise_ratio : tuple of float, optional
        Per channel, rms of the difference over the noise std, where the model states that.
    """

    predicted: Array
    measured: Array
    error: tuple[float, ...]
    labels: tuple[str, ...]
    flags: tuple[Flag, ...]
    noise_ratio: tuple[float, ...] | None = None


def held_out(estimate: LoadEstimate, model: Model, record: Record | ArrayLike) -> HeldOut:
    """Predict the channels of `model` from an estimated load and compare them with what was measured there.

    Parameters
    ----------
    estimate : LoadEstimate
        Load histories with a time axis, or a static load (loads,) or (frames, loads).
    model : Model
        Forward model from the same loads to the validation channels.
    record : Record or array
        Holds those channels. Static readings may be bare, (sensors,) or (frames, sensors), in the order of
        ``model.sensors``; a record of many samples against one static load is averaged.

    Raises
    ------
    InputError
        Channels, samples or units that do not fit, another step, NaN, or an estimate over another axis.
    """
    static = _is_static(estimate)
    if not static and (estimate.axis is None or estimate.axis.name != "time"):
        raise InputError("only static loads and load histories can be validated on held-out channels", where="held_out",
                         found="no time axis", expected="an estimate over time, or a static one",
                         hint="transform the estimate to time first")  # fmt: skip
    predicted, measured, whole = (_static if static else _in_time)(estimate, model, record)
    labels = tuple(s.label for s in model.sensors)
    error = _errors(predicted, measured, model)
    flag = guards.used_for_training("a validation channel", set(labels) & set(estimate.sensors))
    if flag is None and len(whole) >= RECORD:
        flag = guards.used_for_training("the validation record", set(digests(whole)) & _seen(estimate, model))
    return HeldOut(predicted, measured, error, labels, guards.collect([flag]), _ratio(predicted, measured, model))


def _is_static(estimate: LoadEstimate) -> bool:
    axis = estimate.axis
    return axis is None or axis.name == "frame" or estimate.provenance.get("family") == STATIC


def _in_time(estimate: LoadEstimate, model: Model, record: Any) -> tuple[Array, Array, Array]:
    """Predicted and measured histories of equal length, and the measured one in full."""
    if not isinstance(record, Record):
        raise InputError("a load history is validated on a Record", where="held_out",
                         found=f"an object of type {type(record).__name__}",
                         expected="a Record with its step and channels", hint="Record(values, dt, labels)")  # fmt: skip
    assert estimate.axis is not None
    if abs(estimate.axis.step / record.dt - 1) > 1e-6:
        raise InputError("the record and the estimate have different steps", where="held_out",
                         found=f"dt = {record.dt:.9g} s", expected=f"dt = {estimate.axis.step:.9g} s",
                         hint="resample one of the two")  # fmt: skip
    whole = _select(model, record)
    measured = whole[: len(estimate.load)]
    predicted = model.predict(_ordered(estimate, model), record.dt)[: len(measured)]
    return predicted, measured[: len(predicted)], whole


def _static(estimate: LoadEstimate, model: Model, record: Any) -> tuple[Array, Array, Array]:
    """Predicted and measured static readings in the shape of the load, and the measured ones as a table."""
    predicted = _ordered(estimate, model) @ np.asarray(model.static(), float).T
    if isinstance(record, Record):
        measured = _select(model, record)
        if estimate.load.ndim == 1:
            measured = measured.mean(axis=0)
    else:
        measured = _readings(record)
    if measured.ndim == 2 and estimate.load.ndim == 1 and len(measured) == 1:
        measured = measured[0]
    if measured.shape != predicted.shape:
        raise InputError("the readings do not fit the estimate and the model", where="held_out",
                         found=f"shape {measured.shape}",
                         expected=f"shape {predicted.shape} for the sensors {[s.label for s in model.sensors][:12]}",
                         hint="one number per sensor (and frame), in the order of model.sensors")  # fmt: skip
    return predicted, measured, np.atleast_2d(measured)


def _select(model: Model, record: Record) -> Array:
    kept = record.select([s.label for s in model.sensors])
    require_finite(kept)
    _check_units(model, kept)
    return np.asarray(kept.values)


def _readings(values: Any) -> Array:
    hint = "leave lost sensors out of the model and of the readings"
    return numbers(values, "the readings", hint, where="held_out")


def _errors(predicted: Array, measured: Array, model: Model) -> tuple[float, ...]:
    if measured.ndim == 1:
        units = np.array([s.unit for s in model.sensors])
        size = np.array([np.sqrt(np.mean(measured[units == u] ** 2)) for u in units])
    else:
        size = np.linalg.norm(measured, axis=0)
    if np.any(size == 0):
        raise InputError("a validation channel is zero", where="held_out",
                         found=[s.label for s, x in zip(model.sensors, size, strict=True) if x == 0],
                         expected="measured responses", hint="leave it out")  # fmt: skip
    difference = measured - predicted
    found = np.abs(difference) if measured.ndim == 1 else np.linalg.norm(difference, axis=0)
    return tuple(float(e) for e in found / size)


def _ratio(predicted: Array, measured: Array, model: Model) -> tuple[float, ...] | None:
    noise = model.noise
    if noise is None:
        return None
    std = noise if noise.ndim == 1 else np.sqrt(np.diagonal(noise))
    rms = np.sqrt(np.mean(np.atleast_2d(measured - predicted) ** 2, axis=0))
    return tuple(float(r) for r in rms / std)


def _seen(estimate: LoadEstimate, model: Model) -> set[str]:
    """Digests of the responses that were inverted, and of those that the validation model was made from."""
    inverted = () if estimate.response is None else digests(np.atleast_2d(estimate.response))
    return {*inverted, *model.training}


def _ordered(estimate: LoadEstimate, model: Model) -> Array:
    """Loads of the estimate in the order of the model, where both name the same ones."""
    have, want = list(estimate.labels), [c.label for c in model.loads]
    if len(have) != len(want):
        raise InputError("the model and the estimate have different loads", where="held_out",
                         found=f"{len(want)} loads in the model", expected=f"{len(have)} loads",
                         hint="build the validation model with the loads of the inversion")  # fmt: skip
    return estimate.load[..., [have.index(w) for w in want]] if sorted(have) == sorted(want) else estimate.load


def _check_units(model: Model, record: Record) -> None:
    for row, channel in zip(model.sensors, record.channels, strict=True):
        if "arbitrary" not in (row.unit, channel.unit) and row.unit != channel.unit:
            raise InputError("the unit of a channel does not fit the sensor of the model",
                             where=f"channel {channel.label}", found=channel.unit, expected=row.unit,
                             hint="state the unit in which the channel was recorded")  # fmt: skip


def validate(estimate: LoadEstimate, *references: Any, level: float = 0.95) -> Validation:
    """Hold an estimate of any family against what is known of the load, and say at which level that validates it.

    Parameters
    ----------
    estimate : LoadEstimate
    *references
        One or more of: `Known`, `PressureMat` (distribution); `ReferenceWrench`, or a resultant constraint with ``C``
        and ``value`` (resultant); the answer of `held_out` (held-out sensors). An array, a function of the places, a
        pair ``(coordinates, values)`` and a Record with channels named as the loads are taken as `Known`.
    level : float
        Probability of the band whose coverage is counted.

    Returns
    -------
    Validation
        ``estimate.validated(validation)`` keeps it with the result.

    Raises
    ------
    InputError
        No reference, shapes or units that do not fit, NaN, a reference that is zero.

    Notes
    -----
    A resultant is a few well-conditioned numbers of a distribution: agreement there is necessary, and not sufficient.
    """
    if not isinstance(estimate, LoadEstimate):
        raise InputError(
            "no estimate", where="validate", found=type(estimate).__name__, expected="a LoadEstimate",
            hint="validate(family.estimate(...), reference)",
        )  # fmt: skip
    if estimate.load.dtype.kind == "c":
        raise InputError(
            "complex loads have no level", where="validate", found="a load over frequency", expected="a real load",
            hint="transform it to time first",
        )  # fmt: skip
    if not references:
        raise InputError(
            "nothing to validate against", where="validate", found="no reference",
            expected="a known load, a pressure mat, a wrench or held-out sensors",
            hint="validate(estimate, ReferenceWrench(value, std=...)), for example",
        )  # fmt: skip
    if isinstance(level, bool) or not isinstance(level, int | float) or not 0 < level < 1:
        raise InputError(
            "no probability", where="level", found=repr(level), expected="between 0 and 1", hint="level=0.95"
        )
    checks: list[Check] = []
    raised: list[Flag | None] = []
    known = 0  # independent numbers of the load that the resultants fix
    for reference in map(_settled, references):
        if isinstance(reference, HeldOut):
            checks.append(SensorCheck(reference.labels, reference.error, reference.noise_ratio, "held-out sensors"))
            raised += reference.flags
        elif isinstance(reference, ReferenceWrench):
            check, rank = against_wrench(estimate, reference)
            checks, known = [*checks, check], max(known, rank)
            raised.append(_imposed(estimate))
        elif isinstance(reference, PressureMat):
            cells, rank = against_mat(estimate, reference, level)
            checks, known = [*checks, cells], max(known, rank)
        else:
            checks += against_known(estimate, reference, level)
    kinds = {c.kind for c in checks}
    raised.append(guards.resultant_only(kinds, known, estimate.load.shape[-1]))
    return Validation(tuple(checks), guards.collect(raised), datetime.now(UTC).isoformat(timespec="seconds"))


def _settled(reference: Any) -> Known | PressureMat | ReferenceWrench | HeldOut:
    """The reference as one of the four kinds."""
    if isinstance(reference, Known | PressureMat | ReferenceWrench | HeldOut):
        return reference
    if isinstance(reference, Record):
        return Known(reference, source=reference.name or reference.source or "a record")  # type: ignore[arg-type]
    if hasattr(reference, "C") and hasattr(reference, "value"):  # a constraint of the inversion, or its like
        return _wrench(reference)
    if isinstance(reference, tuple) and len(reference) == 2 and not any(_scalar(r) for r in reference):
        return Known(reference[1], coordinates=reference[0])
    return Known(reference)


def _wrench(constraint: Any) -> ReferenceWrench:
    covariance = getattr(constraint, "covariance", None)
    std = None if covariance is None else np.sqrt(np.diagonal(np.atleast_2d(np.asarray(covariance, float))))
    return ReferenceWrench(constraint.value, std, tuple(getattr(constraint, "labels", ())), constraint.C)


def _scalar(x: Any) -> bool:
    return not callable(x) and not isinstance(x, Sequence) and getattr(x, "ndim", 0) == 0


def _imposed(estimate: LoadEstimate) -> Flag | None:
    """W704: the resultant was a constraint of this very inversion."""
    settings = estimate.provenance.get("settings") or {}
    kinds = settings.get("constraint_kinds") or () if isinstance(settings, Mapping) else ()
    return guards.used_for_training("the resultant", {"resultant constraint"} if Resultant.__name__ in kinds else set())


# -- coverage of the stated bands --------------------------------------------------------------------------------------
HISTORIES, READINGS = 50, 2000  # draws where none are asked for: records in time, static readings
Draw = Callable[[np.random.Generator], ArrayLike]


@dataclass(frozen=True)
class Coverage:
    """Share of the true load values inside the stated band.

    Parameters
    ----------
    share : float
        Over all draws, samples and loads.
    level : float
        Stated level of the band.
    draws : int
    date : str
    """

    share: float
    level: float
    draws: int
    date: str

    def __str__(self) -> str:
        return f"the {self.level:.0%} band held {self.share:.1%} of the true values in {self.draws} simulated records"


def coverage(
    family: Any,
    loads: ArrayLike | Sequence[ArrayLike] | Draw,
    dt: float | None = None,
    *,
    noise: ArrayLike,
    truth: Model | None = None,
    draws: int | None = None,
    level: float = 0.95,
    seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Coverage:
    """Simulate readings of known loads with fresh noise, rebuild them, and count the values inside the band.

    Parameters
    ----------
    family : Deconvolution, StaticInversion or another family
        Set up as it will be used.
    loads : array, sequence of arrays, or callable
        Loads like the ones to be expected; draws go through them in turn. In time, ``(samples, loads)`` or a sequence
        of such histories; static, ``(loads,)`` or ``(draws, loads)``. A callable takes a random generator and returns
        one of them: a prior to draw from.
    dt : float, optional
        Step in s; None is static.
    noise : float, array (sensors,) or array (sensors, sensors)
        Noise std to add, or its covariance.
    truth : Model, optional
        Model that makes the data; default the family's own, which is optimistic (an inverse crime).
    draws : int, optional
        Number of records; default 50 histories or 2000 static readings.
    level, seed
        Level of the band, seed of the noise.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Returns
    -------
    Coverage
        Pass it as ``coverage=`` to the family.

    Raises
    ------
    InputError
        No draw, no load or a level outside (0, 1); loads or noise that do not fit the model.
    """
    if not (hasattr(family, "estimate") and hasattr(family, "model")):
        raise InputError(
            "no family", where="coverage", found=type(family).__name__, expected="StaticInversion, Deconvolution, ...",
            hint="coverage(StaticInversion(model), loads, noise=...)",
        )  # fmt: skip
    draws = (READINGS if dt is None else HISTORIES) if draws is None else draws
    shapes = _statics(loads) if dt is None else _histories(loads)
    if draws < 1 or not 0 < level < 1 or not (callable(shapes) or shapes):
        raise InputError("nothing to draw", where="coverage",
                         found=f"{draws} draws, {'a' if callable(shapes) else len(shapes)} loads, level {level}",
                         expected="at least one draw of one load, and a level in (0, 1)",
                         hint="give loads like the ones to be expected")  # fmt: skip
    rng, z = np.random.default_rng(seed), NormalDist().inv_cdf(0.5 + level / 2)
    model = truth or family.model
    add = _noise(noise, rng)
    static = None if dt is not None else _transfer(model)
    inside = total = 0
    for i, g in enumerate(_draws(shapes, draws, rng, dt)):
        if static is not None:
            _fits(g, static)
            estimate = family.estimate(add(static @ g))
        else:
            assert dt is not None
            estimate = family.estimate(add(model.predict(g, dt)), dt)
        hit = np.abs(estimate.load - g[: len(estimate.load)]) <= z * estimate.std
        inside, total = inside + int(hit.sum()), total + hit.size
        if progress is not None:
            progress((i + 1) / draws, "coverage")
    return Coverage(inside / total, level, draws, datetime.now(UTC).isoformat(timespec="seconds"))


Shapes = Draw | list[Array]


def _draws(shapes: Shapes, draws: int, rng: np.random.Generator, dt: float | None) -> Iterator[Array]:
    for i in range(draws):
        if callable(shapes):
            (g,) = _statics([shapes(rng)]) if dt is None else _histories([shapes(rng)])  # type: ignore[misc]
            yield g
        else:
            yield shapes[i % len(shapes)]


def _histories(loads: ArrayLike | Sequence[ArrayLike] | Draw) -> Shapes:
    if callable(loads):
        return loads
    several = isinstance(loads, list | tuple) and any(np.ndim(g) > 0 for g in loads)
    arrays = [np.asarray(plain(g), float) for g in loads] if several else [np.asarray(plain(loads), float)]  # type: ignore[union-attr]
    for g in arrays:
        if g.ndim not in (1, 2) or not g.size:
            raise InputError("no load history", where="coverage", found=f"shape {g.shape}",
                             expected="(samples,) or (samples, loads)",
                             hint="leave dt out where the loads are static")  # fmt: skip
    return [g.reshape(len(g), -1) for g in arrays]


def _statics(loads: ArrayLike | Sequence[ArrayLike] | Draw) -> Shapes:
    if callable(loads):
        return loads
    table = numbers(loads, "static loads", "give dt= where the loads are histories", where="coverage")
    if table.ndim not in (1, 2):
        raise InputError("no static loads", where="coverage", found=f"shape {table.shape}",
                         expected="(loads,) or (draws, loads)",
                         hint="give dt= where the loads are histories")  # fmt: skip
    return list(np.atleast_2d(table))


def _transfer(model: Model) -> Array:
    return np.asarray(model.static(), float)


def _fits(g: Array, H: Array) -> None:
    if g.shape != H.shape[1:]:
        raise InputError("the loads do not fit the model", where="coverage", found=f"{g.size} loads",
                         expected=f"{H.shape[1]} loads",
                         hint="one number per load, in the order of model.loads")  # fmt: skip


def _noise(noise: ArrayLike, rng: np.random.Generator) -> Callable[[Array], Array]:
    """What adds noise to clean readings, sensors last."""
    level = numbers(noise, "noise", where="coverage")
    if level.ndim > 2 or (level.ndim < 2 and np.any(level < 0)):
        raise InputError("no noise level", where="coverage", found=f"shape {level.shape}",
                         expected="std >= 0, a number or (sensors,), or a covariance (sensors, sensors)",
                         hint="give the std of each sensor")  # fmt: skip
    if level.ndim < 2:
        return lambda y: y + level * rng.standard_normal(y.shape)
    try:
        root = np.linalg.cholesky(level)
    except np.linalg.LinAlgError:
        raise InputError("the noise covariance is not positive definite", where="coverage",
                         found=f"shape {level.shape}", expected="a symmetric positive definite matrix",
                         hint="give the std of each sensor where the covariance is singular") from None  # fmt: skip
    return lambda y: y + rng.standard_normal(y.shape) @ root.T
