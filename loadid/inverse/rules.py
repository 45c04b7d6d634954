"""Rules that choose lambda. A rule sees a path and nothing else, and refuses by name what the path cannot give.

Formulas: Hansen, Rank-Deficient and Discrete Ill-Posed Problems, SIAM 1998 (discrepancy, L-curve, GCV,
quasi-optimality); Lukas, Inverse Problems 22 (2006) 1883 (robust GCV); Mallows, Technometrics 15 (1973) 661 (UPRE);
Rust & O'Leary, Inverse Problems 24 (2008) 034005 (NCP); MacKay, Neural Computation 4 (1992) 415 (evidence).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .path import PathPoint, RegularizationPath

CHANCE = 1e-3  # a residual that is smaller than this share of all noise would leave is not believed to be chance
EDGE = 3  # points of the sweep that count as its end
LONGEST_NCP = 300_000  # data; beyond, one transform for each lambda costs more than all other rules together


@dataclass(frozen=True)
class RuleResult:
    """What one rule said.

    Parameters
    ----------
    rule : str
        Name.
    lam : float or None
        Relative lambda (lambda over the scale of the problem); None when the rule refused.
    edge : bool
        The answer sits at an end of the sweep.
    note : str
        Why it refused, or what is odd about it.
    """

    rule: str
    lam: float | None
    edge: bool = False
    note: str = ""


class Refusal(Exception):
    """A rule cannot run on this path; the text says why."""


@dataclass(frozen=True)
class Sweep:
    """A path evaluated over a grid of relative lambdas (one problem, not a stack)."""

    path: RegularizationPath
    lam: NDArray[np.float64]
    point: PathPoint
    sigma: float | None

    @classmethod
    def over(cls, path: RegularizationPath, sigma: float | None, points: int = 121) -> Sweep:
        """Evaluate `path` over its range."""
        low, high = path.range
        lam = np.geomspace(low, high, points)
        return cls(path, lam, path.at(lam), sigma)


def need(point: PathPoint, name: str, rule: str) -> NDArray:
    """One ingredient of a rule, or the rule's refusal."""
    value = getattr(point, name)
    if value is None:
        raise Refusal(f"{rule} needs {name}, which this path does not define")
    return value


def need_sigma(sweep: Sweep, rule: str) -> float:
    """Noise level, or the rule's refusal."""
    if sweep.sigma is None:
        raise Refusal(f"{rule} needs the noise level")
    return sweep.sigma


# -- functions that are minimised ------------------------------------------------------------------------------------
def gcv_function(path: RegularizationPath, p: PathPoint) -> NDArray:
    """G = m |r|^2 / (m - edf)^2."""
    left = need(p, "left", "gcv")
    return path.m * p.residual2 / np.where(left > 0, left, np.nan) ** 2


def robust_gcv_function(path: RegularizationPath, p: PathPoint, gamma: float = 0.1) -> NDArray:
    """[gamma + (1 - gamma) tr A^2 / m] G, Lukas (2006)."""
    return (gamma + (1 - gamma) * need(p, "edf2", "robust_gcv") / path.m) * gcv_function(path, p)


def modified_gcv_function(path: RegularizationPath, p: PathPoint, a: float = 1.4) -> NDArray:
    """G with a edf in place of edf, only where m > a edf."""
    left = path.m - a * need(p, "edf", "modified_gcv")
    return path.m * p.residual2 / np.where(left > 0, left, np.nan) ** 2


def gcv(sweep: Sweep) -> RuleResult:
    """Generalised cross-validation."""
    return _minimum("gcv", sweep, lambda p: gcv_function(sweep.path, p))


def robust_gcv(sweep: Sweep) -> RuleResult:
    """Robust generalised cross-validation."""
    return _minimum("robust_gcv", sweep, lambda p: robust_gcv_function(sweep.path, p))


def modified_gcv(sweep: Sweep) -> RuleResult:
    """Modified generalised cross-validation."""
    return _minimum("modified_gcv", sweep, lambda p: modified_gcv_function(sweep.path, p))


