"""Whether a signature still holds: what it stands on is hashed and compared again whenever somebody asks."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from structures.errors import InputError

from .._commands._job import FILES, OUTPUTS, written
from .ledger import Ledger, Signature, hashed
from .recipe import FREEZE, INVERSE, VERIFY, step

BEFORE = "before it is stale"  # ends a reason that is that of an earlier step
BESIDE = {"log": ("depth",)}  # files that go with one of a job, where it names them


def relative(path: str | os.PathLike[str], folder: Path) -> str:
    """A path as signatures name it: from the folder of the job on."""
    return Path(os.path.relpath(Path(path).resolve(), folder.resolve())).as_posix()


def settings_of(number: int, job: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """What of a job a step stands on: the names of its files, and its settings where it needs them."""
    stands = step(number).stands_on
    files = [one for name in FILES for one in (name, *BESIDE.get(name, ()))]
    found = {one: relative(job[one], folder) for one in _stood_on(stands) if one in job}
    if "settings" in stands:
        found |= {name: _plain(value) for name, value in job.items() if name not in (*files, *OUTPUTS, "truth")}
    return found


def _stood_on(stands: Sequence[str]) -> list[str]:
    """Names of files of a job on which a step stands."""
    return [one for name in FILES if name in stands for one in (name, *BESIDE.get(name, ()))]


def files_of(number: int, job: Mapping[str, Any], folder: Path) -> dict[str, str]:
    """Hash of each file of a job that a step stands on.

    Raises
    ------
    InputError
        The job names none, or it is not there: nothing can be signed.
    """
    found = {}
    for name in _stood_on(step(number).stands_on):
        if name not in job and name not in FILES:
            continue
        if name not in job:
            raise InputError(
                f"the job names no {name}",
                where=f"step {step(number).title}",
                expected=f'{name} = "FILE" in the job',
                hint="add the line; nothing was signed",
            )
        found[relative(job[name], folder)] = hashed(job[name])
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def stale(ledger: Ledger, job: Mapping[str, Any], folder: Path) -> dict[int, list[str]]:
    """Why each signed step no longer holds, by step; a step that holds is not named."""
    latest, hashes = ledger.latest(), _Hashes(folder)
    found: dict[int, list[str]] = {}
    for number, one in latest.items():
        reasons = [*_files(one, hashes), *_settings(one, settings_of(number, job, folder)), *_resigned(one, latest)]
        reasons += [f"step {step(earlier).title} {BEFORE}" for earlier in list(found)[:1]]
        if reasons:
            found[number] = reasons
    return found


class _Hashes:
    """Hashes of files as they are now, each read once."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.known = folder, dict[str, str]()

    def of(self, name: str) -> str:
        """Hash of a file; "" where it cannot be read."""
        if name not in self.known:
            try:
                self.known[name] = hashed(self.folder / name)
            except InputError:
                self.known[name] = ""
        return self.known[name]


def _files(one: Signature, now: _Hashes) -> list[str]:
    kinds = [("", one.files), ("evidence ", one.evidence)]
    return [
        f"{kind}{name} has changed since it was signed" if now.of(name) else f"{kind}{name} is not there any more"
        for kind, files in kinds
        for name, digest in files.items()
        if now.of(name) != digest
    ]


def _settings(one: Signature, now: Mapping[str, Any]) -> list[str]:
    names = [*one.settings, *(name for name in now if name not in one.settings)]
    return [
        f"{name} of the job has changed: {_said(one.settings, name)} when it was signed, {_said(now, name)} now"
        for name in names
        if _said(one.settings, name) != _said(now, name)
    ]


def _said(table: Mapping[str, Any], name: str) -> str:
    return written(table[name]) if name in table else "not given"


def _resigned(one: Signature, latest: Mapping[int, Signature]) -> list[str]:
    return [
        f"step {step(int(number)).title} was signed again on {latest[int(number)].date[:10]}"
        for number, checksum in one.after.items()
        if int(number) in latest and latest[int(number)].checksum != checksum
    ]


# -- what may be signed ------------------------------------------------------------------------------------------------
def lock(number: int, latest: Mapping[int, Signature], stale_steps: Mapping[int, list[str]]) -> tuple[int, str] | None:
    """The step that must be signed first, and why; None where a step can be signed."""
    needed = [VERIFY] if number > VERIFY else []
    needed += [FREEZE] if number >= INVERSE else []
    for other in needed:
        if other not in latest:
            return other, f"locked until step {step(other).title} is signed"
    first = next((other for other in sorted(stale_steps) if other < number), None)
    if first is not None:
        return first, f"locked until step {step(first).title} is signed again: {stale_steps[first][0]}"
    failed = next((other for other in needed if not latest[other].holds), None)
    return None if failed is None else (failed, f"locked: step {step(failed).title} does not hold")
