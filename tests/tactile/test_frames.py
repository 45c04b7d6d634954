"""Frames and marker files: every source gives the same images, and what is wrong is named with its frame."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from structures._flags import codes
from structures.errors import InputError
from tactile._arrays import UnusableFrame
from tactile.vision import _images as backend
from tactile.vision import frames, read_motions
from tactile.vision._frames import each, missing_numbers, natural
from tactile.vision._images import Scene

from ..data import measured
from .scenes import pattern

needs_cv2 = pytest.mark.skipif(not backend.installed(), reason="OpenCV is not installed (extra vision)")


@pytest.fixture(scope="module")
def clip() -> np.ndarray:
    """Twelve frames of 120 x 160 px."""
    scene = Scene(size=(120, 160))
    dots = 0.25 * pattern()[::4]
    return np.stack([scene.draw(dots + 0.2 * k, seed=k) for k in range(12)])


def saved(folder: Path, clip: np.ndarray, name: str = "frame{}.png", first: int = 1) -> Path:
    folder.mkdir(exist_ok=True)
    for k, image in enumerate(clip):
        Image.fromarray(image).save(folder / name.format(first + k))
    return folder


def colour(clip: np.ndarray) -> np.ndarray:
    return np.repeat(clip[..., None], 3, axis=-1)


def test_every_source_gives_the_same_frames(clip: np.ndarray, tmp_path: Path) -> None:
    np.save(tmp_path / "clip.npy", clip)
    np.savez(tmp_path / "clip.npz", images=clip, force=np.zeros(12), depth=np.zeros((12, 120, 160)))
    folder = saved(tmp_path / "folder", clip)  # frame10 follows frame9, not frame1
    (folder / "notes.txt").write_text("not an image")
    rgba = np.concatenate([colour(clip), np.full((*clip.shape, 1), 255, np.uint8)], axis=-1)
    sources = [
        clip, iter(clip), list(clip), colour(clip), rgba, clip / 255, clip.astype(np.uint16) * 256, clip[..., None],
        tmp_path / "clip.npy", str(tmp_path / "clip.npz"), folder,
    ]  # fmt: skip
    for source in sources:
        found = frames(source)
        images = list(found)
        assert np.abs(np.stack(images).astype(int) - clip).max() <= 1  # grey of equal channels rounds down
        assert images[0].dtype == np.uint8
        assert found.delivered == 12
        assert found.count in (12, None)
        assert found.flags == ()
    assert frames(found) is found
    assert len(list(frames(folder / "frame1.png"))) == 1
    np.testing.assert_array_equal(next(frames(tmp_path / "clip.npz", key="images")), clip[0])
    assert len(list(frames(clip[0]))) == len(list(frames(colour(clip)[0]))) == 1


def test_the_measured_frame_is_read_without_unpickling() -> None:
    found = frames(measured("gelsight_dots", "nocontact.npz"))
    assert next(found).shape == (240, 320)
    assert found.count == 1


def test_a_frame_that_cannot_be_used_is_named(clip: np.ndarray, tmp_path: Path) -> None:
    sizes = frames([*clip[:3], clip[3, :100]])
    with pytest.raises(InputError, match=r"frame 4: a frame of another size.*160 x 100 px.*160 x 120 px"):
        list(sizes)
    assert sizes.delivered == 3
    with pytest.raises(InputError, match="frame 2: an image holds NaN"):
        list(frames([clip[0], np.full((120, 160), np.nan)]))
    folder = saved(tmp_path / "damaged", clip[:3])
    whole = (folder / "frame2.png").read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", b"no image at all"):
        (folder / "frame2.png").write_bytes(damaged)
        with pytest.raises(InputError, match=r"frame2\.png.*cannot be read"):
            list(frames(folder))


def test_frames_missing_in_a_folder_are_noted(clip: np.ndarray, tmp_path: Path) -> None:
    folder = saved(tmp_path / "gaps", clip, "run7_{:04d}.png")
    assert frames(folder).flags == ()
    for k in (4, 9):
        (folder / f"run7_{k:04d}.png").unlink()
    (flag,) = frames(folder).flags
    assert codes([flag]) == {"W604"}
    assert "4, 9" in flag.message
    assert missing_numbers(["a1", "a3", "a5", "a9"]) == [7]  # every second one is the rule
    assert missing_numbers(["a1", "b2", "c9"]) == missing_numbers(["left", "right"]) == missing_numbers(["7"]) == []
    names = ["f1", "f2", "f10", "F011", "g1"]
    assert [p.name for p in sorted(map(Path, reversed(names)), key=natural)] == names


def test_what_holds_no_frames(clip: np.ndarray, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    np.save(tmp_path / "objects.npy", np.array([{"gs_img": 1}], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "two.npz", a=clip, b=clip)
    np.savez(tmp_path / "none.npz", a=np.zeros(4))
    np.save(tmp_path / "row.npy", np.zeros(4))
    np.save(tmp_path / "flat.npy", np.zeros((2, 3, 4, 5, 6)))
    (tmp_path / "cut.npz").write_bytes((tmp_path / "two.npz").read_bytes()[:2000])
    (tmp_path / "text.csv").write_text("1,2")
    cases = {
        "empty": "holds no images", "objects.npy": "cannot be read", "two.npz": "several arrays",
        "none.npz": "no images", "row.npy": "no images", "flat.npy": "no stack of images", "cut.npz": "cannot be read",
        "text.csv": "no frames in a file of this kind", "absent": "no such file",
    }  # fmt: skip
    for name, message in cases.items():
        with pytest.raises(InputError, match=message):
            frames(tmp_path / name)
    with pytest.raises(InputError, match="no such array"):
        frames(tmp_path / "two.npz", key="c")
    with pytest.raises(InputError, match="there are no frames"):
        list(frames([]))
    with pytest.raises(InputError, match="no frames"):
        frames(3.5)


@needs_cv2
def test_videos_are_read_and_a_truncated_one_names_the_frame(clip: np.ndarray, tmp_path: Path) -> None:
    cv2 = backend.opencv()
    found = {}
    for codec in ("FFV1", "MJPG"):
        path = tmp_path / f"{codec}.avi"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 30, (160, 120))
        if not writer.isOpened():
            pytest.skip(f"this OpenCV writes no {codec}")
        for image in colour(clip):
            writer.write(np.ascontiguousarray(image))
        writer.release()
        video = frames(path)
        found[codec] = np.stack(list(video)).astype(int)
        assert video.count == 12
        assert codes(video.flags) == ({"W406"} if codec == "MJPG" else set())
    assert np.abs(found["FFV1"] - clip).max() <= 2
    assert np.sqrt(np.mean((found["MJPG"] - clip) ** 2)) < 6
    whole = (tmp_path / "MJPG.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(whole[: 6 * len(whole) // 10])
    video = frames(tmp_path / "cut.avi")
    with pytest.raises(InputError, match=r"frame \d+: the video ends early") as error:
        list(video)
    assert 1 <= video.delivered < 12
    assert f"frame {video.delivered + 1}" in str(error.value)
    (tmp_path / "noise.mp4").write_bytes(bytes(500))
    with pytest.raises(InputError, match="the video cannot be read"):
        frames(tmp_path / "noise.mp4")


class Camera:
    """What OpenCV gives of a camera: frames, failures (None), and a stamp where it has one."""

    def __init__(self, images: list, stamped: bool = True, opened: bool = True, count: int = -1) -> None:
        self.images, self.stamped, self.opened, self.count = list(images), stamped, opened, count
        self.at, self.released = 0, False

    def isOpened(self) -> bool:
        return self.opened

    def get(self, what: str) -> float:
        return {"count": self.count, "msec": 40.0 * self.at if self.stamped else -1.0, "four": 0}[what]

    def read(self) -> tuple[bool, np.ndarray | None]:
        image = self.images[self.at] if self.at < len(self.images) else None
        self.at += 1
        return image is not None, image

    def release(self) -> None:
        self.released = True


Camera.__module__ = "cv2"


def seen_by(monkeypatch: pytest.MonkeyPatch, camera: Camera) -> None:
    named = {"CAP_PROP_FRAME_COUNT": "count", "CAP_PROP_POS_MSEC": "msec", "CAP_PROP_FOURCC": "four"}
    fake = SimpleNamespace(**named, VideoCapture=lambda index: camera)
    monkeypatch.setattr(sys.modules["tactile.vision._frames"], "opencv", lambda: fake)
    monkeypatch.setattr(sys.modules["tactile.vision._frames"], "installed", lambda: True)


@pytest.mark.parametrize("by_number", [True, False])
def test_a_camera_gives_frames_with_its_stamps(
    by_number: bool, clip: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame that fails is passed over; ten in a row are the end of a camera, in words."""
    camera = Camera([*colour(clip[:2]), None, *colour(clip[2:4])])
    seen_by(monkeypatch, camera)
    found = frames(0) if by_number else frames(camera)
    assert (found.count, found.time, found.flags) == (None, None, ())
    taken, stamps, lost = [], [], 0
    coming = each(found)
    for _ in range(5 + 9):
        frame = next(coming)
        if isinstance(frame, UnusableFrame):
            lost += 1
            assert found.time is None
        else:
            taken.append(frame)
            stamps.append(found.time)
    with pytest.raises(InputError, match=r"frame 15.*no more frames.*4 frames, then 10 failures"):
        next(coming)
    assert np.abs(np.stack(taken).astype(int) - clip[:4]).max() <= 1
    assert stamps == pytest.approx([0.04, 0.08, 0.16, 0.2])
    assert lost == 1 + 9
    assert camera.released is by_number  # a capture of one's own stays one's own
    assert list(each(found)) == []


