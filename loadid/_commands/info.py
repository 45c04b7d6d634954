"""``loadid info``: what is in a file, or what a guard code means."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import structures
from structures._advice import on_command_line
from structures._flags import table as codes
from structures.files import _storage as storage

from .._results.summary import quantity, summary
from . import Command, add_details, add_log_options, emit, load_model, read_records, settings, table
from .calibrate import describe as describe_hits
from .calibrate import show as show_hits

if TYPE_CHECKING:
    from structures._model import Model

MODELS = ("forward model", "modal model", "state space")  # kinds of files
FIRST = 10  # natural frequencies that are listed
EXAMPLES = """\
examples:
  channels, units, rate and health of a log; of one record of several:
    loadid info log.csv
    loadid info runs.mat --record run3
  where the file does not tell them:
    loadid info bare.npy --fs 10000 --columns force,acc --unit force=N --unit acc=g
  what a result says, and how it was found:
    loadid info result.h5 --details
  what the code of a flag means, with an example and the cure:
    loadid info W407
"""


def universal(path: str | Path) -> dict[str, Any] | None:
    """Functions, degrees of freedom and axes of a universal file; None of any other file, and of one with records.

    Raises
    ------
    InputError
        If it is one and is damaged.
    """
    from structures.files._uff import SUFFIXES, read_uff
    from structures.files._uff_datasets import FRF, TIME

    if Path(path).suffix.lower() not in SUFFIXES or not Path(path).is_file():
        return None
    file = read_uff(path)
    if not file.functions or any(f.head.function == TIME for f in file.functions):
        return None
    found: dict[str, Any] = {"title": file.title} if file.title else {}
    found["functions"] = file.holds()
    for name, axis in (("response", 1), ("reference", 2)):
        texts = {getattr(f, name) or "not named": f.head.axes[axis].unit for f in file.functions}
        listed = [f"{label} [{unit}]" if unit else label for label, unit in texts.items()]
        found[f"{name}s"] = ", ".join(listed[:50]) + (f" and {len(listed) - 50} more" if len(listed) > 50 else "")
    spans = {(len(f.abscissa), f.abscissa[0], f.abscissa[-1], f.axis.unit) for f in file.functions}
    found["axes"] = "; ".join(f"{n} values, {a:.6g} to {b:.6g} {unit}".strip() for n, a, b, unit in sorted(spans)[:8])
    found |= {"notes": "; ".join(file.notes)} if file.notes else {}
    if any(f.head.function == FRF for f in file.functions):
        found["to_read_it"] = (
            f"--model {path} takes it as a model; loadid model import {path} -o model.h5 keeps it as one"
        )
    return found


def info(
    path: str | Path, records: list[str] | None = None, *, arrays: bool = True, details: bool = False, **reading: Any
) -> dict[str, Any]:
    """What is in a log, a model file or a result file, as plain values.

    Parameters
    ----------
    path : path
    records : list of str, optional
        Names of the records to describe; default all.
    arrays : bool
        Whether a result file is given with its arrays.
    details : bool
        Whether the summary of a result says how the load was found, too.
    **reading
        As for `loadid._readers.read`.

    Returns
    -------
    dict
        ``kind`` is ``"log"`` (with ``records``, or with ``tables`` and ``to_read_it`` where something must be stated
        first), ``"load estimate"`` (with ``summary``), ``"measured model"`` (with ``sensors``, ``hits``, ...) or
        ``"universal file"`` (with the ``content`` of one that holds no record); of a guard code, where no file is
        called so, ``"guard code"`` (with what the table of codes says).

    Raises
    ------
    InputError
        If the file is no such file, damaged, or not usable.
    """
    if (code := str(path).upper().removeprefix("LID-")) in codes() and not Path(path).exists():
        return {"kind": "guard code", **_code(code)}
    kind = None if Path(path).is_dir() else storage.kind_of(path)
    if kind is None and (held := universal(path)):
        return {"kind": "universal file", "file": str(path), "content": held}
    if kind is None:
        return {"kind": "log", "file": str(path), **_log(path, records, reading)}
    if kind == "load estimate":
        from .._results.estimate import LoadEstimate

        estimate = LoadEstimate.read(path)
        said = summary(estimate, details=details, command=True)
        return {"kind": kind, "file": str(path), "summary": said, **estimate.to_dict(arrays=arrays)}
    if kind == "measured model":
        return {"kind": kind, "file": str(path), **_model(path)}
    if kind == "table of FRFs":
        return {"kind": kind, "file": str(path), "content": _table(path)}
    if kind in MODELS:
        return {"kind": kind, "file": str(path), "content": _dynamic(load_model(path))}
    return {"kind": kind, "file": str(path), "content": _outline(storage.read(path, kind))}


def _code(code: str) -> dict[str, Any]:
    """What the table of codes says of one of them."""
    guard = codes()[code]
    advice = on_command_line(guard.advice)
    return {"code": guard.code, "title": guard.title, "level": guard.level, "stage": guard.stage,
            "condition": guard.condition, "example": guard.example, "advice": advice, "docs": guard.docs}  # fmt: skip


def show_code(data: dict[str, Any]) -> str:
    """A guard code as text: what it is, when it is raised, how a flag reads, what to do."""
    lines = [f"{data['code']} ({data['level']}, {data['stage']}): {data['title']}", f"  when: {data['condition']}",
             f"  example: {data['example']}", f"  what to do: {data['advice']}", f"  more: {data['docs']}"]  # fmt: skip
    return "\n".join(lines)


def _log(path: str | Path, records: list[str] | None, reading: dict[str, Any]) -> dict[str, Any]:
    """Records of a log; what is known of them where units or the step must be stated before it can be read."""
    from .._quality import describe
    from .._readers import outline
    from .._readers.source import NotStated

    try:
        return {"records": [describe(r) for r in read_records(path, records, reading)]}
    except NotStated as error:
        return {"tables": [asdict(table) for table in outline(path, **reading)], "to_read_it": error.command}


def _model(path: str | Path) -> dict[str, Any]:
    """What a measured model was made from and what it covers."""
    model = structures.MeasuredModel.load(path)
    return {
        **describe_hits(model),
        "sensors": [{"label": c.label, "unit": c.unit, "quantity": c.quantity} for c in model.sensors],
        "loads": [{"label": c.label, "unit": c.unit, "quantity": c.quantity} for c in model.loads],
        "dt": model.dt,
        "lines": len(model.frequencies),
        "band": [0.0, float(model.frequencies[-1])],
        "samples": model.samples,
        "certificate": None if model.certificate is None else str(model.certificate),
        "flags": [f.to_dict() for f in model.flags],
        "fingerprint": model.fingerprint,
    }


def _channels(model: Model) -> dict[str, str]:
    """Sensors and loads in words."""
    return {
        "sensors": ", ".join(f"{c.label} [{c.unit}]" for c in model.sensors),
        "loads": ", ".join(f"{c.label} [{c.unit}]" for c in model.loads),
    }


def _dynamic(model: Model) -> dict[str, Any]:
    """What a model that knows its structure, its modes or its states tells of itself."""
    f = model.natural_frequencies
    modes = [] if f is None else [x for x in np.atleast_1d(f).tolist() if np.isfinite(x)]
    shown = ", ".join(f"{x:.5g}" for x in modes[:FIRST]) + (f" and {len(modes) - FIRST} more" * (len(modes) > FIRST))
    structure = model.structure
    return {
        **_channels(model),
        **({} if structure is None else {"structure": f"{len(structure.dofs)} degrees of freedom"}),
        **({"natural frequencies": f"{shown} Hz"} if modes else {}),
        **({} if model.dt is None else {"step": f"{model.dt:.6g} s"}),
        "verification": str(model.certificate or "forward model not verified"),
        "flags": "; ".join(f"{f.code}: {f.message}" for f in model.flags) or "none",
        "fingerprint": model.fingerprint[:16],
    }


def _table(path: str | Path) -> dict[str, Any]:
    """What a table of FRFs covers."""
    model = structures.FrfModel.load(path)
    return {
        **_channels(model),
        "lines": f"{len(model.frequencies)}, {model.frequencies[0]:.6g} to {model.frequencies[-1]:.6g} Hz",
        "errors": "none stated" if model.variance is None else "variance of every FRF",
        "verification": str(model.certificate or "forward model not verified"),
        "flags": "; ".join(f"{f.code}: {f.message}" for f in model.flags) or "none",
        "fingerprint": model.fingerprint[:16],
    }


def _outline(tree: Any) -> Any:
    """A tree with arrays and long lists replaced by their shape."""
    if isinstance(tree, dict):
        return {k: _outline(v) for k, v in tree.items()}
    if isinstance(tree, list):
        return [_outline(v) for v in tree] if len(tree) <= 32 else f"list of {len(tree)}"
    return f"array {tree.shape} {tree.dtype}" if hasattr(tree, "shape") else tree


def show_record(record: dict[str, Any]) -> str:
    """A record as `loadid._quality.describe` gives it, as text."""
    name = f"record {record['name']!r}: " if record["name"] else ""
    head = f"{name}{record['samples']} samples, step {quantity(record['dt'], 's')} ({record['fs']:.6g} Hz), "
    lines = [head + f"{quantity(record['duration'], 's')} long"]
    rows = [["", "channel", "unit", "recorded in", "quantity", "min", "max", "rms", "offset", "noise"]]
    for i, channel in enumerate(record["channels"]):
        numbers = [channel[k] for k in ("min", "max", "rms", "offset", "noise")]
        texts = [channel[k] for k in ("label", "unit", "recorded_unit", "quantity")]
        rows.append([str(i), *texts, *("-" if x is None else f"{x:.4g}" for x in numbers)])
    lines.append(table(rows))
    lines += [f"  note: {note}" for note in record["notes"]]
    found = [*record["flags"], *(f for c in record["channels"] for f in c["findings"])]
    lines += [f"  {f['code']} {f['level']}: {f['message']} -> {f['advice']}" for f in found]
    return "\n".join(lines)


def show(data: dict[str, Any]) -> str:
    """Answer of `info` as text."""
    if data["kind"] == "guard code":
        return show_code(data)
    if "tables" in data:
        shown = [_show_table(t) for t in data["tables"]]
        return "\n".join([f"{data['file']}: {_counted(len(shown))}", *shown, data["to_read_it"]])
    if data["kind"] == "log":
        shown = [show_record(r) for r in data["records"]]
        return "\n\n".join([f"{data['file']}: {_counted(len(shown))}", *shown])
    if "summary" in data:
        return f"{data['file']}: {data['kind']}\n{data['summary']}"
    if data["kind"] == "measured model":
        return f"{data['file']}: {data['kind']}\n{_show_model(data)}"
    return "\n".join([f"{data['file']}: {data['kind']}", *_lines(data["content"], "  ")])


def _counted(records: int) -> str:
    return f"{records} record{'s' * (records != 1)}"


def _show_table(outline: dict[str, Any]) -> str:
    pairs = zip(outline["labels"], outline["units"], strict=True)
    named = ", ".join(f"{i}: {label} [{unit or 'unit not stated'}]" for i, (label, unit) in enumerate(pairs))
    step = f"step {outline['dt']:.6g} s" if outline["dt"] else "step not stated"
    lines = [f"  {outline['name'] or 'record'}: {outline['samples']} samples, {step}, channels {named}"]
    return "\n".join(lines + [f"  note: {note}" for note in outline["notes"]])


def _show_model(data: dict[str, Any]) -> str:
    def channels(key: str) -> str:
        return ", ".join(f"{c['label']} [{c['unit']}]" for c in data[key])

    lines = [
        f"  sensors {channels('sensors')}; loads {channels('loads')}",
        f"  step {quantity(data['dt'], 's')}, {data['lines']} lines from 0 to {data['band'][1]:.6g} Hz",
    ]
    if data["hits"]:
        used = sum(h["used"] for h in data["hits"])
        lines += [f"  {used} of {len(data['hits'])} hits used", *show_hits(data).splitlines()[1:]]
    else:
        lines.append("  made from an FRF, not from hits")
    lines.append(f"  verification: {data['certificate'] or 'forward model not verified'}")
    lines += [f"  {f['code']} {f['level']}: {f['message']} -> {f['advice']}" for f in data["flags"]]
    return "\n".join([*lines, f"  fingerprint {data['fingerprint'][:16]}"])


def _lines(tree: Any, indent: str) -> list[str]:
    lines: list[str] = []
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in items:
        nested = isinstance(value, dict) or (isinstance(value, list) and any(isinstance(v, dict | list) for v in value))
        lines += [f"{indent}{key}:", *_lines(value, indent + "  ")] if nested else [f"{indent}{key}: {value}"]
    return lines


def _configure(parser: ArgumentParser) -> None:
    parser.epilog, parser.formatter_class = EXAMPLES, RawDescriptionHelpFormatter
    parser.add_argument("file", metavar="FILE", help="log, model or result; or the code of a flag, W407")
    parser.add_argument("--json-full", action="store_true", help="as --json, with the arrays of a result")
    add_details(parser)
    add_log_options(parser, several=True)


def _run(args: Namespace) -> int:
    data = info(args.file, args.record, arrays=args.json_full, details=args.details, **settings(args))
    emit(args, data, show(data))
    return 0


command = Command("info", "say what is in a log, a model or a result, or what a flag means", _configure, _run)
