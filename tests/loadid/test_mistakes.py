"""What people get wrong: every mistake is named, with what to do, and none is taken silently."""

import json

import h5py
import numpy as np
import pytest

import loadid
from loadid import Record, StaticInversion, cli, read, read_all
from loadid._commands.identify import known_load
from loadid._families.data import WITHOUT_SENSOR, gather
from loadid._readers import outline
from structures import Channel, MatrixModel, MeasuredModel
from structures._advice import Option
from structures.errors import InputError
from tests.loadid.made import impact
from tests.loadid.readers.files import small_files
from tests.loadid.test_cli import RATE, hit, installed, logs, model, run

__all__ = ["installed", "logs", "model", "run"]


def table(path, names, values):
    np.savetxt(path, values, delimiter=",", header=names, comments="", fmt="%.6f")
    return path


@pytest.fixture
def plain(tmp_path):
    """Time and three channels without units."""
    values = np.column_stack([np.arange(200) / 1000, np.random.default_rng(0).standard_normal((200, 3))])
    return table(tmp_path / "cols.csv", "time,F,a1,a2", values)


# -- gaps -------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("missing", [1, 10, 100, 200, 1000])
@pytest.mark.parametrize(("fs", "digits"), [(10000, 4), (10000, 9), (3200, 4), (1 / 3.4, 0)])
def test_gaps_of_any_length_keep_the_step(tmp_path, missing, fs, digits):
    t = np.round(np.arange(10_000) / fs, digits)
    keep = np.r_[0:4000, 4000 + missing : 10_000]
    rows = "\n".join(f"{x:.{digits}f},{k}" for x, k in zip(t[keep], keep, strict=True))
    (tmp_path / "gap.csv").write_text(f"time,F [N]\n{rows}\n")
    r = read(tmp_path / "gap.csv")
    assert r.fs == pytest.approx(fs, rel=1e-6)
    assert len(r) == 10_000
    assert np.flatnonzero(np.isnan(r["F"])).tolist() == list(range(4000, 4000 + missing))
    assert r["F"][-1] == 9999
    assert any(n.startswith(f"{missing} sample") and "after sample 3999" in n for n in r.notes)


def test_many_gaps(tmp_path):
    rng = np.random.default_rng(1)
    keep = np.sort(np.r_[0, 9999, rng.choice(np.arange(1, 9999), 9000, replace=False)])
    rows = "\n".join(f"{k / 10000:.4f},{k}" for k in keep)
    (tmp_path / "gap.csv").write_text(f"time,F [N]\n{rows}\n")
    r = read(tmp_path / "gap.csv")
    assert (r.fs, len(r)) == (10_000, 10_000)
    assert np.flatnonzero(~np.isnan(r["F"])).tolist() == keep.tolist()


# -- one way to count channels ----------------------------------------------------------------------------------------
def test_indices_count_the_channels_without_time(run, plain):
    code, out, _ = run("info", plain)
    assert code == 0
    assert "0: F [unit not stated], 1: a1 [unit not stated], 2: a2" in out
    assert "step 0.001 s" in out
    stated = ("--unit", "F=N", "--unit", "1=g", "--unit", "a2=g")
    answer = json.loads(run("info", plain, "--json", *stated)[1])["records"][0]
    assert [c["recorded_unit"] for c in answer["channels"]] == ["N", "g", "g"]
    assert "unit g as stated is that of channel 1, a1" in answer["notes"]
    assert json.loads(run("info", plain, "--json", *stated, "--columns", "1")[1])["records"][0]["channels"][0][
        "label"
    ] == ("a1")
    code, out, _ = run("info", plain, "--unit", "1=kN")  # what an index means is said, not guessed
    assert code == 0
    assert "unit kN as stated is that of channel 1, a1" in out


@pytest.mark.parametrize("key", ["3", "b", "ch1"])
def test_the_list_of_channels_has_no_time_and_no_phantom(run, plain, key):
    code, _, err = run("info", plain, "--unit", f"{key}=N")
    assert code == 3
    assert "the channels 0: F, 1: a1, 2: a2;" in err


def test_unnamed_columns_have_one_name(run, tmp_path):
    values = np.column_stack([np.arange(50) / 100, np.arange(50) % 7, np.arange(50) % 5])
    bare = tmp_path / "bare.csv"
    np.savetxt(bare, values, delimiter=",")
    empty = table(tmp_path / "empty.csv", "time,,", values)
    for path in (bare, empty):
        assert outline(path)[0].labels == ("ch1", "ch2")
        assert "0: ch1" in run("info", path)[1]
        code, _, err = run("check", path)
        assert code == 3
        assert "--unit ch1=UNIT --unit ch2=UNIT" in err
        assert read(path, units={0: "N", "ch2": "g"}).labels == ("ch1", "ch2")


