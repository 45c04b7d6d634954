"""One run for each file: locks that the system lets go of, whatever ends the process."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from structures.errors import InputError


class StateLock:
    """Holds the file of a state for one run, until it is closed; stands for its path meanwhile.

    A state is replaced as a whole by every checkpoint, so what is locked is a file beside it.

    Parameters
    ----------
    path : path

    Raises
    ------
    InputError
        Another run holds it, or its folder cannot be written.
    """

    def __init__(self, path: str | os.PathLike) -> None:
        self.path = Path(path)
        self._beside = self.path.parent.resolve() / f".{self.path.name}.lock"
        self._file = self._held()

    def __fspath__(self) -> str:
        return os.fspath(self.path)

    def __enter__(self) -> StateLock:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of it."""
        with suppress(OSError):  # a system that keeps open files keeps an empty one, which holds nobody up
            self._beside.unlink()
        self._file.close()

    def _held(self) -> BinaryIO:
        while True:
            try:
                file = self._beside.open("ab")
            except OSError as error:
                raise InputError("the state cannot be written", where=str(self.path),
                                 found=error.strerror or str(error), hint="check the path") from None  # fmt: skip
            if not taken(file):
                file.close()
                raise InputError("another run goes on from this state", where=str(self.path),
                                 expected="one run for each state",
                                 hint="end that run first, or name another file with --state")  # fmt: skip
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), self._beside.stat()):
                    return file
            file.close()  # the run that held it took it away meanwhile


def taken(file: BinaryIO) -> bool:
    """Whether no other process holds the file; this one does from now on, where the system has locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # a file system without locks
        pass
    return True
