"""Subcommands: one module each, registered under the entry-point group ``loadid.commands``; here what they share.

A package adds its own by an entry point that names a `Command`. Modules here are imported for every command line, so
they import what is heavy inside functions.
"""

from __future__ import annotations

import json
import logging
import math
import os
import re
import sys
import tempfile
import time
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, TextIO

from structures._advice import did_you_mean
from structures._flags import explained
from structures.errors import InputError
from structures.files import _storage as storage

from .._inverse import penalties

if TYPE_CHECKING:
    from structures._models.forward import ForwardModel
    from structures._models.measured import MeasuredModel
    from structures._models.modal import ModalModel
    from structures._models.statespace import StateSpace
    from structures._models.tabulated import FrfModel

    from .._record import Record
    from .._results.estimate import LoadEstimate

log = logging.getLogger(__name__)

DICTIONARIES = ("dirac", "bspline", "wavelet")
STARTS = ("rest", "unknown")
NONE = "none"
NOT_USABLE = 1  # exit code of an answer that is not to be used
FIT_OPTIONS = ("prior", "noise", "lag", "replay", "scales", "model_error", "start", "gate", "allow_drift")  # of `track`
PICTURES = ("--plot",)  # options whose suffix names the format
WRITTEN = {"-o": (".h5", ".hdf5"), "--state": (".h5", ".hdf5"), "--report": (".html", ".htm")}  # suffixes of outputs


class UsageError(Exception):
    """Wrong words on the command line."""


@dataclass(frozen=True)
class Command:
    """One subcommand.

    Parameters
    ----------
    name, help : str
        Word on the command line; one line for the list of commands.
    configure : callable
        Adds the arguments to a parser.
    run : callable
        Does the work and returns the exit code, 0 or `NOT_USABLE`; raises InputError (exit 3) or NotIdentifiable (4).
    """

    name: str
    help: str
    configure: Callable[[ArgumentParser], None]
    run: Callable[[Namespace], int]


def emit(args: Namespace, data: Any, text: str) -> None:
    """Print the answer: text for people, nothing with ``--quiet``, one strict JSON value with ``--json``."""
    if args.json or getattr(args, "json_full", False):
        from .._results.archive import plain

        if isinstance(data, dict) and "flags" in data:
            flags = [explained(flag) if isinstance(flag, dict) else flag for flag in data["flags"]]
            data = {**data, "flags": flags}
        print(printable(json.dumps(plain(data), allow_nan=False, ensure_ascii=False)))
    elif not getattr(args, "hushed", False):
        print(printable(text))


def exit_code(estimate: LoadEstimate | None) -> int:
    """0 of an answer that may be used, `NOT_USABLE` of one with the worst grade, which is written and printed too."""
    return 0 if estimate is None or estimate.grade.usable else NOT_USABLE


def say(text: str, *, aside: bool = False) -> None:
    """Print a line at once, for who reads a pipe; aside (on standard error, if not `hushed`) what is no answer."""
    if aside:
        log.info("%s", text)
        if Bar.hushed:
            return
    print(printable(text), file=sys.stderr if aside else sys.stdout, flush=True)


_HARMFUL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """A text in which control characters, and marks that turn the direction of writing, are shown as in JSON.

    A name in a file may hold them; a terminal would obey them.
    """
    return _HARMFUL.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def names(text: str) -> list[str]:
    """``"a,b"`` as a list, for options that take several channels."""
    return [part.strip() for part in text.split(",") if part.strip()]


def table(rows: list[list[str]]) -> str:
    """Rows as aligned columns; the first row is the head."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)
    return "\n".join(f"  {line}" for line in lines)


# -- words of the command line, checked while it is parsed -------------------------------------------------------------
def number(text: str, what: str, fits: Callable[[float], bool]) -> float:
    """A finite number that fits; else the text is refused as being none of `what`."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and fits(value)):
        raise ArgumentTypeError(f"{text!r} is no {what}")
    return value


def frequency(text: str) -> float:
    """Sampling frequency in Hz, positive and finite."""
    return number(text, "sampling frequency in Hz, > 0", lambda rate: rate > 0 and math.isfinite(1 / rate))


def unit(text: str) -> str:
    """A text of the form CH=UNIT."""
    channel, sign, symbol = text.rpartition("=")
    if not (sign and channel.strip() and symbol.strip()):
        raise ArgumentTypeError(f"{text!r} is not CH=UNIT, for example force=N")
    return text


def channels(text: str) -> list[str]:
    """``"a,b"`` as a list of channels, at least one."""
    found = names(text)
    if not found:
        raise ArgumentTypeError("no channel is named")
    return found


def choice(text: str) -> str | float:
    """A rule, or a relative lambda >= 0."""
    from .._inverse.rules import RULES, known

    if known(text):
        return text
    what = f"rule ({', '.join(RULES)}) and no relative lambda >= 0{did_you_mean(text, RULES)}"
    return number(text, what, lambda lam: lam >= 0)


