"""Side constraints as plain arrays: signs, bounds, support, resultants, friction cones with their projection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structures._readonly import ReadOnly
from structures.errors import InputError, as_array, reals

from ._inverse import Array, Indices

__all__ = ["Bounds", "FrictionCone", "NonNegative", "Resultant", "Support"]


@dataclass(frozen=True, eq=False)
class NonNegative:
    """Loads that cannot pull: g >= 0.

    Parameters
    ----------
    loads : array of int or of bool, optional
        Numbers of the loads, or a mask over all of them; None is all.
    """

    loads: ArrayLike | None = None
    masked: int | None = field(default=None, init=False, repr=False)  # length of a mask

    def __post_init__(self) -> None:
        _set(self, masked=_masked(self.loads), loads=_numbers(self.loads, "NonNegative"))

    def __str__(self) -> str:
        return f"non-negative ({_count(self.loads)})"


@dataclass(frozen=True, eq=False)
class Bounds(ReadOnly):
    """Lower and upper limits of loads; infinite where there is none.

    Parameters
    ----------
    lower, upper : float or array, optional
        One for all, or one per load of `loads`.
    loads : array of int or of bool, optional
        Numbers of the loads, or a mask over all of them; None is all.
    """

    lower: ArrayLike | None = None
    upper: ArrayLike | None = None
    loads: ArrayLike | None = None
    masked: int | None = field(default=None, init=False, repr=False)  # length of a mask

    def __post_init__(self) -> None:
        loads = _numbers(self.loads, "Bounds")
        lower = reals(-np.inf if self.lower is None else self.lower, where="Bounds")
        upper = reals(np.inf if self.upper is None else self.upper, where="Bounds")
        if np.any(np.isnan(lower)) or np.any(np.isnan(upper)):
            raise InputError("NaN in the bounds", where="Bounds", expected="numbers; infinite where there is no bound")
        if self.lower is None and self.upper is None:
            raise InputError("bounds without a bound", where="Bounds", expected="lower, upper or both")
        if lower.ndim > 1 or upper.ndim > 1:
            raise InputError(
                "bounds are one number, or one per load", where="Bounds",
                found=f"shapes {lower.shape} and {upper.shape}", expected="() or (loads,)",
            )  # fmt: skip
        _set(self, lower=lower, upper=upper, masked=_masked(self.loads), loads=loads)

    def __str__(self) -> str:
        return f"bounds ({_count(self.loads)})"


@dataclass(frozen=True, eq=False)
class Support(ReadOnly):
    """Only these loads act; the others are no unknowns at all (their columns are removed, not penalised).

    Parameters
    ----------
    loads : array of int or of bool
        Numbers of the loads that act, or a mask over all loads.
    """

    loads: ArrayLike
    masked: int | None = field(default=None, init=False, repr=False)  # length of a mask

    def __post_init__(self) -> None:
        loads = _numbers(self.loads, "Support")
        if loads is None or len(loads) == 0:
            raise InputError("a support without any load", where="Support", expected="numbers of the loads that act")
        _set(self, masked=_masked(self.loads), loads=loads)

    def __str__(self) -> str:
        return f"support ({_count(self.loads)})"


@dataclass(frozen=True, eq=False)
class Resultant(ReadOnly):
    """Resultant forces and moments C g = r: exact, or measured by a force/torque sensor with a covariance.

    Parameters
    ----------
    C : array, shape (R, loads)
        Each row makes one resultant from the loads.
    value : array, shape (R,), or (R, frames) where each frame has its own
        The resultants r.
    covariance : array, shape (R, R) or (R,), optional
        Covariance of r (or its diagonal, variances): the constraint is then soft, with R whitened rows beside the
        data. Without it the constraint is exact.
    labels : sequence of str
        Names such as ``("Fx", "Fy", "Fz")``.
    """

    C: ArrayLike
    value: ArrayLike
    covariance: ArrayLike | None = None
    labels: Sequence[str] = ()

    def __post_init__(self) -> None:
        C, value = np.atleast_2d(reals(self.C, where="Resultant")), np.atleast_1d(reals(self.value, where="Resultant"))
        R = len(C)
        if C.ndim != 2 or value.ndim > 2 or len(value) != R or not np.all(np.isfinite(C)):
            raise InputError(
                "the resultants do not fit", where="Resultant", found=f"C {C.shape}, value {value.shape}",
                expected="finite; C (R, loads) and value (R,)",
            )  # fmt: skip
        if not np.all(np.isfinite(value)):
            raise InputError("NaN or inf in the resultants", where="Resultant", expected="finite numbers")
        labels = tuple(str(x) for x in self.labels) or tuple(f"resultant {i}" for i in range(R))
        if len(labels) != R:
            raise InputError("the labels do not fit", where="Resultant", found=len(labels), expected=R)
        covariance = None if self.covariance is None else _covariance(self.covariance, R)
        _set(self, C=C, value=value, covariance=covariance, labels=labels)

    @property
    def hard(self) -> bool:
        """Exact, not measured."""
        return self.covariance is None

    def __str__(self) -> str:
        return f"resultant {', '.join(self.labels)} ({'exact' if self.hard else 'with covariance'})"


@dataclass(frozen=True, eq=False)
class FrictionCone(ReadOnly):
    """Coulomb friction norm(t_t) <= mu t_n at each contact: the load pushes, and does not leave its cone.

    Parameters
    ----------
    mu : float or array (contacts,)
        Friction coefficient, >= 0.
    contacts : array of int, shape (contacts, dim)
        Numbers of the loads that are the components of each contact; dim is 2 or 3.
    normals : array, shape (contacts, dim), optional
        Direction of a push in these components; None: the last component is the push.
    facets : int, optional
        A pyramid of this many facets (3 or more) in place of the round cone. Facet 0 lies in the first tangential
        direction. In the plane (dim 2) there is no difference.
    inner : bool
        False: the facets touch the cone from outside, which lets norm(t_t) reach mu / cos(pi / facets) times t_n;
        True: the edges lie on the cone, which is the safe side.
    """

    mu: ArrayLike
    contacts: ArrayLike
    normals: ArrayLike | None = None
    facets: int | None = None
    inner: bool = False

    def __post_init__(self) -> None:
        contacts = np.atleast_2d(as_array(self.contacts, where="FrictionCone"))
        if contacts.ndim != 2 or contacts.shape[1] not in (2, 3) or not np.issubdtype(contacts.dtype, np.integer):
            raise InputError(
                "contacts are numbers of loads", where="FrictionCone", found=f"{contacts.dtype} {contacts.shape}",
                expected="integers, (contacts, 2) or (contacts, 3)",
            )  # fmt: skip
        k, dim = contacts.shape
        mu = reals(self.mu, where="FrictionCone")
        if mu.shape not in ((), (k,)) or not np.all(np.isfinite(mu)) or np.any(mu < 0):
            raise InputError(
                "no friction coefficient", where="FrictionCone", found=self.mu,
                expected=f"one finite number >= 0, or {k} of them",
            )  # fmt: skip
        if self.facets is not None and not _facets(self.facets):
            raise InputError(
                "no number of facets", where="FrictionCone", found=repr(self.facets),
                expected=f"an integer from 3 to {FACETS}, or None",
                hint="None is the round cone, which is exact and faster than many facets",
            )  # fmt: skip
        normals = None
        if self.normals is not None:
            normals = np.atleast_2d(reals(self.normals, where="FrictionCone"))
            length = np.linalg.norm(normals, axis=-1)
            if normals.shape != (k, dim) or not np.all(np.isfinite(length)) or np.any(length == 0):
                raise InputError(
                    "the normals do not fit the contacts", where="FrictionCone", found=f"shape {normals.shape}",
                    expected=f"({k}, {dim}), each with a length",
                )  # fmt: skip
            normals = normals / length[:, None]
        _set(self, mu=np.broadcast_to(mu, (k,)).copy(), contacts=contacts, normals=normals)

    def __str__(self) -> str:
        contacts: Any = self.contacts
        kind = "round" if self.facets is None else f"{self.facets} facets{', inner' if self.inner else ''}"
        return f"friction cone ({len(contacts)} contacts, {kind})"


FACETS = 360  # of a pyramid: beyond, the round cone is no different
Constraint = NonNegative | Bounds | Support | Resultant | FrictionCone


def _set(spec: object, **values: Any) -> None:
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value = value.copy()
            value.flags.writeable = False
        object.__setattr__(spec, name, value)


def _facets(count: Any) -> bool:
    return bool(isinstance(count, int | np.integer) and not isinstance(count, bool) and 3 <= count <= FACETS)


def _numbers(loads: ArrayLike | None, where: str) -> Array | None:
    """Distinct load numbers, or None for all."""
    if loads is None:
        return None
    found = np.atleast_1d(as_array(loads, where=where))
    if found.dtype == bool:
        found = np.flatnonzero(found)
    if found.ndim != 1 or (len(found) and not np.issubdtype(found.dtype, np.integer)):
        raise InputError("loads are numbers", where=where, found=f"{found.dtype} {found.shape}", expected="integers")
    if len(set(found.tolist())) != len(found):
        raise InputError("a load is named twice", where=where, expected="each load once")
    return found.astype(int)


def _masked(loads: ArrayLike | None) -> int | None:
    """How many loads a mask speaks of; None of numbers."""
    mask = as_array(loads, where="loads")
    return mask.size if loads is not None and mask.dtype == bool else None


def _covariance(covariance: ArrayLike, R: int) -> Array:
    S = reals(covariance, where="Resultant")
    S = np.diag(S) if S.ndim == 1 else S
    if S.shape != (R, R) or not np.all(np.isfinite(S)) or not np.allclose(S, S.T, rtol=1e-8, atol=0):
        raise InputError(
            "the covariance does not fit the resultants", where="Resultant", found=f"shape {np.shape(covariance)}",
            expected=f"finite and symmetric, ({R}, {R}) or ({R},)",
        )  # fmt: skip
    try:
        np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        raise InputError(
            "the covariance of the resultants is not positive definite", where="Resultant",
            found=f"smallest eigenvalue {np.linalg.eigvalsh(S)[0]:.3g}", expected="> 0",
            hint="leave the covariance out where the resultant is exact",
        ) from None  # fmt: skip
    return S


def _count(loads: Any) -> str:
    return "all loads" if loads is None else f"{len(loads)} loads"


@dataclass(frozen=True)
class ConeFaces:
    """Where on their cones some points lie, after projection.

    Parameters
    ----------
    axes : array, shape (k, dim, dim)
        Orthonormal columns: along the ray, (across it,) outward normal. The identity inside and at the apex.
    share : array, shape (k, dim)
        Derivative of the projection along each axis: 1 free, 0 held, between for the curved side of a round cone.
    status : array, shape (k,)
        0 open (apex), 1 sliding (on the side), 2 sticking (inside).
    """

    axes: Array
    share: Array
    status: Indices


def frames(normals: Array) -> Array:
    """Orthogonal frames whose last axis is the normal, (k, dim, dim): global = frame @ local (Householder)."""
    k, dim = normals.shape
    last = np.zeros(dim)
    last[-1] = 1.0
    u = last - normals
    size = np.sum(u**2, axis=1)
    factor = np.divide(2.0, size, out=np.zeros(k), where=size > 0)
    return np.asarray(np.eye(dim) - factor[:, None, None] * u[:, :, None] * u[:, None, :])


def faces(v: Array, mu: Array, facets: Indices) -> ConeFaces:
    """Faces of the cones on which the projections of points `v` lie.

    A point is inside if |t| <= mu n; its projection is the apex if mu |t| <= -n, else it lies on the side at
    n* = (n + mu |t|) / (1 + mu^2). A pyramid is taken facet by facet, in the sector of the point.

    Parameters
    ----------
    v : array, shape (k, dim)
        Tangential components, then the normal one; dim is 2 or 3.
    mu : array, shape (k,)
        Friction coefficients (of the facets where there are any).
    facets : array of int, shape (k,)
        Number of facets of a pyramid; 0 is the round cone.
    """
    k, dim = v.shape
    t, n = v[:, :-1], v[:, -1]
    size = np.sqrt(np.sum(t**2, axis=1))
    e = np.zeros_like(t)
    e[:, 0] = 1.0
    np.divide(t, size[:, None], out=e, where=size[:, None] > 0)
    pyramid = facets > 0
    if dim == 3 and np.any(pyramid):
        e, reach, mu, vertex = _sectors(e, t, size, n, mu, facets)
    else:
        reach, vertex = size, np.zeros(k, bool)
    inside = (reach <= mu * n) & ((mu > 0) | (size == 0) & (n > 0))
    along = n + mu * reach  # component on the ray (mu e, 1), times its length
    apex = ~inside & (along <= 0)
    side = ~(inside | apex)
    axes = np.zeros((k, dim, dim))
    axes[:] = np.eye(dim)
    share = np.zeros((k, dim))
    share[inside] = 1.0
    length = np.sqrt(1 + mu**2)
    axes[side] = _side(e[side], mu[side], length[side])
    share[side, 0] = 1.0
    if dim == 3:
        round_ = np.divide(mu * along / length**2, size, out=np.zeros(k), where=size > 0)
        share[side, 1] = np.where(pyramid, np.where(vertex, 0.0, 1.0), round_)[side]
    return ConeFaces(axes, share, 2 * inside + side)


def _side(e: Array, mu: Array, length: Array) -> Array:
    """Axes on the side of a cone: ray, across (in space), outward normal."""
    k, flat = e.shape
    axes = np.zeros((k, flat + 1, flat + 1))
    axes[:, :-1, 0], axes[:, -1, 0] = e * (mu / length)[:, None], 1 / length
    if flat == 2:
        axes[:, 0, 1], axes[:, 1, 1] = -e[:, 1], e[:, 0]
    axes[:, :-1, -1], axes[:, -1, -1] = e / length[:, None], -mu / length
    return axes


def _sectors(
    e: Array, t: Array, size: Array, n: Array, mu: Array, facets: Indices
) -> tuple[Array, Array, Array, Array]:
    """Direction, reach along it and slope of the facet or edge that a point projects to; round cones stay as they are.

    Facet j of K has its normal at the angle 2 pi j / K. By symmetry a point projects into its own sector.
    """
    pyramid = facets > 0
    K = np.where(pyramid, facets, 4)
    step = 2 * np.pi / K
    angle = np.arctan2(t[:, 1], t[:, 0])
    centre = np.round(angle / step) * step
    d = np.stack([np.cos(centre), np.sin(centre)], axis=1)
    reach, across = np.sum(d * t, axis=1), d[:, 0] * t[:, 1] - d[:, 1] * t[:, 0]
    foot = mu * (n + mu * reach) / (1 + mu**2)  # reach of the projection onto the plane of the facet
    outside = reach > mu * n
    vertex = pyramid & outside & (np.abs(across) > np.tan(step / 2) * foot)
    turned = centre + np.where(across < 0, -0.5, 0.5) * step
    corner = np.stack([np.cos(turned), np.sin(turned)], axis=1)
    d = np.where(vertex[:, None], corner, d)
    steep = np.where(vertex, mu / np.cos(step / 2), mu)
    reach = np.sum(d * t, axis=1)
    choose = pyramid[:, None]
    return np.where(choose, d, e), np.where(pyramid, reach, size), np.where(pyramid, steep, mu), vertex


def project(v: Array, face: ConeFaces) -> Array:
    """Projections of points onto their cones, (k, dim), given their faces."""
    local = np.einsum("kij,ki->kj", face.axes, v)
    return np.asarray(np.einsum("kij,kj->ki", face.axes, face.share * local))


def excess(h: Array, mu: Array, facets: Indices) -> Array:
    """By how much points lie outside their cones, (k,): |t| - mu n, or -n where that is larger; zero inside."""
    t, n = h[:, :-1], h[:, -1]
    size = np.sqrt(np.sum(t**2, axis=1))
    if h.shape[1] == 3:
        K = np.where(facets > 0, facets, 4)
        step = 2 * np.pi / K
        off = np.arctan2(t[:, 1], t[:, 0])
        off = off - np.round(off / step) * step
        size = np.where(facets > 0, size * np.cos(off), size)
    return np.asarray(np.maximum(np.maximum(size - mu * n, -n), 0.0))
