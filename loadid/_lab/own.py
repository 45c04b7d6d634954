"""The page of one's own data: a model and a log are sent, or an estimate lies there already (`estimate.explore`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from .contract import Call, OneOf, Page, Real, Text, Whole

if TYPE_CHECKING:
    from .desk import Desk

MIB = 1 << 20
LARGEST_LOG, LARGEST_MODEL = 256 * MIB, 64 * MIB
FAMILIES = ("auto", "deconvolution", "field", "frequency", "harmonic", "sparse", "static", "tracker")
LAMBDA = Real(0.0, 1e12)


def page_of(desk: Desk | None = None, *, given: bool = False) -> Page:
    """The page of a desk, of a new one where none is given; `given`: nothing can be sent to it.

    The desk is made when the first call comes, so that the list of pages stays light.
    """
    kept: list[Desk] = [] if desk is None else [desk]

    def own() -> Desk:
        if not kept:
            from .desk import Desk

            kept.append(Desk())
        return kept[0]

    def read_log(upload: Path, **reading: str) -> dict[str, Any]:
        return own().read_words(upload, **reading)

    sent = {
        "model": Call(lambda upload: own().read_model(upload), {}, upload=LARGEST_MODEL),
        "log": Call(read_log, {name: Text(300) for name in ("fs", "columns", "record", "units")}, upload=LARGEST_LOG),
        "identify": Call(
            lambda **options: own().identify(**options),
            {"family": OneOf(FAMILIES), "response": Text(1000), "noise": Text(300), "more": Text(1000)},
        ),
    }
    calls = {
        "state": Call(lambda: {**own().state(), "given": given}),
        "found": Call(lambda: own().found()),
        "picture": Call(lambda lam, load: own().picture(lam, load), {"lam": LAMBDA, "load": Whole(0, 100_000)}),
        "at": Call(lambda lam: own().at(lam), {"lam": LAMBDA}),
        "save": Call(lambda lam: own().save(lam), {"lam": LAMBDA}),
    }
    return Page(
        "own",
        "Your own data",
        "A log and a model: what was recorded, what the data can tell, and the load at any lambda.",
        "loadid._lab",
        "files/own.html",
        calls if given else {**sent, **calls},
    )


page = page_of()
