"""Where a force map touches: as one contact, or as the regions that hang together, each with its own force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from loadid._results.summary import plus_minus
from structures.errors import InputError

from .._arrays import Array, Mask

if TYPE_CHECKING:
    from .forcemap import ForceMap

SHARE = 0.1  # of the peak pressure, from which a point is taken to be in contact
CLEAR = 3.0  # stds above zero that a pressure must lie to be contact
CHANCE = 1e-3  # of any region of noise alone that counts as a contact
ALIKE = 9  # nodes whose errors may be one: a node and those about it
BESIDE = 1.5  # pitches to a neighbour on a grid without cells


@dataclass(frozen=True, eq=False)
class Vector:
    """Three components with their standard deviations and one unit: a resultant force, or a torque."""

    value: Array
    std: Array
    unit: str

    def __str__(self) -> str:
        last = (np.atleast_2d(a)[-1] for a in (self.value, self.std))
        return f"({', '.join(plus_minus(v, s) for v, s in zip(*last, strict=True))}) {self.unit}"


@dataclass(frozen=True, eq=False)
class Contact:
    """Where the pad is touched.

    Parameters
    ----------
    mask : bool array (P,)
        Nodes in contact.
    area : float
        m^2, by tributary areas.
    centre : array (2,)
        Centre of pressure in the plane of the pad (m).
    radius : float
        Radius (m) of the Hertz pressure of the same second moment, ``sqrt(5/2 <r^2>)``.
    peak : float
        Largest pressure (Pa).
    slip : array (P,)
        Shear over pressure at the nodes in contact, NaN elsewhere: near the friction coefficient where it slips.
    threshold : float
        Pressure (Pa) above which a node counts as in contact.
    force : Vector
        Force on the pad (N): of one contact the resultant; of several each has that of the nodes nearer to it than to
        the others, so that they add up to the resultant.
    """

    mask: Mask
    area: float
    centre: Array
    radius: float
    peak: float
    slip: Array
    threshold: float
    force: Vector

    def __str__(self) -> str:
        x, y = 1e3 * self.centre
        return (
            f"contact of {1e6 * self.area:.3g} mm^2 about ({x:.3g}, {y:.3g}) mm, radius {1e3 * self.radius:.3g} mm, "
            f"peak {1e-3 * self.peak:.3g} kPa"
        )


def whole(found: ForceMap, share: float) -> Contact:
    """All of a single frame that is touched, as one contact."""
    mask, threshold = _touched(found, share)
    return _contact(found, mask, threshold, found.resultant())


def apart(found: ForceMap, share: float) -> tuple[Contact, ...]:
    """Regions of a single frame that hang together, the strongest first, without those that noise alone may make."""
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree
    from scipy.special import ndtri

    mask, threshold = _touched(found, share)
    nodes = np.flatnonzero(mask)
    if not nodes.size:
        return ()
    linked = _neighbours(found)[nodes][:, nodes]
    part = connected_components(linked, directed=False)[1]
    clear = max(CLEAR, float(-ndtri(CHANCE / len(mask))))
    push, spread = found.pressure_of(found.forces())[nodes], (found.pressure_noise() * found.areas)[nodes]
    noise = np.bincount(part, spread**2) * np.minimum(np.bincount(part), ALIKE)
    regions = [nodes[part == k] for k in np.flatnonzero(np.bincount(part, push) > clear * np.sqrt(noise))]
    if not regions:
        return ()
    places, owner = found.nodes[:, :2], np.repeat(np.arange(len(regions)), [len(r) for r in regions])
    nearest = owner[cKDTree(places[np.concatenate(regions)]).query(places)[1]]
    contacts = []
    for k, region in enumerate(regions):
        inside = np.zeros(len(mask), bool)
        inside[region] = True
        contacts.append(_contact(found, inside, threshold, _force(found, nearest == k)))
    return tuple(sorted(contacts, key=lambda c: -float(np.linalg.norm(c.force.value))))


def _touched(found: ForceMap, share: float) -> tuple[Mask, float]:
    """Nodes in contact of a single frame, and the pressure from which they are."""
    if not found.single:
        raise InputError("contact is that of one frame", where="contact", found=f"{len(found.load)} frames",
                         expected="one", hint="force.frame(i).contact()")  # fmt: skip
    if not 0 < share < 1:
        raise InputError("no share of the peak", where="contact", found=share, expected="between 0 and 1")
    p = found.pressure()
    threshold = share * max(float(p.max()), 0.0)
    return (p > threshold) & (p > CLEAR * found.pressure_noise()), threshold


def _contact(found: ForceMap, mask: Mask, threshold: float, force: Vector) -> Contact:
    t, p, areas = found.traction(), found.pressure(), found.areas
    weight = np.where(mask, p, 0.0) * areas
    total = float(weight.sum())
    xy = found.nodes[:, :2]
    centre = weight @ xy / total if total > 0 else np.full(2, np.nan)
    radius = float(np.sqrt(2.5 * (weight @ np.sum((xy - centre) ** 2, axis=1)) / total)) if total > 0 else 0.0
    slip = np.full(len(p), np.nan)
    n = np.array([[0.0, 0.0, 1.0]]) if found.normals is None else found.normals
    slip[mask] = np.linalg.norm(t + p[:, None] * n, axis=1)[mask] / p[mask]
    peak = float(p[mask].max() if mask.any() else p.max())
    return Contact(mask, float(areas[mask].sum()), centre, radius, max(peak, 0.0), slip, threshold, force)


def _neighbours(found: ForceMap) -> sparse.csr_array:
    """Which nodes share a cell; on a grid without cells, which lie within one and a half pitches."""
    places, cells = found.nodes, found.cells
    if cells is not None:
        corners = cells.shape[1]
        i, j = np.repeat(cells, corners, axis=1).ravel(), np.tile(cells, (1, corners)).ravel()
    else:
        from scipy.spatial import cKDTree

        tree = cKDTree(places[:, :2])
        pitch = float(np.median(tree.query(places[:, :2], k=2)[0][:, 1]))
        i, j = tree.query_pairs(BESIDE * pitch, output_type="ndarray").T
    return sparse.csr_array((np.ones(len(i), bool), (i, j)), shape=(len(places),) * 2)


def _force(found: ForceMap, nodes: Mask) -> Vector:
    """Force on some nodes. Its variance is that of the posterior, where there is one.

    Else the errors of the nodes are taken to be as correlated among these as among all: the variance of the resultant
    over the sum of all variances is that of the part over the sum of its own.
    """
    rows = found.sums(nodes)
    value = rows @ found.load
    if nodes.all():
        return found.resultant()
    if found.posterior is not None:
        variance = np.array([float(found.posterior.variance(row)) for row in rows])
        if found.bias is not None:
            variance = variance + (rows @ found.bias) ** 2
        return Vector(value, np.sqrt(variance), "N")
    own = (rows**2) @ found.std**2
    every = (found.sums(np.ones(len(nodes), bool)) ** 2) @ found.std**2
    ratio = found.resultant().std ** 2 / np.where(every > 0, every, 1.0)
    return Vector(value, np.sqrt(own * ratio), "N")
