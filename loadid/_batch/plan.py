"""A plan: which assets, which of their records, and what is asked of them, read from a TOML file and checked."""

from __future__ import annotations

import argparse
import datetime as dt
import glob
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

from structures.errors import InputError

from .. import _toml
from .._commands import identify, one_record, settings
from .._toml import is_number

NAMES = {
    "plan": ("output", "job", "reading", "fatigue", "run", "every", "asset"),
    "job": tuple(name for name in identify.JOB if name not in ("signal", "over", "level", "band", "segment")),
    "reading": ("fs", "columns", "axis", "record", "unit"),
    "fatigue": ("exponents", "rate"),
    "run": ("workers", "memory", "retries", "piece", "history"),
    "asset": ("name", "model", "records", "response", "start", "from", "to", "limits", "reading"),
}
FAMILIES = ("deconvolution", "sparse")  # whose answers are histories
LEAST = 1e8  # bytes that a worker needs to load and compile
UNITS = {"kb": 1e3, "mb": 1e6, "gb": 1e9, "kib": 2**10, "mib": 2**20, "gib": 2**30, "b": 1.0}


@dataclass(frozen=True)
class Fatigue:
    """What is counted of the cycles of a load.

    Parameters
    ----------
    exponents : tuple of float
        Of Woehler lines, for damage-equivalent loads.
    rate : float
        Equivalent cycles in a second.
    """

    exponents: tuple[float, ...]
    rate: float = 1.0


@dataclass(frozen=True)
class RunSettings:
    """How chunks are worked on.

    Parameters
    ----------
    workers : int
        Processes on this machine.
    memory : float, optional
        Bytes that a worker may take beside what it takes at its start.
    retries : int
        How often a chunk is given to another worker after its own was lost.
    piece : int
        Samples of a piece of a long record.
    history : bool
        Keep the load histories, as NPZ files beside the tables.
    """

    workers: int
    memory: float | None = None
    retries: int = 3
    piece: int = 200_000
    history: bool = False


@dataclass(frozen=True)
class Asset:
    """One structure: its model, its records and what its loads may not exceed.

    Parameters
    ----------
    name : str
    model : Path
    records : tuple of str
        Paths, each a file, or a folder of files that make one record (`loadid.read_folder`).
    response : tuple of str, optional
        Channels in the order of the sensors of the model.
    start : str
        How the name of a file tells when its record begins, as `datetime.strptime` takes it; "" where it does not.
    limits : mapping of str to (float, float)
        Label of a load -> lowest and highest value that is no alarm.
    reading : mapping
        Keyword arguments of `loadid._readers.read`, and ``record``.
    """

    name: str
    model: Path
    records: tuple[str, ...]
    response: tuple[str, ...] | None = None
    start: str = ""
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    reading: Mapping[str, Any] = field(default_factory=dict)
    first: dt.datetime | None = None
    last: dt.datetime | None = None

    def begins(self, path: str) -> float | None:
        """When a record begins, in s since 1970 (UTC); None where its name does not tell.

        Raises
        ------
        InputError
            A name that is not written as stated.
        """
        if not self.start:
            return None
        name = os.path.basename(path)
        try:
            return dt.datetime.strptime(name, self.start).replace(tzinfo=dt.UTC).timestamp()
        except ValueError:
            raise InputError("the name does not tell when the record begins", where=path, found=name,
                             expected=self.start,
                             hint="mend start in the plan, or rename the file") from None  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """What a plan file asks for.

    Parameters
    ----------
    path, output : Path
        The file, and the folder of what is written.
    job : mapping
        Keyword arguments of `loadid._commands.identify.identify`.
    assets : tuple of Asset
    fatigue : Fatigue, optional
    run : RunSettings
    """

    path: Path
    output: Path
    job: Mapping[str, Any]
    assets: tuple[Asset, ...]
    fatigue: Fatigue | None
    run: RunSettings


