"""What a user means by region=: a span, a rectangle, a face, or a rectangle on a face."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._system.structure import Structure
from ..errors import InputError, numbers, plain, shown
from ._domains import Domain, FaceDomain, domain_of, frames
from ._grids import PAIRS, SNAP, merged

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Region:
    """Loaded part of a domain.

    Parameters
    ----------
    domain : Domain
    window : array (axes, 2)
        Extent along the axes.
    whole : bool
        It is all of the domain.
    """

    domain: Domain
    window: Array
    whole: bool

    def flat(self, where: str) -> None:
        """Refuse to cut a face whose cells are no rectangles along the axes."""
        if not self.domain.boxed:
            raise self.curved(where)

    def curved(self, where: str) -> InputError:
        """The refusal of a window or a grid on a curved or distorted face."""
        return InputError(
            "a curved or distorted face is not cut by a grid",
            where=where,
            found="cells that are no rectangles along the axes",
            expected="the whole face, by its own cells",
            hint="leave grid, rectangles and windows out: hats and patches then follow the mesh",
        )

    def mesh_lines(self) -> list[Array]:
        """Lines of the mesh inside the window, its sides included, one array per axis."""
        domain = self.domain
        lines = []
        for k, (start, stop) in enumerate(self.window):
            values = np.concatenate([domain.lower[:, k], domain.upper[:, k]])
            inside = values[(values > start) & (values < stop)]
            ends = merged(np.concatenate([[start], inside, [stop]]), stop - start)
            lines.append(np.concatenate([ends[:-1], [stop]]))
        return lines

    def rectangles(self, given: Any, where: str) -> Array:
        """Extents (n, axes, 2) of a list of spans or rectangles, each inside the window.

        Raises
        ------
        InputError
            If one has no extent, is not finite or leaves the window.
        """
        axes = len(self.window)
        form = "(x0, x1)" if axes == 1 else "((x0, x1), (y0, y1))"
        try:
            boxes = np.array([np.asarray(plain(one), float) for one in given], float)
        except (TypeError, ValueError):
            boxes = np.empty(0)
        boxes = boxes[:, None] if axes == 1 and boxes.ndim == 2 else boxes
        if boxes.ndim != 3 or boxes.shape[1:] != (axes, 2) or not 1 <= len(boxes) <= PAIRS:
            raise InputError(
                "no list of patches",
                where=f"{where}, rectangles",
                found=shown(given),
                expected=f"1 to {PAIRS} of {form} in m",
                hint="many patches side by side are a grid=",
            )
        slack = SNAP * np.ptp(self.window, axis=1)
        good = np.all(boxes[..., 1] - boxes[..., 0] > slack, axis=1)
        good &= np.all(
            (boxes[..., 0] >= self.window[:, 0] - slack) & (boxes[..., 1] <= self.window[:, 1] + slack), axis=1
        )
        if not np.all(good):
            bad = int(np.argmin(good))
            raise InputError(
                "a patch is empty or leaves the region",
                where=f"{where}, rectangles[{bad}]",
                found=boxes[bad].tolist(),
                expected=f"start < stop within {_extent(self.domain, self.window)}",
                hint="give places in metres, in the frame of the structure",
            )
        return np.asarray(np.clip(boxes, self.window[:, :1], self.window[:, 1:]))

    def normals_at(self, places: Array) -> Array | None:
        """Outward unit normals near places, (P, 3); None on beams and plates."""
        if self.domain.normals is None:
            return None
        from scipy.spatial import cKDTree

        near = cKDTree(self.domain.coordinates).query(places)[1]
        return frames(self.domain.normals[near], self._first())["N"]

    def directions_at(self, chosen: Sequence[tuple[float, str]], count: int, normals: Array | None) -> Array:
        """Unit vectors (count, components, 3) of the components at the points."""
        local = {} if normals is None else frames(normals, self._first())
        each = [s * (local[n] if n in local else np.tile(np.eye(3)["XYZ".index(n)], (count, 1))) for s, n in chosen]
        return np.stack(each, axis=1)

    def _first(self) -> int:
        return self.domain.axes[0] if isinstance(self.domain, FaceDomain) else 0


def _extent(domain: Domain, window: Array) -> str:
    return ", ".join(f"{a:.9g} <= {name} <= {b:.9g}" for name, (a, b) in zip(domain.names, window, strict=True))


def region_of(structure: Structure, region: Any, where: str) -> Region:
    """Domain and window of ``region=``.

    Raises
    ------
    InputError
        If the structure has nothing to distribute a load over, or the region does not fit it.
    """
    if not isinstance(structure, Structure):
        raise InputError(
            "no structure",
            where=where,
            found=shown(structure),
            expected="a Structure",
            hint="build one with beams, plates or solids",
        )
    surface, window = split(structure, region)
    domain = domain_of(structure, surface)
    if domain is None:
        has_faces = hasattr(structure.field, "surface")
        raise InputError(
            "no region that a load could be distributed over",
            where=where,
            found="a solid without the name of a face" if has_faces else "a structure without such a mesh",
            expected='a face, such as region="top"' if has_faces else "a beam, a rectangular plate or a solid",
            hint='region="top", for example' if has_faces else "bases.nodal(structure, nodes=...) puts forces on nodes",
        )
    if window is None:
        return Region(domain, domain.bounds, True)
    box = _window(domain, window, where)
    return Region(domain, box, bool(np.allclose(box, domain.bounds, rtol=0, atol=SNAP * np.ptp(domain.bounds))))


def split(structure: Structure, region: Any) -> tuple[Any, Any]:
    """Surface and window that a region names, each or None."""
    if region is None:
        return None, None
    if isinstance(region, str) or hasattr(region, "cells"):
        return region, None
    if (
        isinstance(region, Sequence)
        and len(region) == 2
        and (isinstance(region[0], str) or hasattr(region[0], "cells"))
    ):
        return region[0], region[1]
    return None, region


def _window(domain: Domain, window: Any, where: str) -> Array:
    bounds = domain.bounds
    box = numbers(window)
    box = box[None] if len(bounds) == 1 and box.shape == (2,) else box
    slack = SNAP * np.ptp(bounds, axis=1)
    fits = box.shape == bounds.shape and bool(np.all(np.isfinite(box)))
    if fits:
        fits = bool(np.all(box[:, 1] - box[:, 0] > slack))
        fits &= bool(np.all((box[:, 0] >= bounds[:, 0] - slack) & (box[:, 1] <= bounds[:, 1] + slack)))
    if not fits:
        raise InputError(
            f"no region of {domain.words}",
            where=f"{where}, region",
            found=shown(window),
            expected=f"(start, stop) in m along each of {', '.join(domain.names)}, within {_extent(domain, bounds)}",
            hint="leave region out for all of it"
            if not isinstance(domain, FaceDomain)
            else 'region="top" for all of the face',
        )
    return np.asarray(np.clip(box, bounds[:, :1], bounds[:, 1:]))
