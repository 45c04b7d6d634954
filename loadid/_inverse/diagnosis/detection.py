"""Whether data hold more than noise: the energy that a load explains, against what it explains of noise alone.

At a lambda the fit takes y^T A y from the data, A their influence matrix. Of white noise of variance sigma^2 that is
sigma^2 times a sum of chi-squares with the weights of A: mean tr A, variance 2 tr A^2, near enough one scaled
chi-square (F. Satterthwaite, Biometrics Bulletin 2 (1946) 110). Where the level is not known, the share
y^T A y / y^T y is asked, which white noise of any level distributes like a beta variable of the same two moments. Some
lambdas are tried, as a load may be simple or not, and the smallest chance counts as many times (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .. import Array
from ..path import PathPoint, RegularizationPath
from ..sparse.path import log_supports

TRIED = 7  # lambdas ...
LOWEST = 1e-4  # ... from here to the scale of the path
CHANCE = 0.01  # that noise alone explains as much
ROUGH = 1.05  # a stated level may be too small by so much
FEWEST = 40  # data that tell their own noise level
SURE = 1.6448536269514722  # std that 95 % of all cases stay above
PLAIN = 1e-4  # chance at one lambda below which no other is asked


@dataclass(frozen=True, eq=False)
class EnergyTest:
    """Energy that a load explains at some lambdas; arrays are (lambdas,).

    Parameters
    ----------
    lam : array
        Relative.
    energy, edf, edf2 : array
        y^T A y, tr A and tr A^2.
    m : int
        Number of data.
    whole : float
        y^T y.
    sigma : float or None
        Noise level of the whitened data, where it is known.
    """

    lam: Array
    energy: Array
    edf: Array
    edf2: Array
    m: int
    whole: float
    sigma: float | None

    @property
    def level(self) -> float:
        """Noise level: as it is known with some allowance, or as data that are noise alone show it."""
        return _level(self.whole, self.m, self.sigma)

    @property
    def chance(self) -> float:
        """That noise alone explains as much, at some of these lambdas."""
        from scipy.special import betaincc, gammaincc

        if self.sigma is not None:
            each = gammaincc(self.edf**2 / self.edf2 / 2, self.energy / self.level**2 * self.edf / self.edf2 / 2)
        else:
            each = betaincc(*self._beta(), np.clip(self.energy / self.whole, 0.0, 1.0))
        return float(min(1.0, len(self.lam) * np.min(each)))

    def told_by(self, seen: Callable[[float], float]) -> float:
        """Of these lambdas the one at which the smallest load of some shape would be told from noise.

        Parameters
        ----------
        seen : callable
            Energy ``(H g)^T A (H g)`` of the whitened response of a load g of that shape, at a relative lambda.
        """
        sizes = [self.sizes(np.array([seen(float(lam))]), float(lam))[0] for lam in self.lam]
        return float(self.lam[int(np.argmin(sizes))])

    def sizes(self, energy: Array, lam: float) -> Array:
        """Factors (loads,) on loads of some `energy` at one lambda from which 95 % of all cases would tell them."""
        need = self._needed[np.flatnonzero(self.lam == lam)[0]]
        return np.sqrt(need / np.where(energy > 0, energy, np.nan), where=energy > 0, out=np.full(energy.shape, np.inf))

    def _beta(self) -> tuple[Array, Array]:
        mean = self.edf / self.m
        variance = 2 * (self.m * self.edf2 - self.edf**2) / (self.m**2 * (self.m + 2.0))
        free = mean * (1 - mean) / np.maximum(variance, np.finfo(float).tiny) - 1
        return mean * free, (1 - mean) * free

    @cached_property
    def _needed(self) -> Array:
        """Energy of a response that 95 % of all noise lifts above the threshold."""
        from scipy.special import betaincinv, gammainccinv

        each = CHANCE / len(self.lam)
        if self.sigma is not None:
            threshold = 2 * self.edf2 / self.edf * gammainccinv(self.edf**2 / self.edf2 / 2, each)
        else:
            threshold = self.m * betaincinv(*self._beta(), 1 - each)
        # mean edf + x and variance 2 edf2 + 4 x of the energy with a response of energy x
        above, b = np.maximum(threshold - self.edf, 0.0), 2 * SURE**2
        x = above + b + np.sqrt(b**2 + 2 * b * above + 2 * SURE**2 * self.edf2)
        return np.asarray(self.level**2 * x)


@dataclass(frozen=True, eq=False)
class SupportTest:
    """Energy that a few waveforms explain, which were picked from many.

    Of noise alone that of k waveforms is a chi-square of k degrees of freedom, or its share of the data a beta variable
    where the level is not known; the smallest chance counts as many times as there are supports of that size.

    Parameters
    ----------
    energies : mapping of int to float
        Number of waveforms -> what they explain of ``whole``.
    atoms, m : int
        Waveforms to pick from, and data.
    whole : float
        y^T y.
    sigma : float or None
        Noise level of the whitened data, where it is known.
    """

    energies: Mapping[int, float]
    atoms: int
    m: int
    whole: float
    sigma: float | None

    @property
    def level(self) -> float:
        """Noise level, as that of `EnergyTest`."""
        return _level(self.whole, self.m, self.sigma)

    @property
    def chance(self) -> float:
        """That noise alone is explained as well, by some support."""
        from scipy.stats import beta, chi2

        each = []
        for count, energy in self.energies.items():
            if self.sigma is not None:
                log = chi2.logsf(energy / self.level**2, count)
            else:
                share = float(np.clip(energy / self.whole, 0.0, 1.0))
                log = beta.logsf(share, count / 2, max(self.m - count, 1) / 2)
            each.append(float(log) + log_supports(self.atoms, count))
        return float(np.exp(min(0.0, np.log(len(each)) + min(each))))

    @property
    def least(self) -> float:
        """Norm of the response of one waveform that would have been told in 95 % of all cases."""
        from scipy.special import ndtri

        return float(-ndtri(CHANCE / (2 * len(self.energies) * self.atoms)) + SURE) * self.level


def largest(size: float, many: int) -> tuple[float, float]:
    """Chance that the largest of `many` normal numbers of unit std is as large, and what is told of two such questions.

    Of the stated level some allowance is made, as in `EnergyTest`; the numbers may depend on each other.
    """
    from scipy.special import ndtr, ndtri

    chance = min(1.0, float(2 * many * ndtr(-size / ROUGH)))
    return chance, float(-ndtri(CHANCE / (4 * many)) + SURE) * ROUGH


def _level(whole: float, m: int, sigma: float | None) -> float:
    """Std of one of `m` data with the sum of squares `whole`: with some allowance, where it is known."""
    return ROUGH * sigma if sigma is not None else float(np.sqrt(whole / m))


def noise_alone(path: RegularizationPath, lam: float, sigma: float | None) -> EnergyTest | None:
    """What the data explain, where that is no more than noise alone gives; None where it is more, or cannot be asked.

    Parameters
    ----------
    path : RegularizationPath
        Not stacked.
    lam : float
        Relative lambda at which it is asked first: clear cases end there.
    sigma : float or None
        Noise level of the whitened data; None where it is not known, and white noise is taken for granted.
    """
    path = path.unconstrained
    if path.energy is None or path.stacked or (sigma is None and path.m < FEWEST):
        return None
    at = lam if lam > 0 else path.range[0]  # the range of a long record costs more than all else that is asked here
    first = _tested(path, np.array([at]), sigma, bounded=True)
    if first is None or first.chance < PLAIN:
        return None
    found = _tested(path, np.geomspace(max(path.range[0], LOWEST), 1.0, TRIED), sigma)
    return None if found is None or found.chance < CHANCE else found


def _tested(path: RegularizationPath, lam: Array, sigma: float | None, bounded: bool = False) -> EnergyTest | None:
    """The test at some lambdas; with tr A in place of the smaller tr A^2 where it is `bounded`."""
    point = path.at(lam)
    edf2 = point.edf if bounded else _edf2(path, point)
    if point.edf is None or edf2 is None:
        return None
    left = np.asarray(point.residual2)
    if path.smooth:
        left = left + (lam * float(path.scale)) ** 2 * np.asarray(point.penalty2)
    whole = float(np.asarray(path.energy))
    asked = (np.asarray(point.edf) > 0) & (np.asarray(point.edf) < path.m * (1 - 1e-9))
    if sigma is not None:
        asked |= np.asarray(point.edf) > 0
    if not asked.any() or not whole > 0:
        return None
    edf, edf2 = np.asarray(point.edf)[asked], np.asarray(edf2)[asked]
    energy = np.maximum(whole - left[asked], 0.0)
    return EnergyTest(lam[asked], energy, edf, np.minimum(edf2, edf), path.m, whole, sigma)


def _edf2(path: RegularizationPath, point: PathPoint) -> Array | None:
    if point.edf2 is not None or point.rest2 is None or point.edf is None:
        return point.edf2
    return np.asarray(point.rest2 - path.m + 2 * point.edf)
