"""Sensors: what each one reads, as a row over all DOFs and a number of time derivatives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .._channels import ARBITRARY, TWIST, Channel, Dof, direction_code, direction_label
from ..errors import InputError, number, numbers, pair, positive, real, shown
from .fields import field_of, one_place

if TYPE_CHECKING:
    from .structure import Structure


Array = NDArray[np.float64]
Place = float | tuple[float, ...]


def fixed_quantity(channel: Channel, quantity: str) -> None:
    """Refuse another quantity than the one that this kind of sensor reads, or this kind of load is."""
    if channel.quantity not in ("", quantity) and ARBITRARY not in (channel.quantity, quantity):
        who = type(channel).__name__
        raise InputError(
            f"this {who} speaks {quantity}, not {channel.quantity}",
            where=f"{who} {channel.label}".rstrip(),
            found=f"quantity={channel.quantity!r}",
            expected=repr(quantity),
            hint="leave quantity out, or use the class of the other quantity",
        )


def settled(who: str, at: Any) -> Place:
    """A place as a number or a tuple of numbers, checked to be finite."""
    values = numbers(at)
    if values.size not in (1, 2, 3) or not np.all(np.isfinite(values)):
        raise InputError(
            "no place",
            where=who,
            found=f"at={at!r}",
            expected="finite coordinates in m: x, or (x, y)",
            hint="name a DOF such as 12+Z, or give at= in metres",
        )
    if hasattr(at, "_fields"):  # a place that names its coordinates keeps them
        named: tuple[float, ...] = type(at)(*at)
        return named
    return float(values.ravel()[0]) if values.size == 1 else tuple(values.ravel().tolist())


def words(dof: Dof | None, at: Place | None, code: int | None = None) -> str:
    """A DOF or a place in words: ``12+Z``, ``x=0.31 +Z``, ``x=0.1 y=0.2``, ``member=2 s=0.4``."""
    if dof is not None:
        return str(dof)
    values = np.atleast_1d(np.asarray(at, float))
    place = " ".join(f"{name}={value:.9g}" for name, value in zip(getattr(at, "_fields", "xyz"), values, strict=False))
    return place if code is None else f"{place} {direction_label(code)}"


def spot(who: str, dof: Any, at: Any, direction: str) -> tuple[Dof | None, Place | None, int]:
    """DOF, or place inside an element, and direction code of a sensor or load.

    Raises
    ------
    InputError
        If not exactly one of DOF and place is given, or the twist of a plate is asked for.
    """
    one_place(who, dof, at)
    known = None if dof is None else Dof.parse(dof)
    code = direction_code(direction) if known is None else known.direction
    if abs(code) == TWIST:
        raise InputError(
            "the twist of a plate is an internal unknown",
            where=who,
            found=str(known or direction),
            expected="Z, RX or RY",
            hint="read a rotation beside it",
        )
    return known, None if at is None else settled(who, at), code


@dataclass(frozen=True, kw_only=True)
class Sensor(Channel):
    """Base of all sensors: a channel that can say which row it reads.

    Attributes
    ----------
    derivative : int
        Time derivatives of the row: 0 displacement and strain, 1 velocity, 2 acceleration.
    """

    label: str = ""
    derivative: ClassVar[int] = 0

    def row(self, structure: Structure) -> Array:
        """Row over all DOFs of the structure, shape (n,)."""
        raise NotImplementedError


@dataclass(frozen=True)
class _Motion(Sensor):
    dof: Any = None
    _: KW_ONLY
    at: Place | None = None
    direction: str = "+Z"
    label: str = ""
    quantity: str = ""
    unit: str = ""
    # (quantity, unit) for a translation and for a rotation
    _kinds: ClassVar[tuple[tuple[str, str], tuple[str, str]]]

    def __post_init__(self) -> None:
        known, at, code = spot(type(self).__name__, self.dof, self.at, self.direction)
        quantity, unit = self._kinds[4 <= abs(code) <= 6] if code else ("arbitrary", "arbitrary")
        for name, value in (("dof", known), ("at", at), ("direction", direction_label(code))):
            object.__setattr__(self, name, value)
        fixed_quantity(self, quantity)
        for name, value in (("label", words(known, at, code)), ("quantity", quantity), ("unit", unit)):
            object.__setattr__(self, name, getattr(self, name) or value)
        super().__post_init__()

    def row(self, structure: Structure) -> Array:
        """Row over all DOFs of the structure, shape (n,); a negative direction flips its sign.

        Raises
        ------
        InputError
            If the structure has no such DOF or the point lies outside.
        """
        if self.at is None:
            return structure.unit_row(self.dof)
        code = direction_code(self.direction)
        return math.copysign(1, code) * field_of(structure, f"sensor {self.label}").motion(self.at, abs(code))


@dataclass(frozen=True)
class Displacement(_Motion):
    """Displacement, or rotation, at a DOF or at a point inside an element.

    Parameters
    ----------
    dof : Dof, str or (node, direction), optional
        ``"12+Z"``; a negative direction flips the polarity.
    at : float or (x, y), optional
        Instead of a DOF: coordinates (m) in the structure's own frame.
    direction : str
        Direction at a point: ``"+Z"``, ``"-Z"``, ``"+RY"``.
    label : str, optional
        The DOF or the place where not given.
    noise, highpass : float, optional
        Noise std in the sensor's unit; corner of AC coupling (Hz).

    Raises
    ------
    InputError
        If the place is not exactly one.
    """

    _kinds = (("displacement", "m"), ("angle", "rad"))


@dataclass(frozen=True)
class Velocity(_Motion):
    """Velocity at a DOF or at a point inside an element; parameters as in `Displacement`."""

    derivative = 1
    _kinds = (("velocity", "m/s"), ("angular_velocity", "rad/s"))


@dataclass(frozen=True)
class Accelerometer(_Motion):
    """Acceleration at a DOF or at a point inside an element; parameters as in `Displacement`."""

    derivative = 2
    _kinds = (("acceleration", "m/s^2"), ("angular_acceleration", "rad/s^2"))


@dataclass(frozen=True)
class StrainGauge(Sensor):
    """Strain of one fibre of a beam or plate, positive in tension: -z times the curvature along the gauge.

    Parameters
    ----------
    at : float or (x, y)
        Centre of the gauge (m).
    fibre : float
        Coordinate z of the fibre (m, along +Z from the neutral axis or mid-plane): ``section.c`` on the upper face,
        negative on the lower one. On a member of a space frame also the pair (y, z) in the member's axes.
    length : float, optional
        Grid length (m): the mean over it, exact across elements. A point where not given.
    angle : float
        Direction on a plate, from X towards Y (rad).
    label, noise, highpass
        As in `Displacement`; the noise is a strain.

    Raises
    ------
    InputError
        If fibre is zero or a value is not finite; in `row`, if the gauge does not lie on the structure.
    """

    _: KW_ONLY
    at: Place
    fibre: float | tuple[float, float]
    length: float | None = None
    angle: float = 0.0
    label: str = ""
    quantity: str = "strain"
    unit: str = "m/m"

    def __post_init__(self) -> None:
        if np.ndim(self.fibre) == 1:
            object.__setattr__(self, "fibre", pair("the fibre", self.fibre, where="StrainGauge", unit="m"))
        elif not real(self.fibre):
            raise InputError(
                "the fibre's distance is missing",
                where="StrainGauge",
                found=shown(self.fibre),
                expected="fibre= in m, not zero",
                hint="section.c for the outer fibre",
            )
        if self.length is not None:
            positive("the gauge length", self.length, where="StrainGauge", unit="m")
        number("the angle", self.angle, where="StrainGauge", unit="rad")
        fixed_quantity(self, "strain")
        object.__setattr__(self, "at", settled("StrainGauge", self.at))
        object.__setattr__(self, "label", self.label or f"strain {words(None, self.at)}")
        super().__post_init__()

    def row(self, structure: Structure) -> Array:
        """Row over all DOFs of the structure, shape (n,)."""
        return field_of(structure, f"sensor {self.label}").strain(self.at, self.fibre, self.angle, self.length)


@dataclass(frozen=True)
class SolidGauge(Sensor):
    """Strain d^T eps d along a direction d, on the surface of a solid or inside; positive in tension.

    Parameters
    ----------
    at : (x, y, z)
        Centre of the gauge (m).
    direction : (dx, dy, dz) or str
        Direction of the grid, of any length; or an axis, "X".
    length : float, optional
        Grid length (m): the mean over it, exact across elements. A point where not given.
    label, noise, highpass
        As in `Displacement`; the noise is a strain.

    Raises
    ------
    InputError
        If place or direction is none; in `row`, if the gauge does not lie in the structure, or this is no solid.
    """

    _: KW_ONLY
    at: Place
    direction: Any
    length: float | None = None
    label: str = ""
    quantity: str = "strain"
    unit: str = "m/m"

    def __post_init__(self) -> None:
        if self.length is not None:
            positive("the gauge length", self.length, where="SolidGauge", unit="m")
        fixed_quantity(self, "strain")
        object.__setattr__(self, "at", settled("SolidGauge", self.at))
        object.__setattr__(self, "direction", _unit_vector(self.direction))
        axis = ", ".join(f"{v:.3g}" for v in self.direction)
        object.__setattr__(self, "label", self.label or f"strain {words(None, self.at)} along ({axis})")
        super().__post_init__()

    def row(self, structure: Structure) -> Array:
        """Row over all DOFs of the structure, shape (n,)."""
        field = field_of(structure, f"sensor {self.label}")
        if not hasattr(field, "direct_strain"):
            raise InputError(
                "a solid gauge needs a solid",
                where=f"sensor {self.label}",
                found=type(field).__name__,
                expected="a structure of structures.solids",
                hint="sensors.StrainGauge(at=, fibre=) reads a fibre of a beam or plate",
            )
        return np.asarray(field.direct_strain(self.at, np.array(self.direction), self.length), float)


def _unit_vector(direction: Any) -> tuple[float, float, float]:
    """A direction in space as a unit vector; an axis by its name."""
    if isinstance(direction, str) and abs(direction_code(direction)) in (1, 2, 3):
        code = direction_code(direction)
        direction = math.copysign(1.0, code) * np.eye(3)[abs(code) - 1]
    d = numbers(direction)
    size = float(np.linalg.norm(d))
    if d.shape != (3,) or not np.isfinite(size) or size == 0:
        raise InputError(
            "no direction in space",
            where="SolidGauge, direction",
            found=shown(direction),
            expected="three finite numbers, not all zero, or X, Y or Z",
            hint="direction=(1, 0, 0) reads the strain along X",
        )
    x, y, z = (float(v) for v in d / size)
    return x, y, z


def matrix(structure: Structure, sensors: Sequence[Sensor]) -> Array:
    """Rows of several sensors, shape (sensors, n)."""
    return np.array([sensor.row(structure) for sensor in sensors]).reshape(len(sensors), structure.n)
