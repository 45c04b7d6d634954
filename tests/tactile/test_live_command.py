"""``loadid tactile live`` from pad file to lines, and images that come through a pipe."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from loadid.cli import main
from structures.errors import InputError
from tactile import Pad, Press, frames
from tactile._arrays import UnusableFrame
from tactile._pad import padfile
from tactile.live import State, replay
from tactile.vision._frames import each
from tactile.vision._images import Scene

from .test_command import FILE, MARKERS

ROOT = Path(__file__).resolve().parents[2]
ENV = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
STILL, HELD = 24, 8  # frames of the unloaded pad, then of a press


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pad file, and frames as a stack and as they come through a pipe."""
    folder = tmp_path_factory.mktemp("clip")
    (folder / "pad.toml").write_text(f"{FILE}[contact]\nlam = 0.002\npenalty = 'identity'\n", encoding="utf-8")
    settings = padfile.read(folder / "pad.toml")
    fine = Pad.from_settings(replace(settings, body={**settings.body, "pitch": 0.5e-3, "layers": 6}))
    scene = Scene(size=(240, 320), radius=0.22e-3, blur=1.0, noise=2.0)
    pressed = fine.surface.forces(Press(radius=2.2e-3, force=2e-3, shear=(0.08, 0.0)).traction(fine.nodes2d))
    moved = np.asarray(fine.from_surface(MARKERS) @ fine.displacements(pressed).ravel()).reshape(-1, 3)
    flat = np.column_stack([MARKERS, np.zeros(len(MARKERS))])
    assert settings.view is not None
    images = [scene.photograph(settings.view, flat + (k >= STILL) * moved, seed=k) for k in range(STILL + HELD)]
    images.insert(STILL, np.zeros_like(images[0]))
    np.save(folder / "clip.npy", np.array(images))
    (folder / "clip.pgm").write_bytes(b"".join(b"P5\n# a camera\n320 240\n255\n" + i.tobytes() for i in images))
    return folder


def run(clip: Path, out: Path, *words: str, camera: str = "clip.npy") -> int:
    """Run the command on the clip."""
    return main(["tactile", "live", "--pad", str(clip / "pad.toml"), "--camera", str(clip / camera), "--rate", "30",
                 "--state", str(out / "state.h5"), *words])  # fmt: skip


