"""What no gel pad measures is refused, with the unit that it is likely in; what pads measure stays silent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from structures.errors import InputError
from tactile import (
    DepthMap,
    Extent,
    Eye,
    GelSlim,
    Layer,
    Markers,
    MarkerTracker,
    MultilayerPad,
    Pad,
    Press,
    Sphere,
    View,
    Wrench,
    outline,
)
from tactile import _arrays as arrays

from .rigs import NOISE, PRESS, depth, markers, motion, nodal, pad, sensor

GEL: dict[str, Any] = {"size": (18e-3, 16e-3), "thickness": 3e-3, "E": 147e3, "nu": 0.3223, "pitch": 2e-3}
CAMERA: dict[str, Any] = {"focal": 640, "centre": (320, 240), "distance": 25e-3, "depth": 3e-3, "gamma": 1.4}
RAGGED: Any = [[1.0, 2.0], [3.0]]
MAP = np.zeros((5, 5))


def turned(scale: float) -> DepthMap:
    seen = depth()
    return DepthMap(scale * seen.values, seen.pixel, seen.noise)


def deep(**settings: Any) -> MultilayerPad:
    return MultilayerPad(pad(), Markers(markers(), NOISE), depth=depth(), choice=0.01, **settings, penalty="identity")


def eye(scale: float = 1.0, **settings: Any) -> Eye:
    view = View.homography(np.diag([14e3 * scale, 14e3 * scale, 1.0]), alpha=0.0, gamma=1.4)
    return Eye(view, 14e3 * markers(), noise=0.02, **settings)


def wrenched(force: float, torque: float | None = None) -> Any:
    return sensor().estimate(motion(1), wrench=Wrench([0, 0, -force], None if torque is None else [0, 0, torque]))


OTHER_UNITS: dict[str, tuple[Callable[[], Any], str]] = {
    "size in mm": (lambda: Pad(**{**GEL, "size": (18.0, 16.0)}), r"18 m.*in mm it is 0\.018 m"),
    "size in cm": (lambda: Pad(**{**GEL, "size": (1.8, 1.6)}), r"in cm it is 0\.018 m"),
    "one side": (lambda: Pad(**{**GEL, "size": (18e-3, 16.0)}), r"16 m"),
    "size of nothing": (lambda: Pad(**{**GEL, "size": (18e-6, 16e-6)}), r"decimal point"),
    "negative side": (lambda: Pad(**{**GEL, "size": (-18e-3, 16e-3)}), "a side must be positive"),
    "thickness in mm": (lambda: Pad(**{**GEL, "thickness": 3.0}), r"in mm it is 0\.003 m"),
    "thickness in um": (lambda: Pad(**{**GEL, "thickness": 3000.0}), r"in um it is 0\.003 m"),
    "thin as a molecule": (lambda: Pad(**{**GEL, "thickness": 3e-6}), "the thickness is not of the scale"),
    "negative thickness": (lambda: Pad(**{**GEL, "thickness": -3e-3}), "must be positive"),
    "pitch in mm": (lambda: Pad(**{**GEL, "pitch": 1.0}), r"in mm it is 0\.001 m"),
    "pitch of atoms": (lambda: Pad(**{**GEL, "pitch": 1e-9}), "the pitch is not of the scale"),
    "E in kPa": (lambda: Pad(**{**GEL, "E": 147.0}), r"147 Pa.*in kPa it is 1\.47e\+05 Pa"),
    "E in MPa": (lambda: Pad(**{**GEL, "E": 0.147}), r"in MPa it is 1\.47e\+05 Pa"),
    "E of a metal": (lambda: Pad(**{**GEL, "E": 147e9}), r"1\.47e\+11 Pa.*material="),
    "negative E": (lambda: Pad(**{**GEL, "E": -147e3}), "E must be positive"),
    "pixel in mm": (lambda: DepthMap(MAP, 0.1, 1e-5), r"the pixel.*in mm it is 0\.0001 m"),
    "negative pixel": (lambda: DepthMap(MAP, -1e-4, 1e-5), "must be positive"),
    "pixel of atoms": (lambda: DepthMap(MAP, 1e-10, 1e-5), "the pixel is not of the scale"),
    "noise of depth in um": (lambda: DepthMap(MAP, 1e-4, 10.0), r"the noise.*in um it is 1e-05 m"),
    "places in mm": (lambda: Markers(1e3 * markers(), NOISE), r"a place.*in mm it is 0\.0065 m"),
    "noise in um": (lambda: Markers(markers(), 2.0), r"in um it is 2e-06 m"),
    "motion in mm": (lambda: sensor().estimate(1e3 * motion(1)), r"farther than their pattern is wide.*in mm"),
    "places for motion": (lambda: sensor().estimate(np.pad(20 + markers(), ((0, 0), (0, 1)))), "no places"),
    "depth in mm": (lambda: deep().estimate(motion(1)[:, :2], turned(1e3)), r"below the base.*in mm"),
    "depth turned": (lambda: deep().estimate(motion(1)[:, :2], turned(-1)), r"pulls the surface out.*turn the sign"),
    "depth turned, F = K U": (
        lambda: GelSlim(pad(), Markers(markers(), NOISE), depth=depth()).estimate(motion(1)[:, :2], turned(-1)),
        "pulls the surface out",
    ),
    "depth turned, calibrating": (lambda: deep().calibrate([motion(1)[:, :2]], [turned(-1)]), "pulls the surface out"),
    "distance for motion": (
        lambda: deep().estimate(motion(1)[:, :2], DepthMap(25e-3 + depth().values, 2e-4, 1e-5)),
        "take off what the unloaded pad shows",
    ),
    "indenter in mm": (
        lambda: GelSlim(pad(), Markers(markers(), NOISE)).estimate(
            motion(1)[:, :2], indenter=Sphere(radius=8.0, depth=0.5)
        ),
        r"below the base.*in mm it is -0\.0005",
    ),
    "camera in mm": (lambda: View.camera(**{**CAMERA, "distance": 25.0}), r"distance.*in mm it is 0\.025 m"),
    "negative distance": (lambda: View.camera(**{**CAMERA, "distance": -25e-3}), "distance must be positive"),
    "gel of a camera in mm": (lambda: View.camera(**{**CAMERA, "depth": 3.0}), r"depth.*in mm it is 0\.003 m"),
    "matrix from mm": (lambda: eye(1e-3), r"unit=1e-3"),
    "size of an eye in mm": (lambda: eye(size=(18.0, 16.0)), r"Eye, size.*in mm"),
    "force in mN": (lambda: wrenched(1000.0), r"1000 N.*it is 1 N if it was given in mN or 9\.81 N .* grams"),
    "force in grams": (lambda: wrenched(102.0), r"or 1 N if it was given in grams"),
    "torque in N mm": (lambda: wrenched(1.0, 2.0), r"0\.002 N m if it was given in N mm"),
    "extent, thickness": (lambda: Extent(3.0), r"in mm it is 0\.003 m"),
    "extent, contact": (lambda: Extent(3e-3, 2.0), r"the contact radius.*in mm"),
    "extent, size": (lambda: Extent(3e-3, size=(18.0, 16.0)), r"Extent, size.*in mm"),
}


@pytest.mark.parametrize("case", OTHER_UNITS)
def test_another_unit_is_refused_and_named(case: str) -> None:
    act, words = OTHER_UNITS[case]
    with pytest.raises(InputError, match=words) as caught:
        act()
    assert caught.value.hint


def test_pads_that_were_built_are_silent() -> None:
    """From a gel of traction force microscopy to a patch of robot skin, with their markers, cameras and loads."""
    for size, h, E, pitch in (
        ((120e-6, 120e-6), 30e-6, 5e3, 30e-6),
        ((8e-3, 8e-3), 0.4e-3, 147e3, 2e-3),
        ((18e-3, 16e-3), 3e-3, 147e3, 2e-3),
        ((24e-3, 32e-3), 4e-3, 435e3, 4e-3),
        ((0.1, 0.1), 30e-3, 20e3, 0.02),
        ((0.5, 0.5), 10e-3, 1e6, 0.05),
    ):
        here = Pad(size=size, thickness=h, E=E, nu=0.45, pitch=pitch, layers=3)
        assert here.flags == ()
        Markers(0.4 * np.array(size) * [[1, 1], [-1, 1], [0, -1]], 1e-4 * h)
        DepthMap(MAP, size[0] / 100, 1e-3 * h)
        Extent(h, h, size)
        Wrench([0, 0, -0.2 * E * size[0] * size[1]]).require_scale(E, 0.45, size, h)
    for distance in (1e-3, 25e-3, 0.3):
        View.camera(**{**CAMERA, "distance": distance, "depth": 0.0})
    assert eye(size=(14e-3, 12e-3)).markers.shape == (195, 2)


def test_other_bodies_and_closed_forms_hold_at_any_scale() -> None:
    Pad(size=(20.0, 16.0), thickness=3.0, E=0.147, nu=0.3223, pitch=4.0, layers=3, material="mm, MPa")
    assert replace(pad(), E=210e9, material="steel").E == 210e9
    assert Layer(h=3.0, E=0.147, nu=0.45).h == Press(radius=3.0).radius == 3.0


def test_what_a_press_a_small_pull_and_noise_do_is_no_turned_depth() -> None:
    """A press raises the surface beside it; the same map upside down, far shallower, is what tack can do."""
    seen = depth()
    assert deep().estimate(motion(1)[:, :2], seen).resultant().value[2] < -0.9
    assert deep().estimate(-0.2 * motion(1)[:, :2], turned(-0.2)).resultant().value[2] > 0.1
    arrays.settled_depth(-1e-3, 2.9e-3, 3e-3)  # both: a tilt
    arrays.settled_depth(-2.99e-3, 0.0, 3e-3)
    noisy = 5e-5 * np.random.default_rng(0).standard_normal(2000)
    arrays.settled_depth(0.0, float(noisy.max()), 3e-5, 5e-5)
    with pytest.raises(InputError, match="pulls the surface out"):
        arrays.settled_depth(0.0, 4e-4, 3e-5, 5e-5)
    with pytest.raises(InputError, match=r"no depths.*not images of the markers"):
        arrays.settled_depth(0.0, 160.0, 3e-3)


def test_absolute_maps_are_taken_off_by_zero() -> None:
    seen = depth()
    here = DepthMap(20e-3 + seen.values, seen.pixel, seen.noise)
    flat = DepthMap(np.full_like(seen.values, 20e-3), seen.pixel, seen.noise)
    s = deep().zero([np.zeros((195, 2))] * 2, [flat] * 2)
    plain = deep().estimate(motion(1)[:, :2], seen)
    assert s.estimate(motion(1)[:, :2], here).load == pytest.approx(plain.load, abs=1e-6 * abs(plain.load).max())


def test_the_force_that_squashes_a_pad_is_that_of_the_layer() -> None:
    """Of a wide compressible pad: oedometric modulus times area; of a slender one E times area."""
    nu, E = 0.3, 1e5
    wide = E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) * 0.04
    assert arrays.squashed(E, nu, (0.2, 0.2), 1e-3) == pytest.approx(wide)
    assert arrays.squashed(E, 0.5, (1e-3, 1e-3), 0.1) == pytest.approx(E * 1e-6, rel=1e-4)
    f = nodal().sum(axis=0)
    assert f[2] == pytest.approx(-PRESS.force, rel=0.02)  # the press of the rig is far below
    assert arrays.squashed(147e3, 0.3223, (14e-3, 12e-3), 3e-3) > 10


RAGGED_AT: dict[str, Callable[[], Any]] = {
    "frame": lambda: sensor().estimate(RAGGED),
    "readings": lambda: sensor().readings(RAGGED),
    "stream": lambda: list(sensor().stream([RAGGED])),
    "zero": lambda: sensor().zero([RAGGED]),
    "calibrate": lambda: sensor().calibrate([RAGGED]),
    "reference": lambda: MarkerTracker(RAGGED),
    "eye": lambda: Eye(View.camera(**CAMERA), RAGGED, noise=0.02),
    "size of an eye": lambda: eye(size=RAGGED),
    "size": lambda: Pad(**{**GEL, "size": RAGGED}),
    "centre": lambda: DepthMap(MAP, 1e-4, 1e-5, RAGGED),
    "points": lambda: depth().at(RAGGED),
    "mask": lambda: outline.mask(RAGGED),
    "markers": lambda: Markers(RAGGED, NOISE),
    "wrench": lambda: Wrench(RAGGED),
}


@pytest.mark.parametrize("case", RAGGED_AT)
def test_rows_of_different_lengths_are_refused_in_words(case: str) -> None:
    with pytest.raises(InputError):
        RAGGED_AT[case]()
