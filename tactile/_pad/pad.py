"""The gel pad as finite elements: bonded base, free edges, any number of layers, seen from its loaded surface.

x and y lie in the plane of the pad with the origin at its centre, z = 0 is the bonded base, z = h the surface.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from structures import bases
from structures._elements.members import Material
from structures._elements.surfaces import Surface
from structures._flags import Flag
from structures._system.structure import Structure
from structures.errors import InputError, integer

from .. import _guards as guards
from .._arrays import Index, Mask
from .._closed.layer import Layer
from . import meshfiles
from .body import Body, edges, rectangle
from .mesh import placed, rebuilt
from .padfile import SensorFile, read
from .stiffness import Loaded
from .table import TomlTable

if TYPE_CHECKING:
    from structures.bases import Basis


@dataclass(frozen=True, eq=False, kw_only=True)
class Pad(Loaded):
    """A gel pad bonded to a rigid window.

    Parameters
    ----------
    size : (a, b)
        Sides along x and y (m); those of the mesh where one is given.
    thickness : float
        From the bonded base to the surface (m); likewise.
    E, nu : float
        Young's modulus (Pa) and Poisson's ratio.
    pitch : float, optional
        Side of the cells in the plane (m); a side that it does not divide gets the nearest number of cells. A quarter
        of the thickness where neither `pitch` nor `elements` is given.
    elements : (nx, ny), optional
        Or the number of cells along each side.
    layers : int
        Cells through the thickness.
    element : {"bbar", "standard", "incompatible"}
        B-bar unless history is to be repeated: one layer of ``"standard"`` bricks is the baseline of the field, whose
        map of tractions is wrong by half (W115).
    outline : optional
        What is left of the rectangle, `tactile._pad.body`.
    density : float
        kg/m^3; static maps do not ask for it.
    material : str
        ``"elastomer"`` questions a modulus that none has (W111); another word does not.
    allow : sequence of str
        ``("E109",)``: plain bricks above nu = 0.49, flagged; ``("W115",)``: few layers that were compared with many.
    mesh : optional
        A mesh instead of dimensions: `Pad.from_mesh`.
    counts : (cells, nodes), optional
        Published counts of the mesh that this pad stands for: refused where no mesh of so many layers has them (E110),
        never built from.

    Attributes
    ----------
    structure : Structure
        The finite elements, base bonded.
    surface : Surface
        The loaded surface: nodes, cells, areas, boundary mass.
    flags : tuple of Flag
        What the guards of material and mesh found.

    Raises
    ------
    InputError
        If a value is not possible, or the mesh is none.

    Notes
    -----
    Vectors at points are flattened with the point first, 3 * point + component. Forces are consistent nodal forces (N);
    `surface.tractions` turns them into Pa. What the base carries is `reactions` and never part of a load.
    """

    E: float
    nu: float
    size: tuple[float, float] = (0.0, 0.0)
    thickness: float = 0.0
    pitch: float | None = None
    elements: tuple[int, int] | None = None
    layers: int = 4
    element: str = "bbar"
    outline: Any = None
    density: float = 1000.0
    material: str = "elastomer"
    allow: Sequence[str] = ()
    mesh: Any = None
    counts: tuple[int, int] | None = None
    structure: Structure = field(init=False, repr=False)
    surface: Surface = field(init=False, repr=False)
    flags: tuple[Flag, ...] = field(init=False, repr=False)
    _levels: Index | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        def fix(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        material = Material(E=self.E, rho=self.density, nu=self.nu)
        fix("allow", (self.allow,) if isinstance(self.allow, str) else tuple(self.allow))
        if self.counts is not None:
            guards.published(self.counts, self.layers)
        body = rectangle(self, material) if self.mesh is None else self._meshed(material)
        for name, value in body.dimensions.items():
            fix(name, value)
        fix("structure", body.structure)
        fix("_levels", body.levels)
        fix("surface", body.surface)
        fix("flags", self._found(body))

    def _meshed(self, material: Material) -> Body:
        if self.pitch is None:
            body: Body = self.mesh.built(material, self.element, self.allow)
            return body
        layers = integer("layers", self.layers, where="Pad, layers", limit=100)
        return rebuilt(self.mesh, self.pitch, layers, material, self.element, self.allow)

    @classmethod
    def from_mesh(
        cls,
        file: str | os.PathLike[str],
        *,
        E: float,
        nu: float,
        pitch: float | None = None,
        layers: int = 4,
        unit: str | None = None,
        axis: str | None = None,
        base: str | None = None,
        top: str | None = None,
        element: str = "bbar",
        **settings: Any,
    ) -> Pad:
        """Pad from a mesh file: Abaqus or CalculiX ``.inp``, also with ``.gz``, or arrays in NPZ or HDF5.

        Parameters
        ----------
        file : path
            `tactile._pad.meshfiles.read` says what it may hold.
        E, nu : float
            Pa; `tactile._pad.meshfiles.elastic` reads them from an input file.
        pitch, layers : optional
            With a pitch (m), rebuild the body from columns of B-bar bricks: outline of the base, height of the surface.
            Without, the cells of the file are used as they are; the loads of ten-node tetrahedra are then tractions
            that fall linearly from a corner to its neighbours, of 1 N each.
        unit, axis, base, top : optional
            As in `tactile._pad.mesh.placed`: what the file does not say is found, and told by ``repr(pad.mesh)``.
        element : str
            Of hexahedra.
        **settings
            Other settings of `Pad`.

        Raises
        ------
        InputError
            If the file holds no mesh of a pad; code LID-E110 where Euler's formula says so.
        """
        allow = settings.get("allow", ())
        allow = (allow,) if isinstance(allow, str) else tuple(allow)
        mesh = placed(meshfiles.read(file), unit=unit, axis=axis, base=base, top=top, allow=allow)
        return cls(E=E, nu=nu, mesh=mesh, pitch=pitch, layers=layers, element=element, **settings)

    @classmethod
    def from_toml(cls, file: str | os.PathLike[str]) -> Pad:
        """Pad of a TOML file: its table ``[pad]``; `tactile._pad.padfile` says what it may hold.

        Raises
        ------
        InputError
            If it holds no pad, or as `Pad`.
        """
        return cls.from_settings(read(file))

    @classmethod
    def from_settings(cls, given: SensorFile, *, allow: Sequence[str] = ()) -> Pad:
        """Pad of a sensor that `tactile._pad.padfile.read` gave; `allow` overrides guards of model and mesh.

        Raises
        ------
        InputError
            As `Pad`; the message names the file.
        """
        settings = dict(given.body)
        allowed = [*settings.pop("allow", ()), *allow]
        with TomlTable(given.path, "pad", {}).named():
            if "mesh" in settings:
                return cls.from_mesh(settings.pop("mesh"), allow=allowed, **settings)
            return cls(allow=allowed, **settings)

    def _found(self, body: Body) -> tuple[Flag, ...]:
        """What the guards of mesh and material found."""
        found = [guards.modulus(self.E) if self.material == "elastomer" else None]
        if body.layered:
            found.append(guards.too_coarse(self.layers, self.nu, self.element))
        waived = {str(code).upper().removeprefix("LID-") for code in self.allow}
        kept = [f for f in found if f is not None and f.code.removeprefix("LID-") not in waived]
        return (*body.flags, *kept)

    def __repr__(self) -> str:
        a, b = (1e3 * side for side in self.size)
        cells = f"{len(self.surface.cells)} cells x {self.layers} layers" if self.mesh is None else repr(self.mesh)
        return f"Pad({a:g} x {b:g} x {1e3 * self.thickness:g} mm, E={self.E:g} Pa, nu={self.nu:g}, {cells})"

    # -- geometry -------------------------------------------------------------------------------------------------
    @cached_property
    def edge(self) -> Mask:
        """Whether a surface node lies on the rim (P,)."""
        sides, times = edges(self.surface.cells)
        out = np.zeros(self.points, bool)
        out[sides[(times == 1) & (sides[:, 0] != sides[:, 1])].ravel()] = True
        return out

    @cached_property
    def layer(self) -> Layer:
        """The bonded layer of the same thickness and material, without edges."""
        return Layer(self.thickness, self.E, self.nu)

    @cached_property
    def basis(self) -> Basis:
        """Nodal forces on the surface along X, Y and Z: what `ForwardModel` takes as loads.

        Raises
        ------
        InputError
            For ten-node tetrahedra.
        """
        if self._quadratic:
            raise InputError(
                "ten-node tetrahedra have no load basis", where="Pad, basis", found=repr(self.mesh),
                expected="hexahedra",
                hint="Pad.from_mesh(file, pitch=) rebuilds the body from bricks; solve and transfer serve both",
            )  # fmt: skip
        return bases.nodal(self.structure, self.surface, components=("+X", "+Y", "+Z"))
