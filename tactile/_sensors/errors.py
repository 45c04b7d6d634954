"""What a pad's model may be wrong by: its mesh, and the modulus, Poisson's ratio and thickness that it was built with.

The mesh errs by a share of what the same pad with twice the pitch and half the layers differs from it. In the band that
share is `REFINED`; in the estimate the whole of the difference counts, without which every rule for lambda follows the
mesh (`python -m tests.campaigns tactile` prints what both are worth). Derivatives by nu and thickness are those of the
coarser pad, whose error they do not share.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from structures.errors import InputError

from .._arrays import Array
from .._pad.tolerances import Tolerances
from .gaussian import MESH, ModelError

if TYPE_CHECKING:
    from .._pad.pad import Pad

REFINED = 0.4  # of the difference from half the mesh: std of the error of a mesh
STEP = 0.25  # of the std of a parameter, of a finite difference
COARSE = ("W115", "E109")  # what the coarser pad is allowed


def errors(
    pad: Pad, tolerances: Tolerances, mass: Any, transfer: Array, parts: Sequence[tuple[Array, Callable[[Any], Any]]]
) -> list[ModelError]:
    """Errors of a transfer matrix (m, 3 P) of tractions, `mass` times which are nodal forces; each of one std.

    `parts` are points (n, 2 or 3) of the pad and what picks the readings of their motion.
    """
    half = coarser(pad)
    found = [] if half is None else _of_mesh(pad, half, tolerances, mass, transfer, parts)
    return [*found, *([ModelError("E", tolerances.E * transfer)] if tolerances.E else [])]


def _of_mesh(
    pad: Pad, half: Pad, tolerances: Tolerances, mass: Any, transfer: Array, parts: Sequence[tuple[Array, Any]]
) -> list[ModelError]:
    spread = _onto(half, pad.nodes2d) @ mass

    def rows(body: Pad) -> Array:
        return np.vstack([np.asarray(pick(body.from_surface(at)) @ (body.compliance @ spread)) for at, pick in parts])

    try:
        first = rows(half)
    except InputError:  # markers that lie beside a surface of larger cells
        return []
    found = [ModelError(MESH, REFINED * (first - transfer), 1 / REFINED)]
    for name in ("nu", "thickness"):
        std = float(getattr(tolerances, name))
        if std:
            found.append(ModelError(name, (first - rows(_less(half, name, std * STEP))) / STEP))
    return found


def _less(pad: Pad, name: str, by: float) -> Pad:
    """The pad with a smaller thickness, by a share of it, or a smaller nu: a larger one may be none."""
    if name == "thickness":
        return replace(pad, thickness=pad.thickness * (1 - by))
    return replace(pad, nu=pad.nu - by)


def coarser(pad: Pad) -> Pad | None:
    """The same pad with half the mesh; None where it cannot be built, as of a mesh that is used as it is."""
    if pad.mesh is not None and pad.pitch is None:
        return None
    layers, allow = max(1, pad.layers // 2), (*pad.allow, *COARSE)
    try:
        if pad.elements is not None and pad.mesh is None:
            nx, ny = (max(2, round(n / 2)) for n in pad.elements)
            return replace(pad, pitch=None, elements=(nx, ny), layers=layers, allow=allow, counts=None)
        pitch = 2 * float(pad.pitch or np.sqrt(np.median(pad.surface.areas)))
        return replace(pad, pitch=pitch, elements=None, layers=layers, allow=allow, counts=None)
    except InputError:
        return None


def _onto(half: Pad, places: Array) -> sparse.csr_array:
    """Nodal forces on a coarser surface (3 Q, 3 P) from forces at places (P, 2): of its cells, or the nearest node."""
    try:
        return sparse.csr_array(half.rows(places)[:, half.dofs]).T.tocsr()
    except InputError:
        from scipy.spatial import cKDTree

        nearest = cKDTree(half.nodes2d).query(places)[1]
        ones = sparse.csr_array((np.ones(len(places)), (nearest, np.arange(len(places)))),
                                shape=(half.points, len(places)))  # fmt: skip
        return sparse.csr_array(sparse.kron(ones, sparse.eye_array(3)))
