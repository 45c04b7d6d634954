"""A universal file as its data sets, and data set 58: a function measured at a degree of freedom."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from .._channels import Dof
from ..errors import InputError
from ._uff_records import AxisRecord, Head, Place, numbers, parse_head, text_of, whole

MARK = re.compile(rb"^ {4}-1[ \t]*\r?$", re.MULTILINE)
_AFTER_BINARY = re.compile(rb"(?:\r?\n)? {4}-1[ \t]*(?:\r?\n|\Z)")
_ID = re.compile(r" {0,5}(\d{1,6})([bB]?)(.*)")
_BEGUN = re.compile(rb"\n {1,5}\Z")
_BLANK = re.compile(rb"[ \t\r\n\x1a]*")
HEAD_LINES = 11  # records of a data set 58 in front of its values
LITTLE, BIG = 1, 2


@dataclass(frozen=True)
class Block:
    """One data set.

    Parameters
    ----------
    number : int
        58, 15, 164, ...
    at : int
        Byte at which its first record begins.
    body : bytes
        Its records; of a data set 58 only the values.
    head : Head or None
        Of a data set 58.
    order : str
        ``"<"`` or ``">"`` where the values are binary, "" where they are text.
    abscissa : int
        Bytes of each stored abscissa of binary values.
    notes : tuple of str
        Where the file contradicts itself, and how it was read.
    line : int
        Line of the file, from 1, at which the body begins; binary values have line feeds of their own.
    """

    number: int
    at: int
    body: bytes
    head: Head | None = None
    order: str = ""
    abscissa: int = 0
    notes: tuple[str, ...] = ()
    line: int = 0


def split(place: Place) -> list[Block]:
    """All data sets of a file, in its order; every one of them complete.

    Raises
    ------
    InputError
        Something between the data sets, or a data set that has no end: the file is truncated or damaged.
    """
    blocks: list[Block] = []
    at, counted, line_number = _skip_blank(place.data, 0), 0, 1
    while at < len(place.data):
        line, after = _line(place, at)
        if not MARK.fullmatch(line.rstrip(b"\n")):
            place.refuse("no data set begins here", at, repr(text_of(line)[:40]), "a line '    -1'")
        block, at = _block(place, after)
        line_number += place.data.count(b"\n", counted, block.at)
        counted = block.at
        blocks.append(replace(block, line=line_number))
        at = _skip_blank(place.data, at)
    if blocks and _BEGUN.search(place.data):
        _truncated(place, len(place.data), 0, "truncated: the file ends within the mark of a next data set")
    if not blocks:
        place.refuse("the file holds no data set", 0, f"{len(place.data)} bytes", "data sets between lines '    -1'")
    return blocks


def _block(place: Place, at: int) -> tuple[Block, int]:
    line, after = _line(place, at)
    match = _ID.match(text_of(line))
    if match is None:
        place.refuse("no number of a data set", at, repr(text_of(line)[:40]), "such as '    58'")
    number, binary = int(match[1]), bool(match[2])
    if binary:
        return _binary(place, after, number, match[3], at)
    if match[3].strip():
        place.refuse("no number of a data set", at, repr(text_of(line)[:40]), "a number alone, such as '    58'")
    if number != 58:
        end, beyond = _end(place, after, number)
        return Block(number, after, place.data[after:end]), beyond
    lines, values = _lines(place, after, HEAD_LINES, number)
    head = parse_head(lines, place, after)
    end, beyond = _end(place, values, number)
    return Block(number, values, place.data[values:end], head), beyond


def _binary(place: Place, at: int, number: int, fields: str, id_at: int) -> tuple[Block, int]:
    """A data set with binary values: '58b', byte order, floating point format, lines of text, bytes that follow."""
    words = fields.split()
    if len(words) < 4:
        place.refuse("the header of a binary data set is cut", id_at, repr(fields[:60]), "byte order, format, sizes")
    order, form, count, size = (whole(w, place, id_at, "a field of the binary header") for w in words[:4])
    if not (order in (LITTLE, BIG) and form == 2 and 0 <= count <= 1000 and size >= 0):
        place.refuse(
            "a binary form that is not read",
            id_at,
            f"byte order {order}, floating point format {form}, {count} lines of text, {size} bytes",
            "byte order 1 (little) or 2 (big), format 2 (IEEE 754)",
            "export it as text (58), or in IEEE 754",
        )
    lines, start = _lines(place, at, count, number)
    if number != 58:
        return Block(number, at, b"".join(lines)), _behind(place, start, [size], size, number, at)[1]
    if count != HEAD_LINES:
        place.refuse("a data set 58 has eleven records of text", id_at, count, HEAD_LINES)
    head = parse_head(lines, place, at)
    widths = _widths(head)
    real, beyond = _behind(place, start, list(widths), size, number, at, head.count)
    notes: tuple[str, ...] = ()
    if real != size:
        notes = (f"a data set declares {size} bytes and holds the {real} that its {head.count} values take",)
    body = place.data[start : start + real]
    return Block(number, start, body, head, "<" if order == LITTLE else ">", widths[real], notes), beyond


def _widths(head: Head) -> dict[int, int]:
    """Sizes that the values may have, each with the width of its abscissa.

    The format stores every abscissa in single precision; writers that do not know that store all numbers alike.
    """
    each = 8 if head.precision in (4, 6) else 4
    ordinates = each * (2 if head.complex else 1)
    if head.even:
        return {head.count * ordinates: 0}
    return {head.count * (ordinates + width): width for width in dict.fromkeys((4, each))}


def _behind(
    place: Place, start: int, sizes: list[int], declared: int, number: int, at: int, count: int = 0
) -> tuple[int, int]:
    """Size of the binary values that the end mark stands behind, and the byte after that mark."""
    for size in sorted(sizes, key=lambda s: s != declared):
        match = _AFTER_BINARY.match(place.data, start + size)
        if match:
            return size, match.end()
    there, wanted = len(place.data) - start, min(sizes, key=lambda s: s != declared)
    if there < wanted:
        whole_ones = there * count // wanted if count else there
        _truncated(place, at, number, f"truncated: {whole_ones} of {count or wanted} {'samples' if count else 'bytes'}")
    return place.refuse(
        f"the values of data set {number} do not end where they should",
        at,
        f"{declared} bytes declared",
        f"the mark '    -1' behind {' or '.join(map(str, sizes))} bytes, as number and type of the values say",
        "the file is cut or damaged: export or transfer it again",
    )


def _end(place: Place, at: int, number: int) -> tuple[int, int]:
    """Where the records of a data set end, and the byte after its end mark."""
    match = MARK.search(place.data, at)
    if match is None:
        _truncated(place, at, number, f"truncated: data set {number} has no end")
    return match.start(), min(match.end() + 1, len(place.data))


def _truncated(place: Place, at: int, number: int, what: str) -> NoReturn:
    place.refuse(what, at, f"the file ends after {len(place.data)} bytes", f"the mark '    -1' of set {number}")


def _lines(place: Place, at: int, count: int, number: int) -> tuple[list[bytes], int]:
    lines = []
    for _ in range(count):
        end = place.data.find(b"\n", at)
        if end < 0:
            _truncated(place, at, number, f"truncated: data set {number} ends within its header")
        lines.append(place.data[at : end + 1])
        at = end + 1
    return lines, at


def _line(place: Place, at: int) -> tuple[bytes, int]:
    end = place.data.find(b"\n", at)
    end = len(place.data) if end < 0 else end + 1
    if end == at:
        _truncated(place, at, 0, "truncated: a data set begins and does not go on")
    return place.data[at:end], end


def _skip_blank(data: bytes, at: int) -> int:
    """First byte of the next line that is not blank."""
    match = _BLANK.match(data, at)
    end = match.end() if match else at
    return len(data) if end >= len(data) else max(at, data.rfind(b"\n", 0, end) + 1)


TIME, FRF, COHERENCE, MULTIPLE_COHERENCE = 1, 4, 6, 26
FUNCTIONS = {
    0: "unknown", 1: "time response", 2: "auto spectrum", 3: "cross spectrum", 4: "FRF", 5: "transmissibility",
    6: "coherence", 7: "auto correlation", 8: "cross correlation", 9: "power spectral density",
    10: "energy spectral density", 11: "probability density", 12: "spectrum", 26: "multiple coherence",
}  # fmt: skip
MOST = 27  # largest type of a function that the format knows
REAL = (TIME, 2, COHERENCE, 7, 8, 9, 10, 11, MULTIPLE_COHERENCE)  # types whose values have no phase
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
    values: NDArray[Any]
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
    def axis(self) -> AxisRecord:
        """What its abscissa is."""
        return self.head.axes[0]


def is_function(block: Block, place: Place) -> bool:
    """Whether a data set of another number begins with the eleven records of a data set 58."""
    lines = block.body.split(b"\n", HEAD_LINES)[:HEAD_LINES]
    if len(lines) < HEAD_LINES:
        return False
    try:
        parse_head(lines, place, block.at)
    except InputError:
        return False
    return True


def function_of(block: Block, place: Place) -> Function:
    """The function of a data set 58.

    Raises
    ------
    InputError
        Fewer or more values than declared (it says how many of how many), an abscissa that does not rise, a type that
        the format does not know, or one that has no phase and complex values.
    """
    head = block.head
    assert head is not None  # a block 58 has one
    table = _binary_values(block, head) if block.order else _text(block, head, place)
    at = 0 if head.even else 1
    values = table[:, at:].copy().view(complex)[:, 0] if head.complex else table[:, at]
    _check_type(head, values, block, place)
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


def _check_type(head: Head, values: NDArray[Any], block: Block, place: Place) -> None:
    if not 0 <= head.function <= MOST:
        place.refuse("a type of function that the format does not know", block.at, head.function, f"0 to {MOST}",
                     "it is damaged: export or transfer the file again")  # fmt: skip
    if head.function in REAL and np.iscomplexobj(values) and np.any(values.imag):
        place.refuse("a function without a phase has complex values", block.at,
                     f"type {head.function}, {FUNCTIONS[head.function]}", "real values",
                     "a spectrum or an FRF is of another type: export it again")  # fmt: skip


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


def _binary_values(block: Block, head: Head) -> NDArray[np.float64]:
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
