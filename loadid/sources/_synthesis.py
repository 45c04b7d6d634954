"""The response that a model gives to an estimated load, with the std that the load's own std leaves it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._channels import ARBITRARY, Channel
from structures._model import Model
from structures.errors import InputError, plain, positive

from .._results.estimate import Axis, LoadEstimate

Real = NDArray[np.float64]
SPECTRA, DENSITIES, HISTORIES = "spectra", "densities", "histories"


@dataclass(frozen=True, eq=False)
class SynthesisedResponse:
    """Response of some sensors to an estimated load.

    Parameters
    ----------
    axis : Axis
        Lines (Hz) or samples (s).
    values : array, shape (lines, sensors)
        Complex amplitudes, real one-sided densities (unit^2/Hz), or histories (samples, sensors).
    sensors : tuple of Channel
    kind : ``"spectra"``, ``"densities"`` or ``"histories"``
    std : array, shape (points, sensors), optional
        Standard deviation of `values`, ``sqrt(E|error|^2)`` of complex ones, at the entries `points` of the axis.
    points : array of int
        All lines; some samples of a history, whose band costs a solve each.
    """

    axis: Axis
    values: NDArray[Any]
    sensors: tuple[Channel, ...]
    kind: str
    std: Real | None = None
    points: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of `values`, one per sensor."""
        return tuple(unit_of(c.unit, self.kind) for c in self.sensors)


@dataclass(frozen=True, eq=False)
class Paths:
    """What a synthesis over frequency is made of: responses, loads in the order of the model, and their errors.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads), complex
    load : array, shape (lines, loads), complex, or None
        Complex amplitudes.
    cross : array, shape (lines, loads, loads), complex, or None
        Cross spectral densities, instead.
    errors : array, shape (lines, loads, loads), complex, or None
        ``E[e e^H]`` of the complex amplitudes.
    std : array, shape (lines, loads)
        Std of the amplitudes, or of the autospectra.
    variance : array, shape (lines, sensors, loads), or None
        Variance of H.
    """

    H: NDArray[np.complex128]
    load: NDArray[np.complex128] | None
    cross: NDArray[np.complex128] | None
    errors: NDArray[np.complex128] | None
    std: Real
    variance: Real | None


def synthesise(
    model: Model,
    estimate: LoadEstimate,
    *,
    sensors: Any = None,
    covariance: ArrayLike | None = None,
    points: int = 0,
) -> SynthesisedResponse:
    """Response of the sensors of a model to an estimated load.

    Parameters
    ----------
    model : Model
        From the same loads to any sensors, of the structure of the test or of another one.
    estimate : LoadEstimate
        Complex loads or cross spectra over frequency, or load histories.
    sensors : sequence of str or int, optional
        Which ones; default all.
    covariance : array, shape (lines, loads, loads), optional
        ``E[e e^H]`` of complex loads; default what ``estimate.spectrum`` holds, else errors that do not correlate.
    points : int
        Samples of a history, evenly spread, at which its std is found from the posterior.

    Returns
    -------
    SynthesisedResponse
        The std holds that of the loads and, over frequency, the variance of the FRFs of this model where it is known.

    Raises
    ------
    InputError
        Loads or units that do not fit the model, a static estimate, or as the model's ``frf`` or ``predict``.

    Notes
    -----
    Complex amplitudes: y = H f, E abs(dy)^2 = h C h^H + sum_j var(h_j) abs(f_j)^2. Densities: S_yy = h S_ff h^H, to
    first order with the std of the autospectra as uncorrelated. Histories: var y_n = w^T C w with the weights w of a
    row of the convolution, at least the response to the stated bias.
    """
    kind, rows = kind_of(estimate), rows_of(model, sensors)
    chosen = tuple(model.sensors[i] for i in rows)
    assert estimate.axis is not None
    if kind == HISTORIES:
        return _history(model, estimate, rows, chosen, points)
    return whole(estimate.axis, chosen, paths(model, estimate, rows, covariance))


def whole(axis: Axis, sensors: tuple[Channel, ...], parts: Paths) -> SynthesisedResponse:
    """Response over frequency to all loads together."""
    every = np.arange(len(axis.values))
    if parts.load is not None:
        values = np.einsum("lij,lj->li", parts.H, parts.load)
        return SynthesisedResponse(axis, values, sensors, SPECTRA, np.sqrt(_amplitude_variance(parts)), every)
    assert parts.cross is not None
    seen = np.einsum("ljk,lik->lij", parts.cross, parts.H.conj())  # S h^H
    values = np.maximum(np.einsum("lij,lij->li", parts.H, seen).real, 0.0)
    return SynthesisedResponse(axis, values, sensors, DENSITIES, np.sqrt(_density_variance(parts, seen)), every)


