"""The page of guard codes, made from their table: `python -m tests.guards.page` writes it.

With ``--examples`` the examples of the table are written anew first, from the cases of this room.
"""

from __future__ import annotations

import json
import re
import sys

from structures import Flag
from structures._advice import Advice
from structures._flags import STAGES, Guard, table

from ..sources import ROOT

PATH, TABLE = ROOT / "docs" / "guards.md", ROOT / "structures" / "guards.toml"
HEAD = """# Guard codes

What must be known before a number is trusted. E refuses (`--allow` or `allow=` with the code overrides where that makes
sense), W warns, N notes; the first digit is the stage. A flag carries the number that raised it and its threshold. Its
advice is the one below, or a sharper one where the guard knows more. `loadid info W407` prints the section of a code.
This page is made from `structures/guards.toml` by `python -m tests.guards.page`; the examples are flags of the tests.
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
    lines.append(f"- Example: `{guard.example}`")
    lines.append(f"- What to do: {guard.advice}.")
    if isinstance(guard.advice, Advice) and guard.advice.command != guard.advice:
        lines.append(f"- On the command line: {guard.advice.command}.")
    return "\n".join(lines) + "\n"


def example(flag: Flag) -> str:
    """What a flag found, with its evidence; of a refusal what was refused."""
    found = " ".join(flag.message.partition("; what to do:")[0].replace("`", "'").split())
    found = re.sub(r"^\[?LID-[EWN]\d{3}\]?:? ?|/tmp/\S*/", "", found)
    return found if flag.evidence.name == "refusal" else f"{found} [{flag.evidence}]"


def shape(text: str) -> str:
    """A text without its numbers and fingerprints, which differ by the last digit from machine to machine."""
    return re.sub(r"\b[0-9a-f]{12}\b|-?\d+(\.\d+)?(e[-+]?\d+)?", "0", text)


def write_examples() -> None:
    """Put what the first case of every code finds today into the table."""
    import tempfile
    from pathlib import Path

    from . import test_every_guard, test_histories

    with tempfile.TemporaryDirectory() as folder:
        test_histories.TMP[:] = [Path(folder)]
        found = {case.code: example(flag) for case in reversed(test_every_guard.CASES)
                 for flag in case.trigger()[::-1] if flag.code == f"LID-{case.code}"}  # fmt: skip
    lines, code = [], ""
    for line in TABLE.read_text("utf-8").splitlines():
        code = line[1:-1] if line.startswith("[") else code
        if line.startswith("example = ") and code in found:
            continue
        lines.append(line)
        if line.startswith("condition = ") and code in found:
            lines.append(f"example = {json.dumps(found[code], ensure_ascii=False)}")
    TABLE.write_text("\n".join(lines) + "\n", "utf-8")


if __name__ == "__main__":
    if "--examples" in sys.argv[1:]:
        write_examples()
        table.cache_clear()
    PATH.write_text(text(), "utf-8")
