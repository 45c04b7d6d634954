"""How lambda was chosen: what every rule said, how far they agree, and what that agreement is worth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, Spelling
from structures.errors import InputError, real, shown

from . import Array, rules
from .path import PathPoint, RegularizationPath
from .problem import NOT_KNOWN, NoiseSource, NoiseSourceLike
from .rules import Rule, answered, in_words
from .sweep import ALARM, LARGEST, TESTABLE, Refusal, RuleResult, Sweep, plateau_test, residual_test, smallest_seen

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
GRADES = ("determined", "usable", "rules disagree", "not determined")
LIMITS = (0.5, 1.0, 2.0)  # decades between the grades
KINDS = (("gcv", "robust_gcv"), ("quasi_optimality",), ("discrepancy",))  # the first of each that ran has its voice
BENEATH = 0.03  # share of the smallest singular value below which the load no longer changes
ORDERS = {
    False: ("predicted_error", "robust_gcv", "gcv", "l_curve"),
    True: ("predicted_error", "discrepancy", "upre", "gcv", "l_curve"),
}
EXPLAINING = ("predicted_error", "robust_gcv", "evidence")  # of which one stands in for a fit that explains too little
WIDE, NEAR = 0.2, 1.0  # share of the data that a wide-band load spends; decades within which UPRE then refines it
BELOW = 0.7  # decades by which a whiteness rule lies below quasi-optimality where it may follow correlated noise
CHANCE, CLEARLY = 1e-2, 1.3  # of a residual so far above the stated noise; and how far at least
EXCESS = 1e-3  # chance of a residual so far above the noise that the load does not explain its data
CORNER = 1.5  # decades by which the corner of the L-curve lies below the lambda in use where it has a voice
FACTOR, LARGER = 30.0, 100.0  # Bayes factor that counts as strong; largest noise level that is tried, over the stated
SPARE, TESTED = 0.2, 10  # share of the data, or number, that a fit leaves for the test of the stated noise level
BELOW_BY = 3.0  # steps of lambda below a sweep over a part of the range
RULED_OUT, FAR = 1e-4, 1.5  # evidence over that of the lambda in use; residual over what it leaves, or the noise
NOISY = 0.25  # rms of a residual over that of the data beyond which noise that nobody stated is not what is left
IMPERFECT, SWOLLEN = 0.1, 3.0  # share of the data (rms) that every model may leave; size of a load over a smoother one
EARNED = 10.0  # residual that a degree of freedom takes, over what is left for each, from which it is no error
CALM, FEW, MANY = 0.9, 0.25, 300  # a residual so far inside its limit, and so many data left: the noise is white


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


def contradicted(sweep: Sweep, asked: dict[str, RuleResult], source: NoiseSource) -> float | None:
    """Noise level that the data show, where chance cannot explain that it is above the stated one.

    White noise above the stated level shows in the residual of every fit; a load that its penalty does not expect only
    in those that smooth too much. So every lambda must contradict whose fit leaves `TESTED` data, or `SPARE` of them:
    by a chi-square test at `CHANCE` with those degrees of freedom, and by a factor of at least `CLEARLY`. None where
    few data can all be spent on the load, so that every fit that leaves some may be smoother than it, and the evidence
    does not ask for more noise either (as in `implausible`); where robust GCV, which would have to stand in, found no
    optimum or one that spends more (a fit that leaves enough is then smoother than the load, and leaves some of it);
    and where the level itself was estimated from the misfit of the model (kind ``residual``).
    """
    path, sigma, found, left = sweep.path, sweep.sigma, asked["robust_gcv"], sweep.point.left
    if sigma is None or left is None or found.lam is None or found.edge or source.kind == "residual":
        return None
    enough = np.flatnonzero(left >= SPARE * path.m)
    if not len(enough) or sweep.lam[enough[0]] > found.lam:
        return None
    least = min(SPARE * path.m, TESTED)
    if left[0] < 1 and least < TESTED and (more := _level_asked_for(sweep)) is not None and more[1] < np.log(FACTOR):
        return None
    level, margin = _levels(sweep, np.flatnonzero(left >= least))
    if np.any(level <= margin * sigma) or _agrees_below(sweep, least):
        return None
    return float(level.min())


def _agrees_below(sweep: Sweep, least: float) -> bool:
    """Whether a lambda below those of a sweep over a part of the range agrees with the stated noise level."""
    assert sweep.point.left is not None
    assert sweep.sigma is not None
    low, lam, left = sweep.path.range[0], float(sweep.lam[0]), float(sweep.point.left[0])
    while left >= least and lam > low:
        lam = max(lam / BELOW_BY, low)
        lower = Sweep(sweep.path, np.array([lam]), sweep.path.at(np.array([lam])), sweep.sigma, whole=False)
        assert lower.point.left is not None
        left = float(lower.point.left[0])
        level, margin = _levels(lower, np.flatnonzero(lower.point.left >= least))
        if np.any(level <= margin * sweep.sigma):
            return True
    return False


def _passed(sweep: Sweep) -> bool:
    """Whether the stated noise level agrees with a residual of `TESTED` data or more."""
    if sweep.point.left is None or sweep.sigma is None:
        return False
    level, margin = _levels(sweep, np.flatnonzero(sweep.point.left >= TESTED))
    return bool(np.any(level <= margin * sweep.sigma))


def _levels(sweep: Sweep, at: NDArray[np.intp]) -> tuple[Array, Array]:
    """Noise level that the residual shows at some lambdas of a sweep, and how far above the true one it may be."""
    from scipy.special import gammaincinv

    assert sweep.point.left is not None
    freedom = sweep.point.left[at]
    level = np.sqrt(sweep.point.residual2[at] / freedom)
    return level, np.maximum(CLEARLY, np.sqrt(2 * gammaincinv(freedom / 2, 1 - CHANCE) / freedom))


def implausible(sweep: Sweep, source: NoiseSource) -> float | None:
    """Noise level that the evidence asks for, where it makes the stated one implausible.

    Says what `contradicted` cannot where a few data are all spent by the fit: a larger level, log-uniform up to
    `LARGER` times the stated one, over every lambda against the stated one over every lambda (a Bayes factor above
    `FACTOR`; Kass & Raftery, J. Am. Stat. Assoc. 90 (1995) 773). None where the path does not give its evidence, and
    where the level passed a test with `TESTED` data left: the evidence of a load unlike its prior would be no more.
    """
    if sweep.sigma is None or source.kind == "residual" or (found := _level_asked_for(sweep)) is None or _passed(sweep):
        return None
    level, factor = found
    return level if factor > np.log(FACTOR) and level > CLEARLY * sweep.sigma else None


def _level_asked_for(sweep: Sweep) -> tuple[float, float] | None:
    """Noise level of the largest evidence over every lambda, from the stated one upwards; ln of their Bayes factor."""
    point, sigma = sweep.point, sweep.sigma
    if sigma is None or point.objective is None or point.log_ratio is None:
        return None
    if sweep.path.stacked or not sweep.whole:
        return None
    from scipy.special import logsumexp

    inside = sweep.lam <= 1.0
    levels = sigma * np.geomspace(1.0, LARGER, 60)
    fit = point.objective[inside, None] / levels**2
    log = -0.5 * (point.log_ratio[inside, None] + fit) - (sweep.path.m - sweep.path.null) * np.log(levels)
    each = logsumexp(log, axis=0)
    return float(levels[np.argmax(each)]), float(logsumexp(each) - np.log(len(levels)) - each[0])


def whiteness_of(path: RegularizationPath, asked: dict[str, RuleResult], lam: float) -> dict[str, float]:
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
    asked: dict[str, RuleResult], used: float, path: RegularizationPath | None = None, correlated: bool = False
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
    if path is not None and _spends(path, used):
        found[2] = None
    if asked["quasi_optimality"].edge and (found[1] or 0.0) < 0.5:
        found[1] = None
    if _cornered(asked, used):
        found.append(asked["l_curve"].lam)
    return found


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


def _cornered(asked: Mapping[str, RuleResult], used: float) -> bool:
    """Whether, without a noise level, the L-curve has its corner far below the lambda in use.

    A wrong corner is more frequent than a wrong lambda, so that it counts from `CORNER` decades only.
    """
    corner, known = asked["l_curve"], asked["discrepancy"].lam is not None
    if known or corner.lam is None or corner.edge or used <= 0:
        return False
    return corner.lam < 10**-CORNER * used


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
    if refined and _spends(path, answered(first)) and answered(upre) > 10**-NEAR * answered(first):
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


def _spends(path: RegularizationPath, lam: float) -> bool:
    """Whether the solution takes more than a fifth of the data as degrees of freedom."""
    edf = path.at(lam).edf
    return edf is not None and float(edf) > WIDE * path.m


def _with_sensitivity(found: RuleResult, sweep: Sweep) -> RuleResult:
    """The discrepancy rule with what it says at half and twice the noise level."""
    try:
        values = rules.sensitivity(sweep)
    except Refusal:
        return found
    text = " / ".join("none" if x is None else f"{x:.2g}" for x in values)
    note = f"at half, once and twice the noise level: {text}"
    return replace(found, note=f"{found.note}; {note}" if found.note else note)


def unexplained(residual2: float, m: float, sigma: float) -> float | None:
    """Residual over the noise, where no noise of that level leaves so much; None where it may.

    The rms of all m data counts, whatever the fit has spent: noise alone leaves less. A chi-square test at `EXCESS`,
    and a factor of at least `CLEARLY`, as stated noise levels are rough.
    """
    from scipy.special import gammaincinv

    level = float(np.sqrt(residual2 / m)) / sigma
    return level if level > max(CLEARLY, float(np.sqrt(2 * gammaincinv(m / 2, 1 - EXCESS) / m))) else None


def ungraded(choice: Choice) -> Choice:
    """The choice with the worst grade: of a load that does not explain its data."""
    return replace(choice, verdict=GRADES[-1], odds="the load does not explain its data: no agreement of rules counts")


def residual_level(path: RegularizationPath, lam: float) -> float | None:
    """Noise level of the whitened data that the residual shows, sqrt(|r|^2 / (m - edf)).

    None where the fit leaves less than a fifth of the data: what is left then tells of the prior, not of the noise.
    """
    return shown_level(path.at(lam), path.m)


def shown_level(point: PathPoint, m: float) -> float | None:
    """See `residual_level`, of a point of a path of m data."""
    if point.left is None or float(point.left) < 0.2 * m:
        return None
    return float(np.sqrt(point.residual2 / point.left))
