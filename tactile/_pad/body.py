"""What a pad is made of: the rectangle of bricks, its divisions, its outline, and what is cut from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from structures._elements import solids
from structures._elements.members import Material
from structures._elements.surfaces import Surface
from structures._flags import Flag
from structures._system.structure import Structure
from structures.errors import InputError, as_array, integer, one_of, pair, positive, shown

from .._arrays import MODULUS, PITCH, PLANE, SIDE, THICKNESS, Array, Index, Mask, shaped

if TYPE_CHECKING:
    from .pad import Pad


ARC = 16  # chords of a rounded corner
REACH = 0.75  # of a cell: rim nodes farther from the outline stay where they are
SOUND = 0.1  # of a cell's area: the least Jacobian that fitting may leave at a corner
HALVINGS = 20  # rounds in which nodes that flatten a corner go back by half


@dataclass(frozen=True, eq=False)
class PadOutline:
    """The region that a pad covers, seen from above, in the frame of the pad.

    Parameters
    ----------
    corners : array (n, 2), optional
        Polygon, in cyclic order (m).
    cells : bool array (ny, nx), optional
        Or which cells of the rectangle stay, row by row from the smallest y.
    fitted : bool
        Move the nodes of the rim onto the polygon instead of leaving stairs.
    radius : float, optional
        Or round the corners of the rectangle (m).
    """

    corners: Array | None = None
    cells: Mask | None = None
    fitted: bool = True
    radius: float | None = None

    def on(self, size: tuple[float, float], counts: tuple[int, int]) -> tuple[Array, Index]:
        """Nodes (V, 2) and quadrilaterals (Q, 4) of the one piece that stays of a rectangle of cells."""
        (a, b), (nx, ny) = size, counts
        x, y = np.linspace(-a / 2, a / 2, nx + 1), np.linspace(-b / 2, b / 2, ny + 1)
        places = np.column_stack([m.ravel() for m in np.meshgrid(x, y)])
        first = (np.arange(nx) + (nx + 1) * np.arange(ny)[:, None]).ravel()
        quads = first[:, None] + np.array([0, 1, nx + 2, nx + 1])
        polygon = self._polygon(size)
        stays = self._mask(counts) if polygon is None else inside(polygon, places[quads].mean(axis=1)).reshape(ny, nx)
        _one_piece(stays)
        used, local = np.unique(quads[stays.ravel()], return_inverse=True)
        places, quads = places[used], local.reshape(-1, 4)
        if polygon is not None and self.fitted:
            places = _fit(places, quads, polygon, min(a / nx, b / ny))
        return places, quads

    def _polygon(self, size: tuple[float, float]) -> Array | None:
        if self.radius is not None:
            return _rounded(size, self.radius)
        return self.corners

    def _mask(self, counts: tuple[int, int]) -> Mask:
        assert self.cells is not None
        if self.cells.shape != counts[::-1]:
            raise InputError(
                "the mask does not fit the cells of the pad", where="Pad, outline", found=f"shape {self.cells.shape}",
                expected=f"{counts[::-1]}: cells along y, cells along x",
                hint="the pitch or elements of the pad decide how many cells there are",
            )  # fmt: skip
        return self.cells


def polygon(corners: ArrayLike, *, fitted: bool = True) -> PadOutline:
    """Outline by a simple polygon: a pad that was built larger and cropped.

    Parameters
    ----------
    corners : array (n, 2)
        In cyclic order (m), the origin at the centre of the rectangle.
    fitted : bool
        As in `PadOutline`.

    Raises `InputError`: if they are no polygon.
    """
    found = shaped(corners, PLANE, where="outline.polygon", what="no polygon", fewest=3, hint="an array (n, 2) in m")
    if not _area(found):
        raise InputError("no polygon", where="outline.polygon", found="no area", expected="corners in cyclic order")
    return PadOutline(corners=found, fitted=fitted)


def rounded(radius: float, *, fitted: bool = True) -> PadOutline:
    """Rounded corners of the rectangle, `radius` in m.

    Raises `InputError`: if the radius is not positive; in `Pad`, if it is more than half a side.
    """
    return PadOutline(radius=positive("the radius", radius, where="outline.rounded", unit="m"), fitted=fitted)


def mask(cells: Any) -> PadOutline:
    """Outline by cells: ``cells[j, i]`` says whether cell i along x, j along y stays.

    Raises `InputError`: if it is no table of truth values.
    """
    found = as_array(cells, where="outline.mask")
    if found.ndim != 2 or found.dtype != bool:
        raise InputError(
            "no mask of cells", where="outline.mask", found=f"{found.dtype} {found.shape}",
            expected="truth values (ny, nx)",
        )  # fmt: skip
    return PadOutline(cells=found.copy())


def inside(corners: Array, points: Array) -> Mask:
    """Whether points (n, 2) lie in a polygon (m, 2), by the parity of the sides that a ray crosses."""
    x, y = points.T
    odd = np.zeros(len(points), bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        crosses = (y0 > y) != (y1 > y)
        if y1 != y0:
            odd ^= crosses & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return odd


def _rounded(size: tuple[float, float], radius: float) -> Array:
    if radius > min(size) / 2:
        raise InputError(
            "the corners are rounder than the pad is wide", where="Pad, outline", found=f"radius {radius:g} m",
            expected=f"at most {min(size) / 2:g} m", hint="the radius is in m",
        )  # fmt: skip
    turn = np.linspace(0, np.pi / 2, ARC + 1)
    arc = radius * np.column_stack([np.cos(turn), np.sin(turn)])
    out = []
    for quarter, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        middle = np.array([sx * (size[0] / 2 - radius), sy * (size[1] / 2 - radius)])
        part = np.abs(arc) * [sx, sy]
        out.append(middle + (part if quarter % 2 == 0 else part[::-1]))
    return np.concatenate(out)


def _area(corners: Array) -> float:
    x, y = corners.T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


def _one_piece(stays: Mask) -> None:
    """Refuse an empty pad, and cells that hang together at a corner or not at all."""
    from scipy.ndimage import label

    parts, count = label(stays)
    if count == 1:
        return
    sizes = np.bincount(parts.ravel())[1:]
    raise InputError(
        "the outline leaves no cell" if count == 0 else f"the outline leaves {count} pieces that share no side",
        where="Pad, outline",
        found="no cell with its centre inside" if count == 0 else f"pieces of {sizes.tolist()[:6]} cells",
        expected="one piece",
        hint="check the frame (origin at the centre) and the unit (m), or take a finer pitch",
    )


def _fit(places: Array, quads: Index, corners: Array, pitch: float) -> Array:
    """Places with the nodes of the rim moved onto the polygon, as far as the cells stay sound."""
    pairs, times = edges(quads)
    rim = np.unique(pairs[times == 1])
    target = _nearest(corners, places[rim])
    near = np.linalg.norm(target - places[rim], axis=1) <= REACH * pitch
    rim, target = rim[near], target[near]
    share = np.zeros(len(places))
    share[rim] = 1.0
    step = np.zeros_like(places)
    step[rim] = target - places[rim]
    whole = np.median(_corner_areas(places, quads))
    for _ in range(HALVINGS):
        areas = _corner_areas(places + share[:, None] * step, quads)
        bad = quads[areas < SOUND * whole]  # the corner itself goes back first: it was flattened
        if not bad.size:
            break
        share[bad] = np.where(share[bad] > 0.1, share[bad] / 2, 0.0)
    else:
        share[np.unique(quads[np.any(areas < SOUND * whole, axis=1)])] = 0.0
    return places + share[:, None] * step


def edges(faces: Index) -> tuple[Index, Index]:
    """Sides (n, 2) of polygons, each once with its ends in ascending order, and how many polygons have it."""
    sides = np.sort(np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()], axis=1), axis=1)
    return np.unique(sides, axis=0, return_counts=True)


def _corner_areas(places: Array, quads: Index) -> Array:
    """Cross product of the two sides at every corner, (Q, 4)."""
    p = places[quads]
    ahead, behind = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
    return np.asarray(ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0], float)


def _nearest(corners: Array, points: Array) -> Array:
    """Nearest points of the polygon's boundary; its own corners where a node is close to one."""
    start, step = corners, np.roll(corners, -1, axis=0) - corners
    length = np.maximum(np.sum(step**2, axis=1), 1e-300)
    share = np.clip(np.sum((points[:, None] - start) * step, axis=2) / length, 0, 1)
    on = start + share[..., None] * step
    best = np.argmin(np.linalg.norm(points[:, None] - on, axis=2), axis=1)
    return np.asarray(on[np.arange(len(points)), best], float)


