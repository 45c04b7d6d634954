"""What a verdict is worth, as measured on 28 350 cases: one table, printed by ``python -m tests.benchmarks.rules``.

Seven discrete ill-posed problems, n = 32, 64, 200, noise 1e-2, 1e-3, 1e-4, three penalties, 50 draws of white noise and
100 of correlated noise (AR(1) with 0.9, and interpolated from every second sample).

The limits of the rules and verdicts were set on four or five draws of the same problems, so that other problems may do
worse. The rows with the noise level known were measured before the test of that level (`choice.contradicted`) took its
present form; with the right level it sets in where white noise is large by chance only.
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
    ("determined", False): (Odds(0.428, 1.07, 1.61, 0.008), Odds(0.047, 1.05, 1.46, 0.011)),
    ("usable", False): (Odds(0.180, 1.09, 1.92, 0.024), Odds(0.042, 1.12, 2.36, 0.060)),
    ("rules disagree", False): (Odds(0.154, 1.11, 2.58, 0.092), Odds(0.088, 1.19, 4, 0.144)),
    ("not determined", False): (Odds(0.239, 1.04, 1.87, 0.042), Odds(0.824, 1.19, 4.95, 0.158)),
    ("determined", True): (Odds(0.260, 1.05, 1.41, 0.002), Odds(0.026, 1.04, 1.23, 0.000)),
    ("usable", True): (Odds(0.356, 1.19, 2.01, 0.023), Odds(0.053, 1.07, 1.51, 0.008)),
    ("rules disagree", True): (Odds(0.192, 1.34, 2.65, 0.080), Odds(0.091, 1.17, 1.97, 0.023)),
    ("not determined", True): (Odds(0.192, 1.17, 2.44, 0.066), Odds(0.830, 1.12, 2.12, 0.041)),
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
