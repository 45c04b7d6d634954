"""How far from the best lambda each rule ends. `python -m tests.benchmarks.rules [DRAWS]`.

Seven classic problems, n = 32, 64, 200; noise of 1e-2, 1e-3, 1e-4; L = I, first and second difference; DRAWS (50) noise
draws each, white, AR(1) with 0.9 and interpolated from every second sample: 28 350 cases. Ratio of the load error to
the smallest error over all lambdas: median / 90 % / share above 3, without and with the noise level known; then the
same in each grade of the verdict. Two processes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loadid.inverse import penalties, rules
from loadid.inverse.choice import Choice, choose
from loadid.inverse.problem import LinearProblem
from loadid.inverse.svd import SVDPath

from .fredholm import NOISES, PROBLEMS

SIZES = (32, 64, 200)
LEVELS = (1e-2, 1e-3, 1e-4)
PENALTIES = ("identity", "first_difference", "second_difference")
GRADES = ("determined", "usable", "rules disagree", "not determined")


@dataclass(frozen=True)
class Setting:
    """One problem, size and penalty: factorised once, then any number of draws."""

    problem: str
    n: int
    penalty: str

    def factorised(self) -> tuple[SVDPath, NDArray, NDArray]:
        """Path without noise, load, clean data."""
        H, load = PROBLEMS[self.problem](self.n)
        L = None if self.penalty == "identity" else penalties.matrix(self.penalty, self.n)
        clean = H @ load
        return SVDPath(LinearProblem.whitened(H, clean, L=L)), load, clean


@dataclass(frozen=True)
class Case:
    """One noisy draw of one problem."""

    setting: Setting
    level: float
    kind: str
    path: SVDPath
    load: NDArray[np.float64]
    sigma: float

    def errors(self, lam: NDArray) -> NDArray[np.float64]:
        """Relative load error at each lambda."""
        path = self.path
        f, _ = path._filter(np.atleast_1d(np.asarray(lam, float)))
        per = np.divide(path.beta, path.c, out=np.zeros(path.c.shape), where=path.c > 0)
        return np.linalg.norm((f * per) @ path.X.T - self.load, axis=1) / np.linalg.norm(self.load)

    def best(self) -> float:
        """Smallest error over a fine grid of lambdas that reaches beyond the range of the rules."""
        low, _ = self.path.range
        return float(self.errors(np.geomspace(0.1 * low, 1e3, 200)).min())


def cases(
    draws: int, kind: str = "white", *, sizes: tuple[int, ...] = SIZES, levels: tuple[float, ...] = LEVELS,
    kept: tuple[str, ...] = PENALTIES, problems: tuple[str, ...] = tuple(PROBLEMS),
) -> Iterator[Case]:  # fmt: skip
    """Every setting and noise level, `draws` draws of each; every draw has its own noise."""
    for setting in (Setting(p, n, L) for p in problems for n in sizes for L in kept):
        yield from drawn(setting, draws, kind, levels)


def drawn(setting: Setting, draws: int, kind: str, levels: tuple[float, ...] = LEVELS) -> Iterator[Case]:
    """Draws of one setting."""
    path, load, clean = setting.factorised()
    for level in levels:
        sigma = level * float(np.sqrt(np.mean(clean**2)))
        for draw in range(draws):
            seed = [*map(ord, f"{setting}{kind}"), round(1 / level), draw]
            noise = NOISES[kind](np.random.default_rng(seed), setting.n)
            yield Case(setting, level, kind, path.with_data(clean + sigma * noise), load, sigma)


def ratios(case: Case, known: bool) -> tuple[dict[str, float], Choice]:
    """Error over the best error, for every rule that answered and for the default choice."""
    sigma = case.sigma if known else None
    chosen = choose(case.path, sigma=sigma, source="unloaded record" if known else "not known")
    sweep = rules.Sweep.over(case.path, sigma)
    more = [rules.run(name, sweep) for name in rules.RULES if name not in {r.rule for r in chosen.rules}]
    lams = {r.rule: r.lam for r in (*chosen.rules, *more) if r.lam is not None} | {"default": chosen.lam}
    error = case.errors(np.array(list(lams.values())))
    best = min(case.best(), error.min())
    return dict(zip(lams, error / best, strict=True)), chosen
