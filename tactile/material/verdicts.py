"""Two verdicts that do not follow from one another: is the material rate-independent, and is it linear?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .fits import CurveFit
from .pooled import pool

RATE, BEND = 0.05, 0.10  # relative changes of the modulus that still count as none
SPAN = 3.0  # fastest over slowest rate below which rate dependence is not tested
STRAIN = 0.02  # range below which linearity is not tested


@dataclass(frozen=True)
class Verdict:
    """One question about the material, answered by an effect and its interval, not by a p-value alone.

    Parameters
    ----------
    question : {"rate independence", "linearity"}
    verdict : {"shown", "violated", "undecided", "not tested"}
        "shown" where the whole 95 % interval of the effect lies within the tolerance, "violated" where it lies outside.
    effect, low, high : float or None
        Relative change of the modulus over the range tested, and its 95 % interval.
    tolerance : float
        Relative change that still counts as none.
    p : float or None
        Probability of such an effect where there is none.
    text : str
        Range tested, and why a verdict is missing.
    """

    question: str
    verdict: str
    effect: float | None
    low: float | None
    high: float | None
    tolerance: float
    p: float | None
    text: str

    @property
    def tested(self) -> bool:
        """The tests can answer the question at all."""
        return self.verdict != "not tested"

    def __str__(self) -> str:
        head = f"{self.question}: {self.verdict}"
        if self.effect is None:
            return f"{head} ({self.text})"
        return (
            f"{head} (modulus changes by {self.effect:+.1%}, 95 % interval {self.low:+.1%} to {self.high:+.1%}, "
            f"tolerance {self.tolerance:.0%}, p = {self.p:.2g}; {self.text})"
        )


def rate_independence(fits: Sequence[CurveFit], tolerance: float = RATE) -> Verdict:
    """Analysis of covariance: slope of log E over the logarithm of the strain rate, over all curves.

    The effect is the change of E from the slowest to the fastest test.
    """
    rates = np.log10([f.rate for f in fits])
    span = float(np.ptp(rates))
    if span < np.log10(SPAN):
        text = f"rates span a factor of {10**span:.3g}; a factor of {SPAN:g} or more tests it"
        return Verdict("rate independence", "not tested", None, None, None, tolerance, None, text)
    found = pool(
        np.log([f.E for f in fits]),
        [f.std / f.E for f in fits],
        np.stack([np.ones(len(rates)), (rates - rates.mean()) / span], axis=1),
    )
    change, half = float(found.value[1]), found.half_width(1)
    effect, low, high = (float(np.expm1(v)) for v in (change, change - half, change + half))
    text = f"{len(fits)} curves, rates over a factor of {10**span:.3g}"
    if found.dof == 0:
        text += ", scatter between runs not seen: repeat a speed"
    return Verdict(
        "rate independence", judged(low, high, tolerance), effect, low, high, tolerance, found.p_value(1), text
    )


def linearity(fits: Sequence[CurveFit], tolerance: float = BEND) -> Verdict:
    """Bend of the curves, pooled: secant modulus at the end of the range over the modulus at its start, minus one."""
    usable = [f for f in fits if f.strain >= STRAIN]
    if not usable:
        text = f"strain to {max(f.strain for f in fits):.2%} only; {STRAIN:.0%} or more tests it"
        return Verdict("linearity", "not tested", None, None, None, tolerance, None, text)
    found = pool([f.bend for f in usable], [f.bend_std for f in usable], np.ones((len(usable), 1)))
    effect, half = float(found.value[0]), found.half_width()
    reach = max(f.strain for f in usable)
    return Verdict(
        "linearity", judged(effect - half, effect + half, tolerance), effect, effect - half, effect + half, tolerance,
        found.p_value(0), f"{len(usable)} curves, strain to {reach:.1%}; beyond it nothing is shown",
    )  # fmt: skip


def judged(low: float, high: float, tolerance: float) -> str:
    """Verdict of an interval against a tolerance."""
    if -tolerance <= low and high <= tolerance:
        return "shown"
    return "violated" if low > tolerance or high < -tolerance else "undecided"
