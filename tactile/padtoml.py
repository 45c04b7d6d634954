"""A pad from a TOML file: the table ``[pad]`` with the settings of `tactile.pad.Pad`."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError
from structures.values import number, shown

from . import outline
from .guards import pad as guards
from .padmesh import UNITS

if TYPE_CHECKING:
    from .pad import Pad

MODULI = {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6}
LENGTHS = ("size", "thickness", "pitch", "rounded", "polygon")
KNOWN = {
    "size", "thickness", "E", "nu", "pitch", "elements", "layers", "element", "density", "material", "allow", "rounded",
    "polygon", "mesh", "mesh_unit", "axis", "base", "top", "length_unit", "E_unit", "cells", "nodes",
}  # fmt: skip


def read(path: str | os.PathLike) -> Pad:
    """Pad of a TOML file.

    Parameters
    ----------
    path : path
        Table ``[pad]``: ``E``, ``nu``; ``size`` and ``thickness``, or ``mesh`` (a file, beside this one) with
        ``mesh_unit``, ``axis``, ``base``, ``top``; ``pitch`` or ``elements``, ``layers``, ``element``, ``density``,
        ``material``, ``allow``; ``rounded`` (radius) or ``polygon`` (corners). SI, unless ``length_unit = "mm"`` and
        ``E_unit = "MPa"`` say otherwise. ``cells`` and ``nodes`` are counts that somebody published: they are compared
        with Euler's formula and with the mesh, never built from.

    Raises
    ------
    InputError
        If the file is no TOML, has no such table, an unknown key or a value that fits nothing; code LID-E110 for counts
        that no mesh has.
    """
    place = Path(os.fspath(path))
    try:
        table = tomllib.loads(place.read_text(encoding="utf-8")).get("pad")
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(
            "the pad file cannot be read", where=str(place), found=str(error), expected="a TOML file"
        ) from None
    if not isinstance(table, dict):
        raise InputError(
            "the file has no table [pad]", where=str(place), found=shown(table), expected="[pad] with E, nu, size, ..."
        )
    unknown = sorted(set(table) - KNOWN)
    if unknown or not {"E", "nu"} <= set(table):
        raise InputError(
            "unknown or missing settings of a pad",
            where=f"{place}, [pad]",
            found=f"unknown {unknown}" if unknown else f"only {sorted(table)}",
            expected="E, nu and any of " + ", ".join(sorted(KNOWN - {"E", "nu"})),
        )
    return _built(place, _in_si(place, table))


def _in_si(place: Path, table: dict[str, Any]) -> dict[str, Any]:
    """Settings with lengths in m and E in Pa."""
    length, modulus = table.pop("length_unit", "m"), table.pop("E_unit", "Pa")
    if length not in UNITS or modulus not in MODULI:
        raise InputError(
            "unknown unit",
            where=f"{place}, [pad]",
            found=f"length_unit = {length!r}, E_unit = {modulus!r}",
            expected=f"{', '.join(UNITS)}; {', '.join(MODULI)}",
        )

    def scaled(value: Any) -> Any:
        if isinstance(value, list):
            return [scaled(v) for v in value]
        return UNITS[length] * number("a length", value, where=f"{place}, [pad]")

    found = {key: scaled(value) if key in LENGTHS else value for key, value in table.items()}
    found["E"] = MODULI[modulus] * number("E", found["E"], where=f"{place}, [pad]")
    return found


def _built(place: Path, table: dict[str, Any]) -> Pad:
    from .pad import Pad

    counts = table.pop("cells", None), table.pop("nodes", None)
    if counts != (None, None):
        _counted(place, counts, table.get("layers", 1))
    edges = {name: table.pop(name) for name in ("rounded", "polygon") if name in table}
    if len(edges) > 1:
        raise InputError(
            "two outlines of one pad", where=f"{place}, [pad]", found=sorted(edges), expected="rounded or polygon"
        )
    if "rounded" in edges:
        table["outline"] = outline.rounded(edges["rounded"])
    if "polygon" in edges:
        table["outline"] = outline.polygon(edges["polygon"])
    for name in ("size", "elements", "allow"):
        if isinstance(table.get(name), list):
            table[name] = tuple(table[name])
    if "mesh" not in table:
        extra = sorted({"mesh_unit", "axis", "base", "top"} & set(table))
        if extra:
            raise InputError("settings of a mesh without a mesh", where=f"{place}, [pad]", found=extra, expected="mesh")
        return Pad(**table)
    return Pad.from_mesh(place.parent / str(table.pop("mesh")), unit=table.pop("mesh_unit", None), **table)


def _counted(place: Path, counts: tuple[Any, Any], layers: Any) -> None:
    if not all(isinstance(n, int) and not isinstance(n, bool) and n > 0 for n in (*counts, layers)):
        raise InputError(
            "counts of a mesh are positive integers, both of them",
            where=f"{place}, [pad]",
            found=f"cells = {counts[0]}, nodes = {counts[1]}, layers = {layers}",
            expected="cells and nodes",
        )
    guards.counts(*counts, layers=layers, where=f"{place}, [pad]")
