"""Tests of a material as they are recorded, and curves to moduli: is it rate-independent, and is it linear?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError, one_of, positive, reals

from .._arrays import Array
from .._closed.contact import WIDEST, flat_stiffness, sphere_law, sphere_limit
from .._closed.layer import Layer

DEEPEST = 5.5  # depth times radius of a sphere over thickness squared: contact of some 3.5 thicknesses
FEWEST = 5  # points of a curve: modulus, offset, curvature, and something left to see the noise


@dataclass(frozen=True, eq=False)
class Tensile:
    """Tensile test at one speed.

    Parameters
    ----------
    elongation, force : array (n,)
        Elongation of the gauge length (m) and force (N), positive in tension.
    length, area : float
        Gauge length (m) and cross-section (m^2) at rest.
    speed : float
        Of the elongation (m/s).
    contraction : array (n,), optional
        Shortening of the width (m), positive in tension: gives Poisson's ratio.
    width : float, optional
        Width at rest (m), with `contraction`.
    name : str

    Raises
    ------
    InputError
        Arrays that do not fit, fewer than five points, NaN, sizes that are not positive.
    """

    elongation: Any
    force: Any
    length: float
    area: float
    speed: float
    contraction: Any = None
    width: float | None = None
    name: str = ""

    def __post_init__(self) -> None:
        _settle(self, ("elongation", "force"), ("length", "area", "speed"))
        if (self.contraction is None) != (self.width is None):
            raise InputError(
                "lateral strain needs contraction and width", where=f"Tensile {self.name}", found="one of them",
                expected="both, or none", hint="width= is the width at rest, in m",
            )  # fmt: skip
        if self.contraction is not None:
            _settle(self, ("elongation", "contraction"), ("width",))

    @property
    def motion(self) -> Array:
        """Abscissa of the curve (m)."""
        return np.asarray(self.elongation)

    @property
    def rate(self) -> float:
        """Strain rate (1/s)."""
        return self.speed / self.length

    @property
    def strain(self) -> float:
        """Largest strain of the test."""
        return float(np.ptp(self.elongation)) / self.length

    def shape(self, motion: Array, nu: float | None) -> Array:
        """Force over modulus (m^2) at elongations (m)."""
        return self.area / self.length * motion


@dataclass(frozen=True, eq=False)
class Indentation:
    """Indentation of a bonded layer at one speed.

    Parameters
    ----------
    depth, force : array (n,)
        Depth (m) and force (N), positive when pressed. Where the depth is zero does not matter: the contact point is
        fitted.
    radius : float
        Of the sphere, or of the flat-ended cylinder (m).
    thickness : float
        Of the layer (m).
    speed : float
        Of the indenter (m/s).
    indenter : {"sphere", "flat"}
    name : str

    Raises
    ------
    InputError
        Arrays that do not fit, fewer than five points, NaN, sizes that are not positive, another indenter.
    """

    depth: Any
    force: Any
    radius: float
    thickness: float
    speed: float
    indenter: str = "sphere"
    name: str = ""

    def __post_init__(self) -> None:
        _settle(self, ("depth", "force"), ("radius", "thickness", "speed"))
        hint = "a flat-ended cylinder is flat"
        one_of("unknown indenter", self.indenter, ("sphere", "flat"), where=f"Indentation {self.name}", hint=hint)
        flat = self.indenter == "flat"
        reach = self.radius / self.thickness if flat else np.ptp(self.depth) * self.radius / self.thickness**2
        if reach > (WIDEST if flat else DEEPEST):
            raise InputError(
                "contact too wide for this layer", where=f"Indentation {self.name}".strip(),
                found=f"{'radius over thickness' if flat else 'depth times radius over thickness squared'} {reach:.3g}",
                expected=f"at most {WIDEST if flat else DEEPEST:g}", hint="depth, radius and thickness in m",
            )  # fmt: skip

    @property
    def motion(self) -> Array:
        """Abscissa of the curve (m)."""
        return np.asarray(self.depth)

    @property
    def rate(self) -> float:
        """Speed over thickness (1/s)."""
        return self.speed / self.thickness

    @property
    def strain(self) -> float:
        """Depth over thickness: an order of magnitude of the strain."""
        return float(np.ptp(self.depth)) / self.thickness

    def shape(self, motion: Array, nu: float | None) -> Array:
        """Force over modulus (m^2) at depths (m) below the contact point."""
        assert nu is not None
        if self.indenter == "flat":
            return flat_stiffness(Layer(h=self.thickness, E=1.0, nu=nu), self.radius) * motion
        x = motion * self.radius / self.thickness**2  # a search may look deeper than the record: not beyond the law
        return sphere_law(nu)(np.minimum(x, sphere_limit(nu))) * self.thickness**3 / self.radius


Curve = Tensile | Indentation


def _settle(curve: Any, arrays: tuple[str, str], sizes: tuple[str, ...]) -> None:
    """Arrays copied and checked, sizes to floats."""
    where = f"{type(curve).__name__} {curve.name}".strip()
    for name in sizes:
        object.__setattr__(curve, name, positive(name, getattr(curve, name), where=where))
    x, y = (reals(getattr(curve, name), where=f"{where}, {name}") for name in arrays)
    if x.ndim != 1 or x.shape != y.shape or len(x) < FEWEST or not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError(
            "no curve", where=where, found=f"{arrays[0]} {x.shape}, {arrays[1]} {y.shape}",
            expected=f"two finite arrays of the same length, at least {FEWEST} points", hint="cut off what is missing",
        )  # fmt: skip
    if np.ptp(x) == 0:
        raise InputError(f"{arrays[0]} does not move", where=where, found=f"{x[0]:.4g} at every point",
                         expected="a loading curve", hint="pass motion first, then force")  # fmt: skip
    for name, array in zip(arrays, (x, y), strict=True):
        array.setflags(write=False)
        object.__setattr__(curve, name, array)


DIFFERENCE, STEPS = 1e-6, 60


@dataclass(frozen=True)
class CurveFit:
    """What one curve says: E of the linear law over the range used (Pa), and its std from its own noise alone.

    `bend` is the departure from that law: secant modulus at the end of the range over the modulus at its start, minus
    one. `rate` in 1/s; `noise` is the std of the residuals (N) about the bent law.
    """

    name: str
    rate: float
    E: float
    std: float
    bend: float
    bend_std: float
    strain: float
    noise: float


def fit(curve: Curve, nu: float | None) -> CurveFit:
    """Fit force = E (1 + c x/range) g(x - x0), with c = 0 for the modulus and free for the bend; tension needs no nu.

    Residuals that follow one another (a filtered record, slack, hysteresis) hold fewer independent points: variances
    grow by (1 + r)/(1 - r) where the correlation r of neighbours is beyond its own noise. Refused: force that does not
    grow.
    """
    straight, _ = _solved(curve, nu, bent=False)
    bent, residual = _solved(curve, nu, bent=True)
    noise = float(np.sqrt(residual @ residual / (len(residual) - 3)))
    inflated = noise * np.sqrt(_fewer(residual))
    std, bend_std = straight.E * inflated * straight.spread[0], float(inflated * bent.spread[2])
    return CurveFit(curve.name, curve.rate, straight.E, std, float(bent.c), bend_std, curve.strain, noise)


def modulus(curve: Curve, nu: float | None) -> float:
    """Modulus of the linear law alone (Pa)."""
    return _solved(curve, nu, bent=False)[0].E


@dataclass(frozen=True)
class _Solution:
    E: float
    c: float
    spread: Array  # std of (log E, x0, c) per unit noise of the force


def _solved(curve: Curve, nu: float | None, *, bent: bool) -> tuple[_Solution, Array]:
    """Least squares for (log E, start of the load, bend) by Levenberg-Marquardt, in units of the curve's ranges."""
    order = np.argsort(curve.motion, kind="stable")
    x, y = curve.motion[order], curve.force[order]
    reach, top = float(np.ptp(x)), float(np.max(np.abs(y - y[0])))
    slope = np.polyfit((x - x[0]) / reach, y / top, 1)[0] if top > 0 else 0.0
    if not slope > 0.05:
        raise InputError(
            "force does not grow with the motion", where=f"{type(curve).__name__} {curve.name}".strip(),
            found=f"slope {slope:.2g} of the largest force over the range", expected="a loading curve, both positive",
            hint="depth and elongation are positive into the load; pass the loading branch alone",
        )  # fmt: skip
    whole = float(curve.shape(np.array([reach]), nu)[0])
    law = _Law((x - x[0]) / reach, lambda deep: curve.shape(reach * deep, nu) / whole)
    p, J = _fitted(law, y / top, law.start(y / top), 3 if bent else 2)
    _, triangle = np.linalg.qr(J)
    rows = np.linalg.solve(triangle.T, np.eye(len(triangle)))  # columns of R^-T: their squares sum to the variances
    spread = np.zeros(3)
    spread[: len(rows)] = np.sqrt(np.sum(rows**2, axis=0)) / top
    return _Solution(float(np.exp(p[0]) * top / whole), float(p[2]), spread), y - top * law.force(p)


