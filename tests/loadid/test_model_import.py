"""``loadid model import`` of the files of a solver: told, reduced, and a load identified with what it writes."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from loadid import Deconvolution, Spectra, cli
from structures import ForwardModel, damping, loads, sensors
from structures._models.substructure import reduce
from structures.files import _modelfile, read_fe
from tests.test_contracts import USERS

FIXTURES = Path(__file__).parents[1] / "structures" / "fe" / "fixtures"
FILES = [str(FIXTURES / name) for name in ("plate.sti", "plate.mas", "plate.inp")]
PLACES = ["--sensor", "accelerometer:123+Z", "--sensor", "displacement:33+Z", "--load", "point:63+Z"]


def run(capsys, *words):
    code = cli.main(["model", "import", *map(str, words)])
    return code, capsys.readouterr()


def test_the_summary_is_told_and_the_model_written(capsys, tmp_path):
    out = tmp_path / "m.h5"
    code, said = run(capsys, *FILES, "--units", "mm,N", "--damping", "0.01", *PLACES, "-o", out)
    assert code == 0
    for word in ("mass 0.2617 kg", "rigid-body modes: 0", "2675, 4423, 4530", "model written to"):
        assert word in said.out
    hz = np.loadtxt(FIXTURES / "frequencies.txt")
    assert _modelfile.load(out).natural_frequencies[:4] == pytest.approx(hz, rel=1e-6)


def test_a_band_reduces_it(capsys, tmp_path):
    out = tmp_path / "m.h5"
    code, said = run(
        capsys, *FILES, "--units", "mm,N", "--damping", "0.01", "--band", "1500", *PLACES, "-o", out, "--json"
    )
    assert code == 0
    assert "reduced to 3 DOFs" in json.loads(said.out)["summary"]
    small = _modelfile.load(out)
    assert small.structure.n < 24
    whole = ForwardModel(
        read_fe(FILES, units="mm,N").structure(damping=damping.Modal(0.01)),
        [sensors.Accelerometer("123+Z"), sensors.Displacement("33+Z")], [loads.Point("63+Z")],
    )  # fmt: skip
    f = np.linspace(50.0, 1450.0, 30)
    H = whole.frf(f)
    assert np.linalg.norm(small.frf(f) - H) < 1e-2 * np.linalg.norm(H)


@pytest.mark.parametrize(("words", "told"), [
    ([], "units of the files are not stated"),
    (["--units", "mm"], "no units of a model"),
    (["--units", "mm,N", "--length-unit", "mm"], "no setting of the files"),
    (["--units", "mm,N", "--supports", "999+X"], "a support that no row has"),
    (["--units", "mm,N", "--names", "K=KGG"], "no matrix 'KGG'"),
    (["--units", "mm,N", "--names", "KGG"], "these name no matrices"),
])  # fmt: skip
def test_refusals_leave_no_file(capsys, tmp_path, words, told):
    out = tmp_path / "m.h5"
    code, said = run(capsys, *FILES, *words, *PLACES, "-o", out)
    assert code == 3
    assert told in said.err
    assert not out.exists()


def test_modes_become_a_model(capsys, tmp_path):
    out = tmp_path / "m.h5"
    files = [FIXTURES / "modes.op2", FIXTURES / "nodes.bdf"]
    code, _ = run(capsys, *files, "--units", "mm,N", "--damping", "0.01", *PLACES, "-o", out)
    assert code == 0
    assert _modelfile.load_model(out).natural_frequencies[0] == pytest.approx(2674.5, rel=1e-4)


def test_modes_take_no_settings_of_matrices(capsys, tmp_path):
    files = [FIXTURES / "modes.op2", FIXTURES / "nodes.bdf"]
    code, said = run(capsys, *files, "--units", "mm,N", "--damping", "0.01", "--band", "500", *PLACES, "-o",
                     tmp_path / "m.h5")  # fmt: skip
    assert code == 3
    assert "no such setting" in said.err


def test_universal_modes_need_no_units_of_the_command(capsys, tmp_path):
    from tests.structures.fe.test_read import UNIVERSAL

    path, out = tmp_path / "m.unv", tmp_path / "m.h5"
    path.write_text(UNIVERSAL.format(cs=0))
    code, said = run(capsys, path, "--sensor", "displacement:8+Z", "--load", "point:7+Z", "-o", out)
    assert code == 0, said.err
    assert _modelfile.load_model(out).natural_frequencies.tolist() == [10.0]


def test_names_say_which_matrix_is_which(capsys, tmp_path):
    """Two matrices may be K: the refusal tells what to say, and saying it is enough."""
    from scipy import io, sparse

    for name, k in (("KGG", 1.0), ("KAA", 4.0), ("MGG", 1.0)):
        io.mmwrite(tmp_path / f"{name}.mtx", sparse.coo_matrix(k * (2 * np.eye(12) - np.eye(12, k=1) - np.eye(12, k=-1))
                                                               if name[0] == "K" else np.eye(12)))  # fmt: skip
    (tmp_path / "g.bdf").write_text("GRID,1,0,0.,0.,0.\nGRID,2,0,5.,0.,0.\n")
    words = [*(tmp_path / f for f in ("KGG.mtx", "KAA.mtx", "MGG.mtx", "g.bdf")), "--units", "m,N",
             "--sensor", "displacement:2+Z", "--load", "point:1+X", "-o", tmp_path / "m.h5"]  # fmt: skip
    code, said = run(capsys, *words)
    assert code == 3
    assert "--names K=KGG" in said.err
    assert run(capsys, *words, "--names", "K=KAA")[0] == 0
    stiff = _modelfile.load(tmp_path / "m.h5").natural_frequencies[0]
    assert run(capsys, *words, "--names", "K=KGG")[0] == 0
    assert stiff == pytest.approx(2 * _modelfile.load(tmp_path / "m.h5").natural_frequencies[0])


def test_a_band_keeps_the_modes_that_are_asked_and_needs_a_mass(capsys, tmp_path):
    words = ["--units", "mm,N", "--damping", "0.01", "--band", "4000", *PLACES, "-o", tmp_path / "m.h5"]
    assert run(capsys, *FILES, *words, "--modes", "2")[0] == 0
    assert len(_modelfile.load(tmp_path / "m.h5").natural_frequencies) == 2
    code, said = run(capsys, FILES[0], *words)
    assert code == 3
    assert "mass" in said.err


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_a_load_is_identified_with_an_imported_model(tmp_path):
    """Truth: CalculiX integrates the same plate under a half sine in time; the model is what its files tell."""
    from tests.structures.fe import make_fixtures

    step, count, peak, width = 5e-6, 160, 100.0, 4e-4
    t = step * np.arange(count + 1)
    force = np.where(t < width, peak * np.sin(np.pi * t / width), 0.0)
    amplitude = "\n".join(f"{a:.8g},{v:.10g}" for a, v in zip(t, force, strict=True))
    deck = make_fixtures.deck(
        f"*DYNAMIC,DIRECT,ALPHA=0\n{step:g},{step * count:g}\n*CLOAD,AMPLITUDE=A\n63,3,1.0\n"
        "*NODE PRINT,NSET=OUT,FREQUENCY=1\nU"
    ).replace("*STEP\n", f"*NSET,NSET=OUT\n123,33\n*AMPLITUDE,NAME=A\n{amplitude}\n*STEP,INC=1000\n")
    (tmp_path / "run.inp").write_text(deck)
    subprocess.run(["ccx", "run"], cwd=tmp_path, check=True, stdout=subprocess.DEVNULL, timeout=60)
    rows = [line.split() for line in (tmp_path / "run.dat").read_text().splitlines()]
    moved = {n: [float(r[3]) * 1e-3 for r in rows if len(r) == 4 and r[0] == str(n)] for n in (123, 33)}
    y = np.vstack([np.zeros(2), np.column_stack([moved[123], moved[33]])])[: count + 1]
    model = ForwardModel(
        read_fe(FILES, units="mm,N").structure(), [sensors.Displacement("123+Z"), sensors.Displacement("33+Z")],
        [loads.Point("63+Z")],
    )  # fmt: skip
    simulated = model.predict(force[:, None], step)
    assert np.linalg.norm(simulated - y) < 0.02 * np.linalg.norm(y)
    found = Deconvolution(model, noise=1e-3 * np.abs(y).max()).estimate(y, dt=step)
    assert np.linalg.norm(found.load[:, 0] - force) < 0.1 * np.linalg.norm(force)


@pytest.fixture(scope="module")
def plates():
    """An imported plate, whole and reduced to 2.5 kHz, as models of the same channels."""
    whole = read_fe(FILES, units="mm,N").structure(damping=damping.Modal(0.02))
    places = ("123+Z", "33+Z", "63+Z", "93+Z")
    small = reduce(whole, places, 2500.0).structure
    channels = [sensors.Displacement(at, label=at) for at in places], [loads.Point("63+Z"), loads.Point("33+Z")]
    return ForwardModel(whole, *channels), ForwardModel(small, *channels)


@pytest.mark.parametrize("family", USERS)
def test_every_family_runs_on_a_reduced_model(plates, family):
    """Data of the whole model, an answer of the reduced one."""
    whole, small = plates
    rng, dt, samples = np.random.default_rng(1), 1e-4, 60
    still, lines = np.array([10.0, 4.0]), np.linspace(300.0, 2000.0, 40)
    pulse = np.zeros((samples, 2))
    pulse[20:36, 0] = 10 * np.sin(np.pi * (np.arange(16) + 0.5) / 16) ** 2
    if family == "StaticInversion":
        y, truth = whole.static() @ still, still
    elif family == "HarmonicInversion":
        y, truth = whole.frf(np.array([80.0]))[0] @ (still * [1, 1j]), still * [1, 1j]
    elif family == "FrequencyInversion":
        y, truth = whole.frf(lines) @ (still * [1, 1j]), np.tile(still * [1, 1j], (len(lines), 1))
    else:
        y, truth = whole.predict(pulse, dt), pulse
    level = 1e-3 * np.sqrt(np.mean(np.abs(y) ** 2))
    noise = level * rng.standard_normal(y.shape)
    y = y + (noise + 1j * level * rng.standard_normal(y.shape) if np.iscomplexobj(y) else noise)
    lined = {"FrequencyInversion": (Spectra(lines, y, noise=np.sqrt(2) * level),)} if y.shape[0] == len(lines) else {}
    given = {"StaticInversion": (y,), "HarmonicInversion": (y,), **lined}.get(family, (y, dt))
    found = USERS[family][0](small).estimate(*given)
    if family == "LocationSearch":
        assert found.best == (0,)
        return
    load = found.load[:1] + 1j * found.load[1:] if family == "HarmonicInversion" else found.load
    load = load.reshape(truth.reshape(-1, 2).shape) if load.size == truth.size else load
    assert np.linalg.norm(load - truth.reshape(load.shape)) < 0.03 * np.linalg.norm(truth)
