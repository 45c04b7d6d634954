"""``loadid tactile``: from files to force maps, by the command line, against the presses behind the images."""

from __future__ import annotations

import hashlib
import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loadid.cli import main
from structures.errors import InputError
from tactile import ForceMap, Pad, Press
from tactile._commands import _demo as demo
from tactile._commands import _sources as _eyes
from tactile._commands._sources import depth_maps, is_motion
from tactile._commands.tactile import EXAMPLES, span
from tactile._pad import padfile
from tactile._results import film
from tactile.vision._images import Scene, grid

FILE = """\
[pad]
size = ["12 mm", "9 mm"]
thickness = "3 mm"
E = "0.147 MPa"
nu = 0.3223
pitch = "1 mm"
layers = 4
[camera]
focal = 640
centre = [160, 120]
distance = "25 mm"
depth = "3 mm"
gamma = 1.4
tilt = "8 deg"
[depth]
pixel = "0.25 mm"
noise = "5 um"
"""
MARKERS = grid(9, 12, 0.9e-3)
UNLOADED = 4
PRESSES = [Press(at=(d, 0.0), radius=2.2e-3, force=0.2, shear=(s, 0.0)) for d, s in ((0, 0), (0, 0.03), (2e-4, 0.06))]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images, stack, places in px and mm, and depth maps of presses on a small pad, by a finer mesh than the maps'."""
    from PIL import Image

    folder = tmp_path_factory.mktemp("tactile")
    (folder / "pad.toml").write_text(FILE, encoding="utf-8")
    settings = padfile.read(folder / "pad.toml")
    view, rng = settings.view, np.random.default_rng(3)
    fine = Pad.from_settings(replace(settings, body={**settings.body, "pitch": 0.5e-3, "layers": 6}))
    assert view is not None

    def motion(press: Press | None, rows: Any) -> np.ndarray:
        pressed = np.zeros((fine.points, 3)) if press is None else fine.surface.mass @ press.traction(fine.nodes2d)
        return np.asarray(rows @ fine.displacements(pressed).ravel()).reshape(-1, 3)

    x, y = ((np.arange(n) - (n - 1) / 2) * 0.25e-3 for n in (48, 36))
    pixels = np.array(np.meshgrid(x, y)).reshape(2, -1).T
    at_markers, at_pixels = fine.from_surface(MARKERS), fine.from_surface(pixels)
    scene = Scene(size=(240, 320), radius=0.22e-3, blur=1.0, noise=2.0)
    images, places, moved, depths = [], [], [], []
    for press in [*[None] * UNLOADED, *PRESSES]:
        u, z = motion(press, at_markers), motion(press, at_pixels)[:, 2]
        now = np.column_stack([MARKERS + u[:, :2], u[:, 2]])
        images.append(scene.photograph(view, now, seed=rng))
        places.append(view.to_pixels(now) + 0.015 * rng.standard_normal((len(MARKERS), 2)))
        moved.append(1e3 * (now + 5e-7 * rng.standard_normal(now.shape)))
        depths.append(z.reshape(36, 48) + 5e-6 * rng.standard_normal((36, 48)))
    (folder / "frames").mkdir()
    for k, image in enumerate(images):
        Image.fromarray(image).save(folder / "frames" / f"f{k + 1}.png")
    np.save(folder / "stack.npy", np.array(images))
    np.save(folder / "moved.npy", np.array(moved))
    np.save(folder / "depth.npy", np.array(depths, np.float32))
    rows = [(k + 1, i, *xy) for k, frame in enumerate(places) for i, xy in enumerate(frame)]
    lines = ["frame,id,x,y", *(f"{k},{i},{a:.6f},{b:.6f}" for k, i, a, b in rows if (k, i) != (6, 40))]
    (folder / "places.csv").write_text("\n".join(lines), encoding="utf-8")
    return folder


def run(made: Path, out: Path, *words: str, source: str = "frames", depth: bool = True) -> int:
    """Run the command on what was made."""
    more = ["--depth", str(made / "depth.npy")] if depth else []
    return main(["tactile", str(made / source), "--pad", str(made / "pad.toml"), *more, "-o", str(out), *words])


def off(found: ForceMap, k: int, press: Press) -> float:
    """Relative error of the resultant of a frame."""
    return float(np.linalg.norm(found.resultant().value[k] - press.vector) / np.linalg.norm(press.vector))


