"""Markers followed through motion, loss and return, against the places at which they are."""

from __future__ import annotations

import numpy as np
import pytest

from structures._flags import codes
from structures.errors import InputError
from tactile import frames
from tactile._results.film import overlay
from tactile.vision import Detector, MarkerTracker, jitter
from tactile.vision._frames import read_image
from tactile.vision._images import Scene

from ..data import measured
from .scenes import PITCH, pattern, pressed


def swapped(places: np.ndarray, truth: np.ndarray) -> int:
    """Markers that are reported nearer to another marker's place than to their own."""
    seen = np.isfinite(places[:, 0])
    distance = np.hypot(*np.moveaxis(places[seen][:, None] - truth[None], -1, 0))
    return int((np.argmin(distance, axis=1) != np.flatnonzero(seen)).sum())


def test_a_rendered_clip_that_loses_a_tenth_of_its_dots() -> None:
    rest, rng, scene = pattern(), np.random.default_rng(2), Scene()
    gone = rng.random(len(rest)) < 0.1
    tracker = MarkerTracker(scene.draw(rest, seed=rng), radius=5, pitch=PITCH)
    order = np.argmin(np.hypot(*np.moveaxis(tracker.points[:, None] - rest[None], -1, 0)), axis=1)
    rest, gone, first = rest[order], gone[order], None
    for k in range(1, 13):
        truth = pressed(rest, 0.6 * k, 1.5 * k)
        lost = gone & (4 <= k < 9)
        motion = tracker.step(scene.draw(truth[~lost], seed=rng))
        np.testing.assert_array_equal(motion.tracked, ~lost)
        assert motion.lost.sum() == lost.sum()
        assert np.isnan(motion.moved[lost]).all()
        assert np.abs(motion.places[~lost] - truth[~lost]).max() < 0.3
        assert np.sqrt(np.mean((motion.places - truth)[~lost] ** 2)) < 0.05
        assert ("W604" in codes(motion.flags)) == bool(lost.any())
        assert motion.frame == k
        first = first or motion
    np.testing.assert_array_equal(first.points, tracker.points)


@pytest.mark.parametrize("seed", range(3))
def test_no_marker_takes_the_place_of_another(seed: int) -> None:
    rng, rest = np.random.default_rng(seed), pattern(seed)
    tracker = MarkerTracker(rest)
    shift, gone = np.zeros(2), np.zeros(len(rest), bool)
    for k in range(40):
        angle = rng.uniform(0, 2 * np.pi)
        shift += rng.uniform(0, 0.42) * PITCH * np.array([np.cos(angle), np.sin(angle)])
        gone = rng.random(len(rest)) < 0.1 if k == 10 else gone & (k < 30)
        truth = pressed(rest, 6 * np.sin(k / 6)) + shift
        dots = (truth + 0.05 * rng.standard_normal(truth.shape))[~gone]
        motion = tracker.step(rng.permutation(dots))
        assert swapped(motion.places, truth) == 0
        assert motion.unmatched == motion.rejected.sum() == 0
        np.testing.assert_array_equal(motion.lost, gone)


def test_a_hidden_part_of_a_moving_pattern_is_found_again() -> None:
    rng, rest = np.random.default_rng(5), pattern(5)
    tracker, shift = MarkerTracker(rest), np.zeros(2)
    hidden = np.hypot(*(rest - [280.0, 200.0]).T) < 4.2 * PITCH
    assert hidden.sum() > 40
    for k in range(36):
        shift += rng.uniform(-0.25, 0.25, 2) * PITCH
        truth = pressed(rest, 10 * np.sin(k / 8), 6 * np.sin(k / 5)) + shift
        gone = hidden & (8 <= k < 28)
        motion = tracker.step((truth + 0.03 * rng.standard_normal(truth.shape))[~gone])
        assert swapped(motion.places, truth) == 0
        assert motion.tracked[~hidden].all()
    assert motion.tracked.all()


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 4, 2.0])
def test_a_motion_of_nearly_half_a_pitch_is_followed(angle: float) -> None:
    rest = pattern()
    step = 0.47 * MarkerTracker(rest).pitch
    truth = rest + step * np.array([np.cos(angle), np.sin(angle)])
    motion = MarkerTracker(rest).step(truth)
    assert motion.tracked.all()
    np.testing.assert_allclose(motion.places, truth)
    assert motion.flags == ()


def test_a_leap_is_said_and_stays_said() -> None:
    rest = pattern()
    tracker = MarkerTracker(rest)
    truth = rest + 0.6 * PITCH * np.array([1, 1]) / np.sqrt(2)
    assert "W604" in codes(tracker.step(truth).flags)
    later = tracker.step(truth)
    assert any("frame 1" in flag.message for flag in later.flags)
    tracker.zero([truth, truth])
    assert tracker.step(truth).flags == ()


def test_a_dot_that_moves_unlike_its_neighbours_is_refused_and_only_it() -> None:
    rest = pattern()
    truth = rest.copy()
    truth[[100, 333, 402]] += PITCH * np.array([[0.48, 0.3], [-0.5, 0.2], [0.0, -0.44]])
    motion = MarkerTracker(rest).step(truth)
    np.testing.assert_array_equal(np.flatnonzero(~motion.tracked), [100, 333, 402])
    np.testing.assert_allclose(motion.moved[motion.tracked], 0, atol=1e-12)


