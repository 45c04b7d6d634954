"""What a verdict is worth, as measured: one table, made by ``python -m tests.benchmarks.rules``."""

from __future__ import annotations

from dataclasses import dataclass

MEANING = {
    "determined": "GCV, quasi-optimality and the lambda in use lie within half a decade",
    "usable": "GCV, quasi-optimality and the lambda in use lie within one decade, or one of the two did not run",
    "rules disagree": "GCV, quasi-optimality and the lambda in use lie over one decade apart, or the noise is correlated",
    "not determined": "GCV, quasi-optimality and the lambda in use lie over two decades apart, or none ran",
}


@dataclass(frozen=True)
class Odds:
    """How the default lambda did in one grade: load error over the smallest error of all lambdas.

    Parameters
    ----------
    share : float
        Share of the cases with this verdict.
    median, ninety : float
        Median and 90 % quantile of the ratio.
    lost : float
        Share of the cases with a ratio above 3.
    """

    share: float
    median: float
    ninety: float
    lost: float


# (verdict, noise level known): white noise, correlated noise
MEASURED: dict[tuple[str, bool], tuple[Odds, Odds]] = {}


def in_words(verdict: str, known: bool) -> str:
    """Meaning and measured odds of a verdict."""
    text = MEANING[verdict]
    if (verdict, known) not in MEASURED:
        return text
    white, smooth = (_words(o) for o in MEASURED[verdict, known])
    return f"{text}; on the test problems: {white} with white noise, {smooth} with correlated noise"


def _words(o: Odds) -> str:
    return (
        f"{o.share:.0%} of the cases, error {o.median:.2f}x the best possible "
        f"(90 %: {o.ninety:.3g}x; above 3x: {o.lost:.0%})"
    )
