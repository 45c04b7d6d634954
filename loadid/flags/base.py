"""What every guard shares: how findings are collected, and which codes a user may allow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from structures.errors import InputError
from structures.flags import Flag

from ..codes import known_codes


def collect(flags: Iterable[Flag | None]) -> tuple[Flag, ...]:
    """The flags that were raised, without repeats, in order."""
    seen: dict[tuple[str, str], Flag] = {}
    for flag in flags:
        if flag is not None:
            seen.setdefault((flag.code, flag.message), flag)
    return tuple(seen.values())


def allowed(codes: Sequence[str]) -> tuple[str, ...]:
    """Codes that a user allows, in full form.

    Raises
    ------
    InputError
        If one of them is no guard code.
    """
    if not isinstance(codes, list | tuple | set | frozenset):
        raise InputError("allow takes a list of codes", where="allow", found=repr(codes), expected=f"[{codes!r}]")
    return known_codes(codes)
