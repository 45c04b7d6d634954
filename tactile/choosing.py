"""The lambda of a force map: the larger of two rules, each of which fails where the other does not.

The discrepancy rule takes the noise of the unloaded camera for all there is, and fits the errors of the mesh where
those are larger: lambda comes out too small. Robust GCV does not ask for a noise level; where the load is finer than
the mesh it finds nothing that predicts, and goes to the end of its range: that is no choice.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from structures.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from loadid.estimate import LoadEstimate
    from loadid.families.calibration import Calibration
    from loadid.families.static import StaticInversion

RULES = ("discrepancy", "robust_gcv")
END = 0.5  # relative lambda from which a rule has found nothing


def estimated(family: StaticInversion, found: Any) -> LoadEstimate:
    """Estimate of one frame; where no rule is set, by the one that gives the larger lambda."""
    if family.choice is not None:
        return family.estimate(found)
    tried = _each(family, lambda: family.estimate(found))
    return tried[larger([_lam(e) for e in tried])]


def calibrated(family: StaticInversion, records: Sequence[Any]) -> Calibration:
    """One lambda for all records; where no rule is set, the larger of two."""
    if family.choice is not None:
        return family.calibrate(records)
    tried = _each(family, lambda: family.calibrate(records))
    family.calibration = tried[larger([c.lam for c in tried])]
    return family.calibration


def larger(lams: Sequence[float]) -> int:
    """Which lambda to take: the largest that is no end of a range, else the smallest."""
    inside = [i for i, lam in enumerate(lams) if lam < END]
    return max(inside, key=lams.__getitem__) if inside else int(min(range(len(lams)), key=lams.__getitem__))


def _each(family: StaticInversion, act: Callable[[], Any]) -> list[Any]:
    """What each rule gives; one that cannot run leaves it to the other."""
    out: list[Any] = []
    for rule in RULES:
        try:
            out.append(_with_rule(family, rule, act))
        except InputError:
            if not out and rule == RULES[-1]:
                raise
    return out


def _with_rule(family: StaticInversion, rule: str, act: Callable[[], Any]) -> Any:
    family.choice = rule
    try:
        return act()
    finally:
        family.choice = None


def _lam(estimate: LoadEstimate) -> float:
    assert estimate.choice is not None
    return float(estimate.choice.lam)
