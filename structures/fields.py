"""What lies between the nodes: rows that give the motion, the strain or a resultant anywhere in a structure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError
from .values import plain

if TYPE_CHECKING:
    from .structure import Structure

Array = NDArray[np.float64]
Span = tuple[float, float]
CARRIER = 1.25  # how far out a gauge on its glue and carrier may lie, over the outer fibre


class Field(Protocol):
    """The displacement field of a meshed structure; every row has one entry per DOF, supported ones included."""

    def motion(self, at: ArrayLike, axis: int) -> Array:
        """Row of the motion along `axis` (direction code) at a point."""

    def strain(self, at: ArrayLike, fibre: Any, angle: float, length: float | None) -> Array:
        """Row of the strain of a fibre at the distance `fibre` from the neutral axis or mid-plane, along `angle`."""

    def resultant(self, region: tuple[Span, ...]) -> Array:
        """Row of the integral of the deflection over a region: the consistent load of one unit per length or area."""

    def box(self, node: int) -> tuple[Span, ...]:
        """Place of a node, as a region without extent."""

    def near(self, region: tuple[Span, ...]) -> NDArray[np.intp]:
        """DOFs of all elements that the region shares."""

    def inside(self, at: ArrayLike) -> bool:
        """Whether a point lies on the structure."""

    def rigid(self) -> dict[str, Array]:
        """Rigid-body motions of the unsupported structure, by name; rotations have unit amplitude over the length."""


class Lumped:
    """The field of a lumped structure: nothing between its nodes, one rigid translation.

    Parameters
    ----------
    axis : str
        Direction of the motion.
    size : int
        Number of DOFs.
    """

    def __init__(self, axis: str, size: int) -> None:
        self.axis, self.size = axis, size

    def _refuse(self) -> NoReturn:
        raise InputError(
            "lumped masses have nothing between them",
            where="sensor or load",
            found="a place or region",
            expected="a DOF, such as 1+" + self.axis,
            hint="name the mass instead of a place",
        )

    def motion(self, at: ArrayLike, axis: int) -> Array:
        """Refuses."""
        self._refuse()

    def strain(self, at: ArrayLike, fibre: float, angle: float, length: float | None) -> Array:
        """Refuses."""
        self._refuse()

    def resultant(self, region: tuple[Span, ...]) -> Array:
        """Refuses."""
        self._refuse()

    def box(self, node: int) -> tuple[Span, ...]:
        """No place: a lumped load acts on its mass alone."""
        return ()

    def near(self, region: tuple[Span, ...]) -> NDArray[np.intp]:
        """No DOF: no shape function spreads a lumped load onto a support."""
        return np.empty(0, np.intp)

    def inside(self, at: ArrayLike) -> bool:
        """Never."""
        return False

    def rigid(self) -> dict[str, Array]:
        """One translation."""
        return {f"translation {self.axis}": np.ones(self.size)}


def field_of(structure: Structure, where: str) -> Field:
    """Field of a structure, or a refusal that says to name a DOF."""
    if structure.field is None:
        raise InputError(
            "this structure has no mesh that says what lies between its nodes",
            where=where,
            found="a structure built from matrices",
            expected="a DOF, such as " + str(structure.dofs[0]),
            hint="name the DOF instead of at=, x= or y=",
        )
    return structure.field


def point(at: ArrayLike, names: Sequence[str]) -> tuple[float, ...]:
    """Coordinates of a point, checked: one finite number per name.

    Raises
    ------
    InputError
        If their number or a value is wrong.
    """
    try:
        values = np.atleast_1d(np.asarray(plain(at), float)).ravel()
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.size != len(names) or not np.all(np.isfinite(values)):
        raise InputError(
            "no point of this structure",
            where="sensor or load",
            found=f"at={at!r}",
            expected=f"finite {', '.join(names)} in m",
            hint=f"at=({', '.join(names)})" if len(names) > 1 else "at=0.31, for example",
        )
    return tuple(float(v) for v in values)


def within(fibre: Any, outer: float | None) -> None:
    """Refuse a fibre that lies outside the section; glue and carrier of a gauge are forgiven.

    Raises
    ------
    InputError
        If it lies further out than the outer fibre, by more than a quarter, or is a pair.
    """
    if np.ndim(fibre):
        raise InputError(
            "this structure bends over its height only",
            where="StrainGauge, fibre",
            found=f"fibre = {fibre}",
            expected="one distance from the neutral axis or mid-plane, in m",
            hint="a pair (y, z) is for members of a frame in space",
        )
    if outer is not None and abs(fibre) > CARRIER * outer:
        raise InputError(
            "the gauge lies outside the section",
            where="StrainGauge, fibre",
            found=f"fibre = {fibre:g} m",
            expected=f"at most {outer:g} m from the neutral axis or mid-plane",
            hint="half the height or thickness, not all of it; negative on the lower face",
        )
