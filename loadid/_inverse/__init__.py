"""The shared mathematics of all families: problems, penalties, paths, rules, diagnostics. No physics."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

# names for the arrays that signatures speak of
Array: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.int_]
Flags: TypeAlias = NDArray[np.bool_]
Numbers: TypeAlias = NDArray[Any]  # real or complex
