"""Answers on a disk are never taken away: one output and one run for each state, and what a killed run has written."""

import os
import signal
import socket
import struct
import subprocess
import sys
import threading
from importlib.metadata import EntryPoint, EntryPoints

import numpy as np
import pytest

from loadid import cli
from loadid._families.tracking import tracker as checkpoint
from loadid._families.tracking.tracker import Tracker
from loadid._stream import follow
from loadid._stream.output import Output, StateLock, taken
from structures.errors import InputError
from tests.killed import fitted, text


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    group = EntryPoints([EntryPoint("track", "loadid._commands.track:command", cli.GROUP)])
    monkeypatch.setattr(cli, "entry_points", lambda group=None, found=group: found)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Tracker, record, lines, file of the tracker, and the table of an undisturbed run."""
    tracker, Y = fitted(600)
    folder = tmp_path_factory.mktemp("outputs")
    tracker.save(folder / "model.h5")
    lines = text(tracker, Y)
    (folder / "log").write_bytes(b"".join(lines))
    follow(checkpoint.read(folder / "model.h5")[0], str(folder / "log"), str(folder / "out"), idle=0)
    return tracker, Y, lines, folder / "model.h5", (folder / "out").read_bytes()


@pytest.fixture
def run(made, tmp_path, capfd):
    """A run on the first lines of the log; its exit code and what it says."""

    def call(upto, out="out.csv", state="s.h5"):
        (tmp_path / "log.csv").write_bytes(b"".join(made[2][: upto + 1]))
        words = ["--model", made[3], "--in", tmp_path / "log.csv", "--out", tmp_path / out, "--idle", "0"]
        words += ["--state", tmp_path / state] if state else []
        code = cli.main(["track", *map(str, words)])
        return code, capfd.readouterr().err

    return call


# -- one output for each state ----------------------------------------------------------------------------------------
def test_a_state_knows_its_output_and_no_other_is_written(made, run, tmp_path):
    assert run(200)[0] == 0
    before = (tmp_path / "out.csv").read_bytes()
    code, said = run(400, "other.csv")
    assert code == cli.BAD_INPUT
    assert str(tmp_path / "out.csv") in said
    assert not (tmp_path / "other.csv").exists()
    (tmp_path / "other.csv").write_bytes(made[4])  # of another state
    assert run(400, "other.csv")[0] == cli.BAD_INPUT
    assert (tmp_path / "other.csv").read_bytes() == made[4]
    assert (tmp_path / "out.csv").read_bytes() == before
    assert run(600)[0] == 0
    assert (tmp_path / "out.csv").read_bytes() == made[4]


def test_answers_of_another_run_stay_where_a_new_one_is_begun(made, run, tmp_path):
    (tmp_path / "out.csv").write_bytes(made[4])
    for state in ("s.h5", None):
        code, said = run(300, state=state)
        assert code == cli.BAD_INPUT
        assert "the output exists" in said
    assert (tmp_path / "out.csv").read_bytes() == made[4]
    assert not list(tmp_path.glob("*.h5"))


def test_an_output_that_was_moved_is_known_by_its_content(made, run, tmp_path):
    assert run(200)[0] == 0
    (tmp_path / "out.csv").rename(tmp_path / "moved.csv")
    code, said = run(600)
    assert code == cli.BAD_INPUT
    assert "gone" in said
    assert run(600, "moved.csv")[0] == 0
    assert (tmp_path / "moved.csv").read_bytes() == made[4]


def test_what_others_wrote_to_an_output_stays(made, run, tmp_path):
    assert run(200)[0] == 0
    before = (tmp_path / "out.csv").read_bytes()
    with (tmp_path / "out.csv").open("ab") as file:
        file.write(b"a note")
    code, said = run(600)
    assert code == cli.BAD_INPUT
    assert "no run has written" in said
    assert (tmp_path / "out.csv").read_bytes() == before + b"a note"
    with (tmp_path / "out.csv").open("ab") as file:
        file.write(b"\n")
    assert run(600)[0] == 0
    mark = before.split(b"\n")[-2].split(b",")[0] + b",nan,nan,nan,nan\n"
    assert (tmp_path / "out.csv").read_bytes() == before + b"a note\n" + mark + made[4][len(before) :]


def test_a_state_of_a_pipe_belongs_to_pipes(made, run, tmp_path):
    if os.path.exists("/dev/null"):
        assert run(200, "/dev/null")[0] == 0
        code, said = run(400)
        assert code == cli.BAD_INPUT
        assert "standard output" in said
        assert not (tmp_path / "out.csv").exists()
        assert run(400, "/dev/null")[0] == 0


def test_a_state_of_the_first_release_goes_on(made, run, tmp_path):
    assert run(250)[0] == 0
    tracker, stream = checkpoint.read(tmp_path / "s.h5")
    for tree, names in ((stream, ["heading"]), (stream["clock"], ["begun"]), (stream["layout"], ["tick"])):
        for name in names:
            del tree[name]  # it did not know them
    checkpoint.save(tracker, tmp_path / "s.h5", stream)
    assert run(600)[0] == 0
    assert (tmp_path / "out.csv").read_bytes() == made[4]


# -- one run for each state -------------------------------------------------------------------------------------------
def test_a_state_is_held_by_one_run(made, run, tmp_path):
    assert run(200)[0] == 0
    before = (tmp_path / "s.h5").read_bytes(), (tmp_path / "out.csv").read_bytes()
    with StateLock(tmp_path / "s.h5"):
        code, said = run(600)
        assert code == cli.BAD_INPUT
        assert "another run" in said
        with pytest.raises(InputError, match="another run"):  # from Python
            follow(made[0], str(tmp_path / "log.csv"), str(tmp_path / "o"), state=tmp_path / "s.h5", idle=0)
    assert before == ((tmp_path / "s.h5").read_bytes(), (tmp_path / "out.csv").read_bytes())
    assert run(600)[0] == 0
    assert not list(tmp_path.glob(".*"))


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_a_lock_dies_with_its_process(tmp_path):
    code = (
        "import sys; from loadid._stream.output import StateLock; held = StateLock(sys.argv[1]); "
        "print('held', flush=True); sys.stdin.read()"
    )
    argv = [sys.executable, "-c", code, str(tmp_path / "s.h5")]
    with subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(InputError, match="another run"):
            StateLock(tmp_path / "s.h5")
        other.kill()
        other.wait(30)
    assert list(tmp_path.glob(".s.h5.lock"))  # it is there, and holds nobody up
    StateLock(tmp_path / "s.h5").close()
    assert not list(tmp_path.glob(".*"))


@pytest.mark.skipif(sys.platform == "win32", reason="flock")
def test_a_file_system_without_locks_refuses_nobody(tmp_path, monkeypatch):
    import fcntl

    def none(file, kind):
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", none)
    with (tmp_path / "f").open("ab") as file:
        assert taken(file)


# -- what a killed run has written ------------------------------------------------------------------------------------
def listened(folder, model, data):
    """A run on a socket that sends some lines."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            with connection:
                connection.sendall(data)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        where = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        words = ["--model", model, "--in", where, "--out", folder / "out.csv", "--state", folder / "s.h5"]
        code = cli.main(["track", *map(str, words)])
        thread.join()
    return code


