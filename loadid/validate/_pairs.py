"""An estimate and a reference brought to the same places, samples and units, and then compared."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .._quality import require_finite
from .._record import Record
from .._results.estimate import LoadEstimate
from ._checks import DistributionCheck, ResultantCheck, compare, resultant_check
from ._references import Known, PressureMat, ReferenceWrench, at_places, factor, numbers, spread

Array = NDArray[np.float64]

BATCH = 4_000_000  # entries of the weights that are handed to a posterior at once


def columns_of(e: LoadEstimate, loads: str | Sequence[str | int] | None) -> NDArray[np.intp]:
    """Columns of the loads that are compared."""
    if loads is None:
        return np.arange(len(e.labels))
    if isinstance(loads, str):
        components = [] if e.geometry is None else list(e.geometry.get("components", ()))
        bare = [c.lstrip("+") for c in components]
        if loads not in e.labels and loads.lstrip("+") in bare:
            return np.arange(bare.index(loads.lstrip("+")), len(e.labels), len(components))
        loads = [loads]
    return np.array([e.index(x) for x in loads], dtype=np.intp)


def loads_of(e: LoadEstimate) -> tuple[Array, Array | None, None]:
    """Loads and their std, (frames, loads); in their own unit."""
    return np.atleast_2d(e.load), np.atleast_2d(e.std) if np.any(e.std > 0) else None, None


def field_of(e: LoadEstimate) -> tuple[Array, Array | None, str | None]:
    """Loads as a field, (frames, loads), their std and their unit where that is another: nodal forces become tractions.

    Raises
    ------
    InputError
        If the result knows no matrix for that.
    """
    geometry = e.geometry or {}
    if geometry.get("kind") != "nodal":
        return loads_of(e)
    found = np.atleast_2d(e.traction())
    std = row_std(e, np.asarray(geometry["traction"], float))
    line = np.asarray(geometry["coordinates"]).reshape(len(geometry["coordinates"]), -1).shape[1] == 1
    return found, None if std is None else np.broadcast_to(std, found.shape), "N/m" if line else "Pa"


def areas_of(e: LoadEstimate, columns: NDArray[np.intp], tractions: bool) -> Array:
    """Weights of the inner product: tributary areas where tractions of a basis are compared, else ones."""
    geometry = e.geometry or {}
    measures, kind = geometry.get("measures"), geometry.get("kind")
    if measures is None or kind == "polynomials" or (kind == "nodal" and not tractions):
        return np.ones(len(columns))
    weights = np.asarray(measures, float)[columns // len(geometry.get("components", ("",)))]
    return np.asarray(weights / weights.mean())


def resultants_of(e: LoadEstimate, wrench: ReferenceWrench) -> tuple[Array, list[str], list[str]]:
    """Weights, labels and units of the resultants."""
    labels = [wrench.labels] if isinstance(wrench.labels, str) else [str(x) for x in wrench.labels]
    if wrench.C is not None:
        C = np.atleast_2d(numbers(wrench.C, "weights of the resultants"))
        labels = labels or [f"R{i + 1}" for i in range(len(C))]
        if C.shape != (len(labels), e.load.shape[-1]):
            raise InputError(
                "the weights of the resultants do not fit", where="ReferenceWrench", found=f"shape {C.shape}",
                expected=f"({len(labels)}, {e.load.shape[-1]})", hint="one row per resultant, one column per load",
            )  # fmt: skip
        return C, labels, [_resultant_unit(x, e) for x in labels]
    have = [] if e.geometry is None else [str(x) for x in e.geometry.get("resultant_labels", ())]
    labels = labels or have
    if not have or e.geometry is None or e.geometry.get("resultant") is None or set(labels) - set(have):
        raise InputError(
            "the estimate knows no such resultant", where="ReferenceWrench", found=labels or "loads without a basis",
            expected=f"some of {have}" if have else "a model whose loads are a Basis",
            hint="give C (resultants, loads): the weights of the loads in each resultant",
        )  # fmt: skip
    C = np.asarray(e.geometry["resultant"], float)[[have.index(x) for x in labels]]
    return C, labels, [_resultant_unit(x, e) for x in labels]


def _resultant_unit(label: str, e: LoadEstimate) -> str:
    if label.startswith("M"):
        return "N m"
    return "N" if label.startswith("F") or e.geometry is not None or set(e.units) == {"N"} else "arbitrary"


def row_std(e: LoadEstimate, rows: Array) -> Array | None:
    """Std of weighted sums of the loads, (sums,) or (frames, sums); not less than the bias that the estimate states."""
    if e.posterior is None:
        return None
    own = getattr(e.posterior, "std", None)
    if e.load.ndim == 1 or (own is not None and own.shape == e.load.shape[1:]):
        variance = np.asarray(e.posterior.variance(rows), float)[None]
    else:
        variance = np.empty((len(e.load), len(rows)))
        step = max(1, BATCH // e.load.size)
        for k in range(len(e.load)):
            for i in range(0, len(rows), step):
                weights = np.zeros((len(rows[i : i + step]), *e.load.shape))
                weights[:, k] = rows[i : i + step]
                variance[k, i : i + step] = e.posterior.variance(weights)
    std = np.sqrt(np.maximum(variance, 0.0))
    return np.asarray(std if e.bias is None else np.maximum(std, np.abs(np.atleast_2d(e.bias) @ rows.T)))


FEW = 4  # averages below which a mat knows no more than a force and its moments


# -- the three kinds ---------------------------------------------------------------------------------------------------
def against_known(e: LoadEstimate, known: Known, level: float) -> list[DistributionCheck]:
    """A known load: one check for each unit among the loads."""
    columns = columns_of(e, known.loads)
    if known.coordinates is not None or (callable(known.values) and e.geometry is not None):
        found, std, unit = field_of(e)
        own = _field(e, known, columns)
    else:
        found, std, unit = loads_of(e)
        if isinstance(known.values, Record):
            columns = _named(e, known.values, columns)
        own = _table(e, known, columns)
    own = np.broadcast_to(own, (len(found), len(columns)))
    error = spread(known.std, own.shape, known.source)
    names = np.array([e.units[j] for j in columns])
    checks = []
    for name in dict.fromkeys(names.tolist()):
        pick = names == name
        scale = factor(known.unit, unit or name, known.source)
        stds = None if std is None else (std[:, columns[pick]], None if error is None else error[:, pick] * scale)
        pair = found[:, columns[pick]], own[:, pick] * scale
        places, weights = _Entries(e, columns[pick].tolist()), areas_of(e, columns[pick], unit is not None)
        checks.append(_distribution(pair, stds, weights, places, unit or name, level, known.source, "load"))
    return checks


def against_mat(e: LoadEstimate, mat: PressureMat, level: float) -> tuple[DistributionCheck | ResultantCheck, int]:
    """A pressure mat, and how many numbers it knows: averages of the load; too few cells are resultants."""
    columns = columns_of(e, mat.loads)
    unit = _one_unit(e, columns, mat.source)
    P = np.atleast_2d(numbers(mat.P, f"averaging matrix of {mat.source}"))
    if P.shape[1] != len(columns):
        raise InputError(
            "the averaging matrix does not fit the loads", where="PressureMat", found=f"shape {P.shape}",
            expected=f"(cells, {len(columns)})", hint="one column per load; loads= names a component",
        )  # fmt: skip
    found = np.atleast_2d(e.load)[:, columns] @ P.T
    own = _fitted(numbers(mat.values, mat.source), found.shape, mat.source, e.load.ndim == 1)
    scale = factor(mat.unit, unit, mat.source)
    error = spread(mat.std, own.shape, mat.source)
    error = None if error is None else error * scale
    rows = np.zeros((len(P), e.load.shape[-1]))
    rows[:, columns] = P
    band, rank = row_std(e, rows), int(np.linalg.matrix_rank(P))
    if len(P) < min(FEW, e.load.shape[-1]):
        labels, same = [f"cell {i + 1}" for i in range(len(P))], [unit] * len(P)
        _not_zero(own, mat.source)
        check = resultant_check(labels, same, found, own * scale, _total(band, error), _axis(e), mat.source)
        return check, rank
    stds = None if band is None else (np.broadcast_to(band, found.shape), error)
    places = _Entries(e, None)
    pair = found, own * scale
    return _distribution(pair, stds, np.ones(len(P)), places, unit, level, mat.source, "average"), rank


def against_wrench(e: LoadEstimate, wrench: ReferenceWrench) -> tuple[ResultantCheck, int]:
    """Resultants, and how many independent numbers of the load they are."""
    C, labels, units = resultants_of(e, wrench)
    found = np.atleast_2d(e.load) @ C.T
    own = _fitted(numbers(wrench.value, wrench.source), found.shape, wrench.source, e.load.ndim == 1)
    scale = np.ones(len(C))
    if wrench.units:
        if len(wrench.units) != len(C):
            raise InputError(
                "units and resultants do not fit", where="ReferenceWrench", found=len(wrench.units), expected=len(C),
                hint="one unit per resultant",
            )  # fmt: skip
        scale = np.array([factor(u, x, wrench.source) for u, x in zip(wrench.units, units, strict=True)])
    error = spread(wrench.std, own.shape, wrench.source)
    own = own * scale
    _not_zero(own, wrench.source)
    error = None if error is None else error * scale
    check = resultant_check(labels, units, found, own, _total(row_std(e, C), error), _axis(e), wrench.source)
    size = np.linalg.norm(C, axis=1, keepdims=True)
    return check, int(np.linalg.matrix_rank(C / np.where(size > 0, size, 1.0)))


# -- the reference -----------------------------------------------------------------------------------------------------
def _table(e: LoadEstimate, known: Known, columns: NDArray[np.intp]) -> Array:
    """Known loads (frames, columns) given in the order of the estimate, or as a function of its axis."""
    values: Any = known.values
    if isinstance(values, Record):
        return _record(e, values, columns)
    if callable(values):
        if e.axis is None:
            raise InputError(
                "a function needs places or times", where="validate", found="a static load without a basis",
                expected="an array (loads,)", hint="evaluate the function yourself, once per load",
            )  # fmt: skip
        values = values(np.asarray(e.axis.values))
    own = numbers(values, known.source)
    rows = np.atleast_2d(e.load).shape[0]
    if own.ndim == 1 and len(columns) == 1 and len(own) == rows:
        return own[:, None]
    return _fitted(
        own, (rows, len(columns)), known.source, e.load.ndim == 1, wide=e.axis is None or e.axis.name != "time"
    )


def _named(e: LoadEstimate, record: Record, columns: NDArray[np.intp]) -> NDArray[np.intp]:
    """The loads that a record names; the only load where it has but one channel."""
    named = [int(j) for j in columns if e.labels[j] in record.labels]
    if not named and not (len(columns) == 1 and len(record.labels) == 1):
        raise InputError(
            "no channel of the record is named as a load", where=record.source or "record",
            found=list(record.labels), expected=f"one of {[e.labels[j] for j in columns][:12]}",
            hint="name the channels of the reference as the loads",
        )  # fmt: skip
    return np.array(named, dtype=np.intp) if named else columns


def _record(e: LoadEstimate, record: Record, columns: NDArray[np.intp]) -> Array:
    if e.axis is None or e.axis.name != "time" or abs(e.axis.step / record.dt - 1) > 1e-6 or len(record) < len(e.load):
        wanted = (
            "no record: no time axis" if e.axis is None or e.axis.name != "time" else f"steps of {e.axis.step:.9g} s"
        )
        raise InputError(
            "the record does not fit the estimate", where=record.source or "record",
            found=f"{len(record)} samples of {record.dt:.9g} s",
            expected=f"{wanted}; {len(e.load)} samples or more",
            hint="resample it, and cut it to the same start",
        )  # fmt: skip
    labels = [e.labels[j] for j in columns]
    kept = record.select(labels if labels[0] in record.labels else list(record.labels))
    require_finite(kept)
    for channel, j in zip(kept.channels, columns, strict=True):
        if "arbitrary" not in (channel.unit, e.units[j]):
            factor(channel.unit, e.units[j], f"channel {channel.label}")
    return np.asarray(kept.values)[: len(e.load)]


def _field(e: LoadEstimate, known: Known, columns: NDArray[np.intp]) -> Array:
    """A field on the places of the basis, as one row of the loads that are compared."""
    geometry = e.geometry or {}
    values = at_places(known, e.geometry)
    points, count = len(values), len(geometry.get("components", ("",)))
    values = values.reshape(points, -1)
    at, which = columns // count, columns % count
    if values.shape[1] == count:
        return values[at, which][None]
    if values.shape[1] == 1 and len(set(which.tolist())) == 1:
        return np.asarray(values[at, 0][None])
    raise InputError(
        "components of the reference do not fit", where="validate", found=f"{values.shape[1]} components",
        expected=f"{count}: {list(geometry.get('components', ()))}",
        hint='name the component that is known: Known(..., loads="+Z")',
    )  # fmt: skip


def _fitted(own: Array, shape: tuple[int, int], source: str, static: bool, wide: bool = False) -> Array:
    """Values as (frames, places); one frame serves all where `wide`, or where there is but one."""
    table = own[None] if own.ndim == 1 else own
    if table.ndim == 2 and (table.shape == shape or (wide and table.shape == (1, shape[1]))):
        return table
    expected = f"({shape[1]},)" if static else f"({shape[0]}, {shape[1]})"
    raise InputError(
        "the reference does not fit the estimate", where="validate", found=f"{source}: shape {own.shape}",
        expected=expected, hint="one number per load (or cell, or resultant), and per frame or sample of a sequence",
    )  # fmt: skip


# -- the comparison ----------------------------------------------------------------------------------------------------
class _Entries:
    """Where an entry of the compared arrays is, in words and in metres or seconds."""

    def __init__(self, e: LoadEstimate, columns: Sequence[int] | None) -> None:
        self.e, self.columns = e, columns

    def words(self, at: tuple[int, ...]) -> str:
        """Label of the load (or cell), and the place on the axis."""
        name = f"cell {at[1] + 1}" if self.columns is None else self.e.labels[self.columns[at[1]]]
        axis = self.e.axis
        return name if axis is None else f"{name}, {axis.values[at[0]]:.6g} {axis.unit}".rstrip()

    def distance(self, a: tuple[int, ...], b: tuple[int, ...]) -> tuple[float | None, str]:
        """Of two entries: m between places of a basis, else s of a history of one load."""
        geometry = self.e.geometry
        if self.columns is None:
            return None, "m"
        i, j = self.columns[a[1]], self.columns[b[1]]
        if geometry is not None and geometry.get("kind") != "polynomials":
            x, count = np.asarray(geometry["coordinates"], float), len(geometry.get("components", ("",)))
            return float(np.linalg.norm(np.atleast_1d(x[i // count] - x[j // count]))), "m"
        if self.e.axis is not None and i == j:
            return float(abs(self.e.axis.values[a[0]] - self.e.axis.values[b[0]])), self.e.axis.unit
        return None, "m"


def _distribution(
    pair: tuple[Array, Array],
    stds: tuple[Array, Array | None] | None,
    weights: Array,
    places: _Entries,
    unit: str,
    level: float,
    source: str,
    word: str,
) -> DistributionCheck:
    found, known = pair
    _not_zero(known, source)
    error, shape, gain, top, real = compare(found, known, weights)
    band = None
    if stds is not None:
        width = NormalDist().inv_cdf(0.5 + level / 2) * np.hypot(stds[0], 0.0 if stds[1] is None else stds[1])
        band = float(np.mean(np.abs(found - known) <= width))
    distance, of = places.distance(top, real)
    frames = "" if len(found) == 1 else f" x {len(found)}"
    return DistributionCheck(
        unit=unit,
        what=f"{found.shape[1]} {word}{'s' * (found.shape[1] != 1)}{frames}",
        error=error,
        shape=shape,
        gain=gain,
        peak=float(found[top]),
        reference_peak=float(known[real]),
        peak_at=places.words(top),
        reference_peak_at=places.words(real),
        peak_distance=distance,
        distance_unit=of,
        band=band,
        level=level,
        source=source,
    )


def _one_unit(e: LoadEstimate, columns: NDArray[np.intp], what: str) -> str:
    found = sorted({e.units[j] for j in columns})
    if len(found) != 1:
        raise InputError(
            f"{what} averages loads of different units", where="PressureMat", found=found, expected="one unit",
            hint="loads= names those that it feels",
        )  # fmt: skip
    return str(found[0])


def _total(std: Array | None, error: Array | None) -> Array | None:
    """Std of the difference of two independent numbers; None where it would be zero."""
    if std is None and error is None:
        return None
    total = np.hypot(0.0 if std is None else std, 0.0 if error is None else error)
    return total if np.all(total > 0) else None


def _axis(e: LoadEstimate) -> Array | None:
    return None if e.axis is None else e.axis.values


def _not_zero(known: Array, source: str) -> None:
    if not np.any(known):
        raise InputError(
            "the reference is zero: no relative error exists", where="validate", found=source,
            expected="a load that is not zero", hint="compare a loaded case, or read estimate.band() around zero",
        )  # fmt: skip
