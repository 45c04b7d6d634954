"""E and nu of the gel in its sensor, from presses with a known force: E is a gain, nu is in the shape of the motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.flags import Flag
from structures.values import reals

from .guards.pad import modulus

if TYPE_CHECKING:
    from .reading import DepthMap
    from .sensor import LinearSensor

Array = NDArray[np.float64]
AXES = 3


@dataclass(frozen=True, eq=False)
class Gain:
    """Modulus that makes the estimated forces those that were measured.

    Parameters
    ----------
    E, std : float
        Pa; the std is from the scatter of the presses, infinite for a single one.
    ratio : float
        E over the modulus that the sensor was built with.
    residual : float
        Rms of what is left over the rms of the forces.
    flags : tuple of Flag
        W111 where no elastomer has this modulus.
    """

    E: float
    std: float
    ratio: float
    residual: float
    flags: tuple[Flag, ...] = ()

    def __str__(self) -> str:
        return (
            f"E = {self.E:.4g} +- {self.std:.2g} Pa ({self.ratio:.4g} of the modulus assumed); "
            f"{100 * self.residual:.2g} % of the forces is left over"
        )


@dataclass(frozen=True, eq=False)
class Shape:
    """Poisson's ratio from the shape of the motion, and the modulus that goes with it.

    Parameters
    ----------
    nu, std : float
        Minimum of the misfit and its std, by its curvature.
    gain : Gain
        At this nu.
    tried, misfit : array
        What was tried, and minus twice the log likelihood (up to a constant).
    inside : bool
        The minimum lies between those that were tried; else nu is a bound only.
    """

    nu: float
    std: float
    gain: Gain
    tried: Array
    misfit: Array
    inside: bool

    def __str__(self) -> str:
        where = "" if self.inside else " (at the end of what was tried: a bound only)"
        return f"nu = {self.nu:.4f} +- {self.std:.2g}{where}; {self.gain}"


def gain(E: float, estimated: ArrayLike, measured: ArrayLike) -> Gain:
    """Modulus from forces: ``E <- E sum(F_ref F_est) / sum(F_est^2)``.

    Parameters
    ----------
    E : float
        Modulus of the sensor (Pa).
    estimated, measured : array (presses, 3) or (presses,)
        Resultants that the sensor gave, and those that a balance, weights or an F/T sensor told (N).

    Raises
    ------
    InputError
        Shapes that differ, NaN, no force at all.
    """
    a, b = (reals(v, what="the forces are no real numbers", where="gain") for v in (estimated, measured))
    if a.shape != b.shape or a.size == 0 or not np.all(np.isfinite(a)) or not np.all(np.isfinite(b)):
        raise InputError("the forces do not fit", where="gain", found=f"{a.shape} and {b.shape}, or NaN",
                         expected="finite, one row per press in both")  # fmt: skip
    x, y = a.ravel(), b.ravel()
    if not x @ x > 0:
        raise InputError("the estimated forces are zero", where="gain", found="no force", expected="presses that press")
    ratio = float(x @ y / (x @ x))
    if not ratio > 0:
        raise InputError("the estimated forces point the other way", where="gain", found=f"ratio {ratio:.3g}",
                         expected="> 0", hint="forces are those on the pad: a press has Fz < 0")  # fmt: skip
    rest = y - ratio * x
    # presses scatter as wholes, strong ones more than weak ones: each press counts by its own residual
    each, count = np.sum(np.reshape(x * rest, (len(a), -1)), axis=1), len(a)
    std = float(np.sqrt(count / (count - 1) * np.sum(each**2))) / float(x @ x) if count > 1 else np.inf
    flag = modulus(E * ratio)
    size = float(np.sqrt(rest @ rest / (y @ y))) if y @ y > 0 else np.inf
    return Gain(E * ratio, E * std, ratio, size, () if flag is None else (flag,))


def poisson(
    build: Callable[[float], LinearSensor],
    tried: ArrayLike,
    frames: Sequence[Any],
    forces: ArrayLike,
    *,
    depths: Sequence[DepthMap] | None = None,
    force_std: float = 0.01,
    progress: Callable[[float, str], None] | None = None,
) -> Shape:
    """Poisson's ratio and modulus from presses with known forces, where the contact is known.

    For every nu the sensor explains the motion as well as it can (residual and penalty of its own inversion) and its
    forces are scaled onto the known ones; what is left of both is the misfit. A resultant alone does not tell nu, nor
    does motion in the plane. Say where the contact is (``support=`` of the sensor): on a mesh that is not that of the
    gel a contact that is only found biases nu by several hundredths. The std is that of the noise, not of the mesh.

    Parameters
    ----------
    build : callable
        Takes nu and gives a sensor whose lambda is frozen (``choice`` a number, small, such as 0.005: the ridge itself
        prefers some nu); its E does not matter.
    tried : array
        At least four values of nu, ascending.
    frames : sequence
        As `LinearSensor.estimate` takes them; presses of different sizes tell more.
    forces : array (presses, 3)
        N.
    depths : sequence of DepthMap, optional
    force_std : float
        Std of the known forces over the largest of them.

    Raises
    ------
    InputError
        Fewer than four values, forces that do not fit, a sensor whose lambda is not frozen.
    """
    nus = np.unique(reals(tried, where="poisson, tried"))
    F = reals(forces, where="poisson, forces")
    if len(nus) < 4 or F.shape != (len(frames), AXES):
        raise InputError("too few values, or forces that do not fit", where="poisson",
                         found=f"{len(nus)} values, forces {F.shape}",
                         expected=f"at least four values of nu, ({len(frames)}, 3) forces")  # fmt: skip
    said = progress or (lambda fraction, text: None)
    spread, misfit = force_std * float(np.abs(F).max()), []
    for i, nu in enumerate(nus):
        said(i / len(nus), f"nu = {nu:.4g}")
        misfit.append(_misfit(build(float(nu)), frames, depths, F, spread)[0])
    left = np.array(misfit)
    best, std, inside = _minimum(nus, left / max(1.0, left.min() / _count(frames, depths, F)))
    return Shape(best, std, _misfit(build(best), frames, depths, F, spread)[1], nus, left, inside)


def _count(frames: Sequence[Any], depths: Sequence[DepthMap] | None, F: Array) -> float:
    """Number of data, roughly: what the misfit would be if the model were right."""
    return float(sum(np.asarray(f).size for f in frames) + F.size)


def _misfit(
    sensor: LinearSensor, frames: Sequence[Any], depths: Sequence[DepthMap] | None, F: Array, spread: float
) -> tuple[float, Gain]:
    """Minus twice the log likelihood of one nu, and its modulus."""
    inverse, total, found = sensor.inverse, 0.0, []
    H, lam = sensor.model.H / inverse.spread[:, None], inverse.lam * inverse.scale
    for i, frame in enumerate(frames):
        y = sensor.readings(frame, None if depths is None else depths[i])
        # a load anywhere would explain any motion: only one that presses, where the contact is, tells nu
        load = sensor.pressed(y).load
        z = y / inverse.spread
        rest = (z - H @ load)[np.isfinite(z)]
        total += float(rest @ rest) + float(np.sum((lam * load) ** 2))
        found.append(sensor.resultant[:3] @ load)
    modulus_ = gain(sensor.E, found, F)
    total += float(np.sum(((F - modulus_.ratio * np.array(found)) / spread) ** 2))
    return total, modulus_


def _minimum(x: Array, y: Array) -> tuple[float, float, bool]:
    """Minimum of a curve through points by the parabola about the lowest, and its std by the curvature of y / 2."""
    i = int(np.argmin(y))
    if i in (0, len(x) - 1):
        return float(x[i]), float(np.diff(x).max()), False
    a, b, _ = np.polyfit(x[i - 1 : i + 2] - x[i], y[i - 1 : i + 2], 2)
    return float(x[i] - b / (2 * a)), float(1 / np.sqrt(a)), True
