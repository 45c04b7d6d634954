"""Loops that numba compiles: the decorator, small products and solves, and when a recursion has converged.

Numba is imported when the first loop is called, not when it is defined: the import takes longer than most problems that
never need a loop. What it compiles is kept on disk for the next process. Whole arrays in an expression (``a[:] = b``,
``np.abs(a).max()``) take seconds to compile, loops over entries a fraction: here they are written out. Numba's own
``NUMBA_DISABLE_JIT=1`` in the environment runs the loops as Python, to debug them.

Steps of a lightly damped loop beat, rest for a while and go on, and those of a badly conditioned one never fall to
rounding. Both are told apart from arrival by the rate: what is left after k samples is rho^(2 k) of what was left.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from functools import cache, update_wrapper
from types import FunctionType
from typing import Any

import numpy as np

from .roots import Array

WORTH = 2 * 10**6  # products of a loop as it is written, that take as long as the compiler to load
log = logging.getLogger(__name__)


class Compiled:
    """Decorator of a loop over arrays, which is compiled at its first call.

    Parameters
    ----------
    function : function
        It may call other loops of this kind by the names that they have in its module.

    Attributes
    ----------
    plain : function
        The loop as written.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        assert isinstance(function, FunctionType)
        self.plain = function
        self._fast: Callable[..., Any] | None = None
        self._made = 0  # products, as written
        update_wrapper(self, function)

    def __reduce__(self) -> str:
        return self.plain.__qualname__  # there is one of each, in its module

    @property
    def built(self) -> bool:
        """Whether the compiler is loaded, and a call costs no more than the loop."""
        return self._fast is not None

    def after(self, products: int) -> Callable[..., Any]:
        """The loop as written, until it has made the products that the load of the compiler is worth; then compiled."""
        self._made += products
        if self._fast is None and self._made <= WORTH and "numba" not in sys.modules:
            return self.plain
        return self.build()

    def build(self) -> Callable[..., Any]:
        """The compiled function: to be called often, it saves the look whether there is one."""
        if self._fast is None:
            self._fast = _njit(self.plain)
        return self._fast

    def __call__(self, *args: Any) -> Any:
        """As the loop."""
        return (self._fast or self.build())(*args)


def _njit(function: FunctionType) -> Callable[..., Any]:
    """Compile a function whose names of other loops stand for what these are compiled to."""
    from numba import njit

    names = function.__globals__
    called = {name: names[name] for name in function.__code__.co_names if isinstance(names.get(name), Compiled)}
    if called:
        known = {**names, **{name: loop.build() for name, loop in called.items()}}
        twin = FunctionType(function.__code__, known, function.__name__, function.__defaults__, function.__closure__)
        function = update_wrapper(twin, function)  # type: ignore[assignment]
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    fast: Callable[..., Any]
    try:
        fast = njit(cache=True, **options)(function)
    except RuntimeError:  # no folder that numba may write to
        _warn_of_no_cache()
        fast = njit(**options)(function)
    return fast


@cache
def _warn_of_no_cache() -> None:
    log.warning("every process compiles its loops anew: set NUMBA_CACHE_DIR to a folder that can be written")


