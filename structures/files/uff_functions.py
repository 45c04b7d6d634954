"""Data set 58: a function measured at a degree of freedom, its values compared with what its header declares."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..dofs import Dof
from .uff_blocks import Block
from .uff_records import Axis, Head, Place, numbers

TIME, FRF, COHERENCE, MULTIPLE_COHERENCE = 1, 4, 6, 26
FUNCTIONS = {
    0: "unknown", 1: "time response", 2: "auto spectrum", 3: "cross spectrum", 4: "FRF", 5: "transmissibility",
    6: "coherence", 7: "auto correlation", 8: "cross correlation", 9: "power spectral density",
    10: "energy spectral density", 11: "probability density", 12: "spectrum", 26: "multiple coherence",
}  # fmt: skip
_DIGITS = 4  # a step of so many digits at most is meant as it stands
_CHANCE = 0.01  # how likely a dyadic step may fit by chance


@dataclass(frozen=True, eq=False)
class Function:
    """One function of a universal file.

    Parameters
    ----------
    head : Head
        Its records.
    abscissa : array (samples,)
        As recorded: s, Hz or what the unit of the axis says.
    step : float or None
        Of an even abscissa, with the rounding of the header undone where the number meant is certain.
    values : array (samples,), real or complex
        As recorded.
    line : int
        Line of the file at which the values begin.
    notes : tuple of str
    """

    head: Head = field(repr=False)
    abscissa: NDArray[np.float64]
    step: float | None
    values: NDArray
    line: int
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """What it is, in words."""
        return FUNCTIONS.get(self.head.function, f"function type {self.head.function}")

    @property
    def response(self) -> str:
        """Label of the response: ``12+Z``, else the name of its entity, else "" where the file names none."""
        return _label(self.head.response)

    @property
    def reference(self) -> str:
        """Label of the reference, in the same way."""
        return _label(self.head.reference)

    @property
    def axis(self) -> Axis:
        """What its abscissa is."""
        return self.head.axes[0]


def function_of(block: Block, place: Place) -> Function:
    """The function of a data set 58.

    Raises
    ------
    InputError
        Fewer or more values than declared (it says how many of how many), or an abscissa that does not rise.
    """
    head = block.head
    assert head is not None  # a block 58 has one
    table = _binary(block, head) if block.order else _text(block, head, place)
    at = 0 if head.even else 1
    values = table[:, at:].copy().view(complex)[:, 0] if head.complex else table[:, at]
    notes = list(block.notes)
    if not head.even:
        abscissa = table[:, 0]
        if not np.all(np.isfinite(abscissa)) or np.any(np.diff(abscissa) <= 0):
            k = int(np.argmax(~(np.diff(abscissa) > 0)))
            found = f"{abscissa[k]:.9g} and then the next value {k + 1}"
            place.refuse("the abscissa does not rise", block.at, found, "ascending, finite numbers")
        step = None
    else:
        step = unrounded(head.step, head.step_text)
        if step != head.step:
            notes.append(f"the step {head.step_text} is read as {step!r}: the header rounds it")
        abscissa = head.start + step * np.arange(head.count, dtype=float)
    return Function(head, abscissa, step, values, block.line, tuple(notes))


def unrounded(step: float, text: str) -> float:
    """The step that a header of six digits means: 1/51200 for 1.95312E-05, 25/128 for 1.95313E-01.

    A whole number of steps per unit, else a fraction of a small power of two, is taken where only rounding to the
    digits of the text parts them and chance hardly does; any other step stays as it stands.
    """
    mantissa = text.lower().replace("d", "e").partition("e")[0].lstrip("+-").replace(".", "").lstrip("0")
    if len(mantissa.rstrip("0")) <= _DIGITS:
        return step
    place = 10.0 ** (np.floor(np.log10(step)) + 1 - len(mantissa))  # of the last digit; some writers cut, do not round
    whole = 1.0 / step if step < 0.1 else 0.0
    if whole and abs(1.0 / round(whole) - step) <= place and place * whole**2 < 0.5:
        return 1.0 / round(whole)
    for power in range(21):
        fine = 2.0**power
        if 2 * place * fine > _CHANCE:
            break
        near = round(step * fine) / fine
        if near > 0 and abs(near - step) <= place:
            return float(near)
    return step


def _text(block: Block, head: Head, place: Place) -> NDArray[np.float64]:
    found = numbers(block.body, place, block.at)
    wanted, per_line = head.count * head.parts, 6 if head.precision in (2, 5) else 4
    filled = len(found) % per_line == 0 and 0 < len(found) - wanted < per_line and not np.any(found[wanted:])
    if filled and head.even:  # FORTRAN programs fill the last line with zeros
        found = found[:wanted]
    if len(found) != wanted:
        short = len(found) < wanted
        place.refuse(
            f"truncated: {len(found) // head.parts} of {head.count} samples" if short else "more samples than declared",
            block.at,
            f"{len(found)} numbers",
            f"{wanted}: {head.count} values of {head.parts} numbers each",
            "the file is cut or damaged: export or transfer it again",
        )
    return found.reshape(head.count, head.parts)


def _binary(block: Block, head: Head) -> NDArray[np.float64]:
    """Numbers of binary values; their size was checked when the data set was found."""
    real = f"{block.order}f{8 if head.precision in (4, 6) else 4}"
    fields = [] if head.even else [("x", f"{block.order}f{block.abscissa}")]
    fields += [("re", real)] + ([("im", real)] if head.complex else [])
    table = np.frombuffer(block.body, np.dtype(fields), head.count)
    with np.errstate(invalid="ignore"):  # damage may look like a signalling NaN
        return np.column_stack([table[name].astype(float) for name, _ in fields])


def _label(entity: tuple[str, int, int]) -> str:
    name, node, direction = entity
    if direction and node >= 0 and abs(direction) <= 6:
        return str(Dof(node, direction))
    return name
