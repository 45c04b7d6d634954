"""Whether the markers of a frame agree with each other: what the others predict for each, and which contradict all.

What the others predict for a reading is known from the inverse alone: its residual over ``1 - A_ii`` (leave-one-out).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .._arrays import Array, Index, Mask
from .inversion import Inverse

MANY = 12  # markers from which one can be told to contradict the others
STRAYS = 20  # of them that are left out, at most
STRAY, PART = 10.0, 0.6  # distance over its std or the typical one, and over the largest motion
BESIDE = 4.0  # and over the second largest distance of its neighbours, which a contact raises alike
AROUND = 8  # neighbours
TURNS, ALIKE = 4, 0.5  # of them that may be the other half of a swap; its distance over that of the first
FREE = 0.02  # 1 - A_ii below which a reading explains itself: no other tells of it
NORMAL = 1.4826  # standard deviation over median absolute value of a normal law


@dataclass(eq=False)
class Consistency:
    """Leave-one-out errors of the markers (N, 2) of a frozen inverse; their readings come first, `axes` for each."""

    inverse: Inverse
    places: Array
    axes: int
    near: Index = field(init=False)

    def __post_init__(self) -> None:
        from scipy.spatial import cKDTree

        rows = len(self.places) * self.axes
        count = min(AROUND + 1, len(self.places))
        self.near = np.atleast_2d(cKDTree(self.places).query(self.places, k=count)[1])[:, 1:]
        self.free = np.maximum(1 - np.diagonal(self.inverse.influence)[:rows], 1e-3)
        self.judged = np.repeat((self.free.reshape(-1, self.axes) > FREE).all(axis=1), self.axes)
        # single precision where the products of the map are: it is asked for every frame
        self.rows = np.ascontiguousarray(self.inverse.influence[:rows], self.inverse.matrix.dtype)

    def checked(self, y: Array) -> tuple[Array, int, float]:
        """Readings without those of markers that contradict all others, how many these are, and the misfit left.

        One at a time, the worst first, as a stray marker pulls the predictions of its neighbours with it. The misfit is
        the rms residual of the markers over what their noise lets expect: 1 where model and noise are right.
        """
        found, rest = 0, self._rest(y)
        while len(self.places) >= MANY and found < STRAYS and (worst := self._stray(y, *rest)) is not None:
            before, y = y, self._left_out(y, worst)
            partner = self._partner(before, y, worst)
            y = y if partner is None else self._left_out(y, partner)
            found += 1 if partner is None else 2
            rest = self._rest(y)
        return y, found, self._misfit(*rest[1:])

    def _partner(self, before: Array, y: Array, stray: int) -> int | None:
        """The neighbour that was taken for the stray marker in turn: as far from its place, if there is one.

        Alone it might explain itself, so it is held against what all others say without both.
        """
        far = self._distance(before, y, stray)
        seen = [int(j) for j in self.near[stray][:TURNS] if np.isfinite(y[j * self.axes])]
        away = [self._distance(before, self._left_out(y, j), j) for j in seen]
        return seen[int(np.argmax(away))] if away and max(away) > ALIKE * far else None

    def _distance(self, before: Array, y: Array, marker: int) -> float:
        """Whitened distance of a marker that was left out from what the others predict for it."""
        here = slice(marker * self.axes, (marker + 1) * self.axes)
        return float(np.linalg.norm(before[here] / self.inverse.noise[here] - self.inverse.filled(y)[0][here]))

    def _misfit(self, gone: Mask, rest: Array) -> float:
        kept = ~gone & self.judged
        return float(np.sqrt(np.sum(rest[kept] ** 2) / max(np.sum(self.free[kept]), 1.0))) if kept.any() else 0.0

    def _stray(self, y: Array, z: Array, gone: Mask, rest: Array) -> int | None:
        apart = self._apart(gone, rest)
        free = self.free.reshape(-1, self.axes)
        size = np.linalg.norm(apart, axis=1)
        scaled = size / np.sqrt(np.sum(1 / free, axis=1))
        worst = int(np.argmax(scaled))
        moved = np.linalg.norm(z.reshape(-1, self.axes), axis=1).max(initial=0.0)
        if not size[worst] > PART * moved or not scaled[worst] > STRAY * max(1.0, NORMAL * float(np.median(scaled))):
            return None
        others = self._apart(*self._rest(self._left_out(y, worst))[1:])[self.near[worst]]
        beside = np.sort(np.linalg.norm(others, axis=1))
        # the second largest: two dots that were swapped are each other's neighbours
        return worst if size[worst] > BESIDE * beside[-2] else None

    def _left_out(self, y: Array, marker: int) -> Array:
        y = y.copy()
        y[marker * self.axes : (marker + 1) * self.axes] = np.nan
        return y

    def _apart(self, gone: Mask, rest: Array) -> Array:
        """Whitened distance (markers, axes) from what the others predict."""
        return np.where(self.judged & ~gone, rest / self.free, 0.0).reshape(-1, self.axes)

    def _rest(self, y: Array) -> tuple[Array, Mask, Array]:
        """Whitened motion of the markers, which are lost, and the residual."""
        z, lost = self.inverse.filled(y)
        count = len(self.free)
        gone = np.zeros(len(z), bool)
        gone[lost] = True
        rest = z[:count] - self.rows @ z.astype(self.rows.dtype, copy=False)
        return z[:count], gone[:count], np.where(gone[:count], 0.0, rest)
