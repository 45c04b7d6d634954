"""What a pad is made of: the rectangle of bricks, its divisions, and what is cut from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures import solids
from structures.errors import InputError
from structures.flags import Flag
from structures.materials import Material
from structures.structure import Structure
from structures.surfaces import Surface
from structures.values import integer, pair, positive, shown

from .outline import Outline

CELLS = 2_000  # along a side


@dataclass(frozen=True, eq=False)
class Body:
    """Structure and loaded surface of a pad, its dimensions, and what its guards found.

    Parameters
    ----------
    structure : Structure
    surface : Surface
    dimensions : dict
        Settled settings of the pad.
    flags : tuple of Flag
    layered : bool
        Whether it is made of layers of bricks, so that few of them are too few.
    levels : int array (nodes,), optional
        Level of each node from the base up.
    """

    structure: Structure
    surface: Surface
    dimensions: dict[str, Any]
    flags: tuple[Flag, ...] = ()
    layered: bool = True
    levels: NDArray[np.intp] | None = None


def sides(size: Any) -> tuple[float, float]:
    """Both sides, checked.

    Raises
    ------
    InputError
        If they are not two positive numbers.
    """
    a, b = pair("size", size, where="Pad", unit="m")
    return positive("a side", a, where="Pad, size", unit="m"), positive("a side", b, where="Pad, size", unit="m")


def divisions(size: tuple[float, float], thickness: float, pitch: Any, elements: Any) -> tuple[int, int]:
    """Cells along x and y from the pitch or from their number.

    Raises
    ------
    InputError
        If both are given, or neither is possible.
    """
    if pitch is not None and elements is not None:
        raise InputError(
            "two divisions of one pad",
            where="Pad",
            found=f"pitch={pitch!r} and elements={elements!r}",
            expected="one of the two",
            hint="pitch=1e-3, for example",
        )
    if elements is not None:
        found = list(elements) if isinstance(elements, tuple | list) else []
        if len(found) != 2:
            raise InputError(
                "elements must be two integers",
                where="Pad, elements",
                found=repr(elements),
                expected="cells along x and along y",
                hint="elements=(20, 16); layers= divides the thickness",
            )
        nx, ny = (integer("elements", n, where="Pad, elements", limit=CELLS) for n in found)
        return nx, ny
    step = thickness / 4 if pitch is None else positive("the pitch", pitch, where="Pad", unit="m")
    counts = [max(1, round(side / step)) for side in size]
    if max(counts) > CELLS:
        raise InputError(
            "too many cells",
            where="Pad, pitch",
            found=f"{counts[0]} x {counts[1]} cells of {step:g} m",
            expected=f"at most {CELLS} along a side",
            hint="pitch is in m: 1e-3 is a millimetre",
        )
    return counts[0], counts[1]


def rectangle(
    size: tuple[float, float],
    thickness: float,
    *,
    pitch: Any,
    elements: Any,
    layers: Any,
    material: Material,
    element: str,
    outline: Any,
    allow: tuple[str, ...],
) -> Body:
    """Rectangle of equal bricks, base bonded, centred on the origin.

    Raises
    ------
    InputError
        If a value is not possible.
    """
    nx, ny = divisions(size, thickness, pitch, elements)
    nz = integer("layers", layers, where="Pad, layers", limit=CELLS)
    dimensions = {"size": size, "thickness": thickness, "elements": (nx, ny), "pitch": None, "layers": nz}
    if outline is not None:
        if not isinstance(outline, Outline):
            raise InputError(
                "no outline",
                where="Pad, outline",
                found=shown(outline),
                expected="an Outline",
                hint="outline.rounded(radius), outline.polygon(corners) or outline.mask(cells) of tactile.outline",
            )
        places, quads = outline.on(size, (nx, ny))
        return extruded(places, quads, thickness, nz, material, element, allow, dimensions)
    structure = solids.block(
        lengths=(*size, thickness),
        elements=(nx, ny, nz),
        material=material,
        element=element,
        origin=(-size[0] / 2, -size[1] / 2, 0.0),
        allow=[code for code in allow if code.upper().endswith("E109")],
    )
    field: Any = structure.field
    return Body(structure, field.surface("top"), dimensions, field.flags)


def extruded(
    places: NDArray[np.float64],
    quads: NDArray[np.intp],
    thickness: float,
    layers: int,
    material: Material,
    element: str,
    allow: tuple[str, ...],
    dimensions: dict[str, Any],
    *,
    height: NDArray[np.float64] | float = 1.0,
) -> Body:
    """Layers of hexahedra over quadrilaterals (Q, 4) between nodes (V, 2), base bonded.

    The surface lies at ``thickness * height``, one height for all nodes or for each.

    Raises
    ------
    InputError
        As `structures.solids.mesh`.
    """
    count = len(places)
    z = np.multiply.outer(np.linspace(0.0, thickness, layers + 1), np.broadcast_to(height, count)).ravel()
    nodes = np.column_stack([np.tile(places, (layers + 1, 1)), z])
    cells = np.concatenate([np.hstack([quads + k * count, quads + (k + 1) * count]) for k in range(layers)])
    structure = solids.mesh(
        nodes,
        cells,
        material=material,
        element=element,
        fixed=np.arange(count),
        allow=[code for code in allow if code.upper().endswith("E109")],
        where="Pad",
    )
    field: Any = structure.field
    levels = np.repeat(np.arange(layers + 1), count)
    return Body(structure, field.surface("top"), dimensions, field.flags, levels=levels)
