"""The reduced model in continuous time, in the states of `discretise`: for loads that live between the samples too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .discretise import feedthrough
from .errors import InputError
from .reduction import ReducedModel


def continuous(reduced: ReducedModel) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Matrices of ``dx/dt = A x + B p``, ``y = C x + D p``.

    States: ``omega q`` (``q`` of a rigid mode) and ``dq/dt`` of every mode, then the low-pass of every sensor with a
    corner.

    Parameters
    ----------
    reduced : ReducedModel

    Returns
    -------
    A (nx, nx) in 1/s, B (nx, loads), C (sensors, nx), D (sensors, loads)

    Raises
    ------
    InputError
        If a load moves, or the damping is structural.
    """
    if reduced.moving or reduced.loss != 0:
        raise InputError("the model has no constant matrices in continuous time", where="continuous",
                         found="a load that moves" if reduced.moving else f"structural damping {reduced.loss:g}",
                         expected="loads that stay in place, damping that is a matrix or modal",
                         hint="a modal ratio of half the loss has the same peaks")  # fmt: skip
    filtered = np.flatnonzero(reduced.corner > 0)
    k, m, p = len(reduced.lam), len(reduced.S), reduced.B.shape[1]
    n, place, speed = 2 * k + len(filtered), 2 * np.arange(k), 2 * np.arange(k) + 1
    omega = np.sqrt(reduced.lam)
    unit = np.where(reduced.lam > 0, omega, 1.0)  # of the first state, against q
    damping = np.diag(reduced.damping) if reduced.proportional else reduced.damping
    A, B, C, D = np.zeros((n, n)), np.zeros((n, p)), np.zeros((m, n)), np.array(feedthrough(reduced))
    A[place, speed], A[speed, place] = unit, -omega
    A[np.ix_(speed, speed)] = -damping
    B[speed] = reduced.B
    q, v, a = (reduced.derivative == d for d in range(3))
    C[np.ix_(q, place)] = reduced.S[q] / unit
    C[np.ix_(v, speed)] = reduced.S[v]
    C[a] = reduced.S[a] @ A[speed]
    D[a] = reduced.S[a] @ reduced.B
    for row, s in enumerate(filtered, start=2 * k):
        pole = 2 * np.pi * reduced.corner[s]
        A[row], B[row] = pole * C[s], pole * D[s]
        A[row, row], C[s, row] = -pole, -1.0
    return A, B, C, D
