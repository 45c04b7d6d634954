"""Solids: a rectangular block of eight-node bricks with B-bar, plain or incompatible elements; any mesh by `mesh`.

The X-Y plane is the plane of the pad, Z its thickness. Node n = i + (nx + 1) (j + (ny + 1) k), at column i along X, j
along Y, k along Z, has the DOFs ``n+X, n+Y, n+Z``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .damping import Damping, settled
from .dofs import Dof
from .errors import InputError
from .faceloads import FacePatch
from .hermite import Line
from .hexcell import ELEMENTS, Brick, mass_matrix
from .hexfield import HexField, known_face
from .locking import locking
from .materials import Material
from .meshes import mesh
from .structure import Structure
from .values import integer, number, positive, shown

__all__ = ["FacePatch", "block", "mesh"]

CELLS = 50_000  # matrices of half a GB, a factor of many GB


def block(
    *,
    lengths: tuple[float, float, float],
    elements: tuple[int, int, int],
    material: Material,
    element: str = "bbar",
    fixed: str | Iterable[str] | None = "bottom",
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    damping: Damping | float | None = None,
    allow: Iterable[str] = (),
) -> Structure:
    """Rectangular block: a pad, a thick plate, a short beam.

    Parameters
    ----------
    lengths : (a, b, c)
        Sides along X, Y and Z (m).
    elements : (nx, ny, nz)
        Equal cells along X, Y and Z.
    material : Material
        E, rho, nu.
    element : {"bbar", "standard", "incompatible"}
        Mean dilatation (pads and other soft solids, any nu), the plain brick (locks for nu > 0.45), or incompatible
        modes (thin parts in bending: the other two are several times too stiff there).
    fixed : face or faces
        Bonded faces, all three DOFs held: "bottom" and "top" (Z), "left" and "right" (X), "front" and "back" (Y). None
        for a free body; ``with_supports`` adds rollers and points.
    origin : (x0, y0, z0)
        Coordinates of the first corner (m). Points are given in the same coordinates; matrices do not depend on it.
    damping : Rayleigh, Modal, Structural or float, optional
        Damping; a number is the ratio of every mode.
    allow : iterable of str
        ``("E109",)`` builds plain bricks above nu = 0.49; a flag stays.

    Returns
    -------
    Structure
        ``structure.field.surface("top")`` is a face of it; ``structure.field.flags`` what the guards found.

    Raises
    ------
    InputError
        If a value is not possible, a name is unknown, or there are too many cells; code LID-E109 for plain bricks above
        nu = 0.49.

    Notes
    -----
    Elements: see `structures.hexcell`. The mass is that of the plain brick for all of them.
    """
    if not isinstance(element, str) or element not in ELEMENTS:
        raise InputError(
            "unknown element",
            where="solids.block, element",
            found=shown(element),
            expected=", ".join(ELEMENTS),
            hint='"bbar" for pads and rubber, "incompatible" for thin parts in bending',
        )
    if not isinstance(material, Material):
        raise InputError(
            "no material",
            where="solids.block, material",
            found=shown(material),
            expected="a Material",
            hint="beams.materials.steel, or beams.Material(E=, rho=, nu=)",
        )
    lines = _lines(lengths, elements, origin)
    h = np.array([line.h for line in lines])
    field = HexField(*lines, cell=Brick(h, material.nu, element))
    faces = _faces(fixed)
    field = replace(field, flags=locking(field, faces, allow))
    held = sorted({int(node) for face in faces for node in field.face_nodes(face).ravel()})
    return Structure(
        K=field.assemble(material.E * field.cell.stiffness),
        M=field.assemble(mass_matrix(h, material.rho)),
        dofs=tuple(Dof(node, axis) for node in range(field.grid.size) for axis in (1, 2, 3)),
        coordinates=field.coordinates,
        supports=tuple(Dof(node, axis) for node in held for axis in (1, 2, 3)),
        damping=settled(damping),
        field=field,
    )


def _three(name: str, value: Any) -> list[Any]:
    items = list(value) if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) else []
    if len(items) != 3:
        raise InputError(
            f"{name} must be three numbers",
            where="solids.block",
            found=shown(value),
            expected="one for each of X, Y, Z",
            hint=f"{name}=(20e-3, 20e-3, 4e-3)" if name != "elements" else "elements=(20, 20, 4)",
        )
    return items


def _lines(lengths: Any, elements: Any, origin: Any) -> tuple[Line, Line, Line]:
    """The divisions along X, Y and Z, checked."""
    sides = [positive("a length", v, where="solids.block, lengths", unit="m") for v in _three("lengths", lengths)]
    corner = [number("the origin", v, where="solids.block, origin", unit="m") for v in _three("origin", origin)]
    counts = [
        integer("elements", n, where=f"solids.block, mesh along {name}", limit=CELLS)
        for n, name in zip(_three("elements", elements), "XYZ", strict=True)
    ]
    cells = counts[0] * counts[1] * counts[2]
    if cells > CELLS:
        dofs = 3 * (counts[0] + 1) * (counts[1] + 1) * (counts[2] + 1)
        raise InputError(
            "too many cells for this machine's memory",
            where="solids.block, elements",
            found=f"{' x '.join(map(str, counts))} = {cells} cells, {dofs} DOFs, {cells * 576 * 12 / 1e9:.2g} GB each "
            "for K and M, and a factor of many times that",
            expected=f"at most {CELLS} cells",
            hint="a coarser mesh: two to four layers are enough for a pad with B-bar",
        )
    x, y, z = (Line(s, n, o, name) for s, n, o, name in zip(sides, counts, corner, "xyz", strict=True))
    return x, y, z


def _faces(fixed: str | Iterable[str] | None) -> tuple[str, ...]:
    """Names of the fixed faces, checked, without repeats."""
    names = [fixed] if isinstance(fixed, str) else list(fixed or ())
    return tuple(dict.fromkeys(known_face(name) for name in names))
