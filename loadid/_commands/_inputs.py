"""What a family is handed, made from what a job says: constraints and noise by name, readings, candidates."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structures.errors import InputError

from ..constraints import Bounds, NonNegative, Resultant, Support
from . import resolved

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from structures._model import Model

    from .._record import Record
    from .._results.estimate import LoadEstimate

BIGGEST = 1 << 20  # bytes of a table of one row for each sensor
HEADS = ("sensor", "channel", "label", "name")  # of its first column, where it has a heading


# -- by name -----------------------------------------------------------------------------------------------------------
def _index(label: Any, labels: Sequence[str], where: str) -> int:
    if label in labels:
        return labels.index(label)
    near = get_close_matches(str(label), labels, n=1)
    raise InputError("the model has no such name", where=where, found=repr(label), expected=", ".join(labels[:12]),
                     hint=f"did you mean {near[0]!r}?" if near else "")  # fmt: skip


def constraints(model: Model, settings: Mapping[str, Any]) -> list[Any]:
    """`loadid.constraints` of the settings ``nonnegative``, ``bounds``, ``resultant`` and ``acting``.

    Raises
    ------
    InputError
        A load or a resultant that the model does not have.
    """
    labels = [c.label for c in model.loads]
    found: list[Any] = []
    push = settings.get("nonnegative")
    if push:
        named = isinstance(push, list | tuple)
        found.append(NonNegative([_index(one, labels, "nonnegative") for one in push] if named else None))
    bounds = settings.get("bounds")
    if isinstance(bounds, Mapping):
        at = [_index(name, labels, "bounds") for name in bounds]
        ends = np.array([_pair(bounds[name]) for name in bounds])
        found.append(Bounds(ends[:, 0], ends[:, 1], loads=at))
    elif bounds is not None:
        low, high = _pair(bounds)
        found.append(Bounds(low, high))
    if settings.get("acting") is not None:
        found.append(Support([_index(one, labels, "acting") for one in settings["acting"]]))
    if settings.get("resultant") is not None:
        found.append(_resultant(model, settings["resultant"]))
    return found


def _pair(value: Any) -> tuple[float, float]:
    ends = list(value) if isinstance(value, list | tuple) else []
    if len(ends) != 2 or not all(isinstance(one, int | float) and not math.isnan(one) for one in ends):
        raise InputError("no pair of limits", where="bounds", found=repr(value)[:80], expected="[low, high]")
    return float(ends[0]), float(ends[1])


def _resultant(model: Model, given: Any) -> Resultant:
    rows = {} if model.basis is None else dict(
        zip(model.basis.resultant_labels, np.asarray(model.basis.resultant(), float), strict=False)
    )  # fmt: skip
    if len({c.unit for c in model.loads}) == 1:
        rows.setdefault("sum", np.ones(len(model.loads)))
    if not isinstance(given, Mapping) or not given:
        raise InputError("no resultants", where="resultant", found=repr(given)[:80], expected="{Fz = 100.0}")
    for name in given:
        _index(name, list(rows), "resultant")
    pairs = [list(v) if isinstance(v, list | tuple) else [v, None] for v in given.values()]
    stated = [std for _, std in pairs if std is not None]
    if stated and len(stated) < len(pairs):
        raise InputError("some resultants have a std and some are exact", where="resultant",
                         found=repr(dict(given))[:80], expected="all of one kind")  # fmt: skip
    return Resultant(np.array([rows[name] for name in given]), [value for value, _ in pairs],
                     covariance=[std**2 for std in stated] or None, labels=tuple(given))  # fmt: skip


def noise(given: Any, labels: Sequence[str], used: Sequence[str]) -> Any:
    """Noise std as a family takes it, of the sensors that it uses; of a table by their names.

    Raises
    ------
    InputError
        A sensor that the model does not have, or one without its noise.
    """
    if isinstance(given, Mapping):
        for name in given:
            _index(name, labels, "noise")
        lacking = [label for label in used if label not in given]
        if lacking:
            raise InputError("the noise of a sensor is not stated", where="noise",
                             found=f"none of {', '.join(lacking)}",
                             expected="that of every sensor that is used",
                             hint="state all of them, one for all, or none")  # fmt: skip
        return [float(given[label]) for label in used]
    if isinstance(given, list | tuple) and len(given) == len(labels) != len(used):
        return [given[labels.index(label)] for label in used]
    return given


# -- data --------------------------------------------------------------------------------------------------------------
def responses_of(
    record: Record, model: Model, chosen: Sequence[str] | None, wanted: Sequence[str] | None = None
) -> Record:
    """The channels of a record that the model predicts, in the order and under the names of its sensors.

    Parameters
    ----------
    chosen : sequence of str, optional
        Channels, one for every sensor.
    wanted : sequence of str, optional
        Sensors that are used, where only some are.

    Raises
    ------
    InputError
        Too few or too many channels, one that is not there or given twice, or of another unit than its sensor.
    """
    from dataclasses import replace

    labels = [s.label for s in model.sensors]
    if chosen is None:
        return record.select(labels if wanted is None else [one for one in labels if one in wanted])
    if len(chosen) != len(labels):
        raise InputError(
            "one channel per sensor is needed",
            where="--response",
            found=f"{len(chosen)} channels: {', '.join(map(str, chosen))}",
            expected=f"{len(labels)}, for the sensors {', '.join(labels)}",
            hint="name one for every sensor of the model, in its order; for fewer sensors calibrate a model of them",
        )
    some = record.select(resolved(record, chosen, where="--response"))
    for channel, sensor in zip(some.channels, model.sensors, strict=True):
        if "arbitrary" not in (channel.unit, sensor.unit) and channel.unit != sensor.unit:
            raise InputError(
                f"channel {channel.label!r} is in another unit than the sensor {sensor.label!r} of the model",
                where="--response",
                found=f"{channel.unit} ({channel.quantity})",
                expected=f"{sensor.unit} ({sensor.quantity})",
                hint="name the channels in the order of the model's sensors, or correct the unit where the file has it "
                "wrong",
            )
    return replace(some, channels=tuple(replace(c, label=s) for c, s in zip(some.channels, labels, strict=True)))


def known_load(record: Record, model: Model, channel: str) -> NDArray[Any]:
    """The measured load, shape (samples,), that an estimate of this model can be compared with.

    Raises
    ------
    InputError
        A channel that is not there, in another unit than the load, or with gaps; a model of several loads.
    """
    import numpy as np

    column = record.index(channel)
    known, loads = record.channels[column], model.loads
    if len(loads) != 1:
        raise InputError("one load is compared with one channel", where="--truth",
                         found=f"{len(loads)} loads: {', '.join(c.label for c in loads)}",
                         expected="a model of one load", hint="leave --truth out")  # fmt: skip
    if "arbitrary" not in (known.unit, loads[0].unit) and known.unit != loads[0].unit:
        raise InputError(
            f"channel {known.label!r} is in another unit than the load",
            where="--truth",
            found=f"{known.unit} ({known.quantity})",
            expected=f"{loads[0].unit} ({loads[0].quantity})",
            hint=f"the channel is recorded as {known.quantity}: name the channel of the load, or correct the unit "
            "where the file has it wrong",
        )
    values = record.values[:, column]
    if not np.all(np.isfinite(values)) or not np.any(values):
        raise InputError(
            f"channel {known.label!r} is nothing to compare with",
            where="--truth",
            found=f"{int(np.sum(~np.isfinite(values)))} missing samples" if np.any(values) else "zero throughout",
            expected="a measured load without gaps",
            hint="leave --truth out, or name another channel",
        )
    return values


def sensor_table(path: str | Path, labels: Sequence[str]) -> dict[str, float] | None:
    """Readings of a text file with one row for each sensor, its name and its number; None where it is no such file.

    Raises
    ------
    InputError
        A sensor twice, or a text where a number is needed.
    """
    place = Path(path)
    try:
        if place.stat().st_size > BIGGEST or place.suffix.lower() not in (".csv", ".txt", ".tsv", ".dat"):
            return None
        text = place.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError):
        return None
    mark = max(";\t,", key=text.count)
    rows = [[cell.strip() for cell in row] for row in csv.reader(text.splitlines(), delimiter=mark) if any(row)]
    rows = rows[1:] if rows and rows[0][0].lower() in HEADS else rows
    named = [row for row in rows if row and row[0] in labels]
    if not named or len(named) < len(rows) or any(len(row) < 2 for row in rows):
        return None
    found: dict[str, float] = {}
    for name, cell, *_ in rows:
        if name in found:
            raise InputError(
                "a sensor has two readings", where=str(path), found=repr(name), expected="one row for each"
            )
        try:
            found[name] = float(cell.replace(",", ".") if mark != "," else cell)
        except ValueError:
            raise InputError("a reading is no number", where=f"{path}, {name}", found=repr(cell)[:40],
                             expected="a number in the unit of the sensor") from None  # fmt: skip
    return found


def reading(record: Record, settings: dict[str, Any]) -> Any:
    """Static readings of a record: every row one, the row `at` a time, or the `mean` over a window (taken out of
    `settings`).

    Raises
    ------
    InputError
        Both, or times beyond the record.
    """
    at, window = settings.pop("at", None), settings.pop("mean", None)
    if at is None and window is None:
        return record
    if at is not None and window is not None:
        raise InputError("a row or a mean", where="at", found="both", expected="one of the two")
    t = np.arange(len(record.values)) * record.dt
    low, high = (at, at) if window is None else window
    inside = _inside(record, low, high)
    if not inside.any() or low > t[-1] + 0.5 * record.dt or low < -0.5 * record.dt:
        raise InputError("no row of the record", where="at" if window is None else "mean",
                         found=f"{low:g} to {high:g} s", expected=f"times within 0 to {t[-1]:.6g} s")  # fmt: skip
    rows = record.values[inside] if window is not None else record.values[[int(np.argmin(np.abs(t - at)))]]
    if np.isnan(rows).all(axis=0).any():
        raise InputError("a channel has no sample there", where="mean", found=f"{low:g} to {high:g} s",
                         expected="samples of every channel")  # fmt: skip
    return dict(zip(record.labels, np.nanmean(rows, axis=0).tolist(), strict=True))


def _inside(record: Record, low: float, high: float) -> NDArray[np.bool_]:
    t = np.arange(len(record.values)) * record.dt
    return (t >= low - 0.5 * record.dt) & (t <= high + 0.5 * record.dt)


def lacking(record: Record, settings: Mapping[str, Any]) -> list[str]:
    """What is said of samples that a `mean` over a window lacks, of each channel that lacks some."""
    window = settings.get("mean")
    if window is None:
        return []
    gone = np.isnan(record.values[_inside(record, *window)])
    return [
        f"mean over {window[0]:g} to {window[1]:g} s: {count} of {len(gone)} samples of {label} are missing"
        for label, count in zip(record.labels, gone.sum(axis=0).tolist(), strict=True)
        if count
    ]


def require_frequency(settings: Mapping[str, Any]) -> None:
    """Nothing, unless a harmonic load is asked for without its frequency.

    Raises
    ------
    InputError
        What to state.
    """
    if settings.get("frequency") is None:
        raise InputError("at which frequency does the load act?", where="frequency", found="none stated",
                         expected="the frequency of the load in Hz",
                         hint="--frequency 25, or frequency = 25 in the job")  # fmt: skip


def candidates(model: Model, grid: Sequence[int]) -> Model:
    """The model with its first load at nodes spread evenly over the structure: those nearest the middle of equal parts.

    Raises
    ------
    InputError
        A model without places, another number of parts than the structure has dimensions, a load that is no force.
    """
    from structures import Dof, loads

    structure = model.structure
    outline = None if structure is None else structure.coordinates
    if structure is None or outline is None or not model.loads or model.loads[0].quantity != "force":
        raise InputError("the model does not know where a force could act", where="grid", found=type(model).__name__,
                         expected="a ForwardModel with a point force, of a structure that knows its places",
                         hint="make a model whose loads are the candidates")  # fmt: skip
    column = np.asarray(model.loads[0].shape(structure))  # type: ignore[attr-defined]
    pushed = np.array([abs(dof.direction) <= 3 for dof in structure.dofs]) * np.abs(column)
    direction = structure.dofs[int(np.argmax(pushed))].direction * int(np.sign(column[int(np.argmax(pushed))]) or 1)
    numbers = sorted({dof.node for dof in structure.dofs})
    nodes = [structure.dofs[i].node for i in structure.free if structure.dofs[i].direction == abs(direction)]
    there = np.asarray(outline, float)[[numbers.index(node) for node in nodes]]
    spread = np.flatnonzero(np.ptp(there, axis=0) > 0)
    listed: list[Any] = list(grid) if isinstance(grid, list | tuple) else [grid]
    counts = [int(n) for n in listed]
    if len(counts) != len(spread) or int(np.prod(counts)) < 2:
        raise InputError("the grid does not fit the structure", where="grid", found="x".join(map(str, counts)),
                         expected=f"{len(spread)} numbers of parts, two places or more")  # fmt: skip
    low, high = there[:, spread].min(axis=0), there[:, spread].max(axis=0)
    axes = [a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(low, high, counts, strict=True)]
    wanted = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    nearest = {int(np.argmin(np.linalg.norm(there[:, spread] - place, axis=1))) for place in wanted}
    return model.with_loads([loads.Point(Dof(nodes[i], direction)) for i in sorted(nearest)])


def held_out(estimate: LoadEstimate, model: Model, record: Any, labels: Sequence[str]) -> LoadEstimate:
    """The estimate with the prediction errors of sensors that were kept out among its facts."""
    from .._results.facts import Facts

    errors = predicted(estimate, model, record, labels)
    told = tuple(f"{label} {error:.2%}" for label, error in errors.items())
    return replace(estimate, facts=Facts.of({**estimate.facts, "held_out": told}))


def predicted(estimate: LoadEstimate, model: Model, record: Any, labels: Sequence[str]) -> dict[str, float]:
    """Prediction error of sensors that were kept out, relative to what they measured."""
    rows = [[c.label for c in model.sensors].index(label) for label in labels]
    if isinstance(record, Mapping):
        measured = np.array([[record[label] for label in labels]], float)
    else:
        measured = record.select(resolved(record, labels, where="validation")).values
    load = np.asarray(estimate.load)
    if estimate.axis is not None and estimate.axis.name == "time" and model.gives("impulse_response") and _histories(
        estimate
    ):  # fmt: skip
        hold = estimate.provenance.get("settings", {}).get("hold") or model.default_hold
        made = model.predict(load, estimate.over("time").step, hold)[:, rows]
    else:
        made = np.atleast_2d(load) @ model.static()[rows].T
    measured = measured[: len(made)]
    rest = np.where(np.isnan(measured), 0.0, measured - made)
    size = np.sqrt(np.nansum(measured**2, axis=0))
    errors = np.linalg.norm(rest, axis=0) / np.maximum(size, np.finfo(float).tiny)
    return dict(zip(labels, errors.tolist(), strict=True))


def _histories(estimate: LoadEstimate) -> bool:
    """Whether a load over time is a history, and no row of static readings."""
    from .._results.facts import STATIC

    return bool(estimate.provenance.get("family") != STATIC)
