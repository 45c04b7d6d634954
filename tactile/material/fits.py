"""One curve: its modulus, its departure from the straight law, and how well each is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .curves import Curve, Tensile

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CurveFit:
    """What one curve says.

    Parameters
    ----------
    name : str
    rate : float
        Strain rate (1/s).
    E, std : float
        Modulus of the linear law over the range used (Pa), and its std from the noise of this curve alone.
    bend, bend_std : float
        Departure from the linear law: secant modulus at the end of the range over the modulus at its start, minus one.
    strain : float
        Range used.
    noise : float
        Std of the residuals (N), about the bent law.
    """

    name: str
    rate: float
    E: float
    std: float
    bend: float
    bend_std: float
    strain: float
    noise: float


def fit(curve: Curve, nu: float | None) -> CurveFit:
    """Fit force = E (1 + c x/range) g(x - x0), with c = 0 for the modulus and free for the bend.

    Parameters
    ----------
    curve : Tensile or Indentation
    nu : float or None
        Poisson's ratio; a tensile test needs none.

    Raises
    ------
    InputError
        A curve without stiffness: force that does not grow with the motion.

    Notes
    -----
    Residuals that follow one another (a filtered record, slack, hysteresis) hold fewer independent points: variances
    grow by (1 + r)/(1 - r) where the correlation r of neighbours is beyond its own noise.
    """
    straight, _ = _solved(curve, nu, bent=False)
    bent, residual = _solved(curve, nu, bent=True)
    noise = float(np.sqrt(residual @ residual / (len(residual) - 3)))
    inflated = noise * np.sqrt(_fewer(residual))
    return CurveFit(
        curve.name,
        curve.rate,
        straight.E,
        straight.E * inflated * straight.spread[0],
        float(bent.c),
        float(inflated * bent.spread[2]),
        curve.strain,
        noise,
    )


@dataclass(frozen=True)
class _Solution:
    E: float
    c: float
    spread: Array  # std of (log E, x0, c) per unit noise of the force


def _solved(curve: Curve, nu: float | None, *, bent: bool) -> tuple[_Solution, Array]:
    """Least squares for (log E, contact point, bend), in units of the curve's own ranges."""
    from scipy.optimize import least_squares

    order = np.argsort(curve.motion, kind="stable")
    x, y = curve.motion[order], curve.force[order]
    reach, top = float(np.ptp(x)), float(np.max(np.abs(y - y[0])))
    whole = float(curve.shape(np.array([reach]), nu)[0])
    slope = np.polyfit(x / reach, y / top, 1)[0] if top > 0 else 0.0
    if not slope > 0.05:
        raise InputError(
            "force does not grow with the motion", where=f"{type(curve).__name__} {curve.name}".strip(),
            found=f"slope {slope:.2g} of the largest force over the range", expected="a loading curve, both positive",
            hint="depth and elongation are positive into the load; pass the loading branch alone",
        )  # fmt: skip

    def force(p: Array) -> Array:
        deep = x - x[0] - reach * p[1]
        return np.exp(p[0]) * curve.shape(deep, nu) / whole * (1 + (p[2] if bent else 0.0) * deep / reach)

    start = np.array([0.0, y[0] / top * (-1 if isinstance(curve, Tensile) else 0), 0.0])
    count = 3 if bent else 2
    bounds = (np.array([-5.0, -0.9, -0.95])[:count], np.array([5.0, 0.9, 20.0])[:count])
    start = np.clip(start, [-4.0, -0.8, -0.9], [4.0, 0.8, 10.0])[:count]
    found = least_squares(
        lambda p: force(np.append(p, 0.0)) - y / top, start, bounds=bounds, xtol=1e-13, ftol=1e-13, gtol=1e-13
    )
    _, triangle = np.linalg.qr(found.jac)
    rows = np.linalg.solve(triangle.T, np.eye(count))  # columns of R^-T: their squares sum to the variances
    spread = np.zeros(3)
    spread[:count] = np.sqrt(np.sum(rows**2, axis=0)) / top
    c = float(found.x[2]) if bent else 0.0
    return _Solution(float(np.exp(found.x[0]) * top / whole), c, spread), found.fun * top


def _fewer(residual: Array) -> float:
    """Factor on variances for residuals that follow one another."""
    n = len(residual)
    size = float(residual @ residual)
    r = float(residual[1:] @ residual[:-1]) / size if size > 0 else 0.0
    r = min(r, 1 - 2 / n)
    return (1 + r) / (1 - r) if r > 2 / np.sqrt(n) else 1.0


def poisson(curve: Tensile) -> tuple[float, float]:
    """Poisson's ratio of a tensile test with lateral strain, and its std from the noise of the curve."""
    x = curve.elongation / curve.length
    y = curve.contraction / float(curve.width or 1.0)
    away = x - x.mean()
    size = float(away @ away)
    nu = float(away @ y / size)
    residual = y - y.mean() - nu * away
    sigma = float(np.sqrt(residual @ residual / (len(x) - 2) * _fewer(residual)))
    return nu, sigma / np.sqrt(size)
