"""Rules that choose lambda, each from a path and nothing else; and what a verdict is worth, as measured.

A rule is a function ``Sweep -> RuleResult``, written on scalars whose last axis is lambda: it serves one problem and a
stack of lines alike, or refuses by name (`Refusal`) where the path does not give what it needs. `register_rule` adds
one of the user, as do entry points of the group ``loadid.rules``; a function itself is accepted wherever a name is.

Seven discrete ill-posed problems, n = 32, 64, 200, noise 1e-2, 1e-3, 1e-4, three penalties, 50 draws of white noise and
100 of correlated noise (AR(1) with 0.9, and interpolated from every second sample).

The limits of the rules and verdicts were set on four or five draws of the same problems, so that other problems may do
worse.

Formulas: Hansen, Rank-Deficient and Discrete Ill-Posed Problems, SIAM 1998 (discrepancy, L-curve, GCV,
quasi-optimality); Lukas, Inverse Problems 22 (2006) 1883 (robust GCV); Mallows, Technometrics 15 (1973) 661 (UPRE);
Rust & O'Leary, Inverse Problems 24 (2008) 034005 (NCP); MacKay, Neural Computation 4 (1992) 415 (evidence).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError, shown

from . import Array
from .path import PathPoint
from .sweep import (
    NULL_SPACE,
    Refusal,
    RuleResult,
    Sweep,
    among_modes,
    crossing,
    dips,
    log,
    minimum,
    ncp_statistic,
    need,
    need_sigma,
    search,
)

__all__ = [
    "NULL_SPACE",
    "RULES",
    "Refusal",
    "Rule",
    "RuleResult",
    "Sweep",
    "lines",
    "name_of",
    "ncp_statistic",
    "need",
    "register_rule",
    "run",
]

Rule = Callable[[Sweep], RuleResult]
GROUP = "loadid.rules"  # entry points by which other distributions add rules

MEANING = {
    "determined": "different kinds of rule lie within half a decade",
    "usable": "different kinds of rule lie within one decade, or only one kind found an optimum",
    "rules disagree": "different kinds of rule lie over one decade apart, or the noise is correlated",
    "not determined": "different kinds of rule lie over two decades apart, or none found an optimum",
}


@dataclass(frozen=True)
class Odds:
    """How the default lambda did in one grade: load error over the smallest error of all lambdas.

    Parameters
    ----------
    share : float
        Share of the cases with this verdict.
    median, ninety : float
        Median and 90 % quantile of the ratio.
    lost : float
        Share of the cases with a ratio above 3.
    """

    share: float
    median: float
    ninety: float
    lost: float


# (verdict, noise level known): white noise, correlated noise
MEASURED: dict[tuple[str, bool], tuple[Odds, Odds]] = {
    ("determined", False): (Odds(0.433, 1.07, 1.6, 0.010), Odds(0.047, 1.04, 1.48, 0.012)),
    ("usable", False): (Odds(0.175, 1.09, 1.9, 0.022), Odds(0.041, 1.11, 2.35, 0.059)),
    ("rules disagree", False): (Odds(0.154, 1.10, 2.62, 0.090), Odds(0.088, 1.20, 3.98, 0.142)),
    ("not determined", False): (Odds(0.239, 1.04, 1.85, 0.043), Odds(0.824, 1.19, 4.96, 0.158)),
    ("determined", True): (Odds(0.264, 1.04, 1.37, 0.002), Odds(0.027, 1.04, 1.23, 0.000)),
    ("usable", True): (Odds(0.348, 1.09, 1.86, 0.019), Odds(0.052, 1.08, 1.5, 0.005)),
    ("rules disagree", True): (Odds(0.197, 1.16, 2.54, 0.080), Odds(0.092, 1.12, 2.16, 0.074)),
    ("not determined", True): (Odds(0.191, 1.12, 2.18, 0.056), Odds(0.829, 1.10, 2.1, 0.049)),
}


def in_words(verdict: str, known: bool) -> str:
    """Meaning and measured odds of a verdict."""
    white, smooth = MEASURED[verdict, known]
    return f"{MEANING[verdict]}; measured: with white noise {_words(white)}; with correlated noise {_words(smooth)}"


def _words(o: Odds) -> str:
    return (
        f"({o.share:.0%} of the cases) error {o.median:.2f}x the best possible, "
        f"90 % within {o.ninety:.3g}x, {o.lost:.0%} above 3x"
    )


SAFE = 0.99  # margin of a pilot: too smooth a one costs little, one that follows the noise much
CHANCE = 1e-3  # a residual that is smaller than this share of all noise would leave is not believed to be chance
CLOSE = 0.93  # a step of a pilot that is nearer to one than this has arrived
SLOWEST = 0.6  # shrinkage of such steps beyond which the limit is not extrapolated further
EDGE = 3  # points of the sweep that count as its end
SHORT_NCP = 4000  # data up to which every point of the sweep is asked
LONGEST_NCP = 300_000  # data; beyond, one transform for each lambda costs more than all other rules together
ROUNDING = 1e-10  # residual over the largest below which it is rounding


# -- functions that are minimised ------------------------------------------------------------------------------------
class Counted(Protocol):
    """Anything with a number of data."""

    @property
    def m(self) -> int:
        """Number of data."""
        ...


def gcv_function(path: Counted, p: PathPoint) -> Array:
    """G = m |r|^2 / (m - edf)^2."""
    left = need(p, "left", "gcv")
    return np.asarray(path.m * p.residual2 / np.where(left > 0, left, np.nan) ** 2)


def robust_gcv_function(path: Counted, p: PathPoint) -> Array:
    """[gamma + (1 - gamma) tr A^2 / m] G with gamma = 0.1, Lukas (2006)."""
    return (0.1 + 0.9 * need(p, "edf2", "robust_gcv") / path.m) * gcv_function(path, p)


def modified_gcv_function(path: Counted, p: PathPoint) -> Array:
    """G with 1.4 edf in place of edf, only where m > 1.4 edf."""
    left = path.m - 1.4 * need(p, "edf", "modified_gcv")
    return np.asarray(path.m * p.residual2 / np.where(left > 0, left, np.nan) ** 2)


def gcv(sweep: Sweep) -> RuleResult:
    """Generalised cross-validation."""
    return minimum("gcv", sweep, lambda p: gcv_function(sweep.path, p))


def robust_gcv(sweep: Sweep) -> RuleResult:
    """Robust generalised cross-validation."""
    return minimum("robust_gcv", sweep, lambda p: robust_gcv_function(sweep.path, p))


def modified_gcv(sweep: Sweep) -> RuleResult:
    """Modified generalised cross-validation: each degree of freedom counts 1.4 times."""
    return minimum("modified_gcv", sweep, lambda p: modified_gcv_function(sweep.path, p))


def upre(sweep: Sweep) -> RuleResult:
    """Unbiased predictive risk estimate |r|^2 + 2 sigma^2 edf."""
    sigma = need_sigma(sweep, "upre")
    return minimum("upre", sweep, lambda p: p.residual2 + 2 * sigma**2 * need(p, "edf", "upre"))


def quasi_optimality(sweep: Sweep) -> RuleResult:
    """Smallest change of the load with ln lambda, among the generalised singular values.

    Below and above them the load no longer changes whatever the data, so that the smallest change there says nothing.
    """
    need(sweep.point, "sensitivity", "quasi_optimality")
    return minimum(
        "quasi_optimality", among_modes(sweep, "quasi_optimality"), lambda p: need(p, "sensitivity", "quasi_optimality")
    )


def evidence(sweep: Sweep) -> RuleResult:
    """Largest marginal likelihood; with the noise level where it is known, else free of it."""
    path, sigma = sweep.path, sweep.sigma

    def negative(p: PathPoint) -> Array:
        J, ratio = need(p, "objective", "evidence"), need(p, "log_ratio", "evidence")
        return ratio + (J / sigma**2 if sigma is not None else (path.m - path.null) * log(J))

    return minimum("evidence", sweep, negative)


def predicted_error(sweep: Sweep) -> RuleResult:
    """Smallest predicted error of the load itself: parametric-bootstrap steps from a pilot, to their fixed point.

    The other rules aim at the response; the load wants more regularisation where its fine detail costs much noise. The
    pilot is the discrepancy solution where the noise level is known, which needs no white noise, else the minimum of
    robust GCV or GCV that is no stroke of chance. A pilot that is too smooth hides what a smaller lambda would bring
    back, so that its answer is the next pilot (`_settled`). Faraway & Jhun, J. Am. Stat. Assoc. 85 (1990) 1119, for the
    bootstrap choice of a smoothing parameter.
    """
    path, sigma = sweep.path, sweep.sigma
    if path.stacked:
        return _predicted_once(sweep)
    if path.predicted_error(sweep.lam[-1:], float(sweep.lam[-1]), 1.0) is None:
        raise Refusal("predicted_error is not defined on this path")
    start = None
    if sigma is not None:
        met = discrepancy(sweep, margin=SAFE)
        if met.free:
            return replace(met, rule="predicted_error")
        start = met.lam if not met.edge else None
    if start is None:
        k = _pilot(sweep)
        if k == 0:
            return RuleResult("predicted_error", float(sweep.lam[0]), note="the data ask for no regularisation")
        if sweep.ends_free and k == len(sweep.lam) - 1:
            return RuleResult.null_space("predicted_error", float(sweep.lam[k]))
        start = float(sweep.lam[k])
        sigma = sigma or float(np.sqrt(sweep.point.residual2[k] / need(sweep.point, "left", "predicted_error")[k]))
    assert sigma is not None
    level = sigma
    return _settled(lambda pilot: _predicted(sweep, pilot, level), start, sweep.whole)


def _predicted(sweep: Sweep, pilot: Any, sigma: Any) -> RuleResult:
    """Smallest error of the load expected if it were the estimate at `pilot`; of a stack both are (lines, 1)."""

    def error(lam: Array) -> Array:
        value = sweep.path.predicted_error(lam, pilot, sigma)
        if value is None:
            raise Refusal("predicted_error is not defined on this path")
        return value

    return search("predicted_error", sweep, error)


def _predicted_once(sweep: Sweep) -> RuleResult:
    """Of every line of a stack: one step from the minimum of robust GCV, which few data have to themselves."""
    pilot = robust_gcv(sweep).lines
    assert pilot is not None
    if sweep.sigma is not None:
        return _predicted(sweep, pilot[:, None], np.asarray(sweep.sigma)[..., None])
    rows, k = np.arange(len(pilot)), np.clip(np.searchsorted(sweep.lam, pilot), 0, len(sweep.lam) - 1)
    left = need(sweep.point, "left", "predicted_error")[rows, k]
    sigma = np.sqrt(sweep.point.residual2[rows, k] / np.maximum(left, 1e-12))
    return _predicted(sweep, pilot[:, None], sigma[:, None])


def _settled(best: Callable[[float], RuleResult], pilot: float, whole: bool) -> RuleResult:
    """Fixed point of steps from one pilot to the next, which shrink by about the same factor: two, and Aitken's limit.

    Only towards smaller lambdas: from a pilot that follows the noise the first step leads back, and it is enough. A
    step to the wall of the `whole` range is none; one to the wall of a part is the answer that asks for a wider part.
    """
    first = best(pilot)
    if first.edge or first.lam is None or first.lam > CLOSE * pilot:
        return first
    second = best(first.lam)
    if second.edge or second.lam is None or second.lam > CLOSE * first.lam:
        return first if second.edge and whole else second
    one, two = np.log(first.lam / pilot), np.log(second.lam / first.lam)
    shrink = min(two / one, SLOWEST)
    third = best(float(pilot * np.exp(one / (1 - shrink))))
    return second if third.edge and whole else third


def _pilot(sweep: Sweep) -> int:
    """Point of the sweep at a minimum of robust GCV or GCV that is no stroke of chance.

    The residual of a fit that leaves few degrees of freedom may be small by chance, and its minimum then wins. So the
    search starts at the largest lambda (the null-space solution, where the penalty has one), and moves to a minimum at
    a smaller one only where the noise level that it shows, |r|^2 / tr (I - A)^2, is below what `CHANCE` makes of the
    level before (chi-square with the freedom of Satterthwaite, (tr (I - A)^2)^2 / tr (I - A)^4).
    """
    from scipy.special import gammaincinv

    path, p = sweep.path, sweep.point
    rest2, rest4 = (np.maximum(need(p, name, "predicted_error"), np.finfo(float).tiny) for name in ("rest2", "rest4"))
    level, freedom = p.residual2 / rest2, np.maximum(rest2**2 / rest4, 1.0)
    found = dips(robust_gcv_function(path, p)) | dips(gcv_function(path, p))
    found[-1] = sweep.ends_free
    minima = np.flatnonzero(found)[::-1]
    if len(minima) == 0:
        raise Refusal("predicted_error needs a minimum of robust GCV or GCV inside the sweep")
    k = int(minima[0])
    for j in minima[1:]:
        if level[j] < level[k] * 2 * gammaincinv(freedom[j] / 2, CHANCE) / freedom[j]:
            k = int(j)
    return k


# -- rules of another form -------------------------------------------------------------------------------------------
def discrepancy_level(m: float, sigma: float, margin: float | None = 0.95, reals: int = 1) -> float:
    """Squared residual that noise of this level stays below in `margin` of all cases (None: that of the mean case).

    Every one of the `m` data has so many `reals`: 2 where it is complex.
    """
    from scipy.special import gammaincinv

    if margin is None:
        return sigma**2 * m
    return float(sigma**2 * (2 / reals) * gammaincinv(reals * m / 2, margin))


def discrepancy(sweep: Sweep, factor: float = 1.0, margin: float | None = None) -> RuleResult:
    """Residual equals the noise, with the chi-square margin of a finite record (`factor` scales the noise level)."""
    path, sigma = sweep.path, need_sigma(sweep, "discrepancy") * factor
    level = discrepancy_level(path.m, sigma, path.margin if margin is None else margin, path.reals)
    return crossing("discrepancy", sweep, lambda p: p.residual2, level)


def dof_discrepancy(sweep: Sweep) -> RuleResult:
    """|r|^2 = sigma^2 (m - edf), its largest crossing."""
    sigma = need_sigma(sweep, "dof_discrepancy")
    return crossing(
        "dof_discrepancy", sweep, lambda p: p.residual2, lambda p: sigma**2 * need(p, "left", "dof_discrepancy")
    )


def sensitivity(sweep: Sweep, factors: tuple[float, ...] = (0.5, 1.0, 2.0)) -> tuple[float | None, ...]:
    """Lambda of the discrepancy rule at multiples of the noise level, read off the sweep; None where it ends first.

    Raises
    ------
    Refusal
        Without a noise level.
    """
    path = sweep.path
    level = discrepancy_level(path.m, need_sigma(sweep, "discrepancy"), path.margin, path.reals)
    rest = np.maximum.accumulate(sweep.point.residual2)
    found: list[float | None] = []
    for factor in factors:
        aim = factor**2 * level
        k = int(np.searchsorted(rest, aim))
        if k in (0, len(rest)):
            found.append(None)
            continue
        span = log(rest[k - 1 : k + 1])
        share = (np.log(aim) - span[0]) / max(float(np.diff(span)[0]), 1e-300)
        found.append(float(sweep.lam[k - 1] * (sweep.lam[k] / sweep.lam[k - 1]) ** min(share, 1.0)))
    return tuple(found)


def curvature(
    lam: Array, residual2: Array, penalty2: Array, bend: Array | None = None, scale: Array | float = 1.0
) -> Array:
    """Signed curvature of the L-curve (ln |r|, ln |L g|), positive at a corner; same shape as `lam`.

    Closed form where ``bend`` = d penalty2 / d ln lambda is given (Hansen 1998, section 7.5, with lambda^4 eta^2 in
    the denominator), else by differences on the grid. `scale` makes `lam` absolute.
    """
    if bend is None:
        t, x, y = np.log(lam), 0.5 * log(residual2), 0.5 * log(penalty2)
        dx, dy = np.gradient(x, t), np.gradient(y, t)
        ddx, ddy = np.gradient(dx, t), np.gradient(dy, t)
        with np.errstate(divide="ignore", invalid="ignore"):
            kappa = (dx * ddy - ddx * dy) / (dx**2 + dy**2) ** 1.5
        return np.nan_to_num(kappa, nan=0.0, posinf=0.0, neginf=0.0)
    # with a = lambda^2 eta / rho and b = d ln eta / d ln lambda, both without units
    with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
        a = (lam * scale) ** 2 * penalty2 / residual2
        b = bend / penalty2
        kappa = -2 * a * (b + 2 + a * b) / (b * (a**2 + 1) ** 1.5)
    return np.nan_to_num(kappa, nan=0.0, posinf=0.0, neginf=0.0)


def l_curve(sweep: Sweep) -> RuleResult:
    """Corner of the L-curve: the largest positive curvature away from the ends of the sweep."""
    if not sweep.path.smooth:
        raise Refusal("l_curve needs a path that is smooth in lambda")
    sweep = among_modes(sweep, "l_curve", 0.03)  # far below all modes the curve is flat, and its bends are rounding
    p = sweep.point
    kappa = curvature(sweep.lam, p.residual2, p.penalty2, p.bend, np.asarray(sweep.path.scale)[..., None])
    if sweep.path.stacked:
        kappa[..., :EDGE] = kappa[..., -EDGE:] = -np.inf
        return search("l_curve", sweep, lambda lam: -kappa)
    inner = kappa[EDGE:-EDGE]
    if len(inner) == 0 or not np.any(inner > 0):
        raise Refusal("the L-curve has no corner: its curvature is nowhere positive")
    k = int(np.argmax(inner)) + EDGE
    edge = k < 2 * EDGE or k >= len(kappa) - 2 * EDGE
    return RuleResult("l_curve", float(sweep.lam[k]), edge, f"curvature {kappa[k]:.3g}")


def ncp(sweep: Sweep) -> RuleResult:
    """Residual closest to white noise by its normalised cumulative periodogram."""
    if sweep.path.m > LONGEST_NCP:
        raise Refusal(f"ncp is left out beyond {LONGEST_NCP} data")
    count = len(sweep.lam) if sweep.path.m <= SHORT_NCP else 41
    picks = np.unique(np.linspace(0, len(sweep.lam) - 1, count).round().astype(int))
    rests = sweep.path.residuals(sweep.lam[picks])
    if rests is None:
        raise Refusal("ncp needs the residual of a record, which this path does not define")
    # several small residuals in one transform, a long one alone
    held = iter(rest.reshape(len(rest), -1) for rest in rests)
    together = max(1, SHORT_NCP * len(picks) // sweep.path.m)
    told = []
    while some := list(islice(held, together)):
        stack = np.stack(some, axis=-1)
        told.append((ncp_statistic(stack)[0], np.linalg.norm(stack, axis=(0, 1))))
    value, size = np.concatenate(told, axis=1)
    k = int(np.argmin(np.where(size >= ROUNDING * size.max(), value, np.inf)))  # rounding is as white as noise
    return RuleResult("ncp", float(sweep.lam[picks[k]]), k in (0, len(picks) - 1))


def information(rest: ArrayLike, count: ArrayLike, log_supports: ArrayLike, m: int, sigma: float | None) -> Array:
    """Extended Bayesian information criterion of a support (Chen & Chen, Biometrika 95 (2008) 759, gamma = 1).

    ``|r|^2 / sigma^2``, or ``m ln(|r|^2 / m)`` where sigma is not known, plus ``k ln m + 2 ln C(n, k)``, of the least
    squares on the k atoms of a support, `rest` their squared residual.
    """
    rest = np.asarray(rest, float)
    misfit = m * np.log(np.maximum(rest, 1e-300) / m) if sigma is None else rest / sigma**2
    return np.asarray(misfit + np.asarray(count) * np.log(m) + 2 * np.asarray(log_supports))


def criterion(sweep: Sweep) -> Array:
    """Extended Bayesian information criterion over a sweep."""
    rest, count, supports = (need(sweep.point, name, "ebic") for name in ("fitted2", "edf", "log_supports"))
    return information(rest, count, supports, sweep.path.m, sweep.sigma)


def best_support(sweep: Sweep) -> int:
    """Point of the sweep with the best support, at the largest lambda that has it."""
    value = criterion(sweep)
    return len(value) - 1 - int(np.argmin(value[::-1]))


def ebic(sweep: Sweep) -> RuleResult:
    """Extended Bayesian information criterion: the largest lambda of the best support."""
    k = best_support(sweep)
    return RuleResult("ebic", float(sweep.lam[k]), k == 0)


RULES: dict[str, Rule] = {
    rule.__name__: rule
    for rule in (
        discrepancy,
        dof_discrepancy,
        upre,
        gcv,
        robust_gcv,
        modified_gcv,
        predicted_error,
        l_curve,
        quasi_optimality,
        ncp,
        evidence,
        ebic,
    )
}


# rules that read off the residual alone what is noise, as if it were white; `register_rule` adds those that say so
FOR_WHITE_NOISE = {"gcv", "robust_gcv", "modified_gcv", "predicted_error"}


def register_rule(function: Rule, name: str | None = None, *, for_white_noise: bool = False) -> Rule:
    """Add a rule of your own to those that every family takes as ``choice=``.

    Parameters
    ----------
    function : callable
        ``Sweep -> RuleResult``; `loadid._inverse.sweep.minimum` and `crossing` make one of a function of the path's
        scalars, which then serves frequency lines too.
    name : str, optional
        Its name; default that of the function.
    for_white_noise : bool
        It takes the noise to be white, as GCV does: its lambda is flagged where GCV has no minimum (LID-W402) and where
        too few data are left to test the noise (LID-W405).

    Returns
    -------
    callable
        The function itself, so that this decorates.

    Raises
    ------
    InputError
        No function, or a name that another rule has.
    """
    if not callable(function):
        raise InputError("no rule", where="register_rule", found=shown(function), expected="a function of a Sweep")
    name = function.__name__ if name is None else name
    if not (isinstance(name, str) and name) or RULES.get(name, function) is not function:
        raise InputError("a rule needs a name of its own", where="register_rule", found=shown(name),
                         expected=f"none of {', '.join(RULES)}")  # fmt: skip
    RULES[name] = function
    if for_white_noise:
        FOR_WHITE_NOISE.add(name)
    return function


def known(name: str) -> bool:
    """Whether there is a rule of this name: here, registered, or an entry point of another distribution."""
    if name in RULES:
        return True
    from importlib.metadata import entry_points

    found = next(iter(entry_points(group=GROUP, name=name)), None)
    if found is not None:
        register_rule(found.load(), name)
    return found is not None


def name_of(rule: str | Rule) -> str:
    """Name of a rule, which results and provenance hold: of a function of the user its module and qualified name.

    Raises
    ------
    InputError
        If there is no such rule.
    """
    if callable(rule):
        return next((name for name, own in RULES.items() if own is rule), f"{rule.__module__}.{rule.__qualname__}")
    if not known(rule):
        raise InputError("unknown rule", where="choice", found=repr(rule),
                         expected=f"one of {', '.join(RULES)}, or a relative lambda")  # fmt: skip
    return rule


def run(rule: str | Rule, sweep: Sweep) -> RuleResult:
    """Ask one rule; a refusal comes back as a result without a lambda.

    Raises
    ------
    InputError
        If there is no such rule, or it gives no `RuleResult`.
    """
    name = name_of(rule)
    try:
        found = rule(sweep) if callable(rule) else RULES[rule](sweep)
    except Refusal as why:
        note = str(why)
        return RuleResult(name, None, note=note if name in note else f"{name}: {note}")
    if not isinstance(found, RuleResult) or sweep.path.stacked != (found.lines is not None):
        raise InputError(
            f"the rule {name} gives no lambda" + " of every line" * sweep.path.stacked, where="choice",
            found=shown(found), expected="a RuleResult, as loadid.paths.minimum and crossing make it",
            hint="over='band' asks it of all lines together" if sweep.path.stacked else "",
        )  # fmt: skip
    return found if found.rule == name else replace(found, rule=name)


def answered(found: RuleResult) -> float:
    """Lambda of a rule that was wanted.

    Raises
    ------
    InputError
        Where it refused.
    """
    if found.lam is None:
        raise InputError(f"the rule {found.rule} cannot run here", where="choice", found=found.note,
                         expected="another rule or a relative lambda")  # fmt: skip
    return found.lam


def lines(rule: str | Rule, sweep: Sweep) -> Array:
    """Relative lambda of every line of a stack (lines,), by one rule.

    Raises
    ------
    InputError
        As `run` and `answered`.
    """
    found = run(rule, sweep)
    answered(found)
    assert found.lines is not None
    return found.lines
