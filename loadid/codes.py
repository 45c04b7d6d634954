"""Every guard code of the package, in words; how findings are collected, and which codes a user may allow."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from structures._flags import Flag, canonical, table
from structures.errors import InputError

__all__ = ["GUARDS", "allowed", "collect", "explained", "known_codes"]

GUARDS = {code: guard.title for code, guard in table().items()}


def known_codes(codes: Iterable[str], *, where: str = "allow") -> tuple[str, ...]:
    """The codes in full form.

    Raises
    ------
    InputError
        If one of them is no code of the package; the message lists those that are.
    """
    full = []
    for code in codes:
        short = str(code).strip().upper().removeprefix("LID-")
        if short not in GUARDS:
            raise InputError("there is no such guard code", where=where, found=repr(code),
                             expected=f"one of {', '.join(GUARDS)}",
                             hint="only refusals (E) can be overridden")  # fmt: skip
        full.append(canonical(short))
    return tuple(full)


def explained(flag: Mapping[str, Any]) -> dict[str, Any]:
    """A flag as plain values, with what the table of codes says of it: title, stage and place in the documentation."""
    guard = table()[flag["code"].removeprefix("LID-")]
    return {**flag, "title": guard.title, "stage": guard.stage, "docs": guard.docs}


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
