"""For methods of one's own: linear problems, their regularisation paths, and what a rule for lambda gets and gives.

A rule is a function ``Sweep -> RuleResult`` (`loadid.register_rule`, or ``choice=<function>``); a solver derives from
`RegularizationPath`; ``choose(SVDPath(LinearProblem.whitened(H, y, noise)))`` asks every rule of a matrix and data.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ._inverse import rules
from ._inverse.choice import Choice, choose, decide
from ._inverse.path import PathPoint, RegularizationPath, Solution
from ._inverse.problem import LinearProblem, NoiseSource, NoiseSourceLike, toeplitz
from ._inverse.svd import SVDPath
from ._inverse.sweep import Refusal, RuleResult, Sweep, crossing, minimum, need

__all__ = [
    "LinearProblem",
    "PathPoint",
    "Refusal",
    "RegularizationPath",
    "RuleResult",
    "SVDPath",
    "Solution",
    "Sweep",
    "choose",
    "compare",
    "crossing",
    "minimum",
    "need",
    "toeplitz",
]


@dataclass(frozen=True)
class Row:
    """One rule.

    Parameters
    ----------
    rule : str
    lam : float or None
        Relative lambda; None when the rule refused.
    edge : bool
        At an end of the sweep.
    residual : float or None
        Norm of the whitened residual at `lam`; in units of the noise, per datum, where the noise level is known.
    edf : float or None
        Effective degrees of freedom at `lam`.
    note : str
        Why it refused, or what is odd about it.
    """

    rule: str
    lam: float | None
    edge: bool
    residual: float | None
    edf: float | None
    note: str


@dataclass(frozen=True)
class RuleComparison:
    """What every rule says. `str` of it is a table.

    Parameters
    ----------
    rows : tuple of Row
    choice : Choice
        What `choose` would do on this path.
    spread : float
        Decades between the rules that are compared (GCV, quasi-optimality, discrepancy) and the lambda in use.
    full_spread : float
        Decades between the smallest and the largest lambda of all rules that ran and did not end at an edge.
    verdict, odds : str
        Grade of the agreement, and what it was worth on test problems.
    sensitivity : tuple of float or None
        Lambda of the discrepancy rule at half, once and twice the noise level; empty without a noise level.
    source : NoiseSource
        Where the noise level comes from.
    """

    rows: tuple[Row, ...]
    choice: Choice = field(repr=False)
    spread: float
    full_spread: float
    verdict: str
    odds: str
    sensitivity: tuple[float | None, ...]
    source: NoiseSource

    @property
    def warning(self) -> bool:
        """Whether the verdict is one to act on: the rules disagree, or lambda is not determined."""
        return self.verdict in ("rules disagree", "not determined")

    def __str__(self) -> str:
        head = ("rule", "lambda", "edge", "residual", "edf", "note")
        table = [head] + [
            (r.rule, _short(r.lam), "edge" if r.edge else "", _short(r.residual), _short(r.edf), r.note)
            for r in self.rows
        ]
        widths = [max(len(row[k]) for row in table) for k in range(5)]
        lines = [
            "  ".join([*(c.ljust(w) for c, w in zip(row, widths, strict=False)), row[5]]).rstrip() for row in table
        ]
        tail = [
            f"in use: {self.choice.lam:.3g} ({self.choice.rule})",
            f"verdict: {self.verdict}, {self.spread:.2f} decades apart (all rules: {self.full_spread:.2f})",
            f"  {self.odds}",
            f"noise level: {'not known' if self.choice.sigma is None else f'{self.choice.sigma:.3g}'} ({self.source})",
        ]
        if self.sensitivity:
            tail.append(f"discrepancy at half, once and twice of it: {', '.join(map(_short, self.sensitivity))}")
        return "\n".join([*lines, *tail])


def compare(path: RegularizationPath, sigma: float | None = None, source: NoiseSourceLike = None) -> RuleComparison:
    """Run every rule on a path and grade their agreement.

    Parameters
    ----------
    path : RegularizationPath
    sigma : float, optional
        Noise level of the whitened data (1 where it was whitened by its noise).
    source : NoiseSource or str, optional
        Where the noise level comes from.

    Returns
    -------
    RuleComparison
        Rows in the order of `rules.RULES`.

    Raises
    ------
    InputError
        A path on which no rule can run.
    """
    sweep = rules.Sweep.over(path, sigma)
    asked = {name: rules.run(name, sweep) for name in rules.RULES}
    chosen = decide(sweep, None, dict(asked), source)
    lams = np.array([r.lam for r in asked.values() if r.lam is not None])
    point = path.at(lams)
    root = 1.0 if sigma is None else sigma * np.sqrt(path.m)
    index = iter(range(len(lams)))
    rows = []
    for found in chosen.rules:
        k = None if found.lam is None else next(index)
        rows.append(
            Row(
                found.rule,
                found.lam,
                found.edge,
                None if k is None else float(np.sqrt(point.residual2[k]) / root),
                None if k is None or point.edf is None else float(point.edf[k]),
                found.note,
            )
        )
    inside = [r.lam for r in rows if r.lam is not None and not r.edge]
    try:
        sensitivity = rules.sensitivity(sweep)
    except Refusal:
        sensitivity = ()
    return RuleComparison(
        rows=tuple(rows),
        choice=chosen,
        spread=chosen.spread,
        full_spread=float(np.ptp(np.log10(inside))) if inside else float("inf"),
        verdict=chosen.verdict,
        odds=chosen.odds,
        sensitivity=sensitivity,
        source=chosen.source,
    )


def _short(x: float | None) -> str:
    return "-" if x is None else f"{x:.3g}"
