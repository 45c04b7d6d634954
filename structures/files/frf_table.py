"""What the readers of FRF files are asked and what they find: a table with labels and units, not yet in SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .uff_units import Said

Units = str | Mapping[str, str] | None


@dataclass(frozen=True)
class Asked:
    """What the caller stated."""

    path: str
    kind: str | None
    responses: tuple[str, ...] | None
    references: tuple[str, ...] | None
    response_unit: Units
    reference_unit: Units


@dataclass(frozen=True)
class Found:
    """FRFs as recorded: lines (Hz), table (lines, responses, references), labels, units, coherence, decisions."""

    frequencies: NDArray[np.float64]
    H: NDArray[np.complex128]
    responses: tuple[str, ...]
    references: tuple[str, ...]
    response_units: tuple[Said, ...]
    reference_units: tuple[Said, ...]
    coherence: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()


def refuse(where: str, what: str, found: object, expected: object, hint: str = "") -> NoReturn:
    """Raise an InputError that names the file."""
    raise InputError(what, where=where, found=found, expected=expected, hint=hint)
