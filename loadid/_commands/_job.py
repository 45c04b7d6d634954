"""A job file: what ``loadid identify`` is asked for, in TOML, with the names of Python; and the resolved job as text.

    log = "hit4.csv"
    model = "model.h5"
    output = "result.h5"
    family = "deconvolution"
    support = [0.1, 0.106]
    noise = {a1 = 0.2, a2 = 0.3}

Paths count from the folder of the job. The resolved job holds everything that was given, also on the command line, and
the family that was taken: run again, it gives the same load, bit for bit.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from structures.errors import InputError

from .. import __version__, _toml
from .._toml import PlanReader, is_number
from ._settings import FAMILIES, OPTIONS

FILES = ("log", "model")  # that are read
OUTPUTS = ("output", "report", "plot")
WORDS = (*FILES, *OUTPUTS, "family", "record", "responses", "truth", "reading")
READING = ("fs", "columns", "axis", "units")
SUFFIX = ".job.toml"


def read(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What a job says, its paths from the folder of the job on, its values checked.

    Raises
    ------
    InputError
        No such file, no TOML, a key that is none (with the nearest one), a value that fits none.
    """
    tree = _toml.read(path, "job")
    plan = PlanReader(os.fspath(path), {"job": (*WORDS, *OPTIONS), "reading": READING})
    plan.known(tree, "job", plan.where)
    found: dict[str, Any] = {}
    for name, value in tree.items():
        if name == "reading":
            found[name] = _reading(plan, plan.table(tree, name))
        elif name == "responses" or (name == "record" and isinstance(value, list)):
            found[name] = _texts(plan, name, value)
        elif name in WORDS:
            found[name] = plan.text(tree, name, "the job")
        else:
            found[name] = _value(plan, name, value)
    if found.get("family", "auto") not in FAMILIES:
        plan.refused("family", found["family"], " or ".join(FAMILIES))
    folder = Path(path).parent
    return {name: os.fspath(folder / value) if name in (*FILES, *OUTPUTS) else value for name, value in found.items()}


def _texts(plan: PlanReader, name: str, value: Any) -> list[str]:
    if not isinstance(value, list) or not value or not all(isinstance(one, str) for one in value):
        plan.refused(name, value, "a list of texts")
    return list(value)


def _reading(plan: PlanReader, table: Mapping[str, Any]) -> dict[str, Any]:
    plan.known(table, "reading", "[reading]")
    fits = {
        "fs": is_number, "columns": lambda v: isinstance(v, list) and all(isinstance(one, str) for one in v),
        "axis": lambda v: v in (0, 1) and not isinstance(v, bool),
        "units": lambda v: isinstance(v, dict) and all(isinstance(one, str) for one in v.values()),
    }  # fmt: skip
    for name, value in table.items():
        if not fits[name](value):
            plan.refused(f"[reading], {name}", value, "as loadid.read takes it")
    return dict(table)


def _value(plan: PlanReader, name: str, value: Any) -> Any:
    """A setting, as its option would give it."""
    one = OPTIONS[name]
    if one.flag:
        texts = name == "nonnegative" and isinstance(value, list) and all(isinstance(v, str) for v in value)
        if not (isinstance(value, bool) or texts):
            plan.refused(name, value, "true or false")
        return value
    if one.choices and value not in one.choices:
        plan.refused(name, value, " or ".join(one.choices))
    if isinstance(value, str) and one.parse is not None:
        from argparse import ArgumentTypeError

        try:
            return one.parse(value)
        except ArgumentTypeError as error:
            plan.refused(name, value, str(error))
    if not _plain(value):
        plan.refused(name, value, "texts, finite numbers, lists and tables of them")
    if one.parse is not None and is_number(value) and one.metavar and "," not in one.metavar:
        return _value(plan, name, repr(value))  # the option checks the range
    return value


def _plain(value: Any) -> bool:
    """Whether a value is made of texts, numbers (infinite where a side is open), lists and tables alone."""
    if isinstance(value, list):
        return all(_plain(one) for one in value)
    if isinstance(value, dict):
        return all(_plain(one) for one in value.values())
    return isinstance(value, str | bool) or (isinstance(value, int | float) and not math.isnan(value))


# -- written -----------------------------------------------------------------------------------------------------------
def beside(result: str | os.PathLike[str]) -> Path:
    """Where the resolved job of a result stands: ``result.job.toml`` of ``result.h5``."""
    return Path(result).with_suffix(SUFFIX)


def resolved(job: Mapping[str, Any], folder: Path) -> str:
    """A job as text, its paths counted from a folder."""
    lines = [f"# loadid {__version__}: loadid identify {{this file}} gives the same load again"]
    for name, value in job.items():
        if value is None:
            continue
        if name in (*FILES, *OUTPUTS):
            value = Path(os.path.relpath(value, folder)).as_posix()
        lines.append(f"{name} = {written(value)}")
    return "\n".join(lines) + "\n"


def written(value: Any) -> str:
    """A value in TOML, on one line; numbers with all their digits.

    Raises
    ------
    InputError
        What no TOML says.
    """
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value)  # inf and nan are written alike
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_quoted(str(name))} = {written(one)}" for name, one in value.items()) + "}"
    if isinstance(value, Sequence):
        return "[" + ", ".join(written(one) for one in value) + "]"
    raise InputError("a job file cannot say this", where="job", found=type(value).__name__,
                     expected="texts, numbers, lists and tables")  # fmt: skip


def _quoted(text: str) -> str:
    """A basic string of TOML."""
    names = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t", "\r": "\\r"}
    return (
        '"' + "".join(names.get(c) or (c if ord(c) >= 32 and ord(c) != 127 else f"\\u{ord(c):04x}") for c in text) + '"'
    )
