"""The page of guard codes, made from their table: `python -m tests.guards.page` writes it."""

from __future__ import annotations

from structures._advice import Advice
from structures._flags import STAGES, Guard, table

from ..sources import ROOT

PATH = ROOT / "docs" / "guards.md"
HEAD = """# Guard codes

What must be known before a number is trusted. E refuses (`--allow` or `allow=` with the code overrides where that makes
sense), W warns, N notes; the first digit is the stage. A flag carries the number that raised it and its threshold. Its
advice is the one below, or a sharper one where the guard knows more. This page is made from `structures/guards.toml`
by `python -m tests.guards.page`.
"""


def text() -> str:
    """The whole page."""
    parts = [HEAD]
    for number, stage in enumerate(STAGES, start=1):
        rows = [guard for code, guard in table().items() if code[1] == str(number)]
        parts += [f"## {number} {stage.capitalize()}\n", *map(_section, rows)]
    return "\n".join(parts)


def _section(guard: Guard) -> str:
    title = guard.title[0].upper() + guard.title[1:]
    lines = [f"### {guard.code}\n", f"{title} ({guard.level}).\n", f"- When: {guard.condition}."]
    lines.append(f"- What to do: {guard.advice}.")
    if isinstance(guard.advice, Advice) and guard.advice.command != guard.advice:
        lines.append(f"- On the command line: {guard.advice.command}.")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PATH.write_text(text(), "utf-8")