@dataclass(frozen=True)
class _Law:
    """Force exp(a) g(x - x0) (1 + c (x - x0)) of motion x from 0 to 1."""

    x: Array
    g: Callable[[Array], Array]

    def force(self, p: Array) -> Array:
        deep = self.x - p[1]
        return np.asarray(np.exp(p[0]) * self.g(deep) * (1 + p[2] * deep))

    def slopes(self, p: Array) -> Array:
        """Derivatives by a, x0 and c."""
        moved = np.array([0.0, DIFFERENCE, 0.0])
        deep = self.x - p[1]
        whole = np.exp(p[0]) * self.g(deep)
        by_place = (self.force(p + moved) - self.force(p - moved)) / (2 * DIFFERENCE)
        return np.stack([whole * (1 + p[2] * deep), by_place, whole * deep], axis=1)

    def start(self, y: Array) -> Array:
        """The best of some places at which the load may start, with its modulus."""
        best, found = np.inf, np.zeros(3)
        for place in np.linspace(-0.4, 0.8, 7):
            g = self.g(self.x - place)
            E = float(g @ y) / float(g @ g)
            misfit = float(np.sum((y - E * g) ** 2))
            if E > 0 and misfit < best:
                best, found = misfit, np.array([np.log(E), place, 0.0])
        return found