def kind_of(estimate: LoadEstimate) -> str:
    """``"spectra"``, ``"densities"`` or ``"histories"``: what the loads of an estimate are.

    Raises
    ------
    InputError
        A static estimate, an axis of frames, autospectra without their cross spectra.
    """
    axis, spectrum = estimate.axis, getattr(estimate, "spectrum", None)
    if axis is not None and axis.name == "time":
        return HISTORIES
    if axis is not None and axis.name == "frequency":
        if getattr(spectrum, "cross", None) is not None:
            return DENSITIES
        if estimate.load.dtype.kind == "c":
            return SPECTRA
        raise InputError(
            "autospectra alone do not say how the loads act together", where="synthesis",
            found="real loads over frequency", expected="complex amplitudes, or cross spectra in estimate.spectrum",
            hint="FrequencyInversion on cross spectra gives them",
        )  # fmt: skip
    raise InputError(
        "a response is synthesised over time or frequency", where="synthesis",
        found="a static load" if axis is None else f"an axis of {axis.name}",
        expected="load histories or spectra", hint="of a static estimate: loadid.validate.validate",
    )  # fmt: skip


def rows_of(model: Model, sensors: Any) -> list[int]:
    """Rows of a model, by label or index; all for None.

    Raises
    ------
    InputError
        One that is not there, or none.
    """
    if sensors is None:
        return list(range(len(model.sensors)))
    labels = [s.label for s in model.sensors]
    wanted = [sensors] if isinstance(sensors, str | int | np.integer) else list(sensors)
    if not wanted:
        raise InputError("no sensor is named", where="sensors", found="none", expected=f"some of {labels[:12]}")
    return [row_of(getattr(w, "label", w), labels) for w in wanted]


def row_of(sensor: Any, labels: Sequence[str]) -> int:
    """Row of a sensor, by label or index.

    Raises
    ------
    InputError
        There is none.
    """
    if isinstance(sensor, str) and sensor in labels:
        return list(labels).index(sensor)
    if isinstance(sensor, int | np.integer) and not isinstance(sensor, bool) and -len(labels) <= sensor < len(labels):
        return int(sensor) % len(labels)
    raise InputError(
        "no such sensor", where="sensors", found=repr(sensor), expected=f"an index or one of {list(labels[:12])}",
        hint="sensors are named as in model.sensors",
    )  # fmt: skip


def order(model: Model, estimate: LoadEstimate) -> list[int]:
    """Columns of the estimate in the order of the loads of the model: by name, else as they stand.

    Raises
    ------
    InputError
        Another number of loads, or units that do not fit.
    """
    have, want = list(estimate.labels), [c.label for c in model.loads]
    if len(have) != len(want):
        raise InputError(
            "the model and the estimate have different loads", where="synthesis",
            found=f"{len(want)} loads in the model", expected=f"{len(have)} loads: {have[:12]}",
            hint="build the model with the loads of the inversion",
        )  # fmt: skip
    columns = [have.index(w) for w in want] if sorted(have) == sorted(want) else list(range(len(have)))
    if kind_of(estimate) != DENSITIES:
        for c, j in zip(model.loads, columns, strict=True):
            if ARBITRARY not in (c.unit, estimate.units[j]) and c.unit != estimate.units[j]:
                raise InputError(
                    "the unit of a load does not fit the model", where=f"load {c.label}", found=estimate.units[j],
                    expected=c.unit, hint="name the loads of both alike, in SI",
                )  # fmt: skip
    return columns


def paths(model: Model, estimate: LoadEstimate, rows: list[int], covariance: ArrayLike | None = None) -> Paths:
    """Responses and loads at the lines of an estimate over frequency.

    Raises
    ------
    InputError
        A covariance or cross spectra of another shape, NaN, or as `order` and the model's ``frf``.
    """
    columns = order(model, estimate)
    assert estimate.axis is not None
    f = estimate.axis.values
    H = np.asarray(model.frf(f), complex)[:, rows]
    variance = model.frf_variance(f)
    variance = None if variance is None else np.asarray(variance, float)[:, rows]
    spectrum, std = getattr(estimate, "spectrum", None), np.asarray(estimate.std, float)[:, columns]
    shape = (len(f), len(columns), len(columns))
    if kind_of(estimate) == DENSITIES:
        cross = _matrices(getattr(spectrum, "cross", None), shape, "spectrum.cross")
        return Paths(H, None, cross[:, columns][:, :, columns], None, std, variance)
    given = covariance if covariance is not None else getattr(spectrum, "covariance", None)
    errors = None if given is None else _matrices(given, shape, "covariance")[:, columns][:, :, columns]
    return Paths(H, np.asarray(estimate.load, complex)[:, columns], None, errors, std, variance)


def unit_of(unit: str, kind: str) -> str:
    """Unit of the values of a sensor: that of a density is ``(m/s^2)^2/Hz``."""
    if kind != DENSITIES or unit == ARBITRARY:
        return unit
    return f"({unit})^2/Hz" if any(x in unit for x in "/^* ") else f"{unit}^2/Hz"


