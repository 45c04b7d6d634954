"""Parts to tables: loads, peaks, cycles, sensors, alarms and records, by asset and day."""

from __future__ import annotations

import csv
import datetime as dt
import io
import json
import math
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

from structures.errors import InputError
from structures.files import _storage as storage

from .loads import Kept, equivalent, joined
from .plan import Asset, Fatigue, Plan
from .records import Entry, Manifest, part_of, pieces_of
from .run import Failed

Row = dict[str, Any]
UNKNOWN = "unknown"  # day of a record whose beginning nobody told
MISFIT = 3.0  # of a sensor over the median of its asset, from which it is an alarm
TABLES = {
    "records": {
        "asset": str, "day": str, "record": str, "start": str, "samples": int, "dt": float, "pieces": int,
        "status": str, "said": str, "grade": str, "expected_error": float, "verdict": str, "rule": str, "lam": float,
        "codes": str,
    },
    "loads": {
        "asset": str, "day": str, "record": str, "load": str, "unit": str, "samples": int, "mean": float, "rms": float,
        "std": float, "min": float, "max": float, "peak": float, "peak_std": float, "peak_low": float,
        "peak_high": float, "peak_at": float, "cycles": float,
    },
    "peaks": {
        "asset": str, "day": str, "record": str, "load": str, "unit": str, "at": float, "peak": float,
        "peak_std": float, "peak_low": float, "peak_high": float,
    },
    "cycles": {
        "asset": str, "day": str, "record": str, "load": str, "unit": str, "range_low": float, "range_high": float,
        "count": float,
    },
    "sensors": {
        "asset": str, "day": str, "record": str, "sensor": str, "unit": str, "mean": float, "rms": float,
        "missing": float, "misfit": float, "found": str,
    },
    "alarms": {
        "asset": str, "day": str, "record": str, "about": str, "kind": str, "certain": bool, "value": float,
        "limit": float, "said": str,
    },
}  # fmt: skip


@dataclass
class Results:
    """Rows of every table, in the order of the plan.

    Parameters
    ----------
    rows : dict of str to list
        Table -> its rows.
    columns : dict of str to dict
        Table -> its columns and their types.
    """

    rows: dict[str, list[Row]] = field(default_factory=lambda: {name: [] for name in TABLES})
    columns: dict[str, dict[str, type]] = field(default_factory=lambda: {n: dict(c) for n, c in TABLES.items()})


def gathered(plan: Plan, manifest: Manifest, failed: Iterable[Failed] = ()) -> Results:
    """Tables of all parts; a record without one is listed with the reason.

    Of two records of an asset that overlap in time the later one is refused, so that nothing counts twice.
    """
    found = Results()
    for m in () if plan.fatigue is None else plan.fatigue.exponents:
        found.columns["loads"][_name(m)] = float
    why: dict[str, str] = {}
    for one in failed:
        why.setdefault(one.chunk.parent or one.chunk.key, one.said)
    ends: dict[int, tuple[float, str]] = {}
    for entry in manifest.entries:
        asset = plan.assets[entry.chunk.asset]
        base = {"asset": asset.name, "day": _day(entry.start), "record": _shown(plan, entry.chunk.record)}
        tree = _tree(plan, entry)
        if tree is None or entry.chunk.key in why:
            said = why.get(entry.chunk.key, "it was not worked on")
            found.rows["records"].append({**base, "status": "failed", "said": said})
        elif tree["kind"] == "refused":
            found.rows["records"].append({**base, "status": "refused", "said": tree["said"]})
        else:
            over = _overlapping(entry, tree, ends)
            if over:
                found.rows["records"].append({**base, "status": "refused", "said": over})
                continue
            _add(found, plan, asset, entry, tree, base)
    for bad in manifest.bad:
        base = {"asset": plan.assets[bad.asset].name, "day": UNKNOWN, "record": _shown(plan, bad.record)}
        found.rows["records"].append({**base, "status": "refused", "said": bad.said})
    _alarms_of_sensors(found)
    return found


def _overlapping(entry: Entry, tree: Mapping[str, Any], ends: dict[int, tuple[float, str]]) -> str:
    if entry.start is None:
        return ""
    last, before = ends.get(entry.chunk.asset, (-math.inf, ""))
    if entry.start < last - 0.5 * tree["dt"]:
        return (f"{entry.chunk.record}: overlaps an earlier record; found: begins {_iso(entry.start)}; expected: not "
                f"before {_iso(last)}, where {before} ends; what to do: take one of them away")  # fmt: skip
    ends[entry.chunk.asset] = entry.start + tree["samples"] * tree["dt"], entry.chunk.record
    return ""


