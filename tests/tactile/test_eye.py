"""From images to a force map: the whole chain on a coarse pad, with lost dots, a sparse eye, and what it refuses."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from structures.errors import InputError
from tactile import ContactLaw, DepthMap, Eye, ForceMap, MultilayerPad, Pad, Press, View, frames
from tactile.vision._images import Scene, grid

SIDE, H = 24e-3, 3e-3
SCENE = Scene(radius=0.22e-3, blur=1.0, noise=2.0)
VIEW = View.camera(focal=640, centre=(320, 240), distance=25e-3, depth=H, gamma=1.4, tilt=np.deg2rad(12), azimuth=0.3)
PRESS = Press(at=(0.3e-3, 0.0), radius=2.5e-3, force=1.0, shear=(0.25, 0.0))


@cache
def pad() -> Pad:
    return Pad(size=(SIDE, SIDE), thickness=H, E=0.147e6, nu=0.3223, pitch=1e-3, layers=4)


@cache
def dots() -> np.ndarray:
    return grid(20, 26, 0.9e-3)


def picture(press: Press | None, seed: int, keep: np.ndarray | slice = slice(None)) -> np.ndarray:
    rest = np.column_stack([dots(), np.zeros(len(dots()))])
    moved = rest if press is None else rest + press.displacement(pad().layer, dots())
    return SCENE.photograph(VIEW, moved[keep], seed=seed)


@cache
def unloaded() -> tuple[np.ndarray, ...]:
    return tuple(picture(None, k) for k in range(5))


def chained(watch: Eye, **settings: object) -> MultilayerPad:
    """A sensor whose map may lie anywhere but near the rim."""
    inner = np.all(np.abs(pad().nodes2d) < 7.6e-3, axis=1)
    return MultilayerPad(
        pad(), eye=watch, choice=0.01, **settings, contact=ContactLaw(support=inner), penalty="identity"
    )  # type: ignore[arg-type]


def eye(**settings: object) -> Eye:
    given = {"unloaded": unloaded()[1:], "size": (SIDE, SIDE), **settings}
    return Eye(VIEW, unloaded()[0], **given)  # type: ignore[arg-type]


@cache
def depth(press: Press | None = PRESS) -> DepthMap:
    line = (np.arange(240) - 119.5) * 1e-4
    places = np.array(np.meshgrid(line, line)).reshape(2, -1).T
    z = np.zeros((240, 240)) if press is None else press.displacement(pad().layer, places)[:, 2].reshape(240, 240)
    return DepthMap(z + 1e-5 * np.random.default_rng(0).standard_normal(z.shape), 1e-4, 1e-5)


def steps(count: int = 3) -> list[Press]:
    """The press, step by step: markers are followed from frame to frame."""
    return [Press(at=PRESS.at, radius=2.5e-3, force=s, shear=(0.25 * s, 0.0)) for s in np.arange(1, count + 1) / count]


def followed(sensor: MultilayerPad, keep: np.ndarray | slice = slice(None)) -> ForceMap:
    for k, press in enumerate(steps()):
        found = sensor.estimate(picture(press, 20 + k, keep), depth(press))
    return found


@pytest.fixture(scope="module")
def whole() -> tuple[MultilayerPad, ForceMap]:
    sensor = chained(eye(), depth=depth())
    return sensor, followed(sensor)


def cosine(found: ForceMap) -> float:
    t, truth = found.traction(), PRESS.traction(pad().nodes2d)
    return float(np.sum(t * truth) / np.linalg.norm(t) / np.linalg.norm(truth))


def close(found: ForceMap, like: float) -> None:
    touch = found.contact()
    assert np.linalg.norm(found.resultant().value - PRESS.vector) < 0.03 * np.linalg.norm(PRESS.vector)
    assert touch.peak == pytest.approx(PRESS.peak, rel=0.1)
    assert touch.radius == pytest.approx(PRESS.radius, rel=0.08)
    assert cosine(found) > like


def test_the_whole_chain(whole: tuple[MultilayerPad, ForceMap]) -> None:
    close(whole[1], 0.97)
    assert whole[1].provided == {"x": "tracked", "y": "tracked", "z": "measured"}


@pytest.mark.parametrize("light", ["darker", "brighter", "lifted", "from one side"])
def test_light_that_changes_moves_no_load(whole: tuple[MultilayerPad, ForceMap], light: str) -> None:
    """Press, motion and pictures are exact and drawn; only the light of the last picture is another one."""
    sensor, before = whole
    image = picture(steps()[-1], 22).astype(float)
    side = np.linspace(0.75, 1.1, image.shape[1])
    other = {"darker": 0.6 * image, "brighter": 1.2 * image, "lifted": image + 20, "from one side": side * image}[light]
    found = sensor.estimate(np.clip(np.round(other), 0, 255).astype(np.uint8), depth(steps()[-1]))
    close(found, 0.97)
    away = np.abs(found.resultant().value - before.resultant().value)[:3]
    print(light, away, found.facts["lost"])
    assert np.all(away < 0.004 * np.linalg.norm(PRESS.vector))
    assert found.facts["lost"] == before.facts["lost"]


def test_a_tenth_of_the_dots_removed() -> None:
    keep = np.sort(np.random.default_rng(1).permutation(520)[:468])
    sensor = chained(eye(), depth=depth())
    found = followed(sensor, keep)
    close(found, 0.95)
    assert found.facts["lost"] >= 104
    assert "W604" in found.codes


def test_in_plane_markers_alone_do_not_tell_pressure() -> None:
    sensor = chained(eye())
    for k, press in enumerate(steps()):
        found = sensor.estimate(picture(press, 20 + k))
    print(f"in-plane markers alone: {found.resultant()}, cosine {cosine(found):.3f}")
    assert found.provided["z"] == "completed"
    assert abs(found.resultant().value[2] + 1) > 0.5
    assert "W608" in found.codes  # a press would hardly be seen


def test_apparent_motion_is_read_to_a_fraction_of_a_pixel() -> None:
    watch = eye()
    assert len(watch.markers) == 520
    for k, press in enumerate(steps()):
        motion, _ = watch.read(picture(press, 20 + k), depth(press))
    u = PRESS.displacement(pad().layer, watch.markers)
    slope = watch.slope
    assert slope is not None
    error = motion - (u[:, :2] + slope * u[:, 2:])
    assert np.sqrt(np.nanmean(error**2)) < 0.04 * 45e-6  # a pixel is 45 um
    far = np.hypot(*(watch.markers - PRESS.at).T) > 5e-3  # near the press the dots themselves are deformed
    assert watch.noise.mean() == pytest.approx(np.sqrt(np.nanmean(error[far] ** 2)), rel=0.35)


def test_markers_beside_the_pad_are_left_out() -> None:
    watch = eye(size=(12e-3, 12e-3))
    assert 0 < len(watch.markers) < 300
    assert np.all(np.abs(watch.markers) < 6e-3)


def test_a_view_without_rays_is_refused_and_can_be_allowed() -> None:
    corners = np.array([(x, y) for x in (-9e-3, 9e-3) for y in (-7e-3, 7e-3)])
    flat = View.fit(corners, VIEW.to_pixels(corners))
    with pytest.raises(InputError) as caught:
        Eye(flat, unloaded()[0], unloaded=unloaded()[1:])
    assert caught.value.code == "LID-E603"
    allowed = Eye(flat, unloaded()[0], unloaded=unloaded()[1:], allow=("E603",))
    assert allowed.slope is None
    assert {f.code for f in allowed.read(unloaded()[1])[1] if f is not None} == {"LID-E603"}


@pytest.mark.parametrize("settings", [{"unloaded": None}, {"unloaded": [unloaded()[0]] * 4}, {"noise": -1.0}])
def test_noise_must_be_known(settings: dict) -> None:
    with pytest.raises(InputError):
        eye(**settings)


# -- dead frames ------------------------------------------------------------------------------------------------------
BLANK = np.zeros(SCENE.size, np.uint8)
DEAD = {
    "black": BLANK,
    "saturated": BLANK + np.uint8(255),
    "no markers": np.random.default_rng(0).normal(100, 2, SCENE.size).astype(np.uint8),
    "noise": np.random.default_rng(0).integers(0, 256, SCENE.size).astype(np.uint8),
    "another size": BLANK[:100, :100],
    "no image": np.zeros(7, np.uint8),
    "NaN": np.full((*SCENE.size, 3), np.nan),
    "nothing": None,
}


@cache
def pictures() -> tuple[np.ndarray, ...]:
    return tuple(picture(press, 20 + k) for k, press in enumerate(steps()))


@cache
def undisturbed() -> tuple[ForceMap, ...]:
    return tuple(chained(eye()).stream(pictures()))


@pytest.mark.parametrize("kind", DEAD)
def test_a_dead_frame_does_not_end_a_stream(kind: str) -> None:
    """Those after it are what they are without it; the next one says which were left out, no other does."""
    a, b, c = pictures()
    stream = chained(eye()).stream(iter([a, DEAD[kind], DEAD[kind], b, c, DEAD[kind]]))
    numbers, found = [], []
    for force in stream:
        numbers.append(stream.number)
        found.append(force)
    assert numbers == [1, 4, 5]
    assert stream.skipped == (2, 3, 6)
    assert stream.time is None
    for one, like in zip(found, undisturbed(), strict=True):
        assert one.load == pytest.approx(like.load, rel=1e-9, abs=1e-9 * np.abs(like.load).max())
    told = [[f for f in force.flags if "left out, with no map" in f.message] for force in found]
    assert [len(flags) for flags in told] == [0, 1, 0]
    assert (told[1][0].code, told[1][0].evidence.value) == ("LID-W604", 2.0)
    assert "frames 2, 3 left out" in told[1][0].message


def test_a_stream_of_dead_frames_only_ends_in_the_error_of_the_first() -> None:
    stream = chained(eye()).stream([DEAD["another size"], BLANK])
    with pytest.raises(InputError, match="another size"):
        list(stream)
    assert stream.skipped == (1, 2)
    assert list(chained(eye()).stream([])) == []


def test_depth_maps_keep_step_with_dead_frames() -> None:
    a, b, c = pictures()
    maps = [depth(press) for press in steps()]
    whole = [m.load for m in chained(eye(), depth=depth()).stream([a, b, c], maps)]
    stream = chained(eye(), depth=depth()).stream([a, BLANK, b, None, c], [maps[0], maps[0], maps[1], maps[1], maps[2]])
    for force, like in zip(stream, whole, strict=True):
        assert force.load == pytest.approx(like, rel=1e-9, abs=1e-9 * np.abs(like).max())
    with pytest.raises(InputError, match=r"frame 3: .* no depth map 3"):
        list(chained(eye(), depth=depth()).stream([a, BLANK, b], maps[:2]))


def test_what_is_wrong_with_the_call_still_ends_a_stream() -> None:
    sensor = chained(eye())
    for wrong in (np.zeros((7, 2)), np.full((520, 2), np.inf), "frame"):
        with pytest.raises(InputError):
            list(sensor.stream([pictures()[0], wrong]))


def test_a_stream_of_a_folder_passes_over_a_damaged_file(tmp_path: Path) -> None:
    for k, image in enumerate([pictures()[0], BLANK, *pictures()[1:]]):
        Image.fromarray(image).save(tmp_path / f"{k + 1}.png")
    (tmp_path / "2.png").write_bytes(b"no image at all")
    stream = chained(eye()).stream(frames(tmp_path))
    loads = [force.load for force in stream]
    assert stream.skipped == (2,)
    for load, like in zip(loads, undisturbed(), strict=True):
        assert load == pytest.approx(like.load, rel=1e-9, abs=1e-9 * np.abs(load).max())


def test_a_frame_of_another_size(whole: tuple[MultilayerPad, ForceMap]) -> None:
    with pytest.raises(InputError, match="another size"):
        whole[0].estimate(np.zeros((240, 320), np.uint8))
