"""Guards of the tactile route: each triggered through the door that a user takes, and its clean twin."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from structures import Flag
from tactile import (
    ForceMap,
    GelSlim,
    Hertz,
    Layer,
    LayerSensor,
    Markers,
    MultilayerPad,
    Pad,
    Press,
    Sphere,
    View,
    metrics,
)
from tactile import _guards as guards

from ..tactile import rigs
from ..tactile.domes import DomePress
from ..tactile.domes import motion as motion_of
from .cases import Case, refused

OLD, NEW = datetime(2024, 5, 1), datetime(2025, 5, 1)
FORCES = [0.1, 0.0, -1.0], [0.1, 0.0, -1.1]  # found, true


def small(**settings: object) -> Pad:
    """A pad of few cells."""
    given = {"size": (8e-3, 8e-3), "thickness": 3e-3, "E": 147e3, "nu": 0.3223, "pitch": 1e-3, "layers": 4}
    return Pad(**{**given, **settings})  # type: ignore[arg-type]


def strained(force: float) -> tuple[Flag, ...]:
    """What the strain of a pad under a force says."""
    here = small()
    f = np.zeros((here.points, 3))
    f[here.points // 2, 2] = -force
    found = here.strained(f)
    return () if found is None else (found,)


def mapped(**settings: object) -> ForceMap:
    """A force map of the small rig, and what was found on the way."""
    return rigs.sensor(**settings).estimate(rigs.motion(1))  # type: ignore[arg-type]


def lost(count: int) -> tuple[Flag, ...]:
    """Flags of a frame in which some markers are lost."""
    y = rigs.motion(1).copy()
    y[:count] = np.nan
    return rigs.sensor().estimate(y).flags


def slid(shift: float) -> tuple[Flag, ...]:
    """Flags of an untouched pad whose image is shifted (m)."""
    still = rigs.NOISE * np.random.default_rng(1).standard_normal((len(rigs.markers()), 3))
    return rigs.sensor().estimate(still + np.array([shift, 0.0, 0.0])).flags


def slim(spread: bool, indenter: bool = False) -> tuple[Flag, ...]:
    """Flags of F = K U, on markers that are the nodes or coarser than them."""
    here = rigs.pad(1, "standard")
    m = rigs.markers(6, 5) if spread else here.nodes2d
    s = GelSlim(here, Markers(m, 1e-6, "XY" if indenter else "XYZ"), interpolation="linear")
    u = np.zeros((len(m), 3))
    return s.estimate(u, indenter=Sphere(radius=8e-3, depth=0.2e-3) if indenter else None).flags


def layered(nu: float = 0.3223, at: float = 0.0) -> tuple[Flag, ...]:
    """Flags of the in-plane motion of an endless layer in a window, under a shear in its middle or beside it."""
    gel, line = Layer(2e-3, 147e3, nu), np.linspace(-12e-3, 12e-3, 41)
    points = np.array([(x, y) for y in line for x in line])
    u = Press(at=(at, 0.0), radius=2e-3, force=0.0, shear=(0.2, 0.0)).displacement(gel, points)
    return LayerSensor(gel, Markers(points, 2e-6)).estimate(u[:, :2]).flags


def flattened(dome: bool) -> tuple[Flag, ...]:
    """Flags of a press on a dome, or on a flat gel, by a sensor that takes both for flat."""
    flat = Pad(size=(12e-3, 12e-3), thickness=4e-3, E=147e3, nu=0.45)
    gel = Pad.dome(8e-3, 4e-3, plinth=1.5e-3, E=147e3, nu=0.45, pitch=1e-3, layers=4) if dome else flat
    line = np.arange(-5e-3, 5.5e-3, 1e-3)
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    u = motion_of(points, DomePress(at=(0.6e-3, -0.4e-3), radius=2.5e-3, force=0.4, shear=0.08), pad=gel)
    seen = u + 2e-6 * np.random.default_rng(1).standard_normal(u.shape)
    return MultilayerPad(flat, Markers(points, 2e-6, "XYZ"), choice=0.05).estimate(seen).flags


def in_the_plane(force: float) -> tuple[Flag, ...]:
    """Flags of a press on a flat gel by markers in the plane under a contact prior, or of the gel at rest."""
    gel, rng = Pad(size=(12e-3, 12e-3), thickness=4e-3, E=147e3, nu=0.45), np.random.default_rng(1)
    line = np.arange(-5e-3, 5.5e-3, 1e-3)
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    u = 2e-6 * rng.standard_normal((len(points), 3))
    if force:
        u += motion_of(points, DomePress(at=(0.6e-3, -0.4e-3), radius=2.5e-3, force=force, shear=0.08), pad=gel)
    return MultilayerPad(gel, Markers(points, 2e-6), choice=0.05).estimate(u[:, :2]).flags


def hertz(thickness: float) -> tuple[Flag, ...]:
    """Flags of a Hertz contact on a pad, or its refusal."""
    found: list[Flag] = []
    raised = refused(lambda: found.extend(Hertz(R=4e-3, force=0.02, E=147e3, nu=0.3223, thickness=thickness).flags))
    return raised or tuple(found)


def motion(known: bool) -> tuple[Flag, ...]:
    """The refusal of tangential motion by a homography, with and without the directions of the rays."""
    rays = {"alpha": 0.3, "gamma": 1.4} if known else {}
    view = View.homography(np.diag([2e4, 2e4, 1.0]), **rays)  # type: ignore[arg-type]
    px = np.zeros((4, 2))
    return refused(lambda: view.motion(px, px + 1.0, 1e-4))


def one(flag: Flag | None) -> tuple[Flag, ...]:
    """As a tuple."""
    return () if flag is None else (flag,)


CASES = [
    Case("E110", lambda: refused(lambda: guards.counts(1964, 3698)), lambda: refused(lambda: guards.counts(1764, 3698)),
         "one conforming mesh"),
    Case("W111", lambda: small(E=147e6).flags, lambda: small().flags, "1.47e.08.*factor 1000"),
    Case("W112", lambda: strained(5.0), lambda: strained(0.01), "principal strain"),
    Case("W113", lambda: one(guards.one_of_two("rate independent", "not tested")),
         lambda: one(guards.one_of_two("rate independent", "linear")), "linearity"),
    Case("W115", lambda: small(layers=1, element="standard").flags, lambda: small().flags, "single layer|one layer"),
    Case("W117", lambda: one(guards.unlike(3.1, 2, 1.0)), lambda: one(guards.unlike(1.1, 2, 1.0)), "2 presses.*3.1"),
    Case("W117", lambda: one(guards.unlike(1.1, 2, 2.5)), lambda: one(guards.unlike(1.1, 2, 1.5)), "2.5 times",
         "motion"),
    Case("W601", lambda: hertz(4e-3), lambda: hertz(1.0), "too soft"),
    Case("E602", lambda: hertz(1e-3), lambda: hertz(1.0), "too soft"),
    Case("E603", lambda: motion(False), lambda: motion(True), "not known"),
    Case("W604", lambda: lost(12), lambda: lost(1), "36 of 585"),
    Case("W605", lambda: slim(True), lambda: slim(False), "effective"),
    Case("N606", lambda: slim(False, indenter=True), lambda: slim(False), "z completed"),
    Case("W607", lambda: one(guards.drift(5e-5, 1e-6, OLD)), lambda: one(guards.drift(1e-6, 1e-6, OLD)),
         "2024-05-01"),
    Case("W608", lambda: mapped(choice=0.06).flags, lambda: mapped(choice=1e-3).flags, "lowers the resultant by"),
    Case("W608", lambda: mapped(choice=0.2).flags, lambda: mapped(choice=1e-3).flags, "would be found", "unseen"),
    Case("N610", lambda: metrics.compare_resultants(*FORCES, loads=0).flags,
         lambda: metrics.compare_resultants(*FORCES).flags, "no map"),
    Case("W611", lambda: slid(18e-6), lambda: slid(0.0), "moved together by .1[78].*fasten"),
    Case("W612", lambda: layered(0.47), layered, r"28 % of it is read as shear"),
    Case("W613", lambda: layered(at=10e-3), layered, "places at the edge of the window move by"),
    Case("W614", lambda: one(guards.unpressed(np.array([0.2, 0.0, -0.001]), 1e-4 * np.eye(3))),
         lambda: one(guards.unpressed(np.array([0.2, 0.0, -0.5]), 1e-4 * np.eye(3))), "a shear of 0.2 N and no press"),
    Case("W615", lambda: flattened(dome=True), lambda: flattened(dome=False), "times as much of the readings"),
    Case("N617", lambda: one(guards.contacts_open({1: 0.57, 2: 0.43})),
         lambda: one(guards.contacts_open({1: 0.995, 2: 0.005})), r"1 contact \(57%\).* 2"),
    Case("N618", lambda: in_the_plane(0.0), lambda: in_the_plane(0.4), "no contact is found; .*hide a press of up to"),
    Case("W608", lambda: in_the_plane(0.4), lambda: mapped(choice=1e-3).flags, "the band holds", "contacts"),
    Case("W705", lambda: one(guards.gain_or_shape(0.8, 0.999, 0.01, 0.5)),
         lambda: one(guards.gain_or_shape(1.01, 0.9999, 0.001, 0.5)), "0.8"),
    Case("W706", lambda: one(guards.other_calibration(OLD, NEW)), lambda: one(guards.other_calibration(NEW, OLD)),
         "2024-05-01"),
]  # fmt: skip
