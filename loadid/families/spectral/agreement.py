"""How far other rules agree with the regularisation of the lines: asked of all lines together."""

from __future__ import annotations

import numpy as np

from ...inverse import choice as choosing
from ...inverse import rules
from ...inverse.choice import Choice
from ...inverse.noise_source import NoiseSource
from ...inverse.odds import MEANING
from ...inverse.rules import RuleResult
from ...inverse.spectral.ruled import JoinedPath, joint_sweep
from .fitting import Fit, Rule

ASKED = ("discrepancy", "upre", "gcv", "robust_gcv", "l_curve", "quasi_optimality", "evidence")
VOICES = ("upre", "gcv", "robust_gcv", "evidence")
MODES = 4096  # of the lines, evenly chosen, that are asked
POINTS = 49


def judged(fit: Fit, rule: Rule, known: bool, source: NoiseSource) -> Choice:
    """The lambda in use beside what each rule says of all lines together.

    Notes
    -----
    The lines are weighted by the expected size of their loads, so that noise over load is the same number everywhere:
    the lambda of the joined lines is comparable with that of the neighbours' evidence.
    """
    step = max(1, -(-fit.path.c.size // MODES))
    joined = JoinedPath(fit.path, slice(None, None, step))
    sweep = joint_sweep(joined, 1.0 if known else None, POINTS)
    asked = {name: rules.run(name, sweep) for name in ASKED}
    used = fit.used / float(joined.scale)
    name = _name(rule)
    if name == "given":
        spread, verdict, odds = 0.0, "not asked", "lambda was given: no rule decided"
    else:
        spread, verdict = _agreement(asked, used)
        odds = f"{MEANING[verdict]}; how often that goes well was not measured for frequency lines"
    point = sweep.point
    return Choice(
        lam=used,
        scale=float(joined.scale),
        rule=name,
        rules=tuple(asked.values()),
        spread=spread,
        verdict=verdict,
        odds=odds,
        sigma=1.0 if known else None,
        source=source,
        edf=float(np.sum(fit.edf)),
        sweep=choosing.Sweep(
            sweep.lam,
            np.sqrt(point.residual2),
            np.sqrt(point.penalty2),
            point.edf,
            None if point.left is None else rules.gcv_function(joined, point),
        ),
    )


def _name(rule: Rule) -> str:
    if rule.pooled:
        return "evidence"
    return rule.choice if isinstance(rule.choice, str) else ("gcv" if rule.choice is None and rule.count is None else
                                                             "given")  # fmt: skip


def _agreement(asked: dict[str, RuleResult], used: float) -> tuple[float, str]:
    """Spread in decades between the lambda in use and the rules that have an optimum inside, and the verdict.

    The L-curve and quasi-optimality have no voice: over thousands of lines of equal strength the first has no sharp
    corner, and the second ends at the edge.
    """
    inside = (asked[name] for name in VOICES)
    lams = [r.lam for r in inside if r.lam is not None and not r.edge]
    if not lams or used <= 0:
        return float("inf"), choosing.GRADES[-1]
    spread = float(np.ptp(np.log10([used, *lams])))
    return spread, choosing.GRADES[int(np.searchsorted(choosing.LIMITS, spread, side="right"))]
