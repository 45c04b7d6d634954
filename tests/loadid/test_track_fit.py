"""`loadid track --fit`: from a model and a record to a stream, started again, and what is refused."""

import json
from importlib.metadata import EntryPoint, EntryPoints

import numpy as np
import pytest

from loadid import cli, identify, read
from loadid._commands.check import check
from loadid._families import kalman
from loadid._families.tracking.tracker import Tracker
from loadid.settings import Guards, ModelErrors, Noise, Online, Priors
from structures import ForwardModel, MeasuredModel, beams, damping, loads, sensors
from structures.errors import NotIdentifiable
from structures.files import _storage as storage

DT = 0.005


def made():
    mast = beams.cantilever(length=12.0, EI=4e6, mass_per_length=60.0, elements=8, damping=damping.Modal(0.02))
    seen = [sensors.Accelerometer("8+Z"), sensors.Accelerometer("4+Z"), sensors.StrainGauge(at=0.5, fibre=0.1)]
    return ForwardModel(mast, seen, [loads.Point("8+Z", label="wind")], modes=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model, its record, a stream, and the state of a run that was fitted to them."""
    where = tmp_path_factory.mktemp("fit")
    model, rng = made(), np.random.default_rng(0)
    force = np.convolve(rng.standard_normal(1200), np.hanning(60))[:1200, None] * 100
    y = model.predict(force, DT)
    y += 0.02 * y.std(axis=0) * rng.standard_normal(y.shape)
    model.save(where / "model.h5")
    head = ",".join(["time [s]", *(f"{c.label} [{c.unit}]" for c in model.sensors)])
    for name, part in (("record.csv", slice(0, 700)), ("stream.csv", slice(700, None))):
        table = np.column_stack([np.arange(len(y[part])) * DT, y[part]])
        np.savetxt(where / name, table, delimiter=",", header=head, comments="", fmt="%.12g")
    storage.write(where / "other.h5", {}, "load estimate")
    MeasuredModel.from_frf(np.linspace(0, 100, 11), np.ones((11, 1, 1)), kind="accelerance").save(where / "hammer.h5")
    return where


@pytest.fixture
def run(folder, monkeypatch, capfd):
    group = EntryPoints([EntryPoint("track", "loadid._commands.track:command", cli.GROUP)])
    monkeypatch.setattr(cli, "entry_points", lambda group=None, found=group: found)
    monkeypatch.chdir(folder)

    def call(words):
        code = cli.main(["track", "--idle", "0", *words.split()])
        out = capfd.readouterr()
        return code, out.out, out.err

    return call


@pytest.fixture(scope="module")
def first(folder):
    """The first run, which fits."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(
            cli, "entry_points",
            lambda group=None: EntryPoints([EntryPoint("track", "loadid._commands.track:command", cli.GROUP)]),
        )  # fmt: skip
        words = "--model model.h5 --fit record.csv --prior ou --state s.h5 --in stream.csv --out out.csv --idle 0"
        assert cli.main(["track", *words.split()]) == 0


def test_other_commands_take_the_same_model(folder):
    """A model that was saved, in the place of a measured one."""
    found = identify(folder / "record.csv", folder / "model.h5", family="deconvolution")
    expected = identify(folder / "record.csv", made(), family="deconvolution")
    assert np.array_equal(found.load, expected.load)
    assert found.provenance["model"] == expected.provenance["model"]
    assert check(model=folder / "model.h5").layout


@pytest.mark.usefixtures("first")
def test_the_command_tunes_as_python_does_and_is_not_tuned_again(folder, run, monkeypatch):
    fitted = kalman.LoadTracker(made(), prior="ou").fit(read(folder / "record.csv"))
    record = read(folder / "stream.csv")
    load, std, _ = fitted.run(np.ascontiguousarray(record.values))
    found = np.loadtxt(folder / "out.csv", delimiter=",", skiprows=1)[:, :-2]
    assert np.allclose(found[:, 1:], np.column_stack([load, std]), rtol=1e-6, atol=1e-6 * np.abs(load).max())
    assert Tracker.load(folder / "s.h5", made()).counts["samples"] == 500  # of this model
    monkeypatch.setattr(kalman.LoadTracker, "fit", None)  # would fail
    code, said, _ = run(
        "--model model.h5 --fit record.csv --prior ou --state s.h5 --in stream.csv --out out.csv --json"
    )
    assert code == 0
    data = json.loads(said)
    assert data["resumed"]
    assert data["samples"] == 0
    assert "Ornstein" in data["prior"]
    assert data["verdict"] in ("calibrated", "not calibrated")
    assert run("--model model.h5 --state s.h5 --in stream.csv --out out.csv")[0] == 0
    (folder / "grown.csv").write_text((folder / "record.csv").read_text() + "9.0,0,0,0\n")
    assert run("--model model.h5 --fit grown.csv --prior ou --state s.h5 --in stream.csv --out out.csv")[0] == 0