@pytest.fixture(scope="module")
def whole(made: Path) -> dict[str, Any]:
    """Answer of the command on the images."""
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()) as said:
        assert run(made, made / "a.h5", "--unloaded", "4", "--rate", "10", "--json") == 0
    return dict(json.loads(said.getvalue()))


# -- maps -------------------------------------------------------------------------------------------------------------
def test_images_become_force(made: Path, whole: dict[str, Any]) -> None:
    found = ForceMap.read(made / "a.h5")
    assert found.load.shape == (UNLOADED + 3, 3 * 13 * 10)
    for k, press in enumerate(PRESSES):
        one, k = found.frame(UNLOADED + k), UNLOADED + k
        assert off(found, k, press) < 0.05
        assert one.contact().radius == pytest.approx(press.radius, rel=0.12)
        assert 1e3 * one.contact().centre == pytest.approx(1e3 * np.array(press.at), abs=0.15)
    assert np.linalg.norm(found.resultant().value[:UNLOADED], axis=1).max() < 0.01
    assert found.provided == {"x": "tracked", "y": "tracked", "z": "measured"}
    assert found.axis is not None
    assert found.axis.values == pytest.approx(0.1 * np.arange(7))
    digests = {Path(p).name: d for p, d in found.provenance["inputs"].items()}
    assert digests["pad.toml"] == hashlib.sha256(FILE.encode()).hexdigest()
    assert set(digests) == {"pad.toml", "frames", "depth.npy"}
    assert "reference: first 4 frames of frames" in found.provenance["notes"]
    assert found.codes == {f["code"].removeprefix("LID-") for f in whole["flags"]}


def test_the_answer_holds_what_a_user_must_know(made: Path, whole: dict[str, Any]) -> None:
    assert whole["markers"] == len(MARKERS)
    assert whole["lost"] == [0] * 7
    assert whole["reference"] == "first 4 frames of frames"
    assert "measured on 4 unloaded frames" in whole["noise"]
    assert ", by default, on the strongest whole frames" in whole["lambda_words"]
    assert whole["strongest"]["frame"] == pytest.approx(0.6)
    assert whole["strongest"]["force"] == pytest.approx(ForceMap.read(made / "a.h5").resultant().value[6])
    assert whole["written"] == [str(made / "a.h5")]