def penalty(text: str) -> str:
    """Name of a penalty, or ``none`` for plain least squares."""
    if text not in (*penalties.ORDER, NONE):
        more = did_you_mean(text, (*penalties.ORDER, NONE))
        raise ArgumentTypeError(f"{text!r} is no penalty ({penalties.names()}, {NONE}){more}")
    return text


def leak(text: str) -> float:
    """A leak of a difference, between 0 and 1."""
    return number(text, "leak: a number between 0 and 1", lambda value: 0 < value < 1)


def positive(text: str) -> float:
    """A finite number > 0."""
    return number(text, "number > 0", lambda value: value > 0)


def seconds(text: str) -> float:
    """A time that can be waited for, 0 or more."""
    return number(text, "number of seconds >= 0", lambda value: 0 <= value < 1e9)


def band(text: str) -> tuple[float, float]:
    """``"20:1000"`` as a band in Hz."""
    low, _, high = text.partition(":")
    try:
        ends = float(low), float(high)
    except ValueError:
        ends = math.nan, math.nan
    if not (math.isfinite(ends[0]) and math.isfinite(ends[1]) and 0 <= ends[0] < ends[1]):
        raise ArgumentTypeError(f"{text!r} is no band LOW:HIGH in Hz")
    return ends


def stds(text: str) -> list[float]:
    """``"0.1,0.2"`` as positive numbers, at least one."""
    return [positive(part) for part in names(text)] or [positive(text)]


def hit(text: str) -> tuple[float, float]:
    """``"0.001:100"`` as duration (s) and peak of a hit."""
    duration, _, peak = text.partition(":")
    try:
        return positive(duration), positive(peak)
    except ArgumentTypeError:
        raise ArgumentTypeError(
            f"{text!r} is no hit S:PEAK: seconds and the unit of the load, for example 0.001:100"
        ) from None


def count(text: str) -> int:
    """A whole number > 0."""
    if not (text.strip().isascii() and text.strip().isdecimal() and int(text) > 0):
        raise ArgumentTypeError(f"{text!r} is no whole number > 0")
    return int(text)


def seed(text: str) -> int:
    """A whole number, not negative."""
    if not (text.strip().isascii() and text.strip().isdecimal()):
        raise ArgumentTypeError(f"{text!r} is no seed: a whole number >= 0")
    return int(text)


def add_log_options(parser: ArgumentParser, *, several: bool = False) -> None:
    """Options that say how a log is read."""
    group = parser.add_argument_group("reading logs")
    group.add_argument("--fs", type=frequency, metavar="HZ",
                       help="sampling frequency, where the file does not tell it; of uneven time stamps, or several "
                       "records, the rate to resample to")  # fmt: skip
    group.add_argument("--columns", type=channels, metavar="CH,...",
                       help="channels to read, or the names of all where the file has none")  # fmt: skip
    group.add_argument("--axis", type=int, choices=(0, 1), help="axis of a bare array that is time")
    more = "; may repeat, default all" if several else "; may repeat, with --fs: all onto one clock"
    group.add_argument("--record", action="append", metavar="NAME",
                       help=f"record of a file that holds several{more}")  # fmt: skip
    group.add_argument(
        "--unit",
        action="append",
        default=[],
        type=unit,
        metavar="CH=UNIT",
        help="unit of a channel; overrides the file; may repeat. CH is a name, or an index that counts the channels "
        "from 0 without the time column, as loadid info lists them",
    )


def add_details(parser: ArgumentParser) -> None:
    """The option that asks for all that is known of an answer."""
    parser.add_argument("--details", action="store_true", help="also print how the load was found, and every remark")


def units(options: list[str]) -> dict[str, str]:
    """``["F=N"]`` as a dictionary.

    Raises
    ------
    InputError
        If a part is not CH=UNIT, or a channel comes twice.
    """
    pairs: dict[str, str] = {}
    for option in options:
        channel, sign, unit = option.rpartition("=")
        if not (sign and channel.strip() and unit.strip()):
            raise InputError("not CH=UNIT", where="--unit", found=repr(option), expected="for example --unit force=N")
        if channel.strip() in pairs:
            raise InputError("a channel is given twice", where="--unit",
                             found=f"{channel.strip()}={pairs[channel.strip()]} and {option}",
                             expected="one unit for each channel", hint="leave one of them out")  # fmt: skip
        pairs[channel.strip()] = unit.strip()
    return pairs


def settings(args: Namespace) -> dict[str, Any]:
    """Keyword arguments of `loadid._readers.read` from the options; those not given are left out."""
    given = {"fs": args.fs, "columns": args.columns, "axis": args.axis, "units": units(args.unit) or None}
    return {k: v for k, v in given.items() if v is not None}