def upre(sweep: Sweep) -> RuleResult:
    """Unbiased predictive risk estimate |r|^2 + 2 sigma^2 edf."""
    sigma = need_sigma(sweep, "upre")
    return _minimum("upre", sweep, lambda p: p.residual2 + 2 * sigma**2 * need(p, "edf", "upre"))


def quasi_optimality(sweep: Sweep) -> RuleResult:
    """Smallest change of the load with ln lambda, above the smallest generalised singular value.

    Below it the load no longer changes whatever the data, so that the smallest change there says nothing.
    """
    need(sweep.point, "sensitivity", "quasi_optimality")
    return _minimum(
        "quasi_optimality",
        _above_modes(sweep, "quasi_optimality"),
        lambda p: need(p, "sensitivity", "quasi_optimality"),
    )


def _above_modes(sweep: Sweep, rule: str, share: float = 1.0) -> Sweep:
    """The sweep without what lies below a share of the smallest generalised singular value that rounding leaves."""
    modes = sweep.path.coefficients
    if modes is None:
        return sweep
    relative = modes.gamma / modes.gamma.max()
    floor = 10 * np.finfo(float).eps * np.sqrt(len(relative))
    keep = sweep.lam >= share * np.min(relative[relative > floor], initial=1.0)
    if np.sum(keep) < 3:
        raise Refusal(f"{rule} needs singular values that differ")
    p = sweep.point
    fields = {name: None if value is None else value[keep] for name, value in vars(p).items()}
    return Sweep(sweep.path, sweep.lam[keep], PathPoint(**fields), sweep.sigma)  # type: ignore[arg-type]


def evidence(sweep: Sweep) -> RuleResult:
    """Largest marginal likelihood; with the noise level where it is known, else free of it."""
    path, sigma = sweep.path, sweep.sigma

    def negative(p: PathPoint) -> NDArray:
        J, ratio = need(p, "objective", "evidence"), need(p, "log_ratio", "evidence")
        return ratio + (J / sigma**2 if sigma is not None else (path.m - path.null) * _log(J))

    return _minimum("evidence", sweep, negative)


def predicted_error(sweep: Sweep) -> RuleResult:
    """Smallest predicted error of the load itself: one parametric-bootstrap step from a pilot that GCV vouches for.

    The other rules aim at the response; the load wants more regularisation where its fine detail costs much noise.
    Faraway & Jhun, J. Am. Stat. Assoc. 85 (1990) 1119, for the bootstrap choice of a smoothing parameter.
    """
    path, k = sweep.path, _pilot(sweep)
    if k == 0:
        return RuleResult("predicted_error", float(sweep.lam[0]), note="the data ask for no regularisation")
    start, left = float(sweep.lam[k]), need(sweep.point, "left", "predicted_error")
    sigma = sweep.sigma or float(np.sqrt(sweep.point.residual2[k] / left[k]))

    def error(lam: NDArray) -> NDArray:
        value = path.predicted_error(lam, start, sigma)
        if value is None:
            raise Refusal("predicted_error is not defined on this path")
        return value

    return _search("predicted_error", sweep, error)


def _pilot(sweep: Sweep) -> int:
    """Point of the sweep at a minimum of robust GCV or GCV that is no stroke of chance.

    The residual of a fit that leaves few degrees of freedom may be small by chance, and its minimum then wins. So the
    search starts at the largest lambda, and moves to a minimum at a smaller one only where the noise level that it
    shows, |r|^2 / tr (I - A)^2, is below what `CHANCE` makes of the level before (chi-square with the freedom of
    Satterthwaite, (tr (I - A)^2)^2 / tr (I - A)^4).
    """
    from scipy.special import gammaincinv

    path, p = sweep.path, sweep.point
    rest2, rest4 = (np.maximum(need(p, name, "predicted_error"), np.finfo(float).tiny) for name in ("rest2", "rest4"))
    level, freedom = p.residual2 / rest2, np.maximum(rest2**2 / rest4, 1.0)
    found = _dips(robust_gcv_function(path, p)) | _dips(gcv_function(path, p))
    minima = np.flatnonzero(found[:-1])[::-1]
    if len(minima) == 0:
        raise Refusal("predicted_error needs a minimum of robust GCV or GCV inside the sweep")
    k = int(minima[0])
    for j in minima[1:]:
        if level[j] < level[k] * 2 * gammaincinv(freedom[j] / 2, CHANCE) / freedom[j]:
            k = int(j)
    return k


