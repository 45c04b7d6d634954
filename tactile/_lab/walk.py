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
SWITCHES = ("vanish", "naive", "ignored", "uncorrected", "wrong")  # of the first five steps, in their order
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
def sensor(blind: bool) -> GelSlim:
    """F = K U of this pad; an eye that knows no rays has no slopes to correct by."""
    from tactile import GelSlim, Markers

    sight = eye(blind)
    markers = Markers(sight.markers, sight.noise, slope=sight.slope)
    return GelSlim(rig().pad, markers, allow=("E603",) if blind else ())


@cache
def rows(blind: bool) -> Any:
    """Motion of the markers (3 N,) from that of the nodes (3 P,)."""
    return rig().pad.from_surface(sensor(blind).markers.points)


@cache
def interpolated(vanish: bool, naive: bool) -> Interpolation:
    """Markers that are seen, to nodes."""
    from tactile import Interpolation

    seen = np.isfinite(apparent(vanish, naive, 1.0))
    return Interpolation(np.where(seen, eye(False).markers, np.nan), rig().pad.nodes2d, "local")


@lru_cache(64)
def completed(vanish: bool, naive: bool, noise: float, uncorrected: bool, wrong: bool) -> Completed:
    """The product with the stiffness, and the motion that it rests on."""
    from tactile import Sphere

    r, seen = rig(), apparent(vanish, naive, noise)
    ball = Sphere(radius=WRONG * BALL, depth=r.ball.depth, at=AT) if wrong else r.ball
    slim = sensor(uncorrected).with_noise(noise * eye(uncorrected).noise)
    found = slim.estimate(seen, indenter=ball)
    nodes = r.pad.displacements(found.forces())
    z = np.asarray(rows(uncorrected) @ nodes.ravel()).reshape(-1, 3)[:, 2]
    slope = slim.markers.slope
    corrected = seen if slope is None else seen - slope * z[:, None]
    return Completed(found, interpolated(vanish, naive), ball, nodes, corrected)


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
def shown(steps: Steps) -> dict[str, Any]:
    """The first five steps: what goes in, what comes out, and after each the map of it; mm, px, um, kPa, N."""
    from dataclasses import asdict

    from loadid._lab.shown import flags_of

    given, after = asdict(steps), []
    for k in range(1, len(SWITCHES) + 1):
        done = Steps(**{name: given[name] for name in SWITCHES[:k]})
        found, raised = answered(done)
        after.append({**_map(found), "flags": flags_of(raised)})
    found = matched(steps.vanish, steps.naive)
    seen = apparent(steps.vanish, steps.naive, 1.0)
    made = completed(steps.vanish, steps.naive, 1.0, steps.uncorrected, steps.wrong)
    rest, many = eye(False).tracker, len(dots(steps.vanish))
    return {
        "detect": {"dots": dots(steps.vanish), "found": many, "markers": len(rig().markers)},
        "match": {"rest": rest.points, "motion": found.motion, "lost": found.lost,
                  "largest": float(np.nanmax(np.hypot(*found.motion.T))), "pitch": rest.pitch},
        "interpolate": _interpolated(made, seen, steps),
        "correct": {"points": 1e3 * eye(False).markers, "before": 1e3 * seen, "after": 1e3 * made.corrected,
                    **_tangential(made, seen)},
        "normal": _normal(made),
        "after": after,
        "truth": _truth(),
    }  # fmt: skip


def solved(steps: Steps) -> dict[str, Any]:
    """The sixth step: the motion of the nodes that goes in, the map that comes out, and what is said of it."""
    from loadid._lab.shown import flags_of

    found, raised = answered(steps)
    made = completed(steps.vanish, steps.naive, steps.noise, steps.uncorrected, steps.wrong)
    choice, order = found.choice, _order()
    return {
        "motion": 1e3 * _moved(made.field, made.corrected), "noise": 1e6 * steps.noise * _jitter(),
        "shear": 1e-3 * _tractions(found)[order, :2], **_map(found),
        "lam": None if choice is None else choice.lam, "rule": None if choice is None else choice.rule,
        "verdict": None if choice is None else choice.verdict, "flags": flags_of(raised),
    }  # fmt: skip


def answered(steps: Steps) -> tuple[LoadEstimate, list[Any]]:
    """The answer of all six steps, and what was flagged on the way, each code once."""
    how = (steps.vanish, steps.naive, steps.noise, steps.uncorrected, steps.wrong)
    made, found = completed(*how), matched(steps.vanish, steps.naive)
    seen = [*found.flags, *(flag for flag in eye(steps.uncorrected).flags if flag)]
    given = ridged(*how, steps.ignored) if steps.ridge else made.map
    raised = [*seen, *([made.field.correlated] if steps.ridge else []), *given.flags]
    return given, list({flag.code: flag for flag in raised if flag is not None}.values())


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
    field = made.field
    effective, rank = field.effective()
    return {
        "nodes": 1e3 * rig().pad.nodes2d, "motion": 1e3 * _moved(field, seen), "inside": int(field.inside.sum()),
        "outside": int(np.sum(~field.inside)), "effective": effective, "rank": rank, "held": held(made, steps),
    }  # fmt: skip


def _moved(field: Interpolation, motion: Array) -> Array:
    """Motion of the nodes (P, 2) of that of the markers; NaN outside them."""
    return np.where(field.inside[:, None], field.W[:, field.used] @ motion[field.used], np.nan)


def held(made: Completed, steps: Steps) -> float:
    """Share of errors inside the 95 % band of F = K U: of all nodes, by the band as it is stated.

    With the correlation ignored the variances of nodes are summed as if each had noise of its own.
    """
    if not steps.ignored:
        return 0.95
    from scipy.special import erf

    slim, W = sensor(steps.uncorrected), made.field.W
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


def _jitter() -> float:
    """Noise of a marker as the unloaded frames show it, m."""
    return float(np.sqrt(np.median(eye(False).noise ** 2)))


def _tractions(found: LoadEstimate) -> Array:
    """Of the nodes (P, 3), Pa."""
    return np.asarray(np.asarray(found.load).reshape(-1, 3) / rig().pad.surface.areas[:, None])


@cache
def _order() -> Array:
    """Nodes row by row, from below."""
    nodes = rig().pad.nodes2d
    return np.lexsort((nodes[:, 0], nodes[:, 1]))


def _grid_of(values: Array) -> Array:
    """Values of the nodes as rows and columns."""
    columns = len(np.unique(np.round(rig().pad.nodes2d[:, 0], 9)))
    return np.asarray(values[_order()]).reshape(-1, columns)


def _map(found: LoadEstimate) -> dict[str, Any]:
    """The map of pressure, and its two errors."""
    forces = np.asarray(found.load).reshape(-1, 3)
    total, spread = errors(forces)
    return {"pressure": _grid_of(-1e-3 * _tractions(found)[:, 2]), "force": forces.sum(axis=0),
            "resultant_error": total, "map_error": spread}  # fmt: skip


def _truth() -> dict[str, Any]:
    r = rig()
    low, high = 1e3 * (r.pad.nodes2d.min(axis=0) - CELL / 2), 1e3 * (r.pad.nodes2d.max(axis=0) + CELL / 2)
    return {
        "x": [low[0], high[0]], "y": [low[1], high[1]], "nodes": 1e3 * r.pad.nodes2d[_order()],
        "pressure": _grid_of(-1e-3 * r.truth[:, 2]), "shear": 1e-3 * r.truth[_order(), :2],
        "force": np.array(r.press.vector),
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
