"""Advice: what to do, in the spelling of Python and in that of the command line."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Spelling:
    """The same words as Python and as the command line say them."""

    python: str
    command: str


@dataclass(frozen=True)
class Option:
    """A setting: ``penalty='identity'`` in Python, ``--penalty identity`` on the command line.

    Parameters
    ----------
    name : str
        Keyword argument.
    value : object, optional
        What it is set to; None names the setting alone, ``noise=`` and ``--noise``.
    flag : str, optional
        Name of the option of the command line, where it differs.
    within : str, optional
        Argument and class that hold it in Python: ``"choice=Lambda"`` makes ``choice=Lambda(path='dense')``.
    """

    name: str
    value: Any = None
    flag: str = ""
    within: str = ""

    @property
    def python(self) -> str:
        """As a keyword argument."""
        text = f"{self.name}=" if self.value is None else f"{self.name}={self.value!r}"
        return f"{self.within}({text})" if self.within else text

    @property
    def command(self) -> str:
        """As an option of the command line."""
        option = f"--{self.flag or self.name.replace('_', '-')}"
        return option if self.value is None else f"{option} {self.value}"


def either(python: str, command: str) -> Spelling:
    """What errors of readers say in both spellings, as a file is read from both; the command line has its own alone."""
    return Spelling(f"{command} on the command line, {python} in Python", command)


class Advice(str):
    """Text for people that knows both spellings of the settings that it names; as a string it is that of Python.

    Parameters
    ----------
    *parts : str, Option, Spelling or Advice
        Put one after the other.

    Attributes
    ----------
    command : str
        The text as the command line says it.
    """

    command: str

    def __new__(cls, *parts: str | Option | Spelling) -> Advice:
        """The text of all parts, in both spellings."""
        made = super().__new__(cls, "".join(p if isinstance(p, str) else p.python for p in parts))
        made.command = "".join(map(on_command_line, parts))
        return made

    def __getnewargs__(self) -> tuple[Any, ...]:
        """What a copy is made from."""
        return (Spelling(str(self), self.command),)


def on_command_line(text: object) -> str:
    """Any text, or what prints as one, in the words of the command line."""
    return text.command if isinstance(text, Advice | Option | Spelling) else str(text)


def to_plain(text: object) -> Any:
    """Text as JSON takes it, both spellings of an `Advice`; `from_plain` is its inverse."""
    return {"python": str(text), "command": text.command} if isinstance(text, Advice) else text


def from_plain(data: Any) -> Any:
    """Inverse of `to_plain`."""
    return Advice(Spelling(**data)) if isinstance(data, dict) else data


def nearest(word: str, words: Iterable[str]) -> str | None:
    """Of some words the one that was meant by a word which is none of them; None where none is near.

    Capitals and what joins the parts of a word do not count: ``lcurve`` is ``l_curve``.
    """
    known = {_bare(w): w for w in words}
    bare = _bare(word)
    found = difflib.get_close_matches(bare, known, n=1, cutoff=0.61)  # "noise" is no "units"
    if not found and len(bare) >= 3:
        found = [w for w in known if w.startswith(bare)][:1]
    return known[found[0]] if found else None


def did_you_mean(word: str, words: Iterable[str]) -> str:
    """``"; did you mean l_curve?"``, or nothing."""
    found = nearest(word, words)
    return f"; did you mean {found}?" if found else ""


def _bare(word: str) -> str:
    return "".join(c for c in word.lower() if c.isalnum())
