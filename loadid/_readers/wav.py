"""WAV files: integers as parts of full scale, so that 1 is the largest number of the converter; floats as they are.

A WAV file has no place for units. What one of its numbers means is stated by the number at full scale and its unit:
``units={"ch1": "100 g"}``, ``--unit "ch1=100 g"``.
"""

from __future__ import annotations

import io
import struct

from structures._flags import Flag

from .source import COLUMNS, Options, Source, Table, register, truncated

KINDS = (b"RIFF", b"RIFX", b"RF64")


@register("WAV", suffixes=(".wav",), sniff=lambda head: head[:4] in KINDS and head[8:12] == b"WAVE")
def load(source: Source, options: Options) -> list[Table]:
    """The samples of the file, channels ch1, ch2, ..."""
    from scipy.io import wavfile

    data = source.data()
    start, declared, frame = _data_of(data, source)
    there = min(declared, len(data) - start) // frame * frame
    if there <= 0:
        source.refuse("the file holds no samples", f"{len(data) - start} bytes of data", f"{declared} bytes")
    whole = data
    flags: tuple[Flag, ...] = ()
    if there < declared:
        size = struct.pack(">I" if data[:4] == b"RIFX" else "<I", there)
        if data[:4] != b"RF64":
            whole = data[: start - 4] + size + data[start : start + there]
        flags = (truncated(there // frame, -(-declared // frame)),)
    elif (stated := _stated(data)) > len(data) + 1:  # a byte that fills up may be left out
        flags = (truncated(len(data), stated, "bytes"),)
    rate, values = wavfile.read(io.BytesIO(whole))
    values = values.reshape(len(values), -1)
    if len(values) != there // frame or values.shape[1] > COLUMNS:
        source.refuse("the data chunk is damaged", f"{values.shape}", f"{there // frame} samples")
    if rate <= 0:
        source.refuse("the sampling frequency is not positive", f"{rate} Hz", "Hz, > 0")
    notes: tuple[str, ...] = ()
    if values.dtype.kind in "iu":
        largest = 2.0 ** (8 * values.dtype.itemsize - 1)
        offset = largest if values.dtype.kind == "u" else 0.0
        values = (values.astype(float) - offset) / largest
        notes = ('full scale is 1: state what it stands for, such as units={"ch1": "100 g"}',)
    names = tuple(f"ch{i + 1}" for i in range(values.shape[1]))
    return [Table(values, source.path.stem, names, dt=1.0 / rate, flags=flags, notes=notes)]


def _stated(data: bytes) -> int:
    """Bytes of the file as it says itself, 0 where it does not: who writes as it records leaves a number open."""
    size = int(struct.unpack_from(">I" if data[:4] == b"RIFX" else "<I", data, 4)[0])
    return 0 if size == 0xFFFFFFFF else size + 8


def _data_of(data: bytes, source: Source) -> tuple[int, int, int]:
    """First byte of the samples, bytes that their chunk declares, and bytes of a sample of all channels."""
    order = ">" if data[:4] == b"RIFX" else "<"
    at, frame, long = 12, 0, 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}4sI", data, at)
        if kind == b"ds64" and at + 24 <= len(data):
            long = int(struct.unpack_from("<Q", data, at + 16)[0])
        if kind == b"fmt " and at + 22 <= len(data):
            form, channels, rate, speed, frame, bits = struct.unpack_from(f"{order}HHIIHH", data, at + 8)
            if not channels or frame != channels * ((bits + 7) // 8) or speed != rate * frame:
                found = f"form {form}, {channels} channels, {bits} bits, {frame} bytes a sample, {speed} bytes/s"
                source.refuse("the header of the file is damaged", found, "numbers that agree")
        if kind == b"data":
            if not frame:
                source.refuse("no format stands in front of the samples", "a data chunk", "a fmt chunk before it")
            declared = long if size == 0xFFFFFFFF and long else size
            source.allow(8 * declared // max(1, frame), "the file")
            return at + 8, declared, frame
        at += 8 + size + size % 2
    return source.refuse("the file ends before its samples", f"{len(data)} bytes", "a data chunk")
