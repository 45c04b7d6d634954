"""What `AutomaticInversion` takes beside the plain prior and the best in hindsight: error and cost.

`python -m tests.benchmarks.auto [problems] [seed] [groups ...]`; the criteria were set on seed 60, other seeds judge.

The problems are those of `python -m tests.campaigns`, whose truths have a finer mesh, twice the modes and a finer step:
impacts with and without errors of the model, loads that act throughout (service), static fields, and frequency lines.
Hindsight: the smallest error of the plain prior, a smooth load, first and second differences, B-splines, and loads
that only push. Each line: problems; median error of plain, auto and hindsight; error of auto over plain: median,
worst decile, largest; how often another prior was taken; CPU of auto over plain, median and largest.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from loadid import (
    AutomaticInversion,
    Deconvolution,
    FrequencyInversion,
    InputError,
    NotIdentifiable,
    Penalty,
    SparseDeconvolution,
    StaticInversion,
)
from loadid.constraints import NonNegative
from tests.campaigns import frequency, impacts, static

GROUPS = {
    "impacts": ("none", "gain", "frequency"),
    "service": ("slow", "harmonic", "random", "swept"),
    "static": ("none", "gain"),
    "frequency": ("none",),
}
Row = tuple[float, float, float, float, bool]


def error(load: Any, truth: Any) -> float:
    """Relative error."""
    return float(np.linalg.norm(load - truth) / np.linalg.norm(truth))


def timed(run: Callable[[], Any], truth: Any) -> tuple[Any, float, float]:
    """Answer, its error, CPU seconds."""
    begun = time.process_time()
    found = run()
    return found, error(found.load, truth), time.process_time() - begun


def histories(kind: str, number: int, others: bool) -> Row:
    """One record of `tests.campaigns.impacts`."""
    p = impacts.problem(number, kind)
    noise = {"noise": p.sigma if p.stated else None}
    _, plain, cost = timed(lambda: Deconvolution(p.model, **noise).estimate(p.record, p.dt), p.truth)
    taken, own, spent = timed(lambda: AutomaticInversion(p.model, **noise).estimate(p.record, p.dt), p.truth)
    known = [plain, own]
    for make in _others(p.model, noise) if others else ():
        try:
            known.append(error(make().estimate(p.record, p.dt).load, p.truth))
        except (InputError, NotIdentifiable):
            continue
    return plain, own, min(known), spent / cost, taken.facts["variance"] == "smooth"


def _others(model: Any, noise: dict[str, Any]) -> Iterator[Callable[[], Any]]:
    yield lambda: Deconvolution(model, penalty=Penalty(variance="smooth"), **noise)
    yield lambda: Deconvolution(model, penalty="first_difference", **noise)
    yield lambda: Deconvolution(model, penalty="second_difference", **noise)
    yield lambda: SparseDeconvolution(model, dictionary="bspline", **noise)
    yield lambda: Deconvolution(model, constraints=[NonNegative()], **noise)


def fields(kind: str, number: int, others: bool) -> Row:
    """One reading of `tests.campaigns.static`."""
    p = static.problem(number, kind)
    noise = {"noise": p.sigma if p.stated else None}
    _, plain, cost = timed(lambda: StaticInversion(p.model, **noise).estimate(p.readings), p.truth)
    taken, own, spent = timed(lambda: AutomaticInversion(p.model, **noise).estimate(p.readings), p.truth)
    known = [plain, own]
    for penalty in ("gradient", "laplacian", "second_difference") if others else ():
        try:
            known.append(error(StaticInversion(p.model, penalty=penalty, **noise).estimate(p.readings).load, p.truth))
        except (InputError, NotIdentifiable):
            continue
    return plain, own, min(known), spent / cost, "'identity'" not in taken.facts["chosen"]


def lines(kind: str, number: int, others: bool) -> Row:
    """Spectra of `tests.campaigns.frequency`."""
    p = frequency.problem(number)
    truth = p.truth
    _, plain, cost = timed(lambda: FrequencyInversion(p.model).estimate(p.spectra), truth)
    _, own, spent = timed(lambda: AutomaticInversion(p.model).estimate(p.spectra), truth)
    return plain, own, min(plain, own), spent / cost, False


def rows(group: str, problems: int, seed: int, others: bool = True) -> Iterator[Row]:
    """All problems of a group."""
    one = {"static": fields, "frequency": lines}.get(group, histories)
    for kind in GROUPS[group]:
        for number in range(problems):
            try:
                yield one(kind, seed * 100 + number, others)
            except (InputError, NotIdentifiable):
                continue


def main(problems: int, seed: int, groups: list[str]) -> None:
    """Print the table."""
    warnings.simplefilter("ignore")
    next(rows("service", 1, 0, False))  # compiled
    print(f"{'':10s}   n   plain   auto  hindsight   auto/plain   90 %    max   taken   CPU ratio   max")
    for group in groups:
        found = np.array(list(rows(group, problems, seed)), float)
        ratio, middle = found[:, 1] / found[:, 0], np.median(found, axis=0)
        print(f"{group:10s} {len(found):3d}  {middle[0]:6.3f} {middle[1]:6.3f}  {middle[2]:6.3f}       "
              f"{np.median(ratio):6.2f}   {np.quantile(ratio, 0.9):6.2f} {ratio.max():6.2f}   {found[:, 4].mean():5.0%}"
              f"      {middle[3]:5.2f}  {found[:, 3].max():5.2f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    given = sys.argv[1:]
    main(int(given[0]) if given else 10, int(given[1]) if given[1:] else 61, given[2:] or list(GROUPS))
