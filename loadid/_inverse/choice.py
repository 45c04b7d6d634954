"""How lambda is chosen, and what that choice was: the rules, in their order, and what may take their place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeGuard

import numpy as np

from structures._advice import Advice, Spelling
from structures.errors import InputError, real, shown

from . import Array, rules
from .agreement import GRADES, agreement, is_correlated, spends, voices, whiteness_of
from .noise_level import contradicted, implausible
from .path import PathPoint, RegularizationPath
from .problem import NOT_KNOWN, NoiseSource, NoiseSourceLike
from .rules import Rule, answered, in_words
from .sweep import LARGEST, Refusal, RuleResult, Sweep

ChoiceLike = str | Rule | float | None  # name of a rule, a rule, a relative lambda, or nothing said


@dataclass(frozen=True)
class PathCurve:
    """The path over a grid of relative lambdas, for pictures: all arrays (points,)."""

    lam: Array
    residual_norm: Array
    penalty_norm: Array
    edf: Array | None = None
    gcv: Array | None = None

    @classmethod
    def of(cls, sweep: Sweep) -> PathCurve:
        """What the pictures show of a sweep."""
        p = sweep.point
        gcv = None if p.left is None else rules.gcv_function(sweep.path, p)
        return cls(sweep.lam, np.sqrt(p.residual2), np.sqrt(p.penalty2), p.edf, gcv)


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
        Decades between the smallest and the largest lambda of the rules that are compared.
    verdict : str
        ``determined``, ``usable``, ``rules disagree`` or ``not determined``; ``not asked`` beside a lambda of the user.
    odds : str
        What the verdict is worth, as measured on test problems.
    sigma : float or None
        Noise level of the whitened data (1 where the noise is known).
    source : NoiseSource
        Where the noise level comes from.
    edf : float or None
        Effective degrees of freedom at `lam`.
    sweep : PathCurve or None
        For the pictures.
    whiteness : mapping of str to float
        What the tests of the noise found (`whiteness_of`); empty where none could run.
    correlated : bool
        The tests say that the noise is correlated.
    shown : float or None
        Noise level that robust GCV shows, where it is above the stated one by more than chance: lambda was then chosen
        without the stated one.
    """

    lam: float
    scale: float
    rule: str
    rules: tuple[RuleResult, ...] = ()
    spread: float = 0.0
    verdict: str = "determined"
    odds: str = ""
    sigma: float | None = None
    source: NoiseSource = NOT_KNOWN
    edf: float | None = None
    sweep: PathCurve | None = field(default=None, repr=False)
    whiteness: Mapping[str, float] = field(default_factory=dict)
    correlated: bool = False
    shown: float | None = None

    @property
    def sigma_source(self) -> str:
        """Where the noise level comes from, in words."""
        return self.source.text


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
ORDERS = {
    False: ("predicted_error", "robust_gcv", "gcv", "l_curve"),
    True: ("predicted_error", "discrepancy", "upre", "gcv", "l_curve"),
}
EXPLAINING = ("predicted_error", "robust_gcv", "evidence")  # of which one stands in for a fit that explains too little
NEAR = 1.0  # decades within which UPRE refines a load that spends much of the data
RULED_OUT, FAR = 1e-4, 1.5  # evidence over that of the lambda in use; residual over what it leaves, or the noise
NOISY = 0.25  # rms of a residual over that of the data beyond which noise that nobody stated is not what is left
IMPERFECT, SWOLLEN = 0.1, 3.0  # share of the data (rms) that every model may leave; size of a load over a smoother one
EARNED = 10.0  # residual that a degree of freedom takes, over what is left for each, from which it is no error


