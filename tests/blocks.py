"""Blocks of the documentation that run: which they are, and running them from a folder that is empty.

One rule for README.md and every page of docs/. A page is run from top to bottom, in one folder and one scope:

- a fenced block of ``python`` runs as it stands;
- a fenced block of ``sh``, ``bash`` or ``console``, and an indented block whose lines begin with ``loadid`` or
  ``python -c``, is lines of a shell: ``loadid`` runs in this process, and must end with 0;
- lines of a shell with words in capitals or in brackets (``loadid info FILE [--json]``) say how a command is used, and
  are not run;
- a fenced block of ``toml`` below a line ``<!-- file: plan.toml -->`` is written there;
- a block below a line ``<!-- not run: WORD -->`` is left out, for one of the `REASONS`;
- blocks of other languages are no examples to run.

What a page reads it makes itself (``datasets.impact(".")``), or finds: `FILES` names the sets that a page begins with.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
LIMIT = 15.0  # s of CPU that a block may take
REASONS = {
    "installs": "brings packages, which takes a network",
    "camera": "needs a camera or a pad",
    "broker": "needs a broker of messages, or a program that sends them",
    "cluster": "needs other machines",
    "goes on": "runs until somebody ends it",
    "robot": "needs ROS",
    "compiler": "needs a compiler",
    "a part": "shows a part of a program",
    "hours": "takes longer than a test may",
}
# sets of `loadid.datasets` that lie there before a page begins
FILES: dict[str, tuple[str, ...]] = {}
SHELL = ("sh", "bash", "console", "shell")
FIRST = ("loadid ", "python -c ")
USAGE = re.compile(r"(?:^|\s)(?:\[|[A-Z]{2,}(?:\.\w+)?(?=\s|$))")
MARK = re.compile(r"\s*<!-- (not run|file): (.+?) -->\s*")


@dataclass(frozen=True)
class Block:
    """A piece of a page: its language (``"python"``, ``"shell"`` or ``"toml"``), text, first line, and its mark."""

    page: str
    line: int
    kind: str
    text: str
    mark: str = ""
    said: str = ""

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def runs(self) -> bool:
        if self.kind == "shell" and any(USAGE.search(" ".join(words)) for words in commands(self.text)):
            return False
        return self.mark != "not run" and (self.kind != "toml" or self.mark == "file")


def pages() -> list[str]:
    """README and every page of docs, those that have a block."""
    found = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [path.relative_to(ROOT).as_posix() for path in found if blocks(path.relative_to(ROOT).as_posix())]


def blocks(page: str) -> list[Block]:
    """Blocks of a page, in order."""
    return list(_blocks(page, (ROOT / page).read_text("utf-8")))


def _blocks(page: str, text: str) -> Iterator[Block]:
    lines = text.splitlines()
    mark: tuple[str, str] = ("", "")
    k = 0
    while k < len(lines):
        line = lines[k]
        if found := MARK.fullmatch(line):
            mark = (found[1], found[2])
        elif fence := re.match(r"( *)```+ *(\w*)", line):
            stop = next(j for j in range(k + 1, len(lines) + 1) if j == len(lines) or lines[j].strip() == "```")
            kind = "shell" if fence[2] in SHELL else fence[2]
            if kind in ("python", "shell", "toml"):
                inside = [one.removeprefix(fence[1]) for one in lines[k + 1 : stop]]
                yield Block(page, k + 1, kind, "\n".join(inside) + "\n", *mark)
            mark, k = ("", ""), stop
        elif line.startswith("    ") and (k == 0 or not lines[k - 1].strip()):
            stop = next(j for j in range(k, len(lines) + 1) if j == len(lines) or not lines[j].startswith("    "))
            inside = [one.strip() for one in lines[k:stop]]
            if any(one.startswith(FIRST) for one in inside) or mark[0]:
                yield Block(page, k + 1, "shell", "\n".join(inside) + "\n", *mark)
            mark, k = ("", ""), stop - 1
        elif line.strip():
            mark = ("", "")
        k += 1


def commands(text: str) -> list[list[str]]:
    """Lines of a shell as words, without comments, prompts and what continues the line before."""
    lines = text.replace("\\\n", " ").splitlines()
    found = [shlex.split(line.removeprefix("$ "), comments=True) for line in lines]
    return [words for words in found if words]


def prepare(page: str) -> None:
    """The sets that a page begins with, in the folder where we are."""
    from loadid import datasets

    for name in FILES.get(page, ()):
        getattr(datasets, name)(".")


def run(block: Block, scope: dict[str, Any]) -> tuple[str, float]:
    """Run a block in the folder where we are; what it printed, and the CPU seconds that it took."""
    start, said = _spent(), io.StringIO()
    with contextlib.redirect_stdout(said):
        if block.kind == "toml":
            Path(block.said).write_text(block.text, "utf-8")
        elif block.kind == "python":
            exec(compile("\n" * block.line + block.text, block.page, "exec"), scope)
        else:
            for words in commands(block.text):
                _command(block, words)
    return said.getvalue(), _spent() - start


def _spent() -> float:
    """CPU seconds of this process and of those that it waited for."""
    return sum(os.times()[:4])


def _command(block: Block, words: list[str]) -> None:
    from loadid import cli

    if words[:2] == ["python", "-c"]:
        exec(compile(words[2], str(block), "exec"), {})
        return
    assert words[0] == "loadid", f"{block}: {' '.join(words)} is no line that a test can run; mark it"
    words, target = (words[:-2], words[-1]) if words[-2:-1] == [">"] else (words, "")
    said = io.StringIO()
    with contextlib.redirect_stdout(said) if target else contextlib.nullcontext():
        code = cli.main(words[1:])
    if target:
        Path(target).write_text(said.getvalue(), "utf-8")
    assert code == 0, f"{block}: {' '.join(words)} ended with {code}"
