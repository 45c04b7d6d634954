"""The command line from end to end: answers, exit codes, one line per error, nothing half-written."""

import io
import json
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import numpy as np
import pytest

from loadid import LoadEstimate, Record, calibrate, cli, identify
from loadid import _commands as commands
from loadid._commands import Bar, units
from loadid._commands import check as checking
from loadid._commands import demo as demonstration
from loadid._results.summary import against
from loadid.settings import Lambda, Penalty, Sparsity
from structures import Channel
from structures._advice import on_command_line
from structures.errors import InputError, NotIdentifiable
from tests.data import measured

GROUP = EntryPoints(
    EntryPoint(name, f"loadid._commands.{name}:command", cli.GROUP)
    for name in ("demo", "info", "check", "calibrate", "identify")
)
RATE = 2000.0
PROJECT = Path(__file__).parents[2] / "pyproject.toml"


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """Entry points as an installed package has them."""
    monkeypatch.setattr(cli, "entry_points", lambda group: GROUP)


@pytest.fixture
def run(capsys):
    def call(*argv):
        code = cli.main([str(a) for a in argv])
        out = capsys.readouterr()
        return code, out.out, out.err

    return call


def hit(seed, peak=100.0, samples=2048):
    """Force and two accelerations of a two-mode system, with a little noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) / RATE
    force = peak * np.where((t > 0.1) & (t < 0.106), np.sin(np.pi * (t - 0.1) / 0.006), 0)
    table = [force]
    for shape in ([1.0, 0.5], [0.6, -0.8]):
        h = sum(a * np.exp(-12 * t) * np.sin(w * t) for a, w in zip(shape, (180.0, 900.0), strict=True))
        y = np.convolve(force, h)[:samples]
        table.append(y + 0.002 * y.std() * rng.standard_normal(samples))
    return np.column_stack(table)


@pytest.fixture
def logs(tmp_path):
    paths = []
    for k in range(4):
        paths.append(tmp_path / f"hit{k}.csv")
        table = np.column_stack([np.arange(2048) / RATE, hit(k, peak=90.0 + 7 * k)])
        np.savetxt(paths[-1], table, delimiter=",", header="time [s],F [N],a1 [m/s^2],a2 [m/s^2]", comments="")
    return paths


@pytest.fixture
def model(logs, tmp_path):
    found = calibrate(logs[:3], force="F", responses=["a1", "a2"])
    found.save(tmp_path / "model.h5")
    return tmp_path / "model.h5"


# -- the frame --------------------------------------------------------------------------------------------------------
def test_version_is_light():
    code = """
import sys
from loadid import cli
assert cli.main(["--version"]) == 0
heavy = {"scipy", "matplotlib", "h5py", "casadi", "filterpy", "skfem", "clarabel"} & set(sys.modules)
assert not heavy, heavy
from loadid._commands import calibrate, check, demo, identify, info
heavy = {"scipy", "matplotlib", "h5py"} & set(sys.modules)
assert not heavy, heavy
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "loadid 0.1.0\n"


def test_help_lists_the_commands_and_the_exit_codes(run):
    code, out, _ = run("--help")
    assert code == 0
    for word in ("demo", "info", "check", "calibrate", "identify", "1 answered but not to be used"):
        assert word in out
    for name in ("demo", "info", "check", "calibrate", "identify"):
        assert run(name, "--help")[0] == 0
    for option in ("--fs", "--columns", "--axis", "--record", "--unit", "--json"):
        for name in ("info", "check", "calibrate", "identify"):
            assert option in run(name, "--help")[1]


@pytest.mark.parametrize(
    "argv",
    [
        [],
        ["bogus"],
        ["info"],
        ["info", "a.csv", "--fs", "x"],
        ["calibrate", "a.csv"],
        ["info", "a.csv", "--fs", "0"],
        ["info", "a.csv", "--unit", "acc1"],
        ["check"],
        ["demo", "--seed", "-1"],
        ["identify", "a.csv", "--model", "m.h5", "-o", "r.h5", "--choice", "foo"],
        ["identify", "a.csv", "--model", "m.h5", "-o", "r.h5", "--choice", "-1"],
        ["identify", "a.csv", "--model", "m.h5", "-o", "r.h5", "--method", "foo"],
        ["identify", "a.csv", "--model", "m.h5", "-o", "r.h5", "--penalty", "foo"],
        ["identify", "a.csv", "--model", "m.h5", "-o", "r.h5", "--family", "foo"],
        ["identify", "a.csv", "--model", "m.h5", "-o", "r.h5", "--path", "foo"],
        ["identify", "a.csv", "--model", "m.h5", "-o", "r.h5", "--leak", "1"],
    ],
)
def test_wrong_words_are_usage(run, argv):
    code, out, err = run(*argv)
    assert code == 2
    assert not out
    assert err.startswith("loadid: ")
    assert err.count("\n") == 1
    code, _, err = run(*argv, "--json")
    assert json.loads(err)["error"]["exit"] == code == 2


