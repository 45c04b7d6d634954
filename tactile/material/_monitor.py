"""A gel in use: has its gain changed (E), its shape (thickness, boundary, nu), or its rest position?

The same few presses of known force, repeated after weeks, are held against those of the calibration. A change of E
multiplies every map by one factor; wear of the thickness, a bond that lets go or another Poisson's ratio also change
its shape, but little: a layer 15 % thinner keeps a correlation of 0.996. So the share of the map that no gain explains
is judged against the noise, and not the correlation alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structures._flags import Flag
from structures.errors import InputError, positive, reals

from .. import _guards as guards
from .._arrays import PLANE, SPACE, Array, shaped
from .._closed.layer import Layer
from .._closed.presses import Press

FEWEST = 6
NEIGHBOURS, SHIFT_STEP = 40, 0.02  # neighbours that carry a derivative; its difference, over the distance of neighbours


def tangents(points: ArrayLike, maps: Array) -> Array:
    """Derivatives of maps (presses, N, C) along X and Y, (presses, N, C, 2), by cubic radial functions.

    The places (N, 2 or 3) in m may lie on a grid or not; at least six.
    """
    from scipy.interpolate import RBFInterpolator
    from scipy.spatial import cKDTree

    n, what = maps.shape[1], "places do not fit the maps"
    x = shaped(points, (n, 2), (n, 3), where="GelMonitor, points", what=what, fewest=FEWEST, hint="markers, in m")
    x = x[:, :2]
    near = float(np.median(cKDTree(x).query(x, k=2)[0][:, 1]))
    x = x / near
    values = maps.transpose(1, 0, 2).reshape(len(x), -1)
    surface = RBFInterpolator(x, values, neighbors=min(len(x), NEIGHBOURS), kernel="cubic", degree=2)
    found = []
    for e in np.eye(2) * SHIFT_STEP:
        slope = (surface(x + e) - surface(x - e)) / (2 * SHIFT_STEP * near)
        found.append(slope.reshape(len(x), len(maps), -1).transpose(1, 0, 2))
    return np.stack(found, axis=-1)


def taken_out(reference: Array, found: Array, tangent: Array) -> tuple[Array, tuple[float, float]]:
    """One map (N, C) with the shift of its press taken out, and that shift (m).

    A map moved by d is reference - d . grad(reference), to first order; gain and shift are fitted together.
    """
    A = np.concatenate([reference.reshape(-1, 1), tangent.reshape(-1, 2)], axis=1)
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1.0
    gain, *moved = np.linalg.lstsq(A / size, found.ravel(), rcond=None)[0] / size
    if gain == 0:
        return found, (0.0, 0.0)
    return found - tangent @ np.array(moved), (float(-moved[0] / gain), float(-moved[1] / gain))


STEP = 1e-4  # of a value's range, for its derivative


@dataclass(frozen=True)
class Cause:
    """One change that would explain the maps, if it were the only one.

    Parameters
    ----------
    name : {"E", "thickness", "nu"}
    value, std : float
        New value (SI) and its std.
    change : float
        Relative to the calibration; for nu, the difference.
    misfit : float
        Rms of what is left, over the noise: about 1 where the cause explains the maps.
    """

    name: str
    value: float
    std: float
    change: float
    misfit: float


def attributed(
    moved: Array, sigma: float, layer: Layer, presses: Sequence[Press], points: ArrayLike
) -> tuple[Cause, ...]:
    """Causes, the best one first, for a change of displacements (presses, N, C) in m of noise std `sigma`."""
    kept = np.isfinite(moved)
    moved = np.where(kept, moved, 0.0)

    def motion(ground: Layer) -> Array:
        return np.array([p.displacement(ground, points)[:, : moved.shape[2]] for p in presses])

    start = motion(layer)
    if start.shape != moved.shape:
        raise InputError("presses and points do not fit the maps", where="GelMonitor.attribute",
                         found=f"{len(presses)} presses", expected=f"maps of shape {moved.shape}",
                         hint="one press for each map, one point for each marker")  # fmt: skip

    def alone(name: str, value: float, low: float, high: float, make: Callable[[float], Any]) -> Cause:
        def change(v: float) -> Array:
            return np.where(kept, motion(make(v)) - start, 0.0)

        return _alone(name, value, (low, high), change, moved, sigma, int(kept.sum()))

    causes = (
        alone("E", layer.E, 0.2 * layer.E, 5 * layer.E, lambda v: replace(layer, E=v)),
        alone("thickness", layer.h, 0.3 * layer.h, 2 * layer.h, lambda v: replace(layer, h=v)),
        alone("nu", layer.nu, 0.0, 0.4999, lambda v: replace(layer, nu=v)),
    )
    return tuple(sorted(causes, key=lambda c: c.misfit))


def _alone(
    name: str,
    start: float,
    limits: tuple[float, float],
    change: Callable[[float], Array],
    moved: Array,
    sigma: float,
    count: int,
) -> Cause:
    """Fit one value by Gauss-Newton, to a fiftieth of its std."""
    value, step = start, STEP * (limits[1] - limits[0])
    for _ in range(6):
        here = change(value)
        ahead = step if value + step <= limits[1] else -step
        slope = (change(value + ahead) - here) / ahead
        size = float(np.sum(slope**2))
        after = float(np.clip(value + np.sum(slope * (moved - here)) / size, *limits))
        done, value = abs(after - value) < 0.02 * sigma / np.sqrt(size), after
        if done:
            break
    left = moved - change(value)
    misfit = float(np.sqrt(np.sum(left**2) / max(count - 1, 1))) / sigma
    relative = value - start if name == "nu" else value / start - 1
    return Cause(name, value, sigma / float(np.sqrt(size)), relative, misfit)


@dataclass(frozen=True)
class GelCheck:
    """What a repeat of the reference presses shows.

    Parameters
    ----------
    gain, gain_std : float
        Scale of the maps now over the reference, of all presses. For presses of the same force, E has become E / gain.
    gains : tuple of (float, float)
        The same for each press, with its std: of one E they agree.
    correlation : float
        Cosine of the maps, noise included.
    share : float
        Share of the map that no gain explains, noise taken out.
    significance : float
        By how many sd of the noise that share stands out.
    offset : float or None
        Rms offset of the unloaded markers (m).
    verdict : {"unchanged", "gain", "shape"}
    flags : tuple of Flag
        W607, W705, W706.
    shifts : tuple of (float, float)
        By how much each press lies beside its place (m), where the monitor knows the markers' places.
    """

    gain: float
    gain_std: float
    gains: tuple[tuple[float, float], ...]
    correlation: float
    share: float
    significance: float
    offset: float | None
    verdict: str
    flags: tuple[Flag, ...] = ()
    shifts: tuple[tuple[float, float], ...] = ()

    def __str__(self) -> str:
        text = (
            f"{self.verdict}: gain {self.gain:.4g} +- {self.gain_std:.2g}, correlation {self.correlation:.4f}, "
            f"{self.share:.1%} of the map is no gain ({self.significance:.1f} sd)"
        )
        if self.shifts:
            text += f", presses up to {1e3 * max(float(np.hypot(*d)) for d in self.shifts):.2g} mm beside their places"
        text += "" if self.offset is None else f", unloaded offset {1e6 * self.offset:.3g} um"
        return "\n".join([text, *map(str, self.flags)])


@dataclass(frozen=True, eq=False)
class GelMonitor:
    """The reference that later checks are held against.

    Parameters
    ----------
    reference : array (presses, N, C) or (N, C)
        Maps of the reference presses at calibration: displacements of the markers (m), or unregularised force maps.
        Presses of different size tell gain from shape best.
    noise : float
        Std of each component of a map that is checked.
    reference_noise : float, optional
        Std of each component of the reference, smaller where it was averaged; default `noise`.
    calibrated : datetime or str
        Date of the calibration (ISO). Default now.
    period : float
        Days that a calibration lasts.
    rest : array (M, 2 or 3), optional
        Markers of the unloaded gel at calibration (m), averaged over frames.
    rest_noise : float, optional
        Std of a coordinate of an unloaded marker when checked (m); default `noise`.
    points : array (N, 2 or 3), optional
        Places of the maps' points (m). With them a press that is repeated beside its place is recognised and its shift
        taken out, up to a tenth of its radius; without them 0.1 mm beside may pass for a change of shape.

    Raises
    ------
    InputError
        Maps that are none, NaN, noise that is not positive, a date that cannot be read.
    """

    reference: Any
    noise: float
    reference_noise: float | None = None
    calibrated: datetime | str = field(default_factory=lambda: datetime.now(UTC))
    period: float = guards.PERIOD
    rest: Any = None
    rest_noise: float | None = None
    points: Any = None
    _tangents: Any = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "reference", _maps(self.reference, "reference"))
        put(self, "noise", positive("noise", self.noise, where="GelMonitor"))
        for name in ("reference_noise", "rest_noise"):
            given = getattr(self, name)
            put(self, name, self.noise if given is None else positive(name, given, where="GelMonitor"))
        put(self, "calibrated", _date(self.calibrated, "calibrated"))
        put(self, "period", positive("period", self.period, where="GelMonitor", unit="days"))
        if self.rest is not None:
            put(self, "rest", _points(self.rest, None))
        if self.points is not None:
            put(self, "_tangents", tangents(self.points, self.reference))

    def check(
        self,
        maps: ArrayLike,
        *,
        unloaded: ArrayLike | None = None,
        now: datetime | str | None = None,
        validated: datetime | str | None = None,
    ) -> GelCheck:
        """Hold a repeat of the presses against the reference.

        Parameters
        ----------
        maps : array, as the reference
            Points that are NaN (lost markers) are left out.
        unloaded : array (M, 2 or 3), optional
            Markers of the unloaded gel now (m), NaN where lost.
        now : datetime or str, optional
            Date of the check; default the clock.
        validated : datetime or str, optional
            Date of the validation that is quoted for this sensor.

        Raises
        ------
        InputError
            Maps that do not fit the reference.
        """
        found = _maps(maps, "maps", like=self.reference)
        kept = np.asarray(np.isfinite(found).all(axis=-1))
        if not (kept.sum(axis=1) >= 3).all():
            raise InputError("fewer than three points of a press are left", where="GelMonitor.check",
                             found=int(kept.sum(axis=1).min()), expected="three or more",
                             hint="leave that press out of reference and check")  # fmt: skip
        pairs = [(r[k], m[k]) for r, m, k in zip(self.reference, found, kept, strict=True)]
        shifts: tuple[tuple[float, float], ...] = ()
        if self.points is not None:
            placed = [taken_out(r, m, t[k]) for (r, m), t, k in zip(pairs, self._tangents, kept, strict=True)]
            pairs = [(r, m) for (r, _), (m, _) in zip(pairs, placed, strict=True)]
            shifts = tuple(shift for _, shift in placed)
        gains = tuple(self._gain(r, m) for r, m in pairs)
        a, b = (np.concatenate([p[i].ravel() for p in pairs]) for i in (0, 1))
        gain, std = self._gain(a, b)
        share, significance = self._unexplained(a, b, gain)
        correlation = float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b))) if b.any() else 0.0
        offset, expected = self._offset(unloaded)
        calibrated = _date(self.calibrated, "calibrated")
        days = (_date(now or datetime.now(UTC), "now") - calibrated).total_seconds() / 86400
        changed = guards.gain_or_shape(gain, correlation, share, significance)
        flags = [
            changed,
            None if offset is None else guards.drift(offset, expected, calibrated),
            guards.age(days, self.period, calibrated),
            None if validated is None else guards.other_calibration(_date(validated, "validated"), calibrated),
        ]
        verdict = guards.change(gain, correlation, share, significance)
        return GelCheck(gain, std, gains, correlation, share, significance, offset, verdict,
                        tuple(f for f in flags if f is not None), shifts)  # fmt: skip

    def attribute(
        self, maps: ArrayLike, layer: Layer, presses: Sequence[Press], points: ArrayLike
    ) -> tuple[Cause, ...]:
        """Which single change of the layer explains the maps best, the best one first.

        Parameters
        ----------
        maps : array, as the reference
            Displacements of the markers now (m).
        layer : Layer
            The pad as calibrated.
        presses : sequence of Press
            What presses it, one for each map.
        points : array (N, 2 or 3)
            Markers (m).

        Notes
        -----
        The change of the maps since the calibration is compared with the change of the exact layer's motion, so that
        what the layer does not model cancels to first order.
        """
        found = _maps(maps, "maps", like=self.reference)
        sigma = float(np.hypot(self.noise, self.reference_noise or self.noise))
        return attributed(found - self.reference, sigma, layer, presses, points)

    def _gain(self, reference: Array, found: Array) -> tuple[float, float]:
        """Least squares, without the fall that noise of the reference would cause; and its std."""
        noise = float(self.reference_noise or 0.0)
        energy = float(np.sum(reference**2)) - reference.size * noise**2
        if energy <= 0:
            raise InputError("a reference press no larger than its noise", where="GelMonitor",
                             found=f"rms {np.sqrt(np.mean(reference**2)):.3g}", expected=f"well above {noise:.3g}",
                             hint="press harder at calibration")  # fmt: skip
        gain = float(np.sum(reference * found)) / energy
        return gain, float(np.hypot(self.noise, gain * noise) / np.sqrt(energy))

    def _unexplained(self, reference: Array, found: Array, gain: float) -> tuple[float, float]:
        """Share of the map that no gain explains, the expected noise taken out, and its distance from zero in sd."""
        variance = self.noise**2 + (gain * float(self.reference_noise or 0.0)) ** 2
        excess = float(np.sum((found - gain * reference) ** 2)) - (found.size - 1) * variance
        energy = gain**2 * float(np.sum(reference**2))
        share = float(np.sqrt(max(excess, 0.0) / energy)) if energy > 0 else 0.0
        return share, float(excess / (variance * np.sqrt(2 * found.size)))

    def _offset(self, unloaded: ArrayLike | None) -> tuple[float | None, float]:
        """Rms offset of the unloaded markers, and what noise explains."""
        if unloaded is None or self.rest is None:
            return None, 0.0
        away = _points(unloaded, self.rest.shape) - self.rest
        away = away[np.isfinite(away).all(axis=1)]
        if len(away) < 3:
            raise InputError("fewer than three unloaded markers are left", where="GelMonitor.check, unloaded",
                             found=len(away), expected="three or more", hint="track them again")  # fmt: skip
        noise = float(self.rest_noise or self.noise)
        return float(np.sqrt(np.mean(np.sum(away**2, axis=1)))), noise * float(np.sqrt(away.shape[1]))


def _maps(values: Any, name: str, like: Array | None = None) -> Array:
    array = reals(values, where=f"GelMonitor, {name}")
    array = array[None] if array.ndim == 2 else array
    return shaped(
        array, (None, None, None) if like is None else like.shape, where=f"GelMonitor, {name}", fewest=1,
        what="no maps of presses" if like is None else "maps of the presses do not fit", lost=like is not None,
        hint="(presses, points, components): the same presses at the same points, in the same order",
    )  # fmt: skip


def _points(values: Any, shape: tuple[int, ...] | None) -> Array:
    shapes = (PLANE, SPACE) if shape is None else (shape,)
    what, hint = "unloaded markers do not fit", "the same markers, in order"
    return shaped(values, *shapes, where="GelMonitor, unloaded markers", what=what, lost=True, hint=hint)


def _date(value: datetime | str, name: str) -> datetime:
    """A date with its time zone; UTC where it names none."""
    try:
        found = value if isinstance(value, datetime) else datetime.fromisoformat(str(value))
    except ValueError:
        raise InputError(f"{name} is no date", where="GelMonitor", found=repr(value)[:40],
                         expected="2026-03-01, or a datetime", hint="ISO format") from None  # fmt: skip
    return found if found.tzinfo else found.replace(tzinfo=UTC)
