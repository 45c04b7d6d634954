"""True tractions of a press as a map on a mesh can hold them: means over hats or cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError
from structures.values import positive

from .settled import Array, finite

if TYPE_CHECKING:
    from loadid.validate import Known

PARTS = 6  # sub-cells of a pitch along each direction; a hat is taken as constant in each


def means(press: Any, nodes: Array, pitch: float | tuple[float, float], shape: str = "hat") -> Array:
    """Mean tractions of one press (Pa), (P, 3), about nodes (P, 2) of a regular grid.

    Parameters
    ----------
    press : Press
    nodes : array (P, 2)
        Places (m).
    pitch : float or (along X, along Y)
        Distance of the nodes (m).
    shape : {"hat", "patch"}
        Weight of the mean: bilinear, twice as wide as a cell, or constant over the cell.

    Raises
    ------
    InputError
        Another shape, or a pitch that is not positive.
    """
    if shape not in ("hat", "patch"):
        raise InputError("unknown shape", where="metrics.means", found=repr(shape), expected='"hat" or "patch"',
                         hint="nodal forces of finite elements are means over hats")  # fmt: skip
    d = np.array([positive("pitch", p, where="metrics.means", unit="m") for p in np.broadcast_to(pitch, 2)])
    near = np.all(np.abs(nodes - np.asarray(press.at)) <= press.radius + d, axis=1)
    found = np.zeros((len(nodes), 3))
    if not near.any():
        return found
    if shape == "patch":
        found[near] = press.mean_tractions(_cells(nodes[near], d))
        return found
    steps = (np.arange(2 * PARTS) + 0.5) / PARTS - 1
    for x in steps:
        for y in steps:
            weight = (1 - abs(x)) * (1 - abs(y)) / PARTS**2
            found[near] += weight * press.mean_tractions(_cells(nodes[near] + d * [x, y], d / PARTS))
    return found


def known(
    presses: Sequence[Any],
    nodes: Array,
    areas: ArrayLike,
    *,
    pitch: float | tuple[float, float],
    source: str = "presses of known force and place",
) -> Known:
    """Nodal forces of known presses, as `loadid.validate` takes them: level "distribution".

    A resultant alone (``loadid.validate.Wrench``) stays partial there.

    Parameters
    ----------
    presses : sequence of Press
        Acting together.
    nodes : array (P, 2 or 3)
        Places of the estimate's nodes (m).
    areas : array (P,)
        Their tributary areas (m^2).
    pitch : float or (along X, along Y)
        Distance of the nodes (m).
    source : str
        What the reference is, in words.
    """
    from loadid.validate import Known

    at = finite(nodes, "nodes")[:, :2]
    total = np.sum([means(p, at, pitch) for p in presses], axis=0) * finite(areas, "areas")[:, None]
    return Known(total.ravel(), source=source)


def _cells(middles: Array, d: Array) -> Array:
    """Corners (P, 4, 2), counter-clockwise."""
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    return middles[:, None] + corners * d