@pytest.mark.parametrize(
    ("error", "code", "kind"),
    [
        (InputError("wrong\nthing", where="file", found=1, hint="do"), 3, "bad input"),
        (NotIdentifiable("two loads", advice="one more sensor", code="LID-E306"), 4, "not identifiable"),
        (OSError(28, "No space left on device"), 3, "bad input"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_errors_are_one_line_and_a_code(run, monkeypatch, error, code, kind):
    def fail(args):
        raise error

    command = commands.Command("fails", "fails", lambda parser: None, fail)
    monkeypatch.setattr(cli, "commands", lambda: {"fails": command})
    found, out, err = run("fails")
    assert (found, out, err.count("\n")) == (code, "", 1)
    found, out, err = run("fails", "--json")
    answer = json.loads(err)["error"]
    assert (found, answer["exit"], answer["kind"]) == (code, code, kind)
    if code == 4:
        assert answer["code"] == "LID-E306"


def test_other_packages_add_commands_and_cannot_break_it(run, monkeypatch):
    module = type(sys)("extra")
    module.command = commands.Command("extra", "more", lambda p: p.add_argument("n", type=int), lambda args: args.n)
    monkeypatch.setitem(sys.modules, "extra", module)
    more = [EntryPoint("extra", "extra:command", cli.GROUP), EntryPoint("broken", "no_such_module:command", cli.GROUP)]
    monkeypatch.setattr(cli, "entry_points", lambda group: EntryPoints([*GROUP, *more]))
    assert run("extra", 0)[0] == 0
    code, _, err = run("extra", 7)
    assert code == 7
    assert "'broken'" in err
    assert "left out" in err


def test_commands_of_its_own_are_those_that_are_registered():
    """An install in place that is older than its tree knows them all the same."""
    stated = tomllib.loads(PROJECT.read_text("utf-8"))["project"]["entry-points"][cli.GROUP]
    assert set(cli._OWN) == {name for name, value in stated.items() if value.startswith("loadid.")}


def test_without_entry_points_it_says_so_and_goes_on(run, monkeypatch, logs):
    monkeypatch.setattr(cli, "entry_points", lambda group: EntryPoints())
    code, out, err = run("info", logs[0])
    assert code == 0
    assert "not installed" in err
    assert "a1" in out


def test_log_level_shows_the_log_and_leaves_no_handler(run, monkeypatch):
    import logging

    def talk(args):
        logging.getLogger("loadid.x").info("hello")
        return 0

    monkeypatch.setattr(cli, "commands", lambda: {"talk": commands.Command("talk", "talk", lambda p: None, talk)})
    before = list(logging.getLogger("loadid").handlers)
    assert "hello" in run("--log-level", "info", "talk")[2]
    assert "hello" not in run("talk")[2]
    assert logging.getLogger("loadid").handlers == before


def test_a_log_of_json_holds_nothing_else(run, monkeypatch, logs):
    """Begin and end of a command, what is said aside, and errors; hushed, none of it but errors."""

    def talk(args):
        commands.say("aside", aside=True)
        return 0

    for name, words in (("--log-json", []), ("--log-json", ["--log-level", "info"])):
        monkeypatch.setattr(cli, "commands", lambda: {"talk": commands.Command("talk", "talk", lambda p: None, talk)})
        lines = [json.loads(line) for line in run(name, *words, "talk")[2].splitlines()]
        told = [line["message"] for line in lines]
        assert [text.split(" after")[0] for text in told] == (
            ["talk begins", "aside", "talk ends with exit code 0"] if words else []
        )
        monkeypatch.undo()
    assert json.loads(run("--log-json", "info", "none.csv")[2])["error"]["exit"] == 3
    monkeypatch.setattr(cli, "commands", lambda: {"talk": commands.Command("talk", "talk", lambda p: None, talk)})
    assert run("talk")[2] == "aside\n"
    assert run("-q", "talk")[1:] == ("", "")


def test_units_are_channel_equals_unit():
    assert units(["F=N", "a=b=m/s^2"]) == {"F": "N", "a=b": "m/s^2"}
    for bad in ("F", "=N", "F="):
        with pytest.raises(InputError, match="CH=UNIT"):
            units([bad])


class Screen(io.StringIO):
    def isatty(self):
        return True


def test_progress_is_drawn_on_a_terminal_only():
    pipe, screen = io.StringIO(), Screen()
    for stream in (pipe, screen):
        with Bar(stream, interval=0) as bar:
            bar(0.5, "working")
            bar(1.0, "done")
    assert pipe.getvalue() == ""
    assert "working [##########..........]  50%" in screen.getvalue()
    assert screen.getvalue().endswith("\r")


# -- info and check ---------------------------------------------------------------------------------------------------
def test_info_of_a_log(run, logs):
    code, out, _ = run("info", logs[0])
    assert code == 0
    for word in ("2048 samples", "2000 Hz", "F", "a1", "m/s^2", "acceleration"):
        assert word in out
    answer = json.loads(run("info", logs[0], "--json")[1])
    channel = answer["records"][0]["channels"][0]
    assert (channel["label"], channel["unit"]) == ("F", "N")
    assert channel["max"] == pytest.approx(90, rel=0.01)
    other = json.loads(run("info", logs[0], "--json", "--unit", "F=kN")[1])
    assert other["records"][0]["channels"][0]["max"] == pytest.approx(90e3, rel=0.01)


def test_info_of_a_guard_code_says_what_the_table_says(run, tmp_path, monkeypatch):
    from structures._flags import table

    monkeypatch.chdir(tmp_path)
    for word in ("W407", "lid-w407"):
        code, out, _ = run("info", word)
        guard = table()["W407"]
        assert code == 0
        assert all(text in out for text in (guard.title, guard.condition, guard.example, guard.docs)), out
    code, out, _ = run("info", "E501", "--json")
    assert (code, json.loads(out)["advice"]) == (0, on_command_line(table()["E501"].advice))
    (tmp_path / "W407").write_text("nothing")  # a file of this name is a file
    assert run("info", "W407")[0] == 3
    assert run("info", "W999")[0] == 3


def test_info_of_a_log_whose_units_must_be_stated(run, tmp_path):
    np.save(tmp_path / "log.npy", hit(0))
    code, out, _ = run("info", tmp_path / "log.npy")
    assert code == 0
    assert "2048 samples" in out
    assert "unit not stated" in out
    code, _, err = run("check", tmp_path / "log.npy")
    assert code == 3
    assert "--fs" in err or "--unit" in err
    named = (
        "--fs",
        RATE,
        "--columns",
        "F,a1,a2",
        "--unit",
        "F=N",
        "--unit",
        "1=m/s^2",
        "--unit",
        "a2=g",
        "--axis",
        "0",
    )
    answer = json.loads(run("info", tmp_path / "log.npy", *named, "--json")[1])
    assert [c["label"] for c in answer["records"][0]["channels"]] == ["F", "a1", "a2"]
    assert answer["records"][0]["channels"][2]["recorded_unit"] == "g"


def test_info_of_model_and_result(run, model, logs, tmp_path):
    code, out, _ = run("info", model)
    assert code == 0
    assert "measured model" in out
    assert run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5")[0] == 0
    code, out, _ = run("info", tmp_path / "r.h5")
    assert code == 0
    assert "load estimate" in out
    assert "peak" in out


def test_damaged_and_missing_files_are_bad_input(run, model):
    data = bytearray(model.read_bytes())
    data[2000] ^= 1
    model.write_bytes(data)
    for argv in (["info", model], ["check", "--model", model], ["info", "none.csv"]):
        code, _, err = run(*argv)
        assert code == 3
        assert err.count("\n") == 1


def test_check_names_what_fired_and_what_was_silent(run, tmp_path):
    table = hit(0)
    table[:, 1] = np.clip(table[:, 1], -np.inf, 0.6 * table[:, 1].max())
    np.savetxt(tmp_path / "clip.csv", table, delimiter=",", header="F [N],a1 [m/s^2],a2 [m/s^2]", comments="")
    code, out, _ = run("check", tmp_path / "clip.csv", "--fs", RATE)
    assert code == 0
    fired, silent = out.split("checked and silent:")
    assert "LID-W206" in fired
    assert "a1" in fired
    assert "clipped" in fired
    assert "W209" in silent
    answer = json.loads(run("check", tmp_path / "clip.csv", "--fs", RATE, "--json")[1])
    assert answer["silent"] == ["W209"]


def test_check_of_model_and_log(logs, model):
    fresh = checking.check(logs[3], model)
    codes = {f.code for _, f in fresh.flags}
    assert "LID-W704" not in codes
    assert {"W114", "W201", "W204", "W206", "W207", "W505", "W704"} <= set(fresh.checked)
    assert fresh.layout == {"m": 2, "n": 1, "rank": 1, "nullity": 0, "kappa": pytest.approx(1.0)}
    used = checking.check(logs[0], model)
    assert "LID-W704" in {f.code for _, f in used.flags}
    short = Record(hit(9)[:300], 1 / RATE, [Channel(label=c) for c in ("F", "a1", "a2")], name="short")
    assert "LID-W505" in {f.code for _, f in checking.check(short, model).flags}


def test_check_of_a_structural_model_sees_supports_and_aliasing():
    coarse = demonstration.model()
    slow = Record(np.random.default_rng(0).standard_normal((400, 3)), 1e-3, list(demonstration.SENSORS))
    findings = checking.check(slow, coarse)
    fired = {f.code for _, f in findings.flags}
    assert "LID-W509" in fired  # 14 modes, Nyquist frequency 500 Hz
    assert "W105" in findings.silent
    assert findings.layout["rank"] == 1  # static accelerations are zero: the rank is that between the resonances
    assert "W201" in findings.silent


# -- calibrate and identify -------------------------------------------------------------------------------------------
def test_calibrate_then_identify(run, logs, tmp_path):
    model, result = tmp_path / "model.h5", tmp_path / "result.h5"
    code, out, _ = run("calibrate", *logs[:3], "--force", "F", "--response", "a1,a2", "-o", model)
    assert code == 0
    assert out.count("yes") == 3
    assert "median coherence" in out
    page, picture = tmp_path / "page.html", tmp_path / "picture.png"
    code, out, err = run(
        "identify", logs[3], "--model", model, "-o", result, "--report", page, "--plot", picture, "--truth", "F",
        "--choice", "gcv", "--allow", "W407",
    )  # fmt: skip
    assert code == 1, err  # gcv, asked for by name, ends its range and leaves 1.6 times the noise of the training hits
    assert out.startswith("NOT TO BE USED")
    assert "against the known load" in out
    assert "allowed: LID-W407" in out
    assert "LID-W407" in page.read_text()
    assert picture.read_bytes()[:4] == b"\x89PNG"
    estimate = LoadEstimate.read(result)
    assert estimate.choice.rule == "gcv"
    assert against(estimate, hit(3, peak=111.0)[:, 0])["error"] < 0.15
    assert err == ""  # no progress where standard error is no terminal


def test_channels_by_index_and_the_json_of_a_result(run, logs, tmp_path):
    model = tmp_path / "model.h5"
    code, out, _ = run("calibrate", logs[0], logs[1], "--force", "0", "--response", "1", "-o", model, "--json")
    assert code == 0
    assert json.loads(out)["responses"] == ["a1"]
    code, out, _ = run(
        "identify",
        logs[3],
        "--model",
        model,
        "-o",
        tmp_path / "r.h5",
        "--choice",
        "0.001",
        "--response",
        "a1",
        "--json-full",
    )
    answer = json.loads(out)
    assert code == 1  # this lambda takes the load away: written and printed, not to be used
    assert answer["grade"]["letter"] == "D"
    assert len(answer["load"]) == 2048
    assert answer["choice"]["lam"] == pytest.approx(1e-3)
    assert answer["labels"] == ["F"]


@pytest.mark.parametrize(
    ("more", "word"),
    [
        (["--response", "a1"], "one channel per sensor"),
        (["--record", "x"], "no record"),
        (["--allow", "hello"], "W407"),
        (["--truth", "b"], "'b'"),
        (["--fs", "3000"], "different steps"),
    ],
)
def test_what_cannot_be_identified_leaves_no_file(run, logs, model, tmp_path, more, word):
    code, out, err = run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5", *more)
    assert code == 3
    assert word in err
    assert not out
    assert not (tmp_path / "r.h5").exists()


class Asked(Exception):
    """What a family was asked for."""


def asking(name: str):
    """In place of a family: says what it was asked for."""

    def family(model, **given):
        raise Asked(given)

    family.__name__ = name
    return family


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        (["--family", "sparse", "--dictionary", "bspline"], {"dictionary": "bspline"}),
        (
            ["--family", "sparse", "--nonnegative", "--choice", "ebic"],
            {"sparsity": Sparsity(nonnegative=True), "choice": "ebic"},
        ),
        (["--family", "deconvolution"], {}),
        (["--path", "statespace", "--initial", "unknown"], {"choice": Lambda(path="statespace"), "initial": "unknown"}),
        (["--penalty", "first_difference", "--leak", "0.99"], {"penalty": Penalty("first_difference", leak=0.99)}),
        (["--penalty", "none"], {"penalty": None}),
    ],
)
def test_words_of_the_command_line_reach_the_family(run, logs, model, tmp_path, monkeypatch, words, asked):
    monkeypatch.setattr("loadid._families.sparse.SparseDeconvolution", asking("SparseDeconvolution"))
    monkeypatch.setattr("loadid._families.deconvolution.Deconvolution", asking("Deconvolution"))
    with pytest.raises(Asked) as caught:
        run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5", *words)
    del caught.value.args[0]["progress"]
    assert caught.value.args[0] == asked


def test_loads_that_push_are_a_constraint_where_the_family_has_constraints(run, logs, model, tmp_path, monkeypatch):
    from loadid.constraints import NonNegative

    monkeypatch.setattr("loadid._families.deconvolution.Deconvolution", asking("Deconvolution"))
    with pytest.raises(Asked) as caught:
        run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5", "--nonnegative",
            "--family", "deconvolution")  # fmt: skip
    (one,) = caught.value.args[0]["constraints"]
    assert isinstance(one, NonNegative)


