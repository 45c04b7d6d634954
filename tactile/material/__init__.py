"""Modulus and Poisson's ratio of a gel from tensile and indentation tests, and what those tests do not show.

E and nu with their std come from tests of the material, or, with the thickness, from presses on the gel in its sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from structures._flags import Flag
from structures.errors import InputError, NotIdentifiable, number, positive, reals

from .._arrays import Array, shaped
from .._closed.contact import flat_stiffness, sphere_contact, sphere_force  # noqa: F401
from .._guards import modulus, one_of_two
from ._fits import (
    BEND,
    RATE,
    Curve,
    CurveFit,
    Indentation,
    Pooled,
    Tensile,
    Verdict,
    fit,
    linearity,
    poisson_of_curves,
    pool,
    rate_independence,
)
from ._fits import modulus as of_curve
from ._insitu import InSitu, in_situ

if TYPE_CHECKING:
    from .._sensors.linear import LinearSensor
    from .._sensors.observation import DepthMap

__all__ = ["InSitu", "Indentation", "Tensile", "from_tests", "gain", "in_situ", "poisson"]


KNOWN = 0.05  # std of Poisson's ratio beyond which the tests do not determine it
SIZES = 1.5  # ratio of indenter or contact sizes from which they count as two
LOWEST, HIGHEST, TRIAL = 0.0, 0.4995, 0.005


@dataclass(frozen=True)
class MaterialFit:
    """A material as its tests show it.

    Parameters
    ----------
    E, E_std : float
        Young's modulus (Pa), and its std: noise, scatter between runs, and what Poisson's ratio leaves open.
    nu, nu_std : float or None
        Poisson's ratio; None where the tests do not tell it and none was given.
    nu_source : {"lateral strain", "indenter sizes", "given", "not determined"}
    rate, linear : Verdict
        Rate independence and linearity: neither follows from the other.
    curves : tuple of CurveFit
    dof : int
        Of the std of E.
    flags : tuple of Flag
        W111 implausible modulus, W113 one verdict missing.
    """

    E: float
    E_std: float
    nu: float | None
    nu_std: float | None
    nu_source: str
    rate: Verdict
    linear: Verdict
    curves: tuple[CurveFit, ...]
    dof: int
    flags: tuple[Flag, ...] = ()

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Interval of E (Pa), by Student's t with the curves that there are."""
        relative = self.E_std / self.E
        half = Pooled(np.zeros(1), np.array([relative]), self.dof, 1.0).half_width(0, level)
        return float(self.E * np.exp(-half)), float(self.E * np.exp(half))

    def table(self) -> str:
        """Answer, verdicts, one line for each curve, and flags, as text."""
        low, high = self.interval()
        ratio = "not determined" if self.nu is None else f"{self.nu:.4g} +- {self.nu_std or 0.0:.2g} ({self.nu_source})"
        lines = [
            f"E = {self.E:.4g} +- {self.E_std:.2g} Pa (95 %: {low:.4g} to {high:.4g})",
            f"nu = {ratio}",
            str(self.rate),
            str(self.linear),
            f"{'curve':20s} {'rate 1/s':>9s} {'E Pa':>11s} {'std':>9s} {'bend %':>8s} {'std':>6s} {'strain %':>9s}",
        ]
        for f in self.curves:
            lines.append(f"{f.name[:20]:20s} {f.rate:9.3g} {f.E:11.4g} {f.std:9.2g} {100 * f.bend:8.2f} "
                         f"{100 * f.bend_std:6.2f} {100 * f.strain:9.2f}")  # fmt: skip
        return "\n".join([*lines, *map(str, self.flags)])

    def __str__(self) -> str:
        return self.table()


def from_tests(
    curves: Iterable[Curve],
    *,
    nu: float | tuple[float, float] | None = None,
    rate_tolerance: float = RATE,
    linear_tolerance: float = BEND,
) -> MaterialFit:
    """Modulus, Poisson's ratio and two verdicts from tensile and indentation curves, at one or several speeds.

    Parameters
    ----------
    curves : iterable of Tensile or Indentation
        Loading branches.
    nu : float or (value, std), optional
        Known Poisson's ratio. Without it, lateral strain or several indenter sizes must tell it where indentation is
        used; tensile tests give E without it.
    rate_tolerance, linear_tolerance : float
        Relative change of the modulus, over the speeds and over the strain tested, that still counts as none.

    Returns
    -------
    MaterialFit
        An implausible modulus is flagged, never corrected.

    Raises
    ------
    InputError
        No curve, or curves without stiffness.
    NotIdentifiable
        Indentation of one size without a Poisson's ratio: the force depends on E and nu together.
    """
    tests = list(curves)
    if not tests or not all(isinstance(c, Tensile | Indentation) for c in tests):
        raise InputError(
            "no tests", where="material.from_tests", found=f"{[type(c).__name__ for c in tests][:4]}",
            expected="Tensile and Indentation curves", hint="material.from_tests([Tensile(...), ...])",
        )  # fmt: skip
    given = _given(nu)
    ratio = _ratio(tests, given)
    used = 0.45 if ratio.value is None else ratio.value
    fits = tuple(fit(c, used) for c in tests)
    E, E_std, dof = _modulus(tests, fits, ratio)
    rate, linear = rate_independence(fits, rate_tolerance), linearity(fits, linear_tolerance)
    found = (modulus(E), one_of_two(rate.verdict, linear.verdict))
    return MaterialFit(
        E, E_std, ratio.value, ratio.std, ratio.source, rate, linear, fits, dof, tuple(f for f in found if f)
    )


@dataclass(frozen=True)
class _Ratio:
    """Poisson's ratio, its std and its source; with the pooled fit where it was found together with E."""

    value: float | None
    std: float | None
    source: str
    joint: Pooled | None = None


