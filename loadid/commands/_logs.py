"""What all commands that read logs have in common."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError

from . import _arguments as arguments

if TYPE_CHECKING:
    from loadid.record import Record
    from structures.forward import ForwardModel
    from structures.measured import MeasuredModel
    from structures.statespace import StateSpace
    from structures.tabulated import FrfModel


def add_log_options(parser: ArgumentParser, *, several: bool = False) -> None:
    """Options that say how a log is read."""
    group = parser.add_argument_group("reading logs")
    group.add_argument(
        "--fs", type=arguments.frequency, metavar="HZ", help="sampling frequency, where the file does not tell it"
    )
    group.add_argument(
        "--columns",
        type=arguments.channels,
        metavar="CH,...",
        help="channels to read, or the names of all where the file has none",
    )
    group.add_argument("--axis", type=int, choices=(0, 1), help="axis of a bare array that is time")
    more = "; may repeat, default all" if several else ""
    group.add_argument("--record", action="append", metavar="NAME", help=f"record of a file that holds several{more}")
    group.add_argument(
        "--unit",
        action="append",
        default=[],
        type=arguments.unit,
        metavar="CH=UNIT",
        help="unit of a channel; overrides the file; may repeat. CH is a name, or an index that counts the channels "
        "from 0 without the time column, as loadid info lists them",
    )


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
            raise InputError(
                "a channel is given twice",
                where="--unit",
                found=f"{channel.strip()}={pairs[channel.strip()]} and {option}",
                expected="one unit for each channel",
                hint="leave one of them out",
            )
        pairs[channel.strip()] = unit.strip()
    return pairs


def settings(args: Namespace) -> dict[str, Any]:
    """Keyword arguments of `loadid.readers.read` from the options; those not given are left out."""
    given = {"fs": args.fs, "columns": args.columns, "axis": args.axis, "units": units(args.unit) or None}
    return {k: v for k, v in given.items() if v is not None}


def one_record(args: Namespace) -> str | None:
    """The record that a command of one log is to read.

    Raises
    ------
    InputError
        If several are named.
    """
    if args.record and len(args.record) > 1:
        raise InputError("one record is needed", where="--record", found=args.record)
    return args.record[0] if args.record else None


def read_records(path: str | Path, chosen: list[str] | None, settings: dict[str, Any]) -> list[Record]:
    """Some or all records of a file.

    Raises
    ------
    InputError
        From the reader, or if a name is not in the file.
    """
    from loadid.readers import read, read_all

    if chosen:
        return [read(path, record=name, **settings) for name in chosen]
    return list(read_all(path, **settings))


def load_model(path: str | Path) -> MeasuredModel | FrfModel | ForwardModel | StateSpace:
    """Model of a file: one that was saved here, or the FRFs of a universal file that states what they are.

    Raises
    ------
    InputError
        If the file is missing, damaged, or no model.
    """
    from structures import modelfile
    from structures.files.uff import SUFFIXES
    from structures.measured import MeasuredModel
    from structures.storage import kind_of
    from structures.tabulated import FILE, FrfModel

    if Path(path).suffix.lower() in SUFFIXES:
        from structures.files import read_frfs

        return read_frfs(path)
    kind = kind_of(path) if Path(path).is_file() else None
    if kind in modelfile.KINDS:
        return modelfile.load(path)
    return FrfModel.load(path) if kind == FILE else MeasuredModel.load(path)


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
