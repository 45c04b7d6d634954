"""Arrays as users give them, settled or refused: what every room of this package asks for."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, reals

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
Shape = tuple[int | None, ...]
PLANE: Shape = (None, 2)
SPACE: Shape = (None, 3)


def shaped(
    values: Any, *shapes: Shape, where: str, what: str = "", fewest: int = 0, lost: bool = False, hint: str = ""
) -> Array:
    """Real numbers in one of some shapes, any if none is named, as a new array; None stands for any length.

    An empty list is an array of no rows. There must be `fewest` rows; NaN may be among them where some are `lost`,
    infinity never.
    """
    found = reals(values, where=where, hint=hint)
    if found.shape == (0,) and shapes and shapes[0][:1] == (None,):
        found = found.reshape(0, *(n or 0 for n in shapes[0][1:]))
    fits = not shapes or any(
        len(s) == found.ndim and all(n in (None, m) for n, m in zip(s, found.shape, strict=True)) for s in shapes
    )
    sound = not np.isinf(found).any() and (lost or not np.isnan(found).any())
    if fits and sound and (not fewest or len(found) >= fewest):
        return found
    words = " or ".join(f"({', '.join('n' if n is None else str(n) for n in s)}{',' * (len(s) == 1)})" for s in shapes)
    bad = "" if sound else ", infinity" if lost else ", NaN or infinity"
    raise InputError(
        what or "an array that does not fit", where=where, found=f"shape {found.shape}{bad}",
        expected=f"{'' if lost else 'finite '}{words}" + (f", n at least {fewest}" if fewest else ""), hint=hint,
    )  # fmt: skip
