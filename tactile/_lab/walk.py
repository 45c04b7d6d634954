"""One press of a ball on a gel pad, photographed and rebuilt in six steps, each of which can be done wrongly.

The truth is the exact motion of a bonded layer (`tactile.Press` on a `tactile.Layer`), not that of the pad's own mesh.
What no switch changes is made once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from loadid import LoadEstimate
    from tactile import Eye, GelSlim, Interpolation, Pad, Press, Sphere, View

Array = NDArray[Any]

THICKNESS, E, NU = 3e-3, 147e3, 0.3223  # m, Pa: the gel of GelSlim, its modulus read as 0.147 MPa
SIZE, CELL, LAYERS = (14e-3, 12e-3), 1e-3, 4  # m
BALL, RADIUS, FRICTION, AT = 14e-3, 2.0e-3, (0.35, 0.15), (0.4e-3, -0.3e-3)  # m, of the ball and of its contact
ROWS, COLUMNS, PITCH, DOT = 10, 12, 1.15e-3, 0.22e-3  # markers; m
FOCAL, DISTANCE, TILT, INDEX, FRAME = 610.0, 25e-3, 0.4, 1.4, (280, 320)  # px, m, rad, px
GREY = 1.5  # grey levels of noise
QUIET = 6  # unloaded frames, whose jitter is the noise
RIM = (0.9, 1.25)  # of the contact, over its radius, where a few dots are always hidden
HIDDEN = 2
LEFT = 3e-6  # m, what this mesh and the shape of the indenter leave of the motion; stated beside the noise
NORMAL95 = 1.959963984540054
WRONG = 0.5  # radius of the indenter that is not the one, over that of the ball


@dataclass(frozen=True)
class Steps:
    """How the six steps are done; each is right where nothing is said.

    Parameters
    ----------
    vanish : bool
        The dots under the contact are not seen.
    naive : bool
        Every marker takes the nearest dot, however far it is and whoever else takes it.
    uncorrected : bool
        Apparent motion is taken for tangential motion.
    wrong : bool
        The indenter is said to be a ball of half the radius, equally deep.
    noise : float
        Noise of the markers over that of the camera.
    ridge : bool
        Inverted with a ridge instead of multiplied.
    ignored : bool
        The noise of the nodes is taken for white: the band is that of independent nodes, and GCV chooses lambda.
    """

    vanish: bool = False
    naive: bool = False
    uncorrected: bool = False
    wrong: bool = False
    noise: float = 1.0
    ridge: bool = False
    ignored: bool = False


# -- the rig, made once ------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Rig:
    """Pad, press, the ball that makes it and the camera; exact motion of the markers (N, 3), tractions of the nodes."""

    pad: Pad
    press: Press
    ball: Sphere
    view: View
    markers: Array
    motion: Array
    truth: Array
    under: Array
    hidden: Array


@cache
def rig() -> Rig:
    """The pad and what is done to it."""
    from tactile import Pad, View, metrics

    pad = Pad(E=E, nu=NU, size=SIZE, thickness=THICKNESS, pitch=CELL, layers=LAYERS)
    layer = _layer()
    press, ball = _on_ball(layer)
    view = View.camera(focal=FOCAL, centre=(FRAME[1] / 2, FRAME[0] / 2), distance=DISTANCE, depth=THICKNESS,
                       gamma=INDEX, tilt=TILT)  # fmt: skip
    markers = _grid()
    r = np.hypot(*(markers - AT).T) / RADIUS
    rim = np.flatnonzero((r > RIM[0]) & (r < RIM[1]))
    return Rig(
        pad, press, ball, view, markers, press.displacement(layer, markers),
        metrics.means(press, pad.nodes2d, CELL), np.flatnonzero(r < 1), rim[:: len(rim) // HIDDEN][:HIDDEN],
    )  # fmt: skip


def _layer() -> Any:
    from tactile import Layer

    return Layer(THICKNESS, E, NU)


def _on_ball(layer: Any) -> tuple[Press, Sphere]:
    """The press that leaves the shape of the ball at its deepest point and its rim, and between them to 4 %."""
    from tactile import Press, Sphere

    ends = np.array([[0.0, 0.0], [RADIUS, 0.0]])
    deep, rim = -Press(radius=RADIUS, force=1.0).displacement(layer, ends)[:, 2]
    force = (BALL - np.sqrt(BALL**2 - RADIUS**2)) / (deep - rim)
    shear = (FRICTION[0] * force, FRICTION[1] * force)
    press = Press(at=AT, radius=RADIUS, force=float(force), shear=shear)
    return press, Sphere(radius=BALL, depth=float(force * deep), at=AT)


def _grid() -> Array:
    from ..vision._images import grid

    return grid(ROWS, COLUMNS, PITCH)


# -- 1 detect ----------------------------------------------------------------------------------------------------------
@cache
def photograph(share: float, seed: int, gone: str = "") -> Array:
    """Image of the pad under a share of the press, without some dots: ``hidden`` or ``under`` the contact."""
    from ..vision._images import Scene

    r = rig()
    places = np.column_stack([r.markers, np.zeros(len(r.markers))]) + share * r.motion
    for name in gone.split():
        places[getattr(r, name)] = np.nan
    image: Array = Scene(size=FRAME, radius=DOT, noise=GREY, shading=20.0).photograph(r.view, places, seed=seed)
    return image


@cache
def eye(blind: bool) -> Eye:
    """The eye of the pad; blind to the directions in which it sees its markers, where projection is not corrected."""
    from tactile import Eye, View

    view = View(rig().view.image) if blind else rig().view
    return Eye(view, photograph(0.0, 0), unloaded=[photograph(0.0, k + 1) for k in range(QUIET)], size=SIZE,
               allow=("E603",) if blind else ())  # fmt: skip


def pressed(vanish: bool) -> Array:
    """The image under the whole press."""
    return photograph(1.0, 99, "hidden under" if vanish else "hidden")


@cache
def dots(vanish: bool) -> Array:
    """Places of the dots of that image (k, 2), px."""
    found: Array = eye(False).tracker.detector(pressed(vanish)).points
    return found


# -- 2 match -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Matched:
    """Motion of the markers (N, 2) in px, NaN where one is lost, and what was flagged on the way."""

    motion: Array
    lost: int
    flags: tuple[Any, ...]


@cache
def matched(vanish: bool, naive: bool) -> Matched:
    """Dots to markers: as the tracker does it, or each marker to the dot that is nearest."""
    from tactile import MarkerTracker

    rest = eye(False).tracker.points
    if naive:
        from scipy.spatial import cKDTree

        found = dots(vanish)
        return Matched(found[cKDTree(found).query(rest)[1]] - rest, 0, ())
    motion = MarkerTracker(rest).step(dots(vanish))
    return Matched(motion.moved, int(np.isnan(motion.moved[:, 0]).sum()), tuple(motion.flags))


@lru_cache(64)
def apparent(vanish: bool, naive: bool, noise: float) -> Array:
    """Motion of the markers in the image (N, 2), m on the pad; with more noise, if that is asked for."""
    sight = eye(False)
    rest, found = sight.tracker.points, matched(vanish, naive).motion
    moved = sight.view.to_pad(rest + found) - sight.view.to_pad(rest)
    more = np.sqrt(max(noise**2 - 1, 0.0)) * sight.noise
    found = moved[sight.kept] + more * np.random.default_rng(5).standard_normal((len(sight.kept), 2))
    return np.asarray(found, float)


# -- 3 interpolate, 4 correct, 5 normal motion -------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Completed:
    """What the sensor made of the motion: the map, and the motion of all nodes under its forces."""

    map: Any
    field: Interpolation
    indenter: Sphere
    nodes: Array
    corrected: Array


@cache
def sensor(blind: bool, noise: float) -> GelSlim:
    """F = K U of this pad; an eye that knows no rays has no slopes to correct by."""
    from tactile import GelSlim, Markers

    sight = eye(blind)
    return GelSlim(rig().pad, Markers(sight.markers, noise * sight.noise, slope=sight.slope), allow=sight_allows(blind))


def sight_allows(blind: bool) -> tuple[str, ...]:
    """What had to be allowed of an eye that knows no rays."""
    return ("E603",) if blind else ()


@lru_cache(64)
def completed(vanish: bool, naive: bool, noise: float, uncorrected: bool, wrong: bool) -> Completed:
    """The product with the stiffness, and the motion that it rests on."""
    from tactile import Interpolation, Sphere

    r, seen = rig(), apparent(vanish, naive, noise)
    ball = Sphere(radius=WRONG * BALL, depth=r.ball.depth, at=AT) if wrong else r.ball
    slim = sensor(uncorrected, noise)
    found = slim.estimate(seen, indenter=ball)
    nodes = r.pad.displacements(found.forces()).reshape(-1, 3)
    z = np.asarray(r.pad.from_surface(slim.markers.points) @ nodes.ravel()).reshape(-1, 3)[:, 2]
    slope = slim.markers.slope
    corrected = seen if slope is None else seen - slope * z[:, None]
    there = np.where(np.isfinite(seen), slim.markers.points[:, :2], np.nan)
    return Completed(found, Interpolation(there, r.pad.nodes2d, "local"), ball, nodes, corrected)


# -- 6 multiply or invert ----------------------------------------------------------------------------------------------
@lru_cache(64)
def ridged(vanish: bool, naive: bool, noise: float, uncorrected: bool, wrong: bool, ignored: bool) -> LoadEstimate:
    """The same motion inverted: least squares on the compliance with a ridge, its noise as the interpolation made it.

    Where correlation is ignored nobody states the noise, and GCV takes what is white for it.
    """
    from loadid import Noise, StaticInversion

    r, made = rig(), completed(vanish, naive, noise, uncorrected, wrong)
    rows, data, W = _known(made)
    stds = np.full(W.shape[1], LEFT)
    stds[: 2 * int(made.field.used.sum())] = np.hypot(LEFT, noise * np.sqrt(np.median(eye(False).noise ** 2)))
    told: dict[str, Any] = {"choice": "gcv"} if ignored else {
        "noise": Noise(stds, source="repeatability", interpolation=W)
    }  # fmt: skip
    return StaticInversion(r.pad.compliance[rows], **told).estimate(data)


def _known(made: Completed) -> tuple[Array, Array, Array]:
    """Motion of the nodes that markers reach: rows of the compliance, readings, weights of what was measured.

    In the plane that of the markers, along the normal that of the pad on its indenter, as a marker for each node.
    """
    used = made.field.used
    nodes = np.flatnonzero(made.field.inside)
    W = made.field.W[nodes][:, used].toarray()
    plane = W @ made.corrected[used]
    values = np.column_stack([plane, made.nodes[nodes, 2]])
    weights = np.zeros((len(nodes), 3, 2 * W.shape[1] + len(nodes)))
    weights[:, 0, : W.shape[1]], weights[:, 1, W.shape[1] : 2 * W.shape[1]] = W, W
    weights[np.arange(len(nodes)), 2, 2 * W.shape[1] + np.arange(len(nodes))] = 1.0
    rows = (3 * nodes[:, None] + np.arange(3)).ravel()
    return rows, values.ravel(), weights.reshape(len(rows), -1)


# -- what is shown -----------------------------------------------------------------------------------------------------
def walk(steps: Steps) -> dict[str, Any]:
    """All six steps with what goes in and what comes out, the map, its two errors and every flag; mm, px, kPa, N."""
    from loadid._lab.shown import flags_of

    r, sight = rig(), eye(steps.uncorrected)
    found = matched(steps.vanish, steps.naive)
    seen = apparent(steps.vanish, steps.naive, steps.noise)
    made = completed(steps.vanish, steps.naive, steps.noise, steps.uncorrected, steps.wrong)
    given, flags = made.map, [*found.flags, *(f for f in sight.flags if f), *made.map.flags]
    if steps.ridge:
        given = ridged(steps.vanish, steps.naive, steps.noise, steps.uncorrected, steps.wrong, steps.ignored)
        flags = [*found.flags, *(f for f in sight.flags if f), made.field.correlated, *given.flags]
    forces = np.asarray(given.load).reshape(-1, 3)
    return {
        "detect": {"dots": dots(steps.vanish), "found": len(dots(steps.vanish)), "markers": len(r.markers)},
        "match": {"rest": eye(False).tracker.points, "motion": found.motion, "lost": found.lost,
                  "largest": float(np.nanmax(np.hypot(*found.motion.T))), "pitch": eye(False).tracker.pitch},
        "interpolate": _interpolated(made, seen, steps),
        "correct": {"points": 1e3 * sight.markers, "before": 1e3 * seen, "after": 1e3 * made.corrected,
                    **_tangential(made, seen)},
        "normal": _normal(made),
        "solve": _solved(given, steps),
        "map": _map(forces),
        "flags": flags_of({flag.code: flag for flag in flags if flag is not None}.values()),  # each code once
    }  # fmt: skip


def errors(forces: Array) -> tuple[float, float]:
    """The two errors: of the resultant over its size, and of the tractions, rms over the largest."""
    r = rig()
    true = np.array(r.press.vector)
    rest = forces / r.pad.surface.areas[:, None] - r.truth
    largest = float(np.linalg.norm(r.truth, axis=1).max())
    return (
        float(np.linalg.norm(forces.sum(axis=0) - true) / np.linalg.norm(true)),
        float(np.sqrt(np.mean(np.sum(rest**2, axis=1))) / largest),
    )


def _interpolated(made: Completed, seen: Array, steps: Steps) -> dict[str, Any]:
    field, moved = made.field, np.full((len(rig().pad.nodes2d), 2), np.nan)
    there = np.isfinite(seen).all(axis=1)
    moved[field.inside] = (field.W[:, there] @ seen[there])[field.inside]
    effective, rank = field.effective()
    return {
        "nodes": 1e3 * rig().pad.nodes2d, "motion": 1e3 * moved, "inside": int(field.inside.sum()),
        "outside": int(np.sum(~field.inside)), "effective": effective, "rank": rank, "held": held(made, steps),
    }  # fmt: skip


def held(made: Completed, steps: Steps) -> float:
    """Share of errors inside the 95 % band of F = K U: of all nodes, by the band as it is stated.

    With the correlation ignored the variances of nodes are summed as if each had noise of its own.
    """
    if not steps.ignored:
        return 0.95
    from scipy.special import erf

    slim, W = sensor(steps.uncorrected, steps.noise), made.field.W
    noise2 = slim.markers.noise**2
    alone = np.zeros((len(rig().pad.nodes2d), 3))
    alone[:, :2] = W.power(2) @ noise2
    K = slim.K.toarray() if hasattr(slim.K, "toarray") else np.asarray(slim.K)
    stated = np.sqrt(K**2 @ alone.ravel())
    true = np.asarray(made.map.std)
    some = (true > 1e-3 * true.max()) & (stated > 0)
    return float(np.mean(erf(NORMAL95 * stated[some] / true[some] / np.sqrt(2))))


def _tangential(made: Completed, seen: Array) -> dict[str, float]:
    """How far apparent and corrected motion are from the true tangential one, rms in um."""
    true = rig().press.displacement(_layer(), eye(False).markers)[:, :2]
    off = [float(1e6 * np.sqrt(np.nanmean(np.sum((u - true) ** 2, axis=1)))) for u in (seen, made.corrected)]
    return {"off_before": off[0], "off_after": off[1]}


def _normal(made: Completed) -> dict[str, Any]:
    """Normal motion along a line through the contact: the pad, the indenter as stated, and the truth; mm, um."""
    r = rig()
    x = np.unique(np.round(r.pad.nodes2d[:, 0], 9))
    line = np.unique(r.pad.nodes2d[:, 1])[np.argmin(np.abs(np.unique(r.pad.nodes2d[:, 1]) - AT[1]))]
    along = np.isclose(r.pad.nodes2d[:, 1], line)
    order = np.argsort(r.pad.nodes2d[along, 0])
    fine = np.linspace(x[0], x[-1], 121)
    places = np.column_stack([fine, np.full(fine.shape, line)])
    z, inside = made.indenter.normal(places)
    return {
        "x": 1e3 * x, "pad": 1e6 * made.nodes[along, 2][order], "fine": 1e3 * fine,
        "indenter": 1e6 * np.where(inside, z, np.nan),
        "truth": 1e6 * r.press.displacement(_layer(), places)[:, 2],
        "radius": 1e3 * made.indenter.radius, "depth": 1e3 * made.indenter.depth,
    }  # fmt: skip


def _solved(given: Any, steps: Steps) -> dict[str, Any]:
    choice = given.choice
    return {
        "how": "ridge" if steps.ridge else "F = K U",
        "lam": None if choice is None else choice.lam, "rule": None if choice is None else choice.rule,
        "verdict": None if choice is None else choice.verdict, "noise": 1e6 * steps.noise * _jitter(),
    }  # fmt: skip


def _jitter() -> float:
    """Noise of a marker as the unloaded frames show it, m."""
    return float(np.sqrt(np.median(eye(False).noise ** 2)))


def _map(forces: Array) -> dict[str, Any]:
    r = rig()
    traction = forces / r.pad.surface.areas[:, None]
    total, spread = errors(forces)
    nodes = r.pad.nodes2d
    order = np.lexsort((nodes[:, 0], nodes[:, 1]))
    shape = (len(np.unique(np.round(nodes[:, 1], 9))), len(np.unique(np.round(nodes[:, 0], 9))))

    def grid(values: Array) -> Array:
        return np.asarray(values[order]).reshape(shape)

    return {
        "x": 1e3 * np.array([nodes[:, 0].min() - CELL / 2, nodes[:, 0].max() + CELL / 2]),
        "y": 1e3 * np.array([nodes[:, 1].min() - CELL / 2, nodes[:, 1].max() + CELL / 2]),
        "pressure": grid(-1e-3 * traction[:, 2]), "true_pressure": grid(-1e-3 * r.truth[:, 2]),
        "nodes": 1e3 * nodes[order], "shear": 1e-3 * traction[order, :2], "true_shear": 1e-3 * r.truth[order, :2],
        "force": forces.sum(axis=0), "true_force": np.array(r.press.vector),
        "resultant_error": total, "map_error": spread,
    }  # fmt: skip


def picture(vanish: bool, rest: bool) -> str:
    """The image of the pad as a data address, PNG."""
    import base64
    from io import BytesIO

    from PIL import Image

    grey = photograph(0.0, 0) if rest else pressed(vanish)
    buffer = BytesIO()
    Image.fromarray((grey // 8) * 8).save(buffer, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
