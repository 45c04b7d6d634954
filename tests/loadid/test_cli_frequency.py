"""Frequency inversion from the command line, on a beam under random forces and under a hit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from loadid import LoadEstimate
from loadid.cli import main
from structures import ForwardModel, FrfModel, beams, damping, loads, sensors

DT = 1 / 2000
NODES = (8, 20, 31)


@pytest.fixture(scope="module")
def beam() -> ForwardModel:
    structure = beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=40,
        damping=damping.Modal(0.03),
    )  # fmt: skip
    seen = [sensors.Accelerometer(f"{n}+Z", label=f"a{n}") for n in NODES]
    return ForwardModel(structure, seen, [loads.Point("13+Z", label="force")], modes=8, residual=False)


@pytest.fixture(scope="module")
def files(beam: ForwardModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of 16 s under a band-limited random force, and the FRFs of its lines."""
    from scipy.signal import butter, lfilter

    folder = tmp_path_factory.mktemp("frequency")
    rng = np.random.default_rng(0)
    fine = 8
    force = lfilter(*butter(2, [20 * 2 * DT / fine, 300 * 2 * DT / fine], "band"), rng.standard_normal(32_000 * fine))
    y = beam.predict(50 * force[:, None], DT / fine)[::fine]
    y += 0.01 * y.std() * rng.standard_normal(y.shape)
    table = np.column_stack([np.arange(len(y)) * DT, y])
    head = "time [s]," + ",".join(f"a{n} [m/s^2]" for n in NODES)
    np.savetxt(folder / "log.csv", table, delimiter=",", header=head, comments="")
    f = np.fft.rfftfreq(4096, DT)
    FrfModel.of(beam, f[(f > 15) & (f < 320)]).save(folder / "model.h5")
    np.save(folder / "force.npy", force[::fine] * 50)
    return folder


def test_spectra_of_the_load(files: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    words = [
        "identify", files / "log.csv", "--model", files / "model.h5", "-o", tmp_path / "r.h5", "--family", "frequency",
        "--signal", "stationary", "--segment", "4096", "--band", "25:250", "--report", tmp_path / "r.html",
        "--plot", tmp_path / "r.png", "--json",
    ]  # fmt: skip
    assert main([str(w) for w in words]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert "LID-W508" not in {f["code"] for f in answer["flags"]}
    found = LoadEstimate.read(tmp_path / "r.h5")
    assert found.axis is not None
    assert found.units == ("(N)^2/Hz",)
    inside = (found.axis.values >= 25) & (found.axis.values <= 250)
    assert inside.all()
    from structures import cross_spectra

    known = cross_spectra(np.load(files / "force.npy")[:, None], DT, segment=4096)
    truth = np.interp(found.axis.values, known.frequencies, known.autospectra[:, 0])
    assert found.load.sum() / truth.sum() == pytest.approx(1.0, abs=0.03)
    assert "What every line can tell" in (tmp_path / "r.html").read_text()


def test_a_table_of_frfs_tells_what_it_covers(files: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["info", str(files / "model.h5")]) == 0
    said = capsys.readouterr().out
    assert "a20 [m/s^2]" in said
    assert "force [N]" in said


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ([], 3, "stationary"),  # the kind of signal is never guessed
        (["--signal", "transient"], 3, "lines of the table"),  # a record longer than they resolve
        (["--signal", "stationary", "--band", "9:3"], 2, "no band"),
        (["--signal", "stationary", "--truth", "a8"], 3, "truth"),
    ],
)
def test_refusals(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture, words: list[str], code: int, said: str
) -> None:
    out = tmp_path / "r.h5"
    base = ["identify", files / "log.csv", "--model", files / "model.h5", "-o", out, "--family", "frequency"]
    assert answer([str(w) for w in (*base, *words)]) == code
    assert said in capsys.readouterr().err
    assert not out.exists()


def answer(words: list[str]) -> int:
    """Exit code, whether it is returned or raised."""
    try:
        return int(main(words) or 0)
    except SystemExit as stop:
        return int(stop.code or 0)
