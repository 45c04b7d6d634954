"""The page of one's own data: a model and a log are sent, and the load is found as the command finds it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from .contract import Call, OneOf, Page, Text
from .explore import page_with

if TYPE_CHECKING:
    from .desk import Desk

MIB = 1 << 20
LARGEST_LOG, LARGEST_MODEL = 256 * MIB, 64 * MIB
FAMILIES = ("auto", "deconvolution", "field", "frequency", "harmonic", "sparse", "static", "tracker")


def page_of(desk: Desk | None = None) -> Page:
    """The page of a desk; of a new one, made when the first call comes, where none is given."""
    kept: list[Desk] = [] if desk is None else [desk]

    def own() -> Desk:
        if not kept:
            from .desk import Desk

            kept.append(Desk())
        return kept[0]

    def read_log(upload: Path, **reading: str) -> dict[str, Any]:
        return own().read_words(upload, **reading)

    return page_with(
        lambda: own().shown,
        {
            "state": Call(lambda: {**own().state(), "given": False}),
            "model": Call(lambda upload: own().read_model(upload), {}, upload=LARGEST_MODEL),
            "log": Call(
                read_log, {name: Text(300) for name in ("fs", "columns", "record", "units")}, upload=LARGEST_LOG
            ),
            "identify": Call(
                lambda **options: own().identify(**options),
                {"family": OneOf(FAMILIES), "response": Text(1000), "noise": Text(300), "more": Text(1000)},
            ),
        },
    )


page = page_of()
