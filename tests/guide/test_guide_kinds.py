"""Jobs of another kind: a tracker, hits whose variance is learned, and a gel pad, each from new to its last step."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from loadid import LoadTracker, datasets, read
from structures import ForwardModel, beams, damping, loads, sensors

from . import jobs
from .jobs import guide

SIDE, THICKNESS, NOISE = (14e-3, 12e-3), 3e-3, 2e-6


def state(name: str) -> dict[int, Any]:
    """Signatures by step, read by a plain TOML reader."""
    return {one["step"]: one for one in tomllib.loads(Path(f"{name}.guide.toml").read_text("utf-8"))["signature"]}


# -- a tracker ---------------------------------------------------------------------------------------------------------
def test_a_tracker_is_tuned_frozen_and_watched(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    datasets.mast_wind(".")
    mast = beams.cantilever(length=12.0, EI=4e6, mass_per_length=60.0, damping=damping.Modal(0.02))
    seen = [sensors.Accelerometer("20+Z", noise=0.02), sensors.StrainGauge(at=0.5, fibre=0.1, noise=2e-6, label="root")]
    wind = [loads.Point("20+Z", label="wind")]
    ForwardModel(mast, seen, wind, modes=4).save("mast.h5")
    lines = Path("commissioning.csv").read_text().splitlines(keepends=True)
    Path("log.csv").write_text("".join(lines[:900]))
    Path("today.csv").write_text("".join(lines[:1] + lines[900:1500]))
    t, rng = np.arange(600) / 200.0, np.random.default_rng(0)
    for name, hertz in (("pull.csv", 0.4), ("again.csv", 0.7)):  # twice the modes behind the data
        force = 300 * np.sin(2 * np.pi * hertz * t)
        y = ForwardModel(mast, seen, wind, modes=8).predict(force[:, None], 1 / 200)
        y = y + np.array([0.02, 2e-6]) * rng.standard_normal(y.shape)
        np.savetxt(name, np.column_stack([t, y, force]), delimiter=",", comments="",
                   header="time [s],20+Z [m/s^2],root [m/m],wind [N]")  # fmt: skip
    Path("mast.toml").write_text('log = "log.csv"\nmodel = "mast.h5"\nfamily = "tracker"\n')
    Path("drawing.pdf").write_bytes(b"%PDF")
    assert guide("new", "mast.toml") == 0
    jobs.signed(tmp_path, evidence={1: ["drawing.pdf"], 2: ["pull.csv"], 9: ["again.csv"], 10: ["today.csv"]})
    signed = state("mast")
    own = LoadTracker(ForwardModel(mast, seen, wind, modes=4)).fit(read("log.csv").select(["20+Z", "root"]))
    assert signed[7]["figures"]["numbers"] == pytest.approx(dict(own.fitted.numbers), rel=1e-6)
    assert signed[7]["figures"]["nis"] == pytest.approx(own.certificate.nis, rel=1e-6)
    assert signed[8]["figures"]["differs_by"] < 1e-9
    assert signed[9]["figures"]["level"] == "distribution"
    assert "mast.tracker.h5" in signed[7]["files"]
    Path("mast.tracker.h5").write_bytes(b"another")
    assert guide("sign", 9, "--evidence", "again.csv") == 3  # what was frozen is not what lies there


# -- hits --------------------------------------------------------------------------------------------------------------
def test_a_learned_variance_is_frozen_as_such(tmp_path: Path, monkeypatch: Any) -> None:
    """No noise is known of a measured model: the load is that of the package, to the last digit, near the hammer."""
    from loadid import Deconvolution, cli

    monkeypatch.chdir(tmp_path)
    datasets.hammer_test(".")
    made = ["calibrate", "hit1.csv", "hit2.csv", "--force", "hammer", "--response", "acc1,acc2", "-o", "beam.h5"]
    assert cli.main(made) == 0
    assert guide("new", "beam.toml", "--log", "unknown.csv", "--model", "beam.h5") == 0
    jobs.signed(tmp_path, (1, 3, 7, 8), evidence={1: ["hit1.csv"]}) if guide(
        "sign", 2, "--evidence", "hit3.csv", "--truth", "hammer"
    ) == 0 else pytest.fail("step 2")
    signed = state("beam")
    assert signed[7]["figures"]["frozen"] == {"variance": "local"}
    assert 0.03 < signed[7]["figures"]["one_lambda_differs_by"] < 0.1
    assert signed[8]["figures"]["differs_by"] == 0.0
    assert cli.main(["identify", "beam.frozen.toml", "-o", "load.h5"]) == 0
    from loadid import LoadEstimate
    from loadid._commands import load_model

    model, record = load_model("beam.h5"), read("unknown.csv")
    plain = Deconvolution(model).estimate(record.select(["acc1", "acc2"]))
    np.testing.assert_array_equal(LoadEstimate.read("load.h5").load, plain.load)
    known = read("hit3.csv")
    hammer, responses = known["hammer"], known.select(["acc1", "acc2"])
    off = {one: np.linalg.norm(Deconvolution(model, **one_of).estimate(responses).load[:, 0] - hammer)
           for one, one_of in (("frozen", {}), ("one lambda", {"choice": signed[7]["figures"]["lam"]}))}  # fmt: skip
    assert off["frozen"] < 0.02 * np.linalg.norm(hammer)
    assert off["one lambda"] > 3 * off["frozen"]


# -- a gel pad ---------------------------------------------------------------------------------------------------------
def pressed(name: str, force: float, seed: int) -> None:
    """Places of markers in five quiet frames and two of a press, by the closed form of the layer."""
    from tactile import Layer, Press

    x, y = np.meshgrid(np.linspace(-6e-3, 6e-3, 11), np.linspace(-5e-3, 5e-3, 9))
    dots, rng = np.column_stack([x.ravel(), y.ravel()]), np.random.default_rng(seed)
    moved = Press(radius=3e-3, force=force, shear=(0.2 * force, 0.2 * force)).displacement(
        Layer(THICKNESS, 147e3, 0.3223), dots
    )
    rest = np.column_stack([dots, np.zeros(len(dots))])
    frames = rest + np.array([0, 0, 0, 0, 0, 1, 1])[:, None, None] * moved
    np.save(name, frames + NOISE * rng.standard_normal(frames.shape))


PRESS = 'log = "{0}.npy"\nunloaded = 5\nframes = [6, 7]\nforce = ["{1} mN", "{1} mN", "-{2} N"]\n'
PLACE = 'at = ["0 mm", "0 mm"]\nradius = "3 mm"\n'
PAD = f"""[pad]
size = ["14 mm", "12 mm"]
thickness = "3 mm"
E = "0.147 MPa"
nu = 0.3223
pitch = "1.5 mm"
layers = 3
[markers]
unit = "m"
noise = "{1e6 * NOISE} um"
"""


@pytest.fixture(scope="module")
def pad_job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``gel.toml`` with frames and presses, signed to the end."""
    folder = tmp_path_factory.mktemp("gel")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for seed, (name, force) in enumerate((("log", 1.0), ("check", 1.0), ("other", 0.8), ("later", 1.0))):
            pressed(name, force, seed)
            Path(f"{name}.toml").write_text(PRESS.format(name, 200 * force, force) + PLACE)
        Path("sum.toml").write_text(PRESS.format("other", 160, 0.8))
        Path("pad.toml").write_text(PAD)
        Path("gel.toml").write_text('log = "log.npy"\nmodel = "pad.toml"\nframes = [6, 7]\n')
        Path("tensile.pdf").write_bytes(b"%PDF")
        assert guide("new", "gel.toml") == 0
        jobs.signed(folder, evidence={1: ["tensile.pdf"], 2: ["check.toml", "check.npy"], 9: ["sum.toml", "other.npy"],
                                      10: ["later.toml", "later.npy"]})  # fmt: skip
    return folder


