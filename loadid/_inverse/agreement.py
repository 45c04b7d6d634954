"""How far the rules agree on lambda, and what speaks for or against white noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .path import RegularizationPath
from .sweep import ALARM, TESTABLE, RuleResult, plateau_test, residual_test, smallest_seen

GRADES = ("determined", "usable", "rules disagree", "not determined")
LIMITS = (0.5, 1.0, 2.0)  # decades between the grades
KINDS = (("gcv", "robust_gcv"), ("quasi_optimality",), ("discrepancy",))  # the first of each that ran has its voice
BENEATH = 0.03  # share of the smallest singular value below which the load no longer changes
WIDE = 0.2  # share of the data that a wide-band load spends
BELOW = 0.7  # decades by which a whiteness rule lies below quasi-optimality where it may follow correlated noise
CORNER = 1.5  # decades by which the corner of the L-curve lies below the lambda in use where it has a voice
CALM, FEW, MANY = 0.9, 0.25, 300  # a residual so far inside its limit, and so many data left: the noise is white


def whiteness_of(path: RegularizationPath, asked: Mapping[str, RuleResult], lam: float) -> dict[str, float]:
    """What speaks for and against white noise at a chosen lambda; only what could be tested.

    Returns
    -------
    dict
        ``below``: decades by which the chosen lambda lies below quasi-optimality. ``fine``, ``coarse``: statistic of
        the residual (`residual_test`) over its limit, at the chosen lambda and at the larger of the two.
        ``spent``, ``left``: degrees of freedom at the chosen lambda over the data, and data beyond them. ``chance``:
        of the data coefficients' plateau at the larger lambda under white noise; ``modes``: how many noise modes it
        has. ``followed`` (1 or 0): the chosen lambda follows what may be correlated noise.
    """
    quasi = asked["quasi_optimality"].lam
    larger = max(lam, quasi or 0.0)
    found: dict[str, float] = {}
    if quasi is not None and lam > 0 and not asked["quasi_optimality"].edge:
        found["below"] = float(np.log10(quasi / lam))
    fine = residual_test(path, lam)
    coarse = residual_test(path, larger) if larger > lam else fine
    if fine is not None and coarse is not None:
        found |= {"fine": fine.statistic / fine.threshold, "coarse": coarse.statistic / coarse.threshold}
        found |= {"spent": fine.spent, "left": (1 - fine.spent) * path.m}
    if (plateau := plateau_test(path, larger)) is not None:
        own = plateau if larger == lam else plateau_test(path, lam)
        chance = max(plateau.chance, 0.0 if own is None else own.chance)
        found |= {"modes": float(plateau.modes), "chance": chance}
    calm = found.get("fine", np.inf) < CALM and (found["spent"] < FEW or found["left"] >= MANY)
    found["followed"] = float(found.get("below", 0.0) > BELOW and found.get("coarse", 0.0) > 1 and not calm)
    return found


def is_correlated(evidence: Mapping[str, float]) -> bool:
    """Whether the tests say that the noise is correlated."""
    uneven = evidence.get("modes", 0.0) >= TESTABLE and evidence.get("chance", 1.0) < ALARM
    return bool(evidence.get("followed", 0.0)) or uneven


def agreement(
    asked: Mapping[str, RuleResult], used: float, path: RegularizationPath | None = None, correlated: bool = False
) -> tuple[float, str]:
    """Spread in decades between rules of different kinds and the lambda in use, and the verdict.

    Rules of one kind fail together, so each kind has one voice: GCV for those that ask for white noise,
    quasi-optimality for those that do not (none where it ends below), discrepancy where the noise level is known (none
    where the load spends much of the data: it then smooths more than any other).
    Where the load no longer changes, above the largest and far below the smallest singular value, no distance is
    counted. Correlated noise leaves no better verdict than ``rules disagree``. Where the noise level is not known,
    a corner of the L-curve far below the lambda in use has a voice too.
    """
    smallest = None if path is None else smallest_seen(path)
    low, high = (0.0, np.inf) if smallest is None else (BENEATH * float(smallest), 1.0)
    each = voices(asked, used, path)
    lams = [used, *(lam for lam in each if lam is not None)]
    if len(lams) == 1:
        return float("inf"), "not determined"
    spread = float(np.ptp(np.log10(np.clip(lams, max(low, np.finfo(float).tiny), high))))
    grade = int(np.searchsorted(LIMITS, spread, side="right"))
    if None in each[:2]:
        grade = max(grade, 1)
    return spread, GRADES[max(grade, 2) if correlated else grade]


def voices(asked: Mapping[str, RuleResult], used: float, path: RegularizationPath | None = None) -> list[float | None]:
    """Lambda of each kind of rule, None where it has no voice, as `agreement` counts them."""
    found = [next((asked[name].lam for name in kind if asked[name].lam is not None), None) for kind in KINDS]
    if path is not None and spends(path, used):
        found[2] = None
    if asked["quasi_optimality"].edge and (found[1] or 0.0) < 0.5:
        found[1] = None
    if _cornered(asked, used):
        found.append(asked["l_curve"].lam)
    return found


def _cornered(asked: Mapping[str, RuleResult], used: float) -> bool:
    """Whether, without a noise level, the L-curve has its corner far below the lambda in use.

    A wrong corner is more frequent than a wrong lambda, so that it counts from `CORNER` decades only.
    """
    corner, known = asked["l_curve"], asked["discrepancy"].lam is not None
    if known or corner.lam is None or corner.edge or used <= 0:
        return False
    return corner.lam < 10**-CORNER * used


def spends(path: RegularizationPath, lam: float) -> bool:
    """Whether the solution takes more than a fifth of the data as degrees of freedom."""
    edf = path.at(lam).edf
    return edf is not None and float(edf) > WIDE * path.m
