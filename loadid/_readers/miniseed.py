"""miniSEED files (versions 2 and 3): channels network.station.location.channel, gaps as NaN or as records.

The numbers are counts of a digitiser; what one count is states their unit, ``units={"XX.STA.00.HNZ": "2e-6 m/s^2"}``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._flags import Flag

from .source import COLUMNS, Options, Source, Table, register, seconds_of, truncated

GRID = 0.01  # steps by which channels of one record may be apart
MISSING = 0.25  # share of a record that may be gaps; beyond, its pieces are records
NANO = 1e-9


@dataclass(frozen=True, eq=False)
class _Piece:
    """Samples without a gap: channel, first sample in ns since 1970, step in ns, values."""

    channel: str
    start: int
    step: float
    values: NDArray[Any]

    @property
    def end(self) -> float:
        return self.start + len(self.values) * self.step


def _is_miniseed(head: bytes) -> bool:
    if head[:3] == b"MS\x03":
        return True
    return len(head) >= 48 and head[:6].isdigit() and head[6:7] in b"DRQM" and head[7:8] in b" \0"


@register(
    "miniSEED",
    suffixes=(".mseed", ".miniseed", ".msd", ".mseed3"),
    sniff=_is_miniseed,
    native=True,
    library="pymseed",
)
def load(source: Source, options: Options) -> list[Table]:
    """Channels of one rate and time as one record, with NaN in their gaps."""
    pieces, flags = _pieces(source)
    tables = []
    for step in dict.fromkeys(p.step for p in pieces):
        for group in _together([p for p in pieces if p.step == step]):
            tables.append(_table(group, flags, source))
    if len(tables) > 1:
        counts: dict[str, int] = {}
        for k, table in enumerate(tables):
            counts[table.name] = counts.get(table.name, 0) + 1
            if counts[table.name] > 1:
                tables[k] = Table(**{**vars(table), "name": f"{table.name} {counts[table.name]}"})
    return tables


def _pieces(source: Source) -> tuple[list[_Piece], tuple[Flag, ...]]:
    """Traces without gaps of all channels; samples that the last record lacks are flagged."""
    from pymseed import MiniSEEDError, MS3Record, MS3TraceList, sourceid2nslc

    place = str(source.place or source.path)
    size, total, last = 0, 0, 0
    flags: tuple[Flag, ...] = ()
    try:
        for record in MS3Record.from_file(place, unpack_data=False, validate_crc=True):
            size, last = size + record.reclen, record.reclen
            total += record.samplecnt
            source.allow(8 * total, "the file")
    except MiniSEEDError as error:
        if not size or size + last <= source.size:
            source.refuse("a record is damaged", f"byte {size}: {str(error)[:160]}", "records of miniSEED")
        flags = (truncated(source.size, size + last, "bytes"),)
    data = (source.place or source.path).read_bytes()[:size]
    found = []
    for trace in MS3TraceList.from_buffer(data, unpack_data=True, validate_crc=True):
        name = ".".join(sourceid2nslc(trace.sourceid)) if trace.sourceid.startswith("FDSN:") else trace.sourceid
        for part in trace:
            values = np.array(part.np_datasamples)
            if values.dtype.kind not in "fiu" or not part.samprate > 0:
                continue
            if len(values) != part.samplecnt:
                source.refuse(f"truncated: {len(values)} of {part.samplecnt} samples", name, "all that are declared")
            found.append(_Piece(name, int(part.starttime), 1e9 / part.samprate, values))
    if not found:
        source.refuse("the file holds no samples", f"{size} bytes of records", "records with numbers")
    return sorted(found, key=lambda p: (p.start, p.channel)), flags


def _together(pieces: list[_Piece]) -> list[list[_Piece]]:
    """Pieces of one rate in groups that are records: on one grid, and with few gaps."""
    groups: list[list[_Piece]] = []
    for piece in pieces:
        for group in groups:
            away = (piece.start - group[0].start) / piece.step
            twice = any(p.channel == piece.channel and p.end > piece.start + GRID * piece.step for p in group)
            if abs(away - round(away)) <= GRID and not twice and _sparse([*group, piece]) <= MISSING:
                group.append(piece)
                break
        else:
            groups.append([piece])
    return groups


def _sparse(group: list[_Piece]) -> float:
    """Share of a record that no piece covers."""
    first, last = min(p.start for p in group), max(p.end for p in group)
    cells = round((last - first) / group[0].step) * len({p.channel for p in group})
    return 1 - sum(len(p.values) for p in group) / max(1, cells)


def _table(group: list[_Piece], flags: tuple[Flag, ...], source: Source) -> Table:
    step = group[0].step
    names = sorted({p.channel for p in group})
    first, last = min(p.start for p in group), max(p.end for p in group)
    count = round((last - first) / step)
    if len(names) > COLUMNS:
        source.refuse("too many channels", len(names), f"at most {COLUMNS}")
    source.allow(8 * count * len(names), "the record")
    values = np.full((count, len(names)), np.nan)
    for p in group:
        at = round((p.start - first) / step)
        values[at : at + len(p.values), names.index(p.channel)] = p.values
    notes = []
    for k, name in enumerate(names):
        if missing := int(np.isnan(values[:, k]).sum()):
            notes.append(f"{missing} samples of {name} are missing, first at sample "
                         f"{int(np.argmax(np.isnan(values[:, k])))}: set to NaN")  # fmt: skip
    begin = np.datetime64(first, "ns")
    return Table(
        values,
        name=f"{begin.astype('datetime64[ms]')}Z",
        columns=tuple(names),
        dt=step * NANO,
        flags=flags,
        notes=tuple(notes),
        start=seconds_of(first),
    )
