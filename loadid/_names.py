"""Names of channels and columns: looked up with a hint, and told apart where a file writes one over several."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence

import numpy as np

from structures.errors import InputError


def find(key: str | int, names: Sequence[str], *, what: str, where: str) -> int:
    """Position of a name, or of an index from 0 (an int, or its text where no name is that text).

    Raises
    ------
    InputError
        If there is none; the message lists the names and the nearest one. A name that several columns of a file carry.
    """
    if isinstance(key, str):
        if key in names:
            return list(names).index(key)
        refuse_copies(key, names, what=what, where=where)
        if key.strip().isascii() and key.strip().isdecimal() and len(key) < 9:
            key = int(key)
    if isinstance(key, int | np.integer) and not isinstance(key, bool) and -len(names) <= key < len(names):
        return int(key) % len(names)
    near = difflib.get_close_matches(str(key), names, n=1, cutoff=0.5)
    same = [n for n in names if n.lower() == str(key).strip().lower()]
    listed = ", ".join(f"{i}: {n}" for i, n in enumerate(names[:50])) + (", ..." if len(names) > 50 else "")
    raise InputError(
        f"there is no {what} {key!r}",
        where=where,
        found=f"the {what}s {listed}",
        expected="one of their names or indices",
        hint=f"did you mean {(same or near)[0]!r}?" if same or near else f"name one of the {what}s",
    )


def copy_of(name: str, column: int) -> str:
    """Label of one of several columns (counted from 1) over which a file writes the same name."""
    return f"{name} (column {column})"


def refuse_copies(name: str, names: Sequence[str], *, what: str, where: str) -> None:
    """Nothing, unless several columns of a file carry the name: it says which of them is meant nowhere.

    Raises
    ------
    InputError
        The columns, and how one of them is named.
    """
    label = re.compile(re.escape(name.strip()) + r" \(column (\d+)\)")
    alike = {i: match[1] for i, n in enumerate(names) if (match := label.fullmatch(n))}
    if alike:
        raise InputError(f"the {what} {name!r} could be several columns", where=where,
                         found=f"the name over {'columns' if len(alike) > 1 else 'another column, and over column'} "
                         f"{' and '.join(alike.values())}", expected="a name of its own for every column that is used",
                         hint="rename the columns in the file, or name the one that is meant: "
                         + " or ".join(f"{i} (index) or {names[i]!r}" for i in alike))  # fmt: skip
