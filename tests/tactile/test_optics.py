"""Pixels and places: round trips, Snell's law traced independently, the published correction, its refusal."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from structures._flags import codes
from structures.errors import InputError
from tactile import View
from tactile.vision._rays import Parallel, Window, projection_shift

from ..data import measured
from .scenes import camera

CORNERS_MM = np.array([[-5.0, 5], [5, 5], [-5, -5], [5, -5]])
CORNERS_PX = np.array([[90.0, 190], [90, 50], [230, 190], [230, 50]])  # point_correspondences.yaml of the gel


def test_the_shift_of_projection_has_the_published_values() -> None:
    assert projection_shift(1.0, np.radians(45), 1.4) == pytest.approx(0.58521, abs=5e-6)
    assert np.degrees(np.arctan(projection_shift(1.0, np.radians(45), 1.4))) == pytest.approx(30.336, abs=5e-4)
    assert projection_shift(2.0, 0.3, 1.0) == pytest.approx(2 * np.tan(0.3))
    assert projection_shift(2.0, 0.0, 1.4) == 0
    for bad in ({"alpha": np.pi / 2, "gamma": 1.4}, {"alpha": 0.1, "gamma": 0.9}):
        with pytest.raises(InputError):
            projection_shift(1.0, **bad)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(-0.6, 0.6), st.floats(-3, 3), st.floats(-3, 3), st.floats(1.0, 1.8), st.floats(0.005, 0.1),
    st.floats(0.0005, 0.02), st.integers(0, 1000),
)  # fmt: skip
def test_in_plane_undoes_to_pixels(
    tilt: float, azimuth: float, roll: float, gamma: float, distance: float, depth: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    view = View.camera(
        focal=800, centre=(300, 200), distance=distance, depth=depth, gamma=gamma, tilt=tilt, azimuth=azimuth, roll=roll
    )
    heights = rng.uniform(-0.4, 0.2, 30) * depth
    points = rng.uniform(-0.2, 0.2, (30, 2)) * (distance + depth)
    pixels = view.to_pixels(np.column_stack([points, heights]))
    np.testing.assert_allclose(view.in_plane(pixels, heights), points, atol=1e-9 * distance)
    np.testing.assert_allclose(view.to_pixels(view.to_pad(pixels)), pixels, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(view.to_pixels([[0.0, 0.0]]), [[300, 200]], atol=1e-8)


def test_a_ray_takes_the_shortest_time() -> None:
    window = Window((0.004, -0.002), 0.03, 0.009, 1.4)
    point, height = np.array([[0.011, 0.006]]), np.array([-0.0007])
    offset = point[0] - window.eye
    radius = np.hypot(*offset)

    def time(at: float) -> float:
        """Fermat: path outside, plus index times path inside, of a ray that meets the face at this distance."""
        return float(np.hypot(at, 0.03) + 1.4 * np.hypot(radius - at, 0.009 + height[0]))

    at = minimize_scalar(time, bounds=(0, radius), method="bounded", options={"xatol": 1e-12}).x
    expected = (radius - at) / (0.009 + height[0]) * offset / radius
    np.testing.assert_allclose(window.slope(point, height)[0], expected, rtol=1e-6)


def test_an_untilted_camera_keeps_right_and_down_and_the_scale_of_paraxial_rays() -> None:
    view = View.camera(focal=1000, centre=(320, 240), distance=0.03, depth=0.007, gamma=1.4)
    step = 1e-6
    moved = view.to_pixels([[step, 0], [0, step]]) - [320, 240]
    np.testing.assert_allclose(moved, np.eye(2) * 1000 * step / (0.03 + 0.007 / 1.4), atol=1e-9)


def test_small_depths_follow_the_formula_to_first_order() -> None:
    view = camera()
    rest = np.array([[0.0, 0.0], [0.004, -0.003], [-0.006, 0.005]])
    alpha = np.arctan(np.hypot(*view.image.window.direction(rest)[:, :2].T))
    assert alpha[0] == pytest.approx(0.25)
    errors = []
    for d in (4e-4, 2e-4, 1e-4):
        seen = view.to_pad(view.to_pixels(np.column_stack([rest, np.full(3, -d)])))
        shift = np.hypot(*(seen - rest).T)
        formula = projection_shift(d, alpha, 1.4)
        np.testing.assert_allclose(shift, formula, rtol=0.1)
        errors.append(np.abs(shift - formula))
    np.testing.assert_allclose(errors[0] / errors[1], 4, rtol=0.1)  # the rest is of second order
    np.testing.assert_allclose(errors[1] / errors[2], 4, rtol=0.1)


def test_parallel_rays_shift_by_the_formula_exactly_and_along_them() -> None:
    view = View.homography(np.diag([14e3, 14e3, 1]), alpha=np.radians(45), gamma=1.4, azimuth=np.pi / 2)
    pressed = view.to_pixels([[0.001, 0.002, -1e-3]])
    np.testing.assert_allclose(view.to_pad(pressed), [[0.001, 0.002 + 0.58521e-3]], atol=1e-8)
    np.testing.assert_allclose(view.motion(view.to_pixels([[0.001, 0.002]]), pressed, -1e-3), 0, atol=1e-15)


def test_a_flat_press_tells_the_rays_and_their_sign() -> None:
    true = Parallel(0.5, 1.4, azimuth=-2.0)
    rng = np.random.default_rng(0)
    normal = -rng.uniform(1e-4, 3e-4, 80)
    apparent = -normal[:, None] * true.slope(np.zeros((80, 2)), normal) + 2e-6 * rng.standard_normal((80, 2))
    apparent[3] = np.nan
    found = Parallel.from_press(apparent, normal, 1.4)
    assert found.alpha == pytest.approx(0.5, abs=0.01)
    assert found.azimuth == pytest.approx(-2.0, abs=0.01)
    view = View(View.homography(np.diag([14e3, 14e3, 1])).image, found)
    at = view.to_pixels(np.zeros((80, 2)) + apparent)
    np.testing.assert_allclose(view.in_plane(at, normal)[normal < 0][10:], 0, atol=1.2e-5)
    with pytest.raises(InputError, match="without normal motion"):
        Parallel.from_press(apparent, 0.0, 1.4)
    with pytest.raises(InputError, match="no ray shows"):
        Parallel.from_press([[1.0, 0.0]], -0.1, 1.4)


def test_a_homography_with_a_lens_is_the_camera() -> None:
    rays = camera().rays
    points = np.random.default_rng(0).uniform(-0.008, 0.008, (40, 2))
    plain = View.fit(points, camera().to_pixels(points), window=rays)
    heights = np.full(40, -5e-4)
    pixels = camera().to_pixels(np.column_stack([points, heights]))
    # a homography does not know refraction: it bends straight lines by up to 20 um here, most of it in both frames
    np.testing.assert_allclose(plain.in_plane(pixels, heights), points, atol=2e-5)
    moved = plain.motion(camera().to_pixels(points), pixels, heights)
    np.testing.assert_allclose(moved, 0, atol=3e-6)
    assert np.abs(plain.to_pad(pixels) - points).max() > 1e-4


def test_the_measured_homography_and_its_points_agree() -> None:
    view = View.homography(np.load(measured("gelsight_dots", "homography.npy")), unit=1e-3)
    np.testing.assert_allclose(view.to_pixels(1e-3 * CORNERS_MM), CORNERS_PX, atol=1e-9)
    fitted = View.fit(1e-3 * CORNERS_MM, CORNERS_PX)
    pixels = np.random.default_rng(0).uniform(0, 320, (50, 2))
    np.testing.assert_allclose(fitted.to_pad(pixels), view.to_pad(pixels), atol=1e-12)
    np.testing.assert_allclose(view.to_pad([[160.0, 120.0 - 14]]), [[1e-3, 0]], atol=1e-15)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([1e-6, 1.0, 1e6]))
def test_a_fitted_homography_is_the_true_one_in_any_unit(seed: int, unit: float) -> None:
    rng = np.random.default_rng(seed)
    true = np.eye(3) + 0.2 * rng.standard_normal((3, 3))
    true[2, :2] *= 0.3
    points = rng.uniform(-1, 1, (7, 2))
    lifted = np.column_stack([points, np.ones(7)]) @ true.T
    if np.abs(lifted[:, 2]).min() < 0.2:
        return
    pixels = 300 * lifted[:, :2] / lifted[:, 2:]
    np.testing.assert_allclose(View.fit(unit * points, pixels).to_pad(pixels), unit * points, atol=1e-8 * unit)


def test_lost_markers_stay_lost() -> None:
    view, pixels = camera(), np.array([[100.0, 200], [np.nan, np.nan], [300, 100]])
    heights = np.array([0.0, -1e-4, np.nan])
    assert np.isnan(view.in_plane(pixels, heights)).all(axis=1).tolist() == [False, True, True]
    assert np.isnan(view.to_pixels(view.to_pad(pixels))[1]).all()
    assert view.to_pad(np.empty((0, 2))).shape == (0, 2)


def test_tangential_motion_is_refused_without_rays_or_normal_motion() -> None:
    bare, now = View.homography(np.diag([14e3, 14e3, 1])), [[20.0, 10.0]]
    for view, normal, word in ((bare, -1e-4, "viewing angle"), (camera(), None, "normal motion")):
        with pytest.raises(InputError, match=word) as refused:
            view.motion([[10.0, 10.0]], now, normal)
        assert refused.value.code == "LID-E603"
        apparent = view.motion([[10.0, 10.0]], now, normal, allow=["E603"])
        np.testing.assert_allclose(apparent, view.to_pad(now) - view.to_pad([[10.0, 10.0]]))
    with pytest.raises(InputError, match="E603"):
        bare.in_plane(now, -1e-4)
    np.testing.assert_allclose(bare.in_plane(now, 0.0), bare.to_pad(now))
    assert not bare.knows_rays
    assert camera().knows_rays
    camera().motion([[10.0, 10.0]], now, -1e-4)


def test_the_refusal_can_be_turned_into_a_flag() -> None:
    from tactile._guards import tangential

    flag = tangential(False, True, allow=["LID-E603"])
    assert flag is not None
    assert codes([flag]) == {"E603"}
    assert tangential(True, True) is None


@pytest.mark.parametrize(
    "make",
    [
        lambda: View.fit(np.zeros((3, 2)), np.zeros((3, 2))),
        lambda: View.fit([[0, 0], [1, 0], [2, 0], [0, 1]], [[0, 0], [1, 0], [2, 0], [0, 1]]),
        lambda: View.fit(np.zeros((4, 2)), np.zeros((4, 2))),
        lambda: View.homography(np.zeros((3, 3))),
        lambda: View.homography([[1, 2, 3], [2, 4, 6], [0, 0, 1]]),
        lambda: View.homography(np.eye(3), alpha=0.1),
        lambda: View.homography(np.eye(3), alpha=0.1, gamma=1.4, window=Window((0, 0), 1, 1)),
        lambda: Parallel(2.0),
        lambda: Window((0, 0), -1, 1),
        lambda: Window((0, 0), 1, -1),
        lambda: Window((0, 0), 1, 1, 0.5),
        lambda: camera().in_plane([[1, 2]], [1, 2, 3]),
        lambda: camera().to_pixels([[0.0, 0.0, -0.02]]),
        lambda: camera().to_pad([[0.0, 0.0, 0.0]]),
        lambda: camera().to_pad([[1e6, 1e6]]),
    ],
)
def test_what_is_no_view(make) -> None:
    with pytest.raises(InputError):
        make()
