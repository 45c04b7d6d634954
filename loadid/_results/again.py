"""An estimate asked at another lambda: of the problem that was posed and factorised for it, nothing is posed anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

if TYPE_CHECKING:
    from .._inverse.path import RegularizationPath
    from .estimate import LoadEstimate


@dataclass(frozen=True)
class Quick:
    """What a picture needs at a lambda: of everything else the answer takes several times as long.

    Parameters
    ----------
    load, std : array
        As in the estimate at that lambda.
    """

    load: NDArray[Any]
    std: NDArray[Any]


@dataclass(frozen=True, eq=False)
class Again:
    """What an estimate keeps of its problem, in memory alone: copies, pickles and files are without.

    Parameters
    ----------
    path : RegularizationPath
    full : callable
        Relative lambda -> `LoadEstimate`.
    quick : callable, optional
        Relative lambda -> `Quick`, where that is clearly quicker.
    """

    path: RegularizationPath
    full: Callable[[float], LoadEstimate]
    quick: Callable[[float], Quick] | None = None
