"""Forces on a grid from two layers of markers in a transparent body, by one block matrix inverted globally.

After K. Kamiyama, K. Vlack, T. Mizota, H. Kajimoto, N. Kawakami & S. Tachi, "Vision-based sensor for real-time
measuring of surface traction fields", IEEE Computer Graphics and Applications 25 (2005) 68-75: point forces on a
half-space move every marker (Boussinesq and Cerruti). The inversion couples all forces with all markers; what limits it
is the half-space on a thin pad, so the kernels of a bonded layer stand beside them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from loadid._guards import collect
from structures._flags import Flag
from structures.errors import InputError, reals

from .. import _guards as guards
from .._arrays import PLANE, Array, shaped
from .._closed import halfspace as closed
from .._closed.halfspace import point_forces
from .._closed.layer import HalfSpace, Layer
from .._closed.presses import matrices, unit_point
from .._results.forcemap import ForceMap
from .inversion import Inverse, prepare
from .linear import LinearSensor, PressedBody
from .marked import Extent, InversionSettings, observed, spelled_before
from .observation import DepthMap, Markers, Wrench
from .posing import of_points

LOADED = 6.0  # stds of the noise that a marker must move, if a half-space is to be held against the pad
TOUCHED = 0.2  # of the largest force, from which a point counts as touched


class GelForce(LinearSensor):
    """Forces at the points of a grid from markers at two (or more) depths.

    Parameters
    ----------
    ground : HalfSpace or Layer
        What the forces act on. A half-space is what the method was published with; a layer knows the window behind it.
    forces : array (n, 2)
        Places of the forces (m), a grid.
    markers : Markers
        Places (N, 3) under the surface (m), in the frame of the ground: z = 0 is the surface of a half-space and depths
        are negative; z = h is the surface of a layer. Two layers of markers under one camera give in-plane motion, axes
        "XY"; with known optics all three components.
    extent : Extent, optional
        Of the pad, for the guards of a ground that knows no base (W601, E602) or no edge (W601). Every map of a
        half-space is held against the thickness: by the radius of its contact, and by what the base of a pad so thick
        would change of the motion of the markers. Without a thickness, a contact wider than the markers are deep is
        flagged.
    penalty, choice, noise_source, contact, allow
        See `tactile._sensors.marked.InversionSettings`. ``choice=0`` is the publication's pseudo-inverse, by SVD.

    Raises
    ------
    InputError
        Markers on the surface (point forces have no bound there), deeper than the pad is thick, or fewer than three;
        settings that do not fit.
    NotIdentifiable
        A half-space for a contact that the thickness makes a thin layer (LID-E602), here or in `estimate`.
    """

    name = "GelForce"

    @spelled_before("markers", "contact", "extent", axes="XYZ")
    def __init__(
        self,
        ground: HalfSpace | Layer,
        forces: ArrayLike,
        markers: Markers,
        *,
        extent: Extent | None = None,
        **settings: Unpack[InversionSettings],
    ) -> None:
        self.ground, self.extent = ground, extent or Extent()
        places = shaped(forces, PLANE, where="GelForce, forces", what="no places of forces", fewest=2)
        markers = observed(markers, None)
        if markers.points.shape[1] != 3 or np.any(markers.points[:, 2] >= ground.top):
            raise InputError(
                "markers must lie under the surface", where="GelForce, markers", found="markers on or above it",
                expected="(N, 3) with z below the surface", hint="a point force moves its own point without bound",
            )  # fmt: skip
        deepest = ground.top - float(markers.points[:, 2].min())
        if extent is not None and extent.thickness is not None and deepest > extent.thickness:
            raise InputError(
                "markers lie deeper than the pad is thick", where="GelForce, markers", found=f"{deepest:.4g} m",
                expected=f"up to {extent.thickness:g} m", hint="depths are counted from the surface, in m",
            )  # fmt: skip
        self._deepest = deepest
        area = _cell(places)
        self._size, self._h = self.extent.size, ground.h if isinstance(ground, Layer) else self.extent.thickness
        if self._size is not None and self._h is None:
            raise InputError(
                "how near an edge is depends on the thickness of the pad", where="GelForce, extent",
                found="no thickness", expected="thickness= in m beside size=",
            )  # fmt: skip
        thin = None
        if isinstance(ground, HalfSpace) and self._h is not None and self.extent.contact_radius is not None:
            allow = settings.get("allow", ())
            thin = closed.thin_pad(self.extent.contact_radius, self._h, ground.nu, allow=allow)
        surface = np.column_stack([places, np.full(len(places), ground.top)])

        body = PressedBody(
            ground, ground.h if isinstance(ground, Layer) else None, partial(_rows, ground, places),
            of_points(surface, area, (0.0, 0.0, ground.top)), flags=() if thin is None else (thin,),
            about={"ground": repr(ground), "forces": len(places), "markers": len(markers)},
        )  # fmt: skip
        super().__init__(body, markers, **settings)

    def estimate(self, found: ArrayLike, depth: DepthMap | None = None, *, wrench: Wrench | None = None) -> ForceMap:
        """Forces of one frame, as `LinearSensor.estimate`; a map of a half-space is held against the thickness.

        Raises
        ------
        InputError
            As there.
        NotIdentifiable
            What the readings do not determine, or a contact that a half-space does not describe (LID-E602).
        """
        return self._held(super().estimate(found, depth, wrench=wrench))

    def follow(self, found: ArrayLike, depth: DepthMap | None = None) -> ForceMap:
        """Forces of one of many frames, as `LinearSensor.follow`, held against the thickness too."""
        return self._held(super().follow(found, depth))

    def _held(self, answer: ForceMap) -> ForceMap:
        flag = self._thin(answer)
        return answer if flag is None else replace(answer, flags=collect([*answer.flags, flag]))

    def _thin(self, answer: ForceMap) -> Flag | None:
        """W601 or E602 of a contact found by a half-space."""
        if isinstance(self.ground, Layer):
            return None
        spread = np.array([c.noise for c in self.model.sensors])
        told = self.model.H @ answer.load[self.kept] / spread
        if not np.abs(told).max() > LOADED:
            return None
        contact = answer.contact(TOUCHED)
        if self._h is None:
            return closed.of_unknown_thickness(contact.radius, self._deepest)
        share = float(np.linalg.norm(self._on_pad @ answer.load / spread - told) / np.linalg.norm(told))
        if contact.radius / self._h > share:
            return closed.thin_pad(contact.radius, self._h, self.ground.nu, allow=self.family.allow)
        return closed.base_seen(share, self._h, self.family.allow)

    @cached_property
    def _on_pad(self) -> Array:
        """Readings per force if the pad had its base."""
        assert self._h is not None
        points = self.markers.points + np.array([0.0, 0.0, self._h])
        layer = Layer(self._h, self.ground.E, self.ground.nu)
        return _rows(layer, self.geometry["coordinates"][:, :2], points, self.markers.rows)

    def expected_error(self, forces: ArrayLike) -> float:
        """Relative error that the noise makes of these forces (n, 3) or (3 n,) without regularisation.

        ``|H^+ R^(1/2)|_F / |f|``: what decides is the depth of the markers in units of the pitch of the forces.
        """
        spread = np.array([c.noise for c in self.model.sensors])
        f = reals(forces, where="GelForce, forces").ravel()
        values = np.linalg.svd(self.model.H / spread[:, None], compute_uv=False)
        return float(np.sqrt(np.sum(1 / values**2)) / np.linalg.norm(f))

    def flagged(self, forces: ArrayLike) -> Flag | None:
        """W304 where noise alone would make more than 30 % error of these forces."""
        return guards.too_deep(self.expected_error(forces))

    def _checked(self, load: Array) -> list[Flag | None]:
        """W601 where the contact is near an edge."""
        pressure = -load[2::3]
        touched = pressure > TOUCHED * pressure.max(initial=0.0)
        if self._size is None or self._h is None or not touched.any():
            return []
        places = self.geometry["coordinates"][touched, :2]
        distance = float(np.min(np.asarray(self._size) / 2 - np.abs(places)))
        return [closed.near_edge(max(distance, 0.0), self._h)]

    @property
    def condition(self) -> float:
        """Condition number of the block matrix."""
        return float(np.linalg.cond(self.model.H))

    def at(self, lam: float) -> Inverse:
        """The frozen inverse at another relative lambda."""
        if self.problem is not None:
            return self.problem.inverse(float(lam), "given")
        return prepare(self.family, self.resultant, float(lam))


def _rows(ground: HalfSpace | Layer, places: Array, points: Array, pick: Callable[[Any], Any]) -> Array:
    """Rows of the motion of points under unit point forces at places."""
    return np.asarray(pick(influence(ground, points, places)))


def influence(ground: HalfSpace | Layer, points: Array, forces: Array) -> Array:
    """Motion (3 N, 3 n) of points (N, 3) under unit point forces at (n, 2) on the surface, m/N."""
    depth = np.broadcast_to(points[:, 2] - ground.top, (len(forces), len(points))).T
    offsets = np.dstack([points[:, None, :2] - forces, depth])
    half = ground if isinstance(ground, HalfSpace) else ground.half_space
    blocks = point_forces(half, offsets)
    if isinstance(ground, Layer):
        flat = offsets.reshape(-1, 3)
        heights = np.repeat(points[:, 2], len(forces))
        more = unit_point(ground, np.hypot(flat[:, 0], flat[:, 1]), heights)
        blocks = blocks + matrices(more, flat[:, :2]).reshape(blocks.shape)
    return blocks.transpose(0, 2, 1, 3).reshape(3 * len(points), 3 * len(forces))


def _cell(places: Array) -> float:
    """Area that each force of a grid stands for: the square of the distance of its neighbours (m^2)."""
    from scipy.spatial import cKDTree

    return float(np.median(cKDTree(places).query(places, k=2)[0][:, 1])) ** 2
