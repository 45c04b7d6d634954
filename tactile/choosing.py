"""The lambda of a force map: UPRE at the noise of the markers, or GCV where the data show that there is more than that.

UPRE takes the noise of the unloaded camera for all there is. Where that level is far too low, or the errors of the mesh
are larger, its lambda is far too small; GCV does not ask for a level, and stands in wherever its lambda is larger.
With few markers, or axes of unequal noise, GCV in turn may smooth the load away. So its lambda does not count at the
end of the range, nor where its residual lies above a noise level that the data confirm; where they leave that open, the
discrepancy bounds it. Where both lie far below the discrepancy, they follow an error of the mesh: robust GCV decides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from loadid.inverse.rules import discrepancy_level
from structures.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from loadid.estimate import LoadEstimate
    from loadid.families.calibration import Calibration
    from loadid.families.static import StaticInversion
    from loadid.inverse.choice import Choice

RULES = ("upre", "gcv")
LAST = (*RULES, "robust_gcv", "discrepancy")  # the order in which they are asked where one cannot run
BELOW = 0.1  # of the lambda of the discrepancy, below which no rule that aims at the same noise can lie
END = 0.5  # relative lambda from which a rule has found nothing
SPARE = 0.3  # share of the data that a fit to the stated noise must leave free, if it is to confirm that level
CHANCE = 1e-2  # of a residual as far above the noise level as that of a lambda that does not count


def estimated(family: StaticInversion, found: Any) -> LoadEstimate:
    """Estimate of one frame or of several together; where no rule is set, by UPRE or GCV."""
    if family.choice is not None:
        return family.estimate(found)
    first, rule = _asked(family, found)
    assert first.choice is not None
    return first if rule == first.choice.rule else _with_rule(family, rule, lambda: family.estimate(found))


def calibrated(family: StaticInversion, records: Sequence[Any]) -> Calibration:
    """One lambda for all records; where no rule is set, by UPRE or GCV."""
    if family.choice is not None:
        return family.calibrate(records)
    rule = _asked(family, np.array(records))[1]
    family.calibration = _with_rule(family, rule, lambda: family.calibrate(records))
    return family.calibration


def chosen(choice: Choice, count: int) -> str:
    """Which rule to take of those that were asked.

    Parameters
    ----------
    choice : Choice
        Over `count` data of known noise.
    count : int
    """
    asked = {rule.rule: rule for rule in choice.rules if rule.lam is not None}
    lam = {name: float(rule.lam or 0.0) for name, rule in asked.items()}
    if RULES[0] not in lam:
        return RULES[1]
    best = RULES[1] if lam[RULES[0]] < lam.get(RULES[1], 0.0) < END else RULES[0]
    met = lam.get("discrepancy")
    if met is None or asked["discrepancy"].edge:  # the stated noise is nowhere met
        return best
    if lam[best] < BELOW * met:  # both follow what is left of an error of the mesh
        return LAST[-2] if met < lam.get(LAST[-2], 1.0) < END else LAST[-1]
    if best == RULES[0] or lam[best] <= met or lam[RULES[0]] < BELOW * met:
        return best
    return _smooth(choice, count, met, lam[best])


def _smooth(choice: Choice, count: int, met: float, lam: float) -> str:
    """Which rule to take where GCV at `lam` leaves more than the stated noise, which is left at `met`."""
    sweep, sigma = choice.sweep, choice.sigma
    if sweep is None or sweep.edf is None or sigma is None:
        return RULES[1]
    at = np.log(sweep.lam)
    if count - np.interp(np.log(met), at, sweep.edf) < SPARE * count:
        return LAST[-1]  # the level is neither confirmed nor refuted: no more than what it leaves
    residual = float(np.interp(np.log(lam), at, sweep.residual_norm))
    return RULES[0] if residual**2 > discrepancy_level(count, sigma, 1 - CHANCE) else RULES[1]


def _asked(family: StaticInversion, found: Any) -> tuple[LoadEstimate, str]:
    """Estimate by the first rule that can run on these readings, and the rule to take."""
    for rule in LAST:
        try:
            first: LoadEstimate = _with_rule(family, rule, lambda: family.estimate(found))
        except InputError:
            if rule == LAST[-1]:
                raise
            continue
        assert first.choice is not None
        assert first.response is not None
        return first, chosen(first.choice, first.response.size) if rule == RULES[0] else rule
    raise AssertionError("a rule or its refusal")


def _with_rule(family: StaticInversion, rule: str, act: Callable[[], Any]) -> Any:
    family.choice = rule
    try:
        return act()
    finally:
        family.choice = None
