"""Loops over arrays that numba compiles.

Numba is imported when the first loop is called, not when it is defined: the import takes longer than most problems that
never need a loop. What it compiles is kept on disk for the next process. Numba's own ``NUMBA_DISABLE_JIT=1`` in the
environment runs the loops as Python, to debug them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache, update_wrapper
from types import FunctionType
from typing import Any

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
        update_wrapper(self, function)

    @property
    def built(self) -> bool:
        """Whether the compiler is loaded, and a call costs no more than the loop."""
        return self._fast is not None

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