def reliable(values: NDArray[Any], std: NDArray[Any], share: float) -> NDArray[np.bool_]:
    """Lines (lines, ...) on which the std of some numbers, a root sum over their last axis, is below a share of theirs.

    Raises
    ------
    InputError
        No positive share, or no line left.
    """
    share = positive("the share", share, where="trust")
    found = np.linalg.norm(std, axis=-1) <= share * np.linalg.norm(values, axis=-1)
    if not np.any(found):
        raise InputError(
            "no line is left", where="trust", found=f"a std above {share:.0%} on all {len(found)} lines",
            expected="a line whose std is known to be smaller", hint="raise trust, or leave it out",
        )  # fmt: skip
    return np.asarray(found, bool)


def band_of_history(
    model: Model, estimate: LoadEstimate, rows: list[int], points: int, *, each: bool = True
) -> tuple[Real | None, Real | None, NDArray[np.intp]]:
    """Std of the response to each load alone, of that to all, (points, sensors, ...), and the samples it is known at.

    `each` off leaves the loads alone out.

    From the posterior, at least the response to the stated bias; None where there is no posterior or no point is asked.
    """
    columns, axis = order(model, estimate), estimate.over("time")
    at = spread(len(estimate.load), points) if estimate.posterior is not None else np.empty(0, np.intp)
    if not len(at):
        return None, None, at
    w = weights(model, axis.step, len(estimate.load), rows, at)
    alone, joint = np.zeros((len(at), len(rows), w.shape[-1])), np.empty((len(at), len(rows)))
    for i in range(len(rows)):
        own = np.empty_like(w[:, i])
        own[..., columns] = w[:, i]  # the posterior keeps the order of the estimate
        joint[:, i] = estimate.posterior.variance(own)
        for j, column in enumerate(columns if each else ()):
            single = np.zeros_like(own)
            single[..., column] = own[..., column]
            alone[:, i, j] = estimate.posterior.variance(single)
            if estimate.bias is not None:
                hidden = np.einsum("pnj,nj->p", single, estimate.bias)
                alone[:, i, j] = np.maximum(alone[:, i, j], hidden**2)
        if estimate.bias is not None:
            joint[:, i] = np.maximum(joint[:, i], np.einsum("pnj,nj->p", own, estimate.bias) ** 2)
    return np.sqrt(np.maximum(alone, 0.0)) if each else None, np.sqrt(np.maximum(joint, 0.0)), at


def weights(model: Model, dt: float, samples: int, rows: list[int], points: NDArray[np.intp]) -> NDArray[np.float64]:
    """What every sample of every load adds to some samples of a response, shape (points, sensors, samples, loads)."""
    h = model.impulse_response(dt, samples, model.default_hold)[:, rows]
    w = np.zeros((len(points), len(rows), samples, h.shape[2]))
    for p, n in enumerate(points):
        w[p, :, : n + 1] = np.moveaxis(h[: n + 1][::-1], 1, 0)
    return w


def spread(samples: int, count: int) -> NDArray[np.intp]:
    """Samples evenly spread over a record, not at its start, where nothing has happened yet."""
    count = min(max(int(count), 0), samples)
    return np.unique(np.round(np.arange(1, count + 1) * samples / max(count, 1)).astype(np.intp)) - 1


# -- inside ------------------------------------------------------------------------------------------------------------
def _history(
    model: Model, estimate: LoadEstimate, rows: list[int], chosen: tuple[Channel, ...], points: int
) -> SynthesisedResponse:
    columns = order(model, estimate)
    axis = estimate.over("time")
    values = model.predict(estimate.load[:, columns], axis.step)[:, rows]
    _, std, at = band_of_history(model, estimate, rows, points, each=False)
    return SynthesisedResponse(axis, values, chosen, HISTORIES, std, at)


def _amplitude_variance(p: Paths) -> Real:
    assert p.load is not None
    if p.errors is None:
        found = np.einsum("lij,lj->li", np.abs(p.H) ** 2, p.std**2)
    else:
        found = np.einsum("lij,ljk,lik->li", p.H, p.errors, p.H.conj()).real
    if p.variance is not None:
        found = found + np.einsum("lij,lj->li", p.variance, np.abs(p.load) ** 2)
    return np.asarray(np.maximum(found, 0.0))


def _density_variance(p: Paths, seen: NDArray[Any]) -> Real:
    found = np.einsum("lij,lj->li", np.abs(p.H) ** 4, p.std**2)
    if p.variance is not None:  # dS = 2 Re(dh S h^H), dh circular
        found = found + 2 * np.einsum("lij,lij->li", p.variance, np.abs(seen) ** 2)
    return np.asarray(found)


def _matrices(given: Any, shape: tuple[int, ...], where: str) -> NDArray[np.complex128]:
    found = np.asarray(plain(given), complex)
    if found.shape != shape or not np.all(np.isfinite(found)):
        raise InputError(
            "no matrix for each line", where=where, found=f"shape {found.shape}",
            expected=f"finite numbers of shape {shape}", hint="lines, loads, loads, in the order of the estimate",
        )  # fmt: skip
    return found