def test_one_channel_has_one_unit(run, plain):
    for pair in (["a1=g", "a1=N"], ["a1=g", "1=N"]):
        code, _, err = run("info", plain, *(x for p in pair for x in ("--unit", p)), "--unit", "F=N", "--unit", "a2=g")
        assert code == 3
        assert "two units" in err or "twice" in err


def test_a_doubled_name_names_no_column(run, tmp_path):
    numbers = np.column_stack([np.arange(9) / 10, np.arange(9.0) ** 2, np.ones(9), 3 * np.ones(9)])
    path = table(tmp_path / "d.csv", "time [s],acc1 [g], acc1 [g],acc2 [g]", numbers)
    one = MatrixModel([[2.0]], sensors=[Channel(label="acc1", quantity="acceleration", unit="m/s^2")])
    found = read(path)
    assert any("'acc1' is read as 'acc1 (column 2)'" in n for n in found.notes)
    assert "acc1 (column 3)" in run("info", path)[1]
    for use in (
        lambda: found["acc1"],
        lambda: found.select(["acc2", "acc1"]),
        lambda: StaticInversion(one).estimate(found),
        lambda: read(path, columns=["acc1"]),
        lambda: read(path, units={"acc1": "N"}),
    ):
        with pytest.raises(InputError, match=r"columns 2 and 3.*rename.*0 .index. or 'acc1 .column 2.'"):
            use()
    code, _, err = run("calibrate", path, "--force", "acc1", "--response", "acc2", "-o", tmp_path / "m.h5")
    assert code == 3
    assert "columns 2 and 3" in err
    np.testing.assert_array_equal(found["acc2"], 3 * 9.80665)  # what is not asked for does not stand in the way
    np.testing.assert_allclose(found["acc1 (column 2)"], numbers[:, 1] * 9.80665)
    assert read(path, columns=[1]).labels == ("acc1 (column 3)",)
    other = MatrixModel([[2.0]], sensors=[Channel(label="acc2", quantity="acceleration", unit="m/s^2")])
    np.testing.assert_allclose(StaticInversion(other, choice=0.0).estimate(found).load, 3 * 9.80665 / 2)


def test_a_doubled_number_is_no_index(tmp_path):
    path = table(tmp_path / "d.csv", "time [s],1 [g],1 [g]", np.column_stack([np.arange(9) / 10, np.ones((9, 2))]))
    with pytest.raises(InputError, match="columns 2 and 3"):
        read(path)["1"]
    assert read(path)[1].shape == (9,)


def test_two_time_columns(tmp_path):
    t = np.arange(9) / 10
    for second, times in (("Time [s]", 2.0), (" time [s]", 0.5)):
        path = table(tmp_path / "d.csv", f"time [s],a [g],{second}", np.column_stack([t, np.ones(9), times * t]))
        with pytest.raises(InputError, match=r"named as time.*columns 1, 3"):
            read(path)
    path = table(tmp_path / "d.csv", "time [s],a [g],time [s],b [g]", np.column_stack([t, np.ones(9), t, t]))
    assert read(path).labels == ("a", "time (column 3)", "b")
    assert read(path).dt == pytest.approx(0.1)


@pytest.mark.parametrize("form", ["h5", "lvm", "npz"])
def test_doubled_names_in_other_forms(form, tmp_path):
    path = small_files(tmp_path)[form]
    if form == "lvm":
        path.write_text(path.read_text().replace("\tF\ta\tComment", "\ta\ta\tComment"))
    elif form == "npz":
        np.savez(path, x=np.ones((9, 2)), time=np.arange(9) / 10, channels=["a", "a"], units=["N", "g"])
    else:
        with h5py.File(path, "r+") as file:
            file["run"].attrs["channels"] = ["a", "a"]
    found = read_all(path)[0]
    assert len(found.labels) == 2
    with pytest.raises(InputError, match="columns 2 and 3" if form == "lvm" else "columns 1 and 2"):
        found.index("a")


def test_doubled_labels_of_a_record_are_told_by_their_columns():
    with pytest.raises(InputError, match="'a' over columns 1, 3"):
        Record(np.ones((4, 3)), 1.0, ["a", "b", "a"])


