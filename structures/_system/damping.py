"""Damping: Rayleigh (a matrix), modal ratios (never a matrix), structural (a complex stiffness)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ..errors import InputError, number, numbers, plain, real, shown


@dataclass(frozen=True)
class Rayleigh:
    """Damping matrix C = alpha M + beta K.

    Parameters
    ----------
    alpha : float
        Mass-proportional part (1/s), at least 0.
    beta : float
        Stiffness-proportional part (s), at least 0.

    Raises
    ------
    InputError
        If one is negative or no number: some frequencies would then gain energy.

    Notes
    -----
    zeta = alpha / (2 omega) + beta omega / 2. R. W. Clough, J. Penzien, *Dynamics of Structures*, 3rd ed. (2003),
    section 12-5; Lord Rayleigh, *The Theory of Sound*, vol. 1 (1877).
    """

    alpha: float = 0.0
    beta: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("alpha", self.alpha), ("beta", self.beta)):
            if (real(value) or 0.0) < 0 or real(value) is None:
                raise InputError(
                    f"{name} must not be negative",
                    where="Rayleigh damping",
                    found=shown(value),
                    expected="one number >= 0",
                    hint="Rayleigh.from_ratios finds alpha and beta from two damping ratios",
                )

    @classmethod
    def from_ratios(cls, f1: float, z1: float, f2: float, z2: float) -> Rayleigh:
        """Rayleigh damping with ratio `z1` at `f1` and `z2` at `f2` (Hz).

        Raises
        ------
        InputError
            If the frequencies are equal or not positive, a ratio is not between 0 and 1, or the two ratios differ so
            much that alpha or beta would be negative; the message names the range that is possible.
        """
        f1, z1, f2, z2 = (
            number(name, value, where="Rayleigh damping")
            for name, value in (("f1", f1), ("z1", z1), ("f2", f2), ("z2", z2))
        )
        if f1 > f2:
            f1, z1, f2, z2 = f2, z2, f1, z1
        _check_ratios((z1, z2), "Rayleigh damping")
        if not (math.isfinite(f2) and 0 < f1 < f2):
            raise InputError(
                "two different positive frequencies are needed",
                where="Rayleigh damping",
                found=f"{f1:g} Hz and {f2:g} Hz",
                expected="0 < f1 < f2",
                hint="take the ends of the band of interest",
            )
        w1, w2 = 2 * math.pi * f1, 2 * math.pi * f2
        alpha = 2 * w1 * w2 * (z1 * w2 - z2 * w1) / (w2**2 - w1**2)
        beta = 2 * (z2 * w2 - z1 * w1) / (w2**2 - w1**2)
        # a purely mass- or stiffness-proportional pair is possible: rounding must not refuse it
        alpha = 0.0 if abs(alpha) < 1e-13 * w2 else alpha
        beta = 0.0 if abs(beta) < 1e-13 / w2 else beta
        if alpha < 0 or beta < 0:
            negative, low, high = "alpha" if alpha < 0 else "beta", z1 * f1 / f2, z1 * f2 / f1
            raise InputError(
                f"the ratios {z1:g} at {f1:g} Hz and {z2:g} at {f2:g} Hz make {negative} negative",
                where="Rayleigh damping",
                found=f"alpha = {alpha:.4g} 1/s, beta = {beta:.4g} s",
                expected=f"with {z1:g} at {f1:g} Hz, a ratio from {low:.4g} to {high:.4g} at {f2:g} Hz",
                hint="bring the two ratios closer together, or use Modal ratios",
            )
        return cls(alpha, beta)

    def ratio(self, omega: ArrayLike) -> NDArray[np.float64]:
        """Damping ratio at the angular frequencies `omega` (rad/s, positive), same shape.

        Raises
        ------
        InputError
            If a frequency is not positive.
        """
        omega = np.asarray(plain(omega), float)
        if np.any(omega <= 0):
            raise InputError(
                "a ratio needs a positive frequency",
                where="Rayleigh damping",
                found=float(np.min(omega)),
                expected="> 0 rad/s",
                hint="coefficient() is also defined at zero",
            )
        return self.alpha / (2 * omega) + self.beta * omega / 2

    def coefficient(self, omega: ArrayLike) -> NDArray[np.float64]:
        """Modal damping coefficient 2 zeta omega = alpha + beta omega^2 (1/s) of each mode, same shape as `omega`."""
        return self.alpha + self.beta * np.asarray(plain(omega), float) ** 2

    def matrix(self, K: sparse.csr_array, M: sparse.csr_array) -> sparse.csr_array:
        """The damping matrix alpha M + beta K (n, n), N s/m."""
        return (self.alpha * M + self.beta * K).tocsr()

    def scaled(self, factor: float) -> Rayleigh:
        """Damping multiplied by `factor`."""
        return Rayleigh(self.alpha * factor, self.beta * factor)


@dataclass(frozen=True)
class Modal:
    """Damping ratio of each mode.

    Parameters
    ----------
    ratios : float or sequence of float
        One ratio for all modes, or one per mode in ascending order of frequency. Modes above the last given one take
        the last ratio. Ratios are fractions of critical damping: 0.02, not 2.

    Raises
    ------
    InputError
        If a ratio is no number or not between 0 and 1.

    Notes
    -----
    Each undamped mode obeys q'' + 2 zeta omega q' + omega^2 q = phi^T f. R. R. Craig, A. J. Kurdila, *Fundamentals of
    Structural Dynamics*, 2nd ed. (2006), chapter 10.
    """

    ratios: float | Sequence[float]

    def __post_init__(self) -> None:
        values = tuple(numbers(self.ratios).ravel().tolist())
        if not values or isinstance(self.ratios, str | bytes) or np.ndim(self.ratios) > 1:
            raise InputError(
                "no damping ratio",
                where="modal damping",
                found=shown(self.ratios),
                expected="one number, or one per mode",
                hint="give the fraction of critical damping: damping.Modal(0.02) for 2 %",
            )
        _check_ratios(values, "modal damping")
        object.__setattr__(self, "ratios", values[0] if np.ndim(self.ratios) == 0 else values)

    def ratio(self, omega: ArrayLike) -> NDArray[np.float64]:
        """Damping ratio of the modes with frequencies `omega` (rad/s, ascending from the first mode), same shape."""
        omega = np.asarray(plain(omega), float)
        values = np.atleast_1d(np.asarray(plain(self.ratios), float))
        return values[np.minimum(np.arange(omega.size), values.size - 1)].reshape(omega.shape)

    def coefficient(self, omega: ArrayLike) -> NDArray[np.float64]:
        """Modal damping coefficient 2 zeta omega (1/s) of the modes with frequencies `omega`, same shape."""
        return np.asarray(2 * self.ratio(omega) * np.asarray(plain(omega), float))

    def scaled(self, factor: float) -> Modal:
        """Damping multiplied by `factor`."""
        return Modal(np.asarray(self.ratios, float) * factor)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Structural:
    """Structural (hysteretic) damping: the stiffness is ``K (1 + i eta)`` on every line above 0 Hz.

    It has frequency responses only: no causal motion loses the same energy per cycle at every frequency. At resonance
    it equals a modal ratio of ``eta / 2``.

    Parameters
    ----------
    eta : float
        Loss factor of the whole structure, 0 to 1: 0.02, not 2.

    Raises
    ------
    InputError
        If it is no number or not between 0 and 1.

    Notes
    -----
    S. H. Crandall, "The role of damping in vibration theory", J. Sound Vib. 11 (1970) 3-18; R. R. Craig, A. J. Kurdila,
    *Fundamentals of Structural Dynamics*, 2nd ed. (2006), section 3.7.
    """

    eta: float

    def __post_init__(self) -> None:
        eta = real(self.eta)
        if eta is None or not 0 <= eta <= 1:
            raise InputError(
                "a loss factor is not possible",
                where="structural damping",
                found=shown(self.eta),
                expected="0 <= eta <= 1",
                hint="give it as a fraction: damping.Structural(0.02) for 2 %",
            )
        object.__setattr__(self, "eta", eta)

    def ratio(self, omega: ArrayLike) -> NDArray[np.float64]:
        """Equivalent modal ratio ``eta / 2`` at the frequencies `omega` (rad/s), same shape."""
        return np.full(np.shape(omega), self.eta / 2)

    def scaled(self, factor: float) -> Structural:
        """Damping multiplied by `factor`.

        Raises
        ------
        InputError
            If the loss factor leaves its range.
        """
        return Structural(self.eta * factor)


Damping = Rayleigh | Modal | Structural


def causal(damping: Damping | None, method: str) -> None:
    """Refuse a time response under structural damping.

    Raises
    ------
    InputError
        It is not causal: the loss factor has no equation of motion.
    """
    if isinstance(damping, Structural):
        raise InputError(
            f"structural damping has no {method}: a loss factor is not causal, it has frequency responses only",
            where=method,
            found=f"damping.Structural({damping.eta:g})",
            expected="Rayleigh or modal damping, or a matrix C",
            hint=f"damping={damping.eta / 2:g}, the modal ratio eta / 2, has the same peaks",
        )


def loss_factor(damping: Damping | None) -> float:
    """Structural loss factor; 0 of any other damping."""
    return damping.eta if isinstance(damping, Structural) else 0.0


def settled(damping: Any) -> Damping | None:
    """Damping as it is, or the one ratio of all modes that a bare number means: ``damping=0.02`` is ``Modal(0.02)``.

    Raises
    ------
    InputError
        If it is neither.
    """
    if damping is None or isinstance(damping, Damping):
        return damping
    ratio = real(damping)
    if ratio is None:
        raise InputError(
            "no damping",
            where="damping",
            found=shown(damping),
            expected="damping.Modal, damping.Rayleigh, damping.Structural, a ratio such as 0.02, or None",
            hint="damping.Modal(0.02) is 2 % of critical damping in every mode",
        )
    return Modal(ratio)


def _check_ratios(ratios: Sequence[float], where: str) -> None:
    for z in ratios:
        if not 0 <= z < 1:
            raise InputError(
                "a damping ratio is not possible",
                where=where,
                found=f"{z:g}",
                expected="0 <= ratio < 1",
                hint="give the fraction of critical damping: 0.02 for 2 %",
            )
