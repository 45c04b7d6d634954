"""W611: a camera or a gel that moved as a whole is told from a load, and a load never taken for it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from structures import Flag
from tactile import Eye, GelForce, GelSlim, Layer, Markers, MultilayerPad, Press, View
from tactile._sensors.rigid import away

from .rigs import NOISE, markers, pad, sensor

Array = NDArray[np.float64]
LAYER = Layer(3e-3, 147e3, 0.3223)
PRESSES = [
    Press(at=(-3.5e-3, -2.5e-3), radius=1.3e-3, force=0.25, shear=(0.08, 0.03)),
    Press(at=(4e-3, 2.5e-3), radius=1.2e-3, force=0.4, shear=(-0.1, 0.1)),
    Press(at=(0.4e-3, -0.3e-3), radius=2.5e-3, force=1.0, shear=(0.25, 0.0)),
    Press(at=(-4e-3, 0.0), radius=1.5e-3, force=0.5, shear=(0.2, 0.0)),
]


def deep() -> Array:
    """Markers at two depths under the surface."""
    flat = markers(12, 10)
    return np.column_stack([flat, np.where(np.arange(len(flat)) % 2, 2.2e-3, 1.4e-3)])


def made(kind: str) -> tuple[Any, Array]:
    """A sensor and its markers."""
    if kind == "GelForce":
        x, y = np.meshgrid(np.linspace(-5e-3, 5e-3, 8), np.linspace(-4e-3, 4e-3, 7))
        places = np.column_stack([x.ravel(), y.ravel()])
        return GelForce(LAYER, places, Markers(deep(), NOISE, "XYZ"), choice=0.003), deep()
    if kind == "GelSlim":
        return GelSlim(pad(), Markers(markers(), NOISE, "XYZ")), markers()
    return sensor(0.005, "XY" if kind == "XY" else "XYZ"), markers()


def noisy(motion: Array, seed: int) -> Array:
    return motion + NOISE * np.random.default_rng(seed).standard_normal(motion.shape)


def slipped(places: Array, shift: tuple[float, float], turn: float = 0.0) -> Array:
    """Motion (N, 3) of an image that is shifted and turned."""
    x, y = places[:, :2].T
    return np.column_stack([shift[0] - turn * y, shift[1] + turn * x, np.zeros(len(places))])


def flags(found: Any) -> list[Flag]:
    return [f for f in found.flags if f.code == "LID-W611"]


@pytest.mark.parametrize("kind", ["XYZ", "XY", "GelSlim", "GelForce"])
@pytest.mark.parametrize("size", [5e-6, 18e-6, 71e-6])
def test_an_untouched_pad_that_slips_is_said_and_the_force_told(kind: str, size: float) -> None:
    s, places = made(kind)
    axes = len(s.markers.axes)
    y = noisy(slipped(places, (size, 0.0)), 1)[:, :axes]
    for found in (s.estimate(y), *s.stream([y])):
        (flag,) = flags(found)
        told = [float(v) for v in flag.message.split("together by (")[1].split(")")[0].split(", ")]
        assert told[0] == pytest.approx(1e6 * size, rel=0.2)
        force = float(flag.message.split("wrong by (")[1].split(",")[0])
        assert force == pytest.approx(found.resultant().value[0], rel=0.25)
        assert flag.evidence.value > flag.evidence.threshold


@pytest.mark.parametrize("kind", ["XYZ", "XY", "GelSlim", "GelForce"])
def test_rest_and_presses_are_clean(kind: str) -> None:
    s, places = made(kind)
    axes = len(s.markers.axes)
    still = np.zeros((len(places), 3))
    moved = [still, still, still, *(p.displacement(LAYER, places) for p in PRESSES)]
    assert not any(flags(s.estimate(noisy(u, k)[:, :axes])) for k, u in enumerate(moved))


@pytest.mark.parametrize("kind", ["XYZ", "GelSlim", "GelForce"])
def test_a_slip_beside_a_press_is_said(kind: str) -> None:
    s, places = made(kind)
    u = PRESSES[0].displacement(LAYER, places) + slipped(places, (18e-6, -18e-6))
    (flag,) = flags(s.estimate(noisy(u, 3)))
    told = [float(v) for v in flag.message.split("together by (")[1].split(")")[0].split(", ")]
    assert told == pytest.approx([18.0, -18.0], rel=0.35)


def test_a_lambda_that_is_chosen_on_the_frame_says_so_too() -> None:
    s = MultilayerPad(pad(), Markers(markers(9, 8), NOISE, "XYZ"), penalty="identity")
    y = noisy(slipped(markers(9, 8), (0.0, 30e-6)), 1)
    y[[5, 17]] = np.nan
    (flag,) = flags(s.estimate(y))
    assert "30" in flag.message or "29." in flag.message
    assert not flags(s.estimate(noisy(np.zeros((72, 3)), 1)))


def test_a_turn_is_said() -> None:
    (flag,) = flags(sensor(0.005).estimate(noisy(slipped(markers(), (0.0, 0.0), 3e-3), 1)))
    assert "turned by 0.17 degrees" in flag.message


def test_where_the_contact_reaches_all_markers_nothing_is_said() -> None:
    """A press of half the pad's width leaves no marker to tell from."""
    p = Press(at=(0.0, 0.0), radius=5e-3, force=3.0)
    y = noisy(p.displacement(LAYER, markers()) + slipped(markers(), (18e-6, 0.0)), 1)
    assert not flags(sensor(0.005).estimate(y))


def test_pixels_are_those_of_the_camera() -> None:
    view = View.homography(np.array([[14e3, 0, 320], [0, 14e3, 240], [0, 0, 1.0]]), alpha=0.0, gamma=1.4)
    eye = Eye(view, view.to_pixels(markers()), noise=NOISE * 14e3)
    assert eye.pixel == pytest.approx(1 / 14e3)
    s = MultilayerPad(pad(), eye=eye, choice=0.005, penalty="identity")
    (flag,) = flags(s.estimate(noisy(slipped(markers(), (1 / 14e3, 0.0)), 1)[:, :2]))
    assert "(1 px)" in flag.message


def test_chance_is_that_of_the_statistic() -> None:
    """Noise alone: the ratio over its threshold is an F variable at most, so at 1e-6 none of 100 frames is flagged."""
    places, rng = markers(), np.random.default_rng(0)
    noise, none = np.full((len(places), 2), NOISE), np.zeros(1, bool)  # no node is pressed
    for _ in range(100):
        motion = 3 * NOISE * rng.standard_normal((len(places), 2))  # and a stated noise that is too low
        assert away(motion, np.zeros_like, none, np.zeros((1, 2)), places, noise, 3e-3) is None