# -- a stated frequency that contradicts the file ---------------------------------------------------------------------
def test_a_contradicting_frequency_is_said_everywhere(run, logs, model, tmp_path):
    assert "contradict each other" in run("info", logs[3], "--fs", "3000")[1]
    assert "contradict each other" in run("check", logs[3], "--fs", "3000")[1]
    assert "contradict each other" not in run("info", logs[3], "--fs", "2001")[1]
    code, _, err = run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5", "--fs", "3000")
    assert code == 3
    assert "contradict each other" in err
    assert "dt=)" not in err
    page = tmp_path / "p.html"
    code, out, err = run(
        "identify", logs[3], "--model", model, "-o", tmp_path / "r.h5", "--report", page, "--fs", "2000.0000001"
    )
    assert code == 0, err
    assert "fs = 2000 Hz as stated replaces" in out
    assert "fs = 2000 Hz as stated replaces" in page.read_text()
    assert "as stated replaces" in run("info", tmp_path / "r.h5")[1]


# -- the known load ---------------------------------------------------------------------------------------------------
def test_a_known_load_in_another_unit_is_refused(run, logs, model, tmp_path):
    code, _, err = run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5", "--truth", "a1")
    assert code == 3
    assert "another unit than the load" in err
    assert not (tmp_path / "r.h5").exists()
    known = MeasuredModel.load(model)
    log = read(logs[3])
    for bad in (np.zeros(len(log)), np.full(len(log), np.nan)):
        with pytest.raises(InputError, match="nothing to compare"):
            known_load(Record(np.column_stack([log.values, bad]), log.dt, [*log.channels, "none"]), known, "none")


# -- errors that say where and what to do -----------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--response", "F,a2"], "channel 'F' is in another unit than the sensor 'a1'"),
        (["--response", "a1,a1"], "channel 'a1' is given twice"),
        (["--response", "a1,1"], "channel 'a1' is given twice"),
        (["--response", "a1"], "what to do: name one for every sensor"),
        (["--allow", "W999"], "no such guard code"),
    ],
)
def test_channels_of_identify(run, logs, model, tmp_path, more, words):
    code, _, err = run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5", *more)
    assert code == 3
    assert words in err


@pytest.mark.parametrize("response", ["a1,a1", "a1,F", "a1,0", "1,a1"])
def test_channels_of_calibrate_come_once(run, logs, tmp_path, response):
    code, _, err = run("calibrate", logs[0], "--force", "F", "--response", response, "-o", tmp_path / "m.h5")
    assert code == 3
    assert "is given twice" in err


def test_hits_of_different_steps_are_named(run, logs, tmp_path):
    values = np.column_stack([np.arange(2048) / (2 * RATE), hit(9)])
    other = table(tmp_path / "fast.csv", "time [s],F [N],a1 [m/s^2],a2 [m/s^2]", values)
    code, _, err = run("calibrate", logs[0], other, "--force", "F", "--response", "a1", "-o", tmp_path / "m.h5")
    assert code == 3
    assert "fast.csv" in err
    assert "hit0.csv" in err


def test_a_model_is_no_log_and_a_result_is_no_model(run, logs, model, tmp_path):
    result = tmp_path / "r.h5"
    assert run("identify", logs[3], "--model", model, "-o", result)[0] == 0
    for file, word in ((model, "model"), (result, "result")):
        code, _, err = run("calibrate", file, "--force", "F", "--response", "a1", "-o", tmp_path / "m.h5")
        assert code == 3
        assert f"this is a loadid {word}, not a log" in err
    code, _, err = run("identify", logs[3], "--model", result, "-o", tmp_path / "s.h5")
    assert code == 3
    assert "this is a result, not a model" in err
    with pytest.raises(InputError, match="this is a model, not a result"):
        loadid.load(model)
    assert loadid.load(result).labels == ("F",)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("time,F [N]\n0,1\n1,x\n2,3\n3,4\n4,5\n5,6\n6,7\n7,8\n", "no number"),
        ("time,F [N]\n0,1\n1,2,3\n2,3\n3,4\n4,5\n5,6\n6,7\n7,8\n", "different length"),
        ("time,F [N]\n0,1\n1,inf\n2,3\n3,4\n", "infinite"),
        ("time,F\n0,1\n1,inf\n2,3\n3,4\n", "infinite"),
        ("time,F\n0,1\n2,1\n1,3\n3,4\n", "time does not rise"),
    ],
)
def test_info_of_an_unusable_file(run, tmp_path, content, word):
    (tmp_path / "bad.csv").write_text(content)
    code, out, err = run("info", tmp_path / "bad.csv")
    assert code == 3
    assert word in err
    assert "what to do" in err
    assert "not stated" not in out + err


