"""Universal files (UFF, UNV): their time responses as records, one column for each degree of freedom.

Responses with the same time base are the channels of one record; where a channel comes a second time, the next record
begins. The FRFs of such a file are a model and no record: ``structures.files.read_frfs`` reads them.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from structures import units as _units
from structures.files._uff import SUFFIXES, StatedUnit, UffFile, parse_uff, unit_of
from structures.files._uff_datasets import TIME, Function

from .. import _stamps
from .curves import MODEL
from .settle import distinct
from .source import COLUMNS, Options, Source, Table, register, truncated

SECONDS = 17  # data type of an abscissa that is time
OVER_TIME = ("auto correlation", "cross correlation")  # functions of a lag, which is a time too
_BEGIN = re.compile(rb"\s*^ {4}-1[ \t]*\r?\n {0,5}\d{1,6}", re.MULTILINE)


@register("UFF", suffixes=SUFFIXES, sniff=lambda head: _BEGIN.match(head) is not None)
def load(source: Source, options: Options) -> list[Table]:
    """One table for each run of time responses with a common time base."""
    file = parse_uff(source.data(), str(source.path))
    functions = [f for f in file.functions if f.head.function == TIME]
    if not functions:
        source.refuse("the file holds no time response", file.holds(), "functions of type 1 (data set 58 or 58b)",
                      MODEL)  # fmt: skip
    others = [
        f for f in file.functions if f.head.function != TIME and f.axis.type == SECONDS and f.name not in OVER_TIME
    ]
    strange = (
        [truncated(len(functions), len(functions) + len(others), f"time responses: {_said(others)}")] if others else []
    )
    runs = _runs(functions)
    names = [""] if len(runs) == 1 else [f"run {k + 1}" for k in range(len(runs))]
    tables = [_table(run, name, file, source) for run, name in zip(runs, names, strict=True)]
    passed = [f for f in file.functions if f.head.function != TIME and f not in others]
    note = (f"passed over: {_said(passed)}; structures.files.read_frfs reads FRFs as a model",) if passed else ()
    return [replace(t, flags=tuple(strange), notes=(*t.notes, *note)) for t in tables]


def _said(functions: list[Function]) -> str:
    """Functions that are no record, in words."""
    names = [f"{f.name} {f.response or 'unnamed'}".strip() for f in functions[:8]]
    return ", ".join(names) + (f" and {len(functions) - 8} more" if len(functions) > 8 else "")


def _runs(functions: list[Function]) -> list[list[Function]]:
    """Functions that are the channels of one record: the same abscissa, and none of them twice."""
    runs: list[list[Function]] = []
    for function in functions:
        run = runs[-1] if runs else None
        if run and _together(run[0], function) and not (function.response and _has(run, function)):
            run.append(function)
        else:
            runs.append([function])
    return runs


def _together(a: Function, b: Function) -> bool:
    return a.step == b.step and np.array_equal(a.abscissa, b.abscissa)


def _has(run: list[Function], function: Function) -> bool:
    return any(f.response == function.response for f in run)


def _table(run: list[Function], name: str, file: UffFile, source: Source) -> Table:
    if len(run) > COLUMNS:
        source.refuse("too many channels", len(run), f"at most {COLUMNS}")
    source.allow(8 * len(run) * len(run[0].values), "the record")
    labels = distinct([(f.response or f.head.axes[1].label).strip() for f in run])
    notes = [*filter(None, [file.title]), *file.notes, *dict.fromkeys(note for f in run for note in f.notes)]
    said = [unit_of(f.head.axes[1], f.head.response[2], file.system) for f in run]
    notes += [f"{label}: {s.why}" for label, s in zip(labels, said, strict=True) if s.why]
    columns = [np.real(f.values) * _scale(s) for f, s in zip(run, said, strict=True)]
    texts: list[str | None] = [_text(s) for s in said]
    scale = _seconds(run[0], source)
    if run[0].step is not None:
        if run[0].head.start:
            notes.append(f"time begins at {run[0].head.start * scale:g} s in the file, at 0 in the record")
        return Table(
            np.column_stack(columns), name, tuple(labels), tuple(texts), dt=run[0].step * scale,
            notes=tuple(notes), start=scale * run[0].head.start if _begun(run[0]) else None, begun=_begun(run[0]),
        )  # fmt: skip
    time = run[0].abscissa * scale
    return Table(
        np.column_stack([time, *columns]), name, ("time", *labels), ("s", *texts), time=0, notes=tuple(notes),
        begun=_begun(run[0]),
    )  # fmt: skip


def _begun(function: Function) -> str:
    """When the record began, of the third line of text, where instruments put it; its abscissa may begin later."""
    text = function.head.ids[2].strip()
    return text if _stamps.form(text) in ("stamp", "date") else ""


def _seconds(function: Function, source: Source) -> float:
    """Seconds of one unit of the abscissa."""
    text = function.axis.unit
    unit = _units.parse(text) if text and _units.known(text) else None
    if function.axis.type not in (0, 1, 17) or (text and (unit is None or unit.quantity != "time")):
        source.refuse("the abscissa of a time response is no time",
                      f"data type {function.axis.type}, unit {text or 'not named'}", "data type 17 and seconds",
                      "export it again with time as abscissa")  # fmt: skip
    return unit.factor if unit else 1.0


def _scale(said: StatedUnit) -> float:
    """1 where the unit has a symbol of its own; else its size, and the numbers become SI here."""
    return 1.0 if said.unit is None or _units.known(said.unit.symbol) else said.unit.factor


def _text(said: StatedUnit) -> str | None:
    if said.unit is None:
        return None
    return said.unit.symbol if _units.known(said.unit.symbol) else said.unit.si