@pytest.mark.usefixtures("first")
@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("--model model.h5 --fit record.csv --state s.h5", cli.BAD_INPUT, "other settings"),
        ("--model model.h5 --fit stream.csv --prior ou --state s.h5", cli.BAD_INPUT, "another record"),
        ("--model hammer.h5 --fit record.csv --prior ou --state s.h5", cli.BAD_INPUT, "another model"),
        ("--model model.h5", cli.BAD_INPUT, "--fit"),
        ("--model hammer.h5 --fit record.csv", cli.BAD_INPUT, "no state_space()"),
        ("--model other.h5 --fit record.csv", cli.BAD_INPUT, "no model to tune"),
        ("--model record.csv --fit record.csv", cli.BAD_INPUT, "not a file of this package"),
        ("--model s.h5 --fit record.csv", cli.BAD_INPUT, "tuned already"),
        ("--model s.h5 --state model.h5", cli.BAD_INPUT, "holds no tracker"),
        ("--model model.h5 --fit nothing.csv", cli.BAD_INPUT, "cannot be read"),
        ("--model model.h5 --fit record.csv --in nothing.csv", cli.BAD_INPUT, "cannot be read"),
        ("--model model.h5 --fit record.csv --in tcp://host", cli.BAD_INPUT, "no address"),
        ("--model model.h5 --fit record.csv --out record.csv", cli.BAD_INPUT, "the command reads"),
        ("--model model.h5 --fit record.csv --noise 1,2", cli.BAD_INPUT, "3, for 8+Z"),
        ("--model model.h5 --fit record.csv --noise 8+Z=1", cli.BAD_INPUT, "each sensor"),
        ("--model model.h5 --fit record.csv --noise 1,2,x", cli.BAD_INPUT, "no noise std"),
        ("--model model.h5 --fit record.csv --prior foo", cli.BAD_INPUT, "unknown prior"),
        ("--fit record.csv --state new.h5", cli.USAGE, "--model"),
        ("--model s.h5 --prior ou", cli.USAGE, "--fit"),
        ("--model model.h5 --fit record.csv --lag -1", cli.USAGE, "number of samples"),
        ("--model model.h5 --fit record.csv --replay some", cli.USAGE, "number of samples"),
        ("--model model.h5 --fit record.csv --model-error stiffness", cli.USAGE, "stiffness=0.02"),
        ("--model model.h5 --fit record.csv --gate no", cli.USAGE, "--gate"),
    ],
)
def test_what_is_refused_says_why_and_writes_nothing(folder, run, words, code, said):
    rest = [w for w in ("--in stream.csv", "--out new.csv") if w.split()[0] not in words]
    found, _, err = run(" ".join([words, *rest]))
    assert found == code, err
    assert said in err
    assert not (folder / "new.csv").exists()
    assert not (folder / "new.h5").exists()


def test_every_setting_reaches_the_tracker(run, monkeypatch):
    given = {}

    class Silent(kalman.LoadTracker):
        def __init__(self, model, **settings):
            given.update(settings)
            super().__init__(model, **settings)

        def fit(self, record, dt=None):
            raise NotIdentifiable("enough", advice="none", code="LID-E501")

    monkeypatch.setattr(kalman, "LoadTracker", Silent)
    words = (
        "--model named.h5 --fit record.csv --in stream.csv --out new.csv --prior matern52 --noise 4+Z=2,8+Z=1,gauge=3 "
        "--scales stiffness,damping --model-error mass=0.02 --start static --gate none --allow-drift"
    )
    model = made()
    named = [model.sensors[0], model.sensors[1], sensors.StrainGauge(at=0.5, fibre=0.1, label="gauge")]
    ForwardModel(model.structure, named, model.loads, modes=4).save("named.h5")
    code, _, err = run(words)
    assert code == cli.REFUSED, err
    del given["progress"]
    assert given == {
        "prior": Priors("matern52", start="static"), "noise": Noise([1.0, 2.0, 3.0], source="--noise"), "gate": None,
        "model_error": ModelErrors({"mass": 0.02}, scales=["stiffness", "damping"]), "allow": Guards(["LID-E501"]),
    }  # fmt: skip
    for words, lag in (("auto", "auto"), ("5", 5)):
        assert run(f"--model named.h5 --fit record.csv --in stream.csv --out new.csv --lag {words}")[0] == cli.REFUSED
        assert given["online"] == Online(lag)