def _tree(plan: Plan, entry: Entry) -> dict[str, Any] | None:
    """The part of a record, with those of its pieces in it; None where one is not there."""
    try:
        tree: dict[str, Any] = json.loads(part_of(str(plan.output), entry.chunk.key).read_bytes())
        tree["parts"] = [
            json.loads(part_of(str(plan.output), key).read_bytes()) for key, _, _ in pieces_of(entry.chunk, tree)
        ]
    except FileNotFoundError:
        return None
    refused = next((part for part in tree["parts"] if part["kind"] == "refused"), None)
    return refused or tree


def _add(
    found: Results, plan: Plan, asset: Asset, entry: Entry, tree: dict[str, Any], base: Row
) -> None:  # fmt: skip
    parts = tree["parts"] or [tree]
    pieces = [[Kept.of(one) for one in part["loads"]] for part in parts]
    whole = [joined([piece[j] for piece in pieces]) for j in range(len(tree["labels"]))]
    found.rows["records"].append({
        **base, "start": "" if entry.start is None else _iso(entry.start), "samples": tree["samples"], "dt": tree["dt"],
        "pieces": len(parts), "status": "done", "said": "", "grade": tree["grade"],
        "expected_error": tree["expected_error"], "verdict": tree["verdict"], "rule": tree["rule"], "lam": tree["lam"],
        "codes": " ".join(tree["codes"]),
    })  # fmt: skip
    misfits = _misfits(parts, len(tree["sensors"]))
    for sensor, misfit in zip(tree["sensors"], misfits, strict=True):
        found.rows["sensors"].append({
            **base, "sensor": sensor["label"], "unit": sensor["unit"], "mean": sensor["mean"], "rms": sensor["rms"],
            "missing": sensor["missing"], "misfit": misfit, "found": " ".join(sensor["found"]),
        })  # fmt: skip
    for j, (label, unit, kept) in enumerate(zip(tree["labels"], tree["units"], whole, strict=True)):
        row = {**base, "load": label, "unit": unit}
        found.rows["loads"].append({**row, **kept.numbers, **_fatigue(kept, plan.fatigue, tree["dt"])})
        for piece in pieces:
            n = piece[j].numbers
            bands = {name: n[name] for name in ("peak", "peak_std", "peak_low", "peak_high")}
            found.rows["peaks"].append({**row, "at": n["peak_at"], **bands})
        if kept.cycles is not None:
            for k, count in kept.cycles.whole.classes.items():
                ends = {"range_low": 10 ** (k / 20), "range_high": 10 ** ((k + 1) / 20)}
                found.rows["cycles"].append({**row, **ends, "count": count})
        if label in asset.limits:
            found.rows["alarms"] += _exceeded(base, label, unit, kept, asset.limits[label])


def _fatigue(kept: Kept, asked: Fatigue | None, dt: float) -> Row:
    if asked is None or kept.cycles is None:
        return {"cycles": None}
    count = max(asked.rate * kept.samples * dt, 1e-300)
    half = 0.5 * max(len(kept.cycles.residue) - 1, 0)
    return {"cycles": kept.cycles.closed + half} | {
        _name(m): equivalent(kept.cycles, m, count) for m in asked.exponents
    }


def _exceeded(base: Row, label: str, unit: str, kept: Kept, limit: tuple[float, float]) -> Iterator[Row]:
    """An alarm for each limit that the load went beyond: for certain where its whole band did."""
    sides = (
        (kept.low, kept.sure[0], kept.perhaps[0], limit[0], -1.0),
        (kept.high, kept.sure[1], kept.perhaps[1], limit[1], 1.0),
    )
    for value, sure, perhaps, end, side in sides:
        if side * (perhaps - end) > 0:
            certain = side * (sure - end) > 0
            words = "beyond" if certain else "perhaps beyond"
            yield {**base, "about": label, "kind": "limit", "certain": certain, "value": value, "limit": end,
                   "said": f"{label}: {value:.4g} {unit}, {words} {end:.4g} {unit}"}  # fmt: skip


def _misfits(parts: Sequence[Mapping[str, Any]], sensors: int) -> list[float | None]:
    """Residual over response of every sensor, root mean square; None where it is not known."""
    sums = [part["misfit"] for part in parts]
    if any(one is None or len(one) != sensors for one in sums):
        return [None] * sensors
    return [
        math.sqrt(math.fsum(one[k][0] for one in sums) / total) if (total := math.fsum(one[k][1] for one in sums)) > 0
        else None for k in range(sensors)
    ]  # fmt: skip


