"""read_frfs: FRFs of a universal file or of a MAT file as a model, with DOF, unit and kind or not at all."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import units
from .._channels import Channel
from .._models.tabulated import FrfModel
from .._testing import kinds
from ..errors import InputError
from ._curves import of_curves, read_sdynpy, renamed
from ._frf_text import TEXT, read_text
from ._hdf5 import MatFile, read_mat
from ._recorded import Asked, RecordedFrfs, StatedUnit, Units, agreed, labels_of, paired, refuse
from ._storage import as_path
from ._uff import SUFFIXES, UffFile, ratio, read_uff, unit_of
from ._uff_datasets import COHERENCE, FRF, MULTIPLE_COHERENCE, Function

if TYPE_CHECKING:
    from .._models.tabulated import FrfModel


def read_frfs(
    path: str | os.PathLike[str],
    *,
    kind: str | None = None,
    responses: Sequence[Any] | None = None,
    references: Sequence[Any] | None = None,
    response_unit: Units = None,
    reference_unit: Units = None,
    frf: str | None = None,
    frequencies: str | None = None,
    axes: Sequence[str] | None = None,
    frequency_unit: str = "Hz",
) -> FrfModel:
    """FRFs of a file, in SI.

    Universal files (UFF, UNV: data sets 58 and 58b), MAT files (-v6, -v7, -v7.3: arrays; -v6, -v7: structs of
    Simcenter Testlab), archives of SDynPy (.npz), and text tables over frequency with real and imaginary parts or
    magnitudes and phases.

    Parameters
    ----------
    path : path
    kind : {"accelerance", "mobility", "receptance"}, optional
        Needed where the file does not say what the responses are; must agree where it does.
    responses, references : sequence of DOFs or names, optional
        Which of them, in this order; all if left out. A MAT file of arrays names none: they are needed, in the order
        of the array; so does a text table whose headings name none.
    response_unit, reference_unit : str or dict, optional
        Units of the numbers where the file does not state them, for all or by label: ``"g"``, ``{"12+Z": "m/s^2"}``.
    frf, frequencies : str, optional
        Names of the arrays of a MAT file.
    axes : sequence of str, optional
        What the axes of that array are, such as ``("responses", "references", "lines")``; needed where the shape
        leaves it open.
    frequency_unit : str
        Unit of the frequencies of a MAT file or of a text table that names none, ``Hz`` or ``rad/s``.

    Returns
    -------
    FrfModel
        Coherences (of one reference, or multiple ones) come with it where the file has one for every response.

    Raises
    ------
    InputError
        A file that is truncated or damaged; pairs of response and reference that are missing, doubled or on other
        lines, by name; a unit, a DOF or (LID-W208) a kind that neither file nor caller states.
    """
    place = as_path(path)
    suffix = place.suffix.lower()
    asked = Asked(str(place), kind, labels_of(responses, "responses"), labels_of(references, "references"),
                   response_unit, reference_unit)  # fmt: skip
    if suffix in SUFFIXES:
        return _model(of_uff(read_uff(place), asked), asked)
    if suffix == ".mat":
        found = None if frf else _structs(place, asked)
        if found is None:
            found = of_mat(read_mat(place), asked, frf, frequencies, axes, frequency_unit)
            kinds.check(kind, asked.path)  # nothing else says it
        return _model(found, asked)
    if suffix == ".npz":
        return _model(of_curves(read_sdynpy(place), asked), asked)
    if suffix in TEXT:
        return _model(of_curves(renamed(read_text(place, frequency_unit), asked), asked), asked)
    raise InputError(
        "a file of a kind that holds no FRFs",
        where=str(place),
        found=place.suffix or "no suffix",
        expected=", ".join([*SUFFIXES, ".mat", ".npz", *TEXT]),
        hint="FrfModel.from_frf(frequencies, H, kind=...) takes arrays",
    )


def _structs(place: Path, asked: Asked) -> RecordedFrfs | None:
    """FRFs of the structs of a MAT file of level 5; None where it holds no such struct."""
    from ._mat_level5 import LEVEL5_BUDGET, is_level5, read_structs
    from ._simcenter import blocks_of, curves_of

    if not place.is_file() or place.stat().st_size > LEVEL5_BUDGET or not is_level5(place.read_bytes()[:128]):
        return None
    blocks = list(blocks_of(read_structs(place.read_bytes(), str(place))))
    curves = [c for name, block in blocks for c in curves_of(name, block, str(place))]
    return of_curves(curves, asked) if curves else None


def _model(found: RecordedFrfs, asked: Asked) -> FrfModel:
    """The model, in SI, with described channels; what was decided while reading is logged."""
    for note in found.notes:
        logging.getLogger(__name__).info("%s: %s", asked.path, note)

    _refuse_open(found, asked)
    rows = [
        _settled(label, said, asked.response_unit, asked.path)
        for label, said in zip(found.responses, found.response_units, strict=True)
    ]
    columns = [
        _settled(label, said, asked.reference_unit, asked.path)
        for label, said in zip(found.references, found.reference_units, strict=True)
    ]
    sensors = [Channel(label=n, quantity=u.quantity, unit=u.si) for n, u in zip(found.responses, rows, strict=True)]
    loads = [Channel(label=n, quantity=u.quantity, unit=u.si) for n, u in zip(found.references, columns, strict=True)]
    _check_kind(sensors, asked)
    with np.errstate(over="ignore", invalid="ignore"):  # the model refuses what is not finite
        H = found.H * (np.array([u.factor for u in rows])[:, None] / np.array([u.factor for u in columns]))
    try:
        model = FrfModel(found.frequencies, H, sensors=sensors, loads=loads, coherence=found.coherence)
    except InputError as error:
        raise InputError(
            error.what,
            where=f"{asked.path}: {error.where}",
            found=error.found,
            expected=error.expected,
            hint=error.hint,
            code=error.code,
        ) from None
    return model.judged()


def _stated(label: str, stated: Units) -> str | None:
    """What the caller says of the unit of one channel."""
    return stated.get(label) if isinstance(stated, Mapping) else stated


def _refuse_open(found: RecordedFrfs, asked: Asked) -> None:
    """Nothing, if the unit of every channel is known; else an error that names all that are open."""
    open_: dict[str, list[tuple[str, StatedUnit]]] = {}
    for argument, labels, said, stated in (
        ("response_unit", found.responses, found.response_units, asked.response_unit),
        ("reference_unit", found.references, found.reference_units, asked.reference_unit),
    ):
        lacking = [(n, s) for n, s in zip(labels, said, strict=True) if s.unit is None and _stated(n, stated) is None]
        if lacking:
            open_[argument] = lacking
    if not open_:
        return
    every = [pair for pairs in open_.values() for pair in pairs]
    names = ", ".join([f"{n}{f' ({s.quantity})' if s.quantity else ''}" for n, s in every][:50])
    hints = [
        f'{a}="{_example(pairs[0][1])}"' if len({s.quantity for _, s in pairs}) == 1
        else f'{a}={{"{pairs[0][0]}": "{_example(pairs[0][1])}", ...}}'
        for a, pairs in open_.items()
    ]  # fmt: skip
    raise InputError(
        f"the unit of {names} is not known" if len(every) == 1 else f"the units of {names} are not known",
        where=asked.path,
        found="; ".join(dict.fromkeys(s.why for _, s in every)),
        expected="a unit for each, such as m/s^2, g, N",
        hint="state it: " + " and ".join(hints),
        code="LID-W208",
    )


def _example(said: StatedUnit) -> str:
    return units.si_symbol(said.quantity) if said.quantity and said.quantity != "other" else "UNIT"


def _settled(label: str, said: StatedUnit, stated: Units, path: str) -> units.Unit:
    """The unit of one channel: what the caller states, else what the file says."""
    text = _stated(label, stated)
    if text is None:
        assert said.unit is not None  # refused before
        return said.unit
    unit = units.stated(text, channel=label, where=path)
    if said.quantity is not None and unit.quantity != said.quantity:
        refuse(path, f"the unit of {label} contradicts the file", f"{unit.symbol} ({unit.quantity})", said.quantity)
    return unit


def _check_kind(sensors: Sequence[Channel], asked: Asked) -> None:
    """Refuse a kind that is missing, or that contradicts the quantities of the responses.

    Motions of several kinds, turning ones and strains may stand side by side: each sensor says what it is.
    """
    found = {s.quantity for s in sensors}
    if "arbitrary" in found:  # nothing else says it
        kinds.check(asked.kind, asked.path)
    if asked.kind is None:
        return
    own = {kinds.QUANTITY[kinds.check(asked.kind, asked.path)]}
    if found & set(kinds.ORDER) and found & set(kinds.ORDER) != own:
        raise InputError(
            f"the responses are {' and '.join(sorted(found))}, and kind={asked.kind!r} is stated",
            where=asked.path,
            found=", ".join(k for k, quantity in kinds.QUANTITY.items() if quantity in found),
            expected=asked.kind,
            hint="leave kind out where the file says it, and convert with model.as_kind(...)",
            code="LID-W208",
        )


ROLES = ("lines", "responses", "references")


def of_mat(
    file: MatFile, asked: Asked, frf: str | None, frequencies: str | None, axes: Sequence[str] | None, unit: str
) -> RecordedFrfs:
    """The table of FRFs that two arrays of a MAT file hold.

    Raises
    ------
    InputError
        Arrays or labels that are not named, or axes that the shape does not tell apart.
    """
    for name, value, what in (("frf", frf, "FRFs"), ("frequencies", frequencies, "frequencies")):
        if not isinstance(value, str):
            refuse(
                file.path,
                f"which array holds the {what}?",
                ", ".join(f"{k} {'x'.join(map(str, v.shape))}" for k, v in file.arrays.items())[:400] or "no array",
                "the name of one",
                f'{name}="..."',
            )
    for name, labels in (("responses", asked.responses), ("references", asked.references)):
        if not labels:
            refuse(file.path, f"a MAT file names no {name}", "nothing", f'{name}=["1+Z", ...], in order', "state them")
    responses, references = asked.responses or (), asked.references or ()
    f = file.named(frequencies or "", "frequencies")
    known = units.parse(unit, where="read_frfs, frequency_unit")
    scale = {"frequency": 1.0, "angular_velocity": 1 / (2 * np.pi)}.get(known.quantity)
    if scale is None or f.dtype.kind == "c" or f.size != max(f.shape, default=0):
        refuse(
            file.path,
            "no frequencies",
            f"{frequencies}: {f.dtype}, shape {f.shape}, in {unit}",
            "real numbers along one axis, in Hz or rad/s",
        )
    sizes = {"lines": f.size, "responses": len(responses), "references": len(references)}
    H = oriented(file.named(frf or "", "FRFs"), sizes, axes, f"{file.path}, {frf}")
    open_ = StatedUnit(None, None, "a MAT file states no unit")
    return RecordedFrfs(
        np.ravel(f).astype(float) * known.factor * scale,
        H,
        responses,
        references,
        (open_,) * len(responses),
        (open_,) * len(references),
    )


def oriented(
    values: NDArray[Any], sizes: Mapping[str, int], axes: Sequence[str] | None, where: str
) -> NDArray[np.complex128]:
    """An array with its axes in the order lines, responses, references; the shape must tell which is which.

    Axes of length one are left out of the question, as MATLAB drops them at the end.

    Raises
    ------
    InputError
        If no order fits the shape, or several do and `axes` does not say which.
    """
    target = tuple(sizes[role] for role in ROLES)
    if axes is not None:
        order = tuple(axes)
        if sorted(order) != sorted(ROLES) or tuple(sizes[r] for r in order) != values.shape + (1,) * (3 - values.ndim):
            refuse(where, "the axes do not fit the array", f"{order} for shape {values.shape}", f"{dict(sizes)}")
        cube = values.reshape(values.shape + (1,) * (3 - values.ndim))
        return np.ascontiguousarray(np.transpose(cube, [order.index(r) for r in ROLES])).astype(complex)
    long = [role for role in ROLES if sizes[role] > 1]
    squeezed = np.squeeze(values)
    fits = [order for order in permutations(long) if tuple(sizes[r] for r in order) == squeezed.shape]
    if len(fits) != 1:
        refuse(
            where,
            "the shape leaves open which axis is which" if fits else "the array does not fit its labels and lines",
            f"shape {values.shape}, {dict(sizes)}",
            "one order of the axes",
            'state it: axes=("responses", "references", "lines")',
        )
    turned = np.transpose(squeezed, [fits[0].index(r) for r in long])
    return np.ascontiguousarray(turned).reshape(target).astype(complex)


_SAME_LINES = 1e-6  # of the spacing


def of_uff(file: UffFile, asked: Asked) -> RecordedFrfs:
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
    responses, references, rows = paired(pairs, asked)
    first = rows[0][0]
    lines = _hertz(first, file.path)
    for function in (f for row in rows for f in row):
        _check_lines(function, first, file.path)
    H = np.stack([np.stack([f.values for f in row], axis=1) for row in rows], axis=1)
    said = [[_said(f, file) for f in row] for row in rows]
    return RecordedFrfs(
        lines,
        H,
        responses,
        references,
        tuple(agreed([pair[0] for pair in row], r, file.path) for r, row in zip(responses, said, strict=True)),
        tuple(agreed([row[j][1] for row in said], c, file.path) for j, c in enumerate(references)),
        _coherence(file, first, responses, references),
        (*file.notes, *dict.fromkeys(note for row in rows for f in row for note in f.notes)),
    )


def _said(function: Function, file: UffFile) -> tuple[StatedUnit, StatedUnit]:
    """Units of response and reference of one FRF."""
    _, over, under, _ = function.head.axes
    both = ratio(over.unit)
    if both and not under.unit:  # one text for both, such as g/N
        left, right = (units.parse(text) for text in both)
        return StatedUnit(left, left.quantity), StatedUnit(right, right.quantity)
    return (
        unit_of(over, function.head.response[2], file.system),
        unit_of(under, function.head.reference[2], file.system),
    )


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
