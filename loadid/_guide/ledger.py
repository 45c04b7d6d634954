"""The signatures of a job in one TOML file: readable, only ever added to, and refused where a single sign was changed.

Every signature carries the sha256 of its content and of the one before; the head carries the seal over all of them.
What stands in ``[about]`` is free words: it is not signed, and may be edited.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NoReturn

from structures import _toml
from structures.errors import InputError
from structures.files import _storage as storage

from .._commands._job import written
from .recipe import STEPS

FORMAT = 1
SUFFIX = ".guide.toml"
LARGEST = 5_000_000  # bytes; a thousand signatures have less
HEAD = ("format", "job", "created", "seal", "about", "signature")
ABOUT = ("structure", "client", "remarks")
LAST = "# end of the guide"  # a file that ends otherwise was cut
BARE = re.compile(r"[A-Za-z0-9_-]+")
MEND = "take the copy from your backup, or begin anew with loadid guide new"


@dataclass(frozen=True)
class Signature:
    """One step, signed.

    Parameters
    ----------
    step : int
    said : str
        Its outcome in a sentence.
    holds : bool
        Whether the outcome is as it must be: a validation that disagrees is signed, and does not hold.
    by, date, version : str
        Who signed; ISO date and time, UTC; version of the package.
    note : str
        Words of who signed.
    figures : mapping
        What the package computed: numbers, texts, lists, and tables of them.
    flags : tuple of mapping
        ``code``, ``level``, ``message``, ``advice`` and ``evidence`` of the guards.
    files, evidence : mapping of str to str
        Path from the folder of the job -> sha256: what the package read, and what was named as evidence.
    settings : mapping
        Settings of the job on which it stands, and how the evidence was read.
    after : mapping of str to str
        Step -> checksum of the signatures of earlier steps on which it stands.
    previous, checksum : str
        Checksum of the signature before, and its own.
    """

    step: int
    said: str
    holds: bool
    by: str
    date: str
    version: str
    note: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)
    flags: tuple[Mapping[str, Any], ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    evidence: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    after: Mapping[str, str] = field(default_factory=dict)
    previous: str = ""
    checksum: str = ""

    def sealed(self, previous: str) -> Signature:
        """With its checksum, behind another signature."""
        own = replace(self, previous=previous)
        return replace(own, checksum=own.computed())

    def computed(self) -> str:
        """Sha256 of all but its checksum."""
        tree = asdict(self)
        del tree["checksum"]
        return _digest(tree)


TABLES = ("figures", "files", "evidence", "settings", "after")
TYPES = {"step": int, "holds": bool} | dict.fromkeys(
    ("said", "by", "date", "version", "note", "previous", "checksum"), str
)


@dataclass(frozen=True)
class Ledger:
    """All signatures of a job, in the order in which they were made.

    Parameters
    ----------
    job : str
        Name of the job file, which lies in the same folder.
    created : str
    about : mapping of str to str
        ``structure``, ``client``, ``remarks``: words that nobody signs.
    signatures : tuple of Signature
    """

    job: str
    created: str
    about: Mapping[str, str] = field(default_factory=dict)
    signatures: tuple[Signature, ...] = ()

    @property
    def seal(self) -> str:
        """Sha256 over the head and every signature."""
        return _digest([FORMAT, self.job, self.created, [one.checksum for one in self.signatures]])

    def latest(self) -> dict[int, Signature]:
        """The last signature of every step that has one, by step."""
        found = {one.step: one for one in self.signatures}
        return {number: found[number] for number in sorted(found)}

    def with_signature(self, signature: Signature) -> Ledger:
        """The ledger with one more."""
        last = self.signatures[-1].checksum if self.signatures else ""
        return replace(self, signatures=(*self.signatures, signature.sealed(last)))


def _digest(tree: Any) -> str:
    text = json.dumps(tree, sort_keys=True, ensure_ascii=False, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


# -- written -----------------------------------------------------------------------------------------------------------
def write(path: Path, ledger: Ledger) -> None:
    """Write the file, whole or not at all.

    Raises
    ------
    InputError
        It cannot be written.
    """
    storage.replace(path, text(ledger).encode())


def text(ledger: Ledger) -> str:
    """The file as text."""
    head = {"format": FORMAT, "job": ledger.job, "created": ledger.created, "seal": ledger.seal}
    lines = ["# the ten steps of a job, signed: written by loadid guide; what stands in [about] may be edited",
             *_pairs(head), "", "[about]", *_pairs(ledger.about)]  # fmt: skip
    for one in ledger.signatures:
        lines += ["", f"# -- {STEPS[one.step - 1].title} ".ljust(100, "-"), "[[signature]]",
                  *_pairs({name: getattr(one, name) for name in TYPES})]  # fmt: skip
        lines += _flags(one)
        for name in TABLES:
            if getattr(one, name):
                lines += _table(f"signature.{name}", getattr(one, name))
    return "\n".join([*lines, "", LAST, ""])


def _pairs(table: Mapping[str, Any]) -> list[str]:
    return [f"{_key(key)} = {written(value)}" for key, value in table.items()]


def _table(name: str, content: Mapping[str, Any]) -> list[str]:
    """A table, its numbers first, then a table for each that it holds; what those hold stands on one line."""
    inner = {key: value for key, value in content.items() if isinstance(value, Mapping) and value}
    lines = ["", f"[{name}]", *_pairs({key: value for key, value in content.items() if key not in inner})]
    for key, value in inner.items():
        lines += ["", f"[{name}.{_key(key)}]", *_pairs(value)]
    return lines


def _key(name: str) -> str:
    return name if BARE.fullmatch(name) else written(name)


def _flags(one: Signature) -> list[str]:
    if not one.flags:
        return []
    return ["flags = [", *(f"    {written(dict(flag))}," for flag in one.flags), "]"]


# -- read --------------------------------------------------------------------------------------------------------------
def read(path: Path) -> Ledger:
    """Read a file that `write` wrote.

    Raises
    ------
    InputError
        No such file; no TOML; a key or a value that is none; a signature that was changed, by its step; one that is
        missing; a file that was cut.
    """
    content = _content(path)
    if not content.endswith(f"\n{LAST}\n"):
        _damaged(path, "its end is missing: the file was cut", repr(content[-30:]), repr(LAST))
    tree = _toml.load(path, "the guide of this job is damaged: it is no TOML", MEND)
    _only(path, tree, HEAD, "the head")
    if tree.get("format") != FORMAT:
        _damaged(path, "unknown format", repr(tree.get("format"))[:40], f"format = {FORMAT}",
                 "a newer release of the package may have written it: read it with that one")  # fmt: skip
    for name in ("job", "created", "seal"):
        _typed(path, tree, name, str, "the head")
    about = tree.get("about", {})
    if not isinstance(about, dict):
        _damaged(path, "[about] is no table", type(about).__name__, "a table of texts")
    _only(path, about, ABOUT, "[about]")
    for name in about:
        _typed(path, about, name, str, "[about]")
    listed = tree.get("signature", [])
    if not isinstance(listed, list) or not all(isinstance(one, dict) for one in listed):
        _damaged(path, "no list of signatures", type(listed).__name__, "[[signature]] tables")
    found: list[Signature] = []
    for k, one in enumerate(listed, 1):
        found.append(_signature(path, one, k, found[-1].checksum if found else ""))
    ledger = Ledger(tree["job"], tree["created"], about, tuple(found))
    if ledger.seal != tree["seal"]:
        _damaged(path, "the seal is not that of its signatures: one is missing, or the head was changed",
                 f"{len(found)} signatures", "the file as loadid guide wrote it")  # fmt: skip
    return ledger


def _content(path: Path) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
    except FileNotFoundError:
        raise InputError("this job has no guide yet", where=str(path), expected="a file that loadid guide new wrote",
                         hint="begin one: loadid guide new JOB.toml") from None  # fmt: skip
    except OSError as error:
        raise InputError("the guide of this job cannot be read", where=str(path), found=error.strerror or str(error),
                         hint="check the path and its permissions") from None  # fmt: skip
    if len(data) > LARGEST:
        _damaged(path, "the file is larger than any guide", f"more than {LARGEST} bytes", "a file of loadid guide")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        _damaged(path, "the file is damaged: it is no text", str(error)[:80], "TOML in UTF-8")


def _signature(path: Path, tree: dict[str, Any], k: int, previous: str) -> Signature:
    number = tree.get("step")
    whole = isinstance(number, int) and not isinstance(number, bool) and 1 <= number <= len(STEPS)
    where = f"signature {k}" + (f", of step {STEPS[int(str(number)) - 1].title}" if whole else "")
    _only(path, tree, tuple(f.name for f in fields(Signature)), where)
    for name, kind in TYPES.items():
        _typed(path, tree, name, kind, where)
    if not whole:
        _damaged(path, f"{where}: there is no such step", repr(number)[:40], "1 to 10")
    for name in TABLES:
        if not isinstance(tree.get(name, {}), dict):
            _damaged(path, f"{where}: {name} is no table", type(tree[name]).__name__, "a table")
    flags = tree.get("flags", [])
    if not isinstance(flags, list) or not all(isinstance(one, dict) for one in flags):
        _damaged(path, f"{where}: flags are no list of tables", type(flags).__name__, "a list of tables")
    found = Signature(**{**tree, "flags": tuple(flags)})
    try:
        right = found.checksum == found.computed() and found.previous == previous
    except (TypeError, ValueError):  # a date, say, which no signature holds
        right = False
    if not right:
        _damaged(path, f"{where} was changed after it was signed", f"checksum {found.checksum[:16]}",
                 "what was signed, to the last digit", "take the copy from your backup, or undo the edit; "
                 "to sign a step anew run loadid guide sign")  # fmt: skip
    return found


def _only(path: Path, tree: Mapping[str, Any], names: tuple[str, ...], where: str) -> None:
    for name in tree:
        if name not in names:
            _damaged(path, f"{where}: there is no such key", repr(name)[:60], ", ".join(names))


def _typed(path: Path, tree: Mapping[str, Any], name: str, kind: type, where: str) -> None:
    value = tree.get(name)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        words = {str: "a text", int: "a whole number", bool: "true or false"}[kind]
        _damaged(path, f"{where}: {name} is none", repr(value)[:60], words)


def _damaged(path: Path, what: str, found: str, expected: str, hint: str = MEND) -> NoReturn:
    raise InputError(what, where=str(path), found=found, expected=expected, hint=hint)


def hashed(path: str | os.PathLike[str]) -> str:
    """Sha256 (hex) of a file.

    Raises
    ------
    InputError
        It is not there, is no file, or cannot be read.
    """
    place = storage.as_path(path)
    if not place.exists():
        raise InputError("no such file", where=str(path), expected="a file that a signature can stand on",
                         hint="check the path; nothing was signed")  # fmt: skip
    if not place.is_file():
        raise InputError("this is no file", where=str(path), found="a folder" if place.is_dir() else "a device",
                         expected="a file", hint="name each file of it")  # fmt: skip
    try:
        with place.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError("the file cannot be read", where=str(path), found=error.strerror or str(error),
                         hint="check its permissions; nothing was signed") from None  # fmt: skip