def test_a_stack_is_the_folder_and_a_span_its_part(
    made: Path, whole: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--unloaded", "4", "--frames", "6:7", "--lam", str(whole["lambda"])]
    assert run(made, tmp_path / "b.h5", *words, source="stack.npy") == 0
    said = capsys.readouterr().out
    first, part = ForceMap.read(made / "a.h5"), ForceMap.read(tmp_path / "b.h5")
    assert part.load == pytest.approx(first.load[5:], rel=1e-6, abs=1e-6 * np.abs(first.load).max())
    assert part.axis is not None
    assert part.axis.values.tolist() == [6.0, 7.0]
    assert "130 nodes" in said
    assert "strongest of 2 frames (frame 7)" in said
    assert "as stated" in said


def test_motions_in_px_are_read_through_the_camera(made: Path, tmp_path: Path) -> None:
    assert run(made, tmp_path / "c.h5", "--unloaded", "4", source="places.csv") == 0
    found = ForceMap.read(tmp_path / "c.h5")
    assert found.facts["lost"][5] == 2  # one marker is not in the file, along x and y
    for k, press in enumerate(PRESSES):
        assert off(found, UNLOADED + k, press) < 0.05


def test_motions_in_a_length_need_no_camera(made: Path, tmp_path: Path) -> None:
    body = FILE[: FILE.index("[camera]")] + '[markers]\nunit = "mm"\nnoise = "0.5 um"\n'
    body += "[contact]\npenalty = 'identity'\n"
    (tmp_path / "pad.toml").write_text(body, encoding="utf-8")
    words = ["tactile", str(made / "moved.npy"), "--pad", str(tmp_path / "pad.toml"), "-o", str(tmp_path / "d.h5")]
    assert main([*words, "--unloaded", "4", "--no-pull"]) == 0
    found = ForceMap.read(tmp_path / "d.h5")
    assert found.provided["z"] == "tracked"
    assert found.pressure().min() > -1e-6 * found.pressure().max()
    for k, press in enumerate(PRESSES):
        assert off(found, UNLOADED + k, press) < 0.05


def test_the_product_of_the_stiffness(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(made, tmp_path / "e.h5", "--unloaded", "4", "--sensor", "gelslim") == 0
    assert "F = K U is a product" in capsys.readouterr().out
    found = ForceMap.read(tmp_path / "e.h5")
    assert set(found.units) == {"N"}
    assert off(found, 6, PRESSES[2]) < 0.1
    assert run(made, tmp_path / "e.h5", "--sensor", "gelslim", "--lam", "0.1") == 3
    assert "no lambda" in capsys.readouterr().err


def test_markers_alone_are_flagged(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(made, tmp_path / "f.h5", "--unloaded", "4", depth=False) == 0
    found = ForceMap.read(tmp_path / "f.h5")
    assert found.provided["z"] == "completed"
    assert "N606" in found.codes
    assert "completed, not measured" in capsys.readouterr().out


def test_dead_frames_are_named_and_the_others_answered(
    made: Path, whole: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Black, damaged, of another size, saturated, without markers: the forces of the others are what they were."""
    from PIL import Image

    images, maps = np.load(made / "stack.npy"), np.load(made / "depth.npy")
    order = [None, 0, 1, None, 2, 3, 4, None, 5, None, 6, None]
    rng, shape = np.random.default_rng(0), images[0].shape
    dead = iter([np.zeros(shape), None, np.zeros((60, 80)), np.full(shape, 255), rng.normal(120, 2, shape)])
    (tmp_path / "run").mkdir()
    for k, i in enumerate(order):
        image, path = images[i] if i is not None else next(dead), tmp_path / "run" / f"{k + 1}.png"
        path.write_bytes(b"") if image is None else Image.fromarray(np.asarray(image, np.uint8)).save(path)
    np.save(tmp_path / "depth.npy", maps[[0 if i is None else i for i in order]])
    words = ["tactile", str(tmp_path / "run"), "--pad", str(made / "pad.toml"), "--depth", str(tmp_path / "depth.npy")]
    words += ["-o", str(tmp_path / "a.h5"), "--unloaded", "6", "--lam", str(whole["lambda"])]
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [one["frame"] for one in told["skipped"]] == [1, 4, 8, 10, 12]
    assert "another size" in told["skipped"][2]["why"]
    found, like = ForceMap.read(tmp_path / "a.h5"), ForceMap.read(made / "a.h5")
    assert found.axis is not None
    assert found.axis.values.tolist() == [k + 1 for k, i in enumerate(order) if i is not None]
    assert found.load == pytest.approx(like.load, rel=1e-6, abs=1e-6 * np.abs(like.load).max())
    assert any("frames 1, 4, 8, 10, 12 left out" in f["message"] for f in told["flags"])
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "left out" in said
    assert "5 of 12 frames: 1, 10, 12 (" in said


def test_dead_frames_among_the_unloaded_ones(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without --unloaded: a damaged first file, and a black frame that is the last of the five taken as unloaded."""
    from PIL import Image

    images = np.load(made / "stack.npy")
    (tmp_path / "run").mkdir()
    for k, image in enumerate([None, *images[:4], np.zeros_like(images[0]), *images[4:]]):
        path = tmp_path / "run" / f"{k + 1}.png"
        path.write_bytes(b"") if image is None else Image.fromarray(image).save(path)
    words = ["tactile", str(tmp_path / "run"), "--pad", str(made / "pad.toml"), "-o", str(tmp_path / "a.h5"), "--json"]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)
    assert [one["frame"] for one in told["skipped"]] == [1, 6]
    assert told["reference"] == "first 6 frames of run, 1 of them unusable"
    assert told["markers"] == len(MARKERS)
    assert not told["notes"]


def test_an_input_of_dead_frames_is_an_error(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = np.load(made / "stack.npy")
    np.save(tmp_path / "dead.npy", np.concatenate([images[:4], np.zeros_like(images[:2])]))
    words = ["tactile", str(tmp_path / "dead.npy"), "--pad", str(made / "pad.toml"), "-o", str(tmp_path / "a.h5")]
    assert main([*words, "--unloaded", "4", "--frames", "5:6"]) == 3
    assert "no marker" in capsys.readouterr().err
    assert not (tmp_path / "a.h5").exists()
    np.save(tmp_path / "dead.npy", np.zeros_like(images))
    assert main(words) == 3
    assert "no dots" in capsys.readouterr().err


def test_frames_that_were_not_unloaded_are_noticed(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "late.npy", np.load(made / "stack.npy")[1:])
    np.save(tmp_path / "depth.npy", np.load(made / "depth.npy")[1:])
    words = ["tactile", str(tmp_path / "late.npy"), "--pad", str(made / "pad.toml"), "-o", str(tmp_path / "g.h5")]
    assert main([*words, "--depth", str(tmp_path / "depth.npy")]) == 0
    said = capsys.readouterr().out
    assert "first 5 frames of late.npy" in said
    assert "taken as unloaded, but the markers move" in said


def test_unloaded_frames_of_their_own(made: Path, tmp_path: Path) -> None:
    stack, depth = np.load(made / "stack.npy"), np.load(made / "depth.npy")
    np.save(tmp_path / "rest.npy", stack[:4])
    np.save(tmp_path / "press.npy", stack[4:])
    np.save(tmp_path / "depth.npy", depth[4:])
    words = ["tactile", str(tmp_path / "press.npy"), "--pad", str(made / "pad.toml"), "-o", str(tmp_path / "h.h5")]
    assert main([*words, "--depth", str(tmp_path / "depth.npy"), "--unloaded", str(tmp_path / "rest.npy")]) == 0
    assert off(ForceMap.read(tmp_path / "h.h5"), 2, PRESSES[2]) < 0.05


# -- depth maps -------------------------------------------------------------------------------------------------------
def test_depth_maps_of_any_kind(made: Path, tmp_path: Path) -> None:
    from PIL import Image

    kind = padfile.DepthKind(pixel=1e-3, noise=1e-5, factor=-1e-6, absolute=True)
    counts = np.array(
        [np.arange(80).reshape(8, 10) + 100, np.arange(80).reshape(8, 10) * 7, np.zeros((8, 10))], np.uint16
    )
    for k, map_ in enumerate(counts):
        Image.fromarray(map_).save(tmp_path / f"d{9 + k}.png")  # d9, d10, d11: natural order
    np.savez(tmp_path / "d.npz", depth=counts.astype(float))
    for path in (tmp_path, tmp_path / "d.npz"):
        maps = depth_maps(path, kind, Path("pad.toml"))
        assert len(maps) == 3
        assert maps[1].values == pytest.approx(-1e-6 * counts[1].astype(float))
        zeroed = maps.zeroed(2)
        assert zeroed[1].values == pytest.approx(-1e-6 * (counts[1] - counts[:2].mean(axis=0)), abs=1e-12)
        with pytest.raises(InputError, match="need unloaded frames"):
            maps.zeroed(0)
    with pytest.raises(InputError, match=r"pad.toml: .*not described"):
        depth_maps(tmp_path, None, Path("pad.toml"))
    with pytest.raises(InputError, match="no depth maps in a file of this kind"):
        depth_maps(made / "pad.toml", kind, Path("pad.toml"))


# -- what is refused --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("tactile {0}/frames", 2, "--pad PAD.toml, -o MAP.h5"),
        ("tactile {0}/none --pad {0}/pad.toml -o {1}/x.h5", 3, "no such file or folder"),
        ("tactile {0}/frames --pad {0}/none.toml -o {1}/x.h5", 3, "no such file"),
        ("tactile {0}/frames --pad {0}/pad.toml -o {1}/no/x.h5", 3, "folder does not exist"),
        ("tactile {0}/frames --pad {0}/pad.toml -o {1}/x.h5 --video {1}/x.mkv", 3, "no kind of video"),
        ("tactile {0}/frames --pad {0}/pad.toml -o {1}/x.h5 --frames 3", 2, "no span FIRST:LAST"),
        ("tactile {0}/frames --pad {0}/pad.toml -o {1}/x.h5 --frames 8:9", 3, "no such frames"),
        ("tactile {0}/frames --pad {0}/pad.toml -o {1}/x.h5 --unloaded 9", 3, "fewer frames"),
        ("tactile {0}/frames --pad {0}/pad.toml -o {1}/x.h5 --unloaded 2", 3, "too few unloaded frames"),
        ("tactile {0}/frames --pad {0}/pad.toml -o {1}/x.h5 --allow X1", 3, "--allow"),
        ("tactile {0}/frames --pad {0}/pad.toml -o {1}/x.h5 --lam best", 2, "no rule"),
        ("tactile {0}/frames --pad {0}/pad.toml -o {1}/x.h5 --depth {1}/short.npy", 3, "fewer depth maps"),
        ("tactile {0}/frames --pad {0}/pad.toml -o {1}/x.h5 --seed 1", 2, "for the demo only"),
        ("tactile demo --pad {0}/pad.toml", 2, "--out and --seed only"),
        ("tactile {0}/pad.toml --pad {0}/pad.toml -o {1}/x.h5", 3, "no frames in a file of this kind"),
        ("tactile {0}/moved.npy --pad {0}/pad.toml -o {1}/x.h5", 3, "motion in px has two coordinates"),
    ],
)
def test_mistakes_are_told_and_write_nothing(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str, code: int, said: str
) -> None:
    np.save(tmp_path / "short.npy", np.load(made / "depth.npy")[:5])
    assert main(words.format(made, tmp_path).split()) == code
    assert said in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["short.npy"]


def test_a_camera_is_needed_for_images(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "pad.toml").write_text(FILE[: FILE.index("[camera]")], encoding="utf-8")
    words = ["tactile", str(made / "frames"), "--pad", str(tmp_path / "pad.toml"), "-o", str(tmp_path / "x.h5")]
    assert main(words) == 3
    assert "no table [camera]" in capsys.readouterr().err


def test_advice_is_that_of_the_command_line(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flat = 'homography = [[25, 0, 160], [0, 25, 120], [0, 0, 1]]\nhomography_unit = "mm"\n'
    body = f"{FILE[: FILE.index('focal')]}{flat}{FILE[FILE.index('[depth]') :]}"
    (tmp_path / "pad.toml").write_text(body, encoding="utf-8")
    words = ["tactile", str(made / "frames"), "--pad", str(tmp_path / "pad.toml"), "-o", str(tmp_path / "x.h5")]
    assert main(words) == 3
    said = capsys.readouterr().err
    assert "LID-E603" in said
    assert "--allow E603 overrides" in said
    assert main([*words, "--allow", "E603", "--lam", "0.02"]) == 0
    assert "E603" in ForceMap.read(tmp_path / "x.h5").codes


def test_spans() -> None:
    assert span("2:5") == (2, 5)
    assert span(":5") == (1, 5)
    assert span("4:")[0] == 4
    assert span("4:")[1] > 10**6


def test_kinds_of_input(made: Path) -> None:
    kinds = {n: is_motion(made / n) for n in ("frames", "stack.npy", "moved.npy", "places.csv")}
    assert kinds == {"frames": False, "stack.npy": False, "moved.npy": True, "places.csv": True}
    followed = _eyes.PlaceTracker(np.zeros((3, 2)))
    motion = followed.step(np.array([[1.0, 2.0], [np.nan, np.nan], [0.0, 0.0]]))
    assert motion.lost.tolist() == [False, True, False]
    assert motion.moved[0].tolist() == [1.0, 2.0]


# -- help and demonstration -------------------------------------------------------------------------------------------
def test_the_help_lists_the_command_and_shows_examples(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    assert "tactile" in capsys.readouterr().out
    assert main(["tactile", "--help"]) == 0
    assert "tactile demo --out tactile-demo" in capsys.readouterr().out


def test_the_demonstration_and_the_examples_of_the_help_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("cv2")  # one of the examples writes an MP4
    monkeypatch.chdir(tmp_path)
    coarse = padfile.EXAMPLE.replace('"1 mm"', '"1.5 mm"').replace('"0.1 mm"', '"0.2 mm"').replace('"10 um"', '"5 um"')
    monkeypatch.setattr(padfile, "EXAMPLE", coarse)
    for name, value in (("LOADED", 2), ("ROWS", 16), ("COLUMNS", 16)):
        monkeypatch.setattr(demo, name, value)
    monkeypatch.setattr(film, "DPI", 40)
    lines = EXAMPLES.replace("\\\n", " ").splitlines()
    commands = [shlex.split(line)[1:] for line in lines if line.strip().startswith("loadid tactile")]
    assert [words[1] for words in commands[2:]] == ["live", "live"]
    assert len(commands) == 4
    assert main([*commands[0], "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["against_truth"]["resultant_error"] < 0.06
    assert said["against_truth"]["peak_ratio"] == pytest.approx(1, abs=0.15)
    assert said["against_truth"]["radius_ratio"] == pytest.approx(1, abs=0.1)
    assert said["against_truth"]["cosine"] > 0.95
    assert "LID-W112" not in {flag["code"] for flag in said["flags"]}  # pressed within the linear range
    assert all((tmp_path / path).exists() for path in said["written"])
    assert main(commands[1]) == 0
    first, second = (ForceMap.read(path) for path in (tmp_path / "tactile-demo" / "map.h5", tmp_path / "map.h5"))
    assert np.array_equal(first.load, second.load)
    assert all((tmp_path / f"map.{kind}").stat().st_size > 1000 for kind in ("html", "png", "mp4"))
