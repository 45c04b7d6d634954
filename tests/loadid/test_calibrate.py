"""Models from shaker records by the command line: against the structure that made them."""

import json

import numpy as np
import pytest
from scipy.signal import lfilter

from loadid import Deconvolution, calibrate, datasets, read
from loadid._commands import load_model
from structures import FrfModel, InputError, MeasuredModel
from tests.loadid.test_cli import installed, run

__all__ = ["installed", "run"]
RATE = 1000.0


def poles(f, zeta):
    """Displacement over force of one mode, sampled: numerator and denominator of a filter."""
    pole = np.exp(2 * np.pi * f / RATE * (-zeta + 1j * np.sqrt(1 - zeta**2)))
    return [0.0, 1e-3], [1.0, -2 * pole.real, abs(pole) ** 2]


@pytest.fixture
def shaken(tmp_path):
    """Two independent random forces and three responses; the FRFs (lines, 3, 2) of the structure that made them."""
    rng = np.random.default_rng(3)
    n = 40_000
    force = rng.standard_normal((n, 2)) * [10.0, 4.0]
    shapes = np.array([[1.0, 0.4], [0.6, -0.7], [-0.3, 0.9]])
    modes = [poles(60.0, 0.03), poles(190.0, 0.02)]
    y = np.zeros((n, 3))
    for k, (b, a) in enumerate(modes):
        driven = shapes[:2, k] @ np.stack([lfilter(b, a, force[:, j]) for j in (0, 1)])
        y += np.outer(driven, shapes[:, k])

    def frf(f):
        z = np.exp(-2j * np.pi * f / RATE)
        return sum(
            np.polyval(b[::-1], z)[:, None, None] / np.polyval(a[::-1], z)[:, None, None]
            * np.outer(shapes[:, k], shapes[:2, k])
            for k, (b, a) in enumerate(modes)
        )  # fmt: skip

    y += 0.01 * y.std() * rng.standard_normal(y.shape)
    table = np.column_stack([np.arange(n) / RATE, force, y])
    names = "time [s],F1 [N],F2 [N],a1 [m/s^2],a2 [m/s^2],a3 [m/s^2]"
    np.savetxt(tmp_path / "r.csv", table, delimiter=",", header=names, comments="", fmt="%.9g")
    return tmp_path / "r.csv", frf


@pytest.mark.parametrize("estimator", ["H1", "Hv"])
def test_two_shakers_on_lines(run, shaken, tmp_path, estimator):
    log, frf = shaken
    code, out, err = run(
        "calibrate", log, "--excitation", "shaker", "--force", "F1,F2", "--response", "a1,a2,a3",
        "-o", tmp_path / "m.h5", "--estimator", estimator, "--segment", "2000", "--coherence", "0.5",
        "--band", "20:300",
    )  # fmt: skip
    assert code == 0, err
    assert out.startswith("forces F1, F2; responses a1, a2, a3; ")
    model = load_model(tmp_path / "m.h5")
    assert isinstance(model, FrfModel)
    assert model.frequencies[[0, -1]].tolist() == [20.0, 300.0]
    truth = frf(model.frequencies)
    clear = np.abs(model.frequencies - 60) > 4  # away from the peak, where half-hertz lines leak
    error = np.abs(model.H - truth)[clear] / np.abs(truth).max(axis=(1, 2), keepdims=True)[clear]
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.95) < {"H1": 0.05, "Hv": 0.08}[estimator]  # Hv counts the noise to the forces too


def test_random_forces_give_an_impulse_response(run, shaken, tmp_path):
    log, frf = shaken
    argv = ("calibrate", log, "--excitation", "random", "--force", "F1,F2", "--response", "a1,a3", "--segment", "2000",
            "-o", tmp_path / "m.h5", "--json")  # fmt: skip
    code, out, err = run(*argv)
    assert code == 0, err
    answer = json.loads(out)
    assert (answer["excitation"], answer["force"], answer["hits"][0]["used"]) == ("random", ["F1", "F2"], True)
    model = load_model(tmp_path / "m.h5")
    assert isinstance(model, MeasuredModel)
    k = np.arange(1, 60)
    z = np.exp(-2j * np.pi * np.arange(2001) / 4000)[:, None, None]
    truth = np.fft.irfft(np.broadcast_to(frf(np.arange(2001) * RATE / 4000) + 0 * z, (2001, 3, 2)), 4000, axis=0)
    found = model.impulse_response(1 / RATE, 60)
    assert np.abs(found[k] - truth[k][:, [0, 2]]).max() < 0.05 * np.abs(truth[k]).max()


