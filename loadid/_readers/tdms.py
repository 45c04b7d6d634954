"""TDMS files of LabVIEW and DIAdem: groups as records, one for each length and step of their channels.

Step and unit are the properties ``wf_increment`` and ``unit_string`` of a channel, as National Instruments writes them
(white paper "TDMS File Format Internal Structure"; property names of the LabVIEW help, "Setting Waveform Attributes").
"""

from __future__ import annotations

from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from structures._flags import Flag

from .source import COLUMNS, Options, Source, Table, register, since, truncated

LEAD_IN = 28
UNKNOWN = 2**64 - 1  # of a segment that was not closed
RAW, BIG = 0x08, 0x40  # marks of a segment: it holds samples; its numbers are big-endian
VERSIONS = (4712, 4713)
UNITS = ("unit_string", "NI_UnitDescription", "unit", "Unit")


@register("TDMS", suffixes=(".tdms",), sniff=lambda head: head.startswith(b"TDSm"), native=True, library="nptdms")
def load(source: Source, options: Options) -> list[Table]:
    """Groups as records; channels of other lengths or steps are records of their own."""
    from nptdms import TdmsFile

    tables: list[Table] = []
    with (source.place or source.path).open("rb") as stream:
        declared = _declared(stream, source)
        stream.seek(0)
        with TdmsFile.open(stream, raw_timestamps=True) as file:
            channels = [c for group in file.groups() for c in group.channels()]
            source.allow(sum(8 * len(c) for c in channels), "the file")
            lost = _lost(file, declared > source.size)
            for group in file.groups():
                tables += _tables(group, lost, source)
    if declared > source.size:
        whole = [t for t in tables if not t.flags]
        cut = truncated(source.size, declared, "bytes")
        tables = [t if t.flags or len(whole) < len(tables) else Table(**{**vars(t), "flags": (cut,)}) for t in tables]
    return tables


def _declared(stream: BinaryIO, source: Source) -> int:
    """Bytes that the segments declare; one that was never closed declares a byte more than there is.

    A damaged mark or version would lose the samples of its segment in silence.
    """
    at = 0
    while at < source.size:
        stream.seek(at)
        lead = stream.read(LEAD_IN)
        if len(lead) < LEAD_IN:
            return at + LEAD_IN
        if lead[:4] not in (b"TDSm", b"DSm"):
            source.refuse("no segment begins here", f"byte {at}: {lead[:4]!r}", "TDSm")
        order: Literal["big", "little"] = "big" if lead[4] & BIG else "little"
        version, beyond, data = (int.from_bytes(lead[a:b], order) for a, b in ((8, 12), (12, 20), (20, 28)))
        if version not in VERSIONS:
            source.refuse("no segment of a known version", f"byte {at}: {version}", " or ".join(map(str, VERSIONS)))
        if beyond == UNKNOWN:
            return source.size + 1
        if beyond > data and not lead[4] & RAW:
            source.refuse("a segment holds samples and says that it holds none", f"byte {at}", "the mark of raw data")
        at += LEAD_IN + beyond
    return at


def _lost(file: Any, cut: bool) -> dict[str, int]:
    """Samples of each channel that the last segment declares and does not hold."""
    statuses = file.file_status.channel_statuses if cut else None
    return {path: s.expected_length - s.read_length for path, s in (statuses or {}).items()}


def _tables(group: Any, lost: dict[str, int], source: Source) -> list[Table]:
    """Records of one group."""
    columns: dict[tuple[int, float | None], list[tuple[Any, NDArray[Any]]]] = {}
    passed = []
    for channel in group.channels():
        step = _step(channel.properties.get("wf_increment"), channel.name, source)
        if not len(channel):
            continue
        stamps = hasattr(channel[:1], "as_datetime64")
        if not stamps and np.asarray(channel[:1]).dtype.kind not in "fiu":
            passed.append(channel.name)
            continue
        length = len(channel) + lost.get(channel.path, 0)
        values = channel[:].as_datetime64("ns") if stamps else np.asarray(channel[:])
        columns.setdefault((length, step), []).append((channel, values))
    notes = [f"passed over: {', '.join(passed[:20])} (no numbers)"] if passed else []
    return [_table(group.name, key, found, notes, len(columns) > 1, source) for key, found in columns.items()]


def _table(
    group: str,
    key: tuple[int, float | None],
    found: list[tuple[Any, NDArray[Any]]],
    notes: list[str],
    several: bool,
    source: Source,
) -> Table:
    declared, step = key
    if len(found) > COLUMNS:
        source.refuse("too many channels", len(found), f"at most {COLUMNS}")
    there = min(len(values) for _, values in found)
    flags: tuple[Flag, ...] = (truncated(there, declared),) if there < declared else ()
    about = [channel.properties for channel, _ in found]
    stamps = [i for i, (_, values) in enumerate(found) if values.dtype.kind == "M"]
    columns = [values[:there] for _, values in found]
    times = {i: since(columns[i]) for i in stamps}
    begun = next((p["wf_start_time"] for p in about if "wf_start_time" in p), None)
    start = since(np.array([begun.as_datetime64("ns")]))[1] if begun is not None else None
    units = ["s" if i in stamps else _unit(p) for i, p in enumerate(about)]
    rate = f"{group}, {1 / step:.6g} Hz" if step else f"{group}, {declared} samples"
    return Table(
        np.column_stack([times[i][0] if i in times else x.astype(float) for i, x in enumerate(columns)]),
        name=rate if several else group,
        columns=tuple(channel.name for channel, _ in found),
        units=tuple(units),
        dt=step,
        time=stamps[0] if stamps else None,
        flags=flags,
        notes=tuple(notes),
        start=times[stamps[0]][1] if stamps else start,
    )


def _step(value: Any, name: str, source: Source) -> float | None:
    """Step of a channel in s; None where the writer states none."""
    if value is None or value == 0:
        return None
    step = float(value)
    if not (np.isfinite(step) and step > 0):
        source.refuse("the step is not positive", f"{name}: wf_increment = {value}", "seconds, > 0")
    return step


def _unit(properties: Any) -> str | None:
    """Text of the unit of a channel, where it has one."""
    return next((str(properties[k]).strip() for k in UNITS if str(properties.get(k, "")).strip()), None)