def killed_behind_its_checkpoint(made, folder):
    """A run on a socket, as it is left by one that was killed: state of sample 250, answers up to 400, half a row."""
    lines = made[2]
    assert listened(folder, made[3], b"".join(lines[:251])) == 0
    state = (folder / "s.h5").read_bytes()
    assert listened(folder, made[3], b"".join([lines[0], *lines[251:401]])) == 0
    (folder / "s.h5").write_bytes(state)
    with (folder / "out.csv").open("ab") as file:
        file.write(b"4.0,1.25e")
    return made[4].split(b"\n")[:401]


def test_answers_whose_samples_do_not_come_again_stay_and_are_marked(made, tmp_path):
    kept = killed_behind_its_checkpoint(made, tmp_path)
    tracker, Y, lines, model, _ = made
    assert listened(tmp_path, model, b"".join([lines[0], *lines[421:]])) == 0
    found = (tmp_path / "out.csv").read_bytes().split(b"\n")
    assert found[:401] == kept
    assert found[401] == kept[250].split(b",")[0] + b",nan,nan,nan,nan"
    behind = Y.copy()
    behind[250:420] = np.nan  # as far as the run that went on knows
    load, std, _ = Tracker.load(model).run(behind)
    rest = np.array([line.split(b",") for line in found[402:-1]], float)
    assert np.array_equal(rest[:, 1:-2], np.column_stack([load, std])[250:])
    assert np.allclose(rest[:, 0], tracker.fitted.dt * np.arange(250, 600), atol=1e-9)
    once = (tmp_path / "out.csv").read_bytes()
    assert listened(tmp_path, model, lines[0]) == 0  # nothing new: nothing changes
    assert (tmp_path / "out.csv").read_bytes() == once