CELLS = 2_000  # along a side
RIMS = ("free", "bonded")
STEEPEST = np.pi / 3  # tilt of a dome at its rim
REACH_OVER = 0.95  # radii of curvature that a domed surface reaches
THINNEST = 0.02  # of its height: the least height of a dome at its rim


@dataclass(frozen=True, eq=False)
class Body:
    """Structure and loaded surface of a pad, its settled settings (`dimensions`), and what its guards found.

    `layered` where it is made of layers of bricks, so that few of them are too few; `levels` (nodes,) counts from the
    base.
    """

    structure: Structure
    surface: Surface
    dimensions: dict[str, Any]
    flags: tuple[Flag, ...] = ()
    layered: bool = True
    levels: Index | None = None


def locking_allowed(allow: Sequence[str]) -> list[str]:
    """Of the codes that are allowed those that the elements ask about."""
    return [code for code in allow if code.upper().endswith("E109")]


def sides(size: Any) -> tuple[float, float]:
    """Both sides, two positive numbers."""
    a, b = pair("size", size, where="Pad", unit="m")
    return positive("a side", a, where="Pad, size", unit="m"), positive("a side", b, where="Pad, size", unit="m")


def of_a_pad(pad: Pad) -> None:
    """Refuse what no gel pad measures, as another unit makes it; the sides of a mesh are 0 until it is built."""
    if pad.material != "elastomer":
        return
    hint = 'of another body than a gel pad material="..." says the name'
    MODULUS.positive("E", pad.E, where="Pad, E", hint=hint)
    for side in pad.size if pad.mesh is not None else sides(pad.size):
        if side:
            SIDE.positive("a side", side, where="Pad, size", hint=hint)
    if pad.thickness or pad.mesh is None:
        THICKNESS.positive("the thickness", pad.thickness, where="Pad", hint=hint)
    if pad.pitch is not None:
        PITCH.positive("the pitch", pad.pitch, where="Pad", hint=hint)