def _fitted(law: _Law, y: Array, p: Array, count: int) -> tuple[Array, Array]:
    """The first `count` unknowns by damped Gauss-Newton from p, and the derivatives there."""
    damping, rest = 1e-6, y - law.force(p)
    for _ in range(STEPS):
        J = law.slopes(p)[:, :count]
        size = np.linalg.norm(J, axis=0)
        A = np.concatenate([J, np.sqrt(damping) * np.diag(size)])
        step = np.zeros(3)
        step[:count] = np.linalg.lstsq(A, np.append(rest, np.zeros(count)), rcond=None)[0]
        trial = np.clip(p + step, [-np.inf, -5.0, -0.95], [np.inf, 0.95, 20.0])
        found = y - law.force(trial)
        if np.sum(found**2) <= np.sum(rest**2):
            settled = np.max(np.abs(trial - p)) < 1e-7
            p, rest, damping = trial, found, 0.1 * damping
            if settled:
                break
        else:
            damping *= 10
            if damping > 1e9:
                break
    return p, law.slopes(p)[:, :count]


def _fewer(residual: Array) -> float:
    """Factor on variances for residuals that follow one another."""
    n = len(residual)
    size = float(residual @ residual)
    r = float(residual[1:] @ residual[:-1]) / size if size > 0 else 0.0
    r = min(r, 1 - 2 / n)
    return (1 + r) / (1 - r) if r > 2 / np.sqrt(n) else 1.0


def poisson_of_curves(curve: Tensile) -> tuple[float, float]:
    """Poisson's ratio of a tensile test with lateral strain, and its std from the noise of the curve."""
    x = curve.elongation / curve.length
    y = curve.contraction / float(curve.width or 1.0)
    away = x - x.mean()
    size = float(away @ away)
    nu = float(away @ y / size)
    residual = y - y.mean() - nu * away
    sigma = float(np.sqrt(residual @ residual / (len(x) - 2) * _fewer(residual)))
    return nu, sigma / np.sqrt(size)


SMALLEST = 1e-9  # std of a noise-free number, so that its weight stays finite


@dataclass(frozen=True)
class Pooled:
    """Weighted least squares over curves: coefficients (p,) and their std, widened by the scatter between curves.

    `dof` is curves minus coefficients, 0 leaves the scatter between runs unseen; `excess` is that scatter over what the
    noise of each curve explains.
    """

    value: Array
    std: Array
    dof: int
    excess: float

    def half_width(self, i: int = 0, level: float = 0.95) -> float:
        """Half of the interval of coefficient i, by Student's t."""
        from scipy.special import ndtri, stdtrit

        upper = 0.5 + level / 2
        return float((stdtrit(self.dof, upper) if self.dof > 0 else ndtri(upper)) * self.std[i])

    def p_value(self, i: int) -> float:
        """Probability of a coefficient at least that large where it is zero."""
        from scipy.special import ndtr, stdtr

        z = -abs(float(self.value[i] / self.std[i]))
        return float(2 * (stdtr(self.dof, z) if self.dof > 0 else ndtr(z)))