def test_a_part_of_the_records_is_used(run, shaken, tmp_path):
    argv = ("calibrate", shaken[0], "--excitation", "random", "--force", "F1,F2", "--response", "a1", "-o")
    for name, more in (("a", ()), ("b", ("--between", "0:40")), ("c", ("--between", "10:30"))):
        assert run(*argv, tmp_path / f"{name}.h5", "--segment", "1000", *more)[0] == 0
    whole, same, part = (load_model(tmp_path / f"{name}.h5") for name in "abc")
    assert whole.fingerprint == same.fingerprint
    assert np.array_equal(part.frequencies, whole.frequencies)
    assert part.fingerprint != whole.fingerprint
    code, _, err = run(*argv, tmp_path / "d.h5", "--between", "50:60")
    assert code == 3
    assert "the window holds no sample" in err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--segment", "100"], 2, "--excitation shaker"),
        (["--excitation", "random", "--band", "10:20"], 3, "band is no setting of excitation 'random'"),
        (["--force", "F1,F2"], 3, "one hammer has one force"),
        (["--excitation", "shaker", "--band", "900:1000"], 3, "no calibrated line lies in the band"),
        (["--excitation", "shaker", "--coherence", "1"], 2, "share"),
        (["--excitation", "shaker", "--window", "triangl"], 3, "window"),
        (["--excitation", "shaker", "--estimator", "H2", "--force", "F1,F2"], 3, "H2 of several forces"),
        (["--excitation", "shaker", "--response", "F1"], 3, "given twice"),
    ],
)
def test_what_cannot_be_calibrated_leaves_no_file(run, shaken, tmp_path, words, code, said):
    argv = ["calibrate", shaken[0], "--force", "F1", "--response", "a1,a2,a3", "-o", tmp_path / "m.h5"]
    found, out, err = run(*argv, *words)
    assert (found, out) == (code, "")
    assert said in err
    assert not (tmp_path / "m.h5").exists()


def test_noise_of_a_hammer_outside_its_pulses_is_left_out(run, tmp_path):
    """It makes H1 too small where hits have little energy, and a load in a window cannot make up for it."""
    hit = datasets.hammer_test(tmp_path)
    words = ["calibrate", *hit.files[:3], "--force", "hammer", "--response", "acc1,acc2", "-o", tmp_path / "m.h5"]
    record, off, grades = read(hit.files[3]), [], []
    for more in ([], ["--gate", "0.004"]):
        code, _, err = run(*words, *more)
        assert code == 0, err
        found = Deconvolution(load_model(tmp_path / "m.h5"), support=(0.019, 0.025)).estimate(record)
        off.append(np.linalg.norm(found.load - hit.load) / np.linalg.norm(hit.load))
        grades.append(found.grade.letter)
    assert grades == ["D", "A"]
    assert 0.02 < off[0] < 0.03
    assert off[1] < 0.01
    gated = MeasuredModel.from_hits([read(f) for f in hit.files[:3]], force="hammer", responses=["acc1", "acc2"],
                                    gate=0.004)  # fmt: skip
    np.testing.assert_array_equal(load_model(tmp_path / "m.h5").H, gated.H)
    code, _, err = run(*words, "--excitation", "random", "--gate", "0.004")
    assert code == 2
    assert "--gate is for hits" in err
    with pytest.raises(InputError, match=r"gate is no setting of excitation 'random'.*excitation='hammer'"):
        calibrate(hit.files[:1], force="hammer", responses=["acc1"], excitation="random", of_hits={"gate": 0.1})
