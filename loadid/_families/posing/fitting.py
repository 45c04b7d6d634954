"""Loads of every line: whitened, regularised, with the errors of the FRF; how far other rules agree with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, NotIdentifiable, real, reals

from ..._inverse import rules
from ..._inverse.agreement import GRADES, LIMITS
from ..._inverse.choice import Choice, PathCurve, is_rule
from ..._inverse.discrepancy import Discrepancy, learned
from ..._inverse.problem import NoiseSource
from ..._inverse.rules import MEANING
from ..._inverse.spectral import (
    Compressed,
    FactoredLines,
    Identifiable,
    LinePosterior,
    LinePrior,
    LinesPath,
    compress,
    contradicted,
    factor,
    identifiable,
    posterior,
    prior,
    window,
)
from ..._inverse.sweep import LINE_POINTS, RuleResult, Sweep
from ...settings import Lambda

Array = NDArray[Any]

ROUNDS = 3  # of FRF errors, whose share of the noise depends on the loads
LEAST = 0.01  # share of the shown noise that stays noise of the response
SMALLEST = 1e-100  # relative lambda whose square is still a number
POOL = 20  # lines to either side that a noise level of a rule rests on


@dataclass(frozen=True, repr=False, eq=False)
class LineRule(Lambda):
    """How lines are regularised: None is the evidence of the neighbouring lines (Tikhonov)."""

    def __post_init__(self) -> None:
        super().__post_init__()

        def need(good: bool, what: str, where: str, found: object, expected: str) -> None:
            if not good:
                raise InputError(what, where=where, found=repr(found)[:80], expected=expected)

        need(self.count is None or (self.method == "tsvd" and self.choice is None), "count is for truncation alone",
             "count", self.count, "method='tsvd' without a choice")  # fmt: skip
        need(self.size is None or not self.pooled, "the evidence of the lines finds the sizes itself", "size",
             self.size, "no size, or a rule (choice=)")  # fmt: skip
        if is_rule(self.choice):
            rules.name_of(self.choice)
        elif self.choice is not None:
            value = real(self.choice)
            need(value is not None and np.isfinite(value) and value >= 0, "no relative lambda", "choice", self.choice,
                 "a number >= 0, the name of a rule, or None")  # fmt: skip

    @property
    def pooled(self) -> bool:
        """Whether the variances of loads and noise around each line are the regularisation."""
        return self.method == "tikhonov" and self.choice is None

    @property
    def free(self) -> bool:
        """Least squares, without regularisation."""
        return self.count is None and not is_rule(self.choice) and self.choice == 0


@dataclass(frozen=True)
class LineFit:
    """Loads of every line with what is known of them; arrays are (lines, loads) unless said.

    Parameters
    ----------
    load : array, shape (lines, loads, snapshots)
    covariance : array, shape (lines, loads, loads)
    identifiable : Identifiable
    expected : array
        Size of the load around each line.
    noise : array, shape (lines,)
        Variance of the whitened noise.
    total : array, shape (lines, sensors)
        Variance of response noise and FRF errors that whitened the data.
    errors : array, shape (lines, sensors), or None
        The part of `total` that FRF errors make.
    lam : array, shape (lines,)
        Relative to the largest singular value of the weighted line.
    edf : array, shape (lines,)
    path : LinesPath
        Of the weighted lines, for the other rules.
    used : float
        Lambda in use on the joined path of these lines, absolute.
    excess : float
        Noise over the stated level where that is contradicted, else 1 (variances).
    naive_std : array
        Of the least-squares loads, by noise and errors of the FRF; infinite where a line does not determine the load.
    frf_part : array
        The part of `variance` that errors of the FRF make: no average reduces it.
    prior_part : array
        The part of `variance` that is the expected size of what the line does not tell: no average reduces it either.
    blind : array, shape (lines, loads, loads)
        What regularisation takes away from a load: one less the resolution.
    unexplained : float
        What no load explains over what noise and a fair model (`Discrepancy.fair`) leave, on the lines that contradict
        it, else 1 (variances).
    missing : array, shape (lines, loads, loads)
        The part of `covariance` that prior and weights leave open: on average the load is larger by it than its
        estimate. Errors of the FRF that went through the estimator are in the estimate already.
    discrepancy : Discrepancy or None
        Errors of the FRF that nobody stated.
    """

    load: NDArray[np.complex128]
    covariance: NDArray[np.complex128]
    identifiable: Identifiable
    expected: NDArray[np.float64]
    noise: NDArray[np.float64]
    total: NDArray[np.float64]
    errors: NDArray[np.float64] | None
    lam: NDArray[np.float64]
    edf: NDArray[np.float64]
    path: LinesPath
    used: float
    excess: float
    naive_std: NDArray[np.float64]
    frf_part: NDArray[np.float64]
    prior_part: NDArray[np.float64]
    blind: NDArray[np.complex128]
    unexplained: float
    missing: NDArray[np.complex128]
    discrepancy: Discrepancy | None = None

    @property
    def variance(self) -> NDArray[np.float64]:
        """``E|error|^2`` of one realisation, (lines, loads)."""
        return np.asarray(np.maximum(np.einsum("kjj->kj", self.covariance).real, 0.0))


def fit(
    H: Array,
    X: Array,
    power: Array,
    *,
    known: bool,
    rule: LineRule,
    variance: Array | None = None,
    frequencies: Array | None = None,
    averages: float = 1.0,
    progress: Callable[[float], None] = lambda share: None,
) -> LineFit:
    """Solve all lines.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
    X : array, shape (lines, sensors, snapshots)
    power : array, shape (lines, sensors)
        Variance of the noise, or a scale where it is not `known`.
    variance : array like H, optional
        ``E|error|^2`` of H. An error of the FRF times the load is noise of the response: ``Y = H g + n - E g``. Given
        the loads, its variance is ``sum_j var H_ij |g_j|^2``, so that whitening and loads are settled in turn (errors
        in variables with known variances; Fuller, Measurement Error Models, 1987, ch. 3).
    frequencies : array, shape (lines,), optional
        Hz: errors of H that nobody states are learned from the lines, weigh the data and are in the band. None: H is
        exact, but for `variance`.
    averages : float
        Behind the data.

    Raises
    ------
    InputError
        Shapes that do not fit, a rule that cannot run.
    """
    errors: Array | None = None
    found: Discrepancy | None = None
    if frequencies is not None and variance is None:
        found = learned(H, X, power, frequencies, known=known, neighbours=rule.neighbours, averages=averages)
        errors = np.einsum("ksj,kj->ks", found.entries, found.load)
        power, known = power if known else power * found.noise, True
    rounds = 1 if variance is None else ROUNDS
    for k in range(rounds + (variance is not None)):
        total = power if errors is None else power + errors
        w = 1 / np.sqrt(total)
        lines = compress(H * w[..., None], X * w[..., None])
        left_over = None
        if variance is not None and not rule.free:
            lines, left_over = calibrated(lines, np.einsum("ksj,ks->kj", variance, w**2))
            _refuse_lost(lines)
        guess = prior(lines, neighbours=rule.neighbours, known=known, averages=averages)
        f = factor(lines, guess.load)
        first = posterior(f, guess.noise)
        progress((k + 1) / (rounds + 2))
        if variance is None or k == rounds:
            break
        second = first.load @ first.load.conj().swapaxes(1, 2) + first.covariance
        size = np.maximum(np.einsum("kjj->kj", second).real, 0.0)
        errors = np.einsum("ksj,kj->ks", variance, size)
        if left_over is not None:
            errors = errors * left_over(second)[:, None]
        if not known:
            power, known = _alone(power * guess.noise[:, None], errors), True
    excess = guess.excess
    if found is not None and lines.left:
        excess = contradicted(lines, averages, _expected(lines, w, power, found))[1]
    told = identifiable(f)
    answer, noise, lam, path, used = _pooled(f, guess, first) if rule.pooled else _ruled(lines, f, guess, rule, known)
    prior_part = _beyond(answer, noise)
    with np.errstate(divide="ignore"):
        naive_variance = np.where(told.gain > 0, noise[:, None], np.inf) / np.where(told.gain > 0, told.gain, 1.0) ** 2
    frf_part, missing = np.zeros(told.gain.shape), answer.covariance
    if found is not None:
        assert errors is not None
        made = _Propagated.of(found, answer, lines, w, noise[:, None] * errors)
        naive_variance = naive_variance + made.variance(told.inverse, beyond=True)
        frf_part = made.variance(answer.gain)
        answer = replace(answer, covariance=answer.covariance + made.covariance(answer.gain))
    elif errors is not None:
        assert lines.Q is not None
        on_sensors = answer.gain @ lines.Q.conj().swapaxes(1, 2)
        frf_part = np.einsum("kjs,ks->kj", np.abs(on_sensors) ** 2, errors * w**2)
    return LineFit(
        load=answer.load, covariance=answer.covariance, identifiable=told, expected=np.sqrt(guess.probable),
        noise=noise, total=total, errors=errors, lam=lam, edf=answer.edf, path=path, used=used, excess=guess.excess,
        unexplained=excess, missing=missing,
        naive_std=np.sqrt(np.maximum(naive_variance, 0.0)), frf_part=frf_part, prior_part=prior_part,
        blind=np.eye(lines.shape[2]) - answer.gain @ lines.R, discrepancy=found,
    )  # fmt: skip


@dataclass(frozen=True)
class _Propagated:
    """Errors of the FRF in the data of each line, now that its loads are known, over what the weights held for them.

    Errors of entries are independent from sensor to sensor; that of a frequency moves all sensors together.

    Parameters
    ----------
    reduced : array, shape (lines, rank, sensors)
        From the data of the sensors to what is inverted.
    moved : array, shape (lines, rank, snapshots)
        One std of the frequencies.
    made, assumed : array, shape (lines, sensors)
        Variance by the entries, and by what weighed the data.
    """

    reduced: NDArray[np.complex128]
    moved: NDArray[np.complex128]
    made: NDArray[np.float64]
    assumed: NDArray[np.float64]

    @classmethod
    def of(cls, found: Discrepancy, answer: LinePosterior, lines: Compressed, w: Array, assumed: Array) -> _Propagated:
        assert lines.Q is not None
        reduced = lines.Q.conj().swapaxes(1, 2) * w[:, None, :]
        made = (found.entries @ (_square(answer.load) + answer.variance)[..., None])[..., 0]
        load = np.sqrt(_square(answer.load))
        shifted = [shift @ answer.load for shift in np.split(found.shift, found.nodes, axis=2)]
        return cls(reduced, reduced @ np.concatenate([*shifted, found.columns(load, w)], axis=2), made, assumed)

    def covariance(self, gain: Array) -> NDArray[np.complex128]:
        """Of the loads by an estimator (lines, loads, rank), beyond what the weights held."""
        A, U = gain @ self.reduced, gain @ self.moved
        more = (A * (self.made - self.assumed)[:, None, :]) @ A.conj().swapaxes(1, 2)
        return np.asarray(more + U @ U.conj().swapaxes(1, 2))

    def variance(self, gain: Array, *, beyond: bool = False) -> NDArray[np.float64]:
        """Of the loads, all of it or beyond what the weights held, (lines, loads)."""
        data = self.made - self.assumed if beyond else self.made
        A = gain @ self.reduced
        return np.asarray(((A.real**2 + A.imag**2) @ data[..., None])[..., 0] + _square(gain @ self.moved))


def _expected(lines: Compressed, w: Array, power: Array, found: Discrepancy) -> NDArray[np.float64]:
    """Variance of what no load explains, (lines,), with errors of the FRF as a fair model has them."""
    assert lines.Q is not None
    entries, shift = found.fair
    total = power + np.einsum("ksj,kj->ks", entries, found.load)
    moved = shift * w[..., None] * np.sqrt(np.tile(found.load, found.nodes))[:, None, :]
    inside = lines.Q.conj().swapaxes(1, 2) @ moved
    left = 1 - np.sum(np.abs(lines.Q) ** 2, axis=2)
    along = np.sum(np.abs(moved) ** 2, axis=(1, 2)) - np.sum(np.abs(inside) ** 2, axis=(1, 2))
    return np.asarray((np.sum(left * w**2 * total, axis=1) + along) / lines.left)


def _square(load: Array) -> NDArray[np.float64]:
    return np.asarray(np.einsum("kjn,kjn->kj", load.conj(), load).real)


def calibrated(lines: Compressed, size: Array) -> tuple[Compressed, Callable[[Array], Array]]:
    """The FRF that is expected given the measured one, and the share of its errors that stays.

    Errors of an FRF make its small singular values too large, on average by the number of sensors times their variance,
    and the loads in these directions too small: attenuation. The expected FRF, with the rows of a line drawn from what
    the line shows less its errors, has ``(s^2 - 1)+ / s`` in place of each singular value s over those of the errors.
    Regression calibration: Carroll, Ruppert, Stefanski & Crainiceanu, Measurement Error in Nonlinear Models, 2006,
    ch. 4.

    Parameters
    ----------
    lines : Compressed
    size : array, shape (lines, loads)
        Variance of each column of the whitened FRF, summed over the sensors.
    """
    root = np.sqrt(np.maximum(size, 1e-30 * np.max(size, axis=1, keepdims=True) + 1e-300))
    U, s, Vh = np.linalg.svd(lines.scaled(1 / root).R, full_matrices=False)
    kept = np.maximum(1 - 1 / np.maximum(s, 1e-150) ** 2, 0.0)
    R = (U * (s * kept)[:, None, :]) @ (Vh * root[:, None, :])

    def share(second: Array) -> NDArray[np.float64]:
        T = Vh * root[:, None, :]
        q = np.einsum("krj,kji,kri->kr", T, second, T.conj()).real
        return np.asarray(np.sum(kept * q, axis=1) / np.maximum(np.sum(q, axis=1), 1e-300))

    return Compressed(R, lines.b, lines.outside, lines.left, lines.Q), share


def _refuse_lost(lines: Compressed) -> None:
    if not np.any(lines.R):
        raise NotIdentifiable(
            "the errors of the FRF are larger than the FRF: no line tells any load",
            advice="average longer, check the units of variance=, or leave it out where it is not believed",
            code="LID-E306",
        )


Solved = tuple[LinePosterior, Array, Array, LinesPath, float]


def _pooled(f: FactoredLines, guess: LinePrior, answer: LinePosterior) -> Solved:
    path = LinesPath(f)
    lam = np.sqrt(guess.noise) / np.maximum(path.scale, 1e-300)
    return answer, guess.noise, lam, path, float(np.sqrt(np.median(guess.noise)))


def _ruled(lines: Compressed, f: FactoredLines, guess: LinePrior, rule: LineRule, known: bool) -> Solved:
    """A named rule or a given lambda: one penalty |g / size|^2 for all loads of a line."""
    size = _sizes(lines, rule.size)
    plain = factor(lines, np.broadcast_to(size**2, lines.R.shape[::2]))
    path = LinesPath(plain, rule.method == "tsvd")
    lam = _lambda(path, rule, known)
    absolute = _absolute(lam, np.asarray(path.scale))
    used = float(np.median(absolute))
    if rule.free:
        return posterior(f, guess.noise, np.zeros(len(lam))), guess.noise, lam, path, used
    cut = absolute if rule.method == "tsvd" else None
    answer = posterior(plain, absolute**2 if cut is None else guess.noise, cut)
    noise = guess.noise if known else _noise(lines, answer, rule)
    scale = noise / np.maximum(absolute**2, 1e-300) if cut is None else np.ones(len(noise))
    covariance = answer.covariance * scale[:, None, None]
    if cut is not None:  # what was left out is as large as the loads around the line
        covariance = posterior(f, noise, _matching(f, answer)).covariance
    return LinePosterior(answer.gain, answer.load, covariance, answer.edf), noise, lam, path, used


def _lambda(path: LinesPath, rule: LineRule, known: bool) -> NDArray[np.float64]:
    lines = len(path.c)
    if rule.count is not None:
        k = min(rule.count, path.c.shape[1]) - 1
        return path.c[:, k] / np.maximum(path.scale, 1e-300)
    sigma = 1.0 if known else None
    if rule.choice is None:  # truncation where the directions are noise
        return rules.lines("gcv", Sweep.over(path, sigma, mean=window(lines, rule.neighbours)[0]))
    if not is_rule(rule.choice):
        given = real(rule.choice) or 0.0
        if rule.over == "band":  # one absolute lambda
            return np.asarray(given * path.scale.max() / np.maximum(path.scale, 1e-300))
        return np.full(lines, given)
    if rule.over == "band":
        joined = path.joined()
        found = rules.run(rule.choice, Sweep.over(joined, sigma, LINE_POINTS))
        return rules.answered(found) * joined.scale / np.maximum(path.scale, 1e-300)
    near = rule.neighbours if rule.over == "neighbours" else 0
    return rules.lines(rule.choice, Sweep.over(path, sigma, mean=window(lines, near)[0]))


def _absolute(lam: Array, scale: Array) -> NDArray[np.float64]:
    """Lambda of every line in the units of its singular values; one that no load reaches takes that of the others."""
    reached = scale > 0
    absolute = np.maximum(lam, SMALLEST) * scale
    return np.where(reached, absolute, np.median(absolute[reached]))


def _sizes(lines: Compressed, given: ArrayLike | None) -> NDArray[np.float64]:
    """Relative size of the loads: as given, or what each needs to move the sensors as much as the others."""
    loads = lines.shape[2]
    if given is None:
        strength = np.sqrt(np.mean(np.einsum("kij,kij->kj", lines.R.conj(), lines.R).real, axis=0))
        return np.where(strength > 0, strength.max() / np.where(strength > 0, strength, 1.0), 1.0)
    size = reals(given, what="the sizes are no real numbers", where="size")
    if size.shape != (loads,) or not np.all(np.isfinite(size)) or np.any(size <= 0):
        raise InputError("the sizes do not fit the loads", where="size", found=f"shape {size.shape}",
                         expected=f"({loads},), positive")  # fmt: skip
    return size


def _noise(lines: Compressed, answer: LinePosterior, rule: LineRule) -> NDArray[np.float64]:
    """Variance of the whitened noise that the residual of neighbouring lines shows."""
    rest = lines.b - lines.R @ answer.load
    left = np.maximum(lines.shape[1] + lines.left - answer.edf, 0.0)
    near, _ = window(len(lines.R), max(rule.neighbours, POOL))
    energy = np.einsum("kin,kin->k", rest.conj(), rest).real + lines.outside
    return np.maximum(near(energy) / np.maximum(near(left), 0.2), 1e-300)


def _matching(f: FactoredLines, answer: LinePosterior) -> NDArray[np.float64]:
    """Threshold over the loads of expected size that keeps as many directions as the answer has."""
    kept = np.clip(np.round(answer.edf).astype(int), 0, f.s.shape[1])
    walled = np.concatenate([np.full((len(kept), 1), np.inf), f.s], axis=1)
    return np.asarray(walled[np.arange(len(kept)), kept])


def _alone(shown: Array, errors: Array) -> NDArray[np.float64]:
    """Noise of the response: what the data show, less what FRF errors explain of it."""
    return np.asarray(np.maximum(shown - errors, LEAST * shown))


def _beyond(answer: LinePosterior, noise: Array) -> NDArray[np.float64]:
    """Variance of the loads that noise does not make, (lines, loads)."""
    if answer.gain.ndim != 3:  # least squares have no prior
        return np.zeros(answer.variance.shape)
    made = noise[:, None] * np.sum(np.abs(answer.gain) ** 2, axis=2)
    return np.asarray(np.maximum(answer.variance - made, 0.0))


ASKED = ("discrepancy", "upre", "gcv", "robust_gcv", "l_curve", "quasi_optimality", "evidence")
VOICES = ("upre", "gcv", "robust_gcv", "evidence")
MODES = 4096  # of the lines, evenly chosen, that are asked
POINTS = 49


def judged(fit: LineFit, rule: LineRule, known: bool, source: NoiseSource) -> Choice:
    """The lambda in use beside what each rule says of all lines together.

    Notes
    -----
    The lines are weighted by the expected size of their loads, so that noise over load is the same number everywhere:
    the lambda of the joined lines is comparable with that of the neighbours' evidence.
    """
    step = max(1, -(-fit.path.c.size // MODES))
    joined = fit.path.joined(step)
    sweep = Sweep.over(joined, 1.0 if known else None, POINTS)
    asked = {name: rules.run(name, sweep) for name in ASKED}
    used = fit.used / float(joined.scale)
    name = _name(rule)
    if name == "given":
        spread, verdict, odds = 0.0, "not asked", "lambda was given: no rule decided"
    else:
        spread, verdict = _agreement(asked, used)
        odds = f"{MEANING[verdict]}; how often that goes well was not measured for frequency lines"
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
        sweep=PathCurve.of(sweep),
    )


def _name(rule: LineRule) -> str:
    if rule.pooled:
        return "evidence"
    if is_rule(rule.choice):
        return rules.name_of(rule.choice)
    return "gcv" if rule.choice is None and rule.count is None else "given"


def _agreement(asked: dict[str, RuleResult], used: float) -> tuple[float, str]:
    """Spread in decades between the lambda in use and the rules that have an optimum inside, and the verdict.

    The L-curve and quasi-optimality have no voice: over thousands of lines of equal strength the first has no sharp
    corner, and the second ends at the edge.
    """
    inside = (asked[name] for name in VOICES)
    lams = [r.lam for r in inside if r.lam is not None and not r.edge]
    if not lams or used <= 0:
        return float("inf"), GRADES[-1]
    spread = float(np.ptp(np.log10([used, *lams])))
    return spread, GRADES[int(np.searchsorted(LIMITS, spread, side="right"))]
