"""Models from the command line are those of Python, and their frequencies those of closed forms."""

import json

import numpy as np
import pytest
from scipy import io, sparse

from loadid import cli
from loadid._commands import load_model
from structures import ForwardModel, beams, damping, loads, sensors
from tests.loadid.test_cli import installed, run

__all__ = ["installed", "run"]
BEAM = ["model", "beam", "--length", "300mm", "--section", "rectangle:40mm,10mm", "--material", "steel"]
HEARD = ["--sensor", "accelerometer:12+Z", "--load", "point:31+Z"]


def python(**changes):
    words = {"section": beams.Section.rectangle(0.04, 0.01), "material": beams.materials.steel, **changes}
    beam = beams.cantilever(length=0.3, damping=damping.Modal(0.02), **words)
    return ForwardModel(beam, [sensors.Accelerometer("12+Z")], [loads.Point("31+Z")], modes=6)


def test_a_beam_is_that_of_python_and_of_euler(run, tmp_path):
    code, out, err = run(*BEAM, *HEARD, "--damping", "0.02", "--modes", "6", "-o", tmp_path / "m.h5")
    assert code == 0, err
    assert "12+Z [m/s^2] acceleration" in out
    found = load_model(tmp_path / "m.h5")
    np.testing.assert_allclose(found.frf([50.0, 400.0]), python().frf([50.0, 400.0]), rtol=1e-9)
    roots = np.array([1.875104068711961, 4.694091132974174, 7.854757438237613])
    exact = roots**2 / (2 * np.pi * 0.3**2) * np.sqrt(210e9 * 0.01**2 / 12 / 7850)
    np.testing.assert_allclose(found.natural_frequencies[:3], exact, rtol=1e-4)
    answer = json.loads(run(*BEAM, *HEARD, "-o", tmp_path / "n.h5", "--json")[1])
    np.testing.assert_allclose(answer["frequencies"][:3], exact, rtol=1e-4)


def test_a_file_has_the_names_of_the_options(run, tmp_path):
    text = """
kind = "beam"
length = 0.3
section = "rectangle:0.04,0.01"
material = { E = 210e9, rho = "7.85 g/cm^3" }
damping = 0.02
modes = 6
sensors = ["accelerometer:12+Z"]
loads = ["point:31+Z"]
"""
    (tmp_path / "m.toml").write_text(text.replace('"7.85 g/cm^3"', "7850"))
    assert run("model", "--from", tmp_path / "m.toml", "-o", tmp_path / "a.h5")[0] == 0
    assert run(*BEAM, *HEARD, "--damping", "0.02", "--modes", "6", "-o", tmp_path / "b.h5")[0] == 0
    a, b = (load_model(tmp_path / f"{name}.h5") for name in "ab")
    np.testing.assert_allclose(a.frf([50.0]), b.frf([50.0]), rtol=1e-12)
    (tmp_path / "w.toml").write_text(text.replace("section", "sektion"))
    code, _, err = run("model", "--from", tmp_path / "w.toml", "-o", tmp_path / "c.h5")
    assert code == 3
    assert "did you mean section?" in err


def test_gauges_plates_and_frames(run, tmp_path):
    wing = ["model", "beam", "--length", "6", "--EI", "9e5", "--mass-per-length", "20", "--load", "point:x=5"]
    code, _, err = run(*wing, "--sensor", "strain:x=0.2,fibre=80mm,label=root", "-o", tmp_path / "w.h5")
    assert code == 0, err
    found = load_model(tmp_path / "w.h5")
    assert found.sensors[0].label == "root"
    np.testing.assert_allclose(found.static(), [[-0.08 * (5 - 0.2) / 9e5]], rtol=1e-6)  # -z M / EI
    plate = ["model", "plate", "--lengths", "0.5,0.4", "--thickness", "3mm", "--material", "steel", "--elements", "12"]
    code, _, err = run(*plate, "--sensor", "accelerometer:x=0.1,y=0.2", "--load", "point:x=0.3,y=0.1", "--modes", "4",
                       "-o", tmp_path / "p.h5")  # fmt: skip
    assert code == 0, err
    stiffness = 210e9 * 0.003**3 / 12 / (1 - 0.3**2)
    exact = np.pi / 2 * (1 / 0.5**2 + 1 / 0.4**2) * np.sqrt(stiffness / (7850 * 0.003))  # Navier
    assert load_model(tmp_path / "p.h5").natural_frequencies[0] == pytest.approx(exact, rel=2e-3)
    frame = ["model", "frame", "--width", "4", "--height", "3", "--section", "tube:0.2,0.01", "--material", "steel"]
    assert run(*frame, "--sensor", "accelerometer:3+X", "--load", "point:2+X", "-o", tmp_path / "f.h5")[0] == 0


