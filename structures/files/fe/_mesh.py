"""Meshes that meshio reads, made into stiffness and mass of solids; meshio parses in a process of its own."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..._elements import solids
from ..._elements.members import Material
from ...errors import InputError
from .._child import apart
from ._parts import CUT, Matrix, Parts, data_of, refuse

KINDS = {"hexahedron": "C3D8", "tetra10": "C3D10"}
SUFFIXES = (".msh", ".vtk", ".vtu", ".med", ".mesh", ".xdmf", ".cgns", ".e", ".exo", ".ugrid", ".mdpa")


def read(path: Path, material: Material | None, length: float) -> Parts:
    """Nodes of a mesh; with a material the stiffness and mass of its hexahedra or quadratic tetrahedra, in SI.

    Labels count the points of the mesh from 1, as its file lists them.

    Raises
    ------
    InputError
        meshio is missing, cannot read the file, or crashes on it; cells of several kinds; cells with a negative volume.
    """
    where = str(path)
    size = len(data_of(path))
    if importlib.util.find_spec("meshio") is None:
        refuse("meshes are read by the library meshio, which is not installed", where, path.suffix, "meshio",
               "pip install 'loadid[fe]'")  # fmt: skip
    kinds, arrays = apart(
        f"{__name__}:parse", {"path": str(path), "library": "meshio"}, reader="meshio", where=where, size=size
    )
    points, cells = np.asarray(arrays[0], float), dict(zip(kinds, arrays[1:], strict=True))
    if points.ndim != 2 or points.shape[1] not in (2, 3) or not len(points) or not np.isfinite(points).all():
        refuse(CUT, where, f"points {points.shape}", "finite points (n, 3)")
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    numbers = np.arange(1, len(points) + 1)
    if material is None:
        return Parts(nodes=numbers, places=points)
    return _solid(points, cells, material, length, where)


def _solid(points: Any, cells: Mapping[str, Any], material: Material, length: float, where: str) -> Parts:
    known = [kind for kind in cells if kind in KINDS]
    others = sorted(kind for kind in cells if kind not in (*KINDS, "vertex", "line", "line3", "triangle", "triangle6",
                                                           "quad", "quad8", "quad9"))  # fmt: skip
    if len(known) != 1 or others:
        raise InputError(
            "the mesh is not of one kind of cells that is built here", where=where,
            found=", ".join(sorted(cells)) or "no cells", expected=f"one of {', '.join(KINDS)}",
            hint="export K and M of the solver for shells, beams and mixed meshes",
        )  # fmt: skip
    table = np.asarray(cells[known[0]], np.int64)
    if table.shape[1:] != ((10,) if known[0] == "tetra10" else (8,)):
        refuse(CUT, where, f"cells {table.shape}", known[0])
    used, index = np.unique(table, return_inverse=True)
    if used.min(initial=0) < 0 or used.max(initial=0) >= len(points):
        refuse(CUT, where, f"a cell with the point {int(used.max(initial=0))}", f"points below {len(points)}")
    made = solids.mesh(points[used] * length, index.reshape(table.shape), material=material, kind=KINDS[known[0]],
                       element="standard" if known[0] == "tetra10" else "bbar", fixed=None, where=where)  # fmt: skip
    labels = np.column_stack([np.repeat(used + 1, 3), np.tile([1, 2, 3], len(used))])
    assert made.M is not None
    return Parts(
        matrices={"K": Matrix(made.K, labels), "M": Matrix(made.M, labels)}, nodes=used + 1, places=points[used],
        notes=(f"{Path(where).name}: {len(table)} cells, {known[0]}; labels count the points of the mesh from 1",),
    )  # fmt: skip


def parse(request: Mapping[str, Any]) -> tuple[Any, list[Any]]:
    """In the child: points, and the cells of each kind together.

    Raises
    ------
    InputError
        Whatever meshio says of a file that it cannot read.
    """
    import meshio

    try:
        mesh = meshio.read(request["path"])
        kinds: dict[str, list[Any]] = {}
        for block in mesh.cells:
            if block.type not in ("polygon", "polyhedron"):
                kinds.setdefault(block.type, []).append(np.asarray(block.data))
        return list(kinds), [np.asarray(mesh.points, float), *(np.concatenate(k) for k in kinds.values())]
    except (Exception, SystemExit) as error:  # meshio ends the process on some files
        raise InputError(
            "meshio cannot read the mesh", where=request["path"],
            found="a version or kind that it does not know" if isinstance(error, SystemExit) else
                  f"{type(error).__name__}: {str(error)[:160]}",
            expected="an undamaged mesh of a version that it knows",
            hint="export it again, as Gmsh 4.1 or VTU",
        ) from None  # fmt: skip
