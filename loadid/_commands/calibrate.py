"""``loadid calibrate``: a measured forward model from hammer hits."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import structures
from structures.errors import InputError

from . import Command, add_log_options, channels, emit, read_records, require_outputs, resolved, settings, table

if TYPE_CHECKING:
    from structures._models.measured import MeasuredModel

    from .._record import Record


def calibrate(
    paths: Sequence[str | Path],
    *,
    force: str,
    responses: Sequence[str],
    records: list[str] | None = None,
    **reading: Any,
) -> MeasuredModel:
    """Model from the hits in some logs.

    Parameters
    ----------
    paths : sequence of path
        Logs; every record of every log is one hit.
    force, responses : str, sequence of str
        Channels, by name or index.
    records : list of str, optional
        Names of the records to use; default all.
    **reading
        As for `loadid._readers.read`.

    Raises
    ------
    InputError
        From the readers, or when no usable hit is left.
    """
    hits = []
    for path in paths:
        for record in read_records(path, records, reading):
            hits.append(record.select(resolved(record, [force, *responses], where="--force and --response")))
    _require_one_step(hits)
    force, *heard = hits[0].labels
    made: MeasuredModel = structures.MeasuredModel.from_hits(hits, force=force, responses=heard)
    return made


def _require_one_step(hits: Sequence[Record]) -> None:
    first = hits[0]
    other = next((h for h in hits if abs(h.dt / first.dt - 1) > 1e-6), None)
    if other is not None:
        raise InputError(
            "the hits have different steps",
            where=other.source or other.name or "hits",
            found=f"{other.fs:.9g} Hz, but {first.fs:.9g} Hz in {first.source or first.name or 'the first'}",
            expected="one sampling frequency",
            hint="leave one of the files out, or resample it",
        )


def describe(model: MeasuredModel) -> dict[str, Any]:
    """Hits and coherence of a measured model, as plain values."""
    return {
        "force": [c.label for c in model.loads],
        "responses": [c.label for c in model.sensors],
        "hits": [{"name": h.name, "used": h.used, "reason": h.reason, "peak": float(h.peak)} for h in model.hits],
        "coherence": coherence(model),
    }


def coherence(model: MeasuredModel) -> list[dict[str, Any]]:
    """Per sensor: median coherence, and the share of the lines on which it exceeds 0.9; None with one hit."""
    import numpy as np

    rows = []
    for j, sensor in enumerate(model.sensors):
        known = np.empty(0) if model.coherence is None else np.asarray(model.coherence, float)[:, j]
        known = known[np.isfinite(known)]
        rows.append(
            {
                "sensor": sensor.label,
                "median": float(np.median(known)) if known.size else None,
                "above_0.9": float(np.mean(known > 0.9)) if known.size else None,
            }
        )
    return rows


def show(data: dict[str, Any]) -> str:
    """Answer of `describe` as text."""
    hits = [["hit", "peak", "used", "reason"]]
    hits += [[h["name"], f"{h['peak']:.4g}", "yes" if h["used"] else "no", h["reason"]] for h in data["hits"]]
    lines = [f"force {', '.join(data['force'])}; responses {', '.join(data['responses'])}", table(hits)]
    rows = [["sensor", "median coherence", "lines above 0.9"]]
    for c in data["coherence"]:
        known = c["median"] is not None
        rows.append([c["sensor"], f"{c['median']:.4f}" if known else "-", f"{c['above_0.9']:.0%}" if known else "-"])
    lines.append(table(rows))
    if all(c["median"] is None for c in data["coherence"]):
        lines.append("  coherence needs two hits or more")
    return "\n".join(lines)


def _configure(parser: ArgumentParser) -> None:
    parser.add_argument("hits", nargs="+", metavar="HITS", help="logs with hammer hits")
    parser.add_argument("--force", required=True, metavar="CH", help="channel of the hammer")
    parser.add_argument("--response", required=True, type=channels, metavar="CH,...", help="channels of the sensors")
    parser.add_argument("-o", "--output", required=True, metavar="MODEL.h5", help="model file to write")
    add_log_options(parser, several=True)


def _run(args: Namespace) -> int:
    require_outputs({"-o": args.output}, args.hits)
    model = calibrate(args.hits, force=args.force, responses=args.response, records=args.record, **settings(args))
    model.save(args.output)
    data = describe(model)
    emit(args, {**data, "model": args.output}, f"{show(data)}\nmodel written to {args.output}")
    return 0


command = Command("calibrate", "make a forward model from hammer hits", _configure, _run)
