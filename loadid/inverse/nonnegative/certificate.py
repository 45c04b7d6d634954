"""Duality gap of a load that only pushes, from a point that is feasible for the dual."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .normal import Factor, Normal

REFINEMENTS = 2


def violation(gradient: NDArray, signed: NDArray) -> NDArray[np.float64]:
    """What the gradient lacks to be that of a minimum: it is >= 0 where a load may only push, 0 elsewhere."""
    return np.where(signed, np.maximum(-gradient, 0.0), -gradient)


def gap(normal: Normal, free: Factor, v: NDArray, gradient: NDArray, signed: NDArray) -> float:
    """Objective at v (>= 0 where signed) minus a lower bound of its minimum, over ``|y|^2 / 2``.

    The dual of ``min v^T Q v / 2 - q^T v + |y|^2 / 2, v >= 0`` (Wolfe) is to maximise ``|y|^2 / 2 - u^T Q u / 2`` over
    all u with ``Q u - q >= 0``. With ``d`` the violation at v, ``u = v + Q^-1 d`` is such a point, its gradient
    ``s = Q u - q`` is that of v without its negative part, and the difference of the two objectives is
    ``v^T s + (u - v)^T Q (u - v) / 2``: no large numbers are subtracted.

    Parameters
    ----------
    normal : Normal
    free : Factor
        Factors of Q itself.
    v, gradient : array, shape (size,)
        Point and ``Q v - q``.
    signed : array of bool, shape (size,)
        Unknowns that may only push.
    """
    if normal.data2 == 0.0:
        return 0.0
    move, s, curvature = np.zeros(len(v)), gradient, 0.0
    for _ in range(1 + REFINEMENTS):
        move = move + free.solve(violation(s, signed))
        image = normal.apply(move)
        s, curvature = gradient + image, float(move @ image)
    return (float(np.abs(v) @ np.abs(s)) + curvature / 2) / (normal.data2 / 2)
