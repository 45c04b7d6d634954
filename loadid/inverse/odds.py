"""What a verdict is worth, as measured: one table, made by ``python -m tests.benchmarks.rules``."""

from __future__ import annotations

from dataclasses import dataclass

MEANING = {
    "determined": "different kinds of rule lie within half a decade",
    "usable": "different kinds of rule lie within one decade, or only one kind found an optimum",
    "rules disagree": "different kinds of rule lie over one decade apart, or the noise is correlated",
    "not determined": "different kinds of rule lie over two decades apart, or none found an optimum",
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
MEASURED: dict[tuple[str, bool], tuple[Odds, Odds]] = {
    ("determined", False): (Odds(0.504, 1.04, 1.46, 0.005), Odds(0.053, 1.04, 1.4, 0.013)),
    ("usable", False): (Odds(0.189, 1.09, 1.83, 0.014), Odds(0.047, 1.12, 2.58, 0.056)),
    ("rules disagree", False): (Odds(0.131, 1.16, 2.34, 0.061), Odds(0.100, 1.15, 3.53, 0.106)),
    ("not determined", False): (Odds(0.176, 1.12, 1.97, 0.045), Odds(0.800, 1.19, 4.82, 0.150)),
    ("determined", True): (Odds(0.272, 1.05, 1.46, 0.000), Odds(0.022, 1.04, 1.22, 0.000)),
    ("usable", True): (Odds(0.329, 1.18, 1.86, 0.008), Odds(0.050, 1.06, 1.5, 0.026)),
    ("rules disagree", True): (Odds(0.216, 1.30, 2.12, 0.049), Odds(0.098, 1.16, 1.69, 0.000)),
    ("not determined", True): (Odds(0.183, 1.15, 2.71, 0.087), Odds(0.829, 1.13, 2.09, 0.033)),
}


def in_words(verdict: str, known: bool) -> str:
    """Meaning and measured odds of a verdict."""
    white, smooth = (_words(o) for o in MEASURED[verdict, known])
    return f"{MEANING[verdict]}; on the test problems: {white} with white noise, {smooth} with correlated noise"


def _words(o: Odds) -> str:
    return (
        f"{o.share:.0%} of the cases, error {o.median:.2f}x the best possible "
        f"(90 %: {o.ninety:.3g}x; above 3x: {o.lost:.0%})"
    )
