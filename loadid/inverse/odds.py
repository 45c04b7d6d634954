"""What a verdict is worth, as measured on 28 350 cases: one table, printed by ``python -m tests.benchmarks.rules``.

Seven discrete ill-posed problems, n = 32, 64, 200, noise 1e-2, 1e-3, 1e-4, three penalties, 50 draws of white noise and
100 of correlated noise (AR(1) with 0.9, and interpolated from every second sample).

The limits of the rules and verdicts were set on four or five draws of the same problems, so that other problems may do
worse.
"""

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
    ("determined", False): (Odds(0.433, 1.07, 1.6, 0.010), Odds(0.047, 1.04, 1.48, 0.012)),
    ("usable", False): (Odds(0.175, 1.09, 1.9, 0.022), Odds(0.041, 1.11, 2.35, 0.059)),
    ("rules disagree", False): (Odds(0.154, 1.10, 2.62, 0.090), Odds(0.088, 1.20, 3.98, 0.142)),
    ("not determined", False): (Odds(0.239, 1.04, 1.85, 0.043), Odds(0.824, 1.19, 4.96, 0.158)),
    ("determined", True): (Odds(0.264, 1.04, 1.37, 0.002), Odds(0.027, 1.04, 1.23, 0.000)),
    ("usable", True): (Odds(0.348, 1.09, 1.86, 0.019), Odds(0.052, 1.08, 1.5, 0.005)),
    ("rules disagree", True): (Odds(0.197, 1.16, 2.54, 0.080), Odds(0.092, 1.12, 2.16, 0.074)),
    ("not determined", True): (Odds(0.191, 1.12, 2.18, 0.056), Odds(0.829, 1.10, 2.1, 0.049)),
}


def in_words(verdict: str, known: bool) -> str:
    """Meaning and measured odds of a verdict."""
    white, smooth = MEASURED[verdict, known]
    return f"{MEANING[verdict]}; measured: with white noise {_words(white)}; with correlated noise {_words(smooth)}"


def _words(o: Odds) -> str:
    return (
        f"({o.share:.0%} of the cases) error {o.median:.2f}x the best possible, "
        f"90 % within {o.ninety:.3g}x, {o.lost:.0%} above 3x"
    )
