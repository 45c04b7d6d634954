"""Is the noise white? Tests of the residual and of the data coefficients, and what interpolation leaves of the data.

Rules that compare the residual with white noise (GCV and its kin, UPRE, NCP, the dof-corrected discrepancy) take
correlated noise for response and follow it. Residual: normalised cumulative periodogram, Rust & O'Leary, Inverse
Problems 24 (2008) 034005, against what white noise would leave after this fit. Coefficients: a plateau that is no
plateau, by an F-test of its two halves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import plain

from .path import RegularizationPath
from .sweeping import Refusal

KS = 1.36  # 95 % quantile of the Kolmogorov-Smirnov statistic times sqrt(q)
COLOURED, SPENT = 3.5, 0.1  # the fit itself colours the residual beyond this share of the data: threshold without modes
ALARM = 1e-3  # one-sided level of the F-test
TESTABLE = 40  # noise modes below which neither test says anything


# -- residual --------------------------------------------------------------------------------------------------------
def ncp_statistic(residual: NDArray) -> tuple[float, float]:
    """Distance of the cumulated residual periodogram from white noise: (norm, Kolmogorov-Smirnov times sqrt q).

    Parameters
    ----------
    residual : array, shape (samples, sensors)
        Periodograms of several channels are added.

    Raises
    ------
    Refusal
        If there are too few samples, or all are zero.
    """
    power = periodogram(residual)
    q = len(power)
    if q < 2 or power.sum() <= 0:
        raise Refusal("ncp needs a residual with some samples")
    distance = np.cumsum(power) / power.sum() - np.arange(1, q + 1) / q
    return float(np.linalg.norm(distance)), float(np.abs(distance).max() * np.sqrt(q * residual.shape[1]))


def periodogram(residual: NDArray) -> NDArray[np.float64]:
    """Periodogram (lines, ...) of (samples, sensors, ...), without the mean, added over the sensors."""
    return np.sum(np.abs(np.fft.rfft(residual, axis=0)[1:]) ** 2, axis=1)


@dataclass(frozen=True)
class Residual:
    """Whether the residual of one fit is what white noise leaves.

    Parameters
    ----------
    statistic, threshold : float
        Kolmogorov-Smirnov distance of the cumulated periodogram times the root of the number of lines; its 95 % limit.
    spent : float
        Degrees of freedom of the fit over the number of data.
    """

    statistic: float
    threshold: float
    spent: float

    @property
    def white(self) -> bool:
        """Not refuted."""
        return self.statistic <= self.threshold


def residual_test(path: RegularizationPath, lam: float) -> Residual | None:
    """Test of the residual at one lambda; None where it has too few samples to tell.

    Where the modes of the data are known, the periodogram is compared with the one that this fit leaves of white
    noise, tr of (I - A)^2 line by line; elsewhere with a flat one, and with a wider limit once the fit spends more
    than a tenth of the data.
    """
    rest = next(iter(path.residuals(np.array([lam]))))
    rest = rest.reshape(len(rest), -1)
    edf = path.at(lam).edf
    spent = 0.0 if edf is None else float(edf) / path.m
    expected = path.white_residual(lam)
    if expected is None:
        try:
            statistic = ncp_statistic(rest)[1]
        except Refusal:
            return None
        return Residual(statistic, KS if spent <= SPENT else COLOURED, spent)
    power = periodogram(rest)
    if len(power) < 2 or power.sum() <= 0 or expected.sum() <= 0:
        return None
    distance = np.cumsum(power) / power.sum() - np.cumsum(expected) / expected.sum()
    lines = expected.sum() ** 2 / np.sum(expected**2) * rest.shape[1]  # that carry noise
    return Residual(float(np.abs(distance).max() * np.sqrt(lines)), KS, spent)


# -- data coefficients -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Plateau:
    """Two halves of the data coefficients beyond those that the fit uses.

    Parameters
    ----------
    ratio : float
        Mean square of the first half over that of the second: 1 for white noise, larger where the noise is smooth.
    chance : float
        Probability of such a ratio, or a larger one, under white noise.
    modes : int
        Noise-dominated modes.
    """

    ratio: float
    chance: float
    modes: int

    @property
    def testable(self) -> bool:
        """Whether there are enough noise modes to tell."""
        return self.modes >= TESTABLE

    @property
    def flat(self) -> bool:
        """Not refuted."""
        return not self.testable or self.chance >= ALARM


def plateau_test(path: RegularizationPath, lam: float) -> Plateau | None:
    """F-test of the coefficients i > 2 tr A + 5 at one lambda; None where the modes of the path are no real vectors.

    White noise has the same energy in each; smooth noise loads the first modes, which are smooth too.
    """
    edf, known = path.at(lam).edf, path.energies()
    if known is None or edf is None:
        return None
    energy, copies = known
    rest = energy[int(2 * float(edf) / copies + 5) :]
    half = len(rest) // 2
    if half < 2:
        return Plateau(1.0, 1.0, len(rest))
    first, second = float(np.mean(rest[:half])), float(np.mean(rest[half:]))
    if second <= 0:
        return Plateau(np.inf if first > 0 else 1.0, 0.0 if first > 0 else 1.0, len(rest))
    from scipy.special import fdtrc

    ratio = first / second
    return Plateau(ratio, float(fdtrc(half * copies, (len(rest) - half) * copies, ratio)), len(rest))


# -- interpolated data -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Effective:
    """How many data stand behind interpolated or filtered ones.

    Parameters
    ----------
    nominal : int
        Values.
    effective : float
        ``(tr C)^2 / tr(C^2)`` of their noise covariance C.
    rank : int
        Rank of C.
    """

    nominal: int
    effective: float
    rank: int


def effective_number(W: ArrayLike, noise: ArrayLike | float = 1.0) -> Effective:
    """Effective number of data of ``y = W z``, with C = W Sigma W^T.

    Parameters
    ----------
    W : array, shape (values, raw)
        Interpolation or filter.
    noise : float or array
        Std of the raw data, one or (raw,), or their covariance (raw, raw).

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, or an interpolation that keeps nothing.
    """
    W, noise = np.asarray(plain(W), float), np.asarray(plain(noise), float)
    if W.ndim != 2 or noise.shape not in {(), W.shape[1:], (*W.shape[1:], *W.shape[1:])}:
        raise InputError(
            "the interpolation does not fit the noise", where="interpolation",
            found=f"W {W.shape}, noise {noise.shape}", expected="W (values, raw) with a std (raw,) or covariance",
        )  # fmt: skip
    if not (np.all(np.isfinite(W)) and np.all(np.isfinite(noise))):
        raise InputError("NaN or inf in the interpolation or its noise", where="interpolation", expected="finite")
    if noise.ndim == 2:
        value, vector = np.linalg.eigh(noise)
        root = W @ (vector * np.sqrt(np.maximum(value, 0)))
    else:
        root = W * noise
    energy = np.linalg.svd(root, compute_uv=False) ** 2  # eigenvalues of C
    if not np.any(energy > 0):
        raise InputError("the interpolation keeps nothing", where="interpolation", expected="a matrix that is not zero")
    rank = int(np.sum(energy > max(W.shape) * np.finfo(float).eps * energy[0]))
    return Effective(len(W), float(energy.sum() ** 2 / np.sum(energy**2)), rank)
