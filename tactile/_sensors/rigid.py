"""A camera or a gel that moved as a whole, told from a load (W611).

A uniform shift of all markers is fitted by a shear of the whole surface, so that no residual shows it. But a load acts
near a contact, which stands out once the shift of most markers is taken off; and what the loads about it do not explain
of the markers far from it should be noise. The medians over cells as wide as the gel is thick are the data: a multiple
of the motion that these loads explain, a shift and a turn are fitted to them, and an F test asks whether shift and turn
explain more than chance. What scatters beyond the noise are errors of the model, which are alike over two thicknesses:
they count for a quarter of their number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from structures._flags import Flag

from .. import _guards as guards
from .._arrays import Array, Mask
from .._results import forcemap
from .observation import Markers

NEAR, FAR = 1.0, 2.0  # thicknesses from the contact: loads that count as its own, markers that it does not reach
CELLS = 5  # fewest with far markers
CHANCE = 1e-6  # of so large a motion in a frame at rest
UNKNOWNS = 3  # shift along X and Y, turn
SHARING = 4  # cells that share an error of the model
MEDIAN = np.pi / 2  # variance of a median over that of a mean


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """A shift (2,) m and a turn (rad) about a point (2,) m, and what makes them more than chance.

    The F statistic, what chance exceeds once in a million frames, and the number of cells of far markers it stands on.
    """

    shift: Array
    turn: float
    about: Array
    ratio: float
    threshold: float
    cells: int

    def field(self, places: Array) -> Array:
        """In-plane motion (n, 2) in m of places (n, 2)."""
        x, y = (places - self.about).T
        return self.shift + self.turn * np.column_stack([-y, x])


def typical(motion: Array, noise: Array) -> Array:
    """Shift (2,) of most markers, the median of their motion (N, 2); zero where it is below their noise."""
    seen = np.isfinite(motion).all(axis=1)
    if not seen.any():
        return np.zeros(2)
    shift = np.median(motion[seen], axis=0)
    return np.asarray(shift if np.linalg.norm(shift) > np.sqrt(np.mean(noise**2)) else np.zeros(2))


def contact(load: Array, std: Array) -> Mask:
    """Nodes (P,) that are pressed, of loads (3 P,)."""
    pressure = -load[2::3]
    return np.asarray((pressure > forcemap.SHARE * pressure.max(initial=0.0)) & (pressure > forcemap.CLEAR * std[2::3]))


def away(
    motion: Array, explained: Callable[[Mask], Array], touched: Mask, nodes: Array,
    markers: Array, noise: Array, thickness: float,
) -> RigidMotion | None:  # fmt: skip
    """Rigid motion of the markers that the contact does not reach; None where it is chance, or cannot be told.

    `motion` (N, 2) in m is NaN where a marker is lost, `noise` (N, 2) its std; `explained` gives the motion (N, 2) by
    the loads of a mask of nodes (P,), of which those `touched` are pressed; nodes, markers and thickness of the gel in
    m.
    """
    far, loaded = np.isfinite(motion).all(axis=1), np.zeros_like(motion)
    if touched.any():
        from scipy.spatial import cKDTree

        tree = cKDTree(nodes[touched])
        far &= tree.query(markers)[0] > FAR * thickness
        if far.any():
            loaded = explained(tree.query(nodes)[0] <= NEAR * thickness)
    found = _fitted(motion[far], loaded[far], markers[far], noise[far], thickness)
    if found is None or found.ratio <= found.threshold:
        return None
    size = np.sqrt(np.mean(found.field(markers[far]) ** 2))
    return found if size > np.sqrt(np.mean(noise[far] ** 2)) else None  # below the noise of one marker it is none


def _fitted(motion: Array, loaded: Array, places: Array, noise: Array, side: float) -> RigidMotion | None:
    """Rigid motion of the medians over cells of a side, beside a multiple of what the loads explain."""
    from scipy.special import fdtri

    if len(places) < CELLS:
        return None
    which = np.unique(np.floor(places / side).astype(int), axis=0, return_inverse=True)[1].ravel()
    members = [np.flatnonzero(which == k) for k in range(int(which.max()) + 1)]
    if len(members) < CELLS:
        return None
    data, known = (np.array([np.median(v[m], axis=0) for m in members]).T.ravel() for v in (motion, loaded))
    place = np.array([places[m].mean(axis=0) for m in members])
    about = place.mean(axis=0)
    x, y = (place - about).T
    one, zero = np.ones(len(members)), np.zeros(len(members))
    rigid = np.vstack([np.column_stack([one, zero, -y]), np.column_stack([zero, one, x])])
    other = known[:, None] if known.any() else np.empty((len(data), 0))
    without = _rest(other, data)
    answer = np.linalg.lstsq(_rest(other, rigid), without, rcond=None)[0]
    within = _rest(np.column_stack([other, rigid]), data)
    spare = len(data) - other.shape[1] - UNKNOWNS
    chance = float(np.mean([MEDIAN ** (len(m) > 2) * np.mean(noise[m] ** 2) / len(m) for m in members]))
    beyond = max(float(within @ within) / spare - chance, 0.0)
    variance = chance + SHARING * beyond
    ratio = float(without @ without - within @ within) / UNKNOWNS / variance
    threshold = float(fdtri(UNKNOWNS, spare, 1 - CHANCE))
    return RigidMotion(np.asarray(answer[:2], float), float(answer[2]), about, ratio, threshold, len(members))


def _rest(columns: Array, values: Array) -> Array:
    """What columns do not explain of values, by least squares."""
    if columns.shape[1] == 0:
        return values
    scaled = columns / np.linalg.norm(columns, axis=0)
    return np.asarray(values - scaled @ np.linalg.lstsq(scaled, values, rcond=None)[0])


def whole_motion(
    motion: Array, load: Array, std: Array, markers: Markers, nodes: Array, thickness: float,
    alone: Callable[[Callable[[Array], Array]], Array], explained: Callable[[Array], Array], resultant: Array,
    pixel: float | None,
) -> Flag | None:  # fmt: skip
    """W611 of a frame: the in-plane motion (N, 2) of the markers (m), NaN where lost, load and std (3 P,) found of it.

    `alone` takes a motion in the plane as a function of places (n, 2) and gives the load (3 P,) that the map makes of
    it alone, `explained` takes a load and gives the in-plane motion of the markers under it; nodes (P, 2), thickness of
    the gel and side of a pixel on the pad in m.
    """
    places, noise = markers.points[:, :2], markers.noise[:, :2]
    shift = typical(motion, noise)
    local = load - alone(lambda x: np.broadcast_to(shift, x.shape)) if shift.any() else load
    found = away(motion, lambda near: explained(local * np.repeat(near, 3)), contact(local, std), nodes, places, noise,
                 thickness)  # fmt: skip
    if found is None:
        return None
    force = resultant[:3] @ alone(found.field)
    return guards.slipped(found.shift, found.turn, found.ratio, found.threshold, force, pixel)