def read(path: str | os.PathLike[str], **changes: Any) -> Plan:
    """The plan of a file.

    Parameters
    ----------
    path : path
        TOML; paths in it count from its folder.
    **changes
        Fields of `RunSettings` that the command line states.

    Raises
    ------
    InputError
        No such file, no TOML, a key that is none (with the nearest), a value that is none, a model or a pattern of
        records without a file, two assets of one name.
    """
    file, tree = Path(path), _toml.read(path)
    said = BatchPlanReader(str(path), NAMES)
    said.known(tree, "plan", str(path))
    output = said.text(tree, "output", str(path))
    common = said.table(tree, "reading")
    said.reading(common, "[reading]")
    assets = tuple(said.asset(one, common, file.parent) for one in said.assets(tree, "name, model and records"))
    return Plan(
        file, file.parent / output, said.job(said.table(tree, "job")), assets, said.fatigue(tree),
        said.running(said.table(tree, "run"), changes),
    )  # fmt: skip


class BatchPlanReader(_toml.PlanReader):
    """The values of a plan, checked one by one."""

    def asset(self, tree: dict[str, Any], common: dict[str, Any], folder: Path) -> Asset:
        """One asset."""
        name = tree["name"]
        place = f"[[asset]] {name}"
        model = self.file(tree, "model", place, folder)
        begin, first, last = tree.get("start", ""), moment(tree.get("from")), moment(tree.get("to"))
        if not isinstance(begin, str):
            self.refused(f"{place}, start", begin, "a text such as 'log_%Y%m%d_%H%M.csv'")
        for key, found in (("from", first), ("to", last)):
            if found is None and key in tree:
                self.refused(f"{place}, {key}", tree[key], "a date or a time")
            if found is not None and not begin:
                raise InputError("a range of dates needs to know when records begin", where=f"{self.where}, {place}",
                                 found=f"{key} without start", expected="start, as '%Y%m%d_%H%M.csv'")  # fmt: skip
        reading = self.reading({**common, **self.table(tree, "reading")}, place)
        return Asset(
            name, model, tuple(self.files(tree, folder, place)), self.response(tree, place), begin,
            self.limits(tree, place), reading, first, last,
        )  # fmt: skip

    def files(self, tree: Mapping[str, Any], folder: Path, place: str) -> list[str]:
        """Files of all patterns, each once, by name."""
        patterns = tree.get("records")
        patterns = [patterns] if isinstance(patterns, str) else patterns
        if not isinstance(patterns, list) or not patterns or not all(isinstance(p, str) and p for p in patterns):
            self.refused(f"{place}, records", patterns, "paths or patterns, as 'bridge/*.csv'")
        found: set[str] = set()
        for pattern in patterns:
            there = list(_files(os.path.join(folder, pattern)))
            if not there:
                raise InputError("no record is there", where=f"{self.where}, {place}", found=str(folder / pattern),
                                 expected="a file, or a pattern that some files have",
                                 hint="check the path, which counts from the plan")  # fmt: skip
            found.update(there)
        return sorted(found)

    def response(self, tree: Mapping[str, Any], place: str) -> tuple[str, ...] | None:
        """Channels in the order of the sensors."""
        found = tree.get("response")
        if found is None:
            return None
        if not isinstance(found, list) or not found or not all(isinstance(one, str | int) for one in found):
            self.refused(f"{place}, response", found, "a list of channels")
        return tuple(str(one) for one in found)

    def limits(self, tree: Mapping[str, Any], place: str) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of each load: a number L is -L to L."""
        ends: dict[str, tuple[float, float]] = {}
        for label, value in self.table(tree, "limits").items():
            pair = [-value, value] if is_number(value) and value > 0 else value
            if not (isinstance(pair, list) and len(pair) == 2 and all(map(is_number, pair)) and pair[0] < pair[1]):
                self.refused(f"{place}, limits, {label}", value, "a number > 0, or [lowest, highest], SI")
            ends[label] = float(pair[0]), float(pair[1])
        return ends

    def job(self, tree: dict[str, Any]) -> dict[str, Any]:
        """What is asked, in the words of ``loadid identify``."""
        self.known(tree, "job", "[job]")
        found = identify.job(self.options(tree, "[job]"))
        if found["family"] not in FAMILIES:
            self.refused("[job], family", found["family"], " or ".join(FAMILIES))
        return {name: value for name, value in found.items() if value is not None}

    def reading(self, tree: dict[str, Any], place: str) -> dict[str, Any]:
        """How files are read, in the words of the same command."""
        self.known(tree, "reading", f"{place}, reading")
        units = tree.get("unit")
        if isinstance(units, dict):
            tree = {**tree, "unit": [f"{channel}={unit}" for channel, unit in units.items()]}
        args = self.options(tree, f"{place}, reading")
        return {**settings(args), **({"record": one_record(args)} if args.record else {})}

    def options(self, tree: dict[str, Any], place: str) -> argparse.Namespace:
        """A table as the options of ``loadid identify`` of the same names."""
        words = ["log", "--model=model", "--output=result"]
        for name, value in tree.items():
            option = f"--{name.replace('_', '-')}"
            several = name == "unit"
            if isinstance(value, bool):
                words += [option] * value
            elif isinstance(value, list) and not several:
                words.append(f"{option}={','.join(map(str, value))}")
            else:
                words += [f"{option}={one}" for one in (value if isinstance(value, list) else [value])]
        parser = _JobParser(f"{self.where}, {place}")
        identify.command.configure(parser)
        return parser.parse_args(words)

    def fatigue(self, tree: Mapping[str, Any]) -> Fatigue | None:
        """What is counted; None where nothing is asked."""
        if "fatigue" not in tree:
            return None
        given = self.table(tree, "fatigue")
        self.known(given, "fatigue", "[fatigue]")
        exponents, rate = given.get("exponents", [3.0]), given.get("rate", 1.0)
        if (
            not isinstance(exponents, list)
            or not exponents
            or not all(is_number(m) and 1 <= m <= 50 for m in exponents)
        ):
            self.refused("[fatigue], exponents", exponents, "numbers from 1 to 50")
        if not is_number(rate) or rate <= 0:
            self.refused("[fatigue], rate", rate, "cycles in a second, > 0")
        return Fatigue(tuple(sorted({float(m) for m in exponents})), float(rate))

    def running(self, given: dict[str, Any], changes: dict[str, Any]) -> RunSettings:
        """How it is worked on."""
        self.known(given, "run", "[run]")
        given = {**given, **{name: value for name, value in changes.items() if value is not None}}
        for name, least in (("workers", 1), ("retries", 0), ("piece", 1000)):
            if name in given and not (type(given[name]) is int and given[name] >= least):
                self.refused(f"[run], {name}", given[name], f"a whole number, at least {least}")
        if not isinstance(given.get("history", False), bool):
            self.refused("[run], history", given["history"], "true or false")
        given = {"workers": os.cpu_count() or 1, **given}
        return RunSettings(**{**given, "memory": self.memory(given.get("memory"))})

    def memory(self, given: Any) -> float | None:
        """Bytes of ``"2 GB"``."""
        if given is None:
            return None
        number, unit = (str(given).rstrip("BbKkMmGgIi "), str(given).lstrip("0123456789.eE+ ").lower())
        try:
            size = float(number) * UNITS[unit.strip() or "b"]
        except (ValueError, KeyError):
            size = 0.0
        if not LEAST <= size < 1e15:
            self.refused("[run], memory", given, "a size such as '2 GB', at least 100 MB")
        return size


class _JobParser(argparse.ArgumentParser):
    """Options of another command, refused as values of the plan."""

    def __init__(self, place: str) -> None:
        super().__init__(add_help=False, allow_abbrev=False)
        self.place = place

    def error(self, message: str) -> NoReturn:
        raise InputError("no such value", where=self.place, found=message.removeprefix("argument --"),
                         expected="what loadid identify takes (loadid identify --help)")  # fmt: skip


def moment(value: Any) -> dt.datetime | None:
    """A date or a time of a plan, UTC where it says nothing else."""
    if isinstance(value, dt.datetime):
        return value if value.tzinfo else value.replace(tzinfo=dt.UTC)
    return dt.datetime(value.year, value.month, value.day, tzinfo=dt.UTC) if isinstance(value, dt.date) else None


def _files(pattern: str) -> Iterator[str]:
    """Files of a pattern; folders where it names one, or ends in a slash."""
    folders = pattern.endswith("/") or not glob.has_magic(pattern)
    there = glob.iglob(pattern, recursive=True) if glob.has_magic(pattern) else [pattern]
    for path in there:
        if os.path.isfile(path) or (folders and os.path.isdir(path)):
            yield path.rstrip("/")
