"""A sensor that goes on running: its maps, its queues, its zero, its friction, and what it says."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from structures.errors import InputError
from tactile import Press
from tactile._results.forcemap import Contact, ForceMap, Vector
from tactile._sensors.linear import LinearSensor
from tactile.live import Friction, Live, LiveEvent, LiveFrame
from tactile.live._events import EventWatch
from tactile.live._loop import Waiting
from tactile.live._slip import SlipWatch, slip_map
from tactile.live._zero import Rest

from .rigs import NOISE, PRESS, fresh, markers, motion, moved_by, pad, sensor

RATE = 60.0
Array = np.ndarray

NOTHING = Vector(np.zeros(3), np.zeros(3), "N")


def noisy(u: Any, rng: np.random.Generator) -> Array:
    return np.asarray(u) + NOISE * rng.standard_normal((len(markers()), 3))


def resting(count: int, seed: int = 0, at: Any = 0.0) -> list[Array]:
    rng = np.random.default_rng(seed)
    return [noisy(at, rng) for _ in range(count)]


def run(source: Any, **settings: Any) -> tuple[Live, list[LiveFrame]]:
    live = Live(settings.pop("sensor", None) or fresh(), source, **{"rate": RATE, **settings})
    return live, list(live)


def said(found: Sequence[LiveFrame], kind: str) -> list[str]:
    return [event.state for frame in found for event in frame.events if event.kind == kind]


# -- maps and queues --------------------------------------------------------------------------------------------------
def test_maps_are_those_of_the_sensor() -> None:
    frames = [*resting(5), *(motion(k) for k in range(5))]
    live, found = run(frames, quiet=None)
    alone = sensor()
    assert [f.number for f in found] == list(range(1, 11))
    assert [f.time for f in found] == pytest.approx(np.arange(10) / RATE)
    for frame, u in zip(found, frames, strict=True):
        assert np.array_equal(frame.map.load, alone.estimate(u).load)
        assert np.array_equal(frame.motion, u)
    assert [f.touched for f in found] == [False] * 5 + [True] * 5
    assert live.counts["maps"] == live.counts["frames"] == 10
    assert live.counts["dropped"] == 0
    assert all(f.latency.total > 0 and f.latency.map > 0 for f in found)
    assert live.latency(1.0).map >= live.latency(0.5).map > 0
    assert live.ages(1.0) == pytest.approx(max(f.latency.total for f in found))


def test_what_maps_need_is_built_before_the_first_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    ready = LinearSensor.prepare

    def prepare(self: LinearSensor) -> None:
        ready(self)
        order.append("ready")

    def source() -> Iterator[Array]:
        for u in resting(2):
            order.append("frame")
            yield u

    monkeypatch.setattr(LinearSensor, "prepare", prepare)
    run(source(), quiet=None)
    assert order == ["ready", "frame", "frame"]


def test_dead_frames_are_counted_and_said_once() -> None:
    lost = np.full((len(markers()), 3), np.nan)
    frames = [*resting(4), None, lost, None, *resting(4)]
    told: list[LiveEvent] = []
    live, found = run(frames, quiet=None, told=told.append)
    assert [f.number for f in found] == [1, 2, 3, 4, 8, 9, 10, 11]
    assert live.counts["dead"] == 3
    assert [(e.kind, e.state, e.number) for e in told] == [("no image", "begins", 5), ("no image", "ends", 8)]
    assert found[4].events == tuple(told)
    assert "W604" in found[4].map.codes
    assert "frames 5, 6, 7" in next(f.message for f in found[4].map.flags if f.code == "LID-W604")
    assert "W604" not in found[5].map.codes


def test_a_source_of_dead_frames_ends_in_the_error_of_the_first() -> None:
    with pytest.raises(InputError, match="no image"):
        run([None, None])


def test_an_error_comes_after_the_maps_before_it() -> None:
    def broken() -> Iterator[Any]:
        yield from resting(3)
        raise InputError("the cable is out", where="frame 4")

    live = Live(fresh(), broken(), rate=RATE)
    assert [next(live).number for _ in range(3)] == [1, 2, 3]
    with pytest.raises(InputError, match="the cable is out"):
        next(live)
    with pytest.raises(InputError, match="has no eye"):
        run([np.zeros((48, 64), np.uint8)])


def test_a_queue_drops_the_oldest_or_waits() -> None:
    camera, file = Waiting[int](2, drop=True), Waiting[int](2, drop=False)
    for k in range(5):
        assert camera.put(k)
    assert [camera.take(), camera.take(), camera.dropped] == [3, 4, 3]
    giver = threading.Thread(target=lambda: [file.put(k) for k in range(5)], daemon=True)
    giver.start()
    assert [file.take() for _ in range(5)] == list(range(5))
    giver.join(5)
    file.put(7)
    file.end()
    assert not file.put(8)
    assert [file.take(), file.take(), file.dropped] == [7, None, 0]


@pytest.mark.parametrize("drop", [True, False])
def test_a_slow_consumer_loses_the_oldest_of_a_camera_and_nothing_of_a_file(drop: bool) -> None:
    live = Live(fresh(), resting(40), rate=RATE, drop=drop)
    found = []
    for frame in live:
        found.append(frame.number)
        time.sleep(0.02)
    assert found == sorted(found)
    assert len(found) + live.counts["dropped"] == 40
    assert (live.counts["dropped"] > 0) is drop
    assert found[-1] == 40


def test_it_can_be_left_and_closed() -> None:
    with Live(fresh(), (motion(0) for _ in range(10**9)), rate=RATE) as live:
        next(live)
    live.close()
    assert not [t for t in threading.enumerate() if t.name.startswith("tactile")]


def test_a_camera_that_was_gone_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    from tactile.live import _loop

    pictures = [np.full((16, 16), 100, np.uint8)] * 2
    opened: list[int] = []  # reads without a picture, of every camera

    class Camera:
        def __init__(self) -> None:
            opened.append(0)
            self.left, self.which = list(pictures), len(opened) - 1

        def isOpened(self) -> bool:
            return len(opened) != 2  # the second time it is not back yet

        def get(self, what: str) -> float:
            return 0.0

        def read(self) -> tuple[bool, Any]:
            time.sleep(0.01)  # a camera takes its time
            opened[self.which] += not self.left
            return (True, self.left.pop()) if self.left else (False, None)

        def release(self) -> None:
            pass

    named = {f"CAP_PROP_{n}": n for n in ("FRAME_COUNT", "POS_MSEC", "FOURCC")}
    fake = SimpleNamespace(**named, VideoCapture=lambda which: Camera())
    monkeypatch.setattr(sys.modules["tactile.vision._frames"], "opencv", lambda: fake)
    monkeypatch.setattr(sys.modules["tactile.vision._frames"], "installed", lambda: True)
    monkeypatch.setattr(_loop, "AGAIN", 0.01)
    here = fresh()
    here.eye = SimpleNamespace(read=lambda frame, depth: (motion(0), []), tracker=SimpleNamespace(detector=None))  # type: ignore[assignment]
    here.eye.pixel = 1e-4  # type: ignore[union-attr,misc]
    with Live(here, 0) as live:
        assert live._live
        found = [next(live)]
        while "ends" not in said(found, "no image"):  # how many frames that takes is the machine's affair
            found.append(next(live))
    assert len(opened) >= 3
    assert [f.number for f in found] == sorted(f.number for f in found)
    assert opened[:2] == [10, 0]  # reads that failed until it is gone; not asked where it is not back
    # nine of them and the word that it is gone: a machine that is busy drops some
    assert live.counts["dead"] + live.counts["dropped"] >= 10
    assert live.counts["dead"] > 0
    assert said(found, "no image") == ["begins", "ends"]
    assert abs(found[0].time - time.time()) < 60  # the clock of this machine


# -- zero -------------------------------------------------------------------------------------------------------------
def seen_by_a_camera_that_moved() -> Array:
    """Motion of all markers by a camera that shifted, turned and tilted."""
    x, y = (markers() / 7e-3).T
    plane = [30e-6 + 4e-6 * y + 6e-6 * x * x - 3e-6 * x * y, -20e-6 - 4e-6 * x + 6e-6 * x * y - 3e-6 * y * y]
    return np.column_stack([*plane, np.zeros_like(x)])


def test_a_quiet_time_takes_what_a_camera_did_and_the_next_touch_is_as_before() -> None:
    moved, here = seen_by_a_camera_that_moved(), fresh()
    frames = [*resting(30), *resting(130, 1, moved), *resting(20, 2, moved + motion())]
    live, found = run(frames, quiet=1.0, sensor=here)
    (zeroed,) = [e for f in found for e in f.events if e.kind == "zeroed" and e.state == "once"][:1]
    assert zeroed.time > 30 / RATE
    assert "um rms" in zeroed.text
    assert said(found, "camera moved") == ["begins", "ends"]
    assert live.counts["zeros"] >= 1
    touched = found[-5:]
    assert all(f.touched for f in touched)
    like = sensor().estimate(motion())
    for frame in touched:
        assert np.linalg.norm(frame.map.resultant().value - like.resultant().value) < 5e-3
        apart = np.linalg.norm(frame.map.load - like.load) / np.linalg.norm(like.load)
        assert apart < 0.12  # what the noise of a frame does to a map
    alone = sensor().estimate(noisy(motion(), np.random.default_rng(3)))
    assert apart < 1.3 * np.linalg.norm(alone.load - like.load) / np.linalg.norm(like.load)


def test_a_load_does_not_end_what_a_camera_did_and_teaches_no_friction() -> None:
    moved = seen_by_a_camera_that_moved()
    live, found = run([*resting(10), *resting(10, 1, moved), *(moved + u for u in sliding_frames(0.4, 40))], quiet=1.0)
    assert said(found, "camera moved") == ["begins"]
    assert "camera moved" in found[-1].on
    assert live.friction is None


def test_a_step_within_the_noise_is_not_said() -> None:
    live, found = run(resting(400), quiet=1.0)
    assert live.counts["zeros"] == 6
    assert said(found, "zeroed") == []
    assert np.abs(live.sensor.offset).max() < 5 * NOISE / np.sqrt(60)


@pytest.mark.parametrize("force", [0.02, 0.2])
def test_a_load_is_never_zeroed(force: float) -> None:
    """Held for a long time, and grown so slowly that no quiet time sees it grow."""
    press = moved_by(Press(at=PRESS.at, radius=PRESS.radius, force=1.0))
    grown = [noisy(force * min(k / 2000, 1.0) * press, np.random.default_rng(k)) for k in range(2400)]
    here = fresh()
    watch = Rest(here, 0.5)
    for k, u in enumerate(grown):
        watch.update(k, k / RATE, u.ravel())
    found = [here.estimate(u).resultant().value[2] for u in grown[-60:]]
    assert np.mean(found) == pytest.approx(-force, abs=0.008)
    assert watch.touched


def test_a_quiet_time_needs_its_markers_and_no_pause() -> None:
    here = fresh()
    watch = Rest(here, 1.0)
    for share, score in ((0.6, np.inf), (0.2, 6.0)):  # too few to tell; and a hand, under which anything may be
        part = resting(1)[0]
        part[: int(share * len(part))] = np.nan
        assert all(watch.update(k, k / RATE, part.ravel(), hidden=True) is None for k in range(100))
        assert watch.score <= score
        assert watch.touched is (score == np.inf)
    assert np.all(here.offset == 0)
    worn = Rest(fresh(), 1.0)
    steps = [worn.update(k, k / RATE, part.ravel()) for k in range(100)]
    assert [s.frames for s in steps if s is not None] == [61]  # dots that are worn off are no hand
    for k, u in enumerate(resting(100)):
        assert watch.update(k, 2.0 * k, u.ravel()) is None  # two seconds between frames: who knows what was
    few = resting(100, 4)
    for u in few:
        u[3] = np.nan  # a marker that is always lost keeps its zero
    steps = [watch.update(k, 500 + k / RATE, u.ravel()) for k, u in enumerate(few)]
    (step,) = [s for s in steps if s is not None]
    assert step.frames == 61
    assert not step.told
    assert step.expected == pytest.approx(NOISE * np.sqrt(1 / 61 + 1), rel=1e-6)
    assert np.all(here.offset.reshape(-1, 3)[3] == 0)
    assert here.offset.reshape(-1, 3)[4] == pytest.approx(np.mean([u[4] for u in few[:61]], axis=0), rel=1e-9)


def test_no_zero_is_taken_under_a_hand() -> None:
    covered = resting(200, 1)
    for u in covered:
        u[markers()[:, 0] > 2e-3] = np.nan
    live, found = run([*resting(20), *covered], quiet=0.5)
    assert said(found, "covered") == ["begins"]
    assert live.counts["zeros"] == 0
    assert not found[-1].touched


def test_a_camera_that_still_moves_is_not_quiet() -> None:
    watch = Rest(fresh(), 1.0)
    drift = [u + np.array([1e-7 * k, 0, 0]) for k, u in enumerate(resting(300))]
    assert all(watch.update(k, k / RATE, u.ravel()) is None for k, u in enumerate(drift))
    assert not watch.touched


def test_the_user_may_say_that_nothing_touches() -> None:
    here = fresh()
    live = Live(here, [*resting(3, 0, motion()), *resting(30, 1, motion())], rate=RATE, quiet=0.2, drop=False)
    live.zero()
    found = list(live)
    assert not found[-1].touched
    assert np.linalg.norm(found[-1].map.resultant().value) < 0.02


def test_a_zero_is_refused_that_is_none() -> None:
    with pytest.raises(InputError, match="no zero of this sensor"):
        fresh().offset = np.zeros(3)  # type: ignore[assignment]


# -- slip -------------------------------------------------------------------------------------------------------------
def contact_of(found: ForceMap, traction: Array, radius: float, at: Array) -> Contact:
    here = np.linalg.norm(found.nodes[:, :2] - at, axis=1) < radius
    return Contact(
        here, float(found.areas[here].sum()), at, radius, float(-traction[:, 2].min()), np.zeros(0), 0.0, NOTHING
    )


def test_the_slip_map_is_that_of_mindlin() -> None:
    """Ratio one in the ring that slips, below one inside, on tractions known in closed form."""
    like = sensor().estimate(motion())
    x = like.nodes[:, :2]
    a, mu = 4.5e-3, 0.5
    r = np.linalg.norm(x, axis=1)
    p = 20e3 * np.sqrt(np.maximum(1 - (r / a) ** 2, 0))
    c = 0.6 * a  # Cattaneo and Mindlin: mu p, less (c / a) mu p0 sqrt(1 - r^2 / c^2) inside
    q = mu * p - mu * 20e3 * (c / a) * np.sqrt(np.maximum(1 - (r / c) ** 2, 0))
    t = np.column_stack([q, np.zeros_like(q), -p])
    found = replace(like, load=t.ravel(), std=np.full(t.size, 1.0))
    touch = contact_of(found, t, 0.98 * a, np.zeros(2))
    told = slip_map(found, touch, Friction(mu, 1e-6, 100, True))
    ring, middle = touch.mask & (r > 1.001 * c), touch.mask & (r < 0.8 * c)
    np.testing.assert_allclose(told.ratio[ring], 1.0, rtol=1e-12)
    assert told.ratio[middle].max() < 0.75
    assert np.isnan(told.ratio[~touch.mask]).all()
    assert told.share == pytest.approx(found.areas[ring].sum() / touch.area, rel=0.05)


def test_the_band_of_the_slip_map_is_that_of_draws() -> None:
    like = sensor().estimate(motion())
    t, spread = like.traction(), np.full(like.load.shape, 150.0)
    at = t[:, 2] < 0.5 * t[:, 2].min()
    touch = Contact(at, 1.0, np.zeros(2), 1e-3, 1.0, np.zeros(0), 0.0, NOTHING)
    told = slip_map(replace(like, std=spread), touch, Friction(0.4, 0.02, 100, True))
    rng, draws = np.random.default_rng(0), []
    for _ in range(2000):
        moved = t + 150.0 * rng.standard_normal(t.shape)
        mu = 0.4 + 0.02 * rng.standard_normal()
        draws.append(np.hypot(moved[at, 0], moved[at, 1]) / -moved[at, 2] / mu)
    np.testing.assert_allclose(told.std[at], np.std(draws, axis=0), rtol=0.15)


def sliding_frames(mu: float, count: int = 90) -> list[Array]:
    """A press that is sheared while it holds, then slides along X for three millimetres."""
    rng, frames = np.random.default_rng(0), []
    for k in range(count):
        held = min(k / (count / 3), 1.0)
        x = -2e-3 + 3e-3 * max(k / (count / 3) - 1, 0) / 2
        frames.append(noisy(moved_by(Press(at=(x, 0), radius=2.5e-3, force=0.8, shear=(0.8 * mu * held, 0))), rng))
    return frames


def test_friction_is_learned_where_it_slides_and_kept() -> None:
    live, found = run(sliding_frames(0.4), quiet=None)
    known = live.friction
    assert known is not None
    assert known.sliding
    assert known.value == pytest.approx(0.4, abs=0.02)
    assert known.std < 0.02
    before = [f.slip for f in found if f.slip is not None and not f.slip.friction.sliding]
    assert before
    assert before[-1].friction.value <= 0.42  # until then: at least what was held
    assert said(found, "sliding")[:1] == ["begins"]
    assert found[-1].slip is not None
    assert found[-1].slip.share > 0.5
    again = SlipWatch(live._slip.kept())
    assert again.friction == known


def test_a_press_that_holds_does_not_slide() -> None:
    rng = np.random.default_rng(0)
    presses = [Press(radius=2.5e-3, force=f, shear=(0.2 * f, 0.0)) for f in np.linspace(0.2, 1.0, 60)]
    _, found = run([noisy(moved_by(p), rng) for p in presses], quiet=None)
    assert said(found, "sliding") == []
    assert found[-1].slip is not None
    assert not found[-1].slip.friction.sliding
    assert found[-1].slip.friction.value == pytest.approx(0.2, abs=0.02)


# -- events -----------------------------------------------------------------------------------------------------------
def test_each_event_begins_and_ends_once() -> None:
    places, usual = markers(), np.full((64, 64), 120, np.uint8)
    none = np.zeros(len(places), bool)
    hand = places[:, 0] > 2e-3
    strewn = np.random.default_rng(0).permutation(len(places)) < 0.06 * len(places)
    day = [
        (20, usual, none, None), (20, (0.6 * usual).astype(np.uint8), none, None), (20, usual, none, None),
        (20, usual, hand, None), (20, usual, none, None), (20, usual, strewn, None), (20, usual, none, None),
        (2, usual, none, "moved"), (10, usual, none, None), (20, usual, none, "moved"), (20, usual, none, None),
    ]  # fmt: skip
    watch, found, number = EventWatch(places), [], 0
    for count, image, lost, moved in day:
        for _ in range(count):
            number += 1
            found += watch.seen(number, number / RATE, image, lost, moved, False)
    assert [(e.kind, e.state) for e in found] == [
        (kind, state) for kind in ("light", "covered", "markers lost", "camera moved") for state in ("begins", "ends")
    ]
    assert "40% darker" in found[0].text
    assert "hidden, side by side" in found[2].text
    assert watch.on == ()


def test_light_that_changes_slowly_or_stays_after_a_zero_is_the_usual_one() -> None:
    watch, none = EventWatch(markers()), np.zeros(len(markers()), bool)
    slow = [np.full((16, 16), 100 + 0.05 * k) for k in range(1500)]
    assert [e for k, image in enumerate(slow) for e in watch.seen(k, k, image, none, None, False)] == []
    dark = np.full((16, 16), 60.0)
    assert [e.state for k in range(9) for e in watch.seen(k, k, dark, none, None, False)] == ["begins"]
    watch.settled()
    assert [e.state for k in range(9) for e in watch.seen(k, k, dark, none, None, False)] == ["ends"]


def test_the_pad_of_the_rig_is_not_moved_by_others() -> None:
    assert np.all(sensor().offset == 0)
    assert len(pad().surface.cells) == 168
