"""Subcommands: one module each, registered under the entry-point group ``loadid.commands``.

A package adds its own by an entry point that names a `Command`. Modules here are imported for every command line, so
they import what is heavy inside functions.
"""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..codes import explained


@dataclass(frozen=True)
class Command:
    """One subcommand.

    Parameters
    ----------
    name, help : str
        Word on the command line; one line for the list of commands.
    configure : callable
        Adds the arguments to a parser.
    run : callable
        Does the work and returns the exit code; raises InputError (exit 3) or NotIdentifiable (exit 4).
    """

    name: str
    help: str
    configure: Callable[[ArgumentParser], None]
    run: Callable[[Namespace], int]


def emit(args: Namespace, data: Any, text: str) -> None:
    """Print the answer: text for people, one strict JSON value with ``--json``."""
    if args.json or getattr(args, "json_full", False):
        from .._results.archive import plain

        if isinstance(data, dict) and "flags" in data:
            flags = [explained(flag) if isinstance(flag, dict) else flag for flag in data["flags"]]
            data = {**data, "flags": flags}
        text = json.dumps(plain(data), allow_nan=False, ensure_ascii=False)
    print(text)


def names(text: str) -> list[str]:
    """``"a,b"`` as a list, for options that take several channels."""
    return [part.strip() for part in text.split(",") if part.strip()]


def table(rows: list[list[str]]) -> str:
    """Rows as aligned columns; the first row is the head."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)
    return "\n".join(f"  {line}" for line in lines)
