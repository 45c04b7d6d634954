"""How far from the best lambda each rule ends. `python -m tests.benchmarks.rules [SEEDS]`.

Seven classic problems, n = 64, white noise of 1e-2 and 1e-3, L = I and first difference. Ratio of the load error to the
smallest error over all lambdas: median / 90 % / share above 3, without and with the noise level known; then the same in
each grade of the verdict.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loadid.inverse import penalties, rules
from loadid.inverse.choice import Choice, choose
from loadid.inverse.problem import LinearProblem
from loadid.inverse.svd import SVDPath

from .fredholm import PROBLEMS

NOISE = (1e-2, 1e-3)
PENALTIES = ("identity", "first_difference")


@dataclass(frozen=True)
class Case:
    """One noisy draw of one problem."""

    name: str
    H: NDArray[np.float64]
    load: NDArray[np.float64]
    y: NDArray[np.float64]
    sigma: float
    penalty: str

    def path(self) -> SVDPath:
        """Path of the case, data as recorded."""
        L = penalties.matrix(self.penalty, len(self.load))
        return SVDPath(LinearProblem.whitened(self.H, self.y, L=L))

    def errors(self, path: SVDPath, lam: NDArray) -> NDArray[np.float64]:
        """Relative load error at each lambda."""
        loads = np.array([path.X @ path.gains(x) for x in np.atleast_1d(lam)])
        return np.linalg.norm(loads - self.load, axis=1) / np.linalg.norm(self.load)


def cases(seeds: int, n: int = 64) -> Iterator[Case]:
    """All problems, noise levels and penalties, `seeds` draws of each; every draw has its own noise."""
    count = 0
    for name, build in PROBLEMS.items():
        H, load = build(n)
        clean = H @ load
        for level in NOISE:
            sigma = level * float(np.sqrt(np.mean(clean**2)))
            for penalty in PENALTIES:
                for _ in range(seeds):
                    count += 1
                    noise = np.random.default_rng(count).standard_normal(n)
                    yield Case(name, H, load, clean + sigma * noise, sigma, penalty)


def ratios(case: Case, known: bool) -> tuple[dict[str, float], Choice]:
    """Error over the best error, for every rule that answered and for the default choice."""
    path = case.path()
    chosen = choose(path, sigma=case.sigma if known else None)
    sweep = rules.Sweep.over(path, case.sigma if known else None)
    more = [rules.run(name, sweep) for name in rules.RULES if name not in {r.rule for r in chosen.rules}]
    lams = {r.rule: r.lam for r in (*chosen.rules, *more) if r.lam is not None} | {"default": chosen.lam}
    error = case.errors(path, np.array(list(lams.values())))
    best = min(case.errors(path, np.geomspace(*path.range, 150)).min(), error.min())
    return dict(zip(lams, error / best, strict=True)), chosen


def line(values: list[float]) -> str:
    """Median / 90 % / share above 3."""
    x = np.array(values)
    return f"{np.median(x):8.3g} / {np.quantile(x, 0.9):8.3g} / {np.mean(x > 3):6.1%}"


def table(seeds: int, known: bool) -> None:
    """Print the tables."""
    by_rule: dict[str, list[float]] = defaultdict(list)
    by_grade: dict[str, list[tuple[float, float]]] = defaultdict(list)
    worst: dict[tuple[str, str], list[float]] = defaultdict(list)
    total = 0
    for case in cases(seeds):
        ratio, chosen = ratios(case, known)
        total += 1
        for rule, value in ratio.items():
            by_rule[rule].append(value)
        by_grade[chosen.verdict].append((ratio["gcv"], ratio["default"]))
        worst[case.name, case.penalty].append(ratio["default"])
    print(f"\nnoise level {'known' if known else 'not known'}, {total} cases: median / 90 % / above 3x   (answered)")
    for rule, values in by_rule.items():
        print(f"  {rule:18s} {line(values)}   ({len(values) / total:.0%})")
    print("  verdict: share; GCV; default")
    for grade in ("determined", "usable", "rules disagree", "not determined"):
        if pairs := by_grade[grade]:
            gcv, default = zip(*pairs, strict=True)
            print(f"  {grade:18s} {len(pairs) / total:5.0%};  {line(list(gcv))};  {line(list(default))}")
    print("  default by problem and penalty")
    for (name, penalty), values in worst.items():
        print(f"  {name:10s} {penalty:18s} {line(values)}")


if __name__ == "__main__":
    for known in (False, True):
        table(int(sys.argv[1]) if len(sys.argv) > 1 else 20, known)
