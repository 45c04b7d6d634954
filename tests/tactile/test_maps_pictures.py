"""Pictures, videos, reports and recordings of force maps: what they show is what the map holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from structures import Flag
from structures._flags import Evidence
from structures.errors import InputError
from tactile import ForceMap, Pad, Press
from tactile._results import film, report
from tactile._results import film as video
from tactile._results import pictures as maps
from tactile._results import report as words
from tactile._results.forcemap import record, shared
from tactile._sensors.posing import channels, of_pad

STD = 150.0  # Pa


@pytest.fixture(scope="module")
def pad() -> Pad:
    return Pad(size=(9e-3, 6e-3), thickness=3e-3, E=147e3, nu=0.3, pitch=1.5e-3, layers=3)


@pytest.fixture(scope="module")
def frames(pad: Pad) -> list[ForceMap]:
    return [
        known(pad, Press(radius=2e-3, force=f, shear=(s, 0.0)), k) for k, (f, s) in enumerate(((0.1, 0), (0.3, 0.1)))
    ]


def known(pad: Pad, press: Press, k: int = 0) -> ForceMap:
    """A map whose load is that of a press."""
    labels = channels(pad.points, "hats")
    load = press.traction(pad.nodes2d).ravel()
    flags = [Flag("W604", Evidence("share", 0.1 * (k + 1), 0.02), f"lost {k + 1}", "look")]
    return ForceMap(
        load=load, std=np.full(load.shape, STD), labels=[c.label for c in labels], units=[c.unit for c in labels],
        flags=flags, geometry={**of_pad(pad), "resultant_covariance": (1e-3 * (k + 1)) ** 2 * np.eye(6)},
        facts={"lost": k, "n": load.size, "provided": {"x": "tracked", "y": "tracked", "z": "measured"}},
        provenance={"family": "<made & known>"},
    )  # fmt: skip


# -- recording --------------------------------------------------------------------------------------------------------
def test_a_recording_holds_its_frames(pad: Pad, frames: list[ForceMap], tmp_path: Path) -> None:
    whole = record(frames, numbers=[3, 7])
    whole.save(tmp_path / "map.h5")
    for found in (whole, ForceMap.read(tmp_path / "map.h5")):
        assert found.axis is not None
        assert found.axis.values.tolist() == [3.0, 7.0]
        for k, frame in enumerate(frames):
            one = found.frame(k)
            assert np.array_equal(one.load, frame.load)
            assert one.resultant().value == pytest.approx(frame.resultant().value, rel=1e-12)
            assert one.resultant().std == pytest.approx(frame.resultant().std, rel=1e-12)
            assert found.torque([1e-3, 0, 0]).std[k] == pytest.approx(frame.torque([1e-3, 0, 0]).std, rel=1e-12)
            assert str(one.contact()) == str(frame.contact())
        assert found.facts["lost"] == [0, 1]
        assert found.facts["n"] == 3 * pad.points
    assert record(frames, times=[0.1, 0.2]).axis.name == "time"  # type: ignore[union-attr]


def test_findings_stand_once_with_their_frames(frames: list[ForceMap]) -> None:
    (one,) = record(frames, numbers=[3, 7]).flags
    assert one.evidence.value == pytest.approx(0.2)
    assert "lost 2 (in 2 of 2 frames, most in frame 7)" in one.message
    same = Flag("W112", Evidence("strain", 0.2, 0.1), "too far", "less")
    assert shared([[same], [same]], [1, 2]) == (same,)
    assert shared([[], [same], [same]], [1, 2, 3])[0].message == "too far (in 2 of 3 frames, from frame 2)"


def test_of_each_component_the_least_that_a_frame_says(frames: list[ForceMap]) -> None:
    facts = {**frames[1].facts, "provided": {"x": "tracked", "y": "tracked", "z": "completed"}}
    found = record([frames[0], replace(frames[1], facts=facts)])
    assert found.provided == {"x": "tracked", "y": "tracked", "z": "completed"}
    assert "u_x, u_y tracked by the markers; u_z completed" in words.provided(found)


def test_what_is_no_recording(pad: Pad, frames: list[ForceMap]) -> None:
    other = Pad(size=(6e-3, 6e-3), thickness=3e-3, E=147e3, nu=0.3, pitch=3e-3, layers=3)
    with pytest.raises(InputError, match="no frames"):
        record([])
    with pytest.raises(InputError, match="sequence among"):
        record([record(frames)])
    with pytest.raises(InputError, match=r"frame 2.*different sensors"):
        record([frames[0], known(other, Press())])
    with pytest.raises(InputError, match="axis does not fit"):
        record(frames, times=[0.2, 0.1])


# -- pictures ---------------------------------------------------------------------------------------------------------
def test_zero_is_white_and_a_pull_as_strong_as_a_push() -> None:
    from matplotlib.colors import Normalize

    for low in (-0.02, -0.5, -2.0):
        style = maps.colours(low, 1.0)
        norm = Normalize(style["vmin"], style["vmax"])
        assert min(style["cmap"](norm(0.0))[:3]) > 0.95
        size = -style["vmin"]
        push, pull = (np.array(style["cmap"](norm(x))[:3]) for x in (size, -size))
        assert push[0] > push[2]
        assert pull[2] > pull[0]
        assert push.min() == pytest.approx(pull.min(), abs=0.1)  # as far from white


def test_colours_are_the_pressures_on_one_scale(pad: Pad, frames: list[ForceMap]) -> None:
    true = 1.5 * frames[1].traction()
    figure = maps.map_figure(frames[1], truth=true)
    images = [ax.collections[0] for ax in figure.axes if ax.get_title(loc="left")]
    assert [ax.get_title(loc="left") for ax in figure.axes if ax.get_title(loc="left")] == ["estimate", "truth", "std"]
    for image, values in zip(images, (-frames[1].traction()[:, 2], -true[:, 2], np.full(pad.points, STD)), strict=True):
        assert np.asarray(image.get_array()).ravel() == pytest.approx(1e-3 * values, rel=1e-9)
    assert images[0].get_clim() == images[1].get_clim()
    assert images[1].get_clim()[1] == pytest.approx(1.5e-3 * Press(radius=2e-3, force=0.3).peak, rel=1e-9)
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels.count("pressure [kPa]") == 2
    assert "std of the pressure [kPa]" in labels


def test_arrows_are_the_shear(pad: Pad, frames: list[ForceMap]) -> None:
    from matplotlib.quiver import Quiver

    figure = maps.map_figure(frames[1])
    (arrows,) = [c for ax in figure.axes for c in ax.collections if isinstance(c, Quiver)]
    at, _ = maps.spread_evenly(pad.nodes2d)
    assert np.asarray(arrows.U) == pytest.approx(1e-3 * frames[1].traction()[at, 0], abs=1e-9)
    assert np.asarray(arrows.get_offsets()) == pytest.approx(1e3 * pad.nodes2d[at])
    assert not [c for ax in maps.map_figure(frames[0]).axes for c in ax.collections if isinstance(c, Quiver)]


def test_nodes_are_spread_evenly() -> None:
    x = np.linspace(0, 1, 101)
    grid = np.array(np.meshgrid(x, x)).reshape(2, -1).T
    at, step = maps.spread_evenly(grid)
    assert step == pytest.approx(0.05)
    assert len(at) == maps.ARROWS**2
    gaps = np.diff(np.unique(np.round(grid[at, 0], 9)))
    assert gaps == pytest.approx(np.full(maps.ARROWS - 1, 0.05), abs=1e-9)
    every, _ = maps.spread_evenly(grid.reshape(101, 101, 2)[::6, ::6].reshape(-1, 2))  # few: none is left out
    assert len(every) == 17**2


def test_nodal_forces_are_shown_as_pressures(pad: Pad, frames: list[ForceMap]) -> None:
    force = Press(radius=2e-3, force=0.3).traction(pad.nodes2d) * pad.surface.areas[:, None]
    nodal = replace(frames[0], load=force.ravel(), std=np.full(force.size, 1e-3), units=["N"] * force.size,
                    geometry={**of_pad(pad, "nodal"), "resultant_covariance": np.eye(6)})  # fmt: skip
    assert nodal.pressure_std() == pytest.approx(1e-3 / pad.surface.areas, rel=1e-12)


def test_lines_are_the_resultants_with_their_band(frames: list[ForceMap]) -> None:
    whole = record(frames, times=[0.5, 1.0])
    true = np.array([[0.0, 0, -0.1, 0, 0, 0], [0.1, 0, -0.3, 1e-3, 0, 0]])
    figure = maps.sequence_figure(whole, wrenches=true)
    force, torque = (
        next(ax for ax in figure.axes if ax.get_ylabel() == label) for label in ("force [N]", "torque [N mm]")
    )
    lines = {line.get_label(): line for line in force.get_lines()}
    assert np.asarray(lines["Fz"].get_ydata()) == pytest.approx(whole.resultant().value[:, 2])
    assert np.asarray(lines["truth"].get_ydata()) == pytest.approx(true[:, 2])
    band = force.collections[2].get_paths()[0].vertices
    assert np.ptp(band[band[:, 0] == 1.0, 1]) == pytest.approx(2 * 1.959964 * 2e-3, rel=1e-6)
    known_torque = [line for line in torque.get_lines() if line.get_linestyle() == "--"]
    assert np.asarray(known_torque[0].get_ydata()) == pytest.approx([0.0, 1.0])
    assert force.get_xlabel() == "time [s]"


def test_pictures_refuse_what_does_not_fit(frames: list[ForceMap]) -> None:
    whole = record(frames)
    with pytest.raises(InputError, match="known map does not fit"):
        maps.map_figure(frames[0], truth=np.zeros((3, 3)))
    with pytest.raises(InputError, match="no such frame"):
        maps.map_figure(whole, frame=2)
    with pytest.raises(InputError, match="wrenches do not fit"):
        maps.sequence_figure(whole, wrenches=np.zeros((1, 6)))
    with pytest.raises(InputError, match="takes frames"):
        film.pictures(frames[0])


# -- videos -----------------------------------------------------------------------------------------------------------
def moving() -> Iterator[NDArray[np.uint8]]:
    """A bright column that moves to the right."""
    for k in range(4):
        image = np.zeros((33, 65, 3), np.uint8)
        image[:, 16 * k : 16 * k + 8] = (200, 60, 20)
        yield image


@pytest.mark.parametrize("suffix", [".gif", ".mp4", ".avi"])
def test_a_video_reads_back(tmp_path: Path, suffix: str) -> None:
    if suffix != ".gif":
        pytest.importorskip("cv2")
    path = tmp_path / f"a{suffix}"
    assert video.write_video(path, moving(), fps=5) == 4
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    for k, image in enumerate(_read(path)):
        columns = image[..., 0].astype(float).mean(axis=0)
        assert columns @ np.arange(len(columns)) / columns.sum() == pytest.approx(16 * k + 3.5, abs=1.5)
        assert np.abs(image[10, 16 * k + 4].astype(int) - (200, 60, 20)).max() < 40  # red first


def _read(path: Path) -> list[NDArray[np.uint8]]:
    if path.suffix == ".gif":
        from PIL import Image, ImageSequence

        with Image.open(path) as file:
            return [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(file)]
    import cv2

    capture, found = cv2.VideoCapture(str(path)), []
    while True:
        there, image = capture.read()
        if not there:
            break
        found.append(image[..., ::-1])
    capture.release()
    assert len(found) == 4
    return found


def test_nothing_half_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.gif"
    path.write_bytes(b"old")

    def broken() -> Iterator[NDArray[np.uint8]]:
        yield next(moving())
        raise RuntimeError("lost")

    with pytest.raises(RuntimeError, match="lost"):
        video.write_video(path, broken())
    with pytest.raises(InputError, match=r"picture 2: a picture that does not fit"):
        video.write_video(path, [next(moving()), np.zeros((2, 2, 3), np.uint8)])
    with pytest.raises(InputError, match="no pictures"):
        video.write_video(path, [])
    assert path.read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_videos_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"no kind of video.*\.gif"):
        video.require_video(tmp_path / "a.mkv")
    monkeypatch.setattr("tactile._results.film.installed", lambda: False)
    with pytest.raises(InputError, match=r"needs OpenCV.*loadid\[vision\].*\.gif"):
        video.require_video(tmp_path / "a.mp4")
    assert video.require_video(tmp_path / "a.gif") == ".gif"


def test_a_film_shows_every_frame_on_one_scale(frames: list[ForceMap]) -> None:
    whole = record(frames)
    first, second = film.pictures(whole, truth=whole.traction())
    assert first.shape == second.shape
    assert first.dtype == np.uint8
    assert np.ptp(first) > 200
    red = [np.sum((im[..., 0] > 150) & (im[..., 1] < 120) & (im[..., 2] < 120)) for im in (first, second)]
    assert red[1] > 1.5 * red[0]  # three times the force on the same scale
    with pytest.raises(InputError, match="known maps do not fit"):
        film.pictures(whole, truth=np.zeros((1, 3)))


# -- report -----------------------------------------------------------------------------------------------------------
class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "srcset", "href")
                         and not (tag == "a" and (value or "").startswith("#"))]  # fmt: skip
        if tag not in ("meta", "img", "br", "source"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_report_stands_alone_and_says_the_numbers(frames: list[ForceMap], tmp_path: Path) -> None:
    whole = record(frames)
    path = tmp_path / "map.html"
    report.write_report(whole, path, about=[("pad", "<b>soft</b>")], compared=[("force", "1 N", "2 N")])
    text = path.read_text(encoding="utf-8")
    page = _Page()
    page.feed(text)
    assert page.open == []
    assert page.sources
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert "&lt;b&gt;soft" in text
    assert "&lt;made &amp; known&gt;" in text
    assert "in 2 of 2 frames" in text
    assert "frame 2" in text  # the strongest
    for _, value, _ in words.numbers(frames[1]):
        assert value in text
    with pytest.raises(InputError, match="folder does not exist"):
        report.write_report(whole, tmp_path / "none" / "map.html")


def test_words_are_the_numbers(frames: list[ForceMap]) -> None:
    said = {name: value for name, value, _ in words.numbers(frames[1])}
    one = frames[1]
    assert said["contact radius"] == f"{1e3 * one.contact().radius:.3g} mm"
    assert said["force on the pad"].startswith(f"({one.resultant().value[0]:.4f} ± 0.0020")
    assert said["peak pressure"] == f"{1e-3 * one.pressure().max():.2f} ± 0.15 kPa"
    quiet = replace(one, load=0 * one.load)
    assert ("contact", "none") in [row[:2] for row in words.numbers(quiet)]
