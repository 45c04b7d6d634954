"""Functions of files that hold them one by one: time responses and FRFs of SDynPy, of MAT structs and text tables.

SDynPy (`sdynpy.data.NDDataArray.save`, release 0.23) writes a structured array ``data`` with the fields abscissa,
ordinate, comments and coordinate (node, direction), and ``function_type``, the code of universal files; a compressed
abscissa is kept as ``abscissa_start`` and ``abscissa_step``. It states no units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._channels import Dof
from ..errors import InputError
from ._recorded import Asked, RecordedFrfs, StatedUnit, agreed, paired, refuse

TIME, FRF = 1, 4  # function types, as in data set 58
KINDS = {0: "general function", 1: "time response", 2: "autospectrum", 3: "cross spectrum", 4: "FRF", 6: "coherence",
         9: "PSD", 12: "spectrum"}  # fmt: skip
SAME = 1e-6  # of the spacing: lines that are the same
OPEN = StatedUnit(None, None, "the file states no unit")


@dataclass(frozen=True, eq=False)
class Trace:
    """One function of a file.

    Parameters
    ----------
    type : int
        1 time response, 4 FRF, as in data set 58.
    x : array, shape (n,)
        Times in s or frequencies in Hz.
    values : array, shape (n,)
    response, reference : str
        Labels, "" where the file names none.
    unit, reference_unit : StatedUnit
    step : float or None
        Of an even abscissa that the file states so.
    """

    type: int
    x: NDArray[np.float64]
    values: NDArray[np.float64 | np.complex128]
    response: str
    reference: str = ""
    unit: StatedUnit = OPEN
    reference_unit: StatedUnit = OPEN
    step: float | None = None


def held(curves: Sequence[Trace]) -> str:
    """How many functions of which kind there are, for messages."""
    words = [KINDS.get(c.type, f"function of type {c.type}") for c in curves]
    return ", ".join(f"{words.count(w)} x {w}" for w in dict.fromkeys(words)) or "no function"


def of_curves(curves: Sequence[Trace], asked: Asked) -> RecordedFrfs:
    """The table of the FRFs among some curves.

    Raises
    ------
    InputError
        None, pairs that are missing or doubled, lines or units that differ.
    """
    pairs: dict[tuple[str, str], Trace] = {}
    for curve in (c for c in curves if c.type == FRF):
        pair = (curve.response or "response", curve.reference or "reference")
        if pair in pairs:
            refuse(asked.path, "a pair of response and reference comes twice", " / ".join(pair), "each pair once",
                   "export one version of each FRF, with the labels of response and reference")  # fmt: skip
        pairs[pair] = curve
    if not pairs:
        refuse(asked.path, "the file holds no FRF", held(curves), "FRFs", "loadid.read reads a record over time")
    responses, references, rows = paired(pairs, asked)
    first = rows[0][0]
    for curve in (c for row in rows for c in row):
        near = np.max(np.diff(first.x), initial=0.0) if len(first.x) > 1 else 1.0
        if curve.x.shape != first.x.shape or np.max(np.abs(curve.x - first.x)) > SAME * near:
            refuse(asked.path, f"{curve.response} / {curve.reference} has other lines than {first.response} / "
                   f"{first.reference}", f"{len(curve.x)} lines", f"{len(first.x)}, the same for all",
                   "export all FRFs with the same lines, or choose with responses= and references=")  # fmt: skip
    H = np.stack([np.stack([c.values for c in row], axis=1) for row in rows], axis=1).astype(complex)
    return RecordedFrfs(
        first.x,
        H,
        responses,
        references,
        tuple(agreed([c.unit for c in row], r, asked.path) for r, row in zip(responses, rows, strict=True)),
        tuple(agreed([row[j].reference_unit for row in rows], c, asked.path) for j, c in enumerate(references)),
    )


def renamed(curves: Sequence[Trace], asked: Asked) -> list[Trace]:
    """FRFs of a file that names no degrees of freedom, with those that the caller states, references running first.

    Raises
    ------
    InputError
        Labels that are not as many as the FRFs.
    """
    named = all(c.response and c.reference for c in curves)
    if named or (asked.responses is None and asked.references is None):
        return list(curves)
    responses = asked.responses or tuple(dict.fromkeys(c.response for c in curves))
    references = asked.references or ("reference",)
    if len(curves) != len(responses) * len(references):
        refuse(asked.path, "the labels do not fit the columns", f"{len(responses)} responses, {len(references)} "
               f"references", f"{len(curves)} FRFs", "state them in the order of the columns")  # fmt: skip
    pairs = [(r, c) for r in responses for c in references]
    return [replace(c, response=r, reference=f) for c, (r, f) in zip(curves, pairs, strict=True)]


def label_of(text: str) -> str:
    """A DOF in its one form where a text is one, ``12:+Z`` or ``Point12:+Z``; any other name as it is."""
    bare = text.strip()
    try:
        return str(Dof.parse(bare))
    except InputError:
        return bare


def read_sdynpy(path: str | Path) -> list[Trace]:
    """Functions of an archive that SDynPy saved; its objects, if it holds any, are never unpickled.

    Raises
    ------
    InputError
        It is no such archive, or a damaged one.
    """
    from ._container import open_npz

    arrays = open_npz(Path(path)).arrays
    if not {"data", "function_type"} <= set(arrays):
        refuse(str(path), "no archive of SDynPy", ", ".join(arrays)[:200] or "nothing", "data and function_type")
    kind, data = arrays["function_type"](), np.ravel(arrays["data"]())
    names = data.dtype.names or ()
    if kind.size != 1 or kind.dtype.kind not in "iu" or not {"ordinate", "coordinate"} <= set(names) or not data.size:
        refuse(str(path), "no data array of SDynPy", f"fields {', '.join(names)}", "abscissa, ordinate, coordinate")
    ordinate = data["ordinate"].reshape(len(data), -1)
    if "abscissa" in names:
        abscissa = np.asarray(data["abscissa"], float).reshape(len(data), -1)
    else:
        parts = [arrays[k]() for k in ("abscissa_start", "abscissa_step") if k in arrays]
        if len(parts) != 2 or any(p.size != 1 or p.dtype.kind not in "iuf" for p in parts):
            refuse(str(path), "the abscissa is not there", ", ".join(arrays)[:200], "abscissa_start and abscissa_step")
        start, step = (float(p.reshape(-1)[0]) for p in parts)
        if not (math.isfinite(start) and math.isfinite(step) and step > 0):
            refuse(str(path), "the abscissa does not rise", f"from {start:g} in steps of {step:g}", "a step > 0")
        abscissa = np.broadcast_to(start + np.arange(ordinate.shape[1]) * step, ordinate.shape)
    if ordinate.dtype.kind not in "fiuc" or abscissa.shape != ordinate.shape:
        refuse(str(path), "no data array of SDynPy", f"ordinate {data['ordinate'].dtype}", "numbers over an abscissa")
    curves = []
    for x, y, where in zip(abscissa, ordinate, data["coordinate"], strict=True):
        labels = [_coordinate(c, str(path)) for c in np.ravel(where)]
        response, reference = (*labels, "", "")[:2]
        curves.append(Trace(int(kind.reshape(-1)[0]), x, y, response, reference))
    return curves


def _coordinate(entry: np.void, path: str) -> str:
    if not {"node", "direction"} <= set(entry.dtype.names or ()):
        refuse(path, "no coordinate of SDynPy", str(entry.dtype)[:80], "node and direction")
    return str(Dof(int(entry["node"]), int(entry["direction"])))
