"""The lambda of a force map: the larger of two rules, each of which fails where the other does not.

The discrepancy rule takes the noise of the unloaded camera for all there is, and fits the errors of the mesh where
those are larger; robust GCV does not ask for a noise level, and takes noise that is correlated for motion. Both fail
towards a lambda that is too small.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from structures.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from loadid.estimate import LoadEstimate
    from loadid.families.calibration import Calibration
    from loadid.families.static import StaticInversion

RULES = ("discrepancy", "robust_gcv")


def estimated(family: StaticInversion, found: Any) -> LoadEstimate:
    """Estimate of one frame; where no rule is set, by the one that gives the larger lambda."""
    if family.choice is not None:
        return family.estimate(found)
    best: LoadEstimate | None = None
    for rule in RULES:
        try:
            new = _with_rule(family, rule, lambda: family.estimate(found))
        except InputError:  # a rule that cannot run here leaves it to the other
            if best is None and rule == RULES[-1]:
                raise
            continue
        if best is None or _lam(new) > _lam(best):
            best = new
    assert best is not None
    return best


def calibrated(family: StaticInversion, records: Sequence[Any]) -> Calibration:
    """One lambda for all records; where no rule is set, the larger of two."""
    if family.choice is not None:
        return family.calibrate(records)
    tried: list[Calibration] = []
    for rule in RULES:
        try:
            tried.append(_with_rule(family, rule, lambda: family.calibrate(records)))
        except InputError:
            if not tried and rule == RULES[-1]:
                raise
    family.calibration = max(tried, key=lambda c: c.lam)
    return family.calibration


def _with_rule(family: StaticInversion, rule: str, act: Any) -> Any:
    family.choice = rule
    try:
        return act()
    finally:
        family.choice = None


def _lam(estimate: LoadEstimate) -> float:
    assert estimate.choice is not None
    return float(estimate.choice.lam)
