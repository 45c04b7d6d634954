"""A filter that does not change with time, over many samples, as products of blocks of them.

    x <- A x + B u,   out = C x + D u

A block of b samples is one row: its outputs are a Toeplitz matrix times its inputs and an observability matrix times
the state at its start. These states advance by A^b, all those of a stretch together in log2 steps (Hillis & Steele,
Commun. ACM 29 (1986) 1170). All is a matrix product, and no temporary is longer than a stretch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STRETCH = 256  # blocks that advance together
SMALLEST, LARGEST = 8, 64  # samples of a block


@dataclass(frozen=True)
class Filter:
    """Matrices of ``x <- A x + B u, out = C x + D u``: (n, n), (n, inputs), (outputs, n), (outputs, inputs)."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]


def run(
    system: Filter, x: NDArray, inputs: Sequence[NDArray], outputs: Sequence[NDArray], backwards: bool = False
) -> NDArray[np.float64]:
    """Fill the outputs from the state `x` at the first sample, and return the state after the last.

    Parameters
    ----------
    inputs, outputs : sequence of array, each (samples, columns)
        Columns of u and of out, side by side.
    backwards : bool
        From the last sample to the first.
    """
    samples, width = len(inputs[0]), _width(system)
    done = samples // width * width
    parts = (
        (slice(0, done), slice(done, samples))
        if not backwards
        else (slice(samples - done, samples), slice(0, samples - done))
    )
    if done:
        x = _blocks(system, x, [u[parts[0]] for u in inputs], [o[parts[0]] for o in outputs], width, backwards)
    return _rest(system, x, [u[parts[1]] for u in inputs], [o[parts[1]] for o in outputs], backwards)


def _width(system: Filter) -> int:
    """Samples of a block, a power of two: near the least work of the products."""
    n, (outputs, inputs) = len(system.A), system.D.shape
    best = np.log2(max(3.0 * n / np.sqrt(inputs * outputs), 1.0))
    return int(np.clip(2 ** round(best), SMALLEST, LARGEST))


def _blocks(
    system: Filter, x: NDArray, inputs: Sequence[NDArray], outputs: Sequence[NDArray], width: int, backwards: bool
) -> NDArray[np.float64]:
    """Whole blocks, a stretch of them at a time."""
    n, (outs, ins) = len(x), system.D.shape
    made, pushed, jump = _matrices(system, width, backwards)
    count, order = len(inputs[0]) // width, slice(None, None, -1 if backwards else 1)
    jumps = _jumps(jump, min(STRETCH, count))
    for first in range(0, count, STRETCH):
        size = min(STRETCH, count - first)
        low = (count - first - size if backwards else first) * width
        part = slice(low, low + size * width)
        rows = np.empty((size, width * ins + n))  # inputs of a block, and the state at its start
        fed = rows[:, : width * ins]
        fed.reshape(size, width, ins)[:] = np.concatenate([u[part] for u in inputs], axis=1).reshape(size, width, ins)[
            order
        ]
        rows[:, width * ins :], x = _advance(jumps, x, fed @ pushed)
        found = (rows @ made).reshape(size, width, outs)[order]
        column = 0
        for out in outputs:
            out[part] = found[:, :, column : column + out.shape[1]].reshape(size * width, -1)
            column += out.shape[1]
    return x


def _matrices(system: Filter, width: int, backwards: bool) -> tuple[NDArray, NDArray, NDArray]:
    """From inputs and state of a block to its outputs; from its inputs to the next state; A to the power of a block.

    Samples stand in the order of the record.
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    n, (outs, ins) = len(A), D.shape
    powers = [np.eye(n)]
    for _ in range(width):
        powers.append(A @ powers[-1])
    before = np.stack(powers[:width])
    order = slice(None, None, -1 if backwards else 1)
    toeplitz, answer = np.zeros((width, ins, width, outs)), np.concatenate([D[None], C @ before[:-1] @ B])
    for k in range(width):
        toeplitz[k, :, k:] = answer[: width - k].transpose(2, 0, 1)
    direct = toeplitz[order, :, order].reshape(width * ins, width * outs)
    observe = (C @ before)[order].transpose(2, 0, 1).reshape(n, width * outs)
    reach = (before[::-1] @ B)[order].transpose(0, 2, 1).reshape(width * ins, n)
    return np.vstack([direct, observe]), reach, powers[width]


def _jumps(A: NDArray, most: int) -> list[NDArray[np.float64]]:
    """Transposes of A, A^2, A^4, ... for states up to `most` steps apart."""
    out = [A]
    while 1 << len(out) < most:
        out.append(out[-1] @ out[-1])
    return [np.ascontiguousarray(P.T) for P in out]


def _advance(jumps: list[NDArray], x: NDArray, pushed: NDArray) -> tuple[NDArray, NDArray]:
    """States (rows, n) before each push, and the one after the last: ``x <- A x + pushed[i]``."""
    pushed[0] += x @ jumps[0]
    for k, jump in enumerate(jumps):
        step = 1 << k
        if step < len(pushed):
            pushed[step:] += pushed[:-step] @ jump
    return np.vstack([x, pushed[:-1]]), pushed[-1]


def _rest(
    system: Filter, x: NDArray, inputs: Sequence[NDArray], outputs: Sequence[NDArray], backwards: bool
) -> NDArray[np.float64]:
    """Sample by sample."""
    edges = np.cumsum([o.shape[1] for o in outputs])[:-1]
    places = range(len(inputs[0]))
    for k in reversed(places) if backwards else places:
        u = np.concatenate([part[k] for part in inputs])
        for o, value in zip(outputs, np.split(system.C @ x + system.D @ u, edges), strict=True):
            o[k] = value
        x = system.A @ x + system.B @ u
    return x