def _given(nu: float | tuple[float, float] | None) -> tuple[float, float] | None:
    if nu is None:
        return None
    pair = nu if isinstance(nu, tuple | list) and len(nu) == 2 else (nu, 0.0)
    value, std = (number("nu", v, where="material.from_tests") for v in pair)
    if not -1 < value < 0.5 or std < 0:
        raise InputError("Poisson's ratio is not possible", where="material.from_tests, nu", found=nu,
                         expected="-1 < nu < 0.5, or (nu, std)", hint="0.4995 for an incompressible gel")  # fmt: skip
    return value, std


def _ratio(tests: Sequence[Curve], given: tuple[float, float] | None) -> _Ratio:
    """Poisson's ratio from what tells it."""
    if given is not None and given[1] == 0:
        return _Ratio(given[0], 0.0, "given")
    lateral = [poisson_of_curves(c) for c in tests if isinstance(c, Tensile) and c.contraction is not None]
    direct = lateral + ([given] if given else [])
    pressed = any(isinstance(c, Indentation) for c in tests)
    if not pressed:
        if not direct:
            return _Ratio(None, None, "not determined")
        found = pool([v for v, _ in direct], [s for _, s in direct], np.ones((len(direct), 1)))
        return _Ratio(float(found.value[0]), float(found.std[0]), "lateral strain" if lateral else "given")
    joint = _joint(tests, direct)
    value, std = float(joint.value[1]), float(joint.std[1])
    if std > KNOWN or not (direct or _sizes(tests)):
        raise NotIdentifiable(
            f"E and Poisson's ratio cannot be told apart: std of nu is {std:.2g} (limit {KNOWN:g})"
            + ("" if direct or _sizes(tests) else ", with indenters of one size and no lateral strain"),
            advice="add a tensile test, lateral strain, or indenters whose radius over thickness differs by a factor "
            "of 1.5 or more; or pass nu=",
            code="LID-E306",
        )
    return _Ratio(value, std, "lateral strain" if lateral else "given" if given else "indenter sizes", joint)


def _joint(tests: Sequence[Curve], direct: Sequence[tuple[float, float]]) -> Pooled:
    """Both log E and nu from all curves at once: each curve's log E as a function of nu, by Gauss-Newton."""
    nu = float(np.clip(np.mean([v for v, _ in direct]) if direct else 0.4, 0.1, 0.48))
    noise = [f.std / f.E for f in (fit(c, nu) for c in tests)] + [s for _, s in direct]
    found = None
    for _ in range(12):
        level, slope = np.array([_of_ratio(c, nu) for c in tests]).T
        if not direct and float(np.ptp(slope)) < 1e-9:
            return Pooled(np.array([0.0, nu]), np.array([np.inf, np.inf]), 0, 1.0)
        first = np.r_[np.ones(len(tests)), np.zeros(len(direct))]
        second = np.r_[-slope, np.ones(len(direct))]
        found = pool([*level, *(v - nu for v, _ in direct)], noise, np.stack([first, second], axis=1))
        after = float(np.clip(nu + np.clip(found.value[1], -0.15, 0.15), LOWEST, HIGHEST))
        moved, nu = abs(after - nu), after
        if moved < 0.01 * float(found.std[1]):
            break
    assert found is not None
    return Pooled(np.array([found.value[0], nu]), found.std, found.dof, found.excess)


def _of_ratio(curve: Curve, nu: float) -> tuple[float, float]:
    """One curve's log E at a Poisson's ratio, and its slope over it: none for tension."""
    if isinstance(curve, Tensile):
        return float(np.log(of_curve(curve, None))), 0.0
    low, high = max(nu - TRIAL, LOWEST), min(nu + TRIAL, HIGHEST)
    a, b = (float(np.log(of_curve(curve, v))) for v in (low, high))
    return a + (b - a) * (nu - low) / (high - low), (b - a) / (high - low)


def _sizes(tests: Sequence[Curve]) -> bool:
    """Indenters of several sizes, or a tensile test that gives E apart."""
    sizes = [c.radius / c.thickness for c in tests if isinstance(c, Indentation)]
    return max(sizes) / min(sizes) >= SIZES or any(isinstance(c, Tensile) for c in tests)


def _modulus(tests: Sequence[Curve], fits: Sequence[CurveFit], ratio: _Ratio) -> tuple[float, float, int]:
    """E, its std and its degrees of freedom."""
    if ratio.joint is not None:
        value = float(np.exp(ratio.joint.value[0]))
        return value, value * float(ratio.joint.std[0]), ratio.joint.dof
    found = pool(np.log([f.E for f in fits]), [f.std / f.E for f in fits], np.ones((len(fits), 1)))
    E = positive("E", float(np.exp(found.value[0])), where="material.from_tests")
    return E, E * float(found.std[0]), found.dof


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

    Raises `InputError`: Shapes that differ, NaN, no force at all.
    """
    a = shaped(estimated, (None,), (None, None), where="gain", what="the forces do not fit", fewest=1)
    b = shaped(measured, a.shape, where="gain", what="the forces do not fit", hint="one row per press in both")
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
    force_std : float
        Std of the known forces over the largest of them.

    Raises `InputError`: Fewer than four values, forces that do not fit, a sensor whose lambda is not frozen.
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
    H, lam = sensor.model.H / inverse.noise[:, None], inverse.lam * inverse.scale
    for i, frame in enumerate(frames):
        y = sensor.readings(frame, None if depths is None else depths[i])
        # a load anywhere would explain any motion: only one that presses, where the contact is, tells nu
        load = sensor.pressed(y).load
        z = y / inverse.noise
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
