"""How lambda was chosen: what every rule said, how far they agree, and what that agreement is worth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from . import rules
from .path import RegularizationPath
from .rules import RuleResult


@dataclass(frozen=True)
class Sweep:
    """The path over a grid of relative lambdas, for pictures: all arrays (points,)."""

    lam: NDArray[np.float64]
    residual_norm: NDArray[np.float64]
    penalty_norm: NDArray[np.float64]
    edf: NDArray[np.float64] | None = None
    gcv: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Choice:
    """The lambda that was used and what every rule said.

    Parameters
    ----------
    lam : float
        Relative lambda; ``lam * scale`` is the absolute one (whitened data).
    scale : float
        Scale of the problem, its largest generalised singular value.
    rule : str
        Rule that chose it, or ``"given"``.
    rules : tuple of RuleResult
        All rules that were asked.
    spread : float
        Decades between the smallest and the largest lambda of the rules that ran.
    verdict : str
        ``determined``, ``usable``, ``rules disagree`` or ``not determined``.
    odds : str
        What the verdict is worth, as measured on test problems.
    sigma : float or None
        Noise level of the whitened data (1 where the noise is known).
    sigma_source : str
        Where the noise level comes from.
    edf : float or None
        Effective degrees of freedom at `lam`.
    sweep : Sweep or None
        For the pictures.
    """

    lam: float
    scale: float
    rule: str
    rules: tuple[RuleResult, ...] = ()
    spread: float = 0.0
    verdict: str = "determined"
    odds: str = ""
    sigma: float | None = None
    sigma_source: str = "not known"
    edf: float | None = None
    sweep: Sweep | None = field(default=None, repr=False)


DEFAULT_RULES = (
    "discrepancy",
    "upre",
    "gcv",
    "robust_gcv",
    "predicted_error",
    "l_curve",
    "ncp",
    "quasi_optimality",
    "evidence",
)
LARGEST = 1e3  # relative lambda; at 1 the best-seen component of the load has lost half of its height
COMPARED = (
    ("gcv", "robust_gcv"),
    ("l_curve",),
    ("upre",),
)  # one voice for each kind of rule, the first that found an optimum


def choose(
    path: RegularizationPath,
    choice: str | float | None = None,
    *,
    sigma: float | None = None,
    source: str = "not known",
) -> Choice:
    """Choose lambda on a path, ask the other rules too, and grade their agreement.

    Parameters
    ----------
    path : RegularizationPath
    choice : str, float or None
        Rule, or relative lambda. None, noise level known: discrepancy; where its solution spends more than a fifth of
        the data as degrees of freedom, UPRE. UPRE more than a decade below the smallest predicted error of the
        load, and either of them more than a decade below the evidence, is in the flat tail of its function and gives
        way. None, noise level not known: the smallest predicted error of the load, one step from robust GCV
        (`rules.predicted_error`); robust GCV, GCV and the L-curve stand in where that finds nothing inside the sweep.
    sigma : float, optional
        Noise level of the whitened data.
    source : str
        Where it comes from.

    Raises
    ------
    InputError
        Unknown rule, a lambda that is not a finite number >= 0, or a rule that refuses.
    """
    sweep = rules.Sweep.over(path, sigma)
    asked = {name: rules.run(name, sweep) for name in DEFAULT_RULES}
    if isinstance(choice, str) and choice not in asked:
        asked[choice] = rules.run(choice, sweep)
    lam, rule = _pick(path, choice, asked, sigma)
    spread, verdict = agreement(asked, lam if rule == "predicted_error" else None)
    point = path.at(lam)
    return Choice(
        lam=lam,
        scale=float(path.scale),
        rule=rule,
        rules=tuple(asked.values()),
        spread=spread,
        verdict=verdict,
        odds=MEANING[verdict] + ("; lambda itself was given" if rule == "given" else ""),
        sigma=sigma,
        sigma_source=source,
        edf=None if point.edf is None else float(point.edf),
        sweep=Sweep(
            sweep.lam,
            np.sqrt(sweep.point.residual2),
            np.sqrt(sweep.point.penalty2),
            sweep.point.edf,
            None if sweep.point.left is None else rules.gcv_function(path, sweep.point),
        ),
    )


MEANING = {
    "determined": "different kinds of rule lie within half a decade",
    "usable": "different kinds of rule lie within one decade, or only one kind found an optimum",
    "rules disagree": "different kinds of rule lie over one decade apart: correlated noise or model error is likely",
    "not determined": "different kinds of rule lie more than two decades apart, or none found an optimum",
}


def agreement(asked: dict[str, RuleResult], used: float | None = None) -> tuple[float, str]:
    """Spread in decades between the kinds of rule that found an optimum inside the sweep, and the verdict.

    Rules of one kind (GCV and its variants) fail together, so each kind has one voice.
    """
    heard = []
    for kind in COMPARED:
        inside = [asked[name].lam for name in kind if asked[name].lam is not None and not asked[name].edge]
        heard += inside[:1]
    if not heard:
        return float("inf"), "not determined"
    alone = len(heard) == 1
    heard += [used] if used else []  # a lambda far from what the rules say is not determined by them
    spread = float(np.ptp(np.log10(np.array(heard, float))))
    if alone and spread <= 1:
        return spread, "usable"
    names = ("determined", "usable", "rules disagree", "not determined")
    return spread, names[int(np.searchsorted([0.5, 1.0, 2.0], spread, side="right"))]


def _pick(
    path: RegularizationPath, choice: str | float | None, asked: dict[str, RuleResult], sigma: float | None
) -> tuple[float, str]:
    if isinstance(choice, str):
        return _given(asked[choice]), choice
    if choice is not None:
        if isinstance(choice, bool) or not (np.isfinite(choice) and 0 <= choice <= LARGEST):
            raise InputError(
                "no relative lambda",
                where="choice",
                found=choice,
                expected=f"a number from 0 to {LARGEST:g}, or the name of a rule",
            )
        return float(choice), "given"
    order = ["predicted_error", "robust_gcv", "gcv", "l_curve"] if sigma is None else ["discrepancy", "upre", "gcv"]
    first = asked[order[0]]
    if sigma is not None and first.lam is not None:
        edf = path.at(first.lam).edf
        if first.edge or (edf is not None and edf > 0.2 * path.m):
            order = ["upre", "predicted_error", "gcv"]
            if _far_below(asked["upre"], asked["predicted_error"], 1.0):
                order = order[1:]
            order = [name for name in order if not _far_below(asked[name], asked["evidence"], 1.0)] + ["evidence"]
    inside = [asked[name] for name in order if asked[name].lam is not None and not asked[name].edge]
    running = inside or [r for r in asked.values() if r.lam is not None]
    if not running:
        raise InputError(
            "no rule can run on this path",
            where="choice",
            found="; ".join(r.note for r in asked.values()),
            expected="a relative lambda",
            hint="pass choice=<relative lambda>",
        )
    return _given(running[0]), running[0].rule


def residual_level(path: RegularizationPath, lam: float) -> float | None:
    """Noise level of the whitened data that the residual shows, sqrt(|r|^2 / (m - edf)).

    None where the fit leaves less than a fifth of the data: what is left then tells of the prior, not of the noise.
    """
    point = path.at(lam)
    if point.left is None or float(point.left) < 0.2 * path.m:
        return None
    return float(np.sqrt(point.residual2 / point.left))


def _far_below(low: RuleResult, high: RuleResult, decades: float) -> bool:
    """Whether one rule lies this far below another: the flat tail of its function won by chance."""
    return low.lam is not None and high.lam is not None and not high.edge and low.lam < 10**-decades * high.lam


def _given(result: RuleResult) -> float:
    if result.lam is None:
        raise InputError(
            f"the rule {result.rule} cannot run here",
            where="choice",
            found=result.note,
            expected="another rule or a relative lambda",
        )
    return result.lam
