"""`loadid track` from end to end: files, pipes, sockets, states, pictures, and what it refuses."""

import io
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from importlib.metadata import EntryPoint, EntryPoints

import numpy as np
import pytest

import loadid
from loadid import cli
from loadid._families.tracking import tracker as checkpoint
from loadid._families.tracking.tracker import Tracker
from loadid._stream import follow
from structures.files import _storage as storage
from tests.killed import fitted, text


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """Entry points as an installed package has them."""
    group = EntryPoints([EntryPoint("track", "loadid._commands.track:command", cli.GROUP)])
    monkeypatch.setattr(cli, "entry_points", lambda group=None, found=group: found)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Tracker, record, lines, and the file of the tracker."""
    tracker, Y = fitted(600)
    path = tmp_path_factory.mktemp("track") / "model.h5"
    tracker.save(path)
    return tracker, Y, text(tracker, Y), path


@pytest.fixture
def run(capfd):
    def call(*argv):
        code = cli.main(["track", *(str(a) for a in argv)])
        out = capfd.readouterr()
        return code, out.out, out.err

    return call


def table(path):
    return np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)[:, :-2]  # less the alarms


def expected(made, samples=None):
    tracker, Y = Tracker.load(made[3]), made[1][:samples]
    load, std, _ = tracker.run(Y)
    return np.column_stack([np.round(np.arange(len(Y)) * tracker.fitted.dt, 6), load, std])


def test_a_folder_by_the_hour_is_tracked_as_one_log(made, run, tmp_path):
    """Against the tracker in Python on the same samples, with a gap between two files and a file that came later."""
    tracker, Y = made[0], made[1]
    f, folder = tracker.fitted, tmp_path / "hours"
    out, state = tmp_path / "out.csv", tmp_path / "state.h5"
    folder.mkdir()

    def hour(name, first, last):
        loadid.Record(Y[first:last], f.dt, f.sensors, start=1.8e9 + first * f.dt).to_csv(folder / name)

    hour("a.csv", 0, 200)
    hour("b.csv", 230, 400)
    argv = ["--model", made[3], "--state", state, "--in", folder, "--out", out]
    code, _, err = run(*argv)
    assert (code, err.count("gap") > 0) == (0, True)
    gapped = Y.copy()
    gapped[200:230] = np.nan
    load, _, _ = Tracker.load(made[3]).run(gapped)
    found = table(out)
    np.testing.assert_allclose(found[:, 1], load[: len(found), 0], rtol=1e-9, atol=1e-9 * np.nanstd(load))
    np.testing.assert_allclose(found[:, 0] - 1.8e9, np.arange(400) * f.dt, atol=1e-5)
    hour("c.csv", 400, 600)
    assert run(*argv)[0] == 0
    found = table(out)
    assert len(found) == 600
    np.testing.assert_allclose(found[:, 1], load[:, 0], rtol=1e-9, atol=1e-9 * np.nanstd(load))
    (folder / "b.csv").write_text("no numbers\n")
    code, _, err = run(*argv)
    assert code == cli.BAD_INPUT
    assert "b.csv" in err


def test_a_log_in_two_runs_is_the_log_in_one(made, run, tmp_path):
    log, out, state = (tmp_path / name for name in ("log.csv", "out.csv", "state.h5"))
    log.write_bytes(b"".join(made[2][:301]))
    argv = ["--model", made[3], "--state", state, "--in", log, "--out", out, "--idle", "0"]
    code, said, _ = run(*argv)
    assert code == 0
    assert "300 samples" in said
    assert out.read_text().startswith("time [s],p0 [N],std of p0 [N],alarm,alarm channel\n")
    log.write_bytes(b"".join(made[2]))
    code, said, _ = run(*argv, "--plot", tmp_path / "load.png", "--json")
    data = json.loads(said)
    assert code == 0
    assert data["samples"] == 300
    assert data["resumed"]
    assert data["counts"]["samples"] == data["counts"]["lines"] == 600
    assert np.array_equal(table(out), expected(made))
    assert (tmp_path / "load.png").read_bytes().startswith(b"\x89PNG")


def test_a_pipe_gives_its_table_on_standard_output(made, run, monkeypatch):
    reading, writing = os.pipe()
    os.write(writing, b"".join(text(made[0], made[1][:200], stamps=False, header=False)))
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(pipe))
        code, said, err = run("--model", made[3], "--in", "-", "--out", "-")
    assert code == 0
    assert "200 samples" in err
    found, right = table(io.StringIO(said)), expected(made, 200)
    assert np.array_equal(found[:, 1:], right[:, 1:])
    assert np.allclose(found[:, 0], right[:, 0], rtol=1e-14)


def test_a_sender_that_starts_again_loses_and_doubles_nothing(made, run, tmp_path):
    out, state = tmp_path / "out.csv", tmp_path / "state.h5"
    for upto in (250, 601):
        with socket.create_server(("127.0.0.1", 0)) as server:
            where = f"tcp://127.0.0.1:{server.getsockname()[1]}"

            def serve(server=server, upto=upto):
                connection, _ = server.accept()
                with connection:
                    connection.sendall(b"".join(made[2][:upto]))  # from the begin, each time

            thread = threading.Thread(target=serve)
            thread.start()
            assert run("--model", made[3], "--state", state, "--in", where, "--out", out)[0] == 0
            thread.join()
    assert np.array_equal(table(out), expected(made))


def test_a_tracker_with_a_lag_answers_with_the_times_of_its_answers(run, tmp_path):
    tracker, Y = fitted(400, lag=5)
    tracker.save(tmp_path / "late.h5")
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    lines = text(tracker, Y)
    for upto in (3, 120, 401):  # the first run ends before the first answer
        log.write_bytes(b"".join(lines[:upto]))
        assert run("--model", tmp_path / "late.h5", "--state", tmp_path / "s.h5", "--in", log, "--out", out,
                   "--idle", "0")[0] == 0  # fmt: skip
    late = Tracker.load(tmp_path / "late.h5")
    load, std, _ = late.run(Y)
    found = table(out)
    assert np.allclose(found[:, 0], np.arange(395) * tracker.fitted.dt, atol=1e-9)
    assert np.array_equal(found[:, 1:], np.column_stack([load, std])[5:])


@pytest.mark.parametrize("every", [10**6, 7])
def test_late_rows_are_put_in_their_place_and_beyond_the_window_counted(made, tmp_path, every):
    """Rows and single channels that come late: the answers that are still to come are those of the log in order."""
    f, gate = made[0].fitted, made[0].gate
    Y, state = made[1].copy(), tmp_path / "s.h5"
    Y[300, 1:] = np.nan
    lines, split = text(made[0], Y), f"{300 * f.dt:.6f},,"  # the channels of sample 300 that come after it
    lines[301 + 4] += (split + ",".join(map(repr, made[1][300, 1:].tolist())) + "\n").encode()
    for k, by in ((100, 5), (102, 1), (200, 3), (201, 5), (400, 9)):
        lines[k + 1 + by] += lines[k + 1]
        lines[k + 1] = b""
    (tmp_path / "log").write_bytes(b"")
    for part in np.array_split(np.array(lines, object), 600 // every + 1):  # started again and again
        with (tmp_path / "log").open("ab") as file:
            file.write(b"".join(part))
        tracker, stream = checkpoint.read(state) if state.exists() else (Tracker(f, gate, 6), None)
        done = follow(tracker, str(tmp_path / "log"), str(tmp_path / "o"), state=state, stream=stream, idle=0)
    assert (done.counts["replayed"], done.counts["late"]) == (5, 1)  # 9 is more than the lag
    in_order = made[1].copy()
    in_order[400] = np.nan
    load, std, _ = Tracker(f, gate, 6).run(in_order)
    away = np.abs(table(tmp_path / "o")[:, 1:] - np.column_stack([load, std])[6:]).max(axis=1)
    out = [k - 6 + i for k, by in ((100, 5), (102, 1), (200, 3), (201, 5), (300, 4)) for i in range(by + 1)]
    assert set(np.flatnonzero(away > 1e-10 * np.abs(load).max())) == set(out)  # were out when the row came


def test_a_file_that_has_been_read_is_waited_for_and_this_is_said(made, run, tmp_path, monkeypatch, caplog):
    """Once, with what ends the run; a file that ends by itself needs no word, and tells how far it is read."""
    log, shares = tmp_path / "log.csv", []
    log.write_bytes(b"".join(made[2][:101]))
    monkeypatch.setattr("loadid._stream.STANDS", 0.2)

    def interrupt():
        until = time.monotonic() + 20
        while time.monotonic() < until and not any("waits" in r.message for r in caplog.records):
            time.sleep(0.01)
        time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=interrupt)
    thread.start()
    code, _, err = run("--model", made[3], "--in", log, "--out", tmp_path / "out.csv")
    thread.join()
    assert (code, err.count("waits for the file to grow")) == (0, 1)
    assert "100 samples are answered" in err
    assert "--idle" in err
    follow(
        Tracker.load(made[3]), str(log), str(tmp_path / "o.csv"), idle=0, progress=lambda f, t: shares.append((f, t))
    )
    assert shares[-1] == (1.0, "100 samples tracked")
    assert "waits" not in run("--model", made[3], "--in", log, "--out", tmp_path / "p.csv", "--idle", "0.5")[2]


def test_a_signal_ends_a_run_after_its_checkpoint(made, run, tmp_path):
    log, out, state = (tmp_path / name for name in ("log.csv", "out.csv", "state.h5"))
    log.write_bytes(b"".join(made[2][:101]))

    def interrupt():
        until = time.monotonic() + 20
        while time.monotonic() < until and not (out.exists() and out.read_bytes().count(b"\n") == 101):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=interrupt)
    thread.start()
    code, said, _ = run("--model", made[3], "--state", state, "--in", log, "--out", out)
    thread.join()
    assert code == 0
    assert "stopped" in said
    assert Tracker.load(state).counts["samples"] == 100
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_the_terminal_shows_the_load(made, run, tmp_path, monkeypatch):
    screen = io.StringIO()
    screen.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", screen)
    (tmp_path / "log").write_bytes(b"".join(made[2]))
    assert run("--model", made[3], "--in", tmp_path / "log", "--out", tmp_path / "o", "--idle", "0", "--plot")[0] == 0
    assert "p0 [N]  now" in screen.getvalue()
    assert "█" in screen.getvalue()


def test_what_cannot_be_tracked_is_refused_before_anything_is_written(made, run, tmp_path):
    log, out, model = tmp_path / "log", tmp_path / "out", made[3]
    log.write_bytes(b"".join(made[2]))
    assert run("--in", log, "--out", out)[0] == cli.USAGE
    assert run("--model", model, "--in", log, "--out", out, "--idle", "-1")[0] == cli.USAGE
    other = fitted(500)[0]
    other.save(tmp_path / "other.h5")
    assert run("--model", tmp_path / "other.h5", "--state", tmp_path / "s.h5", "--in", log, "--out", tmp_path / "o",
               "--idle", "0")[0] == 0  # fmt: skip
    storage.write(tmp_path / "kind.h5", {}, "load estimate")
    (tmp_path / "torn.h5").write_bytes(model.read_bytes()[:-1])
    (tmp_path / "names").write_bytes(b"time,a,b\n1,2,3\n")
    cases = {
        "no such file": ["--state", tmp_path / "none.h5", "--in", log],
        "another tracker": ["--model", model, "--state", tmp_path / "s.h5", "--in", log],
        "no tracker": ["--model", tmp_path / "kind.h5", "--in", log],
        "damaged": ["--model", tmp_path / "torn.h5", "--in", log],
        "cannot be read": ["--model", model, "--in", tmp_path / "nothing"],
        "nobody answers": ["--model", model, "--in", "tcp://127.0.0.1:1"],
        "the command reads": ["--model", model, "--in", out],
    }
    for words, argv in cases.items():
        code, _, err = run(*argv, "--out", out)
        assert code == cli.BAD_INPUT, words
        assert words in err
        assert not out.exists()
    code, _, err = run("--model", model, "--in", tmp_path / "names", "--out", out)
    assert code == cli.BAD_INPUT
    assert "channel a0" in err


def test_a_new_start_loads_nothing_that_it_does_not_need(made, tmp_path):
    """A fresh process that goes on from a state: the compiler or pictures would cost it more than all the rest."""
    log = tmp_path / "log"
    log.write_bytes(b"".join(made[2][:301]))
    words = ["--model", made[3], "--state", tmp_path / "s.h5", "--in", log, "--out", tmp_path / "o", "--idle", "0"]
    argv = ["track", *(str(w) for w in words)]
    assert cli.main(argv) == 0
    log.write_bytes(b"".join(made[2]))
    code = (
        f"import sys; from loadid import cli; done = cli.main({argv!r}); "
        "print(done, *({'numba', 'matplotlib', 'filterpy', 'scipy.stats'} & set(sys.modules)))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert ran.stdout.splitlines()[-1] == "0"
    assert np.array_equal(table(tmp_path / "o"), expected(made))


def test_the_alarm_in_which_a_stream_ends_is_said_in_a_line(made, run, tmp_path):
    """The run has done what it was asked for: exit 0, in rows and last line what is wrong."""
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    Y = made[1].copy()
    Y[300:, 1] = Y[300, 1]
    log.write_bytes(b"".join(text(made[0], Y)))
    code, said, err = run("--model", made[3], "--in", log, "--out", out, "--idle", "0", "--json")
    alarm = json.loads(said)["alarm"]
    label = made[0].fitted.sensors[1].label
    assert code == 0
    assert (alarm["code"], alarm["channel"]) == (528, 2)
    assert 300 < round(alarm["since"] / made[0].fitted.dt) <= 400
    assert err.splitlines()[-1].startswith(f"alarm since {alarm['since']:.6g} s (W528): channel {label} is wrong")
