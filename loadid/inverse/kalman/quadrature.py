"""From white noise in continuous time to the transition and the noise of a step, without a subtraction.

``P - F P F^T`` loses every digit of the noise of a short step (all of a Matern-5/2 load at a thousandth of its length),
and so does Van Loan's exponential. A quadrature adds only: its root is a triangular factor of weighted impulse
responses, with the relative accuracy of each of its columns.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from .roots import lower

NODES = 8  # exact to degree 15: 2e-15 of the noise at the step below
STEP = 0.5  # largest norm of F times the step that one rule covers; longer steps are doubled up to
TERMS = 24  # of the exponential series at that norm: the rest is below 1e-30


def step(F: NDArray, b: NDArray, dt: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transition and noise of ``dx = F x dt + b dW`` over a step.

    Parameters
    ----------
    F : array, shape (n, n)
        1/s.
    b : array, shape (n, q)
        Root of the density of the white noise.
    dt : float
        Step in s.

    Returns
    -------
    E : array, shape (n, n)
        ``exp(F dt)``.
    L : array, shape (n, n)
        Lower triangular, ``L L^T`` the integral of ``exp(F s) b b^T exp(F s)^T`` over the step; (n, k) where the
        noise has k < n directions.

    Notes
    -----
    Gauss-Legendre nodes over a part of the step that is short against F, then ``L(2h) = lower [E(h) L(h), L(h)]`` and
    ``E(2h) = E(h)^2`` as often as it takes. The series acts on `b` directly, so that entries of a high power of the
    step are as right as those of a low one.
    """
    F, b, unit = _balanced(F, b)
    size = float(np.abs(F).sum(axis=1).max(initial=0.0)) * dt
    doublings = max(0, int(np.ceil(np.log2(size / STEP)))) if size > 0 else 0
    h = dt / 2**doublings
    places, weights = leggauss(NODES)
    weighed = zip(places, weights, strict=True)
    pushes = [np.sqrt(0.5 * h * w) * _propagated(F, b, 0.5 * h * (1 + s)) for s, w in weighed]
    E, L = _propagated(F, np.eye(len(F)), h), lower(*pushes)
    for _ in range(doublings):
        L = lower(E @ L, L)
        E = E @ E
    return unit[:, None] * E / unit, unit[:, None] * L


def _balanced(F: NDArray, b: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """In units of the states (powers of two) in which no entry stands out: units of loads ask for no doublings."""
    from scipy.linalg import matrix_balance

    if len(F) == 0:
        return F, b, np.ones(0)
    even, (unit, _) = matrix_balance(F, permute=False, separate=True)
    return even, b / unit[:, None], unit


def _propagated(F: NDArray, b: NDArray, s: float) -> NDArray[np.float64]:
    """``exp(F s) b`` by its series, for a small ``F s``."""
    terms = [np.asarray(b, float)]
    for k in range(1, TERMS):
        terms.append(F @ terms[-1] * (s / k))
    return np.sum(terms[::-1], axis=0)  # the small ones first
