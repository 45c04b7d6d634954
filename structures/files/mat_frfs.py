"""FRFs in an array of a MAT file: which axis is which must follow from the shape, or be stated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from .. import units
from .frf_table import Asked, Found, refuse
from .mat import MatFile
from .uff_units import Said

ROLES = ("lines", "responses", "references")


def of_mat(
    file: MatFile, asked: Asked, frf: str | None, frequencies: str | None, axes: Sequence[str] | None, unit: str
) -> Found:
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
    open_ = Said(None, None, "a MAT file states no unit")
    return Found(
        np.ravel(f).astype(float) * known.factor * scale,
        H,
        responses,
        references,
        (open_,) * len(responses),
        (open_,) * len(references),
    )


def oriented(
    values: NDArray, sizes: Mapping[str, int], axes: Sequence[str] | None, where: str
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
