"""The inverse finite element method: displacements whose strains are those that gauges read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._readonly import ReadOnly
from .._system.sensors import Sensor
from ..errors import InputError, finite, positive, reals
from . import _squares as squares
from ._elements import elements_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SensedField(ReadOnly):
    """Displacements of a whole structure, from strains.

    Parameters
    ----------
    values : array, shape (n,) or (frames, n)
        Of every DOF, held ones zero: m, rad.
    gain : array, shape (n, gauges)
        Values per unit of each reading.
    noise : array, shape (gauges,), or None
        Std of the readings, where it was stated.
    """

    values: Array
    gain: Array
    noise: Array | None

    @property
    def std(self) -> Array | None:
        """Std of every DOF (n,) that the noise of the gauges makes; None where that was not stated."""
        return None if self.noise is None else np.asarray(np.linalg.norm(self.gain * self.noise, axis=1))

    def covariance(self, rows: ArrayLike) -> Array:
        """Covariance (points, points) of ``rows @ values``, rows (points, n).

        Raises
        ------
        InputError
            If the noise of the gauges was not stated.
        """
        if self.noise is None:
            raise InputError(
                "the covariance of a field needs the noise of the gauges",
                where="SensedField",
                found="no noise",
                expected="noise= of InverseFEM, or of the gauges",
            )
        root = np.asarray(rows, float) @ (self.gain * self.noise)
        return np.asarray(root @ root.T)


class InverseFEM(ReadOnly):
    """Shape sensing by inverse finite elements: strains to displacements, without loads, stiffness or mass.

    Minimises the squared misfit of the gauges, each weighted by its noise, plus a small share of what strains differ
    from a field that is linear over neighbouring elements, and a smaller one of all strains: an element without a gauge
    continues those around it (A. Tessler, J. L. Spangler, Comput. Methods Appl. Mech. Eng. 194 (2005) 327, with a
    smoothing of strains as in A. Tessler, H. R. Riggs, M. Dambach, ibid. 155 (1998) 1). By orthogonal factorisation;
    the normal equations are not formed.

    Parameters
    ----------
    model : Structure or QuadPlate
        Beam, rectangular plate (thin), frame, or flat quadrilaterals (thin, or with shear; bending, or with stretch).
    gauges : sequence of StrainGauge or Displacement
        Where on the structure they are.
    noise : float or array (gauges,), optional
        Std of the readings; default what the gauges declare.
    smoothness : float
        Weight of the bends of the strains between elements, beside a gauge's 1.
    weight : float
        Weight of strains where no gauge is, beside a gauge's 1: Tessler and Spangler's, as a factor of the misfit and
        not of its square.

    Raises
    ------
    InputError
        A gauge outside the structure or twice the same label, gauges and supports that leave a motion open.
    """

    def __init__(
        self, model: Any, gauges: Sequence[Sensor], *, noise: Any = None, smoothness: float = 1e-3, weight: float = 1e-5
    ) -> None:
        self._elements = elements_of(model)
        self.gauges = tuple(gauges)
        if not self.gauges:
            raise InputError("no gauges", where="InverseFEM", found="an empty list", expected="strain gauges on it")
        self.noise = _noise(noise, self.gauges)
        free, n = self._elements.free, len(self._elements.dofs)
        rows = np.array([self._elements.row(one) for one in self.gauges])
        level = np.ones(len(rows)) if self.noise is None else self.noise
        size = _alike(rows, self.gauges, level)
        sampled = self._elements.sampled()
        smooth = positive("smoothness", smoothness, where="InverseFEM", unit="1")
        small = positive("weight", weight, where="InverseFEM", unit="1")
        A = sparse.vstack(
            [
                sparse.csr_array(rows / size[:, None]),
                smooth * (sampled.bends @ sampled.strains),
                small * sampled.strains,
            ],
            format="csr",
        )[:, free]
        rhs = np.zeros((A.shape[0], len(rows)))
        rhs[: len(rows)] = np.diag(1 / size)
        found, lost = squares.factorise(sparse.csr_array(A), rhs)
        if len(lost):
            names = [str(self._elements.dofs[i]) for i in np.flatnonzero(free)[lost[:6]]]
            raise InputError(
                "the supports leave a motion open that no gauge sees",
                where="InverseFEM",
                found=names,
                expected="supports, or displacement sensors, that hold the structure",
            )
        self.gain = np.zeros((n, len(rows)))
        self.gain[free] = found.solution
        self.rows = rows
        self.gain.setflags(write=False)
        self.rows.setflags(write=False)

    def estimate(self, readings: ArrayLike) -> SensedField:
        """Displacements behind readings (gauges,) or (frames, gauges), in m/m and m.

        Raises
        ------
        InputError
            Readings that do not fit the gauges, or NaN.
        """
        y = reals(readings, where="InverseFEM", what="the readings are no numbers")
        if y.ndim not in (1, 2) or y.shape[-1] != len(self.gauges):
            raise InputError(
                "the readings do not fit the gauges",
                where="InverseFEM",
                found=f"shape {y.shape}",
                expected=f"({len(self.gauges)},) or (frames, {len(self.gauges)})",
            )
        finite(y, where="InverseFEM readings", hint="leave a gauge without readings out of gauges=")
        return SensedField(y @ self.gain.T, self.gain, self.noise)

    def row(self, sensor: Sensor) -> Array:
        """Row (n,) with which a sensor reads the field: ``row @ field.values``."""
        return self._elements.row(sensor)


def _noise(given: Any, gauges: Sequence[Sensor]) -> Array | None:
    """Std of each gauge: stated, or declared by all of them."""
    if given is None:
        declared = [one.noise for one in gauges]
        return None if any(level is None for level in declared) else np.array(declared, float)
    level = reals(given, where="InverseFEM, noise")
    if level.shape not in ((), (len(gauges),)) or not np.all(level > 0) or not np.all(np.isfinite(level)):
        raise InputError(
            "no noise of the gauges",
            where="InverseFEM",
            found=f"shape {level.shape}",
            expected=f"one std, or ({len(gauges)},), above zero, in m/m",
        )
    return np.broadcast_to(level, len(gauges)).copy()


def _alike(rows: Array, gauges: Sequence[Sensor], level: Array) -> Array:
    """What divides each row: one for strains of mean noise; a displacement counts as a strain that moves it as much."""
    strain = np.array([one.quantity == "strain" for one in gauges])
    size = np.empty(len(rows))
    for kind in (strain, ~strain):
        if kind.any():
            size[kind] = level[kind] / np.sqrt(np.mean(level[kind] ** 2))
    if strain.any() and (~strain).any():
        lengths = np.linalg.norm(rows, axis=1)
        size[~strain] *= np.median(lengths[~strain]) / np.median(lengths[strain])
    elif not strain.any():
        size *= np.median(np.linalg.norm(rows, axis=1))
    return size
