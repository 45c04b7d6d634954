"""Flags: what a user must know before a number is trusted; and ``guards.toml``, the table of their codes."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from ._advice import Advice, Spelling, on_command_line
from .errors import InputError

LEVELS = {"E": "refused", "W": "warning", "N": "note"}
STAGES = ("forward model", "measurement", "inversion", "parameter choice", "dynamics", "tactile", "validation")


@dataclass(frozen=True)
class Guard:
    """One row of the table.

    Parameters
    ----------
    code : str
        ``"W407"``: its letter is the level, its first digit the stage.
    title, condition : str
        What it is about; when it is raised.
    advice : str
        What a flag says where the guard function knows nothing better (`structures._advice.Advice` where Python and the
        command line differ).
    example : str
        What a flag found when it was raised, with its evidence: from a case of ``tests/guards``.
    """

    code: str
    title: str
    condition: str
    advice: str
    example: str

    @property
    def level(self) -> str:
        """``"refused"``, ``"warning"`` or ``"note"``."""
        return LEVELS[self.code[0]]

    @property
    def stage(self) -> str:
        """The step of the way at which it is asked, ``"parameter choice"``."""
        return STAGES[int(self.code[1]) - 1]

    @property
    def docs(self) -> str:
        """Where the documentation explains it."""
        return f"docs/guards.md#{self.code.lower()}"


@cache
def table() -> Mapping[str, Guard]:
    """Every guard by its short code, in the order of the stages."""
    rows = tomllib.loads(Path(__file__).with_name("guards.toml").read_text("utf-8"))
    return {code: _row(code, **row) for code, row in rows.items()}


def _row(code: str, title: str, condition: str, advice: str, example: str, command: str | None = None) -> Guard:
    return Guard(code, title, condition, advice if command is None else Advice(Spelling(advice, command)), example)


def canonical(code: str) -> str:
    """Full form of a guard code: ``"w407"`` and ``"LID-W407"`` both give ``"LID-W407"``.

    Raises
    ------
    InputError
        If it is no guard code.
    """
    short = str(code).strip().upper().removeprefix("LID-")
    if len(short) != 4 or short[0] not in LEVELS or not short[1:].isdigit():
        raise InputError(
            "no guard code",
            where="allow",
            found=repr(code),
            expected="a letter E, W or N and three digits, such as W407",
        )
    return f"LID-{short}"


@dataclass(frozen=True)
class Evidence:
    """The number that triggered a flag, and the threshold that it crossed."""

    name: str
    value: float | str
    threshold: float | str | None = None

    def __str__(self) -> str:
        def show(x: float | str) -> str:
            return x if isinstance(x, str) else f"{x:.4g}"

        return f"{self.name} = {show(self.value)}" + (
            "" if self.threshold is None else f" (threshold {show(self.threshold)})"
        )


@dataclass(frozen=True)
class Flag:
    """One finding of a guard.

    Parameters
    ----------
    code : str
        ``"LID-W407"``: E refuses, W warns, N notes; the first digit is the stage (1 model, 2 measurement,
        3 inversion, 4 parameter choice, 5 dynamics, 6 tactile, 7 validation).
    evidence : Evidence
        The number that triggered it and the threshold.
    message : str
        What was found.
    advice : str, optional
        What to do next (`structures._advice.Advice` where Python and the command line differ), where it is not what the
        table of codes says (`table`).
    state : bool
        It tells how things were set up (model not checked, fewer sensors than loads), whatever the data say: a note.
    effect : float, optional
        Expected effect on the load, in its std, where the guard can tell.
    """

    code: str
    evidence: Evidence
    message: str
    advice: str = ""
    state: bool = False
    effect: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "code", canonical(self.code))
        if not self.advice:
            object.__setattr__(self, "advice", table()[self.code.removeprefix("LID-")].advice)

    @property
    def level(self) -> str:
        """``"refused"``, ``"warning"`` or ``"note"``."""
        return LEVELS["N" if self.state else self.code[4]]

    def __str__(self) -> str:
        return f"{self.code} {self.level}: {self.message} [{self.evidence}] -> {self.advice}"

    @property
    def command(self) -> str:
        """The line in the words of the command line."""
        message, advice = on_command_line(self.message), on_command_line(self.advice)
        return f"{self.code} {self.level}: {message} [{self.evidence}] -> {advice}"

    def to_dict(self) -> dict[str, object]:
        """Plain dictionary, for JSON and for result files."""
        spelt = {"command": self.advice.command} if isinstance(self.advice, Advice) else {}
        return {
            "code": self.code,
            "level": self.level,
            "evidence": {
                "name": self.evidence.name,
                "value": self.evidence.value,
                "threshold": self.evidence.threshold,
            },
            "message": str(self.message),
            "advice": str(self.advice),
            **spelt,
            **({} if self.effect is None else {"effect": self.effect}),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Flag:
        """Inverse of `to_dict`."""
        advice = data["advice"]
        if "command" in data:
            advice = Advice(Spelling(advice, data["command"]))
        state = data["level"] == LEVELS["N"] and data["code"][4] != "N"
        return cls(data["code"], Evidence(**data["evidence"]), data["message"], advice, state, data.get("effect"))


def cautions(flags: Iterable[Flag]) -> list[Flag]:
    """The flags that are no notes: refusals that were overridden, then by expected effect on the load, then by code."""
    return sorted(
        (flag for flag in flags if flag.level != LEVELS["N"]),
        key=lambda f: (f.code[4] != "E", -(f.effect if f.effect is not None else 0.0), f.code),
    )


def codes(flags: Iterable[Flag]) -> set[str]:
    """Short codes of some flags, ``{"W407", ...}``."""
    return {flag.code.removeprefix("LID-") for flag in flags}


def known_codes(codes: Iterable[str], *, where: str = "allow") -> tuple[str, ...]:
    """The codes in full form.

    Raises
    ------
    InputError
        If one of them is no code of the package; the message lists those that are.
    """
    full = []
    for code in codes:
        short = str(code).strip().upper().removeprefix("LID-")
        if short not in table():
            raise InputError("there is no such guard code", where=where, found=repr(code),
                             expected=f"one of {', '.join(table())}",
                             hint="only refusals (E) can be overridden")  # fmt: skip
        full.append(canonical(short))
    return tuple(full)


def explained(flag: Mapping[str, Any]) -> dict[str, Any]:
    """A flag as plain values, with what the table of codes says of it: title, stage and place in the documentation."""
    guard = table()[flag["code"].removeprefix("LID-")]
    return {**flag, "title": guard.title, "stage": guard.stage, "docs": guard.docs}


def collect(flags: Iterable[Flag | None]) -> tuple[Flag, ...]:
    """The flags that were raised, without repeats, in order."""
    seen: dict[tuple[str, str], Flag] = {}
    for flag in flags:
        if flag is not None:
            seen.setdefault((flag.code, flag.message), flag)
    return tuple(seen.values())


def allowed(codes: Sequence[str]) -> tuple[str, ...]:
    """Codes that a user allows, in full form.

    Raises
    ------
    InputError
        If one of them is no guard code.
    """
    if not isinstance(codes, list | tuple | set | frozenset):
        raise InputError("allow takes a list of codes", where="allow", found=repr(codes), expected=f"[{codes!r}]")
    return known_codes(codes)
