"""Point forces and patches on an elastic half-space in closed form; guards W601 and E602 of its formulas on a pad."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from structures._flags import Evidence, Flag, canonical
from structures.errors import InputError, NotIdentifiable, positive, reals

from .._arrays import Array
from .layer import HalfSpace, Layer
from .presses import Press


def point_forces(ground: HalfSpace, offsets: ArrayLike) -> Array:
    """Motion X, Y, Z per unit point force X, Y, Z on the surface (m/N), (..., 3, 3), both outward.

    The offsets, point minus point of the force (m), are (..., 2), or (..., 3) with heights z <= 0. Boussinesq (1885)
    and Cerruti (1882), as in Johnson, Contact Mechanics, ch. 3. Refused at the force itself, where the motion has no
    bound.
    """
    x, y, d = split(offsets)
    r = np.sqrt(x**2 + y**2 + d**2)
    if not r.all():
        raise InputError(
            "the motion under a point force has no bound", where="offsets", found="a distance of 0",
            hint="spread the force over a patch (tactile.halfspace) or a press",
        )  # fmt: skip
    nu, m, s = ground.nu, 1 - 2 * ground.nu, r + d
    found = np.empty((*r.shape, 3, 3))
    found[..., 0, 0] = 1 / r + x**2 / r**3 + m * (1 / s - x**2 / (r * s**2))
    found[..., 1, 1] = 1 / r + y**2 / r**3 + m * (1 / s - y**2 / (r * s**2))
    found[..., 0, 1] = found[..., 1, 0] = x * y / r**3 - m * x * y / (r * s**2)
    found[..., 2, 2] = d**2 / r**3 + 2 * (1 - nu) / r
    for i, c in enumerate((x, y)):
        found[..., i, 2] = m * c / (r * s) - c * d / r**3
        found[..., 2, i] = -m * c / (r * s) - c * d / r**3
    return found / (4 * np.pi * ground.mu)


def split(offsets: ArrayLike) -> tuple[Array, Array, Array]:
    """Finite offsets (..., 2) or (..., 3) as x, y and the depth below the surface."""
    found = reals(offsets, where="offsets")
    if found.ndim == 0 or found.shape[-1] not in (2, 3) or not np.isfinite(found).all():
        raise InputError(
            "offsets must be finite, two or three coordinates each", where="offsets",
            found=f"an array of shape {found.shape}", expected="(..., 2) or (..., 3), in metres",
        )  # fmt: skip
    d = -found[..., 2] if found.shape[-1] == 3 else np.zeros(found.shape[:-1])
    if (d < 0).any():
        raise InputError("points above the half-space", where="z", found=-float(d.min()), expected="z <= 0")
    return found[..., 0], found[..., 1], d + 0.0


def rectangle(ground: HalfSpace, offsets: ArrayLike, sides: tuple[float, float]) -> Array:
    """Motion X, Y, Z per uniform traction X, Y, Z (m/Pa) on a rectangle of two sides along X and Y (m), (..., 3, 3).

    Offsets, from its centre, as `point_forces`. Corner sums of the antiderivatives of those kernels; on the surface
    those of Love (1929).
    """
    a, b = (positive("sides", side, where="rectangle", unit="m") / 2 for side in sides)
    scale = max(a, b)
    x, y, d = (c / scale for c in split(offsets))
    total = np.zeros((*x.shape, 3, 3))
    for sx in (1, -1):
        for sy in (1, -1):
            total += sx * sy * _corner(x + sx * a / scale, y + sy * b / scale, d, ground.nu)
    return total * scale / (4 * np.pi * ground.mu)


def _corner(X: Array, Y: Array, d: Array, nu: float) -> Array:
    """Antiderivative in x and y of 4 pi mu times the motion under a point force."""
    m, R = 1 - 2 * nu, np.sqrt(X**2 + Y**2 + d**2)
    bulge = d * np.arctan(_over(X * Y, d * R))
    log_x, log_y = (X, Y**2 + d**2), (Y, X**2 + d**2)
    lift_x, lift_y = _lift(X, Y, d, R), _lift(Y, X, d, R)
    mass = _times_log(X, *log_y, R) + _times_log(Y, *log_x, R) - bulge  # of 1/r
    found = np.empty((*R.shape, 3, 3))
    found[..., 0, 0] = 2 * mass - _times_log(X, *log_y, R) + m * (_times_log(X, *log_y, R) - d * lift_x)
    found[..., 1, 1] = 2 * mass - _times_log(Y, *log_x, R) + m * (_times_log(Y, *log_x, R) - d * lift_y)
    height = _times_log(d, R, np.zeros_like(R), d)
    found[..., 0, 1] = found[..., 1, 0] = -R + m * (R - height)
    found[..., 2, 2] = bulge + 2 * (1 - nu) * mass
    for i, (edge, log, across, lift) in enumerate(((Y, log_y, X, lift_x), (X, log_x, Y, lift_y))):
        leaning = -_times_log(d, *log, R)  # of c d / r^3
        turning = _times_log(edge, R, np.zeros_like(R), d) - leaning + across * lift  # of c / (r (r + d))
        found[..., i, 2] = m * turning - leaning
        found[..., 2, i] = -m * turning - leaning
    return found


def _times_log(factor: Array, y: Array, rest: Array, R: Array) -> Array:
    """The product factor ln(y + R) with R^2 = y^2 + rest, which cancels for y < 0; 0 where the factor is."""
    straight = np.where(factor != 0, y + R, 1.0)
    safe = np.where((factor != 0) & (y < 0), rest, 1.0)
    mirrored = np.log(np.where(safe > 0, safe, 1.0)) - np.log(np.where(y < 0, R - y, 1.0))
    return factor * np.where(y < 0, mirrored, np.log(np.where(straight > 0, straight, 1.0)))


def _lift(X: Array, Y: Array, d: Array, R: Array) -> Array:
    """atan(Y / X) - atan(Y d / (X R)); 0 at X = 0."""
    return np.arctan(_over(Y, X)) - np.arctan(_over(Y * d, X * R))


def _over(a: Array, b: Array) -> Array:
    return np.divide(a, b, out=np.zeros_like(a), where=b != 0)


WARN, REFUSE = 0.1, 0.3  # contact radius over thickness
CHANGED = 0.15, 0.3  # share of the motion of the markers that the base of a pad changes
EDGE = 4.0  # thicknesses to the edge of the pad


def too_soft(ratio: float, nu: float) -> float:
    """Per cent of the depth of a half-space at the middle of a Hertz press that a bonded layer lacks, by a/t and nu."""
    layer, press = Layer(h=1.0, E=1.0, nu=nu), Press(radius=positive("a/t", ratio, where="too_soft"))
    ours, theirs = (press.displacement(ground, [[0.0, 0.0]])[0, 2] for ground in (layer, layer.half_space))
    return float(100 * (1 - ours / theirs))


def thin_pad(
    radius: float, thickness: float, nu: float, *, what: str = "half-space", allow: Iterable[str] = ()
) -> Flag | None:
    """W601 above a contact radius of 0.1 thicknesses (both m); E602 above 0.3, refused unless `allow` names it.

    `what` is the formula, as the message names it.
    """
    ratio = positive("radius", radius, where=what, unit="m") / positive("thickness", thickness, where=what, unit="m")
    message = (
        f"the {what} is {too_soft(ratio, nu):.0f} % too soft here: "
        f"contact radius / thickness = {ratio:.3g}, nu = {nu:g}"
    )
    return _beyond("contact radius / thickness", ratio, (WARN, REFUSE), message, allow)


def base_seen(share: float, thickness: float, allow: Iterable[str] = ()) -> Flag | None:
    """W601 and E602 where the base of a pad (m) changes the motion of its markers by this share of the half-space's.

    It does so wherever the markers spread as far as half the pad is thick, however small the contact.
    """
    message = (
        f"on a pad {1e3 * thickness:.3g} mm thick the markers move by {100 * share:.0f} % otherwise than in the "
        "half-space, which makes more than that of the force"
    )
    return _beyond("change of the motion by the base", share, CHANGED, message, allow)


def of_unknown_thickness(radius: float, deepest: float) -> Flag | None:
    """W601 for a half-space of unknown thickness, where a contact is wider than the markers are deep (both m)."""
    ratio = radius / positive("deepest", deepest, where="of_unknown_thickness", unit="m")
    if not ratio > 1:
        return None
    return Flag(
        "W601",
        Evidence("contact radius / depth of the deepest markers", ratio, 1.0),
        f"nothing says how thick the pad is: a half-space is meant for more than {1e3 * radius / WARN:.3g} mm, ten "
        f"radii of this contact, and the deepest markers lie at {1e3 * deepest:.3g} mm",
        "state it (extent=tactile.Extent(thickness)), or use a Layer as ground",
    )


def _beyond(name: str, value: float, limits: tuple[float, float], message: str, allow: Iterable[str]) -> Flag | None:
    """W601 above the first limit, E602 above the second."""
    warn, refuse = limits
    if not value > warn:
        return None
    advice = "use the bonded layer (tactile.Layer) or a finite-element pad, for validation too"
    if value <= refuse:
        return Flag("W601", Evidence(name, value, warn), message, advice)
    if "LID-E602" not in {canonical(code) for code in ([allow] if isinstance(allow, str) else allow)}:
        raise NotIdentifiable(
            f"{message}, {name} above {refuse:g}", advice=f'{advice}; allow=("E602",) uses it all the same',
            code="LID-E602",
        )  # fmt: skip
    return Flag("E602", Evidence(name, value, refuse), message + ", allowed by the user", advice)


def near_edge(distance: float, thickness: float) -> Flag | None:
    """W601 for an infinite layer or a half-space: a contact rim nearer to the edge (m) than four thicknesses."""
    ratio = distance / positive("thickness", thickness, where="near_edge", unit="m")
    if ratio >= EDGE:
        return None
    return Flag(
        "W601",
        Evidence("distance to the edge / thickness", ratio, EDGE),
        f"the load is {ratio:.2g} thicknesses from the edge of the pad: the formula knows no edge",
        "use a finite-element pad with its free edges, or press in the middle",
    )
