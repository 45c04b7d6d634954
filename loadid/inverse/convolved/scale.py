"""Scale of lambda: the largest generalised singular value, by Golub-Kahan steps with FFT products."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structures.advice import Advice, Option
from structures.errors import InputError, NotIdentifiable

from .operator import Operator

STEPS = 60
SETTLED = 1e-9
UNSEEN = 1e-12
LONG = 1 << 14  # samples beyond which the largest value is extrapolated


def free_responses(operator: Operator) -> NDArray[np.float64]:
    """Orthonormal responses (count, sensors, samples) to what a difference penalty leaves free.

    Raises
    ------
    NotIdentifiable
        If the sensors do not see a load that the penalty leaves free (LID-E306).
    """
    o, p, N = operator.order, operator.loads, operator.samples
    if o == 0:
        return np.zeros((0, operator.sensors, N))
    loads = np.zeros((o * p, p, N))
    for k in range(o):  # Legendre polynomials: their responses stay apart
        for j in range(p):
            loads[k * p + j, j] = np.linspace(-1, 1, N) ** k
    responses = operator.apply(loads).reshape(o * p, -1).T
    seen, size = float(np.linalg.norm(responses)), float(np.sqrt(np.sum(operator.h**2) * N))
    Q, R = np.linalg.qr(responses)
    if np.min(np.abs(np.diag(R))) <= UNSEEN * max(seen, size):
        raise NotIdentifiable(
            "a constant or linear load is seen neither by the sensors nor by the penalty",
            advice=Advice("add a sensor that sees a constant load, or choose ", Option("penalty", "identity")),
            code="LID-E306",
        )
    return np.ascontiguousarray(Q.T).reshape(o * p, operator.sensors, N)


def largest(operator: Operator) -> float:
    """Largest generalised singular value of (H, L), what the penalty leaves free taken out.

    That of a record beyond `LONG` samples is extrapolated by its growth over the last doubling: flat where the response
    has been forgotten by then, a power of the length where a difference of a static load is asked for.
    """
    if operator.samples <= LONG or operator.weight is not None:
        return _largest(operator)
    half, whole = _largest(operator.cut(LONG // 2)), _largest(operator.cut(LONG))
    return float(whole * (operator.samples / LONG) ** max(np.log2(whole / half), 0.0))


def _largest(operator: Operator) -> float:
    """Golub & Kahan's bidiagonalisation of ``(I - Q Q^T) H S``, with S the running sums that undo L, until it settles.

    Raises
    ------
    InputError
        If no load moves any sensor.
    """
    rng, free = np.random.default_rng(0), free_responses(operator)
    v = rng.standard_normal((1, operator.loads, operator.samples - operator.order))
    V: list[NDArray] = [v / np.linalg.norm(v)]
    U: list[NDArray] = []
    B = np.zeros((STEPS + 1, STEPS))
    before = 0.0
    for k in range(STEPS):
        u = _without(_without(operator.apply(_sum(V[-1], operator.order)), free), U)
        B[k, k] = alpha = float(np.linalg.norm(u))
        if alpha == 0:
            break
        U.append(u / alpha)
        v = _without(_sum_adjoint(operator.adjoint(_without(U[-1], free)), operator.order), V)
        value = float(np.linalg.norm(B[: k + 1, : k + 1], 2))
        beta = float(np.linalg.norm(v))
        if beta <= 1e-14 * value or abs(value - before) <= SETTLED * value:
            return value
        B[k, k + 1 : k + 2] = beta
        V.append(v / beta)
        before = value
    if before == 0:
        raise InputError(
            "the forward model is zero: no load moves any sensor", where="inverse problem",
            found="largest singular value 0", expected="a sensor that sees a load",
            hint="check the sensors, the loads and the units",
        )  # fmt: skip
    return before


def _without(x: NDArray, basis: NDArray | list[NDArray]) -> NDArray[np.float64]:
    """The part of x (1, rows, samples) at right angles to orthonormal vectors."""
    for _ in range(2 if len(basis) else 0):
        for q in basis:
            x = x - float(np.sum(q * x)) * q.reshape(x.shape)
    return x


def _sum(w: NDArray, order: int) -> NDArray[np.float64]:
    """Load with these differences that starts at zero."""
    for _ in range(order):
        w = np.pad(np.cumsum(w, axis=-1), ((0, 0), (0, 0), (1, 0)))
    return w


def _sum_adjoint(g: NDArray, order: int) -> NDArray[np.float64]:
    """Transpose of `_sum`."""
    for _ in range(order):
        g = np.cumsum(g[..., :0:-1], axis=-1)[..., ::-1]
    return g
