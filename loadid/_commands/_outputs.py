"""What a command writes: files, checked before anything is computed; a progress bar."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self, TextIO

from structures.errors import InputError


class Bar:
    """Callable ``bar(fraction, text)`` that redraws one line; silent where the stream is no terminal.

    It is what the command line passes as ``progress=``: any callable with these two arguments will do.

    Parameters
    ----------
    stream : text stream, optional
        Default standard error.
    interval : float
        Seconds between two drawings.
    """

    def __init__(self, stream: TextIO | None = None, *, interval: float = 0.1) -> None:
        self.stream = sys.stderr if stream is None else stream
        self.interval = interval
        self.shown = bool(getattr(self.stream, "isatty", lambda: False)())
        self._last = 0.0
        self._width = 0

    def __call__(self, fraction: float, text: str) -> None:
        """Show that `fraction` (0 to 1) of the work is done, and what is done now."""
        now = time.monotonic()
        if not self.shown or (now - self._last < self.interval and fraction < 1):
            return
        self._last = now
        full = round(20 * min(max(fraction, 0.0), 1.0))
        self._draw(f"{text} [{'#' * full}{'.' * (20 - full)}] {fraction:4.0%}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        if self._width:
            self._draw("")

    def _draw(self, text: str) -> None:
        print(f"\r{text.ljust(self._width)}" + ("" if text else "\r"), end="", file=self.stream, flush=True)
        self._width = len(text)


PICTURES = ("--plot",)  # options whose suffix names the format


def require_outputs(outputs: Mapping[str, str | Path | None], inputs: Sequence[str | Path | None] = ()) -> None:
    """Nothing, if every output can be written and none of them would replace an input or another output.

    Parameters
    ----------
    outputs : dict of option to path
        ``{"-o": "result.h5"}``; None stands for an option that was not given.
    inputs : sequence of path
        Files that the command reads.

    Raises
    ------
    InputError
        An empty path, a folder that is not there or cannot be written, an unknown kind of picture, a file named twice.
    """
    given = {option: Path(path) for option, path in outputs.items() if path is not None and _named(option, path)}
    for option, path in given.items():
        _require_place(option, path)
        if option in PICTURES:
            from .._plots import picture_format

            picture_format(path)
    read = [Path(path) for path in inputs if path is not None and os.fspath(path)]
    options = list(given)
    for k, option in enumerate(options):
        path = given[option]
        if any(same_file(path, other) for other in read):
            raise InputError("the output is a file that the command reads", where=f"{option} {path}",
                             expected="another file",
                             hint="choose another name; nothing was read or written")  # fmt: skip
        twin = next((other for other in options[:k] if same_file(path, given[other])), None)
        if twin is not None:
            raise InputError("two outputs are one file", where=f"{option} {path}", found=f"also {twin}",
                             expected="a file for each",
                             hint="choose another name for one of them; nothing was written")  # fmt: skip


def same_file(a: Path, b: Path) -> bool:
    """Whether two paths lead to one file: through links, other spellings of the folder, or a second name."""
    if a.resolve() == b.resolve():
        return True
    try:
        return os.path.samefile(a, b)
    except OSError:  # one of them does not exist
        return False


def _named(option: str, path: str | Path) -> bool:
    if not os.fspath(path).strip():
        raise InputError("the path is empty", where=option, expected="a file to write", hint="name a file")
    return True


def _require_place(option: str, path: Path) -> None:
    folder = path.resolve().parent
    where = f"{option} {path}"
    if not folder.is_dir():
        raise InputError(
            "the folder does not exist" if not folder.exists() else "a file stands where the folder should be",
            where=where,
            found=str(folder),
            hint="make the folder first, or write elsewhere",
        )
    if path.is_dir():
        raise InputError("this is a folder", where=where, expected="a file to write", hint="add a file name")
    try:
        with tempfile.TemporaryFile(dir=folder):  # permission bits do not tell everything: ask the file system
            pass
    except OSError as error:
        raise InputError("the folder cannot be written", where=where, found=error.strerror or error,
                         hint="choose a folder that may be written") from error  # fmt: skip
