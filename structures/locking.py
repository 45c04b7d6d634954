"""Guards W108 and E109: plain bricks lock where the material hardly changes its volume."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from .errors import InputError
from .factor import Factor
from .flags import Evidence, Flag, canonical
from .hexfield import FACES, HexField

WARN, REFUSE = 0.45, 0.49
TRIAL = 20_000  # DOFs up to which the mesh itself is tried
# A bonded pad of 16 x 16 x 4 plain bricks (16 x 16 x 4 mm, loaded in the middle): % too stiff against B-bar.
PAD = {0.3: 1.0, 0.45: 4.0, 0.49: 20.0, 0.499: 67.0, 0.4999: 94.0}
ADVICE = 'element="bbar", and check that nu was measured: gels of 0.32 to 0.49 are published'


def locking(field: HexField, fixed: Sequence[str], allow: Iterable[str] = ()) -> tuple[Flag, ...]:
    """Flag W108 (plain bricks and nu > 0.45), or the refusal E109 (nu > 0.49), or nothing.

    Parameters
    ----------
    field : HexField
        The block.
    fixed : sequence of str
        Its fixed faces.
    allow : iterable of str
        ``("E109",)`` turns the refusal into a flag.

    Raises
    ------
    InputError
        Code LID-E109, with the number, unless it is allowed.
    """
    nu = field.cell.nu
    allowed = {canonical(code) for code in ([allow] if isinstance(allow, str) else allow)}
    if field.cell.element != "standard" or nu <= WARN:
        return ()
    excess, how = _excess(field, fixed)
    message = f"plain Hex-8 is {excess:.0f} % too stiff at nu = {nu:g} ({how})"
    if nu <= REFUSE:
        return (Flag("W108", Evidence("Poisson's ratio", nu, WARN), message, ADVICE),)
    if "LID-E109" not in allowed:
        raise InputError(
            message,
            where="solids.block, element",
            found=f"element='standard' and nu = {nu:g}",
            expected=f"nu <= {REFUSE}, or another element",
            hint=ADVICE + '; allow=("E109",) builds it all the same',
            code="LID-E109",
        )
    return (Flag("E109", Evidence("Poisson's ratio", nu, REFUSE), message + ", allowed by the user", ADVICE),)


def _excess(field: HexField, fixed: Sequence[str]) -> tuple[float, str]:
    """By how many per cent plain bricks are too stiff against B-bar, and on what mesh that was found."""
    face = _loaded(fixed)
    if face is None or field.size > TRIAL:
        x = [np.log10(1 - 2 * nu) for nu in PAD]
        found = np.interp(np.log10(1 - 2 * field.cell.nu), x[::-1], list(PAD.values())[::-1])
        return float(found), "a bonded pad of 16 x 16 x 4 cells"
    held = np.unique(np.concatenate([field.face_nodes(name).ravel() for name in fixed or ("bottom",)]))
    free = np.setdiff1d(np.arange(field.size), (3 * held[:, None] + np.arange(3)).ravel())
    f = _press(field, face)[free]
    compliance = []
    for element in ("standard", "bbar"):
        K = field.assemble(replace(field.cell, element=element).stiffness)[free][:, free]
        compliance.append(f @ Factor(K, check=False).solve(f))
    return 100 * (
        1 - compliance[0] / compliance[1]
    ), f"this mesh against B-bar, pressed in the middle of its {face} face"


def _loaded(fixed: Sequence[str]) -> str | None:
    """The free face to press: opposite to the first fixed one if possible."""
    axis, end = FACES[fixed[0] if fixed else "bottom"]
    opposite = next(name for name, place in FACES.items() if place == (axis, 1 - end))
    return next((name for name in (opposite, *FACES) if name not in (fixed or ("bottom",))), None)


def _press(field: HexField, face: str) -> np.ndarray:
    """A pressure on the middle of a face, about 1.4 times as wide as the block is deep."""
    axis, _ = FACES[face]
    side, spans = 1.4 * field.lines[axis].length, []
    for line in field.face_lines(face):
        half, middle = min(max(side, 2 * line.h), line.length) / 2, line.origin + line.length / 2
        spans.append((middle - half, middle + half))
    return field.traction(face, tuple(spans), axis + 1)
