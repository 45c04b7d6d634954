"""Straight beams: Euler-Bernoulli bending, constant or tapered, with axial tension; and tensioned vertical risers.

A beam lies along X and deflects along Z. Node i (from 0, left to right) has the unknowns w and theta = w', the slope.
A positive slope dw/dx turns about -Y in a right-handed frame, so that the DOF table prints them as ``i+Z`` and
``i-RY``; a load or sensor at ``i+RY`` gets its sign from there.

A riser lies along X from its lower end (x = 0) to its top (x = length) and deflects along Z, as the beams do. Under
tension the modes are those of a string with a little bending: neighbouring frequencies lie close together, and vortices
excite whichever the current happens to meet.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn, ParamSpec, Required, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._channels import Dof, direction_label
from .._system import fields
from .._system.damping import Damping, Rayleigh, settled
from .._system.fields import Line, Span, curvature_matrix, mass_matrix
from .._system.structure import Structure
from ..errors import InputError, integer, number, one_of, positive, shown
from . import members as materials
from .members import Material, Section

__all__ = [
    "ENDS",
    "BeamField",
    "Material",
    "Section",
    "beam",
    "cantilever",
    "clamped",
    "free",
    "materials",
    "simply_supported",
]


Z, SLOPE = 3, -5
ENDS: dict[str, tuple[int, ...]] = {"pinned": (Z,), "clamped": (Z, SLOPE), "free": (), "guided": (SLOPE,)}
Array = NDArray[np.float64]
Varying = float | Callable[[float], float]  # constant, or a function of x
P = ParamSpec("P")


@dataclass(frozen=True)
class BeamField:
    """What lies between the nodes of a beam.

    Parameters
    ----------
    line : Line
        The elements.
    outer : float, optional
        Distance of the outer fibre (m) where the section is known.
    """

    line: Line
    outer: float | None = None

    def motion(self, at: ArrayLike, axis: int) -> Array:
        """Row of the deflection (Z) or the rotation (RY, which is -w') at x."""
        (x,) = fields.point(at, ("x",))
        if axis not in (3, 5):
            _refuse("a beam moves along Z and turns about Y", direction_label(axis), "+Z or +RY")
        return self.line.row(x) if axis == 3 else -self.line.row(x, 1)

    def strain(self, at: ArrayLike, fibre: float, angle: float, length: float | None) -> Array:
        """Row of the axial strain -z w'' of the fibre at z = `fibre`, or its mean over a gauge of `length` about x."""
        (x,) = fields.point(at, ("x",))
        if angle:
            _refuse("a beam has axial strain only", f"angle = {angle:g} rad", "angle = 0")
        fields.within(fibre, self.outer)
        if length is None:
            return -fibre * self.line.row(x, 2)
        # the mean of w'' is the difference of the slopes at the ends: exact across elements
        return -fibre * (self.line.row(x + length / 2, 1) - self.line.row(x - length / 2, 1)) / length

    def resultant(self, region: tuple[Span, ...]) -> Array:
        """Row of the integral of w over a span (x0, x1)."""
        if len(region) != 1:
            _refuse("a beam takes a line load", "a rectangle", "a span x=(x0, x1)")
        return self.line.integral(*region[0])

    def box(self, node: int) -> tuple[Span, ...]:
        """Place of a node."""
        x = float(self.line.nodes[node])
        return ((x, x),)

    def near(self, region: tuple[Span, ...]) -> NDArray[np.intp]:
        """DOFs of the elements that a span shares."""
        cells = self.line.cells(*region[0])
        return np.arange(2 * cells.start, 2 * cells.stop + 2)

    def inside(self, at: ArrayLike) -> bool:
        """Whether x lies on the beam."""
        return self.line.inside(*fields.point(at, ("x",)))

    def rigid(self) -> dict[str, Array]:
        """Translation and rotation about the middle."""
        span = self.line.length
        turn = np.column_stack([self.line.local_nodes / span - 0.5, np.full(self.line.elements + 1, 1 / span)])
        return {"translation Z": np.tile([1.0, 0.0], self.line.elements + 1), "rotation RY": turn.ravel()}


def _refuse(what: str, found: str, expected: str) -> NoReturn:
    raise InputError(
        what, where="sensor or load on a beam", found=found, expected=expected, hint="the beam lies along X"
    )


def beam(
    *,
    length: float,
    elements: int = 40,
    left: str,
    right: str,
    EI: Varying | None = None,
    mass_per_length: Varying | None = None,
    section: Section | None = None,
    material: Material | None = None,
    tension: Varying = 0.0,
    damping: Damping | float | None = None,
    origin: float = 0.0,
) -> Structure:
    """Euler-Bernoulli beam with any two ends.

    Parameters
    ----------
    length : float
        m.
    elements : int
        Equal elements. The frequency error is (beta h)^4 / 1440: six elements per wavelength give 8e-4.
    left, right : {"pinned", "clamped", "free", "guided"}
        Ends; guided holds the slope and lets the deflection go.
    EI, mass_per_length : float or callable, optional
        Bending stiffness (N m^2) and mass per length (kg/m), each constant or a function of x (a tapered beam), or
    section, material : Section and Material, optional
        from which both follow.
    tension : float or callable
        Axial force (N), positive in tension, constant or a function of x; ``scaled("tension", factor)`` changes it.
    damping : Rayleigh, Modal, Structural or float, optional
        Damping; a number is the ratio of every mode.
    origin : float
        x of the left end (m). Points are given in the same coordinates; matrices do not depend on it.

    Returns
    -------
    Structure
        DOFs ``i+Z`` and ``i-RY`` (theta = w'), i = 0 ... elements; parameter "tension" where there is one.

    Raises
    ------
    InputError
        If a value is not positive or missing, an end is unknown, or the section is deeper than half the length.

    Notes
    -----
    Euler-Bernoulli element with cubic Hermite functions and consistent mass: R. D. Cook, D. S. Malkus, M. E. Plesha,
    R. J. Witt, *Concepts and Applications of Finite Element Analysis*, 4th ed. (2002), chapters 2 and 11.
    """
    EI, mass = _properties(EI, mass_per_length, section, material)
    for side, end in (("left", left), ("right", right)):
        one_of("unknown end", end, ENDS, where=f"beam, {side}", hint=f'{side}="clamped", for example')
    if section is not None and 4 * section.c > positive("length", length, where="beam", unit="m"):
        raise InputError(
            "the section is too deep for a beam of this length: it would shear, not bend",
            where="beam",
            found=f"depth {2 * section.c:g} m, length {length:g} m",
            expected="a depth of at most half the length; a tenth is usual",
            hint="check the units of the section (m); Euler-Bernoulli theory has no shear",
        )
    line = Line(length, elements, origin)
    K = _integral(line, EI, 2, "EI", "N m^2")
    terms = {}
    if callable(tension) or number("tension", tension, where="beam", unit="N") != 0.0:
        terms["tension"] = line.tension(tension)
        K = K + terms["tension"]
    ends = [(0, axis) for axis in ENDS[left]] + [(line.elements, axis) for axis in ENDS[right]]
    return Structure(
        K=K,
        M=_integral(line, mass, 0, "mass_per_length", "kg/m"),
        dofs=tuple(Dof(node, axis) for node in range(line.elements + 1) for axis in (Z, SLOPE)),
        coordinates=line.nodes,
        supports=tuple(Dof(node, axis) for node, axis in ends),
        damping=settled(damping),
        field=BeamField(line, None if section is None else section.c),
        terms=terms,
    )


class BeamSettings(TypedDict, total=False):
    """What `simply_supported`, `cantilever`, `clamped` and `free` take: all of `beam` but its ends."""

    length: Required[float]
    elements: int
    EI: Varying | None
    mass_per_length: Varying | None
    section: Section | None
    material: Material | None
    tension: Varying
    damping: Damping | float | None
    origin: float


def _settled_ends(build: Callable[P, Structure]) -> Callable[P, Structure]:
    """Give a beam of settled ends the signature of `beam` without them, and refuse them by name."""
    whole = inspect.signature(beam)
    kept = [p for name, p in whole.parameters.items() if name not in ("left", "right")]

    @functools.wraps(build)
    def checked(*args: P.args, **settings: P.kwargs) -> Structure:
        if ends := [name for name in ("left", "right") if name in settings]:
            raise InputError(
                f"the ends of beams.{build.__name__} are settled",
                where=f"beams.{build.__name__}",
                found=", ".join(f"{name}={settings[name]!r}" for name in ends),
                expected="the settings of beam() without left and right",
                hint='beams.beam(left="pinned", right="clamped", ...) takes any two ends',
            )
        return build(*args, **settings)

    checked.__signature__ = whole.replace(parameters=kept)  # type: ignore[attr-defined]
    return checked


@_settled_ends
def simply_supported(**settings: Unpack[BeamSettings]) -> Structure:
    """Beam pinned at both ends; all settings of `beam` but `left` and `right`, and its errors."""
    return beam(left="pinned", right="pinned", **settings)


@_settled_ends
def cantilever(**settings: Unpack[BeamSettings]) -> Structure:
    """Beam clamped on the left, free on the right; all settings of `beam` but `left` and `right`, and its errors."""
    return beam(left="clamped", right="free", **settings)


@_settled_ends
def clamped(**settings: Unpack[BeamSettings]) -> Structure:
    """Beam clamped at both ends; all settings of `beam` but `left` and `right`, and its errors."""
    return beam(left="clamped", right="clamped", **settings)


@_settled_ends
def free(**settings: Unpack[BeamSettings]) -> Structure:
    """Beam without supports; all settings of `beam` but `left` and `right`, and its errors.

    It has two rigid-body motions and no static response.
    """
    return beam(left="free", right="free", **settings)


def _integral(line: Line, value: Varying, order: int, name: str, unit: str) -> sparse.csr_array:
    """Stiffness (order 2) or mass (order 0) of a constant or varying property."""
    if callable(value):
        return line.varying(value, order, name, unit, positive=True)
    return line.assemble(value * (curvature_matrix if order == 2 else mass_matrix)(line.h))


def _properties(
    EI: Varying | None, mass: Varying | None, section: Section | None, material: Material | None
) -> tuple[Varying, Varying]:
    """Bending stiffness and mass per length, from numbers or from section and material, never from both."""
    for name, value, kind in (("section", section, Section), ("material", material, Material)):
        if value is not None and not isinstance(value, kind):
            raise InputError(
                f"no {name}",
                where=f"beam, {name}",
                found=shown(value),
                expected=f"a beams.{kind.__name__}",
                hint="beams.Section.rectangle(width, height)"
                if kind is Section
                else "beams.materials.steel, or beams.Material(E=, rho=)",
            )
    by_number = EI is not None or mass is not None
    by_section = section is not None or material is not None
    if by_section and not by_number and section is not None and material is not None:
        return material.E * section.I, material.rho * section.A
    if by_section or EI is None or mass is None:
        given = [
            n
            for n, v in zip(
                ("EI", "mass_per_length", "section", "material"), (EI, mass, section, material), strict=True
            )
            if v is not None
        ]
        raise InputError(
            "the beam's stiffness and mass are not stated once",
            where="beam",
            found=", ".join(given) or "nothing",
            expected="EI and mass_per_length, or section and material",
            hint="section=beams.Section.rectangle(width, height), material=beams.materials.steel",
        )
    return (
        EI if callable(EI) else positive("EI", EI, where="beam", unit="N m^2"),
        mass if callable(mass) else positive("mass_per_length", mass, where="beam", unit="kg/m"),
    )


WHERE = "riser"


def riser(
    *,
    length: float,
    EI: Varying,
    mass_per_length: Varying,
    top_tension: float,
    weight_per_length: float = 0.0,
    elements: int = 60,
    damping: Damping | float | None = None,
) -> Structure:
    """Riser pinned at both ends, under the tension at its top less the weight below it.

    Parameters
    ----------
    length : float
        m.
    EI, mass_per_length : float or callable
        Bending stiffness (N m^2) and mass per length (kg/m), contents and added mass of the water included.
    top_tension : float
        Tension at x = length (N), positive.
    weight_per_length : float
        Submerged weight (N/m): the tension at x is ``top_tension - weight_per_length (length - x)``.
    elements : int
        Equal elements.
    damping : Rayleigh, Modal, Structural or float, optional
        Damping of the structure; `loss_factor` gives that of a hysteretic material at one frequency.

    Returns
    -------
    Structure
        DOFs as those of `beams.beam`; its parameter "tension" scales the tension.

    Raises
    ------
    InputError
        If a value is not possible, or the weight leaves the lower end without tension.
    """
    span = positive("length", length, where=WHERE, unit="m")
    top = positive("top_tension", top_tension, where=WHERE, unit="N")
    weight = number("weight_per_length", weight_per_length, where=WHERE, unit="N/m")
    if weight < 0 or top - weight * span <= 0:
        raise InputError(
            "the riser is not in tension over its whole length",
            where=WHERE,
            found=f"{top:g} N at the top, {top - weight * span:g} N at the lower end",
            expected="a positive tension at both ends, and a weight that is not negative",
            hint="raise top_tension above weight_per_length * length",
        )
    tension: Varying = top if weight == 0 else lambda x: top - weight * (span - x)
    return simply_supported(
        length=span, elements=elements, EI=EI, mass_per_length=mass_per_length, tension=tension, damping=damping
    )


def loss_factor(eta: float, frequency: float) -> Rayleigh:
    """Damping proportional to the stiffness that is the loss factor `eta`, ``K (1 + i eta)``, at one frequency (Hz).

    Exact on that line of a frequency response, where a hysteretic material has no counterpart in time; elsewhere the
    loss grows with the frequency.

    Raises
    ------
    InputError
        If the loss factor is negative or the frequency is not positive.
    """
    line = positive("frequency", frequency, where="loss_factor", unit="Hz")
    loss = number("eta", eta, where="loss_factor")
    if loss < 0:
        raise InputError("a loss factor is not negative", where="loss_factor", found=eta, expected=">= 0",
                         hint="the imaginary part of the stiffness over its real part: 0.01, for example")  # fmt: skip
    return Rayleigh(0.0, loss / (2 * np.pi * line))


def frequencies(*, length: float, EI: float, mass_per_length: float, tension: float, count: int) -> Array:
    """Natural frequencies (Hz) of a riser of constant tension in closed form, (count,).

    ``f_n = n / (2 L) sqrt(T / m + EI / m (n pi / L)^2)``: modes ``sin(n pi x / L)``.

    Raises
    ------
    InputError
        If a value is not possible.
    """
    span = positive("length", length, where=WHERE, unit="m")
    stiffness, mass = positive("EI", EI, where=WHERE), positive("mass_per_length", mass_per_length, where=WHERE)
    pull, n = (
        number("tension", tension, where=WHERE, unit="N"),
        np.arange(1, integer("count", count, where=WHERE, limit=10_000) + 1),
    )
    inside = pull / mass + stiffness / mass * (n * np.pi / span) ** 2
    if inside[0] <= 0:
        raise InputError("the riser buckles", where=WHERE, found=f"tension {pull:g} N",
                         expected=f"above {-stiffness * (np.pi / span) ** 2:.4g} N", hint="check its sign")  # fmt: skip
    return np.asarray(n / (2 * span) * np.sqrt(inside), float)
