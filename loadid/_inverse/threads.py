"""One thread of the linear algebra for many small products in a row.

OpenBLAS, which numpy and scipy bring along, shares products of some ten thousand numbers out to all processors. Its
threads wait for each other by spinning: where another process has one of the processors, a second of work takes ten.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock

NAMES = ("scipy_openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads", "openblas_{}_num_threads")
_lock = Lock()
_inside = [0]
_before: list[int] = []


@cache
def _libraries() -> tuple[tuple[Callable[[], int], Callable[[int], None]], ...]:
    """What asks for the number of threads and what sets it, of the libraries behind numpy and scipy; none elsewhere."""
    from numpy.linalg import _umath_linalg
    from scipy.linalg import _flapack

    found = []
    for module in (_umath_linalg, _flapack):
        library = ctypes.CDLL(module.__file__)
        for name in NAMES:
            try:
                found.append((library[name.format("get")], library[name.format("set")]))
                break
            except AttributeError:
                continue
    return tuple(found)


@contextmanager
def single(wanted: bool = True) -> Iterator[None]:
    """One thread inside where it is `wanted`; the number of before comes back with the last that leaves.

    The number is the whole process's: threads that compute at the same time share it, and no result depends on it.
    """
    if not wanted:
        yield
        return
    with _lock:
        _inside[0] += 1
        if _inside[0] == 1:
            _before[:] = [get() for get, _ in _libraries()]
            for _, set_to in _libraries():
                set_to(1)
    try:
        yield
    finally:
        with _lock:
            _inside[0] -= 1
            if _inside[0] == 0:
                for count, (_, set_to) in zip(_before, _libraries(), strict=True):
                    set_to(count)
