"""A press of known force in one TOML file: its frames, and what pressed in them.

log = "check.npy"             # frames that begin with the unloaded pad
depth = "check_depth.npy"     # where the job has depth maps
unloaded = 5
frames = [8, 9]               # during the press, from 1: their mean is the reading
force = ["0.25 N", "0 N", "-1 N"]
at = ["0 mm", "0 mm"]         # with the radius of the contact: a press whose distribution is known;
radius = "2.2 mm"             # without both the force alone is
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from loadid import _toml
from structures.errors import InputError, real

from .._closed.presses import Press
from .._pad.table import TomlTable

FORCES = ("Fx", "Fy", "Fz")
NEWTONS = re.compile(r"\s*(\S+)\s+(mN|N|kN)\s*")
UNITS = {"mN": 1e-3, "N": 1.0, "kN": 1e3}


@dataclass(frozen=True)
class KnownPress:
    """Frames of a press, and what is known of it.

    Parameters
    ----------
    log : Path
    depth : Path or None
    unloaded : int
        Frames before it.
    frames : (int, int) or None
        First and last, from 1; None for the strongest.
    force : (float, float, float)
        N on the pad.
    press : Press or None
        With its place and radius; None where the force alone is known.
    """

    log: Path
    depth: Path | None
    unloaded: int
    frames: tuple[int, int] | None
    force: tuple[float, float, float]
    press: Press | None


def presses(path: Path) -> KnownPress:
    """Read the file of a press.

    Raises
    ------
    InputError
        No such file, no TOML, a key or a unit that is none, a place without a radius.
    """
    table = TomlTable(path, "", _toml.read(path, "press"))
    log, depth = table.text("log"), table.text("depth", None)
    unloaded, frames = table.count("unloaded", 5), table.counts("frames", 2, None)
    at, radius = table.quantities("at", "displacement", 2, None), table.positive("radius", "displacement", None)
    words = table.words("force")
    table.end()
    if len(words) != len(FORCES):
        raise InputError("no force", where=f"{path}: force", found=f"{len(words)} numbers",
                         expected='force = ["0.25 N", "0 N", "-1 N"], on the pad along x, y and z')  # fmt: skip
    x, y, z = (_newtons(path, word) for word in words)
    if (at is None) != (radius is None):
        raise InputError("a place and a radius go together", where=str(path), found="one of them",
                         expected="at and radius, or neither: then the force alone is known")  # fmt: skip
    press = None if at is None else Press(at=at, radius=radius, force=-z, shear=(x, y))
    return KnownPress(
        table.beside(log), None if depth is None else table.beside(depth), unloaded, frames, (x, y, z), press
    )


def _newtons(path: Path, word: str) -> float:
    split = NEWTONS.fullmatch(word)
    value = None if split is None else real(_number(split[1]))
    if split is None or value is None:
        raise InputError("no force", where=f"{path}: force", found=repr(word)[:40],
                         expected='a number with its unit, such as "-1 N"')  # fmt: skip
    return value * UNITS[split[2]]


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