def test_frames_become_lines(clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(clip, tmp_path, "--record", str(tmp_path / "run.h5"), "--quiet", "0.2") == 0
    said = capsys.readouterr()
    rows = [json.loads(text) for text in said.out.splitlines()]
    assert [row["number"] for row in rows] == [k for k in range(1, STILL + HELD - 8) if k != STILL - 9]
    assert rows[-1]["touched"]
    assert not rows[0]["touched"]
    assert rows[-1]["force"][0] == pytest.approx(0.08, rel=0.05)
    assert [e["state"] for row in rows for e in row["events"] if e["kind"] == "no image"] == ["begins", "ends"]
    assert "1 dead" in said.err
    assert len(list(replay(tmp_path / "run.h5", speed=None))) == len(rows)
    assert main(["tactile", "live", "--replay", str(tmp_path / "run.h5"), "--speed", "50"]) == 0
    again = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    for one, like in zip(again, rows, strict=True):
        assert one["force"] == pytest.approx(like["force"], rel=1e-5, abs=1e-9)
        assert {k: one[k] for k in ("number", "time", "flags", "on", "events", "touched")} == {
            k: like[k] for k in ("number", "time", "flags", "on", "events", "touched")
        }
    assert main(["tactile", "live", "--replay", str(tmp_path / "run.h5"), "--speed", "50", "--lines", "events"]) == 0
    assert {json.loads(text)["kind"] for text in capsys.readouterr().out.splitlines()} >= {"no image"}


def test_the_next_start_needs_no_unloaded_frames(
    clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(clip, tmp_path, "--lines", "none") == 0
    capsys.readouterr()
    np.save(tmp_path / "held.npy", np.load(clip / "clip.npy")[-HELD:])
    assert run(clip, tmp_path, camera=str(tmp_path / "held.npy")) == 0
    rows = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    assert rows[0]["number"] == STILL + HELD + 1 - 10 + 1
    assert all(row["touched"] for row in rows)
    assert rows[-1]["force"][0] == pytest.approx(0.08, rel=0.05)
    other = FILE.replace("0.147", "0.2")
    (tmp_path / "pad.toml").write_text(f"{other}[contact]\nlam = 0.002\n", encoding="utf-8")
    words = ["tactile", "live", "--pad", str(tmp_path / "pad.toml"), "--camera", str(tmp_path / "held.npy")]
    assert main([*words, "--state", str(tmp_path / "state.h5")]) == 3
    assert "the state is of another pad" in capsys.readouterr().err


def test_lambda_is_chosen_on_a_press_that_is_simulated(
    clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "pad.toml").write_text(FILE, encoding="utf-8")
    words = ["tactile", "live", "--pad", str(tmp_path / "pad.toml"), "--camera", str(clip / "clip.npy")]
    assert main([*words, "--state", str(tmp_path / "s.h5"), "--lines", "events"]) == 0
    told = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    assert [(e["kind"], e["state"]) for e in told] == [("no image", "begins"), ("no image", "ends")]
    lam = State.read(tmp_path / "s.h5").lam
    assert lam is not None
    assert 1e-4 < lam < 0.5


def test_a_pipe_a_port_a_page_and_a_signal(clip: Path, tmp_path: Path) -> None:
    """A process that reads a pipe, sends lines, shows a page, and ends well when it is told to."""
    words = ["--pad", str(clip / "pad.toml"), "--camera", "-", "--state", "state.h5", "--port", "0", "--view", "0"]
    process = subprocess.Popen([sys.executable, "-m", "loadid.cli", "tactile", "live", *words], cwd=tmp_path, env=ENV,
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdin.write((clip / "clip.pgm").read_bytes())
    process.stdin.flush()
    where = [process.stderr.readline().decode().rsplit(maxsplit=1)[-1] for _ in range(2)]
    for _ in range(STILL + HELD - 10):
        row = json.loads(process.stdout.readline())
    assert row["touched"]
    assert "<canvas" in urllib.request.urlopen(where[1], timeout=5).read().decode()
    assert int(where[0].rpartition(":")[2]) > 0
    time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 0
    assert b"maps" in err
    assert State.read(tmp_path / "state.h5").number == STILL + HELD + 1 - 10


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("tactile live", 2, "--camera (with --pad), or --replay"),
        ("tactile live --camera 0", 2, "--pad PAD.toml"),
        ("tactile live --camera 0 --replay a.h5", 2, "--camera (with --pad), or --replay"),
        ("tactile live --replay a.h5 --state s.h5", 2, "--state is for a camera"),
        ("tactile live --pad {0}/pad.toml --camera 0 --speed 2", 2, "--speed is for --replay"),
        ("tactile live --pad {0}/pad.toml --camera 0 -o a.h5", 2, "live takes no -o"),
        ("tactile live --pad {0}/pad.toml --camera 0 --port 99999", 2, "no port"),
        ("tactile {0}/clip.npy --pad {0}/pad.toml -o {1}/a.h5 --view 0", 2, "--view is for live only"),
        ("tactile live --replay {1}/a.h5", 3, "no such file"),
        ("tactile live --pad {0}/pad.toml --camera {1}/none", 3, "no such file or folder"),
        ("tactile live --pad {0}/pad.toml --camera {0}/clip.npy --record {1}/a.bag", 3, "no kind of recording"),
    ],
)
def test_mistakes_are_told(
    clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str, code: int, said: str
) -> None:
    assert main(words.format(clip, tmp_path).split()) == code
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


# -- pipes ------------------------------------------------------------------------------------------------------------
def encoded(image: np.ndarray, kind: str) -> bytes:
    buffer = io.BytesIO()
    if kind == "NPY":
        np.save(buffer, image)
    elif kind == "P5 of 16 bits":
        return b"P5 160 120 65535\n" + (256 * image.astype(np.uint16)).astype(">u2").tobytes()
    else:
        Image.fromarray(image).save(buffer, format=kind, **({"quality": 95} if kind == "JPEG" else {}))
    return buffer.getvalue()


class Trickle(io.RawIOBase):
    """Bytes that come a few at a time, as through a pipe."""

    def __init__(self, data: bytes, piece: int) -> None:
        self.data, self.piece = data, piece

    def readable(self) -> bool:
        return True

    def readinto(self, into: Any) -> int:
        part, self.data = self.data[: min(self.piece, len(into))], self.data[min(self.piece, len(into)) :]
        into[: len(part)] = part
        return len(part)


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    scene = Scene(size=(120, 160), radius=5.0, noise=2.0)
    return [scene.draw(np.array([[40.0 + k, 50.0], [90.0, 60.0 + k]]), seed=k) for k in range(4)]


@pytest.mark.parametrize("kind", ["PPM", "PNG", "JPEG", "NPY", "P5 of 16 bits"])
@pytest.mark.parametrize("piece", [7, 1 << 20])
def test_every_kind_of_pipe_gives_its_images(pictures: list[np.ndarray], kind: str, piece: int) -> None:
    data = b"".join(encoded(image, kind) for image in pictures)
    found = list(frames(Trickle(data, piece)))
    alone = [np.asarray(Image.open(io.BytesIO(encoded(i, kind)))) for i in pictures] if kind == "JPEG" else pictures
    assert len(found) == len(pictures)
    for one, like in zip(found, alone, strict=True):
        assert np.array_equal(one, like)
    if kind in ("PPM", "PNG"):
        colour = encoded(np.repeat(pictures[0][..., None], 3, axis=2), kind)
        assert np.abs(next(frames(Trickle(colour, piece))).astype(int) - pictures[0]).max() <= 1  # rounded down


def test_what_is_damaged_in_a_pipe(pictures: list[np.ndarray]) -> None:
    """A picture that cannot be decoded is passed over; one that is cut ends the pipe, and what is none is refused."""
    png = [bytearray(encoded(image, "PNG")) for image in pictures]
    png[1][60] ^= 255
    told = list(each(frames(io.BytesIO(b"".join(map(bytes, png))))))
    assert [isinstance(one, UnusableFrame) for one in told] == [False, True, False, False]
    for kind in ("PPM", "PNG", "JPEG", "NPY"):
        data = encoded(pictures[0], kind)
        told = list(each(frames(io.BytesIO(data + data[: len(data) // 2]))))
        assert [isinstance(one, UnusableFrame) for one in told] == [False, True]
        assert "the pipe ends within an image" in str(told[1])
    for wrong in (b"RIFF....", b"P5 16 x6 255\n", b"P5 99999999 99999999 255\n"):
        with pytest.raises(InputError, match=r"pipe|size that none has"):
            next(frames(io.BytesIO(wrong + b"\0" * 100)))
    with pytest.raises(InputError, match="no frames"):
        next(frames(io.BytesIO(b"")))
