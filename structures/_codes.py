"""The table of guard codes, ``guards.toml``: what each is about, when it is raised, and what to do next."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from ._advice import Advice, Spelling

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
    """

    code: str
    title: str
    condition: str
    advice: str

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


def _row(code: str, title: str, condition: str, advice: str, command: str | None = None) -> Guard:
    return Guard(code, title, condition, advice if command is None else Advice(Spelling(advice, command)))
