"""Whole jobs, from new to page, by commands alone: the figures against independent ones, locks, and refusals."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loadid import cli
from structures.files import _modelfile as modelfile
from tests.data import measured

from . import jobs
from .jobs import guide


def state(folder: Path, name: str = "wing") -> dict[int, Any]:
    """Signatures by step, read by a plain TOML reader."""
    tree = tomllib.loads((folder / f"{name}.guide.toml").read_text("utf-8"))
    return {one["step"]: one for one in tree["signature"]}


def status(capsys: Any, *argv: str) -> dict[str, Any]:
    capsys.readouterr()
    assert guide("status", "--json", *argv) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


# -- static readings ---------------------------------------------------------------------------------------------------
def test_the_figures_are_those_of_plain_numpy(wing: Path) -> None:
    """Gain, shape and residual of step 2, rank and condition of steps 3 and 4, written out by hand."""
    signed, model = state(wing), jobs.wing(40, jobs.PATCHES)
    rows = dict(line.split(",") for line in (wing / "hang.csv").read_text().splitlines()[1:])
    y, H = np.array([float(rows[c.label]) for c in model.sensors]), model.static()
    made = H[:, -1] * 400.0
    for k, c in enumerate(model.sensors):
        row = signed[2]["figures"]["sensors"][c.label]
        assert row["gain"] == pytest.approx(y[k] / made[k], rel=1e-9)
        assert row["residual"] == pytest.approx(abs(y[k] - made[k]) / abs(y[k]), rel=1e-6)
        assert row["times_noise"] == pytest.approx(abs(y[k] - made[k]) / jobs.NOISE, rel=1e-6)
    s = np.linalg.svd(H, compute_uv=False)
    assert signed[3]["figures"]["numbers"]["rank"] == np.linalg.matrix_rank(H) == 12
    assert signed[4]["figures"]["kappa"] == pytest.approx(s[0] / s[-1], rel=1e-6)
    assert signed[3]["figures"]["numbers"]["nullity"] == signed[4]["figures"]["nullity"] == 0
    assert 3 <= signed[4]["figures"]["recoverable_modes"] <= 6  # of a smooth lift, at this noise


def test_the_frozen_lambda_is_that_of_the_discrepancy(wing: Path) -> None:
    """The residual there is what noise alone exceeds in one of twenty: Tikhonov by augmented least squares."""
    from scipy.stats import chi2

    figures, model = state(wing)[7]["figures"], jobs.wing(40, jobs.PATCHES)
    rows = dict(line.split(",") for line in (wing / "service.csv").read_text().splitlines()[1:])
    y = np.array([float(rows[c.label]) for c in model.sensors]) / jobs.NOISE
    H, L = model.static() / jobs.NOISE, np.diff(np.eye(jobs.PATCHES), 2, axis=0)
    A = np.vstack([H, figures["absolute_lambda"] * L])
    g = np.linalg.lstsq(A, np.concatenate([y, np.zeros(len(L))]), rcond=None)[0]
    assert np.sum((y - H @ g) ** 2) == pytest.approx(chi2.ppf(0.95, len(y)), rel=1e-3)
    assert figures["rule"] == "discrepancy"
    assert {"gcv", "l_curve", "upre"} <= set(figures["witnesses"])
    assert figures["noise_source"].startswith("data sheet")


def test_the_inverse_and_the_frozen_job_give_the_load(wing: Path, capsys: Any) -> None:
    from loadid import LoadEstimate
    from loadid._families.frozen import Frozen

    figures = state(wing)[8]["figures"]
    inverse = Frozen.read(wing / figures["inverse"])
    assert cli.main(["identify", figures["frozen_job"], "-o", "load.h5"]) == 0
    e = LoadEstimate.read("load.h5")
    rows = dict(line.split(",") for line in (wing / "service.csv").read_text().splitlines()[1:])
    y = np.array([float(rows[label]) for label in inverse.sensors])
    np.testing.assert_allclose(inverse(y), np.ravel(e.load), rtol=1e-9)
    assert e.choice.lam == figures["lam"] == state(wing)[7]["figures"]["lam"]


def test_both_levels_are_reached_with_both_kinds_of_evidence(wing: Path, capsys: Any) -> None:
    two = state(wing)[9]["figures"]
    assert (two["level"], two["partial"], two["agrees"]) == ("distribution", False, True)
    assert set(two["kinds"]) == {"distribution", "resultant"}
    assert guide("sign", 9, "--evidence", "cell.csv") == 0
    one = state(wing)[9]["figures"]
    assert (one["level"], one["partial"], one["kinds"]) == ("resultant", True, ["resultant"])
    assert guide("sign", 9, "--evidence", "plain.csv") == 3
    assert "nothing that is known of its load" in capsys.readouterr().err


def test_a_gain_that_moved_is_seen_and_noise_is_no_drift(wing: Path, capsys: Any) -> None:
    assert state(wing)[10]["holds"] is True
    assert guide("sign", 10, "--evidence", "aged.csv") == 0
    one = state(wing)[10]
    assert one["holds"] is False
    assert one["figures"]["largest_drift"] == pytest.approx(0.3, abs=0.05)
    answer = status(capsys)
    assert (answer["next"]["step"], answer["next"]["state"]) == (10, "does not hold")
    assert guide("sign", 10, "--evidence", "plain.csv") == 0  # no known load: a watch over the sensors
    assert state(wing)[10]["figures"]["known_load"] is False
    assert guide("sign", 10, "--evidence", "hang.csv") == 3
    assert "the one of step 2" in capsys.readouterr().err


def test_constraints_and_an_unloaded_record_are_computed(begun: Path) -> None:
    (begun / "wing.toml").write_text((begun / "wing.toml").read_text() + "nonnegative = true\n")
    quiet = np.random.default_rng(1).standard_normal((200, 12)) * 2 * jobs.NOISE
    head = "time [s]," + ",".join(f"g{k} [m/m]" for k in range(1, 13))
    rows = [",".join(repr(float(v)) for v in (0.01 * k, *row)) for k, row in enumerate(quiet)]
    (begun / "quiet.csv").write_text("\n".join([head, *rows, ""]))
    jobs.signed(begun, [2, 5, 7, 8], evidence=jobs.WING | {7: ["quiet.csv"]})
    signed = state(begun)
    assert signed[5]["figures"]["constraints"] == {"nonnegative": True}
    assert signed[5]["figures"]["load_moved_by"] < 0.05
    noise = np.array([*signed[7]["figures"]["noise"].values()])
    np.testing.assert_allclose(noise, quiet.std(axis=0, ddof=1), rtol=1e-9)
    assert signed[8]["figures"]["product"] is False  # signs need a solver
    assert tomllib.loads((begun / "wing.frozen.toml").read_text())["noise_source"] == "quiet"


# -- locks -------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("number", range(3, 11))
def test_nothing_is_signed_before_the_model_is_verified(begun: Path, capsys: Any, number: int) -> None:
    before = (begun / "wing.guide.toml").read_bytes()
    assert guide("sign", number, "--evidence", "sand.csv") == 3
    said = capsys.readouterr().err
    assert "locked until step 2 verify the forward model is signed" in said
    assert "loadid guide sign 2 --job wing.toml --evidence RECORD" in said
    assert (begun / "wing.guide.toml").read_bytes() == before


def test_a_model_that_is_wrong_is_not_verified(begun: Path, capsys: Any) -> None:
    assert guide("sign", 2, "--evidence", "swapped.csv") == 3
    assert "does not predict g1, g2" in capsys.readouterr().err
    assert guide("sign", 2, "--evidence", "plain.csv") == 3
    assert "--truth CH" in capsys.readouterr().err
    assert guide("sign", 2) == 3
    assert "evidence is missing" in capsys.readouterr().err
    assert [one["state"] for one in status(capsys)["steps"]] == ["open", "open", *["locked"] * 8]


def test_a_certificate_in_the_model_file_is_enough(begun: Path) -> None:
    model = modelfile.load("wing.h5")
    model.verify(np.eye(12)[-1], 1.01 * model.static()[:, -1], source="unit load of a rig")
    model.save("wing.h5")
    assert guide("sign", 2) == 0
    one = state(begun)[2]
    assert one["said"].startswith("verified against unit load of a rig")
    assert one["figures"]["sensors"]["g3"]["gain"] == pytest.approx(1.01)


def test_the_record_that_made_the_model_does_not_verify_it(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    from loadid import datasets

    monkeypatch.chdir(tmp_path)
    datasets.hammer_test(".")
    hits = ["hit1.csv", "hit2.csv"]
    assert cli.main(["calibrate", *hits, "--force", "hammer", "--response", "acc1,acc2", "-o", "m.h5"]) == 0
    assert guide("new", "job.toml", "--log", "unknown.csv", "--model", "m.h5") == 0
    assert guide("sign", 1, "--evidence", *hits, "hit3.csv") == 0
    made = state(tmp_path, "job")[1]["figures"]["made_from"]
    assert {name: row["in_the_model"] for name, row in made.items()} == {
        "hit1.csv": True, "hit2.csv": True, "hit3.csv": False,
    }  # fmt: skip
    assert guide("sign", 2, "--evidence", "hit1.csv", "--truth", "hammer") == 3
    assert "made from this very record" in capsys.readouterr().err
    assert guide("sign", 2, "--evidence", "hit3.csv", "--truth", "hammer") == 0
    assert state(tmp_path, "job")[2]["figures"]["sensors"]["acc1"]["gain"] == pytest.approx(1.0, abs=0.02)


# -- histories ---------------------------------------------------------------------------------------------------------
def test_a_hit_from_new_to_page_by_commands_alone(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.chdir(tmp_path)
    jobs.beam_job(tmp_path)
    assert guide("new", "beam.toml", "--log", "log.csv", "--model", "model.h5") == 0
    hammer = ["--truth", "hammer"]
    for number in range(1, 11):
        files = {1: ["drawing.pdf"], 2: ["hit0.csv", *hammer], 9: ["hit1.csv", *hammer], 10: ["hit2.csv", *hammer]}
        given = ["--evidence", *files[number]] if number in files else []
        assert guide("sign", number, *given) == 0, capsys.readouterr().err
    signed = state(tmp_path, "beam")
    assert signed[2]["figures"]["sensors"]["12+Z"]["gain"] == pytest.approx(1.0, abs=0.01)
    assert signed[4]["figures"]["of_modes"] == signed[4]["figures"]["n"] == 400
    assert signed[9]["figures"]["level"] == "distribution"
    assert signed[10]["figures"]["largest_drift"] == pytest.approx(0.0, abs=0.01)
    assert status(capsys)["next"] is None
    assert guide("page", "-o", "beam.html") == 0
    page = (tmp_path / "beam.html").read_text("utf-8")
    assert "10 of 10" in page
    assert "Signed with cautions, which are listed below: step 7 lambda, then frozen" in page  # the rules disagree
    assert signed[7]["figures"]["verdict"] == "not determined"
    assert signed[8]["figures"]["differs_by"] < 1e-6  # of step 7: one lambda, one load
    assert "agreement of the rules" in page


def test_modes_of_a_record_are_those_of_the_dense_matrix() -> None:
    """A smooth load behind a strain-like response: as many coefficients above the noise as the Toeplitz SVD shows."""
    from scipy.linalg import toeplitz

    from loadid._guide.modes import line_modes
    from structures import ImpulseModel

    rng, samples, dt = np.random.default_rng(0), 256, 1e-3
    t = np.arange(2 * samples) * dt
    h = np.exp(-80 * t) * np.sin(2 * np.pi * 60 * t + 0.3)
    load = np.exp(-(((t[:samples] - 0.1) / 0.004) ** 2))
    y = np.convolve(load, h)[:samples] + 0.02 * rng.standard_normal(samples)
    found = line_modes(ImpulseModel(h[:, None, None], dt, kind="held"), y[:, None], dt, np.array([0.02]), load[:, None])
    u, s, _ = np.linalg.svd(toeplitz(h[:samples], np.zeros(samples)))
    dense = int(np.sum((u.T @ y) ** 2 > 0.02**2 * 6.635))  # 1 % of chi-square with one degree of freedom
    assert found.recoverable == pytest.approx(dense, rel=0.25)
    assert found.rank == found.unknowns == samples
    assert found.condition == pytest.approx(s[0] / s[-1], rel=0.5)


def test_the_measured_cantilever_on_its_lines(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    """Test 1 made the FRFs, test 3 verifies them, test 2 is the job; its load cell validates."""
    log = measured("cantilever_shaker", "cantilever_shaker.npz")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "shaker.npz").symlink_to(log)
    read = ["--fs", "3200", "--unit", "drive_V=V", "--unit", "force_lbf=lbf", "--unit", "acc_g=g"]
    made = ["calibrate", "shaker.npz", "--record", "test1", "--excitation", "shaker", "--force", "force_lbf",
            "--response", "acc_g", "--between", "3:19.7", "--segment", "320", "--coherence", "0.99", "--band", "80:170",
            "--frf-error", "0.05", "--interpolate", *read, "-o", "model.h5"]  # fmt: skip
    assert cli.main(made) == 0
    (tmp_path / "job.toml").write_text(
        'log = "shaker.npz"\nmodel = "model.h5"\nrecord = "test2"\nfamily = "frequency"\nsignal = "transient"\n'
        'choice = 0.0\n[reading]\nfs = 3200\nunits = {drive_V = "V", force_lbf = "lbf", acc_g = "g"}\n'
    )
    assert guide("new", "job.toml") == 0
    evidence = ["--evidence", "shaker.npz", "--truth", "force_lbf"]
    assert guide("sign", 2, *evidence, "--record", "test3", *read) == 0, capsys.readouterr().err
    row = state(tmp_path, "job")[2]["figures"]["sensors"]["acc_g"]
    assert row["gain"] == pytest.approx(1.0, abs=0.1)  # a tenth at another level, as the case study says
    assert row["residual"] < 0.15
    for number in range(3, 9):
        assert guide("sign", number) == 0, (number, capsys.readouterr().err)
    assert guide("sign", 9, *evidence, "--record", "test2") == 0, capsys.readouterr().err
    signed = state(tmp_path, "job")
    assert signed[4]["figures"]["of_lines"] > 0
    assert signed[9]["figures"]["level"] == "distribution"
    assert "W704" in str(signed[9]["flags"])  # lambda was chosen on this very record


# -- words -------------------------------------------------------------------------------------------------------------
def test_status_says_the_next_step_and_what_to_type(begun: Path, capsys: Any) -> None:
    answer = status(capsys)
    assert answer["next"]["command"] == "loadid guide sign 1 --job wing.toml --evidence FILE..."
    assert guide("status") == 0
    assert capsys.readouterr().out.startswith("next: step 1 characterise the material or structure (open)\n")
    assert guide("sign", "1", "--evidence", "report.pdf", "--preview") == 0
    assert "nothing is written" in capsys.readouterr().out
    assert status(capsys)["steps"][0]["state"] == "open"
    assert guide("sign", "1", "--evidence", "report.pdf", "--note", "alloy 2024-T3, batch 7") == 0
    one = status(capsys)["steps"][0]
    assert (one["state"], one["signature"]["note"]) == ("signed", "alloy 2024-T3, batch 7")
    assert one["signature"]["evidence"]["report.pdf"]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["sign"], 2, "name the step"),
        (["sign", "11"], 3, "a number from 1 to 10"),
        (["sign", "penalti"], 3, "penalty"),
        (["sign", "1", "--evidence", "gone.pdf"], 3, "no such file"),
        (["sign", "1", "--evidence", "."], 3, "this is no file"),
        (["new"], 2, "name the job"),
        (["new", "wing.toml"], 3, "has a guide already"),
        (["new", "other.toml"], 3, "other.toml"),
        (["new", "wing.h5"], 3, "a job is a TOML file"),
        (["new", "b.toml", "--log", "service.csv"], 3, "a job needs both"),
        (["status", "--job", "nothing.toml"], 3, "loadid guide new"),
        (["page", "-o", "page.pdf"], 3, "page.html"),
        (["page", "-o", "wing.toml"], 3, "file that the command reads"),
        (["sine"], 2, "did you mean sign"),
    ],
)
def test_a_mistake_is_answered_with_what_to_do(wing: Path, capsys: Any, words: list[str], code: int, said: str) -> None:
    before = (wing / "wing.guide.toml").read_bytes()
    assert guide(*words) == code
    error = capsys.readouterr().err
    assert said in error
    assert (wing / "wing.guide.toml").read_bytes() == before


def test_the_line_to_type_is_right_from_another_folder(wing: Path, monkeypatch: Any, capsys: Any) -> None:
    (wing / "report.pdf").write_bytes(b"another")
    monkeypatch.chdir(wing.parent)
    answer = status(capsys, "--job", "job/wing.toml")
    assert answer["next"]["command"] == "loadid guide sign 1 --job job/wing.toml --evidence FILE..."
    assert guide("sign", 1, "--job", "job/wing.toml", "--evidence", "job/report.pdf") == 0
    assert state(wing)[1]["evidence"].keys() == {"report.pdf"}


def test_what_the_guide_does_not_take_is_refused_by_name(begun: Path, capsys: Any) -> None:
    (begun / "place.toml").write_text('log = "service.csv"\nmodel = "wing.h5"\nfamily = "location"\n')
    assert guide("new", "place.toml") == 3
    assert "no lambda that could be frozen" in capsys.readouterr().err
    (begun / "second.toml").write_text((begun / "wing.toml").read_text())
    assert guide("new", "second.toml") == 0
    assert guide("status") == 3
    assert "several guides are here" in capsys.readouterr().err
