"""``loadid info``: what is in a file."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from structures.errors import InputError

from . import Command, emit
from ._logs import add_log_options, read_records, settings


def info(path: str | Path, records: list[str] | None = None, **reading: Any) -> dict[str, Any]:
    """What is in a log, a model file or a result file, as plain values.

    Parameters
    ----------
    path : path
    records : list of str, optional
        Names of the records to describe; default all.
    **reading
        As for `loadid.readers.read`.

    Returns
    -------
    dict
        ``kind`` is ``"log"`` (with ``records``) or the kind of the file (with ``summary``).
    """
    from structures import storage

    kind = storage.kind_of(path)
    if kind is None:
        return {"kind": "log", "file": str(path), **_log(path, records, reading)}
    if kind == "load estimate":
        from loadid.estimate import LoadEstimate

        estimate = LoadEstimate.read(path)
        return {"kind": kind, "file": str(path), "summary": estimate.summary(), **estimate.to_dict()}
    return {"kind": kind, "file": str(path), "content": _outline(storage.read(path, kind))}


def _log(path: str | Path, records: list[str] | None, reading: dict[str, Any]) -> dict[str, Any]:
    """Records of a log; raw tables where units or the step must be stated before it can be read."""
    from loadid.quality import describe
    from loadid.readers import scan

    try:
        return {"records": [describe(r) for r in read_records(path, records, reading)]}
    except InputError as error:
        if records or reading.keys() - {"axis"}:
            raise  # what was asked for does not fit the file
        tables = scan(path, **reading)  # raises where nothing can be read at all
        return {"tables": [_raw(table) for table in tables], "to_read_it": str(error)}


def _raw(table: Any) -> dict[str, Any]:
    rows, columns = table.values.shape if table.values.ndim == 2 else (len(table.values), 1)
    return {
        "name": table.name,
        "samples": rows,
        "columns": list(table.columns or [f"column {i}" for i in range(columns)]),
        "units": list(table.units or [None] * columns),
        "dt": table.dt,
    }


def _outline(tree: Any) -> Any:
    """A tree with arrays and long lists replaced by their shape."""
    if isinstance(tree, dict):
        return {k: _outline(v) for k, v in tree.items()}
    if isinstance(tree, list):
        return [_outline(v) for v in tree] if len(tree) <= 32 else f"list of {len(tree)}"
    return f"array {tree.shape} {tree.dtype}" if hasattr(tree, "shape") else tree


def table(rows: list[list[str]]) -> str:
    """Rows as aligned columns; the first row is the head."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)
    return "\n".join(f"  {line}" for line in lines)


def show_record(record: dict[str, Any]) -> str:
    """A record as `loadid.quality.describe` gives it, as text."""
    from loadid.summary import quantity

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
    if "tables" in data:
        return "\n".join(
            [f"{data['file']}: {len(data['tables'])} record(s)", *map(_show_raw, data["tables"]), data["to_read_it"]]
        )
    if data["kind"] == "log":
        return "\n\n".join([f"{data['file']}: {len(data['records'])} record(s)", *map(show_record, data["records"])])
    if "summary" in data:
        return f"{data['file']}: {data['kind']}\n{data['summary']}"
    return "\n".join([f"{data['file']}: {data['kind']}", *_lines(data["content"], "  ")])


def _show_raw(table: dict[str, Any]) -> str:
    named = ", ".join(f"{c} [{u or 'unit not stated'}]" for c, u in zip(table["columns"], table["units"], strict=True))
    step = f"step {table['dt']:.6g} s" if table["dt"] else "step not stated"
    return f"  {table['name'] or 'record'}: {table['samples']} samples, {step}, columns {named}"


def _lines(tree: Any, indent: str) -> list[str]:
    lines: list[str] = []
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in items:
        nested = isinstance(value, dict) or (isinstance(value, list) and any(isinstance(v, dict | list) for v in value))
        lines += [f"{indent}{key}:", *_lines(value, indent + "  ")] if nested else [f"{indent}{key}: {value}"]
    return lines


def _configure(parser: ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="log, model or result")
    add_log_options(parser, several=True)


def _run(args: Namespace) -> int:
    data = info(args.file, args.record, **settings(args))
    emit(args, data, show(data))
    return 0


command = Command("info", "say what is in a log, a model or a result file", _configure, _run)