def _dips(value: NDArray) -> NDArray[np.bool_]:
    """Local minima, the ends included."""
    walled = np.concatenate([[np.inf], np.where(np.isfinite(value), value, np.inf), [np.inf]])
    return (walled[1:-1] <= walled[:-2]) & (walled[1:-1] < walled[2:])


# -- rules of another form -------------------------------------------------------------------------------------------
def discrepancy_level(m: float, sigma: float) -> float:
    """Squared residual that noise of this level stays below in 95 % of all cases."""
    from scipy.special import gammaincinv

    return float(sigma**2 * 2 * gammaincinv(m / 2, 0.95))


def discrepancy(sweep: Sweep, factor: float = 1.0) -> RuleResult:
    """Residual equals the noise, with the chi-square margin of a finite record (`factor` scales the noise level)."""
    sigma = need_sigma(sweep, "discrepancy") * factor
    return _crossing("discrepancy", sweep, lambda p: p.residual2 - discrepancy_level(sweep.path.m, sigma))


def dof_discrepancy(sweep: Sweep) -> RuleResult:
    """|r|^2 = sigma^2 (m - edf), its largest crossing."""
    sigma = need_sigma(sweep, "dof_discrepancy")
    return _crossing("dof_discrepancy", sweep, lambda p: p.residual2 - sigma**2 * need(p, "left", "dof_discrepancy"))


def curvature(lam: NDArray, residual2: NDArray, penalty2: NDArray) -> NDArray:
    """Signed curvature of the L-curve (ln |r|, ln |L g|), positive at a corner; same shape as `lam`."""
    t, x, y = np.log(lam), 0.5 * _log(residual2), 0.5 * _log(penalty2)
    dx, dy = np.gradient(x, t), np.gradient(y, t)
    ddx, ddy = np.gradient(dx, t), np.gradient(dy, t)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num((dx * ddy - ddx * dy) / (dx**2 + dy**2) ** 1.5, nan=0.0, posinf=0.0, neginf=0.0)


def _log(x: NDArray) -> NDArray:
    return np.log(np.maximum(x, np.finfo(float).tiny))  # data may be zero throughout


def l_curve(sweep: Sweep) -> RuleResult:
    """Corner of the L-curve: the largest positive curvature away from the ends of the sweep."""
    if not sweep.path.smooth:
        raise Refusal("l_curve needs a path that is smooth in lambda")
    sweep = _above_modes(sweep, "l_curve", 0.03)  # far below all modes the curve is flat, and its bends are rounding
    kappa = curvature(sweep.lam, sweep.point.residual2, sweep.point.penalty2)
    inner = kappa[EDGE:-EDGE]
    if len(inner) == 0 or not np.any(inner > 0):
        raise Refusal("the L-curve has no corner: its curvature is nowhere positive")
    k = int(np.argmax(inner)) + EDGE
    edge = k < 2 * EDGE or k >= len(kappa) - 2 * EDGE
    return RuleResult("l_curve", float(sweep.lam[k]), edge, f"curvature {kappa[k]:.3g}")