def _alarms_of_sensors(found: Results) -> None:
    """A sensor with findings, or with a misfit far above its usual one."""
    usual: dict[tuple[str, str], list[float]] = {}
    for row in found.rows["sensors"]:
        if row["misfit"] is not None:
            usual.setdefault((row["asset"], row["sensor"]), []).append(row["misfit"])
    for row in found.rows["sensors"]:
        base = {name: row[name] for name in ("asset", "day", "record")} | {"about": row["sensor"], "kind": "sensor"}
        if row["found"]:
            found.rows["alarms"].append({**base, "certain": False, "value": row["missing"], "limit": None,
                                         "said": f"{row['sensor']}: {row['found']}"})  # fmt: skip
        values = sorted(usual.get((row["asset"], row["sensor"]), []))
        middle = values[len(values) // 2] if len(values) > 2 else None
        if middle is not None and row["misfit"] is not None and row["misfit"] > MISFIT * middle:
            said = f"{row['sensor']}: misfit {row['misfit']:.3g}, usually {middle:.3g}"
            found.rows["alarms"].append({**base, "certain": False, "value": row["misfit"], "limit": MISFIT * middle,
                                         "said": said})  # fmt: skip


# -- files ------------------------------------------------------------------------------------------------------------
def write(results: Results, folder: Path) -> str:
    """Write all tables, by asset and day, in place of those that are there; the format: ``parquet`` or ``csv``."""
    fresh, old = folder.with_name(f".{folder.name}.new"), folder.with_name(f".{folder.name}.old")
    for one in (fresh, old):
        shutil.rmtree(one, ignore_errors=True)
    form = _format()
    for name, rows in results.rows.items():
        columns = results.columns[name]
        for (asset, day), some in _partitions(rows).items():
            place = fresh / name / f"asset={quote(asset, safe=' ')}" / f"day={day}"
            place.mkdir(parents=True)
            shown = {c: kind for c, kind in columns.items() if c not in ("asset", "day")}
            data = _parquet(some, shown) if form == "parquet" else _csv(some, shown)
            (place / f"part.{form}").write_bytes(data)
    fresh.mkdir(parents=True, exist_ok=True)
    if folder.exists():
        folder.rename(old)
    fresh.rename(folder)
    shutil.rmtree(old, ignore_errors=True)
    return form


def page_to(folder: Path, text: str) -> None:
    """Write the page of the fleet."""
    storage.replace(folder / "fleet.html", text.encode())


def _partitions(rows: Iterable[Row]) -> dict[tuple[str, str], list[Row]]:
    found: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        found.setdefault((row["asset"], row["day"]), []).append(row)
    return found


def _format() -> str:
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        return "csv"
    return "parquet"


def _parquet(rows: list[Row], columns: Mapping[str, type]) -> bytes:
    import pyarrow as pa
    from pyarrow import parquet

    kinds = {str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_()}
    arrays = [pa.array([row.get(name) for row in rows], kinds[kind]) for name, kind in columns.items()]
    out = io.BytesIO()
    parquet.write_table(pa.table(arrays, names=list(columns)), out)
    return out.getvalue()


def _csv(rows: list[Row], columns: Mapping[str, type]) -> bytes:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        values = (row.get(name) for name in columns)
        writer.writerow("" if v is None else repr(v) if isinstance(v, float) else v for v in values)
    return out.getvalue().encode()


# -- words ------------------------------------------------------------------------------------------------------------
def _name(exponent: float) -> str:
    return f"equivalent_m{exponent:g}"


def _day(start: float | None) -> str:
    return UNKNOWN if start is None else _iso(start)[:10]


def _iso(seconds: float) -> str:
    return dt.datetime.fromtimestamp(seconds, dt.UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _shown(plan: Plan, path: str) -> str:
    """A path as the plan has it, without the folder of the plan."""
    folder = str(plan.path.parent)
    return path.removeprefix(f"{folder}/") if folder != "." else path


def known_loads(plan: Plan) -> None:
    """Nothing, if every limit of a plan is that of a load of its model.

    Raises
    ------
    InputError
        A label that no load has.
    """
    from .._commands import load_model

    for asset in plan.assets:
        if asset.limits:
            labels = [c.label for c in load_model(asset.model).loads]
            wrong = [label for label in asset.limits if label not in labels]
            if wrong:
                raise InputError("a limit of a load that the model has not",
                                 where=f"{plan.path}, [[asset]] {asset.name}",
                                 found=", ".join(wrong), expected=f"some of {', '.join(labels)}")  # fmt: skip