def divisions(size: tuple[float, float], thickness: float, pitch: Any, elements: Any) -> tuple[int, int]:
    """Cells along x and y from the pitch or from their number, not from both."""
    if pitch is not None and elements is not None:
        raise InputError(
            "two divisions of one pad", where="Pad", found=f"pitch={pitch!r} and elements={elements!r}",
            expected="one of the two", hint="pitch=1e-3, for example",
        )  # fmt: skip
    if elements is not None:
        found = list(elements) if isinstance(elements, tuple | list) else []
        if len(found) != 2:
            raise InputError(
                "elements must be two integers", where="Pad, elements", found=repr(elements),
                expected="cells along x and along y", hint="elements=(20, 16); layers= divides the thickness",
            )  # fmt: skip
        nx, ny = (integer("elements", n, where="Pad, elements", limit=CELLS) for n in found)
        return nx, ny
    step = thickness / 4 if pitch is None else positive("the pitch", pitch, where="Pad", unit="m")
    counts = [max(1, round(side / step)) for side in size]
    if max(counts) > CELLS:
        raise InputError(
            "too many cells", where="Pad, pitch", found=f"{counts[0]} x {counts[1]} cells of {step:g} m",
            expected=f"at most {CELLS} along a side", hint="pitch is in m: 1e-3 is a millimetre",
        )  # fmt: skip
    return counts[0], counts[1]


def rectangle(pad: Pad, material: Material) -> Body:
    """Rectangle of equal bricks as the settings of a pad have it, base bonded, centred on the origin."""
    size, thickness = sides(pad.size), positive("the thickness", pad.thickness, where="Pad", unit="m")
    nx, ny = divisions(size, thickness, pad.pitch, pad.elements)
    nz = integer("layers", pad.layers, where="Pad, layers", limit=CELLS)
    dimensions = {"size": size, "thickness": thickness, "elements": (nx, ny), "pitch": None, "layers": nz}
    bonded = one_of("no rim of a pad", pad.rim, RIMS, where="Pad, rim") == "bonded"
    if pad.outline is not None or pad.curvature is not None or bonded:
        shape = PadOutline(cells=np.ones((ny, nx), bool)) if pad.outline is None else pad.outline
        if not isinstance(shape, PadOutline):
            hint = "tactile.outline.rounded(radius), .polygon(corners) or .mask(cells)"
            raise InputError(
                "no outline", where="Pad, outline", found=shown(pad.outline), expected="an outline", hint=hint
            )
        places, quads = shape.on(size, (nx, ny))
        height = thickness if pad.curvature is None else domed(places, thickness, pad.curvature)
        return extruded(
            places, quads, 1.0, nz, material, pad.element, pad.allow, dimensions, height=height, bonded=bonded
        )
    structure = solids.block(
        lengths=(*size, thickness),
        elements=(nx, ny, nz),
        material=material,
        element=pad.element,
        origin=(-size[0] / 2, -size[1] / 2, 0.0),
        allow=locking_allowed(pad.allow),
    )
    field: Any = structure.field
    return Body(structure, field.surface("top"), dimensions, field.flags)


