"""A fitted tracker as C99 for a controller: `controller.c` and `controller.h` with the numbers of a fit.

The C does sample by sample what `engine.Engine` does: settled gain, square-root recursion with the channels that are
there, the gate with its doubts, ends of range, and the bounds of the loads. States are counted in units (powers of two,
so that doubles stay as they are) in which their std is about one: single precision has no room for the squares of
micrometres beside those of newtons.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from structures.errors import InputError, one_of
from structures.files import _storage as storage

from ..._guards.tracking import FAR
from ..._inverse.gaussian.model import FilterModel, FilterState, SquareRoot
from ..._inverse.gaussian.roots import Array, lower, solve_lower
from ..._inverse.gaussian.steady import SteadyFilter
from . import gate as odds
from . import judging
from .beginning import moving
from .engine import NEAR
from .fit import TrackerFit

IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")
TYPES = ("double", "float")
MANY = 1_000_000_000  # where counts of samples stop
WIDTH = 116  # of a line of numbers


def write_c(
    path: Path, fitted: TrackerFit, gate: float | None, width: Array | None = None, most: Array | None = None, *,
    name: str = "tracker", dtype: str = "double",
) -> Path:  # fmt: skip
    """Write a tracker as a C file, and its header beside it.

    Parameters
    ----------
    path : Path
        Of the C file.
    fitted : TrackerFit
    gate : float or None
    width : array (sensors,), optional
        Factors of the gate.
    most : array (loads,), optional
        Largest loads that are answered.
    name : str
        Prefix of all names that other files see.
    dtype : {"double", "float"}
        What it is compiled to unless a macro says otherwise.

    Raises
    ------
    InputError
        No C identifier, another type, a folder that is not there, a path without a suffix.
    """
    path = Path(path)
    if path.suffix.lower() in ("", ".h"):
        raise InputError("no name of a C file", where=str(path), found=repr(path.name), expected="one like tracker.c",
                         hint="the header is written beside it, with .h")  # fmt: skip
    texts = sources(fitted, gate, width, most, name=name, dtype=dtype, file=path.stem)
    for target, text in zip((path.with_suffix(".h"), path), texts, strict=True):
        storage.replace(target, text.encode("ascii"))
    return path


def sources(
    fitted: TrackerFit, gate: float | None, width: Array | None = None, most: Array | None = None, *,
    name: str = "tracker", dtype: str = "double", file: str = "tracker",
) -> tuple[str, str]:  # fmt: skip
    """Header and C99 source; parameters and refusals as those of `write_c`, `file` the name of the header."""
    if not isinstance(name, str) or not IDENTIFIER.fullmatch(name):
        raise InputError("no C identifier", where="name", found=repr(name)[:80],
                         expected="letters, digits, underscores")  # fmt: skip
    one_of("the type of numbers", dtype, TYPES, where="dtype")
    model = fitted.model
    facts = {
        "m": model.m, "p": model.p, "n": model.n, "gated": int(gate is not None), "file": _plain(file),
        "correlated": int(model.S is not None), "TYPE": dtype.upper(), "numbers": _numbers(fitted, gate, width, most),
    }  # fmt: skip
    head = _comment(fitted, gate, name)
    return tuple(head + _filled(kind, facts, name) for kind in ("controller.h", "controller.c"))  # type: ignore[return-value]


def _filled(kind: str, facts: Mapping[str, Any], name: str) -> str:
    """A file beside this one with its numbers and names."""
    text = (files(__package__) / kind).read_text("ascii")
    text = re.sub(r"\bLT_(?=[A-Z@])", name.upper() + "_", re.sub(r"\blt_(?=[a-z])", name + "_", text))
    return re.sub(r"@(\w+)@", lambda found: str(facts[found[1]]), text)


def _comment(f: TrackerFit, gate: float | None, name: str) -> str:
    """What it is, what goes in and out in which order, and what it does not do."""
    kept = [
        f"{name}: loads from samples, as the tracker that was fitted ({f.words}).",
        f"{f.model.n} states, {f.model.m} sensors, {f.model.p} loads, one sample every {f.dt!r} s",
        *(f"y[{i}]: {c.label}, {c.unit}" for i, c in enumerate(f.sensors)),
        *(f"load[{i}]: {c.label}, {c.unit}" for i, c in enumerate(f.loads)),
        "NaN marks a missing channel: the others are used, and the std is that of what was used.",
        "No gate: every finite number is believed." if gate is None else
        f"A channel beyond {gate:g} std is wrong, or an event of the load: the likelier, until later samples decide.",
        "Not here: the watch over the sensors, late answers, and late samples put in their place.",
        *(["The std does not hold the errors of the model that were declared."] if f.bank else []),
        "No heap, no files, no static variables; of libraries only math.h. Not with -ffast-math.",
    ]  # fmt: skip
    return "/* " + "\n   ".join(map(_plain, kept)) + " */\n"


def _plain(text: str) -> str:
    return re.sub(r"[^\x20-\x7e]", "?", str(text)).replace("*/", "* /").replace("/*", "/ *")


def _numbers(f: TrackerFit, gate: float | None, width: Array | None, most: Array | None) -> str:
    """Constants of the C file."""
    scale = _units(f)
    model, settled = _counted(f.model, scale), f.settled
    core = SquareRoot(model)
    sizes: dict[str, Any] = {"HAS_GAIN": int(settled is not None), "ARRIVED": NEAR}
    tables: dict[str, Array] = {"F": model.F, "H": model.H, "LR": model.LR, "CP": model.Cp, "X0": model.x0}
    tables["L0"], tables["MOVED"] = _square(lower(model.L0)), _square(moving(model, 1.0))
    tables["LQ"] = narrow(core.whole.LQ)
    if model.S is not None:
        tables["SHARED"] = solve_lower(model.LR, model.S.T).T
    sizes["Q"] = tables["LQ"].shape[1]
    if settled is not None:
        tables |= _gain(model, settled, scale)
        limit = np.full(model.m, np.inf) if gate is None else gate * _opened(width, model) * settled.innovation_std
        tables["LIMIT"] = np.minimum(limit, np.finfo(np.float32).max)
    if gate is not None:
        counts, found = _judging(f, model, gate, width, scale)
        sizes, tables = sizes | counts, tables | found
    sizes |= {"HAS_RANGES": int(f.limits is not None), "HAS_WIDER": int(f.wider is not None)}
    if f.limits is not None:
        ends = np.clip(f.limits, np.finfo(np.float32).min, np.finfo(np.float32).max)
        tables |= {"LOWEST": ends[:, 0], "HIGHEST": ends[:, 1]}
    if f.wider is not None:
        tables["WIDER"] = np.broadcast_to(f.wider, model.p)
    sizes["HAS_BOUNDS"] = int(most is not None and bool(np.isfinite(most).any()))
    if most is not None and sizes["HAS_BOUNDS"]:
        tables["BOUND"] = np.minimum(most, np.finfo(np.float32).max)
    sizes["LOG2PI"] = float(np.log(2 * np.pi))
    defined = [f"#define {key} {value!r}" for key, value in sizes.items()]
    return "\n".join([*defined, *(_table(key, value) for key, value in tables.items()), ""])


def _gain(model: FilterModel, settled: SteadyFilter, scale: Array) -> dict[str, Array]:
    """Tables of the settled gain, in units of the states."""
    p, m, n = model.p, model.m, model.n
    rows = settled.rows()
    rows[:, :n] *= scale
    rows[p + m :] /= scale[:, None]
    L = settled.L / scale[:, None]
    ahead = SquareRoot(model).predict(FilterState(model.x0, L, np.zeros(m))).L
    return {"ROWS": rows, "VARIANCE": np.sum(L**2, axis=1), "AHEAD": _square(ahead), "SETTLED_STD": settled.std}


def _judging(
    f: TrackerFit, model: FilterModel, gate: float, width: Array | None, scale: Array
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Numbers and tables of the gate."""
    one = odds.onset(f.model)
    ways = one if f.settled is None else odds.recent(f.settled, judging.PATIENCE)
    recent = ways.shape[1] // one.shape[1]
    reach = narrow(odds.reach(f.model) / scale[:, None])
    ways = np.array([narrow(part) for part in np.split(ways / scale[:, None], recent, axis=1)])
    sizes = {
        "GATE": float(gate), "PATIENCE": judging.PATIENCE, "DECISIVE": judging.DECISIVE, "TOLD": judging.TOLD,
        "WORSE": judging.WORSE, "OPEN": judging.OPEN, "CALM": odds.CALM, "OVER": odds.OVER, "RARE": odds.RARE,
        "DOUBLINGS": odds.DOUBLINGS, "ROUGH": odds.ROUGH, "SCALES": odds.SCALES, "FAR": FAR,
        "USUAL": odds.usual(f.model), "RECENT": recent, "WIDTH": ways.shape[2], "REACHED": reach.shape[1], "MANY": MANY,
    }  # fmt: skip
    return sizes, {"OPENING": _opened(width, model), "WAYS": ways, "HWAYS": model.H @ ways, "REACH": reach,
                   "HREACH": model.H @ reach}  # fmt: skip


