"""Records of universal files: lines of text in fixed columns, and the fields that stand in them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

CHUNK = 2**22  # bytes of text that are turned into numbers at once
_D_EXPONENT = bytes.maketrans(b"dD", b"eE")
_NUMERALS = b"0123456789+-.eE \t\r\nnNaAiIfFtTyY"  # of numbers and of the words nan and infinity
_GLUED = re.compile(rb"([eE][+-]?\d{2,3})(?=[+-])")  # 1.00000E+000-2.0: exponents of three digits leave no blank
_ENTITY = r"(\S.*?)\s+(-?\d+)\s+(-?\d+)"  # name, node, direction
_DOF = re.compile(rf"\s*(\d+)\s+(-?\d+)\s+(-?\d+)\s+(-?\d+)\s+{_ENTITY}\s+{_ENTITY}\s*")
_AXIS = re.compile(r"\s*(\d+)\s+(-?\d+)\s+(-?\d+)\s+(-?\d+)(?=\s|$)")
_DOF_WIDTHS = (5, 10, 5, 10, 1, 10, 10, 4, 1, 10, 10, 4)


@dataclass(frozen=True)
class Place:
    """The bytes of a file and its name, for messages that say where."""

    path: str
    data: bytes

    def refuse(self, what: str, at: int, found: object, expected: object, hint: str = "") -> NoReturn:
        """Raise an InputError that names the line in which byte `at` stands."""
        line = self.data.count(b"\n", 0, at) + 1
        raise InputError(
            what,
            where=f"{self.path}, line {line}",
            found=found,
            expected=expected,
            hint=hint or "export or transfer the file again",
        )


@dataclass(frozen=True)
class AxisRecord:
    """What is measured along an axis (records 8 to 11 of data set 58).

    Parameters
    ----------
    type : int
        Specific data type: 8 displacement, 11 velocity, 12 acceleration, 13 force, 17 time, 18 frequency, ...
    length, force, temperature : int
        Exponents of the units, which count for the general type 1 only.
    label, unit : str
        Texts of the axis, "" where the file says NONE.
    """

    type: int
    length: int
    force: int
    temperature: int
    label: str
    unit: str


@dataclass(frozen=True)
class Head:
    """The eleven records in front of the values of a data set 58.

    Parameters
    ----------
    ids : tuple of str
        The five lines of text, "" where the file says NONE.
    function : int
        1 time response, 4 frequency response function, 6 coherence, ...
    version, load_case : int
    response, reference : tuple (name, node, direction)
        Entity name, "" where the file says NONE, and the degree of freedom.
    precision : int
        2 real single, 4 real double, 5 complex single, 6 complex double.
    count : int
        Values, or pairs where the abscissa is stored.
    even : bool
        Whether the abscissa is not stored.
    start, step : float
        Of an even abscissa.
    step_text : str
        The step as it is written: its digits tell how far it was rounded.
    axes : tuple of AxisRecord
        Abscissa, ordinate, denominator of the ordinate, z.
    """

    ids: tuple[str, ...]
    function: int
    version: int
    load_case: int
    response: tuple[str, int, int]
    reference: tuple[str, int, int]
    precision: int
    count: int
    even: bool
    start: float
    step: float
    step_text: str
    axes: tuple[AxisRecord, AxisRecord, AxisRecord, AxisRecord]

    @property
    def complex(self) -> bool:
        """Whether the ordinate is complex."""
        return self.precision in (5, 6)

    @property
    def parts(self) -> int:
        """Numbers that each value takes, its abscissa included where that is stored."""
        return (2 if self.complex else 1) + (0 if self.even else 1)


def text_of(line: bytes) -> str:
    """Line as text; UTF-8, else Latin-1, which instruments write."""
    try:
        return line.decode("utf-8").rstrip("\r\n")
    except UnicodeDecodeError:
        return line.decode("latin-1").rstrip("\r\n")


def parse_head(lines: list[bytes], place: Place, at: int) -> Head:
    """The eleven records of data set 58, the first of which begins at byte `at`.

    Fields that a writer did not put into their columns are told apart by blanks, where that is possible.

    Raises
    ------
    InputError
        A field that is no number, or a value that the format does not know; it names the line.
    """
    starts = np.concatenate([[0], np.cumsum([len(line) for line in lines])]) + at
    texts = [text_of(line) for line in lines]
    function, _, version, case, name, node, way, name2, node2, way2 = _dof_record(texts[5], place, int(starts[5]))
    precision, count, spacing, start, step, step_text = _form_record(texts[6], place, int(starts[6]))
    axes = [_axis_record(texts[k], place, int(starts[k])) for k in range(7, 11)]
    return Head(
        tuple(_said(t) for t in texts[:5]),
        function,
        version,
        case,
        (_said(name), node, way),
        (_said(name2), node2, way2),
        precision,
        count,
        spacing == 1,
        start,
        step,
        step_text,
        (axes[0], axes[1], axes[2], axes[3]),
    )


def numbers(body: bytes, place: Place, at: int) -> NDArray[np.float64]:
    """All numbers of some lines; ``1.0D+00`` is read, and numbers that touch where exponents have three digits.

    Raises
    ------
    InputError
        Names the line and the word that is no number.
    """
    borders = _borders(body)
    if len(borders) > 2:  # a list of words takes several times the memory of its text
        return np.concatenate([numbers(body[i:j], place, at + i) for i, j in pairwise(borders)])
    text = body.translate(_D_EXPONENT)
    words = text.split()
    if not text.translate(None, _NUMERALS):  # float reads 1_000 too
        for _ in range(2):
            try:
                return np.fromiter(map(float, words), float, len(words))
            except ValueError:
                words = _GLUED.sub(rb"\1 ", text).split()
    odd = text.translate(None, _NUMERALS)[:1]  # float passes over control characters that split keeps
    wrong = next((word for word in words if not _number(word)), odd)
    near = at + max(0, text.find(wrong))
    return place.refuse("no number", near, repr(text_of(wrong)[:40]), "numbers in E format")


def _borders(body: bytes) -> list[int]:
    """Where a long text is cut, at ends of lines; a short one has its beginning and its end only."""
    borders = [0]
    while len(body) - borders[-1] > 2 * CHUNK and (end := body.find(b"\n", borders[-1] + CHUNK) + 1):
        borders.append(end)
    return [*borders, len(body)]


def _number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return b"_" not in word


def whole(text: str, place: Place, at: int, what: str) -> int:
    """Integer of a field; a blank one is 0, as Fortran reads it.

    Raises
    ------
    InputError
        If it is none.
    """
    bare = text.strip()
    if not bare:
        return 0
    if not re.fullmatch(r"[+-]?[0-9]{1,12}", bare):
        place.refuse(f"{what} is no whole number", at, repr(text[:40]), "an integer")
    return int(bare)


def _said(text: str) -> str:
    bare = text.strip()
    return "" if bare.upper() == "NONE" else bare


def _dof_record(text: str, place: Place, at: int) -> tuple[int, int, int, int, str, int, int, str, int, int]:
    fields = _columns(text, _DOF_WIDTHS)
    if fields is None or not all(re.fullmatch(r"\s*[+-]?\d*\s*", fields[k]) for k in (0, 1, 2, 3, 6, 7, 10, 11)):
        match = _DOF.fullmatch(text)
        if match is None:
            place.refuse(
                "no DOF record of a data set 58",
                at,
                repr(text[:80]),
                "function type, three numbers, response name, node and direction, reference name, node and direction",
            )
        g = match.groups()
        fields = [*g[:4], "", *g[4:7], "", *g[7:]]
    n = [whole(fields[k], place, at, "a field of the DOF record") for k in (0, 1, 2, 3, 6, 7, 10, 11)]
    return n[0], n[1], n[2], n[3], fields[5], n[4], n[5], fields[9], n[6], n[7]


def _columns(text: str, widths: tuple[int, ...]) -> list[str] | None:
    """Fields of fixed width; None where a border between two of them cuts a word, so that the widths are not kept."""
    fields, start = [], 0
    padded = text.ljust(sum(widths))
    for width in widths:
        fields.append(padded[start : start + width])
        start += width
        if padded[start - 1 : start + 1].strip() == padded[start - 1 : start + 1] and start < len(padded):
            return None
    return fields if not padded[start:].strip() else None


def _form_record(text: str, place: Place, at: int) -> tuple[int, int, int, float, float, str]:
    words = re.sub(r"([eEdD][+-]?\d{2,3})(?=[+-])", r"\1 ", text).split()
    if len(words) not in (5, 6):
        place.refuse("no data form record of a data set 58", at, repr(text[:80]), "six numbers")
    precision, count, spacing = (whole(w, place, at, "a field of the data form record") for w in words[:3])
    start, step = (float(numbers(w.encode(), place, at)[0]) for w in words[3:5])
    if precision not in (2, 4, 5, 6) or spacing not in (0, 1) or count < 1:
        place.refuse(
            "the data form record holds what the format does not know",
            at,
            f"ordinate type {precision}, {count} values, spacing {spacing}",
            "ordinate type 2, 4, 5 or 6, at least one value, spacing 0 or 1",
        )
    if not (np.isfinite(start) and np.isfinite(step)) or (spacing == 1 and step <= 0):
        place.refuse("the abscissa does not rise", at, f"from {start:g} in steps of {step:g}", "a step > 0")
    return precision, count, spacing, start, step, words[4]


def _axis_record(text: str, place: Place, at: int) -> AxisRecord:
    match = _AXIS.match(text)
    if match is None:
        place.refuse("no axis record of a data set 58", at, repr(text[:80]), "data type, three exponents, label, unit")
    kind, length, force, temperature = (int(g) for g in match.groups())
    rest = text[match.end() :]
    if match.end() == 25 and not (len(text) > 46 and text[45:47].strip() == text[45:47]):
        label, unit = text[26:46], text[47:]
    else:
        label, unit = [*re.split(r"\s{2,}", rest.strip(), maxsplit=1), ""][:2]
    return AxisRecord(kind, length, force, temperature, _said(label), _said(unit))
