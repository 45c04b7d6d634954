"""TOML of strangers: parsed only where it is small, flat and short of keys, so that it costs no more than its size."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from .errors import InputError

LARGEST = 10_000_000  # characters
DOTS = 32  # in one key: the parser's cost grows with their square
DEPTH = 64  # of arrays and tables within each other
_QUOTED = re.compile(r'"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'')
_BETWEEN = re.compile(r"[,=\[\]{}\n#]")


def load(path: Path, wrong: str, hint: str) -> dict[str, Any]:
    """The tables of a file.

    Parameters
    ----------
    path : Path
    wrong, hint : str
        What is said of a file that is no TOML, and what to do.

    Raises
    ------
    OSError
        A file that cannot be opened.
    InputError
        No TOML; or a file, a key or a nesting beyond any that people write.
    """
    with path.open("rb") as file:
        data = file.read(LARGEST + 1)
    found = ""
    try:
        text = data.decode("utf-8")
        found = _beyond(text)
        if not found:
            return tomllib.loads(text)
    except UnicodeDecodeError:
        found, hint = "bytes that are no text", "name the TOML file here: this is a file of another kind"
    except (ValueError, RecursionError, OverflowError) as error:  # a number of 200 000 digits is a bare ValueError
        found = str(error)[:200] or "too many levels"
    raise InputError(wrong, where=str(path), found=found, expected="TOML", hint=hint)


def _beyond(text: str) -> str:
    """What in a text is larger than people write it; "" where nothing is."""
    if len(text) > LARGEST:
        return f"more than {LARGEST} characters"
    bare = _QUOTED.sub('""', text)
    dots = max(part.count(".") for part in _BETWEEN.split(bare))
    if dots > DOTS:
        return f"a key of {dots + 1} parts"
    deepest = depth = 0
    for mark in re.findall(r"[\[\]{}]", bare):
        depth = depth + 1 if mark in "[{" else max(depth - 1, 0)
        deepest = max(deepest, depth)
    return f"{deepest} levels within each other" if deepest > DEPTH else ""
