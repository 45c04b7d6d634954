"""What a page of the lab says of itself: its file, and its calls with the parameters that they take.

A parameter reads one value of a JSON body, or refuses it; nothing that is not declared reaches the numerics.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any, Protocol

from structures.errors import InputError, one_of, real, shown, whole

KIB = 1024
BODY = 64 * KIB  # bytes of a call
_SCRIPT = re.compile(r"<script[^>]*>(.*?)</script>", re.DOTALL)


class Parameter(Protocol):
    """What reads one value of a call."""

    def read(self, name: str, value: Any) -> Any:
        """The value, checked."""


@dataclass(frozen=True)
class Real:
    """A finite number from `low` to `high`, both included."""

    low: float
    high: float

    def read(self, name: str, value: Any) -> float:
        """The number.

        Raises
        ------
        InputError
            No number, not finite, or outside.
        """
        found = real(value) if isinstance(value, int | float) else None
        if found is None or not self.low <= found <= self.high:
            raise InputError("out of range", where=name, found=shown(value),
                             expected=f"a finite number from {self.low:g} to {self.high:g}")  # fmt: skip
        return found


@dataclass(frozen=True)
class Whole:
    """A whole number from `low` to `high`, both included."""

    low: int
    high: int

    def read(self, name: str, value: Any) -> int:
        """The number.

        Raises
        ------
        InputError
            No whole number, or outside.
        """
        found = whole(value)
        if found is None or not self.low <= found <= self.high:
            raise InputError("out of range", where=name, found=shown(value),
                             expected=f"a whole number from {self.low} to {self.high}")  # fmt: skip
        return found


@dataclass(frozen=True)
class OneOf:
    """One of some words."""

    names: tuple[str, ...]

    def read(self, name: str, value: Any) -> str:
        """The word.

        Raises
        ------
        InputError
            Any other.
        """
        return one_of("no such value", value, self.names, where=name)


@dataclass(frozen=True)
class OnOff:
    """True or false."""

    def read(self, name: str, value: Any) -> bool:
        """The truth value.

        Raises
        ------
        InputError
            Anything else.
        """
        if not isinstance(value, bool):
            raise InputError("neither on nor off", where=name, found=shown(value), expected="true or false")
        return value


@dataclass(frozen=True)
class Text:
    """A line of printable text, of at most `longest` characters."""

    longest: int = 200

    def read(self, name: str, value: Any) -> str:
        """The text.

        Raises
        ------
        InputError
            No text, too long, or with what does not print.
        """
        if not (isinstance(value, str) and len(value) <= self.longest and value.isprintable()):
            raise InputError("no line of text", where=name, found=shown(value),
                             expected=f"at most {self.longest} characters that print")  # fmt: skip
        return value


@dataclass(frozen=True)
class Reals:
    """A list of `least` to `most` finite numbers, each from `low` to `high`."""

    low: float
    high: float
    most: int
    least: int = 0

    def read(self, name: str, value: Any) -> list[float]:
        """The numbers.

        Raises
        ------
        InputError
            No list, too long or short, or an entry that is none.
        """
        if not (isinstance(value, list) and self.least <= len(value) <= self.most):
            raise InputError("no list of numbers", where=name, found=shown(value),
                             expected=f"a list of {self.least} to {self.most} numbers")  # fmt: skip
        each = Real(self.low, self.high)
        return [each.read(f"{name}[{k}]", one) for k, one in enumerate(value)]


@dataclass(frozen=True)
class Download:
    """An answer that the browser saves as a file.

    Parameters
    ----------
    name : str
        Of ASCII letters, digits, dot, dash and underscore.
    content : bytes
    kind : str
        Its media type.
    """

    name: str
    content: bytes = field(repr=False)
    kind: str = "application/octet-stream"


@dataclass(frozen=True)
class Call:
    """What the script of a page may ask.

    Parameters
    ----------
    answer : callable
        Gets every parameter by its name, and returns what JSON can say (arrays among it, NaN becomes null), or a
        `Download`. An InputError or a NotIdentifiable of it is told to the browser in words. With an `upload` it gets
        the file too, as ``upload=Path``; the file is gone when it has answered.
    parameters : mapping of name to Real, Whole, OneOf, OnOff, Text or Reals
        All of them must be given, and no others.
    upload : int
        Bytes that a file may have, which is sent in place of a body; 0 takes none.
    """

    answer: Callable[..., Any]
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    upload: int = 0

    def read(self, given: Any) -> dict[str, Any]:
        """Arguments of the answer from a JSON value.

        Raises
        ------
        InputError
            No object, a parameter too many or too few, or a value that its parameter refuses.
        """
        if not isinstance(given, dict):
            raise InputError("the body is no JSON object", where="body", found=shown(given), expected="{...}")
        if given.keys() != self.parameters.keys():
            raise InputError("other parameters than those of this call", where="body",
                             found=shown(", ".join(sorted(given)) or "none"),
                             expected=", ".join(self.parameters) or "none")  # fmt: skip
        return {name: one.read(name, given[name]) for name, one in self.parameters.items()}


@dataclass(frozen=True)
class Page:
    """A page of the lab.

    Parameters
    ----------
    name : str
        Its address is ``/name``, that of a call ``/name/call``.
    title, about : str
        Heading, and a sentence for the list of pages.
    package, file : str
        Where its file lies: what stands in ``<main>``, and one ``<script type="module">`` at its end.
    calls : mapping of name to Call
    """

    name: str
    title: str
    about: str
    package: str
    file: str
    calls: Mapping[str, Call] = field(default_factory=dict)

    @property
    def body(self) -> str:
        """Text of its file."""
        return files(self.package).joinpath(self.file).read_text("utf-8")


def script(body: str) -> str:
    """The script in the text of a page; empty where it has none."""
    found = _SCRIPT.search(body)
    return found[1] if found else ""


def rounded(values: Any, digits: int = 7) -> Any:
    """Arrays and numbers to some significant digits, for pictures: a third of the bytes; NaN becomes None."""
    if values is None or isinstance(values, bool | int | str):
        return values
    if isinstance(values, dict):
        return {key: rounded(one, digits) for key, one in values.items()}
    if isinstance(values, list | tuple):
        return [rounded(one, digits) for one in values]
    if hasattr(values, "tolist"):
        return rounded(values.tolist(), digits)
    return float(f"{values:.{digits}g}") if math.isfinite(values) else None
