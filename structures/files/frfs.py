"""read_frfs: FRFs of a universal file or of a MAT file as a model, with DOF, unit and kind or not at all."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import units
from ..channels import Channel, Dof
from ..errors import InputError
from ..testing import kinds
from .frf_tables import Asked, Found, Units, of_mat, of_uff, refuse
from .hdf5 import read_mat
from .storage import as_path
from .uff import SUFFIXES, Said, read_uff

if TYPE_CHECKING:
    from ..models.tabulated import FrfModel


def read_frfs(
    path: str | os.PathLike,
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
    """FRFs of a universal file (UFF, UNV: data sets 58 and 58b) or of a MAT file (-v6, -v7, -v7.3), in SI.

    Parameters
    ----------
    path : path
    kind : {"accelerance", "mobility", "receptance"}, optional
        Needed where the file does not say what the responses are; must agree where it does.
    responses, references : sequence of DOFs or names, optional
        Which of them, in this order; of a universal file all if left out. A MAT file names none: they are needed, in
        the order of the array.
    response_unit, reference_unit : str or dict, optional
        Units of the numbers where the file does not state them, for all or by label: ``"g"``, ``{"12+Z": "m/s^2"}``.
    frf, frequencies : str, optional
        Names of the arrays of a MAT file.
    axes : sequence of str, optional
        What the axes of that array are, such as ``("responses", "references", "lines")``; needed where the shape
        leaves it open.
    frequency_unit : str
        Unit of the frequencies of a MAT file, ``Hz`` or ``rad/s``.

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
    asked = Asked(str(place), kind, _labels(responses, "responses"), _labels(references, "references"),
                   response_unit, reference_unit)  # fmt: skip
    if suffix in SUFFIXES:
        return _model(of_uff(read_uff(place), asked), asked)
    if suffix == ".mat":
        return _model(of_mat(read_mat(place), asked, frf, frequencies, axes, frequency_unit), asked)
    raise InputError(
        "a file of a kind that holds no FRFs",
        where=str(place),
        found=place.suffix or "no suffix",
        expected=", ".join([*SUFFIXES, ".mat"]),
        hint="FrfModel.from_frf(frequencies, H, kind=...) takes arrays",
    )


def _model(found: Found, asked: Asked) -> FrfModel:
    """The model, in SI, with described channels; what was decided while reading is logged."""
    from ..models.tabulated import FrfModel

    for note in found.notes:
        logging.getLogger(__name__).info("%s: %s", asked.path, note)

    rows = [
        _settled(label, said, asked.response_unit, "response_unit", asked.path)
        for label, said in zip(found.responses, found.response_units, strict=True)
    ]
    columns = [
        _settled(label, said, asked.reference_unit, "reference_unit", asked.path)
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


def _settled(label: str, said: Said, stated: Units, argument: str, path: str) -> units.Unit:
    """The unit of one channel: what the caller states, else what the file says."""
    text = stated.get(label) if isinstance(stated, Mapping) else stated
    if text is None:
        if said.unit is None:
            raise InputError(
                f"the unit of {label} is not known",
                where=path,
                found=said.why,
                expected="a unit such as m/s^2, g, N",
                hint=f'state it: {argument}="g", or {argument}={{"{label}": "g"}}',
                code="LID-W208",
            )
        return said.unit
    unit = units.parse(text, channel=label, where=path)
    if said.quantity is not None and unit.quantity != said.quantity:
        refuse(path, f"the unit of {label} contradicts the file", f"{unit.symbol} ({unit.quantity})", said.quantity)
    return unit


def _check_kind(sensors: Sequence[Channel], asked: Asked) -> None:
    """Refuse a kind that is missing, or that contradicts the quantities of the responses.

    Motions of several kinds, turning ones and strains may stand side by side: each sensor says what it is.
    """
    found = {s.quantity for s in sensors}
    if "arbitrary" in found or asked.path.lower().endswith(".mat"):  # nothing else says it
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


def _labels(given: Sequence[Any] | None, what: str) -> tuple[str, ...] | None:
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