def test_a_pad_is_signed_to_the_end(pad_job: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(pad_job)
    signed = state("gel")
    assert sorted(signed) == list(range(1, 11))
    assert signed[1]["figures"]["E_Pa"] == 147e3
    assert signed[8]["figures"]["product"]
    assert signed[8]["figures"]["differs_by"] < 1e-9
    assert (signed[9]["figures"]["level"], signed[9]["figures"]["partial"]) == ("resultant", True)
    assert abs(signed[10]["figures"]["largest_drift"]) < 0.02
    assert [k for k, one in signed.items() if not one["holds"]] == [9]  # a ridge on a coarse mesh: less than pressed
    assert not signed[9]["figures"]["agrees"]
    assert guide("page", "-o", "gel.html") == 0
    page = Path("gel.html").read_text("utf-8")
    assert "gel.toml" in page
    assert "m0+X to m98+Z (297)" in page  # markers that are alike take one row


def test_the_certificate_of_a_pad_is_that_of_its_finite_elements(pad_job: Path, monkeypatch: Any) -> None:
    """By nodal forces and motion of the pad, and not by the transfer matrix of the sensor."""
    from tactile import Pad, Press, metrics

    monkeypatch.chdir(pad_job)
    pad = Pad(size=SIDE, thickness=THICKNESS, E=147e3, nu=0.3223, pitch=1.5e-3, layers=3)
    frames = np.load("check.npy")
    rest, moved = frames[:5].mean(axis=0), frames[5:].mean(axis=0)
    tractions = metrics.means(
        Press(radius=3e-3, force=1.0, shear=(0.2, 0.2)),
        pad.nodes2d,
        float(np.sqrt(np.median(pad.surface.areas[~pad.edge]))),
    )
    nodes = pad.displacements(pad.surface.forces(tractions))
    made = np.asarray(pad.from_surface(rest[:, :2]) @ nodes.ravel()).reshape(-1, 3)
    for k, name in enumerate(("markers x", "markers y", "markers z")):
        row, seen = state("gel")[2]["figures"]["sensors"][name], (moved - rest)[:, k]
        assert row["gain"] == pytest.approx(made[:, k] @ seen / (made[:, k] @ made[:, k]), rel=1e-3)
        assert row["residual"] == pytest.approx(np.linalg.norm(seen - made[:, k]) / np.linalg.norm(seen), rel=2e-2)


def test_lambda_of_a_pad_leaves_what_its_certificate_left(pad_job: Path, monkeypatch: Any) -> None:
    """Tikhonov by stacked least squares, each reading weighed by the noise that step 2 left."""
    from tactile import Markers, MultilayerPad, Pad

    monkeypatch.chdir(pad_job)
    signed, frames = state("gel"), np.load("log.npy")
    rest = frames[:5].mean(axis=0)
    pad = Pad(size=SIDE, thickness=THICKNESS, E=147e3, nu=0.3223, pitch=1.5e-3, layers=3)
    H = MultilayerPad(pad, Markers(rest[:, :2], NOISE, "XYZ"), penalty="identity").model.H
    y = (frames[5:].mean(axis=0) - rest).ravel()
    left = [signed[2]["figures"]["sensors"][f"markers {axis}"]["times_noise"] for axis in "xyz"]
    std = NOISE * np.tile(np.maximum(left, 1.0), len(rest))
    A = np.vstack([H / std[:, None], signed[7]["figures"]["absolute_lambda"] * np.eye(H.shape[1])])
    g = np.linalg.lstsq(A, np.concatenate([y / std, np.zeros(H.shape[1])]), rcond=None)[0]
    assert signed[7]["figures"]["rule"] == "discrepancy"
    assert np.sum(((y - H @ g) / std) ** 2) == pytest.approx(chi2.ppf(0.95, len(y)), rel=2e-2)


@pytest.mark.parametrize(
    ("name", "text", "files", "said"),
    [
        ("alone.toml", PRESS.format("check", 200, 1.0) + PLACE, [], "the frames of a press are evidence too"),
        ("unit.toml", PRESS.format("check", 200, 1.0).replace("-1.0 N", "-1.0"), ["check.npy"], "with its unit"),
        ("half.toml", PRESS.format("check", 200, 1.0) + 'radius = "3 mm"\n', ["check.npy"], "go together"),
        ("key.toml", PRESS.format("check", 200, 1.0) + "radios = 3\n", ["check.npy"], "unknown"),
        ("sum.toml", "", ["other.npy"], "no known load"),
    ],
)
def test_presses_that_prove_nothing_are_refused(
    pad_job: Path, monkeypatch: Any, capsys: Any, name: str, text: str, files: list[str], said: str
) -> None:
    monkeypatch.chdir(pad_job)
    if text:
        Path(name).write_text(text)
    before = Path("gel.guide.toml").read_bytes()
    assert guide("sign", 2, "--evidence", name, *files) == 3
    assert said in capsys.readouterr().err
    assert Path("gel.guide.toml").read_bytes() == before


def test_a_changed_pad_makes_all_stale(pad_job: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    import shutil

    folder = tmp_path / "copy"
    shutil.copytree(pad_job, folder)
    monkeypatch.chdir(folder)
    Path("pad.toml").write_text(PAD.replace("0.147", "0.15"))
    capsys.readouterr()
    assert guide("status", "--job", "gel.toml") == 0
    said = capsys.readouterr().out
    assert "pad.toml has changed since it was signed" in said
    assert said.count("stale") >= 9