def one_record(args: Namespace) -> str | list[str] | None:
    """The record that a command of one log is to read; several are put onto one clock."""
    return args.record[0] if args.record and len(args.record) == 1 else args.record


def read_records(path: str | Path, chosen: list[str] | None, settings: dict[str, Any]) -> list[Record]:
    """Some or all records of a file.

    Raises
    ------
    InputError
        From the reader, or if a name is not in the file.
    """
    from .._readers import read, read_all

    if chosen:
        return [read(path, record=name, **settings) for name in chosen]
    return list(read_all(path, **settings))


def load_model(path: str | Path) -> MeasuredModel | FrfModel | ForwardModel | ModalModel | StateSpace:
    """Model of a file: one that was saved here, or FRFs of a universal file or a text that states what they are.

    Raises
    ------
    InputError
        If the file is missing, damaged, or no model.
    """
    from structures.files._modelfile import load_model

    return load_model(path)


def resolved(record: Record, channels: Sequence[str | int], *, where: str) -> list[str]:
    """Labels of some channels of a record, each named once.

    Raises
    ------
    InputError
        A channel that is not there, or one that is given twice (by name and by index, say).
    """
    labels = [record.labels[record.index(c)] for c in channels]
    twice = next((label for k, label in enumerate(labels) if label in labels[:k]), None)
    if twice is not None:
        raise InputError(
            f"channel {twice!r} is given twice",
            where=where,
            found=", ".join(str(c) for c in channels),
            expected="each channel once",
            hint="name every channel once; an index counts the channels from 0, without the time column",
        )
    return labels


# -- what is written ---------------------------------------------------------------------------------------------------
class Bar:
    """Callable ``bar(fraction, text)`` that redraws one line; silent where the stream is no terminal, or `hushed`.

    It is what the command line passes as ``progress=``: any callable with these two arguments will do.

    Parameters
    ----------
    stream : text stream, optional
        Default standard error.
    interval : float
        Seconds between two drawings.
    """

    hushed: ClassVar[bool] = False  # --quiet

    def __init__(self, stream: TextIO | None = None, *, interval: float = 0.1) -> None:
        self.stream = sys.stderr if stream is None else stream
        self.interval = interval
        self.shown = not self.hushed and bool(getattr(self.stream, "isatty", lambda: False)())
        self._last = 0.0
        self._width = 0
        self._text = ""

    def __call__(self, fraction: float, text: str) -> None:
        """Show that `fraction` (0 to 1) of the work is done, and what is done now; log what is new."""
        if text != self._text:
            log.debug("%.0f %%: %s", 100 * fraction, text)
            self._text = text
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


def require_outputs(
    outputs: Mapping[str, str | Path | None],
    inputs: Sequence[str | Path | None] = (),
    *,
    suffixes: Mapping[str, Sequence[str]] | None = None,
    streams: Sequence[str] = (),
) -> None:
    """Nothing, if every output can be written, is named as what it is, and would replace no input or other output.

    Parameters
    ----------
    outputs : dict of option to path
        ``{"-o": "result.h5"}``; None stands for an option that was not given.
    inputs : sequence of path
        Files that the command reads.
    suffixes : dict of option to suffixes, optional
        Of options that write something else than `WRITTEN` says.
    streams : sequence of str
        Options that write on and on, into a device or a pipe too.

    Raises
    ------
    InputError
        An empty path, a folder that is not there or cannot be written, a link or a device, no suffix, or not that of
        what is written, an unknown kind of picture, a file named twice.
    """
    named = {option: path for option, path in outputs.items() if path is not None and _named(option, path)}
    given = {option: storage.as_path(path) for option, path in named.items()}
    known = {**WRITTEN, **(suffixes or {})}
    for option, path in given.items():
        _require_place(option, path, stream=option in streams)
        if option in PICTURES:
            from .._plots import picture_format

            picture_format(path)
    read = [storage.as_path(path) for path in inputs if path is not None and os.fspath(path)]
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
        if option == "--report":
            from .._page import require_page

            require_page(path, f"{option} {path}")
        if option in known:
            storage.require_suffix(path, known[option], where=f"{option} {path}", bare=False)


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


def _require_place(option: str, path: Path, *, stream: bool) -> None:
    folder = path.resolve().parent if stream else path.parent.resolve()
    where = f"{option} {path}"
    if not folder.is_dir():
        raise InputError(
            "the folder does not exist" if not folder.exists() else "a file stands where the folder should be",
            where=where,
            found=str(folder),
            hint="make the folder first, or write elsewhere",
        )
    if path.is_dir() or not stream:
        storage.require_target(path, where=where)
    try:
        with tempfile.TemporaryFile(dir=folder):  # permission bits do not tell everything: ask the file system
            pass
    except OSError as error:
        raise InputError("the folder cannot be written", where=where, found=error.strerror or error,
                         hint="choose a folder that may be written") from error  # fmt: skip
