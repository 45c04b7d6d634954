"""MAT structs as Simcenter Testlab (LMS Test.Lab) exports them: a struct for each block, its channels side by side.

The fields, as public scripts and data sets use them (the bearing data of KAIST, "Vibration, acoustic, temperature, and
motor current dataset of rotating machine", doi:10.1016/j.dib.2023.109049, and readers of such exports): ``x_values``
with start_value, increment, number_of_values (or values) and quantity.label; ``y_values`` with values, (samples,) or
(samples, channels), and quantity.label, in which the numbers are; ``function_record`` with type ("Signal", "FRF",
"Coherence", ...), name (a text, or a cell of one for each channel), primary_channel and reference_channel (label, name,
direction). A ``quantity.unit_transformation.factor`` that contradicts the label leaves the unit open.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import units
from ._curves import FRF, OPEN, TIME, Trace, label_of
from ._recorded import StatedUnit, refuse
from ._uff import ratio

TYPES = {"signal": TIME, "time": TIME, "frf": FRF, "frequencyresponsefunction": FRF, "coherence": 6, "psd": 9,
         "autopowerspectrum": 2, "crosspowerspectrum": 3, "frequencyspectrum": 12}  # fmt: skip
DEPTH = 3  # levels of structs above a block
AGREE = 1e-3  # relative difference of factors that is one of digits


def blocks_of(tree: dict[str, Any], depth: int = 0) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names and structs with ``x_values`` and ``y_values``, wherever they lie."""
    for name, value in tree.items():
        for one in value if isinstance(value, list) else [value]:
            if not isinstance(one, dict):
                continue
            if isinstance(one.get("x_values"), dict) and isinstance(one.get("y_values"), dict):
                yield name, one
            elif depth < DEPTH:
                yield from ((f"{name}.{below}", block) for below, block in blocks_of(one, depth + 1))


def curves_of(name: str, block: dict[str, Any], path: str) -> list[Trace]:
    """Channels of one block.

    Raises
    ------
    InputError
        Values that are not as many as the block declares, or no abscissa.
    """
    where = f"{path}, {name}"
    values = _values(block["y_values"].get("values"), where)
    x, step, abscissa = _abscissa(block["x_values"], len(values), where)
    record = block.get("function_record")
    record = record if isinstance(record, dict) else {}
    kind = TYPES.get(_text(record.get("type")).lower().replace(" ", ""), 0)
    if not kind:
        kind = TIME if abscissa == "time" and values.dtype.kind != "c" else FRF if values.dtype.kind == "c" else 0
    over, under = _units(block["y_values"].get("quantity"), kind)
    count = values.shape[1]
    names, channels = _texts(record.get("name"), count), _labels(record.get("primary_channel"), count)
    references = _labels(record.get("reference_channel"), count)
    curves = []
    for k in range(count):
        label = channels[k] or (names[k] if names[k] else name if count == 1 else f"{name} {k + 1}")
        response, reference = label, references[k]
        if kind == FRF and not channels[k] and "/" in label:
            response, _, reference = label.partition("/")
        curves.append(Trace(kind, x, values[:, k], label_of(response), label_of(reference) if reference else "",
                            over, under, step))  # fmt: skip
    return curves


def _values(values: Any, where: str) -> NDArray[Any]:
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiuc" or not values.size or values.ndim != 2:
        refuse(
            where, "the block holds no values", type(values).__name__, "y_values.values: numbers, (samples, channels)"
        )
    return values.reshape(-1, 1) if values.shape[0] == 1 else values


def _abscissa(block: dict[str, Any], count: int, where: str) -> tuple[NDArray[np.float64], float | None, str]:
    """Abscissa in s or Hz, its step where it is even, and its quantity."""
    quantity = block.get("quantity")
    text = _text(quantity.get("label")) if isinstance(quantity, dict) else ""
    unit = units.parse(text or "s", where=where) if not text or units.known(text) else None
    if unit is None or unit.quantity not in ("time", "frequency"):
        refuse(where, "the abscissa is neither time nor frequency", repr(text), "s or Hz")
    listed = block.get("values")
    if isinstance(listed, np.ndarray) and listed.size > 1:
        if listed.size != count or listed.dtype.kind not in "fiu":
            refuse(where, f"{listed.size} abscissae for {count} values", None, "one for each value")
        return np.ravel(listed).astype(float) * unit.factor, None, unit.quantity
    start, step, declared = (_number(block.get(k)) for k in ("start_value", "increment", "number_of_values"))
    if declared != count:
        refuse(where, f"truncated: {count} of {declared} values", None, "as many as number_of_values")
    if start is None or step is None or step <= 0:
        refuse(where, "the block states no step", f"start_value {start}, increment {step}", "an increment > 0")
    return np.asarray((start + np.arange(count) * step) * unit.factor, float), step * unit.factor, unit.quantity


def _units(quantity: Any, kind: int) -> tuple[StatedUnit, StatedUnit]:
    """Units of the values: of a response and, of an FRF, of the reference too."""
    text = _text(quantity.get("label")) if isinstance(quantity, dict) else ""
    change = quantity.get("unit_transformation") if isinstance(quantity, dict) else None
    factor = _number(change.get("factor")) if isinstance(change, dict) else None
    offset = _number(change.get("offset")) if isinstance(change, dict) else None
    if not text:
        return OPEN, OPEN
    both = ratio(text) if kind == FRF else None
    parts = [units.parse(t) for t in both] if both else [units.parse(text)] if units.known(text) else []
    if not parts:
        unknown = StatedUnit(None, None, f"its unit reads {text!r}, which is not known")
        return unknown, unknown
    size = parts[0].factor / (parts[1].factor if both else 1.0)
    if offset or (factor and abs(factor - 1) > AGREE and abs(factor / size - 1) > AGREE):
        why = f"its unit reads {text!r}, and its transformation to SI has the factor {factor:g}, offset {offset or 0:g}"
        return StatedUnit(None, None, why), StatedUnit(None, None, why)
    over = StatedUnit(parts[0], parts[0].quantity)
    return over, StatedUnit(parts[1], parts[1].quantity) if both else OPEN


def _labels(channel: Any, count: int) -> list[str]:
    """Labels of channels, "" where there is none: of one struct with texts, with cells, or of one struct for each."""
    if isinstance(channel, list) and len(channel) == count:
        return [_labels(one, 1)[0] for one in channel]
    if not isinstance(channel, dict):
        return [""] * count
    names = _texts(channel.get("label", channel.get("name")), count)
    ways = _texts(channel.get("direction"), count)
    return [f"{n}:{w}" if n and w and w.upper() not in ("S", "NONE") else n for n, w in zip(names, ways, strict=True)]


def _texts(value: Any, count: int) -> list[str]:
    if isinstance(value, list) and len(value) == count:
        return [_text(v) for v in value]
    text = _text(value)
    return [text] if count == 1 else [""] * count


def _text(value: Any) -> str:
    if isinstance(value, list) and len(value) == 1:
        value = value[0]
    return value.strip() if isinstance(value, str) else ""


def _number(value: Any) -> float | None:
    if isinstance(value, np.ndarray) and value.size == 1 and value.dtype.kind in "fiu":
        number = float(value.reshape(-1)[0])
        return number if np.isfinite(number) else None
    return None
