"""Lambda of a long record: its windows say where to look, the whole record decides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import rules
from .choice import ORDERS, Choice, decide
from .noise_source import NoiseSource
from .path import RegularizationPath
from .sweeping import LARGEST, RuleResult, Sweep

REACH = 0.5  # decades to either side of what the windows' rules chose
WIDER = 1.0  # decades by which the search goes on beyond a wall
POINTS = 15  # in a decade
_MIDDLE = 1e-2  # relative lambda that tells the lower end of a range from the upper one
SHARED = ("discrepancy", "upre", "gcv", "robust_gcv", "predicted_error", "evidence")  # of one sweep, at no further cost


def confirm(
    path: RegularizationPath, guess: Choice, choice: str | float | None, *, sigma: float | None, source: NoiseSource
) -> Choice:
    """Choose on the whole record, near the lambdas that the rules chose on its windows (`guess`).

    Parameters are those of `choose`. The search goes on beyond every wall that a rule of the sweep ends at, but for
    those that ended at the lower end of the range on the windows: what it ends with are optima inside what was
    searched, or an end of the whole range, which then has been searched from end to end. Rules that cost more than the
    sweep keep what they said on the windows. A lambda that was given is kept.
    """
    if guess.rule == "given":
        return guess
    on_windows = {r.rule: r for r in guess.rules}
    first = choice if isinstance(choice, str) else ORDERS[sigma is not None][0]
    wanted = {first if on_windows[first].lam is not None else guess.rule}
    asking = [r for r in guess.rules if r.rule in SHARED and r.lam is not None]
    wanted |= {r.rule for r in asking if not r.edge or (r.lam or 0.0) > _MIDDLE}
    search = _Search.around(path, guess, sigma)
    while True:
        asked = {r: rules.run(r, search.sweep) if r in wanted | {*SHARED} else on_windows[r] for r in on_windows}
        wider = next((w for r in wanted if (w := search.beyond(asked[r])) is not None), None)
        if wider is None:
            # a long record leaves data enough for the predicted error, whose band holds more than that of UPRE
            found = decide(search.sweep, choice, asked, source, refine=False)
            wider = search.beyond(asked[found.rule]) if found.rule in SHARED else None
            if wider is None:
                return found
        search = wider


@dataclass(frozen=True)
class _Search:
    """A sweep over a part of the range from `low` to `high`."""

    sweep: Sweep
    low: float
    high: float

    @classmethod
    def around(cls, path: RegularizationPath, guess: Choice, sigma: float | None) -> _Search:
        """Over what the rules chose that have a say."""
        low, high = path.range
        high = LARGEST if path.null else high
        lams = [r.lam for r in guess.rules if r.rule in SHARED and r.lam is not None and not r.edge]
        near = np.clip([guess.lam, *lams], low, high)
        return cls._over(path, sigma, near.min() * 10**-REACH, near.max() * 10**REACH, low, high)

    @classmethod
    def _over(
        cls, path: RegularizationPath, sigma: float | None, first: float, last: float, low: float, high: float
    ) -> _Search:
        first, last = max(first, low), min(last, high)
        lam: NDArray[np.float64] = np.geomspace(first, last, max(int(POINTS * np.log10(last / first)), 3) + 1)
        return cls(Sweep(path, lam, path.at(lam), sigma, whole=(first, last) == (low, high)), low, high)

    def beyond(self, found: RuleResult) -> _Search | None:
        """The wider search after a rule that ended at a wall; None after an optimum, or where nothing is left."""
        first, last = float(self.sweep.lam[0]), float(self.sweep.lam[-1])
        if (found.lam is not None and not found.edge) or (first, last) == (self.low, self.high):
            return None
        downwards = first > self.low and (found.lam is None or found.lam <= first * (1 + 1e-9))
        upwards = last < self.high and (found.lam is None or found.lam >= last * (1 - 1e-9))
        if not (downwards or upwards):  # a wall of the range itself: the rest of it may hold something better
            downwards = upwards = True
        return self._over(
            self.sweep.path, self.sweep.sigma, first * 10 ** (-WIDER * downwards), last * 10 ** (WIDER * upwards),
            self.low, self.high,
        )  # fmt: skip