def _opened(width: Array | None, model: FilterModel) -> Array:
    return np.ones(model.m) if width is None else np.asarray(width, float)


def _units(f: TrackerFit) -> Array:
    """Powers of two (n,), about the std of each state."""
    std = np.linalg.norm(odds.reach(f.model) if f.settled is None else f.settled.L, axis=1)
    there = np.isfinite(std) & (std > 0)
    return np.asarray(2.0 ** np.round(np.log2(np.where(there, std, 1.0))))


def _counted(model: FilterModel, scale: Array) -> FilterModel:
    """The same filter with its states in other units."""
    column = scale[:, None]
    return replace(
        model, F=model.F * scale / column, LQ=model.LQ / column, H=model.H * scale, Cp=model.Cp * scale,
        x0=model.x0 / scale, L0=model.L0 / column, S=None if model.S is None else model.S / column,
    )  # fmt: skip


def narrow(L: Array) -> Array:
    """The same root with no more columns than rows, and at least one."""
    L = lower(L) if L.shape[1] > len(L) else L
    return L if L.shape[1] else np.zeros((len(L), 1))


def _square(L: Array) -> Array:
    return np.hstack([L, np.zeros((len(L), len(L) - L.shape[1]))])


def _table(name: str, values: Array) -> str:
    """An array of C, each number as short as it can be read back."""
    numbers = [f"R({float(v)!r})" for v in np.ravel(values)]
    lines, line = [], ""
    for number in numbers:
        if len(line) + len(number) > WIDTH:
            lines.append(line.rstrip())
            line = ""
        line += number + ", "
    lines.append(line.removesuffix(", "))
    body = "\n  ".join(lines)
    return f"static const real {name}[{len(numbers)}] = {{\n  {body}}};"
