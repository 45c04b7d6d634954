"""How far from the best lambda each rule ends. `python -m tests.benchmarks.rules [DRAWS]`.

Seven classic problems, n = 32, 64, 200; noise of 1e-2, 1e-3, 1e-4; L = I, first and second difference; DRAWS (50) noise
draws each, white, AR(1) with 0.9 and interpolated from every second sample: 28 350 cases. Ratio of the load error to
the smallest error over all lambdas: median / 90 % / share above 3, without and with the noise level known; then the
same in each grade of the verdict. Two processes; about ten minutes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import Pool

import numpy as np
from numpy.typing import NDArray

from loadid._inverse import penalties, rules
from loadid._inverse.agreement import GRADES
from loadid._inverse.choice import decide
from loadid.paths import Choice, LinearProblem, SVDPath

from .fredholm import NOISES, PROBLEMS

SIZES = (32, 64, 200)
LEVELS = (1e-2, 1e-3, 1e-4)
PENALTIES = ("identity", "first_difference", "second_difference")


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


def drawn(setting: Setting, draws: int, kind: str, levels: tuple[float, ...] = LEVELS) -> Iterator[Case]:
    """Draws of one setting."""
    path, load, clean = setting.factorised()
    path.mode_lines  # noqa: B018 - computed once, shared by all draws
    for level in levels:
        sigma = level * float(np.sqrt(np.mean(clean**2)))
        for draw in range(draws):
            seed = [*map(ord, f"{setting}{kind}"), round(1 / level), draw]
            noise = NOISES[kind](np.random.default_rng(seed), setting.n)
            yield Case(setting, level, kind, path.with_data(clean + sigma * noise), load, sigma)


def _ratios(case: Case, sweep: rules.Sweep, told: dict[str, rules.RuleResult]) -> tuple[dict[str, float], Choice]:
    asked = {name: told.get(name) or rules.run(name, sweep) for name in rules.RULES}
    chosen = decide(sweep, None, dict(asked), "unloaded record" if sweep.sigma else "not known")
    lams = {r.rule: r.lam for r in asked.values() if r.lam is not None} | {"default": chosen.lam}
    error = case.errors(np.array(list(lams.values())))
    best = min(case.best(), error.min())
    return dict(zip(lams, error / best, strict=True)), chosen


@dataclass(frozen=True)
class Outcome:
    """One case with and without its noise level: ratios of the rules, verdicts, and whether correlation was seen."""

    case: tuple[str, int, str, float, str]
    ratio: dict[bool, dict[str, float]]
    verdict: dict[bool, str]
    correlated: dict[bool, bool]


NEED_SIGMA = ("discrepancy", "dof_discrepancy", "upre", "predicted_error", "evidence")


def outcomes(job: tuple[Setting, int, str], levels: tuple[float, ...] = LEVELS) -> list[Outcome]:
    """All draws of one setting and kind of noise."""
    setting, draws, kind = job
    found = []
    for case in drawn(setting, draws, kind, levels):
        known = rules.Sweep.over(case.path, case.sigma)
        free = rules.Sweep(known.path, known.lam, known.point, None)
        told = {name: rules.run(name, free) for name in rules.RULES if name not in NEED_SIGMA}
        both = {True: _ratios(case, known, told), False: _ratios(case, free, told)}
        name = (setting.problem, setting.n, setting.penalty, case.level, kind)
        found.append(
            Outcome(
                name,
                {k: ratio for k, (ratio, _) in both.items()},
                {k: chosen.verdict for k, (_, chosen) in both.items()},
                {k: chosen.correlated for k, (_, chosen) in both.items()},
            )
        )
    return found


# -- tables ----------------------------------------------------------------------------------------------------------
def line(values: Sequence[float]) -> str:
    """Median / 90 % / share above 3."""
    x = np.array(values)
    return f"{np.median(x):6.2f} /{np.quantile(x, 0.9):8.3g} /{np.mean(x > 3):6.1%}" if len(x) else " " * 25


def by_rule(found: list[Outcome], known: bool) -> None:
    """Print one line for each rule."""
    print(f"\nnoise level {'known' if known else 'not known'}: median / 90 % / above 3x")
    print(" " * 20 + "".join(f"{kind:^29s}" for kind in NOISES))
    for rule in ("default", *rules.RULES):
        if not known and rule in ("discrepancy", "dof_discrepancy", "upre"):
            continue
        cells = [
            [o.ratio[known][rule] for o in found if o.case[4] == kind and rule in o.ratio[known]] for kind in NOISES
        ]
        print(f"  {rule:18s}" + "".join(f"{line(c):29s}" for c in cells))


def by_verdict(found: list[Outcome], known: bool) -> None:
    """Print the shares and odds of the verdicts, and the lines that `loadid._inverse.rules` holds."""
    groups = {"white": [o for o in found if o.case[4] == "white"], "smooth": [o for o in found if o.case[4] != "white"]}
    for name, group in groups.items():
        flagged = [o.verdict[known] in GRADES[2:] for o in group]
        lost = [o.ratio[known]["default"] > 3 for o in group]
        caught = np.mean([f for f, bad in zip(flagged, lost, strict=True) if bad])
        seen = np.mean([o.correlated[known] for o in group])
        print(
            f"  {name:6s} flagged {np.mean(flagged):.1%}, of the defaults above 3x {caught:.1%}; correlated {seen:.1%}"
        )
    lost = [o.verdict[known] in GRADES[2:] for o in found if o.ratio[known]["default"] > 3]
    print(f"  of all defaults above 3x flagged {np.mean(lost):.1%}")
    for grade in GRADES:
        cells = []
        for group in groups.values():
            x = np.array([o.ratio[known]["default"] for o in group if o.verdict[known] == grade])
            share = len(x) / len(group)
            cells.append(f"Odds({share:.3f}, {np.median(x):.2f}, {np.quantile(x, 0.9):.3g}, {np.mean(x > 3):.3f})")
        print(f'    ("{grade}", {known}): ({cells[0]}, {cells[1]}),')


def by_problem(found: list[Outcome], known: bool) -> None:
    """Print the default on white noise for each problem and penalty."""
    print("  default, white noise")
    for name in PROBLEMS:
        cells = [
            [o.ratio[known]["default"] for o in found if o.case[0] == name and o.case[2] == L and o.case[4] == "white"]
            for L in PENALTIES
        ]
        print(f"  {name:10s}" + "".join(f"{line(c):29s}" for c in cells))


def main(draws: int) -> None:
    """Run and print everything."""
    jobs = [
        (Setting(p, n, L), draws, kind) for n in SIZES[::-1] for p in PROBLEMS for L in PENALTIES for kind in NOISES
    ]
    with Pool(2) as pool:
        found = [o for part in pool.imap_unordered(outcomes, jobs) for o in part]
    print(f"{len(found)} cases")
    for known in (False, True):
        by_rule(found, known)
        by_verdict(found, known)
        by_problem(found, known)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50)
