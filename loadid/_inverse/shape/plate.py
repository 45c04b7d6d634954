"""A thin rectangular plate as its equation of motion has it: rigidity, mass, damping and edges of a `Structure`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures import Structure
from structures._elements.plates import AXES, PlateField
from structures._system.damping import Modal, Rayleigh
from structures.errors import InputError

from .radial import RadialBasis

Array = NDArray[np.float64]
SHEAR = 5 / 6  # of the area that carries the shear, as E. Reissner has it


@dataclass(frozen=True)
class ThinPlate:
    """``D (nabla^4 w + beta nabla^4 w_t) - 2 zeta sqrt(D m) nabla^2 w_t + alpha m w_t + m w_tt = q``.

    Parameters
    ----------
    lengths, origin : (float, float)
        m.
    edges : str
        S, C or F for x = 0, y = 0, x = a, y = b.
    rigidity : float
        D in N m.
    mass : float
        m = rho h in kg/m^2.
    alpha, beta, ratio : float
        Rayleigh damping, and the damping ratio of every mode. That term is exact where all edges are simply supported.
    nu : float
        Poisson's ratio.
    turning : float
        ``r^2`` (m^2) of the inertia ``-m r^2 nabla^2 w_tt`` of rotation and shear; of short waves, 0 where the
        thickness is not known.
    """

    lengths: tuple[float, float]
    origin: tuple[float, float]
    edges: str
    rigidity: float
    mass: float
    alpha: float = 0.0
    beta: float = 0.0
    ratio: float = 0.0
    nu: float = 0.3
    turning: float = 0.0

    @property
    def size(self) -> float:
        """The longer side (m)."""
        return max(self.lengths)

    @property
    def sides(self) -> tuple[float, float]:
        """Over the longer."""
        return self.lengths[0] / self.size, self.lengths[1] / self.size

    def places(self, at: Array) -> tuple[Array, Array]:
        """Coordinates (points, 2) in m as those of a basis."""
        x, y = ((np.asarray(at, float) - self.origin) / self.size).T
        return x, y

    def load_rows(self, basis: RadialBasis, at: Array) -> tuple[Array, Array, Array]:
        """Rows (points, functions) of the pressure per deflection, velocity and acceleration, at places in m."""
        x, y = self.places(at)
        w, biharmonic = basis.rows(x, y), basis.biharmonic(x, y) / self.size**4
        rate = self.alpha * self.mass * w + self.beta * self.rigidity * biharmonic
        if self.ratio:
            laplace = (basis.rows(x, y, 2, 0) + basis.rows(x, y, 0, 2)) / self.size**2
            rate -= 2 * self.ratio * np.sqrt(self.rigidity * self.mass) * laplace
        return self.rigidity * biharmonic, rate, self.mass * w


def thin_plate(structure: Structure, *, moving: bool = True) -> ThinPlate:
    """What the equation of motion asks of a plate of `structures.plates`.

    Rigidity and mass are read off its matrices, so that a plate that was scaled is the plate it is: D a b is twice the
    energy of w = x^2 / 2, rho h a b that of w = 1, and D nu a b is what x^2 / 2 and y^2 / 2 have in common.

    Raises
    ------
    InputError
        No rectangular plate, prestress, edges of several kinds, damping that is no term of the equation.
    """
    field = structure.field if isinstance(structure, Structure) else None
    if not isinstance(field, PlateField):
        raise InputError(
            "the shape route takes a rectangular plate",
            where="ShapeSensing",
            found=type(field or structure).__name__,
            expected="structures.plates.plate(...)",
            hint="StaticInversion and FieldDeconvolution take any structure",
        )
    if any(term.nnz for term in structure.terms.values()):
        raise InputError(
            "the plate equation here has no in-plane forces",
            where="ShapeSensing",
            found="a plate with prestress",
            expected="a plate without",
            hint="StaticInversion and FieldDeconvolution take it",
        )
    a, b = field.x.length, field.y.length
    places = structure.coordinates
    assert places is not None
    x = places[:, 0] - field.x.origin
    y = places[:, 1] - field.y.origin
    bent = np.column_stack([x**2 / 2, x, 0 * x, 0 * x]).ravel()
    across = np.column_stack([y**2 / 2, 0 * y, y, 0 * y]).ravel()
    rigid = np.column_stack([1 + 0 * x, 0 * x, 0 * x, 0 * x]).ravel()
    D = float(bent @ (structure.K @ bent)) / (a * b)
    mass = float(rigid @ (structure.M @ rigid)) / (a * b) if structure.M is not None else 0.0
    nu = float(across @ (structure.K @ bent)) / (a * b * D)
    thick = 2 * field.outer if field.outer else 0.0
    turning = thick**2 / 12 * (1 + 2 / (SHEAR * (1 - nu)))
    alpha, beta, ratio = _damping(structure) if moving else (0.0, 0.0, 0.0)
    return ThinPlate((a, b), (field.x.origin, field.y.origin), _edges(structure, field), D, mass, alpha, beta, ratio,
                     nu, turning)  # fmt: skip


def _damping(structure: Structure) -> tuple[float, float, float]:
    """alpha, beta and the ratio of all modes."""
    damping = structure.damping
    if structure.C is None:
        if damping is None:
            return 0.0, 0.0, 0.0
        if isinstance(damping, Rayleigh):
            return damping.alpha, damping.beta, 0.0
        if isinstance(damping, Modal) and np.ndim(damping.ratios) == 0:
            return 0.0, 0.0, float(damping.ratios)  # type: ignore[arg-type]
    raise InputError(
        "the damping is no term of the plate equation",
        where="ShapeSensing",
        found="a matrix C" if structure.C is not None else type(damping).__name__,
        expected="Rayleigh damping, or one ratio for all modes",
    )


def _edges(structure: Structure, field: PlateField) -> str:
    """Letters of the four edges, by what is held on all of their nodes."""
    nodes = np.arange((field.x.elements + 1) * (field.y.elements + 1)).reshape(field.y.elements + 1, -1)
    held = {(dof.node, dof.axis) for dof in structure.supports}
    found = ""
    for line, along in ((nodes[:, 0], 4), (nodes[0], 5), (nodes[:, -1], 4), (nodes[-1], 5)):
        kinds = {"C": [abs(axis) for axis in AXES], "S": [3, along], "F": []}
        inner = line[1:-1] if len(line) > 2 else line
        fits = [k for k, axes in kinds.items() if all((int(n), axis) in held for n in inner for axis in axes)]
        free = not any((int(n), axis) in held for n in inner for axis in (3, 4, 5, 7))
        if fits[0] == "F" and not free:
            raise InputError(
                "an edge is held in part",
                where="ShapeSensing",
                found="supports that differ along an edge",
                expected="edges that are simply supported, clamped or free as a whole",
                hint="StaticInversion and FieldDeconvolution take any supports",
            )
        found += fits[0]
    return found