def choose(
    path: RegularizationPath, choice: ChoiceLike = None, *, sigma: float | None = None, source: NoiseSourceLike = None
) -> Choice:
    """Choose lambda on a path, ask the other rules too, and grade their agreement.

    Parameters
    ----------
    path : RegularizationPath
    choice : str, callable, float or None
        Rule by name or itself, or relative lambda. None: the smallest predicted error of the load
        (`rules.predicted_error`), from the discrepancy solution where the noise level is known, else from robust GCV;
        where it cannot run or ends at an edge, discrepancy and UPRE (noise level known) or robust GCV, then GCV and the
        L-curve. Noise level known and more than a fifth of the data spent: UPRE, if it is not more than a decade below.
        Noise level not known and the noise shows itself as correlated (`whiteness_of`): quasi-optimality, which does
        not ask for white noise. Where lambda so chosen leaves more than a quarter of the data (rms), noise that would
        be known: the largest of predicted error, robust GCV and evidence that does not. A level that the data
        contradict (`contradicted`) is set aside, and robust GCV decides: a level far below the true one would let the
        noise through. One that the evidence makes implausible (`implausible`) is not used either: lambda is then chosen
        as if nobody had stated it. Under constraints it is the load without them that must contradict. A load more
        than three times as large as that of the evidence, which leaves 10 % of the data (rms) or less, and whose other
        degrees of freedom explain little each, is that of the error of the model: lambda is then that of the evidence.
    sigma : float, optional
        Noise level of the whitened data.
    source : NoiseSource or str, optional
        Where it comes from.

    Raises
    ------
    InputError
        Unknown rule, a lambda that is not a finite number >= 0, or a rule that refuses.

    Notes
    -----
    Load error over the smallest error of all lambdas, median / 90 % quantile / share above 3, on 9450 cases of seven
    discrete ill-posed problems for each kind of noise (``python -m tests.benchmarks.rules``):

    ==========================  ====================  ====================  ====================
    rule                        white                 AR(1), 0.9            interpolated
    ==========================  ====================  ====================  ====================
    default, level not known    1.07 / 1.8 / 3.2 %    1.19 / 5.4 / 15.9 %   1.15 / 4.1 / 13.3 %
    robust GCV                  1.10 / 2.1 / 5.3 %    7.34 / 9e7 / 57.5 %   4.63 / 1e6 / 53.2 %
    GCV                         1.23 / 132 / 23.4 %   1e3 / 2e10 / 79.8 %   5e3 / 2e10 / 84.2 %
    default, level known        1.08 / 2.0 / 3.3 %    1.11 / 2.1 / 5.3 %    1.08 / 2.0 / 4.2 %
    discrepancy                 1.41 / 2.8 / 8.8 %    1.66 / 3.4 / 12.4 %   1.40 / 3.2 / 11.2 %
    UPRE                        1.17 / 19 / 18.1 %    1.54 / 6e6 / 39.0 %   7.25 / 5e7 / 57.1 %
    ==========================  ====================  ====================  ====================

    ``rules disagree`` or worse: 39 % of the white cases (39 % with the level known), 91 % (92 %) of the correlated
    ones, 96 % (94 %) of those in which the default is off by more than 3.
    """
    sweep = Sweep.over(path, sigma)
    return decide(sweep, choice, {name: rules.run(name, sweep) for name in DEFAULT_RULES}, source)


def given(
    path: RegularizationPath, lam: float, *, sigma: float | None = None, source: NoiseSourceLike = None
) -> Choice:
    """A relative lambda of the user, where no rule is asked: for paths on which a sweep is dear."""
    lam = relative(lam)
    point = path.at(lam)
    return Choice(
        lam=lam, scale=float(path.scale), rule="given", verdict="not asked",
        odds="lambda was given: no rule asked", sigma=sigma,
        source=NoiseSource.of(source) or NOT_KNOWN, edf=None if point.edf is None else float(point.edf),
    )  # fmt: skip


def decide(
    sweep: Sweep, choice: ChoiceLike, asked: dict[str, RuleResult], source: NoiseSourceLike = None,
    refine: bool = True,
) -> Choice:  # fmt: skip
    """As `choose`, from a sweep and the rules that were asked already; `refine`: UPRE may step in, as said there."""
    path, sigma, origin = sweep.path, sweep.sigma, NoiseSource.of(source) or NOT_KNOWN
    wanted = named(choice)
    if is_rule(choice) and wanted not in asked:
        asked[str(wanted)] = rules.run(choice, sweep)
    free, told = _unconstrained(sweep, asked)
    shown = contradicted(free, told, origin) if wanted is None else None
    if wanted is None and shown is None and (level := implausible(sweep, origin)) is not None:
        unknown = replace(sweep, sigma=None)
        found = decide(unknown, None, {name: rules.run(name, unknown) for name in DEFAULT_RULES}, refine=refine)
        return replace(found, sigma=sigma, source=origin, shown=level)
    lam, rule = _pick(path, "robust_gcv" if shown is not None else wanted, asked, sigma, refine)
    evidence = whiteness_of(path, asked, lam)
    correlated = is_correlated(evidence)
    quasi = asked["quasi_optimality"]
    if choice is None and sigma is None and evidence.get("followed") and quasi.lam is not None:
        lam, rule = quasi.lam, quasi.rule
    if wanted is None and sigma is None and (other := _explaining(path, asked, lam)) is not None:
        lam, rule = answered(other), other.rule
    if wanted is None and (smoother := _as_good(path, asked["evidence"], lam)) is not None:
        lam, rule = smoother, "evidence"
    spread, verdict = agreement(asked, lam, path, correlated)
    asked["discrepancy"] = _with_sensitivity(asked["discrepancy"], sweep)
    point = path.at(lam)
    return Choice(
        lam=lam,
        scale=float(path.scale),
        rule=rule,
        rules=tuple(asked.values()),
        spread=spread,
        verdict=verdict,
        odds=in_words(verdict, sigma is not None) + ("; lambda itself was given" if rule == "given" else ""),
        sigma=sigma,
        source=origin,
        edf=None if point.edf is None else float(point.edf),
        sweep=PathCurve.of(sweep),
        whiteness=evidence,
        correlated=correlated,
        shown=shown,
    )


