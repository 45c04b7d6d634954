"""How fast the singular values fall, by which law, and what a better signal-to-noise ratio buys under it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import as_array

LAWS = ("gaussian", "exponential", "algebraic")
DEEPEST = 1e-6  # of the largest singular value: no sensor resolves 120 dB, and below it kinks and the grid rule
FEWEST = 6  # values above rounding without which no law can be told
_RISE: dict[str, Callable[[NDArray], NDArray]] = {"gaussian": np.square, "exponential": np.asarray, "algebraic": np.log}


@dataclass(frozen=True)
class Decay:
    """Law by which singular values fall: ``ln sigma_k = level - rate * x(k)`` with x = k^2, k or ln k.

    Parameters
    ----------
    law : str
        ``gaussian``, ``exponential``, ``algebraic`` (k^-p, p = `rate`), or ``unknown`` with too few values.
    rate : float
        Slope; the exponent p of the algebraic law.
    level : float
        ln of the fitted first value over the largest one.
    r2 : float
        Share of the variance of ln sigma that the law explains.
    rivals : dict
        r2 of every law.
    values : int
        How many singular values were fitted.
    dimension : int
        Of the region over which the loads are spread: k = i^(1/dimension) counts waves in one direction.
    """

    law: str
    rate: float
    level: float
    r2: float
    rivals: dict[str, float]
    values: int
    dimension: int = 1

    def finest(self, snr: float) -> float:
        """Largest k whose singular value is above the first one over `snr`; NaN for an unknown law."""
        room = self.level + float(np.log(snr))
        if self.law == "unknown" or self.rate <= 0:
            return float("nan")
        if self.law == "algebraic":
            return float(np.exp(room / self.rate))
        return float(max(room, 0.0) / self.rate) ** (0.5 if self.law == "gaussian" else 1.0)

    def buys(self, gain: float = 100.0, snr: float = 100.0) -> float:
        """How many times finer the resolution becomes when an SNR of `snr` is raised by `gain`.

        Gaussian: square root of the ratio of the logarithms; exponential: their ratio; algebraic: gain^(1/p), whatever
        the SNR. Loads, sensors and the mesh may end it sooner. NaN for an unknown law.
        """
        before, after = self.finest(snr), self.finest(snr * gain)
        return after / before if before > 0 else float("nan")

    def __str__(self) -> str:
        if self.law == "unknown":
            return f"no law of decay from {self.values} singular values"
        name = f"algebraically, k^-{self.rate:.2g}" if self.law == "algebraic" else f"like {_ARTICLE[self.law]}"
        return f"singular values fall {name} (R2 {self.r2:.3f} over {self.values})"


_ARTICLE = {"gaussian": "a Gaussian, exp(-c k^2)", "exponential": "an exponential, exp(-c k)"}


def decay(singular_values: ArrayLike, dimension: int = 1, unknowns: int | None = None) -> Decay:
    """Fit the three laws to the singular values above rounding and above `DEEPEST`, and take the best.

    Parameters
    ----------
    singular_values : array, shape (r,)
    dimension : int
        1 for loads along a line, 2 for a surface: there are k^2 modes of up to k waves in each direction.
    unknowns : int, optional
        Larger side of the operator, for what rounding leaves; default r.

    Raises
    ------
    InputError
        If they are no finite numbers.
    """
    s = np.sort(np.abs(as_array(singular_values, where="decay", dtype=float)))[::-1]
    if s.ndim != 1 or not np.all(np.isfinite(s)):
        raise InputError("no singular values", where="decay", found=f"shape {s.shape}, or NaN", expected="finite, (r,)")
    tol = 10 * max(unknowns or 0, len(s)) * np.finfo(float).eps  # ten times: values near rounding are no longer true
    s = s[s > tol * s.max(initial=0.0)]
    within = int(np.sum(s > DEEPEST * s.max(initial=0.0)))
    s = s[:within] if within >= FEWEST else s
    if len(s) < FEWEST or s[-1] == s[0]:
        return Decay("unknown", 0.0, 0.0, 0.0, {}, len(s), dimension)
    y, k = np.log(s / s[0]), np.arange(1, len(s) + 1) ** (1 / dimension)
    fits = {law: _line(np.asarray(_RISE[law](k), float), y) for law in LAWS}
    best = max(LAWS, key=lambda law: fits[law][2])
    slope, level, r2 = fits[best]
    return Decay(best, -slope, level, r2, {law: fits[law][2] for law in LAWS}, len(s), dimension)


def _line(x: NDArray, y: NDArray) -> tuple[float, float, float]:
    """Slope, level and R2 of a straight line."""
    slope, level = np.polyfit(x, y, 1)
    return float(slope), float(level), float(1 - np.sum((y - level - slope * x) ** 2) / np.sum((y - y.mean()) ** 2))
