"""Servers in this process: a plan of one tracker, rounds by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loadid import LoadTracker
from loadid._families.tracking.tracker import Tracker
from loadid._serve import plan
from loadid._serve.server import Server
from tests.killed import text
from tests.tracked import bm2

from .broker import straight, waited

_MADE: dict[str, Any] = {}


def fitted() -> tuple[Tracker, np.ndarray]:
    """Tracker of the ten-storey building, fitted to its record, and the record."""
    if not _MADE:
        case = bm2("matern", 0, samples=1500)
        _MADE["found"] = LoadTracker(case.setup.space("zoh"), noise=case.noise).fit(case.y, case.dt), case.y
    tracker, Y = _MADE["found"]
    return tracker, Y


def lines(**settings: bool) -> list[bytes]:
    """The record as text, its names first."""
    return text(*fitted(), **settings)


def server(folder: Path, source: str, skip: Sequence[str] = (), **run: float) -> Server:
    """A server of one structure, ``mast``."""
    if not (folder / "model.h5").exists():
        fitted()[0].save(folder / "model.h5")
    settings = "".join(f"{name} = {value}\n" for name, value in {"latency": 0.005, **run}.items())
    (folder / "plan.toml").write_text(
        f'states = "states"\n[run]\n{settings}[[asset]]\nname = "mast"\nmodel = "model.h5"\nsource = "{source}"\n'
        'sinks = ["mast.csv"]\n'
    )
    return Server(plan.read(folder / "plan.toml"), skip=skip)


def rounds(one: Server, done: Callable[[], bool], what: str) -> None:
    """Go round until something is so."""

    def again() -> bool:
        one.round()
        return done()

    waited(again, what, 30)


def rows(folder: Path, name: str = "mast.csv") -> int:
    """Rows of a table."""
    path = folder / name
    return path.read_bytes().count(b"\n") - 1 if path.exists() else 0


def undisturbed(folder: Path, log: list[bytes]) -> bytes:
    """The same for the server of a folder."""
    return straight(folder / "model.h5", b"".join(log), folder / "straight.csv")
