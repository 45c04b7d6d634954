"""What came and cannot be asked for again, on the disk before it is tracked.

A journal is a folder of segments, ``journal-00000001.bin``, ..., each a row of frames: length, CRC-32, and what came in
a round, each with its length and a JSON line (structure, serial number, key of the message) before the bytes. A last
frame that is not whole was being written when the process or the machine went down: nobody has confirmed any of it, and
it is none. Segments that every structure has left behind are
removed; of an old one that only a halted structure needs, its frames are kept.
"""

from __future__ import annotations

import json
import logging
import os
import re
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from structures.errors import InputError
from structures.files import _storage as storage

FRAME, LENGTH = struct.Struct("<II"), struct.Struct("<I")  # length and CRC of a frame; length of an entry
SEGMENTS = re.compile(r"journal-(\d{8,})\.bin")
SEGMENT = 16 << 20  # bytes, from which a new one is begun
SPARSE = 0.5  # share of a segment that is needed, below which the rest is dropped
log = logging.getLogger(__name__)


class JournalEntry(NamedTuple):
    """Bytes that came for a structure.

    Parameters
    ----------
    to : str
        Name of the structure.
    serial : int
        How many came for it before.
    key : str
        By which a message is known again that is sent twice; "" for none.
    data : bytes
    fresh : bool
        The first of a connection: it may begin with a header, and repeat what came.
    """

    to: str
    serial: int
    key: str
    data: bytes
    fresh: bool = False


class Journal:
    """The segments of a folder.

    Parameters
    ----------
    folder : path

    Raises
    ------
    InputError
        A segment that is damaged before its end, a folder that cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.last: dict[Path, dict[str, int]] = {}  # of each closed segment, the last serial of each structure
        listed = [(SEGMENTS.fullmatch(path.name), path) for path in folder.glob("journal-*.bin")]
        paths = {int(found[1]): path for found, path in listed if found is not None}
        for _, path in sorted(paths.items()):
            self.last[path] = _lasts(_frames(path))
        self._number = max(paths, default=0)
        self._begin()

    def entries(self) -> Iterator[JournalEntry]:
        """Everything, in the order in which it came."""
        for path in [*self.last, self._path]:
            yield from _frames(path)

    @property
    def size(self) -> int:
        """Bytes of all segments."""
        return sum(path.stat().st_size for path in self.last) + self._size

    def append(self, entries: Sequence[JournalEntry]) -> None:
        """Put entries on the disk; they are there when this returns.

        Raises
        ------
        InputError
            They cannot be written.
        """
        if not entries:
            return
        data = _framed(entries)
        try:
            left = memoryview(data)
            while left:
                left = left[self._file.write(left) :]
            os.fsync(self._file.fileno())
        except OSError as error:
            raise InputError("the journal cannot be written", where=str(self._path),
                             found=error.strerror or str(error),
                             hint="make room and start again: nothing confirmed is lost") from None  # fmt: skip
        self._size += len(data)
        for entry in entries:
            self._open[entry.to] = entry.serial
        if self._size >= SEGMENT:
            self.turn()

    def turn(self) -> None:
        """Begin a new segment, where this one has anything."""
        if not self._size:
            return
        self._file.close()
        self.last[self._path] = self._open
        self._begin()

    def forget(self, reached: Mapping[str, int]) -> None:
        """Drop what all checkpoints hold: serials from which each structure would go on."""
        for path, last in list(self.last.items()):
            needed = {name for name, serial in last.items() if name in reached and serial >= reached[name]}
            if not needed:
                path.unlink(missing_ok=True)
                del self.last[path]
            elif len(needed) < len(last):
                kept = [e for e in _frames(path) if e.to in needed and e.serial >= reached[e.to]]
                data = _framed(kept)
                if len(data) < SPARSE * path.stat().st_size:
                    storage.replace(path, data)
                self.last[path] = {name: last[name] for name in needed}  # not read again before one of these is done

    def close(self) -> None:
        """Close it; a segment without a frame is removed."""
        self._file.close()
        if not self._size:
            self._path.unlink(missing_ok=True)

    def _begin(self) -> None:
        self._number += 1
        self._path, self._size = self.folder / f"journal-{self._number:08d}.bin", 0
        self._open: dict[str, int] = {}
        try:
            storage.replace(self._path, b"")  # its name is on the disk too
            self._file = self._path.open("ab", buffering=0)
        except (OSError, InputError) as error:
            found = error.found if isinstance(error, InputError) else error.strerror
            raise InputError("the journal cannot be written", where=str(self._path), found=found,
                             hint="check the folder states") from None  # fmt: skip


def _framed(entries: Sequence[JournalEntry]) -> bytes:
    """One frame."""
    parts = []
    for entry in entries:
        head = json.dumps([entry.to, entry.serial, entry.key, entry.fresh]).encode() + b"\n"
        parts += [LENGTH.pack(len(head) + len(entry.data)), head, entry.data]
    body = b"".join(parts)
    return FRAME.pack(len(body), zlib.crc32(body)) + body


def _frames(path: Path) -> Iterator[JournalEntry]:
    """Entries of a segment; the last one may be torn."""
    data, at = path.read_bytes(), 0
    while at < len(data):
        length, crc = FRAME.unpack_from(data, at) if at + FRAME.size <= len(data) else (0, 0)
        end = at + FRAME.size + length
        body = data[at + FRAME.size : end]
        if not length or end > len(data) or (end == len(data) and zlib.crc32(body) != crc):
            log.warning("%s: the last %d bytes are no whole frame, and were never confirmed", path, len(data) - at)
            return
        if zlib.crc32(body) != crc:
            raise InputError("the journal is damaged", where=str(path), found=f"a wrong checksum at byte {at}",
                             expected="frames as they were written",
                             hint="put a copy back, or move the file away: what it holds is lost")  # fmt: skip
        yield from _entries(body)
        at = end


def _entries(body: bytes) -> Iterator[JournalEntry]:
    """What a frame holds."""
    at = 0
    while at < len(body):
        (length,) = LENGTH.unpack_from(body, at)
        head, _, rest = body[at + LENGTH.size : at + LENGTH.size + length].partition(b"\n")
        to, serial, key, fresh = json.loads(head)
        yield JournalEntry(to, serial, key, rest, fresh)
        at += LENGTH.size + length


def _lasts(entries: Iterator[JournalEntry] | Sequence[JournalEntry]) -> dict[str, int]:
    return {entry.to: entry.serial for entry in entries}