def ncp_statistic(residual: NDArray) -> tuple[float, float]:
    """Distance of the cumulated residual periodogram from white noise: (norm, Kolmogorov-Smirnov times sqrt q).

    Parameters
    ----------
    residual : array, shape (samples, sensors)
        Periodograms of several channels are added.
    """
    power = np.sum(np.abs(np.fft.rfft(residual, axis=0)[1:]) ** 2, axis=1)
    q = len(power)
    if q < 2 or power.sum() <= 0:
        raise Refusal("ncp needs a residual with some samples")
    distance = np.cumsum(power) / power.sum() - np.arange(1, q + 1) / q
    return float(np.linalg.norm(distance)), float(np.abs(distance).max() * np.sqrt(q * residual.shape[1]))


def ncp(sweep: Sweep) -> RuleResult:
    """Residual closest to white noise by its normalised cumulative periodogram."""
    if sweep.path.m > LONGEST_NCP:
        raise Refusal(f"ncp is left out beyond {LONGEST_NCP} data")
    picks = np.unique(np.linspace(0, len(sweep.lam) - 1, 41).round().astype(int))
    value = []
    for k in picks:
        residual = sweep.path.residual(float(sweep.lam[k]))
        value.append(ncp_statistic(residual.reshape(len(residual), -1))[0])
    k = int(np.argmin(value))
    return RuleResult("ncp", float(sweep.lam[picks[k]]), k in (0, len(picks) - 1))


RULES: dict[str, Callable[[Sweep], RuleResult]] = {
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
    )
}


def run(name: str, sweep: Sweep) -> RuleResult:
    """Ask one rule; a refusal comes back as a result without a lambda.

    Raises
    ------
    InputError
        If there is no such rule.
    """
    if name not in RULES:
        raise InputError(
            "unknown rule",
            where="choice",
            found=repr(name),
            expected=f"one of {', '.join(RULES)}, or a relative lambda",
        )
    try:
        return RULES[name](sweep)
    except Refusal as why:
        note = str(why)
        return RuleResult(name, None, note=note if name in note else f"{name}: {note}")


# -- one-dimensional searches on the grid ----------------------------------------------------------------------------
def _minimum(name: str, sweep: Sweep, f: Callable[[PathPoint], NDArray]) -> RuleResult:
    """Global minimum of a function of the path's scalars."""
    return _search(name, sweep, lambda lam: f(sweep.point if lam is sweep.lam else sweep.path.at(lam)))


def _search(name: str, sweep: Sweep, f: Callable[[NDArray], NDArray]) -> RuleResult:
    """Global minimum over the sweep, refined between its neighbours where the path is smooth."""
    value = f(sweep.lam)
    if not np.any(np.isfinite(value)):
        raise Refusal(f"{name} is not defined anywhere on this path")
    value = np.where(np.isfinite(value), value, np.inf)
    k = int(np.argmin(value))
    edge = k == 0 or k == len(value) - 1
    lam = float(sweep.lam[k])
    if not edge and sweep.path.smooth:
        a, b = sweep.lam[k - 1], sweep.lam[k + 1]
        for _ in range(2):
            fine = np.geomspace(a, b, 9)
            j = int(np.clip(np.nanargmin(f(fine)), 1, 7))
            lam, a, b = float(fine[j]), fine[j - 1], fine[j + 1]
    return RuleResult(name, lam, edge)


def _crossing(name: str, sweep: Sweep, f: Callable[[PathPoint], NDArray]) -> RuleResult:
    """Largest lambda at which a rising function crosses zero."""
    value = f(sweep.point)
    below = np.flatnonzero(value < 0)
    if len(below) == 0:
        return RuleResult(
            name,
            float(sweep.lam[0]),
            True,
            "the residual stays above the noise: noise level too low, or the model is wrong",
        )
    k = int(below[-1])
    if k == len(value) - 1:
        return RuleResult(name, float(sweep.lam[-1]), True, "the data are within the noise")
    a, b = sweep.lam[k], sweep.lam[k + 1]
    for _ in range(30 if sweep.path.smooth else 0):
        middle = np.sqrt(a * b)
        a, b = (middle, b) if float(f(sweep.path.at(middle))) < 0 else (a, middle)
    return RuleResult(name, float(a))
