"""Rendered images against what they should hold: area and centroid of a dot, blur, noise, perspective."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from structures.errors import InputError
from tactile import View
from tactile.vision._images import Scene, grid

from .scenes import camera

QUIET = {"noise": 0.0, "shading": 0.0, "background": 200.0, "dot": 0.0}


def moments(image: np.ndarray) -> tuple[float, np.ndarray]:
    """Area of the dark in px, and its centroid (x, y)."""
    dark = 1 - image / 200
    y, x = np.indices(image.shape)
    return float(dark.sum()), np.array([(x * dark).sum(), (y * dark).sum()]) / dark.sum()


@pytest.mark.parametrize("at", [(30.0, 25.0), (30.4, 24.7), (29.51, 25.5)])
def test_a_dot_has_its_area_and_its_centroid(at: tuple[float, float]) -> None:
    area, centre = moments(Scene(size=(50, 60), radius=7.0, blur=1.0, **QUIET).draw([at]))
    assert area == pytest.approx(np.pi * 7.0**2, rel=0.005)
    np.testing.assert_allclose(centre, at, atol=0.01)


def test_the_rim_is_that_of_a_blurred_disc() -> None:
    image = Scene(size=(50, 60), radius=9.0, blur=1.5, **QUIET).draw([[30.0, 25.0]])
    y, x = np.indices((450, 540))
    disc = np.hypot((x - 4) / 9 - 30, (y - 4) / 9 - 25) < 9  # nine by nine points in every pixel
    blurred = ndimage.gaussian_filter(disc.astype(float), 1.5 * 9)[4::9, 4::9]
    np.testing.assert_allclose(image / 200, 1 - blurred, atol=0.01)


def test_noise_and_seed() -> None:
    blank = Scene(size=(200, 200), noise=2.0, shading=0.0)
    one, same, other = (blank.draw(np.empty((0, 2)), seed=s).astype(float) for s in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert (one - other).std() == pytest.approx(np.sqrt(2) * np.hypot(2, 12**-0.5), rel=0.03)


def test_dots_beyond_the_border_or_lost_are_not_drawn() -> None:
    scene = Scene(size=(50, 60), **QUIET)
    np.testing.assert_array_equal(scene.draw([[-40.0, 10.0], [np.nan, 5.0]]), scene.draw(np.empty((0, 2))))
    assert moments(scene.draw([[0.0, 25.0]]))[0] == pytest.approx(
        0.5 * moments(scene.draw([[30.0, 25.0]]))[0], rel=0.15
    )


def test_a_photograph_through_a_plain_view_is_the_drawing() -> None:
    view = View.homography([[1e4, 0, 30], [0, 1e4, 25], [0, 0, 1]])
    dots = grid(1, 2, 2e-3)
    photograph = Scene(size=(50, 60), radius=6e-4, **QUIET).photograph(view, dots)
    drawing = Scene(size=(50, 60), radius=6.0, **QUIET).draw(view.to_pixels(dots))
    np.testing.assert_allclose(photograph.astype(int), drawing, atol=1)


def test_perspective_makes_near_dots_larger_and_a_press_moves_them_along_their_rays() -> None:
    view = camera()
    ends = np.array([[-0.009, -0.006], [0.009, 0.006]])
    scene = Scene(radius=4e-4, **QUIET)
    areas = [moments(scene.photograph(view, ends[k : k + 1]))[0] for k in (0, 1)]
    centre = [moments(scene.photograph(view, ends[k : k + 1]))[1] for k in (0, 1)]
    np.testing.assert_allclose(
        centre, view.to_pixels(ends), atol=0.15
    )  # a projected disc is not quite about its centre
    assert areas[0] > 1.2 * areas[1]
    step = 1e-6
    for k in (0, 1):  # the area is that of the Jacobian of the view
        around = view.to_pixels(ends[k] + step * np.array([[0, 0], [1, 0], [0, 1]]))
        jacobian = np.linalg.det((around[1:] - around[0]) / step)
        assert areas[k] == pytest.approx(np.pi * (4e-4) ** 2 * jacobian, rel=0.02)
    low = np.array([[0.009, 0.006, -1e-3]])
    np.testing.assert_allclose(moments(scene.photograph(view, low))[1], view.to_pixels(low)[0], atol=0.15)
    assert np.hypot(*(view.to_pixels(low)[0] - view.to_pixels(ends[1:])[0])) > 4


def test_what_is_no_scene() -> None:
    for bad in ({"radius": 0.0}, {"blur": -1.0}, {"noise": -1.0}):
        with pytest.raises(InputError):
            Scene(**bad)
    with pytest.raises(InputError, match="no places"):
        Scene().draw(np.zeros((3, 4)))