def test_matrices_are_imported(run, tmp_path):
    K = np.diag([2.0, 2.0, 1.0]) - np.diag([1.0, 1.0], 1) - np.diag([1.0, 1.0], -1)  # N/mm: 1000 N/m
    io.mmwrite(tmp_path / "K.mtx", sparse.coo_array(K))
    io.mmwrite(tmp_path / "M.mtx", sparse.coo_array(1e-3 * np.eye(3)))  # t: 1 kg
    (tmp_path / "dofs.txt").write_text("1, +X\n2, +X\n3, +X\n")
    matrices = ["model", "import", tmp_path / "K.mtx", tmp_path / "M.mtx", "--length-unit", "mm"]
    placed = ["--dofs", tmp_path / "dofs.txt", "--sensor", "displacement:3+X", "--load", "point:1+X"]
    code, _, err = run(*matrices, *placed, "-o", tmp_path / "m.h5")
    assert code == 0, err
    exact = 2 * np.sqrt(1000.0) * np.sin((2 * np.arange(3) + 1) * np.pi / 14) / (2 * np.pi)
    np.testing.assert_allclose(load_model(tmp_path / "m.h5").natural_frequencies, exact, rtol=1e-9)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--length", "300kg"], "a unit of another kind"),
        (["--length", "long"], "this is no number"),
        (["--material", "steal"], "did you mean steel?"),
        (["--sensor", "acelerometer:12+Z"], "did you mean accelerometer?"),
        (["--sensor", "accelerometer"], "one place"),
        (["--sensor", "accelerometer:0.1"], "accelerometer:x=0.1 (a place in m)"),
        (["--sensor", "accelerometer:x=0,1"], "a decimal point"),
        (["--sensor", "accelerometer:at=0.1"], "a place in x, y or z"),
        (["--sensor", "strain:x=0.1"], "fibre"),
        (["--sensor", "strain:x=0.1,fiber=0.01"], "did you mean fibre?"),
        (["--section", "rectangle:0.04"], "has 2 sizes"),
        (["--ends", "clambed"], "did you mean clamped?"),
        (["--edges", "SSSS"], "edges is no setting of a model of kind 'beam'"),
        (["--modes", "0"], "no whole number"),
        (["--load", "point:99+Z"], "99+Z"),
    ],
)
def test_what_is_no_model_leaves_no_file(run, tmp_path, words, said):
    code, out, err = run(*BEAM, *HEARD, *words, "-o", tmp_path / "m.h5")
    assert (code, out) == (3, ""), err
    assert said in err
    assert not (tmp_path / "m.h5").exists()


def test_what_is_missing_is_named(run, tmp_path):
    for argv, code, said in (
        (["model", "-o", tmp_path / "m.h5"], cli.USAGE, "what is the model of"),
        ([*BEAM, "-o", tmp_path / "m.h5"], 3, "at least one --sensor"),
        (["model", "plate", *HEARD, "-o", tmp_path / "m.h5"], 3, "--lengths, --thickness, --material"),
        (["model", "import", *HEARD, "-o", tmp_path / "m.h5"], 3, "nothing is imported"),
    ):
        found, _, err = run(*argv)
        assert found == code
        assert said in err


def test_info_of_a_model_says_what_it_is(run, tmp_path):
    """Sensors, loads and frequencies in place of the arrays of its file."""
    from loadid import datasets

    model = datasets.hammer_test().model
    model.save(tmp_path / "beam.h5")
    model.state_space(1e-4).save(tmp_path / "states.h5")
    for name in ("beam.h5", "states.h5"):
        code, out, _ = run("info", tmp_path / name)
        assert code == 0
        for said in ("acc1 [m/s^2], acc2 [m/s^2]", "loads: hammer [N]", "forward model not verified"):
            assert said in out
        assert "float64" not in out
        assert len(out.splitlines()) < 12
    assert f"{model.natural_frequencies[0]:.5g}" in run("info", tmp_path / "beam.h5")[1]
