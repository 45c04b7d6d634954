"""FRFs as a file records them: what was asked of it, the pairs of response and reference, units and lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import units
from .._channels import Dof
from ..errors import InputError

Units = str | Mapping[str, str] | None
T = TypeVar("T")


@dataclass(frozen=True)
class StatedUnit:
    """What a file says of a unit: itself or None, the quantity where the type tells it, why there is no unit."""

    unit: units.Unit | None
    quantity: str | None = None
    why: str = ""


@dataclass(frozen=True)
class Asked:
    """What the caller stated."""

    path: str
    kind: str | None
    responses: tuple[str, ...] | None
    references: tuple[str, ...] | None
    response_unit: Units
    reference_unit: Units


@dataclass(frozen=True)
class RecordedFrfs:
    """FRFs as recorded: lines (Hz), table (lines, responses, references), labels, units, coherence, decisions."""

    frequencies: NDArray[np.float64]
    H: NDArray[np.complex128]
    responses: tuple[str, ...]
    references: tuple[str, ...]
    response_units: tuple[StatedUnit, ...]
    reference_units: tuple[StatedUnit, ...]
    coherence: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()


def refuse(where: str, what: str, found: object, expected: object, hint: str = "") -> NoReturn:
    """Raise an InputError that names the file."""
    raise InputError(what, where=where, found=found, expected=expected, hint=hint)


def paired(pairs: Mapping[tuple[str, str], T], asked: Asked) -> tuple[tuple[str, ...], tuple[str, ...], list[list[T]]]:
    """Responses, references and the table of what a file holds for each pair of them.

    Raises
    ------
    InputError
        Labels that are not there, or pairs that are missing.
    """
    responses = chosen(asked.responses, [r for r, _ in pairs], "responses", asked.path)
    references = chosen(asked.references, [c for _, c in pairs], "references", asked.path)
    missing = [f"{r} / {c}" for r in responses for c in references if (r, c) not in pairs]
    if missing:
        refuse(
            asked.path,
            f"{len(missing)} of {len(responses) * len(references)} pairs of response and reference are missing",
            ", ".join(missing[:12]) + (", ..." if len(missing) > 12 else ""),
            "an FRF of every response to every reference",
            "choose with responses= and references=, or export all of them in one file",
        )
    return responses, references, [[pairs[r, c] for c in references] for r in responses]


def agreed(said: list[StatedUnit], label: str, path: str) -> StatedUnit:
    """The unit of a response or reference that all its FRFs state."""
    for other in said[1:]:
        a, b = said[0], other
        if (a.quantity, a.unit and (a.unit.factor, a.unit.dimension)) != (
            b.quantity,
            b.unit and (b.unit.factor, b.unit.dimension),
        ):
            refuse(
                path,
                f"the FRFs of {label} are in different units",
                " and ".join(str(s.unit.symbol if s.unit else s.why) for s in (a, b)),
                "one unit",
                "export them in one unit",
            )
    return said[0]


def chosen(asked: tuple[str, ...] | None, found: list[str], what: str, path: str) -> tuple[str, ...]:
    known = list(dict.fromkeys(found))
    if asked is None:
        return tuple(known)
    for label in asked:
        if label not in known:
            refuse(path, f"{label} is none of the {what}", ", ".join(known[:30]), f"one of these {what}")
    return asked


def labels_of(given: Sequence[Any] | None, what: str) -> tuple[str, ...] | None:
    """Labels of DOFs in their one form, and names as they are."""
    if given is None:
        return None
    if isinstance(given, str) or not isinstance(given, Sequence) or not given:
        raise InputError(
            "no list of DOFs", where=f"read_frfs, {what}", found=repr(given)[:60], expected='["1+Z", "2+Z"]'
        )
    labels = tuple(_label(g) for g in given)
    if len(set(labels)) < len(labels):
        refuse(f"read_frfs, {what}", f"{what} are doubled", labels, "each once")
    return labels


def _label(given: Any) -> str:
    try:
        return str(Dof.parse(given))
    except InputError:
        if not isinstance(given, str) or not given.strip():
            raise
        return given.strip()
