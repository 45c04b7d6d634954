"""The FRFs of a universal file as one table: every response to every reference on the same lines, or a refusal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .. import units
from .frf_table import Asked, Found, refuse
from .uff import UffFile
from .uff_functions import COHERENCE, FRF, MULTIPLE_COHERENCE, Function
from .uff_units import Said, ratio, unit_of

_SAME_LINES = 1e-6  # of the spacing


def of_uff(file: UffFile, asked: Asked) -> Found:
    """The table of all FRFs of a universal file, or of those that are asked for.

    Raises
    ------
    InputError
        No FRF, pairs that are missing or doubled, lines or units that differ.
    """
    pairs: dict[tuple[str, str], Function] = {}
    for function in (f for f in file.functions if f.head.function == FRF):
        pair = (function.response or "0+S", function.reference or "0+S")
        if pair in pairs:
            refuse(
                file.path,
                "a pair of response and reference comes twice",
                f"{pair[0]} / {pair[1]} in lines {pairs[pair].line} and {function.line}",
                "each pair once",
                "export one version of each FRF, with the DOF of response and reference",
            )
        pairs[pair] = function
    if not pairs:
        refuse(file.path, "the file holds no FRF", file.holds(), "functions of type 4", "loadid.read reads a record")
    responses = _chosen(asked.responses, [r for r, _ in pairs], "responses", file.path)
    references = _chosen(asked.references, [c for _, c in pairs], "references", file.path)
    missing = [f"{r} / {c}" for r in responses for c in references if (r, c) not in pairs]
    if missing:
        refuse(
            file.path,
            f"{len(missing)} of {len(responses) * len(references)} pairs of response and reference are missing",
            ", ".join(missing[:12]) + (", ..." if len(missing) > 12 else ""),
            "an FRF of every response to every reference",
            "choose with responses= and references=, or export all of them in one file",
        )
    rows = [[pairs[r, c] for c in references] for r in responses]
    first = rows[0][0]
    lines = _hertz(first, file.path)
    for function in (f for row in rows for f in row):
        _check_lines(function, first, file.path)
    H = np.stack([np.stack([f.values for f in row], axis=1) for row in rows], axis=1)
    said = [[_said(f, file) for f in row] for row in rows]
    return Found(
        lines,
        H,
        responses,
        references,
        tuple(_agreed([pair[0] for pair in row], r, file.path) for r, row in zip(responses, said, strict=True)),
        tuple(_agreed([row[j][1] for row in said], c, file.path) for j, c in enumerate(references)),
        _coherence(file, first, responses, references),
        (*file.notes, *dict.fromkeys(note for row in rows for f in row for note in f.notes)),
    )


def _said(function: Function, file: UffFile) -> tuple[Said, Said]:
    """Units of response and reference of one FRF."""
    _, over, under, _ = function.head.axes
    both = ratio(over.unit)
    if both and not under.unit:  # one text for both, such as g/N
        left, right = (units.parse(text) for text in both)
        return Said(left, left.quantity), Said(right, right.quantity)
    return (
        unit_of(over, function.head.response[2], file.system),
        unit_of(under, function.head.reference[2], file.system),
    )


def _agreed(said: list[Said], label: str, path: str) -> Said:
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


def _hertz(function: Function, path: str) -> NDArray[np.float64]:
    """Lines of an FRF in Hz."""
    text = function.axis.unit
    unit = units.parse(text) if text and units.known(text) else None
    if function.axis.type not in (0, 1, 18) or (text and (unit is None or unit.quantity != "frequency")):
        refuse(
            path,
            "the abscissa of an FRF is no frequency",
            f"line {function.line}: data type {function.axis.type}, unit {text or 'not named'}",
            "data type 18 and Hz",
            "export it again over frequency",
        )
    return function.abscissa * (unit.factor if unit else 1.0)


def _check_lines(function: Function, first: Function, path: str) -> None:
    a, b = first.abscissa, function.abscissa
    same = len(a) == len(b) and function.axis.unit == first.axis.unit
    if same and len(a) > 1:
        same = bool(np.max(np.abs(a - b)) <= _SAME_LINES * np.min(np.diff(a)))
    if not same or (len(a) == 1 and a[0] != b[0]):
        refuse(
            path,
            f"{function.response} / {function.reference} has other lines than {first.response} / {first.reference}",
            f"{len(b)} lines, {b[0]:.6g} to {b[-1]:.6g}",
            f"{len(a)} lines, {a[0]:.6g} to {a[-1]:.6g}",
            "export all FRFs with the same lines, or choose with responses= and references=",
        )


def _coherence(
    file: UffFile, first: Function, responses: tuple[str, ...], references: tuple[str, ...]
) -> NDArray[np.float64] | None:
    """Coherence (lines, responses), the multiple one where there are several references; None if one lacks."""
    wanted = MULTIPLE_COHERENCE if len(references) > 1 else COHERENCE
    found = {
        f.response: f.values.real
        for f in file.functions
        if f.head.function in (wanted, MULTIPLE_COHERENCE)
        and (f.head.function == MULTIPLE_COHERENCE or f.reference == references[0])
        and f.step == first.step
        and np.array_equal(f.abscissa, first.abscissa)
    }
    if not all(r in found for r in responses):
        return None
    table = np.stack([found[r] for r in responses], axis=1)
    return table if np.all((table >= 0) & (table <= 1)) else None


def _chosen(asked: tuple[str, ...] | None, found: list[str], what: str, path: str) -> tuple[str, ...]:
    known = list(dict.fromkeys(found))
    if asked is None:
        return tuple(known)
    for label in asked:
        if label not in known:
            refuse(path, f"{label} is none of the {what}", ", ".join(known[:30]), f"one of these {what}")
    return asked
