"""One way to trigger a guard, its clean twin, and how both are asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from structures import Flag, InputError, NotIdentifiable
from structures._flags import Evidence


def refused(action: Callable[[], object]) -> tuple[Flag, ...]:
    """The refusal of an action as a flag; nothing where it is not refused."""
    try:
        action()
    except (InputError, NotIdentifiable) as error:
        return (
            Flag(
                error.code,
                Evidence("refusal", error.code),
                str(error),
                getattr(error, "hint", "") or getattr(error, "advice", ""),
            ),
        )
    return ()


@dataclass(frozen=True)
class Case:
    """One way to trigger a guard, its clean twin, and the number that the flag must print."""

    code: str
    trigger: Callable[[], tuple[Flag, ...]]
    clean: Callable[[], tuple[Flag, ...]]
    says: str
    name: str = ""

    def __str__(self) -> str:
        return f"{self.code} {self.name}".strip()


def of(code: str, found: tuple[Flag, ...]) -> list[Flag]:
    """The flags of one code."""
    return [f for f in found if f.code == f"LID-{code}"]
