"""Loops that numba compiles where it is installed (extra ``fast``); without it the same loops run as Python.

Numba is imported when the first loop is called, not when it is defined: the import takes longer than most problems that
never need a loop. Set the environment variable ``LOADID_COMPILED=0`` before the first import to run them as Python all
the same.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import update_wrapper
from importlib.util import find_spec
from types import FunctionType
from typing import Any

AVAILABLE = find_spec("numba") is not None and os.environ.get("LOADID_COMPILED", "1") != "0"


class Compiled:
    """A loop over arrays that is compiled at its first call.

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


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a loop over arrays; ``plain`` of the result is the function as written."""
    if not AVAILABLE:
        function.plain = function  # type: ignore[attr-defined]
        return function
    return Compiled(function)


def _njit(function: FunctionType) -> Callable[..., Any]:
    """Compile a function whose names of other loops stand for what these are compiled to."""
    from numba import njit

    names = function.__globals__
    called = {name: names[name] for name in function.__code__.co_names if isinstance(names.get(name), Compiled)}
    if called:
        known = {**names, **{name: loop.build() for name, loop in called.items()}}
        twin = FunctionType(function.__code__, known, function.__name__, function.__defaults__, function.__closure__)
        function = update_wrapper(twin, function)  # type: ignore[assignment]
    fast: Callable[..., Any] = njit(cache=True, nogil=True, error_model="numpy")(function)
    return fast
