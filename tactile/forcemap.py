"""The answer of every tactile sensor: a force map, which is a load estimate that knows its surface."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from loadid.estimate import LoadEstimate
from structures.errors import InputError
from structures.values import plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
PROVIDED = ("tracked", "measured", "completed")
SHARE = 0.1  # of the peak pressure, from which a point is taken to be in contact
CLEAR = 3.0  # stds above zero that a pressure must lie to be contact


@dataclass(frozen=True, eq=False)
class Vector:
    """Three components with their standard deviations and one unit: a resultant force, or a torque."""

    value: Array
    std: Array
    unit: str

    def __str__(self) -> str:
        from loadid.summary import plus_minus

        last = (np.atleast_2d(a)[-1] for a in (self.value, self.std))
        return f"({', '.join(plus_minus(v, s) for v, s in zip(*last, strict=True))}) {self.unit}"


@dataclass(frozen=True, eq=False)
class Contact:
    """Where the pad is touched.

    Parameters
    ----------
    mask : bool array (P,)
        Nodes in contact.
    area : float
        m^2, by tributary areas.
    centre : array (2,)
        Centre of pressure in the plane of the pad (m).
    radius : float
        Radius (m) of the Hertz pressure of the same second moment, ``sqrt(5/2 <r^2>)``.
    peak : float
        Largest pressure (Pa).
    slip : array (P,)
        Shear over pressure at the nodes in contact, NaN elsewhere: near the friction coefficient where it slips.
    threshold : float
        Pressure (Pa) above which a node counts as in contact.
    """

    mask: NDArray[np.bool_]
    area: float
    centre: Array
    radius: float
    peak: float
    slip: Array
    threshold: float

    def __str__(self) -> str:
        x, y = 1e3 * self.centre
        return (
            f"contact of {1e6 * self.area:.3g} mm^2 about ({x:.3g}, {y:.3g}) mm, radius {1e3 * self.radius:.3g} mm, "
            f"peak {1e-3 * self.peak:.3g} kPa"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceMap(LoadEstimate):
    """A contact force field on the surface of a pad, with its uncertainty.

    A `loadid.LoadEstimate`: ``load`` and ``std`` hold tractions (Pa, ``geometry["kind"] == "hats"``) or nodal forces
    (N, ``"nodal"``), node by node, components X, Y, Z: (3 P,) for one frame or (frames, 3 P). Tractions act on the
    pad; a pressure is ``-t_z``. ``geometry`` holds also the boundary mass, the centre for moments and the covariance
    of the resultant.
    """

    @property
    def provided(self) -> Mapping[str, str]:
        """Where each component of the motion came from: ``tracked``, ``measured``, ``completed`` or ``unknown``."""
        return dict(self.facts.get("provided", {}))

    @property
    def single(self) -> bool:
        """Whether this is one frame."""
        return self.load.ndim == 1

    @property
    def nodes(self) -> Array:
        """Places of the nodes (P, 3) in m."""
        return np.asarray(self._geometry["coordinates"], float)

    @property
    def areas(self) -> Array:
        """Tributary areas (P,) in m^2."""
        return np.asarray(self._geometry["measures"], float)

    def frame(self, index: int) -> Self:
        """One frame of a sequence."""
        from dataclasses import replace

        if self.single:
            return self
        cut = {n: getattr(self, n)[index] for n in ("load", "std", "response", "residual") if _has(self, n)}
        spread = self._covariance if self._covariance.ndim == 2 else self._covariance[index]
        return replace(self, axis=None, geometry={**self._geometry, "resultant_covariance": spread}, **cut)

    def forces(self) -> Array:
        """Consistent nodal forces (..., P, 3) in N."""
        g = self._vectors(self.load)
        if self._geometry["kind"] == "nodal":
            return g
        return self._apply(lambda column: np.asarray(self._mass @ column), g)

    def traction(self) -> Array:
        """Tractions at the nodes (..., P, 3) in Pa: of nodal forces by the boundary mass (or tributary areas)."""
        g = self._vectors(self.load)
        if self._geometry["kind"] != "nodal":
            return g
        if self._solve is None:
            return g / self.areas[:, None]
        return self._apply(self._solve, g)

    def pressure(self) -> Array:
        """Normal pressure at the nodes (..., P) in Pa, positive where the pad is pressed."""
        return -self.traction()[..., 2]

    def resultant(self) -> Vector:
        """Force on the pad, (..., 3) in N, with its std."""
        return self._wrench(slice(0, 3), "N")

    def torque(self, about: ArrayLike | None = None) -> Vector:
        """Moment of the load, (..., 3) in N m, about the centre of the loaded surface or another point (x, y, z)."""
        if about is None:
            return self._wrench(slice(3, 6), "N m")
        point = np.asarray(plain(about), float)
        if point.shape != (3,) or not np.all(np.isfinite(point)):
            raise InputError("no point", where="torque, about", found=repr(about), expected="(x, y, z) in m")
        arm = np.asarray(self._geometry["about"], float) - point
        cross = np.array([[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]])
        turn = np.hstack([cross, np.eye(3)])
        values = self._rows() @ turn.T
        return Vector(values, _spread(turn @ self._covariance @ turn.T, values), "N m")

    def contact(self, share: float = SHARE) -> Contact:
        """Where the pad is touched: pressure above `share` of its peak and clear of its noise. One frame.

        Raises
        ------
        InputError
            For a sequence (ask ``frame(i)``), or a share outside 0 to 1.
        """
        if not self.single:
            raise InputError("contact is that of one frame", where="contact", found=f"{len(self.load)} frames",
                             expected="one", hint="force.frame(i).contact()")  # fmt: skip
        if not 0 < share < 1:
            raise InputError("no share of the peak", where="contact", found=share, expected="between 0 and 1")
        t, areas = self.traction(), self.areas
        p, spread = -t[:, 2], self._vectors(self.std)[:, 2]
        spread = spread / areas if self._geometry["kind"] == "nodal" else spread
        peak = float(p.max())
        threshold = share * max(peak, 0.0)
        mask = (p > threshold) & (p > CLEAR * spread)
        weight = np.where(mask, p, 0.0) * areas
        total = float(weight.sum())
        xy = self.nodes[:, :2]
        centre = weight @ xy / total if total > 0 else np.full(2, np.nan)
        radius = float(np.sqrt(2.5 * (weight @ np.sum((xy - centre) ** 2, axis=1)) / total)) if total > 0 else 0.0
        slip = np.full(len(p), np.nan)
        slip[mask] = np.hypot(t[mask, 0], t[mask, 1]) / p[mask]
        return Contact(mask, float(areas[mask].sum()), centre, radius, max(peak, 0.0), slip, threshold)

    def plot(
        self,
        kind: str = "map",
        *,
        truth: ArrayLike | None = None,
        ax: Axes | None = None,
        path: str | os.PathLike | None = None,
        show: bool = False,
    ) -> Figure:
        """Picture: ``"map"`` (pressure, shear, std; force and torque of a sequence below), or as `LoadEstimate.plot`.

        Parameters
        ----------
        kind : str
        truth : array (P, 3) or (frames, P, 3), optional
            Known tractions (Pa), for ``"map"``.
        ax, path, show
            As `LoadEstimate.plot`.
        """
        if kind != "map":
            return super().plot(kind, truth=truth, ax=ax, path=path, show=show)
        from .plots.maps import map_figure, sequence_figure

        figure = map_figure(self, truth=truth) if self.single else sequence_figure(self, truth=truth)
        if path is not None:
            figure.savefig(path)
        if show:
            from matplotlib import pyplot

            pyplot.show()
        return figure

    def report(self, path: str | os.PathLike, *, truth: ArrayLike | None = None) -> None:
        """Write one self-contained HTML page."""
        from .report import write_report

        write_report(self, path, truth=truth)

    @classmethod
    def read(cls, path: str | os.PathLike) -> Self:
        """Read a result file.

        Raises
        ------
        InputError
            If the file is missing, of another kind, damaged, or no force map.
        """
        found = LoadEstimate.read(path)
        if found.geometry is None or "resultant_covariance" not in found.geometry:
            raise InputError(
                "this result is no force map",
                where=str(path),
                found="a load estimate",
                expected="what a tactile sensor saved",
                hint="loadid.LoadEstimate.read reads it",
            )
        return cls(**{f.name: getattr(found, f.name) for f in fields(LoadEstimate)})

    # -- inside -------------------------------------------------------------------------------------------------------
    @property
    def _geometry(self) -> Mapping[str, Any]:
        assert self.geometry is not None
        return self.geometry

    @cached_property
    def _mass(self) -> sparse.csr_array:
        g = self._geometry
        count = len(g["measures"])
        return sparse.csr_array((g["mass_data"], g["mass_indices"], g["mass_indptr"]), shape=(count, count))

    @cached_property
    def _solve(self) -> Any:
        from scipy.sparse.linalg import splu

        return splu(self._mass.tocsc()).solve if "mass_data" in self._geometry else None

    @property
    def _covariance(self) -> Array:
        return np.asarray(self._geometry["resultant_covariance"], float)

    def _vectors(self, values: NDArray) -> Array:
        return values.reshape(*values.shape[:-1], -1, 3)

    def _apply(self, act: Any, g: Array) -> Array:
        flat = np.ascontiguousarray(np.moveaxis(g, -2, 0).reshape(g.shape[-2], -1))
        done = np.asarray(act(flat)).reshape(g.shape[-2], *g.shape[:-2], 3)
        return np.moveaxis(done, 0, -2)

    def _rows(self) -> Array:
        return np.asarray(self.load @ np.asarray(self._geometry["resultant"], float).T)

    def _wrench(self, part: slice, unit: str) -> Vector:
        values = self._rows()[..., part]
        return Vector(values, _spread(self._covariance[..., part, part], values), unit)


def _spread(covariance: Array, values: Array) -> Array:
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    return np.broadcast_to(np.sqrt(np.maximum(variance, 0.0)), values.shape)


def _has(estimate: LoadEstimate, name: str) -> bool:
    return getattr(estimate, name) is not None