def test_a_camera_is_known_by_number_or_device(clip: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """And can be released, where it was opened here; a video or a folder is none."""
    for which in (0, "/dev/null"):
        camera = Camera(list(colour(clip[:1])))
        seen_by(monkeypatch, camera)
        found = frames(which)
        assert (found.origin, found.camera) == (which, True)
        found.close()
        assert camera.released
    own = Camera(list(colour(clip[:1])))
    found = frames(own)
    assert (found.origin, found.camera) == (None, True)
    found.close()
    assert not own.released
    assert (frames(clip).origin, frames(clip).camera) == (None, False)


def test_a_camera_without_stamps_has_none(clip: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    seen_by(monkeypatch, Camera(list(colour(clip[:1])), stamped=False))
    found = frames(1)
    next(found)
    assert found.time is None


def test_a_camera_that_is_not_there(clip: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    seen_by(monkeypatch, Camera([], opened=False))
    with pytest.raises(InputError, match="camera 0: the camera cannot be opened"):
        frames(0)
    with pytest.raises(InputError, match="capture is not open"):
        next(frames(Camera([], opened=False)))
    monkeypatch.setattr(sys.modules["tactile.vision._frames"], "installed", lambda: False)
    with pytest.raises(InputError, match=r"a camera needs OpenCV.*loadid\[vision\]"):
        frames(0)
    for wrong in (-1, True, 0.5):
        with pytest.raises(InputError):
            frames(wrong)


@needs_cv2
def test_a_capture_of_a_video_is_the_video(clip: np.ndarray, tmp_path: Path) -> None:
    cv2 = backend.opencv()
    writer = cv2.VideoWriter(str(tmp_path / "a.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25, (160, 120))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no MJPG")
    for image in colour(clip):
        writer.write(np.ascontiguousarray(image))
    writer.release()
    capture = cv2.VideoCapture(str(tmp_path / "a.avi"))
    found, file = frames(capture), frames(tmp_path / "a.avi")
    assert found.count == 12
    assert codes(found.flags) == {"W406"}
    for frame, like in zip(found, file, strict=True):
        np.testing.assert_array_equal(frame, like)
        assert found.time == file.time == pytest.approx((found.delivered - 1) / 25, abs=1e-3)
    assert capture.isOpened()


def test_frames_go_on_after_one_that_cannot_be_used(clip: np.ndarray, tmp_path: Path) -> None:
    folder = saved(tmp_path / "damaged", clip[:6])
    (folder / "frame3.png").write_bytes(b"")
    Image.fromarray(clip[0, :100]).save(folder / "frame5.png")
    found = frames(folder)
    taken = list(each(found))
    assert [isinstance(frame, UnusableFrame) for frame in taken] == [False, False, True, False, True, False]
    assert "frame3.png" in str(taken[2])
    assert "frame 5: a frame of another size" in str(taken[4])
    assert found.delivered == 4
    np.testing.assert_array_equal(taken[5], clip[5])
    with pytest.raises(UnusableFrame):  # a generator is over once it has raised: not taken for its end
        list(each(frame for frame in frames(folder)))


def test_without_opencv_a_video_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.avi").write_bytes(b"RIFF")
    monkeypatch.setattr(sys.modules["tactile.vision._frames"], "installed", lambda: False)  # the name is its function
    monkeypatch.setattr(backend, "installed", lambda: False)
    with pytest.raises(InputError, match=r"loadid\[vision\]"):
        frames(tmp_path / "a.avi")
    with pytest.raises(InputError, match=r"loadid\[vision\]"):
        backend.backend("cv2")
    assert backend.backend().name == "scipy"


# -- marker motion tracked elsewhere ----------------------------------------------------------------------------------
def places(count: int = 6) -> np.ndarray:
    x = np.random.default_rng(0).uniform(20, 300, (count, 5, 3))
    x[2, 3] = np.nan
    return x


def test_marker_files_of_every_form_give_the_same_motion(tmp_path: Path) -> None:
    x = places()
    np.save(tmp_path / "x.npy", x)
    rows = [
        f"{k + 1},{i},{','.join(map(repr, map(float, x[k, i])))}"
        for k in range(6)
        for i in range(5)
        if np.isfinite(x[k, i, 0])
    ]
    (tmp_path / "x.csv").write_text("frame,id,x,y,z\n" + "\n".join(reversed(rows)) + "\n\n")
    for source in (x, tmp_path / "x.npy", tmp_path / "x.csv"):
        found = read_motions(source)
        np.testing.assert_array_equal(found.places, x[..., :2])
        np.testing.assert_array_equal(found.heights, x[..., 2])
        np.testing.assert_array_equal(found.moved, (x - x[0])[..., :2])
        assert found.flags == ()
        assert len(found) == 6
        motion = found[2]
        assert motion.lost.tolist() == [False, False, False, True, False]
        assert motion.frame == 3
        assert codes(motion.flags) == {"W604"}
        assert found[1].flags == ()
    np.testing.assert_array_equal(read_motions(x[..., :2], rest=1).points, x[1, :, :2])
    assert read_motions(x[..., :2]).heights is None


def test_the_file_of_gsrobotics_is_read(tmp_path: Path) -> None:
    lines = [
        f"{k},{r},{c},{30 * c},{20 * r},{30 * c + k},{20 * r - k * (r + 1)}"
        for k in (1, 2, 4)
        for r in (1, 2)
        for c in (1, 2)
    ]
    (tmp_path / "g.csv").write_text("\n".join([*lines, "4,1,3,90,20,-5,3"]) + "\n")
    found = read_motions(tmp_path / "g.csv")
    np.testing.assert_array_equal(found.points, [[30, 20], [60, 20], [90, 20], [30, 40], [60, 40]])
    np.testing.assert_array_equal(found.moved[1, [0, 1, 3, 4]], [[2, -4], [2, -4], [2, -6], [2, -6]])
    assert np.isnan(found.moved[:, 2]).all()  # absent twice, then inferred outside the image
    assert found.numbers == (1, 2, 4)
    assert codes(found.flags) == {"W604"}
    assert any("0.29 px" in note for note in found.notes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frame,id,x,y\n1,1,2,3\n1,2,3\n", "no table"),
        ("frame,id,x,y\n1,1,2,3\n1,1,2,4\n", "twice"),
        ("frame,id,x,y\n1,1,2,3\n1,2,2,4\n", "too few markers"),
        ("frame,id,x,y\n1,1.5,2,3\n", "whole numbers"),
        ("frame,id,x,y\n1,1,2,three\n", "no number"),
        ("t,u,v\n1,1,2\n", "no marker motion"),
        ("frame,id,x,y\n1", "no marker motion"),
        ("frame,id,x,y\n1,2\n2,3\n", "no marker motion"),
        ("1,2,3\n", "no marker motion"),
        ("", "no table"),
    ],
)
def test_a_marker_file_that_is_none(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_motions(tmp_path / "x.csv")


@pytest.mark.parametrize("form", ["{:.4f}", "{!r}", "{:.0f}", "{:.6e}"])
@pytest.mark.parametrize("header", ["frame,id,x,y", ""])
def test_a_marker_file_cut_at_any_byte_gives_no_wrong_place(form: str, header: str, tmp_path: Path) -> None:
    x = 100 * places()[:2, :4]
    lines = [header] if header else []
    for k in range(2):
        for i in range(4):
            rest = () if header else (i, 30 * i, 20)
            lines.append(f"{k + 1},{i}," + ",".join([*map(str, rest), *(form.format(float(v)) for v in x[k, i, :2])]))
    data, path, flagged = ("\n".join(lines) + "\n").encode(), tmp_path / "x.csv", 0
    path.write_bytes(data)
    whole = read_motions(path)
    for size in range(len(data)):
        path.write_bytes(data[:size])
        try:
            found = read_motions(path)
        except InputError:
            continue
        at = np.isfinite(found.places)
        np.testing.assert_array_equal(found.places[at], whole.places[: len(found), : found.places.shape[1]][at])
        if not found.flags:
            assert np.isfinite(found.places[..., 0]).sum() >= data[:size].count(b"\n") - bool(header), data[:size]
        flagged += "LID-W209" in {flag.code for flag in found.flags}
    assert flagged > 20


def test_a_last_frame_with_fewer_markers_than_all_others_is_said(tmp_path: Path) -> None:
    lines = ["frame,id,x,y", *(f"{k},{i},{30 * i + k}.0,5.0" for k in range(1, 5) for i in range(4))]
    path = tmp_path / "x.csv"
    for left, said in ((len(lines), []), (len(lines) - 1, ["LID-W209"]), (len(lines) - 4, [])):
        path.write_text("\n".join(lines[:left]) + "\n")
        assert [flag.code for flag in read_motions(path).flags] == said
    path.write_text("\n".join(lines[:7] + lines[8:-1]) + "\n")  # markers are lost in others too
    assert not read_motions(path).flags


def test_an_array_that_is_no_motion() -> None:
    for source, settings in ((places()[0], {}), (places(), {"rest": 6}), (np.full((2, 5, 2), np.inf), {})):
        with pytest.raises(InputError):
            read_motions(source, **settings)
    with pytest.raises(InputError, match="no such file"):
        read_motions("absent.csv")
