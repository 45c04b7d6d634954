"""The table that a stream of loads is written to: it only grows, and is cut back to where a checkpoint saw it."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

TAIL = 256  # bytes before the end by which an output is known again


class Output:
    """A file, or a pipe.

    Parameters
    ----------
    where : str or binary file
        An open file is taken for a pipe, which cannot be cut back and is left open.
    head : str
        First line.
    place : dict, optional
        Where a checkpoint saw it (`place`): what was written later is cut off.

    Raises
    ------
    InputError
        A file that is not, or no longer, what the checkpoint saw.
    """

    def __init__(self, where: str | BinaryIO, head: str, place: dict[str, Any] | None = None) -> None:
        self.path: Path | None = None
        self.at, self._tail = 0, b""
        if not isinstance(where, str):
            self._file: BinaryIO = where
            if place is None:
                self._put(head.encode() + b"\n")
            return
        self.path = path = Path(where)
        if place is not None and place["where"] == str(path.resolve()):
            self._file = _reopened(path, int(place["at"]), str(place["tail"]))
            self.at = int(place["at"])
            self._file.seek(max(self.at - TAIL, 0))
            self._tail = self._file.read()
            return
        self._file = path.open("wb", buffering=0)
        self._put(head.encode() + b"\n")

    def write(self, times: NDArray, load: NDArray, std: NDArray) -> None:
        """One line a sample: time, loads, stds, with all their digits."""
        if len(times):
            table = np.column_stack([times, load, std]).tolist()
            self._put("".join([",".join(map(repr, row)) + "\n" for row in table]).encode())

    def sync(self) -> None:
        """Everything is on the disk when this returns."""
        self._file.flush()
        if self.path is not None:
            os.fsync(self._file.fileno())

    def place(self) -> dict[str, Any] | None:
        """Where it ends now."""
        if self.path is None:
            return {"where": "-", "at": self.at, "tail": ""}
        return {"where": str(self.path.resolve()), "at": self.at, "tail": _digest(self._tail)}

    def close(self) -> None:
        """Close the file."""
        if self.path is None:
            self._file.flush()
        else:
            self._file.close()

    def _put(self, data: bytes) -> None:
        left = memoryview(data)
        while left:  # a raw file may take less than it is given
            left = left[self._file.write(left) :]
        if self.path is None:
            self._file.flush()
        self.at += len(data)
        self._tail = (self._tail + data[-TAIL:])[-TAIL:]


def _reopened(path: Path, at: int, tail: str) -> BinaryIO:
    try:
        file = path.open("r+b", buffering=0)
    except FileNotFoundError:
        raise InputError("the output of the checkpoint is gone", where=str(path), expected=f"{at} bytes of it",
                         hint="put it back, or write to a file of another name") from None  # fmt: skip
    file.seek(max(at - TAIL, 0))
    found = file.read(min(at, TAIL))
    if len(found) < min(at, TAIL) or _digest(found) != tail:
        file.close()
        raise InputError("the output is not the one that the checkpoint saw", where=str(path),
                         found=f"{path.stat().st_size} bytes", expected=f"at least {at}, as they were written",
                         hint="put it back, or write to a file of another name")  # fmt: skip
    file.truncate(at)
    return file


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
