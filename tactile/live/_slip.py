"""How near the contact is to sliding: shear over pressure, against a friction coefficient that is learned.

The coefficient is the ratio of shear to normal force while the contact slides: its centre moves along the pad, the way
that the shear points. Until then the largest ratio that was held (a high quantile) says what it is at least.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._arrays import Array
from .._results.forcemap import Contact, ForceMap

KEPT = 400  # ratios from which the coefficient is told, newest last
FEWEST = 10  # of them
HIGH = 0.95  # quantile of the ratios that were held
SURE = 5.0  # stds above which a normal force is one
WINDOW = 0.3  # s in which the centre of a contact is followed
SLID, ALONG = 0.15, 0.7  # radii that it moves in this time, cosine to the shear: from which on it slides
NORMAL = 1.4826  # standard deviation over median absolute value of a normal law


@dataclass(frozen=True)
class Friction:
    """A coefficient of friction as it was learned.

    Parameters
    ----------
    value, std : float
        Coefficient, and its spread from sample to sample.
    samples : int
        Frames that it stands on.
    sliding : bool
        Whether these slid; else the value is what the contact has held: the coefficient is at least that.
    """

    value: float
    std: float
    samples: int
    sliding: bool


@dataclass(frozen=True, eq=False)
class SlipMap:
    """How near each place of the contact is to sliding.

    What it cannot tell: a single coefficient is taken for the whole contact, of the object that was last felt, until it
    is learned anew on the next one. At the edge of a contact both shear and pressure go to zero, and a regularised map
    smears them: the ratio is unsure there, as its band says in part (that holds the noise, not the smearing, nor
    what a completed normal motion hides, N606). Places near one need not slip while others hold; a turn about the
    normal, or a contact that rolls, is not told from one that sticks. Before anything slid the ratio is to what was
    held, and may exceed one without any slip.

    Parameters
    ----------
    ratio, std : array (P,)
        Shear over friction times pressure, 1 where it slides, with its std; NaN outside the contact.
    share, sure : float
        Share of the pressed area whose ratio is above one within a std, and whose ratio is so with two stds to spare.
    friction : Friction
    """

    ratio: Array
    std: Array
    share: float
    sure: float
    friction: Friction


class SlipWatch:
    """Learns the friction of a contact over frames; `sliding` says whether the last one slid."""

    def __init__(self, kept: Mapping[str, Any] | None = None) -> None:
        kept = kept or {}
        self._slid: deque[tuple[float, float]] = deque(_pairs(kept.get("slid")), KEPT)
        self._held: deque[tuple[float, float]] = deque(_pairs(kept.get("held")), KEPT)
        self._trail: deque[tuple[float, Array]] = deque()
        self.sliding = False

    @property
    def friction(self) -> Friction | None:
        """The coefficient, as far as it is known."""
        if len(self._slid) >= FEWEST:
            ratio, std = np.array(self._slid).T
            middle = float(np.median(ratio))
            spread = NORMAL * float(np.median(np.abs(ratio - middle)))
            return Friction(middle, float(np.hypot(spread, np.median(std))), len(ratio), True)
        if len(self._held) < FEWEST:
            return None
        ratio, std = np.array(self._held).T
        value = float(np.quantile(ratio, HIGH))
        return Friction(value, float(std[int(np.argmin(np.abs(ratio - value)))]), len(ratio), False)

    def update(self, time: float, force: ForceMap, contact: Contact) -> SlipMap | None:
        """The slip map of a frame, where there is a contact and anything is known of its friction."""
        total = force.resultant()
        self.sliding = False
        if contact.area == 0 or not -total.value[2] > SURE * total.std[2]:
            self._trail.clear()
            return None
        pair = _ratio(total.value, force.geometry["resultant_covariance"][:3, :3])  # type: ignore[index]
        self.sliding = self._slides(time, contact, total.value[:2])
        (self._slid if self.sliding else self._held).append(pair)
        known = self.friction
        return None if known is None else slip_map(force, contact, known)

    def kept(self) -> dict[str, Any]:
        """What is learned, for a file."""
        return {name: np.array(pairs, float).reshape(-1, 2) for name, pairs in
                (("slid", self._slid), ("held", self._held))}  # fmt: skip

    def _slides(self, time: float, contact: Contact, shear: Array) -> bool:
        """Whether the centre of the contact moves the way that the shear points."""
        while self._trail and not 0 <= time - self._trail[0][0] <= WINDOW:
            self._trail.popleft()
        self._trail.append((time, contact.centre))
        moved = contact.centre - self._trail[0][1]
        far, size = float(np.hypot(*moved)), float(np.hypot(*shear))
        if far <= SLID * contact.radius or size == 0:
            return False
        return float(moved @ shear) > ALONG * far * size


def slip_map(force: ForceMap, contact: Contact, friction: Friction) -> SlipMap:
    """Shear over friction times pressure at the nodes in contact, with what noise and friction leave open of it."""
    t, spread = force.traction(), force.std.reshape(-1, 3)
    if force.geometry["kind"] == "nodal":  # type: ignore[index]
        spread = spread / force.areas[:, None]
    at, mu = contact.mask, friction.value
    (x, y, z), (dx, dy, dz) = t[at].T, spread[at].T
    q, p = np.hypot(x, y), -z
    across = np.hypot(x * dx, y * dy) / np.maximum(q, 1e-300)  # std of the shear
    ratio, std = np.full(len(t), np.nan), np.full(len(t), np.nan)
    ratio[at] = q / (mu * p)
    std[at] = np.sqrt((across / (mu * p)) ** 2 + ratio[at] ** 2 * ((dz / p) ** 2 + (friction.std / mu) ** 2))
    area = force.areas[at]
    total = max(float(area.sum()), 1e-300)
    near, clear = ratio[at] + std[at] >= 1, ratio[at] - 2 * std[at] >= 1
    return SlipMap(ratio, std, float(area[near].sum()) / total, float(area[clear].sum()) / total, friction)


def _ratio(force: Array, covariance: Array) -> tuple[float, float]:
    """Shear over normal force, and its std."""
    shear, normal = float(np.hypot(force[0], force[1])), -float(force[2])
    slope = np.array([force[0] / max(shear, 1e-300), force[1] / max(shear, 1e-300), shear / normal]) / normal
    return shear / normal, float(np.sqrt(max(float(slope @ covariance @ slope), 0.0)))


def _pairs(values: Any) -> list[tuple[float, float]]:
    return [] if values is None else [(float(a), float(b)) for a, b in values]