def test_a_speck_that_wanders_off_is_let_go_and_no_stranger_is_taken_for_a_lost_marker() -> None:
    rest = pattern()
    tracker = MarkerTracker(rest)
    seen = []
    for k in range(1, 9):
        truth = rest + k
        truth[250] += [0.1 * k * PITCH, 0.02 * k * PITCH]  # never far in one frame
        seen.append(tracker.step(truth).tracked[250])
    assert seen[:4] == [True] * 4
    assert not any(seen[5:])
    gone = np.delete(rest + 9, 77, axis=0)
    assert tracker.step(gone).lost[77]
    stranger = np.vstack([gone, rest[77] + 10 + [0.3 * PITCH, 0]])
    assert tracker.step(stranger).rejected[77]
    assert tracker.step(rest + 11).tracked[77]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_quick_motion_under_a_press_swaps_none_though_half_the_dots_vanish(seed: int, share: float) -> None:
    rng, rest = np.random.default_rng(seed), pattern(seed)
    angle = rng.uniform(0, 2 * np.pi)
    truth = pressed(rest, 6.0) + 0.44 * PITCH * np.array([np.cos(angle), np.sin(angle)])
    gone = rng.random(len(rest)) < share
    tracker = MarkerTracker(rest)
    motion = tracker.step(truth[~gone])
    assert swapped(motion.places, truth) == 0
    far = np.hypot(*(truth - rest).T) > 0.48 * tracker.pitch  # more than half a pitch is refused
    assert motion.tracked[~gone & ~far].mean() > 0.99
    assert not motion.tracked[gone].any()


def test_an_empty_frame_loses_all_and_the_next_finds_them_again() -> None:
    scene, rest = Scene(), pattern()
    tracker = MarkerTracker(scene.draw(rest), detector=Detector(5, PITCH))
    assert tracker.step(np.full((480, 640), 120, np.uint8)).lost.all()
    assert tracker.step(scene.draw(rest + np.array([3.0, -2.0]))).tracked.all()


def test_zero_takes_the_mean_of_unloaded_frames_as_rest() -> None:
    rest, rng = pattern(), np.random.default_rng(0)
    tracker = MarkerTracker(rest)
    moved = rest + np.array([2.0, 1.0])
    noisy = [moved + 0.1 * rng.standard_normal(rest.shape) for _ in range(16)]
    noisy[3][7] = np.nan
    for frame in noisy:
        frame[11] = np.nan
    tracker.zero(noisy)
    assert np.abs(tracker.points[np.arange(520) != 11] - moved[np.arange(520) != 11]).max() < 0.15
    motion = tracker.step(moved)
    assert np.flatnonzero(motion.lost).tolist() == [11]  # it has no place at rest
    assert np.nanmax(np.abs(motion.moved)) < 0.15
    tracker.zero()
    np.testing.assert_allclose(tracker.step(moved).moved, 0, atol=1e-12)
    with pytest.raises(InputError, match="too few markers"):
        tracker.zero([np.empty((0, 2))])


def test_the_noise_floor_is_that_of_the_places() -> None:
    rest, rng = pattern(), np.random.default_rng(1)
    drift = np.linspace(0, 1, 12)[:, None, None] * [0.3, 0.0]
    places = rest + drift + rng.standard_normal((12, 520, 2)) * [0.03, 0.06]
    places[5, :40] = np.nan
    places[7, 100:110] += 5.0
    floor = MarkerTracker(rest).jitter(places)
    np.testing.assert_allclose(floor.std, [0.03, 0.06], rtol=0.08)
    np.testing.assert_allclose(floor.drift, [0.3, 0.0], atol=0.02)
    assert floor.flags == ()
    assert floor.frames == 12
    assert np.median(floor.per_marker[:, 1]) == pytest.approx(0.06, rel=0.1)


def test_frames_that_a_codec_froze_give_no_noise_level() -> None:
    scene, rest = Scene(), pattern()
    image = scene.draw(rest)
    tracker = MarkerTracker(image, radius=5, pitch=PITCH)
    assert codes(tracker.jitter([image, image, image, scene.draw(rest, seed=3)]).flags) == {"W406"}
    assert tracker.jitter([scene.draw(rest, seed=k) for k in range(4)]).flags == ()
    with pytest.raises(InputError, match="too few frames"):
        jitter(np.zeros((2, 5, 2)))
    with pytest.raises(InputError, match="no marker is seen"):
        jitter(np.full((4, 5, 2), np.nan))


def test_the_measured_press_is_followed_from_the_unloaded_gel() -> None:
    image = read_image(measured("gelsight_dots", "cuboid_10-2-284.png"))
    tracker = MarkerTracker(next(frames(measured("gelsight_dots", "nocontact.npz"))))
    motion = tracker.step(image)
    assert motion.tracked.sum() == 63
    assert motion.flags == ()
    assert 2 < np.hypot(*motion.moved.T).min() < np.hypot(*motion.moved.T).max() < 0.5 * tracker.pitch
    assert len(overlay(image, motion).axes) == 1


def test_too_few_markers_and_frames_of_another_size_are_refused() -> None:
    with pytest.raises(InputError, match="too few markers"):
        MarkerTracker(pattern()[:2])
    image = Scene().draw(pattern()[[5, 300]])
    with pytest.raises(InputError, match="too few markers"):
        MarkerTracker(image, radius=5, pitch=PITCH)
    tracker = MarkerTracker(Scene().draw(pattern()), radius=5, pitch=PITCH)
    with pytest.raises(InputError, match="another size") as error:
        tracker.step(np.zeros((240, 320), np.uint8))
    assert "frame 1" in str(error.value)


def test_what_the_picture_shows_is_counted_in_its_title() -> None:
    rest = pattern()
    tracker = MarkerTracker(rest)
    motion = tracker.step(np.delete(rest, [3, 4], axis=0))
    title = overlay(np.zeros((480, 640), np.uint8), motion).axes[0].get_title(loc="left")
    assert "518 of 520 markers, 2 lost" in title
