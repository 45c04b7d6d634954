"""``loadid identify`` for every family: one table of settings, job files, constraints and noise by name, `compare`."""

from __future__ import annotations

import json
import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loadid import InputError, LoadEstimate, cli, compare, identify, load, read
from loadid._commands import _inputs, _settings
from loadid._commands import compare as comparing
from loadid._commands._job import READING, WORDS, beside, resolved, written
from loadid._commands._job import read as read_job
from loadid._spellings import ARGUMENTS
from structures import ForwardModel, ImpulseModel, bases, beams, damping, loads, sensors

RATE = 2000
BEAM = beams.simply_supported(
    length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=20,
    damping=damping.Modal(0.02),
)  # fmt: skip
PLACES = (0.3, 0.9, 1.5, 1.7)


def hit_model() -> ForwardModel:
    seen = [sensors.Displacement(at=x, direction="+Z", label=f"s{i}") for i, x in enumerate(PLACES)]
    return ForwardModel(BEAM, seen, [loads.Point(at=0.7, direction="+Z", label="F")], modes=5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model and a log of a hit of 6 ms, a static model and its readings, in two kinds of file."""
    place = tmp_path_factory.mktemp("job")
    model = hit_model()
    model.save(place / "model.h5")
    t = np.arange(240) / RATE
    force = np.where((t > 0.02) & (t < 0.026), 100 * np.sin(np.pi * (t - 0.02) / 0.006), 0.0)
    y = model.predict(force[:, None], 1 / RATE)
    y += 0.01 * y.std(axis=0) * np.random.default_rng(0).standard_normal(y.shape)
    head = "time [s],F [N]," + ",".join(f"s{i} [m]" for i in range(4))
    np.savetxt(place / "log.csv", np.column_stack([t, force, y]), delimiter=",", header=head, comments="")
    patches = ForwardModel(BEAM, model.sensors, bases.patches(BEAM, 6), modes=5)
    patches.save(place / "patches.h5")
    read = patches.static() @ np.full(6, 50.0)
    rows = [f"s{i};{str(v).replace('.', ',')}" for i, v in enumerate(read.tolist())]
    (place / "readings.csv").write_text("sensor;reading\n" + "\n".join(rows) + "\n")
    table = np.column_stack([np.arange(6) / 10, np.outer([0, 1, 1, 1, 2, 2], read)])
    np.savetxt(place / "frames.csv", table, delimiter=",", header="time [s]," + head.split(",", 2)[2], comments="")
    return place


@pytest.fixture
def run(capsys: pytest.CaptureFixture, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from importlib.metadata import EntryPoint

    points = [EntryPoint(n, f"loadid._commands.{n}:command", cli.GROUP) for n in ("identify", "compare")]
    monkeypatch.setattr(cli, "entry_points", lambda group: points)
    monkeypatch.chdir(folder)

    def call(*words: Any) -> tuple[int, str, str]:
        code = cli.main([str(w) for w in words])
        out = capsys.readouterr()
        return code, out.out, out.err

    return call


def asked(run: Any, out: Path, *words: Any, log: str = "log.csv", model: str = "model.h5") -> str:
    """What a run says that must answer."""
    code, said, err = run("identify", log, "--model", model, "-o", out, *words)
    # a hit is on the lines beside this one as on it, and so no harmonic load: exit code 1
    assert code == (1 if "harmonic" in words else 0), err
    assert ("do not use the number" in said) == (code == 1)
    return said


# -- the table ---------------------------------------------------------------------------------------------------------
def test_a_mean_says_what_it_lacks(folder, tmp_path):
    lines = (folder / "frames.csv").read_text().splitlines()
    cells = lines[3].split(",")
    lines[3] = ",".join([cells[0], cells[1], "", *cells[3:]])
    (tmp_path / "frames.csv").write_text("\n".join(lines) + "\n")
    found = identify(tmp_path / "frames.csv", folder / "patches.h5", family="static", mean=(0.1, 0.3))
    said = "mean over 0.1 to 0.3 s: 1 of 3 samples of s1 are missing"
    assert said in found.provenance["notes"]
    assert said in found.summary()
    whole = identify(folder / "frames.csv", folder / "patches.h5", family="static", mean=(0.1, 0.3))
    assert not any("missing" in note for note in whole.provenance["notes"])


@pytest.mark.parametrize("heading", ["", "time [s],"])
def test_one_row_of_static_readings_is_one_reading(run, folder, tmp_path, heading):
    """From the shell and in Python, as the mapping is; a row that may be cut is none, and no history."""
    labels = [f"s{i}" for i in range(4)]
    row = [1e-3, 2e-3, 3e-3, 4e-3]
    log, names = tmp_path / "one.csv", ",".join(f"{label} [mm]" for label in labels)
    cells = ("0.5," if heading else "") + ",".join(str(1e3 * x) for x in row)
    log.write_text(f"{heading}{names}\n{cells}\n")
    want = identify(dict(zip(labels, row, strict=True)), folder / "patches.h5", family="static", noise=1e-6)
    found = identify(log, folder / "patches.h5", family="static", noise=1e-6)
    np.testing.assert_allclose(found.load, want.load, rtol=1e-9)
    assert found.axis is None
    code, _, err = run("identify", log, "--model", "patches.h5", "-o", tmp_path / "r.h5", "--family", "static",
                       "--noise", 1e-6)  # fmt: skip
    assert "too few" not in err
    assert code in (0, 1)
    np.testing.assert_allclose(load(tmp_path / "r.h5").load, want.load, rtol=1e-9)
    with pytest.raises(InputError, match="too few samples"):
        identify(log, folder / "patches.h5", family="deconvolution")
    log.write_text(f"{heading}{names}\n{cells}")  # no end of the line
    with pytest.raises(InputError, match="no rows of numbers"):
        read(log)


def test_mistakes_of_a_job_are_told_in_its_own_words(tmp_path):
    job = tmp_path / "a.toml"
    job.write_text("log = 'a.csv'\nnoise = = 3\n")
    with pytest.raises(InputError, match="the job is no TOML"):
        read_job(job)
    job.write_text("suport = [0.1, 0.2]\n")
    with pytest.raises(
        InputError, match=r"no such key; .*expected: support, .*in all\).*did you mean 'support'"
    ) as caught:
        read_job(job)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("family", _settings.FAMILIES)
def test_every_setting_of_python_is_written_or_said_why_not(family: str) -> None:
    kind = _settings.load_family(family)
    own = ARGUMENTS[kind.__name__]
    every = set(own.defaults)
    for argument, (setting, known) in own.kinds.items():
        names = {"source": "noise_source"}
        every |= {names.get(f.name, f.name) for f in fields(setting)[1:] if f.name in known} | {argument}
    written_as = {"sparsity", "search", "online"}  # classes whose fields are written one by one, the first of them too
    every |= {fields(own.kinds[name][0])[0].name for name in written_as & set(own.kinds)}
    missing = {name for name in every - written_as if name not in _settings.OPTIONS and name not in _settings.UNWRITTEN}
    assert missing == set()


def test_every_option_belongs_to_a_family_and_every_family_has_its_own() -> None:
    taken = {family: set(_settings.known(family)) for family in _settings.FAMILIES}
    assert set(_settings.OPTIONS) - set().union(*taken.values()) == set()
    assert {n for names in taken.values() for n in names} - {
        *_settings.OPTIONS,
        "sparsity",
        "search",
        "online",
    } == set()
    assert not set(_settings.OPTIONS) & set(WORDS)


# -- families ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "chosen: Deconvolution"),
        (["--family", "deconvolution", "--support", "0.02:0.026", "--validation", "s3"], "kept out: s3"),
        (["--family", "sparse", "--dictionary", "bspline", "--knots", "2", "--support", "0.018:0.03"], "peak F"),
        (["--family", "tracker", "--prior", "matern32", "--gate", "none"], "peak F"),
        (["--family", "harmonic", "--frequency", "30"], "no load is told from noise: an amplitude of"),
        (["--family", "frequency", "--signal", "transient", "--validation", "s1"], "kept out: s1"),
        (["--family", "field", "--time", "first_difference", "--choice", "0.01"], "peak F"),
        (["--family", "location", "--grid", "7", "--choice", "0.001"], "nearest candidate"),
        (["--choice", "gcv"], "peak F"),
    ],
)
def test_families(run: Any, tmp_path: Path, words: list[str], said: str) -> None:
    out = tmp_path / "r.h5"
    assert said in asked(run, out, *words)
    assert out.exists()
    assert "family" in tomllib.loads(beside(out).read_text())


def test_the_place_of_a_hit(run: Any, tmp_path: Path) -> None:
    out = asked(run, tmp_path / "r.h5", "--family", "location", "--grid", "7", "--json")
    found = json.loads(out)
    assert found["found"][0][0] == pytest.approx(0.7, abs=0.02)
    assert found["estimate"]["labels"]


def test_static_readings_of_either_file(run: Any, tmp_path: Path) -> None:
    by_sensor = asked(run, tmp_path / "a.h5", log="readings.csv", model="patches.h5")
    assert "chosen: StaticInversion" in by_sensor
    asked(run, tmp_path / "b.h5", "--family", "static", "--mean", "0.1:0.3", log="frames.csv", model="patches.h5")
    asked(run, tmp_path / "c.h5", "--family", "static", "--at", "0.2", log="frames.csv", model="patches.h5")
    a, b, c = (LoadEstimate.read(tmp_path / f"{n}.h5").load for n in "abc")
    np.testing.assert_allclose(b, a, rtol=1e-9)
    np.testing.assert_allclose(c, a, rtol=1e-9)


def test_constraints_by_name(run: Any, tmp_path: Path, folder: Path) -> None:
    words = ["--family", "static", "--bounds", "0:60", "--resultant", "sum=300:0.1", "--nonnegative"]
    asked(run, tmp_path / "r.h5", *words, log="readings.csv", model="patches.h5")
    found = LoadEstimate.read(tmp_path / "r.h5").load
    assert found.sum() == pytest.approx(300, abs=1)
    assert found.min() >= 0
    assert found.max() <= 60 + 1e-6
    model = hit_model()
    readings = {"s0": 1e-4, "s1": 2e-4, "s2": 1e-4, "s3": 1e-5}
    bound = identify(readings, model, family="static", bounds={"F": [0.0, 0.5]})
    assert bound.load[0] == pytest.approx(0.5, rel=1e-6)
    with pytest.raises(InputError, match=r"no such name.*expected: F"):
        identify(readings, model, family="static", bounds={"f": [0.0, 0.5]})


def test_noise_by_name_is_noise_in_order(folder: Path) -> None:
    model = hit_model()
    named = {"s3": 4e-6, "s0": 1e-6, "s1": 2e-6, "s2": 3e-6}
    a = identify(folder / "log.csv", model, family="deconvolution", noise=named, choice=0.01)
    b = identify(folder / "log.csv", model, family="deconvolution", noise=[1e-6, 2e-6, 3e-6, 4e-6], choice=0.01)
    np.testing.assert_array_equal(a.load, b.load)
    some = identify(folder / "log.csv", model, family="deconvolution", noise=named, choice=0.01, validation=["s1"])
    rest = identify(folder / "log.csv", model, family="deconvolution", noise=[1e-6, 3e-6, 4e-6], choice=0.01,
                    sensors=["s0", "s2", "s3"])  # fmt: skip
    np.testing.assert_array_equal(some.load, rest.load)
    measured = np.loadtxt(folder / "log.csv", delimiter=",", skiprows=1)[:, 3]
    predicted = model.predict(np.asarray(some.load), 1 / RATE)[:, 1]
    error = np.linalg.norm(measured - predicted) / np.linalg.norm(measured)
    assert some.facts.held_out == (f"s1 {error:.2%}",)
    with pytest.raises(InputError, match="not stated"):
        identify(folder / "log.csv", model, noise={"s0": 1e-6})


# -- jobs --------------------------------------------------------------------------------------------------------------
JOB = """
log = "{folder}/log.csv"
model = "{folder}/model.h5"
output = "first.h5"
family = "deconvolution"
support = [[0.0195, 0.0265]]
noise = {{s0 = 3e-6, s1 = 4e-6, s2 = 3e-6, s3 = 1e-6}}
penalty = "first_difference"
choice = 0.012345678901234567
"""


def test_a_resolved_job_gives_the_same_bits(run: Any, tmp_path: Path, folder: Path) -> None:
    job = tmp_path / "job.toml"
    job.write_text(JOB.format(folder=folder))
    code, said, err = run("identify", job, "--choice", "0.02")  # the option overrides the job
    assert code == 1, err  # and leaves 5 times the noise: answered, not to be used
    assert said.startswith("NOT TO BE USED")
    kept = tmp_path / "first.job.toml"
    assert str(kept) in said
    tree = tomllib.loads(kept.read_text())
    assert tree["choice"] == 0.02
    assert tree["noise"]["s1"] == 4e-6
    first = load(tmp_path / "first.h5")
    assert first.choice.lam == 0.02
    before = kept.read_bytes()
    assert run("identify", "--job", kept)[0] == 1
    again = load(tmp_path / "first.h5")
    np.testing.assert_array_equal(first.load, again.load)
    np.testing.assert_array_equal(first.std, again.std)
    assert kept.read_bytes() == before


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("pnalty = 'identity'", "did you mean 'penalty'"),
        ("penalty = 'smooth'", "no penalty"),
        ("family = 'statik'", "static"),
        ("support = 'soon'", "no window"),
        ("nonnegative = 3", "true or false"),
        ("method = 'lu'", "tikhonov"),
        ("level = -1.0", "> 0"),
        ("responses = 'a'", "a list of texts"),
        ("reading = {fss = 3}", "did you mean 'fs'"),
        ("frequency = nan", "no such value"),
        ("knots = [", "no TOML"),
        ("dictionary = 'dirac'", "sparse take"),  # of another family
    ],
)
def test_a_job_that_says_nothing(run: Any, tmp_path: Path, folder: Path, line: str, said: str) -> None:
    job = tmp_path / "job.toml"
    base = [x for x in JOB.format(folder=folder).splitlines() if x.split(" =")[0] != line.split(" =")[0]]
    job.write_text("\n".join([line, *base]) if "{" in line else "\n".join([*base, line]))
    code, out, err = run("identify", job)
    assert code == 3
    assert said in err
    assert not out
    assert not (tmp_path / "first.h5").exists()


def test_what_a_job_is_written_as_is_read_again(tmp_path: Path) -> None:
    values = {
        "a": 'quo"te\\\n\x01 é',
        "b": [1, 2.5, float("inf"), True],
        "c": {"x y": [0.1, [1e-300]]},
        "d": np.arange(3),
    }
    text = "\n".join(f"{name} = {written(value)}" for name, value in values.items())
    assert tomllib.loads(text) == {**values, "d": [0, 1, 2]}
    job = {"log": tmp_path / "in" / "log.csv", "model": tmp_path / "m.h5", "output": tmp_path / "out" / "r.h5"}
    (tmp_path / "out").mkdir()
    place = tmp_path / "out" / "r.job.toml"
    place.write_text(resolved(job, place.parent))
    back = read_job(place)
    assert {n: Path(back[n]).resolve() for n in job} == {n: p.resolve() for n, p in job.items()}
    assert set(READING) <= {"fs", "columns", "axis", "units"}


def test_what_is_missing_is_a_matter_of_usage(run: Any) -> None:
    code, _, err = run("identify", "log.csv", "--model", "model.h5")
    assert code == 2
    assert "-o" in err


# -- compare -----------------------------------------------------------------------------------------------------------
def test_what_takes_long_is_left_out_and_said(
    run: Any, tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("loadid._commands.compare.LARGE", 10)
    words = ("compare", "log.csv", "--model", "model.h5")
    code, out, err = run(*words, "--json")
    assert code == 0, err
    told = json.loads(out)
    assert {"spikes", "B-splines", "tracker"} < set(told["left_out"])
    assert not {"spikes", "B-splines", "tracker"} & {row["name"] for row in told["families"]}
    assert all(row["criterion"] is None for row in told["families"])
    said = run(*words, "--families", "deconvolution")[1]
    assert "band: rms std over the rms of the load" in said
    assert "--all asks them" in said


def test_a_harmonic_load_is_asked_for_its_frequency(run: Any) -> None:
    code, _, err = run("identify", "log.csv", "--model", "model.h5", "--family", "harmonic", "-o", "none.h5")
    assert code == 3
    assert "at which frequency" in err
    assert "--frequency" in err
    assert "0 Hz" not in err


def test_families_and_rules_in_one_table(run: Any, tmp_path: Path, folder: Path) -> None:
    few = "deconvolution,first difference,tracker"
    page, picture = tmp_path / "page.html", tmp_path / "loads.png"
    code, out, err = run("compare", "log.csv", "--model", "model.h5", "-o", page, "--plot", picture, "--families", few,
                         "--json")  # fmt: skip
    assert code == 0, err
    told = json.loads(out)
    assert [row["name"] for row in told["families"]] == few.split(",")
    assert told["kept_out"] == ["s3"]
    own = identify(folder / "log.csv", folder / "model.h5", family="deconvolution")
    first = told["families"][0]
    k = int(np.argmax(np.abs(own.load[:, 0])))
    assert first["peak"] == own.load[k, 0]
    assert first["std"] == own.std[k, 0]
    assert first["impulse"] == pytest.approx(float(own.load.sum()) / RATE, rel=1e-12)
    assert 0 < first["held_out"] < 0.2
    assert min(row["criterion"] for row in told["families"] if row["criterion"] is not None) >= 0
    rules = {row["rule"]: row for row in told["rules"]}
    by_gcv = identify(folder / "log.csv", folder / "model.h5", choice="gcv").load
    assert rules["gcv"]["peak"] == pytest.approx(float(by_gcv[np.argmax(np.abs(by_gcv))].item()), rel=1e-3)
    assert rules["ebic"]["lam"] is None
    assert rules["ebic"]["note"]
    text = page.read_text()
    assert "<svg" in text
    assert text.count("<script") == 1
    assert "script-src 'sha256-" in text
    assert picture.read_bytes()[:4] == b"\x89PNG"


def test_what_a_family_refuses_is_a_row(folder: Path) -> None:
    found = compare(folder / "frames.csv", folder / "patches.h5", families=["identity", "laplacian"])
    assert [row.name for row in found.families] == ["identity", "laplacian"]
    assert "lambda" in str(found)
    own = read(folder / "log.csv").select([f"s{i}" for i in range(4)])
    lost = own.values.copy()
    lost[50:60, 1] = np.nan
    gappy = replace(own, values=lost)
    told = compare(gappy, hit_model(), families=["deconvolution", "frequency lines"], validation=[])
    assert [bool(row.refused) for row in told.families] == [False, True]
    assert told.families[1].peak is None
    assert f"refused: frequency lines: {told.families[1].refused}" in str(told)
    assert all(row.held_out is None for row in told.families)
    with pytest.raises(InputError, match="no such family for these data"):
        compare(folder / "log.csv", hit_model(), families=["gradients"])


def test_families_that_the_model_does_not_carry_are_not_asked(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = hit_model()
    table = ImpulseModel(own.impulse_response(1 / RATE, 240), 1 / RATE, kind="held", hold=own.default_hold,
                         sensors=own.sensors, loads=own.loads)  # fmt: skip
    few = {name: one for name, one in comparing.HISTORIES.items() if name in ("deconvolution", "smooth", "tracker")}
    monkeypatch.setattr(comparing, "HISTORIES", few)
    told = compare(read(folder / "log.csv"), table, validation=[])
    assert [row.name for row in told.families] == ["deconvolution"]
    assert "not asked, as they need a state space and this model has none: smooth, tracker; loadid modes" in str(told)
    assert "refused" not in str(told)


def test_of_noise_no_number_is_to_be_used(run: Any, tmp_path: Path, folder: Path) -> None:
    own = read(folder / "log.csv")
    noise = np.random.default_rng(3).standard_normal(own.values.shape)
    text = [",".join(["time [s]", *(f"{c.label} [{c.unit}]" for c in own.channels)])]
    text += [",".join([f"{k * own.dt:.6f}", *map("{:.6f}".format, row)]) for k, row in enumerate(noise)]
    (tmp_path / "noise.csv").write_text("\n".join(text) + "\n")
    few = "deconvolution,smooth"
    code, out, _ = run("compare", tmp_path / "noise.csv", "--model", folder / "model.h5", "--families", few)
    assert code == 1
    assert "no load is told from noise (deconvolution, smooth)" in out
    words = ("compare", folder / "log.csv", "--model", folder / "model.h5", "--families", few)
    told = json.loads(run(*words, "--json")[1])
    assert told["usable"]
    assert {row["grade"] for row in told["families"]} <= set("ABC")


def test_compare_writes_the_page_that_its_help_names(run, folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    code, _, err = run(
        "compare", folder / "log.csv", "--model", folder / "model.h5", "--families", "deconvolution", "-o", page
    )
    assert code == 0, err
    assert "held out" in page.read_text("utf-8")


def test_kept_out_sensors_are_predicted_with_the_hold_of_the_estimate() -> None:
    model = hit_model()
    rng = np.random.default_rng(0)
    force = rng.standard_normal((120, 1))
    h = model.impulse_response(1 / RATE, 120, "zoh")[:, :, 0]
    y = np.stack([np.convolve(force[:, 0], one)[:120] for one in h.T], axis=1)
    record = load_record(y)
    found = identify(record, model, family="deconvolution", hold="zoh", noise=1e-9)
    exact = replace(found, load=force)
    assert _inputs.predicted(exact, model, record, ["s3"])["s3"] < 1e-8


def load_record(y: np.ndarray) -> Any:
    from loadid import Record

    return Record(y, 1 / RATE, list(hit_model().sensors))