@Compiled
def multiply(A: Array, B: Array, out: Array) -> None:
    """Put A B into `out`."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            out[i, j] = 0.0
        for k in range(A.shape[1]):
            a = A[i, k]
            if a != 0.0:
                for j in range(B.shape[1]):
                    out[i, j] += a * B[k, j]


@Compiled
def dot(a: Array, b: Array) -> float:
    """Sum of products, in four sums: none waits for another."""
    s0, s1, s2, s3, i, n = 0.0, 0.0, 0.0, 0.0, 0, len(a)
    while i + 4 <= n:
        s0 += a[i] * b[i]
        s1 += a[i + 1] * b[i + 1]
        s2 += a[i + 2] * b[i + 2]
        s3 += a[i + 3] * b[i + 3]
        i += 4
    while i < n:
        s0 += a[i] * b[i]
        i += 1
    return (s0 + s1) + (s2 + s3)


@Compiled
def multiply_by_transposed(A: Array, B: Array, out: Array) -> None:
    """Put A B^T into `out`."""
    for i in range(A.shape[0]):
        for j in range(B.shape[0]):
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * B[j, k]
            out[i, j] = total


@Compiled
def solve_upper(R: Array, B: Array, out: Array) -> None:
    """Put R^-1 B into `out`, R upper triangular."""
    p = R.shape[0]
    for i in range(p - 1, -1, -1):
        for j in range(B.shape[1]):
            total = B[i, j]
            for k in range(i + 1, p):
                total -= R[i, k] * out[k, j]
            out[i, j] = total / R[i, i]


STRIDE = 32  # samples between two looks
SETTLED = 4e-15  # relative change over a stride that is rounding
NEAR = 1e-9  # change from which the approach is geometric
SQUARINGS = 15
MARGINAL = 0.01  # decay over the whole record below which a loop counts as one that forgets nothing
STALLED, SHARE = 1e-12, 0.5  # change of such a loop that no longer falls by this share over half of its history
NEVER = 1 << 62
KEPT = 4  # numbers that `settled` keeps


@Compiled
def subtract(A: Array, B: Array, out: Array) -> None:
    """Put A - B into `out`."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            out[i, j] = A[i, j] - B[i, j]


@Compiled
def scale(A: Array, divisor: float, out: Array) -> None:
    """Put A over a number into `out`, which may be A."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            out[i, j] = A[i, j] / divisor


@Compiled
def largest(A: Array) -> float:
    """Largest modulus of the entries, NaN where one is."""
    size = 0.0
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            if np.isnan(A[i, j]):
                return np.nan
            size = max(size, abs(A[i, j]))
    return size


@Compiled
def begin(kept: Array) -> None:
    """What `settled` keeps, before its first look."""
    kept[0], kept[1], kept[2], kept[3] = -1.0, 0.0, np.inf, 0.0


@Compiled
def decay(M: Array, a: Array, b: Array) -> float:
    """Decay per sample, -ln of the spectral radius of M; two matrices to work in.

    From norms of M^k and M^2k, whose ratio is rho^k however far M is from normal.
    """
    scale(M, 1.0, a)
    log, before = 0.0, 0.0
    for _ in range(SQUARINGS):
        size = largest(a)
        if size == 0.0 or not np.isfinite(size):
            return np.inf
        scale(a, size, a)
        log += np.log(size)
        before = log
        multiply(a, a, b)
        scale(b, 1.0, a)
        log *= 2.0
    size = largest(a)
    if size == 0.0:
        return np.inf
    return float(-(log + np.log(size) - before) / (1 << (SQUARINGS - 1)))


@Compiled
def arrival(since: int, change: float, size: float, decay: float, samples: int) -> int:
    """Sample at which rounding is all that is left, for a change over the last stride."""
    if decay * samples < MARGINAL:
        return NEVER
    left, rounding = change / (1.0 - np.exp(-2.0 * STRIDE * decay)), 0.25 * SETTLED * size
    if left <= rounding:
        return since
    wait = np.log(left / rounding) / (2.0 * decay) if rounding > 0.0 else np.inf
    return since + int(min(wait, float(samples))) + 1


@Compiled
def settled(
    kept: Array, since: int, stride: int, change: float, size: float, closed: Array, a: Array, b: Array, samples: int
) -> bool:
    """Whether a recursion with this closed loop has settled, by its change over a stride; two matrices to work in.

    `kept` holds the sample of arrival, the largest change, that of the time before, and since when it is looked for.
    """
    if kept[0] < 0.0 and change <= NEAR * size:
        kept[0] = arrival(since, change, size, decay(closed, a, b), samples)
    if kept[0] != NEVER:
        return bool(change <= SETTLED * size or 0.0 <= kept[0] <= since)
    kept[1] = max(kept[1], change)
    if since - kept[3] <= max(kept[3] // 2, 16 * stride):
        return False
    stalled = kept[1] <= STALLED * size and kept[1] >= SHARE * kept[2]
    kept[2], kept[1], kept[3] = kept[1], 0.0, since
    return bool(stalled)
