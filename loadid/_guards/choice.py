"""Guards of the choice of lambda and of a prior, of side constraints and their solvers, and of bookkeeping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from structures._advice import Advice, Option, Spelling
from structures._flags import Evidence, Flag, collect
from structures.errors import InputError

from .._inverse import Array
from .._inverse.agreement import BELOW
from .._inverse.choice import Choice, contenders, parted
from .._inverse.constrained.nonnegative import NonNegativeSolution
from .._inverse.constrained.solver import ConstrainedSolution
from .._inverse.path import RegularizationPath
from .._inverse.problem import MEASURED
from .._inverse.rules import FOR_WHITE_NOISE, discrepancy
from .._inverse.sweep import ALARM, TESTABLE, Sweep
from ..constraints import Constraint, Resultant

DECADE = 1.0  # spread of the rules, decades
SIGMA_RULES = ("discrepancy", "dof_discrepancy", "upre", "predicted_error", "evidence")
FLAT = 1.05  # GCV: highest over lowest within half a decade


MATTERS = 3.0  # change of the load over its std, as norms, from which a doubt about lambda is one about the load
HALF = 10**0.5  # half a decade


def parameter(
    choice: Choice,
    path: RegularizationPath | None = None,
    solved: RegularizationPath | None = None,
    spread: float | None = None,
) -> tuple[Flag, ...]:
    """W401 to W407 and W411 of one choice on a path; without one W406 says nothing of other noise levels.

    Parameters
    ----------
    path : RegularizationPath, optional
        On which lambda was sought.
    solved : RegularizationPath, optional
        That of the load.
    spread : float, optional
        Norm of the load's std over that of the load: where another lambda moves the load by less than `MATTERS` of it,
        W407 is not raised, and W401, W402 and W411 are notes.
    """
    parts, doubts = disagreement(choice), [no_corner(choice), gcv_minimum(choice), at_the_end(choice)]
    if solved is not None and spread and (parts or any(doubts)):
        others = contenders(choice, path)
        by_rules = parted(choice, solved, others)
        parts = _apart(parts, by_rules, spread)
        if any(doubts) and by_rules is not None:
            near = parted(choice, solved, [choice.lam / HALF, choice.lam * HALF])
            doubts = [_weighed(flag, max(by_rules, near or 0.0) / spread) for flag in doubts]
    return collect(
        [
            *doubts[:2],
            correlated_noise(choice),
            needs_white_noise(choice),
            not_testable(choice),
            noise_source(choice, path),
            parts,
            doubts[2],
        ]
    )


def _apart(flag: Flag | None, moved: float | None, spread: float) -> Flag | None:
    """W407 with what it does to the load; None where that stays in its band."""
    if flag is None or moved is None:
        return flag
    if moved < MATTERS * spread:
        return None
    said = f"{flag.message}; the loads that they give lie up to {moved / spread:.2g} times the std apart"
    return replace(flag, message=said, effect=moved / spread)


def _weighed(flag: Flag | None, effect: float) -> Flag | None:
    """A doubt about lambda: a note where the load stays in its band."""
    return None if flag is None else replace(flag, state=effect < MATTERS, effect=effect)


def no_corner(choice: Choice) -> Flag | None:
    """W401: lambda was chosen by the L-curve, and it has no corner or one at the end of the sweep.

    Elsewhere that does no harm: well-conditioned problems have no corner, and the table of the rules says so.
    """
    found = next((r for r in choice.rules if r.rule == "l_curve"), None)
    if choice.rule != "l_curve" or found is None or (found.lam is not None and not found.edge):
        return None
    value = "none" if found.lam is None else found.lam
    return Flag("W401", Evidence("lambda at the corner", value, "inside the sweep"),
                f"the L-curve has no usable corner ({found.note})", "use discrepancy or GCV")  # fmt: skip


def gcv_minimum(choice: Choice) -> Flag | None:
    """W402: lambda was chosen by GCV or from it, and GCV sits at an end of the sweep or is flat around its minimum."""
    found = next((r for r in choice.rules if r.rule == "gcv"), None)
    if not _from_gcv(choice) or found is None or found.lam is None or found.free:
        return None
    if choice.sweep is None or choice.sweep.gcv is None:
        return None
    near = np.abs(np.log10(choice.sweep.lam / found.lam)) <= 0.5
    G = choice.sweep.gcv[near]
    G = G[np.isfinite(G)]
    ratio = float(G.max() / G.min()) if len(G) else np.inf
    if not found.edge and ratio >= FLAT:
        return None
    if found.edge:
        evidence = Evidence("GCV lambda", found.lam, "inside the sweep")
        advice = "at the lower end the data ask for no regularisation; at the upper end they carry no information"
    else:
        evidence = Evidence("GCV max/min", ratio, FLAT)
        advice = "the response hardly depends on lambda here: compare the rules, and state the noise of the sensors"
    return Flag("W402", evidence, f"GCV did not find a minimum (relative lambda {found.lam:.3g})", advice)


def _from_gcv(choice: Choice) -> bool:
    """Whether the residual alone told what is noise, as if it were white."""
    return choice.rule in FOR_WHITE_NOISE and not (choice.rule == "predicted_error" and choice.sigma is not None)


def correlated_noise(choice: Choice) -> Flag | None:
    """W403: the noise is shown to be correlated, by the residual and the order of the rules, or by its plateau."""
    if not choice.correlated:
        return None
    tests = choice.whiteness
    if tests.get("followed"):
        evidence = Evidence("decades below quasi-optimality", float(tests["below"]), BELOW)
        seen = f"rules that assume white noise lie {tests['below']:.1f} decades below quasi-optimality"
    else:
        evidence = Evidence("chance of such data coefficients under white noise", float(tests["chance"]), ALARM)
        seen = f"the data coefficients beyond the load are not flat (chance {tests['chance']:.1g} under white noise)"
    return Flag(
        "W403",
        evidence,
        f"the noise is correlated: {seen}; GCV and its kin take it for response (used here: {choice.rule})",
        "state the measured noise level (discrepancy does not need white noise), or its covariance",
    )


def needs_white_noise(choice: Choice) -> Flag | None:
    """W404: dof-corrected discrepancy, and nobody said or showed that the noise is white."""
    if choice.rule != "dof_discrepancy" or choice.source.white:
        return None
    tests = choice.whiteness
    if not choice.correlated and tests.get("modes", 0.0) >= TESTABLE:
        return None
    return Flag(
        "W404",
        Evidence("noise modes that were tested", int(tests.get("modes", 0.0)), TESTABLE),
        "the dof-corrected discrepancy needs white noise, and that is neither stated nor shown",
        Advice(
            "use the plain discrepancy",
            Spelling(", or say that it is white: noise=Noise(std, source=NoiseSource(kind, white=True))", ""),
        ),
    )


def not_testable(choice: Choice) -> Flag | None:
    """W405: the choice rests on white noise, and too few data are left to test it."""
    tests = choice.whiteness
    if not _from_gcv(choice) or "modes" not in tests:
        return None
    count = int(max(tests["modes"], tests.get("left", 0.0)))
    if count >= TESTABLE:
        return None
    return Flag("W405", Evidence("noise modes", count, TESTABLE),
                f"{choice.rule} assumes white noise, which is not testable: {count} noise modes",
                "measure the unloaded sensors, and state their noise", state=True)  # fmt: skip


def at_the_end(choice: Choice) -> Flag | None:
    """W411: the rule that chose lambda ended at an end of its range, the null-space solution included."""
    found = next((r for r in choice.rules if r.rule == choice.rule), None)
    if found is None or not found.edge:
        return None
    if found.free:
        message = "the data ask for nothing beyond what the penalty leaves free: the load is its null-space solution"
        advice = "believe it where such a load is plausible; a weaker penalty (identity) shows whether more is there"
    else:
        message = f"{choice.rule} ended at an end of its range (relative lambda {choice.lam:.3g})"
        advice = "compare the rules; state the noise of the sensors, or give lambda"
    return Flag("W411", Evidence("relative lambda", float(choice.lam), "inside the sweep"), message, advice)


def unexplained(choice: Choice, level: float) -> Flag:
    """W412: the residual is `level` times the noise, more than chance allows."""
    found = next((r for r in choice.rules if r.rule == choice.rule), None)
    wall = f", and lambda ends its range ({choice.lam:.3g})" if found is not None and found.edge else ""
    noise = f"the noise ({choice.sigma_source})" if choice.sigma is not None else "what noise and a fair model leave"
    said = f"the residual is {level:.3g} times {noise}{wall}"
    return Flag(
        "W412",
        Evidence("residual over the noise level", level, 1.0),
        f"the load does not explain its data: {said}",
        Advice(
            "look at the residual: where it is as large as the response, another load acts, or lambda is wrong (give ",
            Option("choice"),
            "); else verify the model with a known load, and measure the noise of the unloaded sensors",
        ),
        effect=level,
    )


def noise_source(choice: Choice, path: RegularizationPath | None = None) -> Flag | None:
    """W406: the data contradict the noise level, or it decides and nobody said where it comes from."""
    if choice.shown is not None and choice.sigma is not None:
        ratio = choice.shown / choice.sigma
        return Flag(
            "W406",
            Evidence("noise that the residual shows, over the stated level", float(ratio), 1.0),
            f"the residual shows {ratio:.3g} times the stated noise level ({choice.sigma_source}): the level is too "
            f"low, or the model is wrong; lambda was chosen without it ({choice.rule})",
            "measure the noise of the unloaded sensors again; then verify the model with a known load",
            effect=float(ratio),
        )
    if choice.sigma is None or choice.rule not in SIGMA_RULES or choice.source.measured:
        return None
    meaning = ""
    if path is not None:
        sweep = Sweep.over(path, choice.sigma)
        found = [discrepancy(sweep, factor).lam for factor in (0.5, 1.0, 2.0)]
        values = ", ".join("none" if d is None else f"{d:.3g}" for d in found)
        meaning = f"; relative lambda at half, once and twice of it: {values}"
    return Flag(
        "W406",
        Evidence("source of the noise level", choice.source.kind, ", ".join(MEASURED)),
        f"the noise level comes from {choice.source.text!r}{meaning}",
        Advice(
            "record the unloaded sensors for a minute, or ",
            Spelling(
                "say where the level comes from: noise=Noise(std, source='datasheet'), 'repeatability' or 'quiet'",
                "choose another rule with --choice",
            ),
        ),
        state=True,
    )


def disagreement(choice: Choice) -> Flag | None:
    """W407: the rules lie more than a decade apart, or none found an optimum."""
    if choice.verdict not in ("rules disagree", "not determined"):
        return None
    found = {r.rule: r.lam for r in choice.rules if r.lam is not None and not r.edge}
    listed = ", ".join(f"{k} {v:.2g}" for k, v in found.items())
    return Flag(
        "W407",
        Evidence(
            "spread of the rules, decades",
            float(min(choice.spread, 99.0)),
            DECADE if choice.spread > DECADE else "noise that is white",
        ),
        f"{choice.verdict}: {listed or 'no rule found an optimum'}",
        "suspect correlated noise or model error before trusting any; look at the path plot and verify the model",
    )


RISE = 2.0  # of the residual, in noise levels


def fighting(solution: ConstrainedSolution, constraints: Sequence[Constraint], sigma: float, m: int) -> Flag | None:
    """W308: the residual with the constraints lies more than two noise levels above the one without them.

    Parameters
    ----------
    sigma : float
        Noise level of the whitened data.
    m : int
        Number of data.
    """
    rise = solution.change / (sigma * np.sqrt(m))
    if not rise > RISE:
        return None
    force = [
        float(np.linalg.norm(push @ np.asarray(c.C) if isinstance(c, Resultant) else push))
        for c, push in zip(constraints, solution.multipliers, strict=True)
    ]
    worst = int(np.argmax(force))
    share = force[worst] / max(sum(force), np.finfo(float).tiny)
    return Flag(
        "W308",
        Evidence("rise of the residual, noise levels", float(rise), RISE),
        f"the constraints fight the data: they raise the residual by {rise:.3g} times the noise; "
        f"{share:.0%} of the force is that of constraint {worst} ({constraints[worst]})",
        "check the signs, the side and the frames of the contact, and the frame of the force/torque sensor",
    )


def pulling(solution: NonNegativeSolution, free_residual2: float, sigma: float, m: int) -> Flag | None:
    """W308 of a history: loads that only push leave a residual more than two noise levels above that of any load.

    Parameters
    ----------
    free_residual2 : float
        Squared residual of the load without signs at the same lambda.
    sigma : float
        Noise level of the whitened data.
    m : int
        Number of data.
    """
    rise = (np.sqrt(solution.residual2) - np.sqrt(free_residual2)) / (sigma * np.sqrt(m))
    if not rise > RISE:
        return None
    return Flag("W308", Evidence("rise of the residual, noise levels", float(rise), RISE),
                f"loads that only push fight the data: they raise the residual by {rise:.3g} times the noise",
                "check the sign of the load and of the sensors, or let the load pull (no constraints)")  # fmt: skip


def stopped(
    solution: ConstrainedSolution | NonNegativeSolution, sigma: float | None, m: int, limit: float = 1e-9
) -> Flag | None:
    """W410: the solver ended on its limit of iterations, not at the solution."""
    if solution.converged:
        return None
    steps = solution.steps if isinstance(solution, NonNegativeSolution) else solution.iterations
    ratio = float(np.sqrt(solution.residual2 / m) / sigma) if sigma else float("nan")
    level = f"the residual is {ratio:.3g} times the noise level" if sigma else "the noise level is not known"
    return Flag(
        "W410",
        Evidence("duality gap", solution.gap, limit),
        f"the solver ({solution.solver}) stopped after {steps} steps, not at the solution: {level}; "
        f"the relative duality gap is {solution.gap:.2g}",
        "allow more iterations, or regularise more",
    )


UNCOUPLED = 0.0  # entries off the one of each row, relative to the largest


def diagonal(H: Array) -> InputError | None:
    """E102: a transfer matrix without any coupling, f_i proportional to u_i, on more than one load."""
    seen = np.abs(H) > UNCOUPLED
    if min(H.shape) < 2 or np.any(seen.sum(axis=1) > 1) or np.any(seen.sum(axis=0) > 1):
        return None
    n = H.shape[1]
    return InputError(
        f"the transfer matrix is diagonal: none of its {H.size - int(seen.sum())} off-diagonal entries differs from 0, "
        "and force would be painted wherever there is motion",
        where="StaticInversion",
        found=f"no coupling among {n} loads",
        expected="a model in which a load moves its neighbours too",
        hint="assemble the stiffness of the whole body (structures.solids, plates, beams)",
        code="LID-E102",
    )


def absolute_lambda(lam: float, scale: float) -> Flag:
    """W307: lambda was given as an absolute value."""
    return Flag(
        "W307",
        Evidence("absolute lambda", lam, "relative"),
        f"lambda {lam:.3g} is absolute (relative {lam / scale:.3g}): with another modulus, unit or scaling the same "
        "value changes the shape of the load, not only its gain",
        f"use the relative value {lam / scale:.3g}, which goes with the problem",
    )


def changing_lambda(lams: Sequence[float]) -> Flag | None:
    """W409: lambda was chosen anew for each frame."""
    used = np.array([x for x in lams if x > 0])
    if len(set(lams)) < 2:  # one frame, or a lambda that was fixed before
        return None
    spread = float(np.ptp(np.log10(used))) if len(used) else 0.0
    return Flag("W409", Evidence("spread of lambda over the frames, decades", spread, 0.0),
                f"lambda changes per frame ({len(lams)} frames, {spread:.2g} decades): frames are not comparable",
                "calibrate([...]) once and freeze(), or leave joint=True")  # fmt: skip


PEAKED = 20.0  # kurtosis of a load above which it is made of impacts
IMPULSIVE = 8.0  # kurtosis above which impacts are looked for; a fifth of the time in pulses has 7.5
NARROW = 2.0  # width of the largest pulse over the resolution below which the pulse may be narrower than it looks
LOST = 0.5  # share of a single-sample peak that the prior takes away, above which that lowers the peak
CLASSES = {"impact": ("sparse",), "service": ("tikhonov",)}


def impulsive(kurtosis: float, prior: str) -> Flag | None:
    """W311 under a smooth prior, of a load that was declared: what came out is made of impacts.

    It is asked only where a class of load was declared. A high kurtosis alone does not show that the prior is wrong: a
    pulse that the data resolve is as high and as wide as it should be, and has that kurtosis too. `smeared` is asked
    always.

    Parameters
    ----------
    kurtosis : float
        Fourth moment over the square of the second, of the load about zero (3 for a Gaussian one).
    prior : str
        In words.
    """
    if not kurtosis > PEAKED:
        return None
    return Flag(
        "W311",
        Evidence("kurtosis of the load", float(kurtosis), PEAKED),
        f"the load looks impulsive (kurtosis {kurtosis:.3g}); the prior used was {prior}: it smears and lowers peaks",
    )


def smeared(kurtosis: float, pulse: float, resolution: float, lost: float, prior: str) -> Flag | None:
    """W311 under a smooth prior: the largest pulse is about as narrow as anything can be shown, and far too low.

    Three signs together: a load of impacts, its largest pulse hardly wider than the answer to a single sample, and a
    prior that takes more than half of the height of such an answer. Calibrated by ``python -m
    tests.benchmarks.smeared``: raised on 95 of 96 records whose pulses came out at a tenth to four fifths of their
    height; silent on 144 whose pulses were resolved (0.72 to 1.03 of their height) and on 24 of random loads.

    Parameters
    ----------
    kurtosis : float
        As in `impulsive`.
    pulse, resolution : float
        Width of the largest pulse at half its height, and of the answer to a single-sample load at its place, in
        samples.
    lost : float
        Share of the height of that load that the answer lacks.
    prior : str
        In words.
    """
    if not (kurtosis > IMPULSIVE and pulse < NARROW * resolution and lost > LOST):
        return None
    return Flag(
        "W311",
        Evidence("width of the largest pulse over the resolution", float(pulse / resolution), NARROW),
        f"the load looks impulsive (kurtosis {kurtosis:.3g}), and its largest pulse is no wider than what is resolved "
        f"({pulse:.3g} and {resolution:.3g} samples): the prior ({prior}) smears it, and a single-sample peak is shown "
        f"at {1 - lost:.0%} of its height",
        Advice(
            "learn from the record where the load acts (",
            Spelling("penalty=Penalty('identity', variance='local')", "--variance local"),
            "), which models with states take; or compare ",
            Spelling("SparseDeconvolution(dictionary='bspline')", "--family sparse --dictionary bspline"),
            ", or let the load only push; an accelerometer near the load resolves more",
        ),
    )


def declared_class(declared: str | None, prior: str) -> Flag | None:
    """W510: the load was declared as one that the prior does not fit, before any data.

    Parameters
    ----------
    declared : {"impact", "service"} or None
        Hammer blows and shocks; loads that act all the time.
    prior : {"sparse", "tikhonov"}
    """
    if declared is None or prior in CLASSES[declared]:
        return None
    other = "SparseDeconvolution, or a load that only pushes" if declared == "impact" else "Deconvolution (Tikhonov)"
    return Flag(
        "W510",
        Evidence("prior", prior, f"one that fits {declared} loads"),
        f"the prior is {prior}, the load class says {declared}",
        f"switch the family: {other}",
    )
