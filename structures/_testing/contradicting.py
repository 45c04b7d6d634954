"""Hits held against each other: one of another unit, range or polarity is left out, or none is believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._advice import Advice, Spelling
from .._flags import Evidence, Flag
from ..errors import InputError
from .reciprocity import FACTORS, NEAR

Real = NDArray[np.float64]

APART = 0.5  # relative difference of FRFs beyond which it is no scatter of hits, and no common nonlinearity
ALIKE = 0.5  # coherence of what should be equal, below which it tells no gain


@dataclass(frozen=True, eq=False)
class HitGains:
    """FRFs of hits over those of most of them.

    Parameters
    ----------
    each : array (hits, sensors)
        1 where a hit is as the others; NaN where the hits are not coherent enough to tell.
    """

    each: Real

    @property
    def off(self) -> Real:
        """Relative difference (hits, sensors) from the others, in whichever direction it is larger; 0 where unknown."""
        g = np.where(np.isnan(self.each), 1.0, self.each)
        return np.maximum(np.abs(g - 1), np.abs(1 / g - 1))

    @property
    def odd(self) -> NDArray[np.bool_]:
        """Hits (hits,) that are not as the others."""
        return np.asarray(np.any(self.off > APART, axis=1))

    @property
    def told(self) -> bool:
        """Whether most hits are alike, so that it is known which are not."""
        good = int(np.sum(~self.odd))
        return good >= 2 and 2 * good > len(self.odd)

    def said(self, hit: int, sensors: Sequence[str]) -> str:
        """What is wrong with a hit, in words."""
        own, wrong = self.each[hit], self.off[hit] > APART
        known = np.isfinite(own)
        level = float(np.median(own[known]))
        if np.all(wrong[known]) and np.all(np.abs(own[known] / level - 1) < APART):
            return f"the force {_factor(1 / level)} what the other hits say"
        worst = int(np.argmax(self.off[hit]))
        return f"{sensors[worst]} {_factor(float(own[worst]))} what the other hits say"


def _factor(gain: float) -> str:
    if abs(gain + 1) < APART:
        return "has the wrong sign: it is minus"
    near = [u for v in FACTORS for u in (v, 1 / v, -v, -1 / v) if abs(gain / u - 1) < NEAR]
    if near:
        return f"is {min(near, key=lambda u: abs(gain / u - 1)):.4g} times (a factor of units)"
    return f"is {gain:.2g} times"


def compared(force: Real, responses: Real) -> HitGains:
    """HitGains of hits from their forces (hits, samples) and responses (hits, samples, sensors), each FRF against one.

    Without a division by a force: where two hits have one FRF, ``F_1 Y_2 = F_2 Y_1``.
    """
    from scipy import fft

    n = fft.next_fast_len(force.shape[1], real=True)
    F = fft.rfft(force - np.median(force, axis=1, keepdims=True), n, axis=1)[:, 1:, None]
    Y = fft.rfft(responses - np.median(responses, axis=1, keepdims=True), n, axis=1)[:, 1:]
    ratio = np.ones((len(F), Y.shape[2]))
    for first in range(len(F)):
        ratio = np.stack([_ratio(F[i] * Y[first], F[first] * Y[i]) for i in range(len(F))])
        if 2 * np.sum(np.any(np.isfinite(ratio), axis=1)) > len(F):
            break
    size = np.exp(_middle(np.log(np.abs(ratio))))
    turned = np.where(_middle(np.sign(ratio)) < 0, -1.0, 1.0)
    return HitGains(ratio / (size * turned))


def _ratio(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> Real:
    """Real ratio (sensors,) of the second to the first (lines, sensors), errors in both; NaN where they are unlike."""
    aa, bb = np.sum(np.abs(a) ** 2, axis=0), np.sum(np.abs(b) ** 2, axis=0)
    ab = np.sum(a.conj() * b, axis=0)
    seen = np.abs(ab) ** 2 > ALIKE * aa * bb
    size = np.sqrt(np.where(seen, bb, 1.0) / np.where(seen, aa, 1.0))
    return np.where(seen, np.where(ab.real < 0, -size, size), np.nan)


def _middle(x: Real) -> Real:
    """Median (sensors,) over the hits that are known."""
    return np.array([np.median(column[np.isfinite(column)]) if np.any(np.isfinite(column)) else 0.0 for column in x.T])


def contradicting(
    force: Real, responses: Real, names: Sequence[str], sensors: Sequence[str], *, reject: bool
) -> tuple[dict[int, str], tuple[Flag, ...]]:
    """Which hits contradict the others, with the reason, and the flag W223 that says so.

    Raises
    ------
    InputError
        Code LID-E223, if hits are to be rejected and there is no majority that says which.
    """
    if len(force) < 2:
        return {}, ()
    gains = compared(force, responses)
    odd = np.flatnonzero(gains.odd)
    if not len(odd):
        return {}, ()
    if gains.told:
        reasons = {int(i): gains.said(int(i), sensors) for i in odd}
        said = "; ".join(f"{names[i]}: {reason}" for i, reason in reasons.items())
    else:
        reasons, said = {}, _extremes(gains, names, sensors)
    if reject and not gains.told:
        raise InputError(
            "the hits contradict each other, and no majority says which is right", where="from_hits", found=said,
            expected="hits of one structure, at one place, in one unit", code="LID-E223",
            hint=Advice("look at the units, ranges and polarities of each, and leave the wrong one out",
                        Spelling(", or pass reject=False to average over them", "")),
        )  # fmt: skip
    evidence = Evidence("relative difference of the FRFs of hits", float(gains.off.max()), APART)
    kept = "" if reject else ", and is in the average"
    return reasons if reject else {}, (Flag("W223", evidence, said + kept),)


def _extremes(gains: HitGains, names: Sequence[str], sensors: Sequence[str]) -> str:
    """The two hits that are furthest apart."""
    s = int(np.argmax(gains.off.max(axis=0)))
    own = np.where(np.isfinite(gains.each[:, s]), gains.each[:, s], 1.0)
    low, high = int(np.argmin(own)), int(np.argmax(own))
    return f"{sensors[s]} over the force of {names[high]} {_factor(float(own[high] / own[low]))} that of {names[low]}"