def _explaining(path: RegularizationPath, asked: Mapping[str, RuleResult], lam: float) -> RuleResult | None:
    """Where `lam` leaves more of the data than anybody's noise is: the smoothest of some rules that does not."""
    if path.energy is None or path.stacked:
        return None
    most = NOISY**2 * float(path.energy)

    def explains(at: float) -> bool:
        return float(path.at(at).residual2) < most

    if explains(lam):
        return None
    running = [asked[name] for name in EXPLAINING if asked[name].lam is not None and not asked[name].edge]
    return max((r for r in running if explains(answered(r))), key=answered, default=None)


def _as_good(path: RegularizationPath, evidence: RuleResult, lam: float) -> float | None:
    """Lambda of the evidence, the larger one, where `lam` has a load several times larger for nothing.

    That is for a part of the data that every model leaves: what its error leaves is fitted by loads that nearly
    nothing sees, and they may be hundreds of times too large. Loads that are real and hardly seen, slow ones by
    accelerometers, explain with few degrees of freedom many times what is left for each.
    """
    if path.energy is None or path.stacked or path.dear or evidence.edge or not 0 < lam < (evidence.lam or 0.0):
        return None
    smoother, own = path.at(answered(evidence)), path.at(lam)
    if smoother.left is None or own.left is None:
        return None
    least, gained = IMPERFECT**2 * float(path.energy), float(smoother.residual2 - own.residual2)
    earned = gained * float(smoother.left) > EARNED * float(smoother.residual2) * float(smoother.left - own.left)
    few = float(own.penalty2) < SWOLLEN**2 * float(smoother.penalty2)
    if float(smoother.residual2) > least or earned or few:
        return None
    try:
        sizes = [float(np.linalg.norm(path.solution(x, None).load)) for x in (lam, answered(evidence))]
    except InputError:  # windows of a record have no solution of it
        return None
    return evidence.lam if sizes[0] > SWOLLEN * sizes[1] else None


def _unconstrained(sweep: Sweep, asked: dict[str, RuleResult]) -> tuple[Sweep, dict[str, RuleResult]]:
    """Sweep and rules of the load without constraints: what these leave unexplained says nothing of the noise."""
    if (path := sweep.path.unconstrained) is sweep.path:
        return sweep, asked
    free = Sweep.over(path, sweep.sigma)
    return free, {"robust_gcv": rules.run("robust_gcv", free)}


def is_rule(choice: object) -> TypeGuard[str | Rule]:
    """Whether a choice is the name of a rule, or a rule."""
    return isinstance(choice, str) or callable(choice)


def checked(choice: object, low: float = 0.0) -> ChoiceLike:
    """What a user gave as ``choice=``: a rule that there is, a relative lambda (`relative`), or None.

    Raises
    ------
    InputError
        Anything else.
    """
    if is_rule(choice):
        rules.name_of(choice)
        return choice
    return None if choice is None else relative(choice, low)


def named(choice: ChoiceLike) -> str | float | None:
    """A choice as provenance holds it."""
    return rules.name_of(choice) if isinstance(choice, str) or callable(choice) else choice


def contenders(choice: Choice, path: RegularizationPath | None = None) -> list[float]:
    """Lambdas of the rules that the data do not rule out: `voices`, or what other rules found inside their range.

    Where the noise is white, a lambda whose evidence is below `RULED_OUT` of that of the lambda in use is no
    alternative to it, nor, where the path does not give its evidence, one at which the data are far from explained.
    """
    asked = {r.rule: r for r in choice.rules}
    whole = set(DEFAULT_RULES) <= set(asked)
    found = voices(asked, choice.lam, path) if whole else [r.lam for r in choice.rules if not r.edge]
    lams = [lam for lam in found if lam is not None]
    if path is None or path.stacked or choice.correlated:
        return lams
    return [lam for lam in lams if _plausible(path, lam, choice)]