def cap(radius: Any, height: Any, plinth: Any) -> tuple[float, PadOutline]:
    """Radius of curvature of a spherical cap over a disc, `height` at its apex and `plinth` at its rim; its outline."""
    r, top, foot = (
        positive(name, x, where="Pad.dome", unit="m")
        for name, x in (("the radius", radius), ("the height", height), ("the plinth", plinth))
    )
    rise = top - foot
    if not 0 < rise <= np.tan(STEEPEST / 2) * r:
        raise InputError(
            "no spherical cap that columns of bricks carry", where="Pad.dome",
            found=f"a rise of {rise:g} m over a disc of radius {r:g} m",
            expected=f"a plinth lower than the height, and a rim no steeper than {np.degrees(STEEPEST):.0f} degrees",
            hint="Pad.from_mesh takes any body",
        )  # fmt: skip
    turn = np.linspace(0, 2 * np.pi, 4 * ARC, endpoint=False)
    return (r**2 + rise**2) / (2 * rise), polygon(r * np.column_stack([np.cos(turn), np.sin(turn)]))


def domed(places: Array, apex: float, curvature: Any) -> Array:
    """Height (n,) over places (n, 2) of a spherical surface of this radius of curvature, `apex` at the origin (m)."""
    R = positive("the curvature", curvature, where="Pad, curvature", unit="m")
    away = np.sum(places**2, axis=1)
    height = apex - R + np.sqrt(np.maximum(R**2 - away, 0.0))
    low = float(height.min())
    if away.max() > (REACH_OVER * R) ** 2 or low < THINNEST * apex:
        raise InputError(
            "the dome comes down to its base, or is too steep", where="Pad, curvature",
            found=f"{low:.3g} m high at its rim, {np.sqrt(away.max()) / R:.2f} radii of curvature from its middle",
            expected=f"at least {THINNEST:g} of its height of {apex:g} m, and {REACH_OVER:g} radii",
            hint="a larger radius of curvature (m), a smaller outline, or a higher plinth",
        )  # fmt: skip
    return height


def extruded(
    places: Array,
    quads: Index,
    thickness: float,
    layers: int,
    material: Material,
    element: str,
    allow: Sequence[str],
    dimensions: dict[str, Any],
    *,
    height: Array | float = 1.0,
    bonded: bool = False,
) -> Body:
    """Layers of hexahedra over quadrilaterals (Q, 4) between nodes (V, 2), base bonded.

    The surface lies at ``thickness * height``, one height for all nodes or for each. With the rim `bonded` too, the
    sides are held up to one layer under the surface, all of whose nodes may be loaded.
    """
    count = len(places)
    held = np.arange(count)
    if bonded:
        pairs, times = edges(quads)
        rim = np.unique(pairs[times == 1])
        held = np.concatenate([held, *(rim + k * count for k in range(1, layers))])
    z = np.multiply.outer(np.linspace(0.0, thickness, layers + 1), np.broadcast_to(height, count)).ravel()
    nodes = np.column_stack([np.tile(places, (layers + 1, 1)), z])
    cells = np.concatenate([np.hstack([quads + k * count, quads + (k + 1) * count]) for k in range(layers)])
    structure = solids.mesh(
        nodes,
        cells,
        material=material,
        element=element,
        fixed=held,
        allow=locking_allowed(allow),
        where="Pad",
    )
    field: Any = structure.field
    levels = np.repeat(np.arange(layers + 1), count)
    top = np.flatnonzero(np.all(field.boundary >= layers * count, axis=1))  # however steep
    return Body(structure, field.surface("top", top), dimensions, field.flags, levels=levels)
