"""Dots against the places at which they were drawn, and against the printed dots of measured images."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from structures.errors import InputError
from tactile import frames
from tactile._results.film import overlay
from tactile.vision import Detector, detect, size_of_dots
from tactile.vision._frames import read_image
from tactile.vision._images import Scene, grid, installed

from ..data import measured
from .scenes import PITCH, camera, errors, pattern, pressed

BACKENDS = [
    pytest.param("cv2", marks=pytest.mark.skipif(not installed(), reason="OpenCV is not installed (extra vision)")),
    "scipy",
]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("method", ["parabola", "centroid"])
def test_dots_of_a_pressed_pad_are_found_to_a_few_hundredths_of_a_pixel(backend: str, method: str) -> None:
    truth = pressed(pattern(), 5.0, 4.0)
    found = detect(Scene().draw(truth), method=method, backend=backend)
    assert np.sqrt(np.mean(errors(found.points, truth) ** 2)) < 0.025


def test_perspective_and_refraction_leave_the_error_below_four_hundredths() -> None:
    view, dots = camera(), grid(20, 26, 0.8e-3)
    near = np.exp(-0.5 * (dots**2).sum(axis=1) / 2.5e-3**2)
    lowered = np.column_stack([dots + 1e-4 * near[:, None], -3e-4 * near])
    image = Scene(radius=0.2e-3, noise=2.0, blur=1.2).photograph(view, lowered, seed=1)
    assert np.sqrt(np.mean(errors(detect(image).points, view.to_pixels(lowered)) ** 2)) <= 0.04


@pytest.mark.skipif(not installed(), reason="OpenCV is not installed (extra vision)")
@pytest.mark.parametrize("radius", [2.2, 5.0, 8.0])
def test_both_backends_find_the_same_dots(radius: float) -> None:
    image = Scene(radius=radius, noise=3.0).draw(pressed(pattern(), 4.0))
    for method in ("parabola", "centroid"):
        one, other = (Detector(radius, PITCH, method=method, backend=name)(image) for name in ("cv2", "scipy"))
        np.testing.assert_allclose(one.points, other.points, atol=0.02)
        np.testing.assert_allclose(one.strength, other.strength, rtol=1e-3)


def test_bright_dots_are_dark_dots_of_the_negative() -> None:
    image = Scene().draw(pattern())
    dark, bright = detect(image, radius=5, pitch=PITCH), detect(255 - image, radius=5, pitch=PITCH, dark=False)
    np.testing.assert_allclose(dark.points, bright.points, atol=1e-3)
    wrong = detect(image, radius=5, pitch=PITCH, dark=False).points  # what lies between the dots, but no dot
    assert len(wrong) == 0 or cKDTree(pattern()).query(wrong)[0].min() > 5


@pytest.mark.parametrize("radius", [3.0, 5.0, 7.5])
def test_the_size_of_the_dots_is_found(radius: float) -> None:
    r, pitch = size_of_dots(Scene(radius=radius).draw(pattern()))
    assert r == pytest.approx(radius, rel=0.12)
    assert pitch == pytest.approx(PITCH, rel=0.06)  # the nearest neighbour of a wobbling grid is a little nearer


def test_a_shift_of_the_light_moves_no_dot() -> None:
    truth = pattern()
    even, uneven = (detect(Scene(noise=0.0, shading=s).draw(truth), radius=5, pitch=PITCH) for s in (0.0, 50.0))
    np.testing.assert_allclose(errors(even.points, truth), errors(uneven.points, truth), atol=0.06)


def test_a_darker_image_holds_the_same_dots() -> None:
    truth = pattern()
    image = Scene(noise=0.0).draw(truth)
    bright, dim = (detect(x, radius=5, pitch=PITCH).points for x in (image, (0.5 * image).astype(np.uint8)))
    np.testing.assert_allclose(errors(bright, truth), errors(dim, truth), atol=0.05)  # whole grey levels


def test_noise_alone_holds_no_dots() -> None:
    blank = Scene(noise=4.0).draw(np.empty((0, 2)))
    assert len(Detector(5, PITCH)(blank).points) == 0
    with pytest.raises(InputError, match="no dots stand out"):
        detect(blank)
    with pytest.raises(InputError, match="no dots stand out"):
        detect(np.full((120, 160), 90, np.uint8))


def test_few_dots_are_found_as_well_as_many() -> None:
    truth = pattern()[[3, 180, 333, 500]]
    found = detect(Scene().draw(truth), radius=5, pitch=PITCH)
    assert np.abs(errors(found.points, truth)).max() < 0.1


def test_a_dot_that_the_border_cuts_is_left_out() -> None:
    truth = np.array([[4.0, 100.0], [8.0, 160.0], [60.0, 100.0], [60.0, 160.0], [120.0, 100.0]])
    image = Scene(size=(240, 320)).draw(truth)
    assert np.abs(errors(detect(image, radius=5, pitch=50).points, truth[1:])).max() < 0.1
    errors(detect(image, radius=5, pitch=50, margin=10).points, truth[2:])


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"radius": 5, "pitch": 8}, "overlap"),
        ({"radius": -1, "pitch": 8}, "positive"),
        ({"radius": 3, "pitch": 9, "method": "guess"}, "unknown method"),
        ({"radius": 3, "pitch": 9, "backend": "matlab"}, "unknown image backend"),
    ],
)
def test_settings_that_are_none(settings: dict, match: str) -> None:
    with pytest.raises(InputError, match=match):
        detect(np.zeros((50, 50), np.uint8), **settings)


@pytest.mark.parametrize(
    ("image", "match"),
    [
        (np.zeros((4, 50), np.uint8), "no image"),
        (np.zeros((50, 50, 2), np.uint8), "no image"),
        (np.full((50, 50), np.nan), "NaN"),
        (np.full((50, 50), 300.0), "out of range"),
        (np.array([["a"] * 20] * 20), "no numbers"),
    ],
)
def test_what_is_no_image(image: np.ndarray, match: str) -> None:
    with pytest.raises(InputError, match=match):
        detect(image, radius=3, pitch=9)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", ["nocontact.npz", "cuboid_10-2-284.png"])
def test_all_63_printed_dots_of_a_measured_gel_and_no_other(name: str, backend: str, tmp_path) -> None:
    path = measured("gelsight_dots", name)
    image = next(frames(path)) if path.suffix == ".npz" else read_image(path)
    found = detect(image, backend=backend)
    rows = np.sort(found.points[:, 1]).reshape(7, 9)  # fails unless there are 63
    assert (np.ptp(rows, axis=1) < 8).all()
    assert (np.diff(rows.mean(axis=1)) > 28).all()
    for low, high in zip(rows[:, 0], rows[:, -1], strict=True):
        x = np.sort(found.points[(found.points[:, 1] >= low) & (found.points[:, 1] <= high), 0])
        assert len(x) == 9
        assert (np.diff(x) > 26).all()
        assert (np.diff(x) < 42).all()
    overlay(image, found, title=name).savefig(tmp_path / "overlay.png", dpi=40)
    assert (tmp_path / "overlay.png").stat().st_size > 10_000
