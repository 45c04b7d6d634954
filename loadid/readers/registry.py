"""Which reader takes which file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from structures.errors import InputError

from .source import Options, Source, Table

Loader = Callable[[Source, Options], list[Table]]


@dataclass(frozen=True)
class Format:
    """One format: its name, its suffixes, whether some first bytes can be it, and its reader.

    A generic format (plain text) is asked after those that have a mark of their own. A native one is parsed by a C
    library and therefore in a child process.
    """

    name: str
    suffixes: tuple[str, ...]
    sniff: Callable[[bytes], bool]
    load: Loader
    generic: bool = False
    native: bool = False


_FORMATS: dict[str, Format] = {}


def register(
    name: str, *, suffixes: tuple[str, ...], sniff: Callable[[bytes], bool], generic: bool = False, native: bool = False
) -> Callable[[Loader], Loader]:
    """Decorator that adds a reader, a function (source, options) -> list of tables.

    Parameters
    ----------
    name : str
        Name of the format, for messages.
    suffixes : tuple of str
        With the dot, lower case.
    sniff : function
        First 4096 bytes -> whether the file can be of this format.
    generic : bool
        The format has no mark of its own.
    native : bool
        A C library parses it: run it where it can be killed.

    Raises
    ------
    InputError
        If a format of this name is there.
    """

    def add(load: Loader) -> Loader:
        if name in _FORMATS:
            raise InputError("a format of this name is registered", where="readers", found=name)
        _FORMATS[name] = Format(name, tuple(s.lower() for s in suffixes), sniff, load, generic, native)
        return load

    return add


def formats() -> tuple[Format, ...]:
    """All formats, those with a mark of their own first."""
    return tuple(sorted(_FORMATS.values(), key=lambda f: f.generic))


def known_suffixes() -> tuple[str, ...]:
    """All suffixes, sorted."""
    return tuple(sorted({s for f in _FORMATS.values() for s in f.suffixes}))


def recognise(source: Source) -> Format:
    """Format of a file whose suffix is known: of that suffix if the content agrees, else what the content says.

    Raises
    ------
    InputError
        If the content is of no format that the suffix allows and of no other one either.
    """
    suffix = source.path.suffix.lower()
    can = [f for f in formats() if f.sniff(source.head)]
    of_suffix = [f for f in can if suffix in f.suffixes]
    marked = [f for f in can if not f.generic]
    if of_suffix or marked:
        return (of_suffix or marked)[0]
    expected = next(f.name for f in formats() if suffix in f.suffixes)
    return source.refuse(
        f"the content is not {expected}",
        "plain text" if can else f"first bytes {source.head[:16]!r}",
        f"{expected}, as the suffix {suffix} says",
        "rename or export the file again",
    )