@pytest.mark.parametrize("words", [["--dictionary", "dirac"], ["--family", "sparse", "--penalty", "identity"]])
def test_a_setting_of_another_family_is_refused(run, logs, model, tmp_path, words):
    code, _, err = run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5", *words)
    assert code == 3
    assert "no such setting" in err
    assert words[-2].removeprefix("--") in err
    assert not (tmp_path / "r.h5").exists()


def test_a_family_that_does_not_exist_is_named(logs, model):
    with pytest.raises(InputError, match="no such family"):
        identify(logs[3], model, family="magic")


def test_the_instruments_own_file(run, tmp_path):
    path = measured("hammer_two_hits", "long_single_header_multi_ch.lvm")
    model, stated = tmp_path / "model.h5", ("--unit", "F=N")
    assert (
        run("calibrate", path, "--record", "record_1", "--force", "F", "--response", "m_1,m_2", "-o", model, *stated)[0]
        == 0
    )
    code, _, err = run("identify", path, "--model", model, "-o", tmp_path / "r.h5", *stated)
    assert code == 3
    assert "record_2" in err  # two records: one must be chosen
    code, out, _ = run(
        "identify",
        path,
        "--record",
        "record_2",
        "--model",
        model,
        "-o",
        tmp_path / "r.h5",
        "--truth",
        "F",
        "--json",
        *stated,
    )
    assert code == 0
    assert abs(json.loads(out)["against_known"]["peak_error"]) < 0.1


# -- demo -------------------------------------------------------------------------------------------------------------
def test_demo_rebuilds_the_hit_and_writes_its_files(run, tmp_path):
    code, out, err = run("demo", "--out", tmp_path / "demo", "--json")
    assert code == 0
    assert err == ""
    answer = json.loads(out)
    assert abs(answer["against_known"]["peak_error"]) < 0.02
    assert answer["against_known"]["error"] < 0.12
    assert "W702" not in answer["flags"]
    assert sorted(p.name for p in (tmp_path / "demo").iterdir()) == ["impact.h5", "impact.html", "impact.png"]
    estimate = LoadEstimate.read(tmp_path / "demo" / "impact.h5")
    assert estimate.functional("impulse", window=(0.049, 0.053)).value == pytest.approx(
        2 / np.pi * 1000 * 0.002, rel=0.05
    )


def test_demo_refuses_a_folder_it_cannot_make(run, tmp_path):
    (tmp_path / "file").write_text("")
    code, _, err = run("demo", "--out", tmp_path / "file")
    assert code == 3
    assert "folder" in err