def test_a_cut_header_says_what_to_do(run, tmp_path):
    (tmp_path / "cut.lvm").write_text("LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\n")
    code, _, err = run("info", tmp_path / "cut.lvm")
    assert code == 3
    assert "what to do" in err


def test_empty_paths_and_arrays_are_no_files(run):
    code, _, err = run("info", "")
    assert code == 3
    assert "the path is empty" in err
    with pytest.raises(InputError, match="type ndarray") as caught:
        read(np.arange(1000.0))
    assert len(str(caught.value)) < 250


def test_advice_has_its_command_line_form(run, tmp_path):
    np.save(tmp_path / "x.npy", hit(0))
    code, _, err = run("check", tmp_path / "x.npy")
    assert code == 3
    assert "--fs HZ" in err
    assert "Python" not in err
    assert "fs=HZ" not in err
    assert Option("penalty", "identity").python == "penalty='identity'"
    assert Option("penalty", "identity").command == "--penalty identity"
    assert WITHOUT_SENSOR.command == "calibrate a model without this sensor"


def test_without_a_penalty(run, logs, model, tmp_path):
    code, out, err = run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5", "--penalty", "none")
    assert code in (cli.DONE, cli.REFUSED), err
    assert "relative lambda 0 " in out if code == 0 else "E306" in err


def test_json_has_no_arrays_unless_asked(run, logs, model, tmp_path):
    argv = ("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5")
    short, whole = (json.loads(run(*argv, option)[1]) for option in ("--json", "--json-full"))
    assert len(json.dumps(short)) < 20_000
    assert short["shape"] == [2048, 1]
    assert short["axis"]["samples"] == 2048
    assert len(whole["load"]) == 2048
    assert short["peaks"] == whole["peaks"]
    assert "load" not in json.loads(run("info", tmp_path / "r.h5", "--json")[1])


def test_info_of_a_model_is_words(run, model):
    out = run("info", model)[1]
    for word in ("sensors a1 [m/s^2], a2 [m/s^2]; loads F [N]", "0 to 1000 Hz", "3 of 3 hits used", "coherence",
                 "verification:"):  # fmt: skip
        assert word in out
    assert "array" not in out
    assert "1 record\n" in run("info", model.parent / "hit0.csv")[1]


# -- bare exceptions --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "action",
    [
        lambda e: e.functional(window=0.04),
        lambda e: e.functional(window=("a", "b")),
        lambda e: e.functional(np.full(e.load.shape, np.nan)),
        lambda e: e.functional(["a"]),
        lambda e: e.band("a"),
        lambda e: e.band(None),
        lambda e: e.plot(ax="q"),
        lambda e: e.plot(path=""),
        lambda e: e.save(None),
        lambda e: e.save(""),
        lambda e: e.report(None),
        lambda e: MeasuredModel.load(None),
        lambda e: loadid.load(3),
        lambda e: Record([1.0, 2.0], 1.0).window("a"),
        lambda e: Record(np.ones((2, 5000)), 1.0),
    ],
)
def test_wrong_arguments_are_input_errors(action):
    with pytest.raises(InputError):
        action(impact(samples=64))


def test_many_channels_are_fine_when_named():
    assert len(Record(np.ones((2, 100)), 1.0, [f"c{i}" for i in range(100)]).labels) == 100


# -- units of another kind ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("unit", ["deg", "mm", "N"])
def test_a_unit_is_advised_only_where_the_file_states_no_kind(unit):
    model = MatrixModel(np.ones((1, 1)), sensors=[Channel(label="a", quantity="acceleration", unit="m/s^2")])
    stated = Record(np.ones((9, 1)), 1, "a").apply_units({"a": unit})
    with pytest.raises(InputError, match="sensor measures acceleration") as caught:
        gather(stated, None, model, None)
    assert "m/s^2)" not in caught.value.hint
    with pytest.raises(InputError, match="--unit a=m/s") as caught:
        gather(Record(np.ones((9, 1)), 1, "a"), None, model, None)


@pytest.mark.parametrize(("largest", "asked"), [(20.0, True), (2000.0, True), (0.005, False), (2e-3, False)])
def test_strains_beyond_any_linear_model_are_asked_about(largest, asked):
    channel = Channel(label="e", quantity="strain", unit="m/m")
    found = Record(largest * np.sin(np.arange(200) / 9), 1e-3, channel).health()
    assert any("is it microstrain" in f.message for f in found) is asked
    model = MatrixModel(np.ones((2, 1)), sensors=[channel, Channel(label="f", quantity="strain", unit="m/m")])
    flags = StaticInversion(model).estimate([largest, largest * 1.01]).flags
    assert any("is it microstrain" in f.message for f in flags) is asked
