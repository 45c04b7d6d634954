"""Loops that numba compiles where it is installed (extra ``fast``); without it the same loops run as Python.

Set the environment variable ``LOADID_COMPILED=0`` before the first import to run them as Python all the same.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

AVAILABLE = find_spec("numba") is not None and os.environ.get("LOADID_COMPILED", "1") != "0"


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a loop over arrays; ``plain`` of the result is the function as written."""
    if not AVAILABLE:
        function.plain = function  # type: ignore[attr-defined]
        return function
    from numba import njit

    fast: Callable[..., Any] = njit(cache=True, nogil=True, error_model="numpy")(function)
    fast.plain = function  # type: ignore[attr-defined]
    return fast
