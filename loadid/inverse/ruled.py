"""Rules that choose a lambda for every line at once: each function of a path, evaluated over all lines together.

The rules are those of `loadid.inverse.rules`; here the lines stay on the first axis. A rule can be asked of one line
alone, or of the mean over neighbouring lines, which all see the same relative lambda.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.advice import Advice, Option
from structures.errors import InputError

from . import rules
from .path import FactoredPath, PathPoint
from .spectral import Factored, window

POINTS = 41  # of the grid of each line


class LinesPath(FactoredPath):
    """Path of independent frequency lines, L = I over the weighted loads: every scalar has the lines first."""

    def __init__(self, f: Factored, truncated: bool = False) -> None:
        beta = np.sqrt(np.einsum("krn,krn->kr", f.beta.conj(), f.beta).real)
        c = np.where(f.seen, f.s, 0.0)
        m = f.lines.shape[1] + f.lines.left
        super().__init__(c, np.ones_like(c), beta, f.lines.outside, m, truncated=truncated)


class JoinedPath(FactoredPath):
    """All lines with one lambda: the modes of every line side by side."""

    def __init__(self, path: LinesPath, keep: NDArray | slice = slice(None)) -> None:
        c = path.c[keep]
        super().__init__(
            c.ravel(), np.ones(c.size), path.beta[keep].ravel(), np.sum(path.outside[keep]), path.m * len(c),
            truncated=not path.smooth,
        )  # fmt: skip


@dataclass(frozen=True)
class LineSweep:
    """A stacked path over a grid of relative lambdas, (points,) for all lines."""

    path: LinesPath
    lam: NDArray[np.float64]
    point: PathPoint
    sigma: float | None
    smooth: Callable[[NDArray], NDArray[np.float64]]

    @classmethod
    def over(cls, path: LinesPath, sigma: float | None, neighbours: int = 0, points: int = POINTS) -> LineSweep:
        """Evaluate a path over its range; `neighbours` lines to either side share the decision."""
        low, high = path.range
        lam = np.geomspace(max(low, 1e-8), high, points)
        return cls(path, lam, path.at(lam), sigma, window(len(path.c), neighbours)[0])


def choose(name: str, sweep: LineSweep) -> NDArray[np.float64]:
    """Relative lambda of every line (lines,) by one rule.

    Raises
    ------
    InputError
        An unknown rule, one that needs the noise level where it is not known, or one that lines do not allow.
    """
    try:
        if name in FUNCTIONS:
            return _lowest(sweep, sweep.smooth(FUNCTIONS[name](sweep)))
        if name in CROSSINGS:
            return _crossing(sweep, sweep.smooth(CROSSINGS[name](sweep)))
    except rules.Refusal as why:
        raise InputError(f"the rule {name} cannot run here", where="choice", found=str(why),
                         expected="another rule or a relative lambda") from None  # fmt: skip
    known = ", ".join((*FUNCTIONS, *CROSSINGS))
    ask = Advice(Option("over", "band", within="choice=Lambda"), " asks it of all lines together")
    hint = ask if name in rules.RULES else ""
    raise InputError("no rule for single lines", where="choice", found=repr(name), expected=f"one of {known}",
                     hint=hint)  # fmt: skip


def joint_sweep(path: JoinedPath, sigma: float | None, points: int) -> rules.Sweep:
    """Sweep of all lines together, for rules that ask for no residual."""
    return rules.Sweep.over(path, sigma, points)


def together(name: str, path: JoinedPath, sigma: float | None) -> float:
    """One relative lambda for all lines together, by one rule.

    Raises
    ------
    InputError
        As `choose`.
    """
    found = rules.run(name, joint_sweep(path, sigma, POINTS))
    if found.lam is None:
        raise InputError(f"the rule {name} cannot run here", where="choice", found=found.note,
                         expected="another rule or a relative lambda")  # fmt: skip
    return found.lam


def _level(sweep: LineSweep, name: str) -> float:
    if sweep.sigma is None:
        raise InputError(f"the rule {name} needs the noise level", where="choice", found="noise not known",
                         expected="noise=", hint="or choice='robust_gcv'")  # fmt: skip
    return sweep.sigma


def _lowest(sweep: LineSweep, value: NDArray) -> NDArray[np.float64]:
    """Minimum over the grid of each line, between its points by the parabola through three of them."""
    value = np.where(np.isfinite(value), value, np.inf)
    k = np.argmin(value, axis=1)
    if not sweep.path.smooth:
        return sweep.lam[k]
    inner = np.clip(k, 1, len(sweep.lam) - 2)
    rows = np.arange(len(value))
    a, b, c = (value[rows, inner + d] for d in (-1, 0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = a - 2 * b + c
        move = np.where((k == inner) & (bend > 0) & np.isfinite(bend), 0.5 * (a - c) / bend, 0.0)
    step = np.log(sweep.lam[1] / sweep.lam[0])
    return sweep.lam[k] * np.exp(np.clip(move, -0.5, 0.5) * step)


def _crossing(sweep: LineSweep, value: NDArray) -> NDArray[np.float64]:
    """Largest lambda at which a rising function is below zero, between two points by their chord."""
    below = value < 0
    last = value.shape[1] - 1
    k = np.where(below.any(axis=1), last - np.argmax(below[:, ::-1], axis=1), 0)
    rows, after = np.arange(len(value)), np.minimum(k + 1, last)
    a, b = value[rows, k], value[rows, after]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where((a < 0) & (b > a), np.clip(-a / (b - a), 0.0, 1.0), 0.0)
    return sweep.lam[k] * (sweep.lam[after] / sweep.lam[k]) ** share


def _evidence(sweep: LineSweep) -> NDArray[np.float64]:
    p = sweep.point
    objective, ratio = rules.need(p, "objective", "evidence"), rules.need(p, "log_ratio", "evidence")
    if sweep.sigma is not None:
        return ratio + objective / sweep.sigma**2
    return ratio + sweep.path.m * rules.log(objective)


def _predicted(sweep: LineSweep) -> NDArray[np.float64]:
    pilot = _lowest(sweep, sweep.smooth(rules.robust_gcv_function(sweep.path, sweep.point)))
    k = np.clip(np.searchsorted(sweep.lam, pilot), 0, len(sweep.lam) - 1)
    rows = np.arange(len(k))
    p = sweep.point
    assert p.left is not None
    sigma = np.sqrt(p.residual2[rows, k] / np.maximum(p.left[rows, k], 1e-12)) if sweep.sigma is None else sweep.sigma
    return sweep.path.predicted_error(sweep.lam, pilot[:, None], np.asarray(sigma)[..., None])  # type: ignore[arg-type]


def _quasi(sweep: LineSweep) -> NDArray[np.float64]:
    """Change of the load with ln lambda, among the singular values of each line: beyond them it says nothing."""
    change = rules.need(sweep.point, "sensitivity", "quasi_optimality")
    gamma = sweep.path.gamma / np.maximum(sweep.path.scale, 1e-300)[:, None]
    low = np.min(np.where(gamma > 0, gamma, np.inf), axis=1, initial=1.0)
    return np.where(sweep.lam >= low[:, None], change, 1e3 * change.max())


def _corner(sweep: LineSweep) -> NDArray[np.float64]:
    if not sweep.path.smooth:
        raise rules.Refusal("l_curve needs a path that is smooth in lambda")
    p = sweep.point
    value = -rules.curvature(sweep.lam, p.residual2, p.penalty2, p.bend, np.asarray(sweep.path.scale)[:, None])
    value[:, :2] = value[:, -2:] = np.inf
    return value


FUNCTIONS: dict[str, Callable[[LineSweep], NDArray]] = {
    "gcv": lambda s: rules.gcv_function(s.path, s.point),
    "robust_gcv": lambda s: rules.robust_gcv_function(s.path, s.point),
    "modified_gcv": lambda s: rules.modified_gcv_function(s.path, s.point),
    "upre": lambda s: s.point.residual2 + 2 * _level(s, "upre") ** 2 * rules.need(s.point, "edf", "upre"),
    "predicted_error": _predicted,
    "quasi_optimality": _quasi,
    "evidence": _evidence,
    "l_curve": _corner,
}


def _complex_level(m: int, sigma: float, margin: float = 0.95) -> float:
    """Squared residual that complex noise of this level stays below in `margin` of all cases."""
    from scipy.special import gammaincinv

    return float(sigma**2 * gammaincinv(m, margin))


CROSSINGS: dict[str, Callable[[LineSweep], NDArray]] = {
    "discrepancy": lambda s: s.point.residual2 - _complex_level(s.path.m, _level(s, "discrepancy")),
    "dof_discrepancy": lambda s: (
        s.point.residual2 - _level(s, "dof_discrepancy") ** 2 * rules.need(s.point, "left", "dof_discrepancy")
    ),
}
