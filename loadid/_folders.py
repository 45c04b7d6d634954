"""A folder of files that follow one another, as loggers write them by the hour, as one record that is read in parts."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from structures import units as _units
from structures._advice import Advice, either
from structures._readonly import ReadOnly
from structures.errors import InputError

from . import _stamps
from ._names import find
from ._readers.source import BUDGET, RecordOutline, known_suffixes

if TYPE_CHECKING:
    from ._record import Record

FILES = 100_000
GAPS = 0.5  # share of samples in gaps beyond which a folder is no one record
SAME = 1e-6  # relative difference of steps that is none
PIECE = 200_000  # samples
BESIDE = {"readme", "license", "licence", "notes", "changelog"}  # stems of what lies beside records
IN_PARTS = "take it in parts: loadid.read_folder(path).window(start, stop) or .pieces(samples)"


@dataclass(frozen=True)
class FolderPart:
    """One file of a folder: its first sample within the record, how many it has, and when it begins (s since 1970)."""

    path: Path
    first: int
    samples: int
    start: float | None

    @property
    def end(self) -> int:
        """The sample after its last one."""
        return self.first + self.samples


@dataclass(frozen=True, eq=False, repr=False)
class Folder(ReadOnly):
    """Files that make one record; samples are read when they are asked for.

    Parameters
    ----------
    path : Path
    parts : tuple of FolderPart
        In the order of time.
    outline : RecordOutline
        Of the record that they make: channels, units as the files state them, step, samples with gaps, notes.
    start : float or None
        When the first sample was taken, in s since 1970 (UTC).
    reading : mapping
        What was stated of every file, as `loadid.read` takes it.
    reader : callable
        Path and `reading` -> Record.
    """

    path: Path
    parts: tuple[FolderPart, ...]
    outline: RecordOutline
    start: float | None
    reading: Mapping[str, Any]
    reader: Callable[..., Record]

    def __repr__(self) -> str:
        begun = "" if self.start is None else f" from {_stamps.iso(self.start)}"
        return f"Folder({len(self.parts)} files, {len(self)} samples{begun}, {', '.join(self.outline.labels[:8])})"

    def __len__(self) -> int:
        return self.outline.samples

    @property
    def duration(self) -> float:
        """Number of samples, those in gaps among them, times the step, in s.

        Raises
        ------
        InputError
            The files state no step.
        """
        return len(self) * self._dt

    @property
    def _dt(self) -> float:
        if self.outline.dt is None:
            return self.reader(self.parts[0].path, **self.reading).dt  # refuses in the words of the file
        return self.outline.dt

    def window(self, start: float = 0.0, stop: float | None = None) -> Record:
        """Samples with start <= time < stop (s after the first one) as a record, NaN in gaps between files.

        Raises
        ------
        InputError
            No sample there, more samples than memory is spent on, files that contradict each other where they overlap.
        """
        dt = self._dt
        ends = [float(x) / dt for x in (start, self.duration if stop is None else stop)]
        if not all(np.isfinite(ends)):
            raise InputError("the window is not a number", where="window", found=(start, stop), expected="seconds")
        first, last = (int(min(max(np.ceil(x - 1e-6), 0), len(self))) for x in ends)
        found = self._assembled(first, last) if first < last else None
        if found is None:
            raise InputError("the window holds no sample", where=str(self.path), found=f"{start} to {stop} s",
                             expected=f"a part of 0 to {self.duration:g} s outside the gaps between files")  # fmt: skip
        return found

    def pieces(self, samples: int = PIECE) -> Iterator[Record]:
        """The record in pieces of so many samples, one after the other; what lies wholly in a gap is passed over.

        A rest that is shorter than half a piece goes with the last one.

        Raises
        ------
        InputError
            As for `window`; a number of samples below 1.
        """
        if not isinstance(samples, int | np.integer) or isinstance(samples, bool) or samples < 1:
            raise InputError("no number of samples", where="pieces", found=repr(samples)[:80], expected="at least 1")
        kept: dict[Path, Record] = {}
        for first, last in spans(len(self), int(samples)):
            if (found := self._assembled(first, last, kept)) is not None:
                yield found

    def record(self) -> Record:
        """All of it.

        Raises
        ------
        InputError
            As for `window`; more gaps than samples.
        """
        gone = sum(_gaps(self.parts).values())
        if gone > GAPS * len(self):
            raise InputError("the gaps between the files are longer than the record", where=str(self.path),
                             found=f"{gone} of {len(self)} samples", expected=f"at most {GAPS:.0%}",
                             hint=IN_PARTS)  # fmt: skip
        return self.window()

    def _assembled(self, first: int, last: int, kept: dict[Path, Record] | None = None) -> Record | None:
        """Samples from `first` to `last`; None where no file holds one. `kept` are files that were read just before."""
        parts = [p for p in self.parts if p.first < last and p.end > first]
        if not parts:
            return None
        size = 8 * (last - first) * max(len(self.outline.labels), 1)
        if size > BUDGET:
            raise InputError("the record is longer than memory is spent on", where=str(self.path),
                             found=f"{last - first} samples, {size} bytes", expected=f"at most {BUDGET} bytes",
                             hint=IN_PARTS)  # fmt: skip
        kept = {} if kept is None else kept
        for path in [path for path in kept if path not in {p.path for p in parts}]:
            del kept[path]
        model: Record | None = None
        values = np.zeros((0, 0))
        for part in parts:
            found = kept[part.path] = kept.get(part.path) or self.reader(part.path, **self.reading)
            if len(found) != part.samples:
                raise InputError("the file has changed since the folder was looked at", where=str(part.path),
                                 found=f"{len(found)} samples", expected=part.samples)  # fmt: skip
            if model is None:
                model, values = found, np.full((last - first, len(found.channels)), np.nan)
            elif found.channels != model.channels:
                _refuse_other(part.path, model.source, _said(found.labels, [c.unit for c in found.channels]),
                              _said(model.labels, [c.unit for c in model.channels]))  # fmt: skip
            low, high = max(part.first, first), min(part.end, last)
            _fill(values[low - first : high - first], found.values[low - part.first : high - part.first],
                  part.path, low * self._dt)  # fmt: skip
        assert model is not None
        flags = {repr(f): f for p in parts for f in kept[p.path].flags}
        return replace(
            model, values=values, name=self.outline.name, source=str(self.path), dt=self._dt,
            flags=tuple(flags.values()),
            start=None if self.start is None else self.start + first * self._dt,
            notes=tuple(dict.fromkeys([*self.outline.notes, *(n for p in parts for n in kept[p.path].notes)])),
        )  # fmt: skip


def folder_of(
    path: str | os.PathLike[str],
    record: str | int | None,
    reading: Mapping[str, Any],
    read: Callable[..., Record],
    outline: Callable[..., tuple[RecordOutline, ...]],
) -> Folder:
    """A folder whose files `read` and `outline` read; see `loadid.read_folder`."""
    place = Path(path).expanduser()
    files, passed = listed(place)
    stated = {**reading, "record": record}
    found = [(file, _outlined(file, record, outline(file, **reading))) for file in files]
    for file, one in found[1:]:
        _refuse_unlike(file, one, files[0], found[0][1])
    starts = [one.start for _, one in found]
    dated = [s for s in starts if s is not None]
    if dated and len(dated) < len(found):
        lacking = [file.name for file, one in found if one.start is None]
        raise InputError("only some files state when they begin", where=str(place),
                         found=f"not stated by {', '.join(lacking[:12])}", expected="a start in all, or in none",
                         hint="move these files away")  # fmt: skip
    notes = [f"{len(found)} files, {found[0][0].name} to {found[-1][0].name}"]
    if dated:
        found.sort(key=lambda pair: pair[1].start or 0.0)
        for (a, one), (b, two) in pairwise(found):
            if one.start == two.start:
                raise InputError("two files begin at the same time", where=str(place), found=f"{a.name} and {b.name}",
                                 expected="every sample once", hint="move one of them away")  # fmt: skip
        notes = [f"{len(found)} files in the order of time, {found[0][0].name} to {found[-1][0].name}"]
    elif len(found) > 1:
        notes.append("the files do not state when they begin: they follow one another in the order of their names, "
                     "without gaps")  # fmt: skip
    parts, more = _placed(found)
    notes += more + (
        [f"passed over: {', '.join(passed[:20])}" + (", ..." if len(passed) > 20 else "")] if passed else []
    )
    first = found[0][1]
    whole = replace(
        first, name=place.resolve().name, samples=max(p.end for p in parts),
        notes=tuple(dict.fromkeys([*notes, *first.notes])),
    )  # fmt: skip
    return Folder(place, parts, whole, parts[0].start, stated, read)


def spans(samples: int, piece: int) -> list[tuple[int, int]]:
    """Ends of the pieces of a long record: a rest that is shorter than half a piece goes with the last one."""
    cuts = [*range(0, samples, piece), samples]
    if len(cuts) > 2 and cuts[-1] - cuts[-2] < piece // 2:
        del cuts[-2]
    return list(pairwise(cuts))


def listed(place: Path) -> tuple[list[Path], list[str]]:
    """Files of one format in the natural order of their names, and names of what is passed over.

    Raises
    ------
    InputError
        No file that is read, several formats of as many files each, a folder that cannot be read.
    """
    try:
        entries = [p for p, _ in zip(place.iterdir(), range(FILES + 1), strict=False)]
    except OSError as error:
        raise InputError("the folder cannot be read", where=str(place), found=str(error)) from None
    if len(entries) > FILES:
        raise InputError("too many files", where=str(place), found=f"more than {FILES}", expected=f"at most {FILES}")
    known = known_suffixes()
    can = [p for p in entries if not p.name.startswith((".", "~")) and p.stem.lower() not in BESIDE and p.is_file()
           and p.suffix.lower() in known]  # fmt: skip
    counts: dict[str, int] = {}
    for p in can:
        counts[p.suffix.lower()] = counts.get(p.suffix.lower(), 0) + 1
    most = max(counts.values(), default=0)
    suffixes = sorted(s for s, n in counts.items() if n == most)
    if len(suffixes) != 1:
        raise InputError(
            "no file of the folder is read" if not suffixes else "files of several formats", where=str(place),
            found=", ".join(sorted(p.name for p in entries)[:12]) or "an empty folder",
            expected=f"files of one format, {', '.join(known[:12])}, ...", hint="name a file, or sort the folder",
        )  # fmt: skip
    files = sorted((p for p in can if p.suffix.lower() == suffixes[0]), key=lambda p: _natural(p.name))
    return files, sorted(p.name for p in entries if p not in set(files))


def _natural(name: str) -> tuple[tuple[int, int | str], ...]:
    """Key by which log_9 comes before log_10."""
    cut = re.split(r"(\d+)", name)
    return tuple((0, int(part)) if part.isdecimal() else (1, part.casefold()) for part in cut if part)


def _outlined(file: Path, record: str | int | None, held: tuple[RecordOutline, ...]) -> RecordOutline:
    if record is not None:
        names = [one.name or f"record_{i + 1}" for i, one in enumerate(held)]
        return held[find(record, names, what="record", where=str(file))]
    if len(held) > 1:
        raise InputError("the file holds several records", where=str(file),
                         found=", ".join(one.name for one in held[:50]), expected="one of them, by name or index",
                         hint=Advice("choose: ", either("record=NAME", "--record NAME")))  # fmt: skip
    return held[0]


def _refuse_unlike(file: Path, one: RecordOutline, other: Path, first: RecordOutline) -> None:
    if one.labels != first.labels or [_unit(u) for u in one.units] != [_unit(u) for u in first.units]:
        _refuse_other(file, str(other), _said(one.labels, one.units), _said(first.labels, first.units))
    if one.dt != first.dt and (not one.dt or not first.dt or abs(one.dt / first.dt - 1) > SAME):
        said = ["no step" if x.dt is None else f"a step of {x.dt:.9g} s" for x in (one, first)]
        raise InputError("a file of the folder has another step", where=str(file), found=said[0],
                         expected=f"{said[1]}, as {other.name}", hint="move it away, or resample it")  # fmt: skip


def _refuse_other(file: Path, other: str, found: str, expected: str) -> None:
    raise InputError("a file of the folder has other channels or units", where=str(file), found=found[:400],
                     expected=f"{expected[:400]}, as {Path(other).name}",
                     hint="move it away, or state columns and units for all files")  # fmt: skip


def _unit(text: str | None) -> object:
    return text if text is None or not _units.known(text) else (_units.parse(text).si, _units.parse(text).factor)


def _said(labels: Sequence[str], units: Sequence[str | None]) -> str:
    return ", ".join(f"{label} [{unit}]" if unit else label for label, unit in zip(labels, units, strict=True))


def _placed(found: Sequence[tuple[Path, RecordOutline]]) -> tuple[tuple[FolderPart, ...], list[str]]:
    """Files on the grid of the first one, and what is said of gaps, overlaps and starts between its samples."""
    dt, begin = found[0][1].dt, found[0][1].start
    parts: list[FolderPart] = []
    away = 0.0
    for path, one in found:
        first = parts[-1].end if parts else 0
        if begin is not None and one.start is not None and dt is not None:
            exact = (one.start - begin) / dt
            first, away = round(exact), max(away, abs(exact - round(exact)))
        parts.append(FolderPart(path, first, one.samples, one.start))
    notes = []
    if gaps := _gaps(parts):
        gone, (longest, size) = sum(gaps.values()), max(gaps.items(), key=lambda pair: pair[1])
        many = "gap" if len(gaps) == 1 else "gaps"
        notes.append(f"{len(gaps)} {many} between files, {gone} samples set to NaN, the longest of {size} samples "
                     f"({size * (dt or 0.0):.6g} s) after {longest.name}")  # fmt: skip
    ends = np.maximum.accumulate([p.end for p in parts])
    twice = [(p, int(min(e, p.end)) - p.first) for p, e in zip(parts[1:], ends[:-1], strict=True) if p.first < e]
    if twice:
        notes.append(f"{sum(n for _, n in twice)} samples lie in two files, which must agree, and are taken once: from "
                     + ", ".join(p.path.name for p, _ in twice[:8]))  # fmt: skip
    if away > 0.01:
        notes.append(f"files begin up to {away:.2f} of a step off the samples of the first one: taken at the nearest")
    return tuple(parts), notes


def _gaps(parts: Sequence[FolderPart]) -> dict[Path, int]:
    """Samples between the end of what was recorded so far and the next file, by the file before."""
    found, last = {}, parts[0]
    for part in parts[1:]:
        if part.first > last.end:
            found[last.path] = part.first - last.end
        last = max(last, part, key=lambda p: p.end)
    return found


def _fill(room: NDArray[np.float64], values: NDArray[np.float64], path: Path, at: float) -> None:
    """Samples into their room; where an earlier file has put some, they must be the same."""
    both = ~np.isnan(room) & ~np.isnan(values)
    wrong = both & (room != values)
    if wrong.any():
        row, column = (int(i) for i in np.argwhere(wrong)[0])
        raise InputError("two files contradict each other where they overlap", where=str(path),
                         found=f"{values[row, column]:.9g} in channel {column}, {row} samples after {at:.9g} s",
                         expected=f"{room[row, column]:.9g}, as the file before", hint="move one of the files away, or "
                         "mend the time that one of them states")  # fmt: skip
    np.copyto(room, values, where=~np.isnan(values))
