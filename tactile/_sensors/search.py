"""Contacts of one frame, found by the evidence of its readings: discs that hold them, one after another.

Where is looked for first on a coarse lattice, then by steps in place and radius. A contact is added beside those that
are known, or one of them is split, as long as the readings ask for it, and left out where the others do without it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._arrays import Array
from .discs import GROWING, SMALLEST, STEP, Disc
from .evidence import SIZES, DiscModel, Fitted
from .looks import COARSE, FirstLook

LOOKS = 2  # places of the first look that are followed
MOST = 3  # contacts
UNSEEN = 1e-3  # of the variance of noise, which a direction has at most that is left out
WORTH = 8.0  # log evidence that a contact must bring: what its place, radius, size and ratios are worth by chance
QUICK = 4  # steps to sizes and ratios where discs are compared
NEARLY = 2.0  # of log evidence, that better sizes and ratios may bring
SETTLED = 2  # starts that are followed
HOPEFUL, BEHIND = 2.0, 40.0  # of log evidence: what one more contact must bring where it starts, a split may cost there
WAYS, APART, HALF = 4, 0.7, 3  # of splitting a disc: directions, radii to either side, steps of radius
WEIGHT = 0.02  # of the likeliest disc, below which one is left out of the average
MOVES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))  # of place and radius

NOTHING = np.empty((0, 3))  # sizes and ratios of no disc


@dataclass(eq=False)
class ContactSearch(FirstLook):
    """Finds the contacts of a frame."""

    def model(self, discs: tuple[Disc, ...], z: Array | None = None) -> DiscModel:
        """What readings tell of some discs, by the directions that readings z (m,) of such a size can show."""
        return DiscModel(self, discs, 0.0 if z is None else UNSEEN / max(float(z @ z), 1.0))

    # -- search -------------------------------------------------------------------------------------------------------
    def look(self, z: Array, known: Fitted) -> list[tuple[Disc, float]]:
        """Discs that explain most of readings (m,) beside known contacts, and log of their size; one of each place."""
        discs = [one.disc for one in self.looks]
        gain = self.gains(self.model(known.discs, z).left(z, known.at))[0]
        best, size = gain.max(axis=0), np.log(SIZES[np.argmax(gain, axis=0)])
        out: list[tuple[Disc, float]] = []
        wide = np.flatnonzero([d.radius == discs[-1].radius for d in discs])  # a step finds those that are smaller
        for k in wide[np.argsort(-best[wide])]:
            if best[k] < best[wide].max() - WORTH or len(out) == LOOKS:
                break
            if all(np.hypot(discs[k].x - d.x, discs[k].y - d.y) > 2 * COARSE for d, _ in out):
                out.append((discs[k], float(size[k])))
        return out

    def settled(self, z: Array, found: Fitted, seen: dict[tuple[Disc, ...], Fitted]) -> Fitted:
        """The likeliest discs near some, by steps in place and radius."""

        def at(discs: tuple[Disc, ...]) -> Fitted:
            if discs not in seen:
                seen[discs] = self.model(discs, z).fitted(z, found.at, found.evidence - NEARLY, QUICK)
            return seen[discs]

        for step in (2, 1):
            while True:
                before = found
                for j in range(len(found.discs)):
                    for x, y, radius in MOVES:
                        d = found.discs[j]
                        other = Disc(d.x + step * x, d.y + step * y, d.radius + step * radius)
                        if not self.allowed(other):
                            continue
                        tried = at((*found.discs[:j], other, *found.discs[j + 1 :]))
                        if tried.evidence > found.evidence:
                            found = tried
                if found is before:
                    break
        seen[found.discs] = found = self.model(found.discs, z).fitted(z, found.at)
        return found

    def contacts(self, z: Array) -> list[Fitted]:
        """Contacts of whitened readings (m,), and others of nearly their evidence; none where nothing is found."""
        known = self.model((), z).fitted(z, NOTHING)
        best: dict[tuple[Disc, ...], Fitted] = {}
        while len(known.discs) < MOST:
            seen: dict[tuple[Disc, ...], Fitted] = {}
            starts = [f for f in self._one_more(z, known) if f.evidence > known.evidence + HOPEFUL]
            starts += [f for f in self._split(z, known) if f.evidence > known.evidence - BEHIND]
            starts.sort(key=lambda f: -f.evidence)
            starts = starts[: SETTLED if len(known.discs) < 2 else 1]
            if not starts:
                break
            found = max((self.settled(z, f, seen) for f in starts), key=lambda f: f.evidence)
            more = found.evidence >= known.evidence + WORTH
            known = self._fewer(z, found, seen) if more else known
            best |= {d: f for d, f in seen.items() if d not in best or f.evidence > best[d].evidence}
            if not more:
                break
        if not known.discs:
            return []
        level = score(known) + np.log(WEIGHT)
        return [f for f in best.values() if score(f) > level]

    def _fewer(self, z: Array, found: Fitted, seen: dict[tuple[Disc, ...], Fitted]) -> Fitted:
        """Contacts, or all but one of them where that is likelier: the first may have been sought in a wrong place."""
        for j in range(len(found.discs) if len(found.discs) > 1 else 0):
            discs = (*found.discs[:j], *found.discs[j + 1 :])
            start = self.model(discs, z).fitted(z, np.delete(found.at, j, axis=0))
            tried = self.settled(z, start, seen) if start.evidence > found.evidence - BEHIND else start
            if score(tried) > score(found):
                return tried
        return found

    def _one_more(self, z: Array, known: Fitted) -> list[Fitted]:
        """Known contacts and one that explains most of what they leave."""
        return [self.model((*known.discs, disc), z).fitted(z, np.vstack([known.at, [size, 0.0, 0.0]]))
                for disc, size in self.look(z, known)[: 1 if known.discs else LOOKS]]  # fmt: skip

    def _split(self, z: Array, known: Fitted) -> list[Fitted]:
        """Known contacts with one of them split along several ways."""
        out = []
        for j, disc in enumerate(known.discs):
            radius = max(0, disc.radius - HALF)
            off = APART * SMALLEST * GROWING**disc.radius / STEP
            for turn in np.arange(WAYS) * np.pi / WAYS:
                x, y = (round(off * np.cos(turn)), round(off * np.sin(turn)))
                pair = Disc(disc.x + x, disc.y + y, radius), Disc(disc.x - x, disc.y - y, radius)
                if all(map(self.allowed, pair)):
                    discs = (*known.discs[:j], *known.discs[j + 1 :], *pair)
                    start = np.vstack([np.delete(known.at, j, axis=0), known.at[j], known.at[j]])
                    out.append(self.model(discs, z).fitted(z, start))
        return out


def score(found: Fitted) -> float:
    """Log evidence less what as many contacts are worth by chance."""
    return found.evidence - WORTH * len(found.discs)