def _plausible(path: RegularizationPath, lam: float, choice: Choice) -> bool:
    point, own = path.at(lam), path.at(choice.lam)
    sigma = None if choice.shown is not None else choice.sigma
    known = [x is not None for p in (point, own) for x in (p.objective, p.log_ratio)]
    if not all(known):
        return bool(point.residual2 < FAR**2 * max(float(own.residual2), path.m * (sigma or 0.0) ** 2))

    def log(p: PathPoint) -> float:
        assert p.objective is not None
        assert p.log_ratio is not None
        fit = float(p.objective) / sigma**2 if sigma else (path.m - path.null) * np.log(float(p.objective))
        return -0.5 * (float(p.log_ratio) + fit)

    return bool(log(point) > log(own) + np.log(RULED_OUT))


def parted(choice: Choice, path: RegularizationPath, lams: Iterable[float | None]) -> float | None:
    """Largest change of the load, over its norm, between the lambda in use and some others of its range.

    None where the path has no load to show, or each costs a search of its own.
    """
    if path.stacked or path.dear:
        return None
    low, high = path.range
    others = {min(max(lam, low), max(high, low)) for lam in lams if lam is not None} - {choice.lam}
    try:
        own = path.solution(choice.lam, None).load
        moved = [float(np.linalg.norm(path.solution(lam, None).load - own)) for lam in sorted(others)]
    except InputError:  # windows of a record have no solution of it
        return None
    return max(moved, default=0.0) / max(float(np.linalg.norm(own)), np.finfo(float).tiny)


def _pick(
    path: RegularizationPath, choice: str | float | None, asked: dict[str, RuleResult], sigma: float | None,
    refine: bool = True,
) -> tuple[float, str]:  # fmt: skip
    if isinstance(choice, str):
        return answered(asked[choice]), choice
    if choice is not None:
        return relative(choice), "given"
    order = [asked[name] for name in ORDERS[sigma is not None] if asked[name].lam is not None]
    inside = [r for r in order if not r.edge or r.free]
    running = inside or order or [r for r in asked.values() if r.lam is not None]
    if not running:
        raise InputError(
            "no rule can run on this path",
            where="choice",
            found="; ".join(r.note for r in asked.values()),
            expected="a relative lambda",
            hint=Advice(Spelling("pass choice=<relative lambda>", "give a relative lambda with --choice")),
        )
    first, upre = running[0], asked["upre"]
    refined = refine and first.rule == "predicted_error" and upre.lam is not None and not (upre.edge or first.edge)
    if refined and spends(path, answered(first)) and answered(upre) > 10**-NEAR * answered(first):
        first = upre
    return answered(first), first.rule


def relative(choice: object, low: float = 0.0) -> float:
    """A lambda that a user gave, as a number: 0, or from `low` to `LARGEST`.

    Raises
    ------
    InputError
        Anything else.
    """
    lam = real(choice)
    if lam is None or not (lam == 0 or low <= lam <= LARGEST):
        raise InputError("no relative lambda", where="choice", found=shown(choice),
                         expected=f"{f'0, a number from {low:g}' if low else 'a number from 0'} to {LARGEST:g}, or the "
                                  "name of a rule")  # fmt: skip
    return lam


def positive_lambda(lam: object) -> float:
    """A relative lambda above 0.

    Raises
    ------
    InputError
        Anything else.
    """
    found = relative(lam)
    if found == 0:
        raise InputError("at lambda 0 the problem is another one", where="lambda", found="0",
                         expected="a number above 0", hint="ask the family with choice=0")  # fmt: skip
    return found


def moved(choice: Choice, path: RegularizationPath, lam: float) -> Choice:
    """The choice of a user who gives `lam` after the rules were asked, which are judged beside it as ever."""
    edf = path.at(lam).edf
    given_now = replace(choice, lam=lam, rule="given", edf=None if edf is None else float(edf), shown=None)
    if not choice.rules:
        return given_now
    asked = {found.rule: found for found in choice.rules}
    evidence = whiteness_of(path, asked, lam)
    correlated = is_correlated(evidence)
    spread, verdict = agreement(asked, lam, path, correlated)
    odds = f"{in_words(verdict, choice.sigma is not None)}; lambda itself was given"
    return replace(given_now, spread=spread, verdict=verdict, odds=odds, whiteness=evidence, correlated=correlated)


def _with_sensitivity(found: RuleResult, sweep: Sweep) -> RuleResult:
    """The discrepancy rule with what it says at half and twice the noise level."""
    try:
        values = rules.sensitivity(sweep)
    except Refusal:
        return found
    text = " / ".join("none" if x is None else f"{x:.2g}" for x in values)
    note = f"at half, once and twice the noise level: {text}"
    return replace(found, note=f"{found.note}; {note}" if found.note else note)


def ungraded(choice: Choice) -> Choice:
    """The choice with the worst grade: of a load that does not explain its data."""
    return replace(choice, verdict=GRADES[-1], odds="the load does not explain its data: no agreement of rules counts")
