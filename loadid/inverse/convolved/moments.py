"""Scalars of the path for some right sides at one lambda, with their derivatives in ln lambda from the same solves.

With f the filter factors, g_1 the solution and ``g_{k+1}`` what the same lambda makes of ``lambda^2 L^T L g_k``:
``dg_k/dt = (k - 1) g_k - k g_{k+1}`` in t = ln lambda^2, since df/dt = -f (1 - f). So three solves give every scalar of
the path with two derivatives or more, and a wide grid of lambdas is enough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .circulant import Circulant
from .operator import Operator
from .pcg import Sides, solve


@dataclass(frozen=True)
class Moments:
    """Sums over the modes, each of shape (k,) for k right sides y; beta are the coefficients of y.

    Parameters
    ----------
    rest : array, shape (2 * solves, k)
        ``sum (1 - f)^j beta^2`` for j = 1, 2, ...: objective, squared residual, and what follows in the derivatives.
    drop : array, shape (2 * solves, k)
        ``sum f (1 - f)^j beta^2`` for j = 0, 1, ...: differences of neighbours of `rest`, without cancellation.
    load2, load_slope : array
        ``|g_1|^2`` and its derivative in t.
    change2, change_slope : array
        ``|g_2|^2``, where g_2 = -dg/dt, and its derivative in t; the slope is None after two solves.
    residual, residual_slope : array, shape (k, sensors, samples)
        ``y - H g_1`` and its derivative in t.
    """

    rest: NDArray[np.float64]
    drop: NDArray[np.float64]
    load2: NDArray[np.float64]
    load_slope: NDArray[np.float64]
    change2: NDArray[np.float64]
    change_slope: NDArray[np.float64] | None
    residual: NDArray[np.float64]
    residual_slope: NDArray[np.float64]


def chain(
    operator: Operator, circulant: Circulant, y: NDArray, solves: int, tolerance: float, takeover: bool = True
) -> tuple[list[NDArray], list[NDArray], list[NDArray]]:
    """g_1, g_2, ... for data y (k, sensors, samples), with their responses H g_j and roughnesses lambda L g_j."""
    loads, responses, roughs = [], [], []
    sides = Sides(y=y)
    for _ in range(solves):
        found = solve(operator, circulant, sides, tolerance, takeover=takeover)
        rough = -found.q if sides.c is None else sides.c - found.q
        loads.append(found.x)
        responses.append((sides.y - found.r) if sides.y is not None else -found.r)
        roughs.append(rough)
        sides = Sides(c=rough)
    return loads, responses, roughs


def moments(y: NDArray, loads: list[NDArray], responses: list[NDArray], roughs: list[NDArray]) -> Moments:
    """Moments of data y (k, sensors, samples) from a `chain` of two solves or more."""
    solves, rests = len(loads), [y]
    for response in responses:
        rests.append(rests[-1] - response)
    rest, drop = [], [_dot(y, responses[0])]
    for k in range(1, solves + 1):
        size = _dot(rests[k], rests[k])
        rest += [size + _dot(roughs[0], roughs[0]) if k == 1 else _dot(rests[k - 1], rests[k]), size]
        drop += [_dot(roughs[k - 1], roughs[k - 1])]
        if k < solves:
            drop += [_dot(roughs[k - 1], roughs[k])]
    slope = None if solves < 3 else 2 * (_dot(loads[1], loads[1]) - 2 * _dot(loads[1], loads[2]))
    return Moments(
        np.array(rest), np.array(drop), _dot(loads[0], loads[0]), -2 * _dot(loads[0], loads[1]),
        _dot(loads[1], loads[1]), slope, rests[1], responses[1],
    )  # fmt: skip


def slopes(drop: NDArray) -> list[NDArray]:
    """Each entry j of `drop` with the derivatives in t that those after it give: D_j' = j D_j - (j + 1) D_{j+1}."""
    table = [np.asarray(drop, float)]
    while len(table[-1]) > 1:
        last = table[-1]
        j = np.arange(len(last) - 1)
        table.append(j * last[:-1] - (j + 1) * last[1:])
    return [np.array([row[j] for row in table if j < len(row)]) for j in range(len(drop))]


def _dot(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    return np.einsum("kij,kij->k", a, b)
