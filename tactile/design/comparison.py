"""Designs side by side."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from structures.errors import InputError

from .judged import SkinDesign, side_by_side, skin
from .parameters import Skin

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class SkinComparison:
    """Designs judged for the same loads.

    Parameters
    ----------
    designs : tuple of SkinDesign
    """

    designs: tuple[SkinDesign, ...]

    def __getitem__(self, name: str) -> SkinDesign:
        """Design of a name."""
        for one in self.designs:
            if one.name == name:
                return one
        raise KeyError(name)

    def table(self) -> str:
        """One column for each design, as text. A condition number says nothing without rank and nullity."""
        return side_by_side(self.designs)

    def __str__(self) -> str:
        return self.table()

    def plot(self, path: str | os.PathLike | None = None) -> Figure:
        """Picture: what is known of each wave, and the numbers of each design."""
        from ..plots.design import draw

        return draw(list(self.designs), path)


def compare(skins: Iterable[Skin | SkinDesign]) -> SkinComparison:
    """Judge several designs.

    Parameters
    ----------
    skins : iterable of Skin or SkinDesign
        Of different names.

    Raises
    ------
    InputError
        No design, two of one name, or designs for different loads or patches.
    """
    designs = tuple(s if isinstance(s, SkinDesign) else skin(s) for s in skins)
    names = [d.name for d in designs]
    loads = {(d.skin.patch, d.skin.load) for d in designs}
    if not designs or len(set(names)) < len(names) or len(loads) > 1:
        raise InputError(
            "designs that do not compare", where="design.compare",
            found=f"names {names[:6]}, {len(loads)} pairs of patch and load",
            expected="different names, the same patch and load", hint="Skin(..., name='thin')",
        )  # fmt: skip
    return SkinComparison(designs)