def pool(values: ArrayLike, stds: ArrayLike, design: ArrayLike) -> Pooled:
    """Fit values (n,) = design (n, p) @ coefficients, weighted; the Birge ratio, above one, widens the std."""
    y, s, X = np.asarray(values, float), np.maximum(np.asarray(stds, float), SMALLEST), np.asarray(design, float)
    A, b = X / s[:, None], y / s
    q, r = np.linalg.qr(A)
    value = np.linalg.solve(r, q.T @ b)
    dof = len(y) - X.shape[1]
    misfit = float(np.sum((b - A @ value) ** 2))
    excess = float(np.sqrt(misfit / dof)) if dof > 0 else 1.0
    rows = np.linalg.solve(r.T, np.eye(X.shape[1]))
    return Pooled(value, np.sqrt(np.sum(rows**2, axis=0)) * max(1.0, excess), dof, excess)


RATE, BEND = 0.05, 0.10  # relative changes of the modulus that still count as none
SPAN = 3.0  # fastest over slowest rate below which rate dependence is not tested
STRAIN = 0.02  # range below which linearity is not tested


@dataclass(frozen=True)
class Verdict:
    """One question about the material, answered by an effect and its interval, not by a p-value alone.

    Parameters
    ----------
    question : {"rate independence", "linearity"}
    verdict : {"shown", "violated", "undecided", "not tested"}
        "shown" where the whole 95 % interval of the effect lies within the tolerance, "violated" where it lies outside.
    effect, low, high : float or None
        Relative change of the modulus over the range tested, and its 95 % interval.
    tolerance : float
        Relative change that still counts as none.
    p : float or None
        Probability of such an effect where there is none.
    text : str
        Range tested, and why a verdict is missing.
    """

    question: str
    verdict: str
    effect: float | None
    low: float | None
    high: float | None
    tolerance: float
    p: float | None
    text: str

    @property
    def tested(self) -> bool:
        """The tests can answer the question at all."""
        return self.verdict != "not tested"

    def __str__(self) -> str:
        head = f"{self.question}: {self.verdict}"
        if self.effect is None:
            return f"{head} ({self.text})"
        return (
            f"{head} (modulus changes by {self.effect:+.1%}, 95 % interval {self.low:+.1%} to {self.high:+.1%}, "
            f"tolerance {self.tolerance:.0%}, p = {self.p:.2g}; {self.text})"
        )


def rate_independence(fits: Sequence[CurveFit], tolerance: float = RATE) -> Verdict:
    """Analysis of covariance: slope of log E over log rate, for all curves; the change from slowest to fastest."""
    rates = np.log10([f.rate for f in fits])
    span = float(np.ptp(rates))
    if span < np.log10(SPAN):
        text = f"rates span a factor of {10**span:.3g}; a factor of {SPAN:g} or more tests it"
        return Verdict("rate independence", "not tested", None, None, None, tolerance, None, text)
    design = np.stack([np.ones(len(rates)), (rates - rates.mean()) / span], axis=1)
    found = pool(np.log([f.E for f in fits]), [f.std / f.E for f in fits], design)
    change, half = float(found.value[1]), found.half_width(1)
    effect, low, high = (float(np.expm1(v)) for v in (change, change - half, change + half))
    text = f"{len(fits)} curves, rates over a factor of {10**span:.3g}"
    if found.dof == 0:
        text += ", scatter between runs not seen: repeat a speed"
    return Verdict(
        "rate independence", judged(low, high, tolerance), effect, low, high, tolerance, found.p_value(1), text
    )


def linearity(fits: Sequence[CurveFit], tolerance: float = BEND) -> Verdict:
    """Bend of the curves, pooled: secant modulus at the end of the range over the modulus at its start, minus one."""
    usable = [f for f in fits if f.strain >= STRAIN]
    if not usable:
        text = f"strain to {max(f.strain for f in fits):.2%} only; {STRAIN:.0%} or more tests it"
        return Verdict("linearity", "not tested", None, None, None, tolerance, None, text)
    found = pool([f.bend for f in usable], [f.bend_std for f in usable], np.ones((len(usable), 1)))
    effect, half, reach = float(found.value[0]), found.half_width(), max(f.strain for f in usable)
    return Verdict(
        "linearity", judged(effect - half, effect + half, tolerance), effect, effect - half, effect + half, tolerance,
        found.p_value(0), f"{len(usable)} curves, strain to {reach:.1%}; beyond it nothing is shown",
    )  # fmt: skip


def judged(low: float, high: float, tolerance: float) -> str:
    """Verdict of an interval against a tolerance."""
    if -tolerance <= low and high <= tolerance:
        return "shown"
    return "violated" if low > tolerance or high < -tolerance else "undecided"
