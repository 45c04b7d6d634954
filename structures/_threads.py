"""How many threads OpenBLAS takes, of which numpy and scipy bring one each.

Thousands of products of a few dozen rows gain nothing from a second thread, and pay for it: it waits by turning in a
loop, and where another program has its processor every product waits for it in turn. A factorisation of a thousand rows
does gain. Other libraries than OpenBLAS are left as they are.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from importlib import import_module
from threading import Lock

LARGE = 500  # rows from which a factorisation gains from a second thread

_MODULES = ("numpy.linalg._umath_linalg", "scipy.linalg._fblas")  # linked to the library: it is found through them
_NAMES = tuple(f"{who}openblas_{{}}_num_threads{ints}" for who in ("scipy_", "") for ints in ("64_", ""))

_lock = Lock()
_inside = 0  # blocks of `one_thread` that are open, in all threads
_before: list[int] = []


@cache
def _libraries() -> tuple[tuple[Callable[[], int], Callable[[int], None]], ...]:
    """What reads and what sets the number, of each library that is found."""
    found = []
    for module in _MODULES:
        try:
            library = ctypes.CDLL(str(import_module(module).__file__))
        except (ImportError, OSError):
            continue
        for name in _NAMES:
            if hasattr(library, name.format("get")) and hasattr(library, name.format("set")):
                found.append((getattr(library, name.format("get")), getattr(library, name.format("set"))))
                break
    return tuple(found)


def threads() -> list[int]:
    """Threads of each library that is found."""
    return [read() for read, _ in _libraries()]


def _set(counts: list[int]) -> None:
    for (_, write), count in zip(_libraries(), counts, strict=True):
        write(count)


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for each library, until the last of the blocks that overlap is left."""
    global _inside, _before
    with _lock:
        _inside += 1
        if _inside == 1:
            _before = threads()
            _set([1] * len(_before))
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                _set(_before)


@contextmanager
def all_threads() -> Iterator[None]:
    """Within `one_thread`, for a large factorisation: as many as were before."""
    with _lock:
        if _inside:
            _set(_before)
    try:
        yield
    finally:
        with _lock:
            if _inside:
                _set([1] * len(_before))


def threads_for(rows: int) -> AbstractContextManager[None]:
    """For a factorisation of a matrix with so many rows or columns, whichever are more: all threads, or one."""
    return all_threads() if rows >= LARGE else one_thread()