def test_answers_whose_samples_come_again_are_not_marked(made, tmp_path):
    killed_behind_its_checkpoint(made, tmp_path)
    assert listened(tmp_path, made[3], b"".join(made[2])) == 0
    assert (tmp_path / "out.csv").read_bytes() == made[4]


def test_answers_of_a_log_that_is_gone_stay(made, run, tmp_path):
    lines = made[2]
    assert run(250)[0] == 0
    state = (tmp_path / "s.h5").read_bytes()
    assert run(400)[0] == 0
    before = (tmp_path / "out.csv").read_bytes()
    (tmp_path / "s.h5").write_bytes(state)
    (tmp_path / "log.csv").write_bytes(b"".join([b"# another log\n", lines[0], *lines[401:]]))
    words = ["--model", made[3], "--state", tmp_path / "s.h5", "--in", tmp_path / "log.csv", "--out",
             tmp_path / "out.csv", "--idle", "0"]  # fmt: skip
    assert cli.main(["track", *map(str, words)]) == 0
    after = (tmp_path / "out.csv").read_bytes()
    assert after.startswith(before)
    assert after[len(before) :].split(b"\n")[0].endswith(b",nan,nan")


def test_a_run_that_is_killed_before_its_first_checkpoint_goes_on(made, run, tmp_path):
    output = Output(str(tmp_path / "out.csv"), ["time [s]", "p0 [N]", "std of p0 [N]"])
    checkpoint.save(checkpoint.read(made[3])[0], tmp_path / "s.h5", {"output": output.place()})
    output.close()
    (tmp_path / "out.csv").write_bytes(made[4][:1234])
    assert run(600)[0] == 0
    assert (tmp_path / "out.csv").read_bytes() == made[4]


def test_a_connection_that_is_reset_is_no_end(made, tmp_path, capfd):
    lines = made[2]
    whole = made[4].split(b"\n")

    with socket.create_server(("127.0.0.1", 0)) as server:
        where = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        ready = threading.Event()

        def go():
            connection, _ = server.accept()
            connection.sendall(b"".join(lines[:301]))
            ready.wait(30)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            connection.close()  # with a reset

        def seen():
            for _ in range(3000):
                if (tmp_path / "out.csv").exists() and (tmp_path / "out.csv").read_bytes().count(b"\n") == 301:
                    break
                threading.Event().wait(0.01)
            ready.set()

        threads = [threading.Thread(target=f, daemon=True) for f in (go, seen)]
        for thread in threads:
            thread.start()
        words = ["--model", made[3], "--in", where, "--out", tmp_path / "out.csv", "--state", tmp_path / "s.h5"]
        assert cli.main(["track", *map(str, words)]) == cli.BAD_INPUT
        for thread in threads:
            thread.join()
    assert "broke off" in capfd.readouterr().err
    assert (tmp_path / "out.csv").read_bytes().split(b"\n")[:-1] == whole[:301]
    assert Tracker.load(tmp_path / "s.h5").counts["samples"] == 300
