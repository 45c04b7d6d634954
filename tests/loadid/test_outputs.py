"""No command replaces what it reads, and nothing is left behind where one output is bad."""

import os

import pytest

from loadid import cli
from loadid._commands import require_outputs
from structures.errors import InputError
from structures.files import _storage as storage
from tests.loadid.test_cli import installed, logs, model, run

__all__ = ["installed", "logs", "model", "run"]


def listing(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}


@pytest.mark.parametrize(
    "outputs",
    [
        ["-o", "hit3.csv"],
        ["-o", "model.h5"],
        ["-o", "./x/../model.h5"],
        ["-o", "link.h5"],
        ["-o", "r.h5", "--report", "hit3.csv"],
        ["-o", "r.h5", "--report", "model.h5"],
        ["-o", "r.h5", "--report", "r.h5"],
        ["-o", "r.png", "--plot", "r.png"],
        ["-o", "r.h5", "--report", "p.png", "--plot", "p.png"],
        ["-o", "r.h5", "--plot", "p.xyz"],
        ["-o", "r.h5", "--plot", "p"],
        ["-o", "r.h5", "--report", "none/p.html"],
        ["-o", "none/r.h5", "--report", "p.html"],
        ["-o", "x"],
        ["-o", ""],
        ["-o", "hit3.csv/r.h5"],
        ["-o", "result"],
        ["-o", "r.pdf"],
        ["-o", "o.txt"],
        ["-o", "r.json"],
        ["-o", "r.h5", "--report", "r.pdf"],
        ["-o", "r.h5", "--report", "r.h5.txt"],
        ["-o", "new.h5"],
        ["-o", "pipe.h5"],
        ["-o", "r.h5", "--report", "new.html"],
        ["-o", "r.h5", "--plot", "new.png"],
    ],
)
def test_identify_refuses_before_it_writes(run, logs, model, tmp_path, monkeypatch, outputs):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x").mkdir()
    (tmp_path / "link.h5").symlink_to(tmp_path / "model.h5")
    (tmp_path / "far").mkdir()
    for name in ("new.h5", "new.html", "new.png"):
        (tmp_path / "far" / name).write_text("of somebody else")
        (tmp_path / name).symlink_to(tmp_path / "far" / name)
    os.mkfifo(tmp_path / "pipe.h5")
    before = listing(tmp_path)
    code, out, err = run("identify", "hit3.csv", "--model", tmp_path / "model.h5", *outputs)
    assert code == cli.BAD_INPUT, err
    assert "what to do" in err
    assert not out
    assert listing(tmp_path) == before


def test_calibrate_keeps_its_logs(run, logs, tmp_path):
    before = listing(tmp_path)
    code, _, err = run("calibrate", *logs[:3], "--force", "F", "--response", "a1", "-o", logs[1])
    assert code == 3
    assert "the command reads" in err
    assert listing(tmp_path) == before


def test_demo_checks_its_files_first(run, tmp_path):
    (tmp_path / "impact.html").mkdir()
    code, _, err = run("demo", "--out", tmp_path)
    assert code == 3
    assert "impact.html" in err
    assert [p.name for p in tmp_path.iterdir()] == ["impact.html"]


def test_second_names_of_one_file_are_one_file(tmp_path):
    (tmp_path / "log.csv").write_text("x")
    os.link(tmp_path / "log.csv", tmp_path / "other.csv")
    with pytest.raises(InputError, match="the command reads"):
        require_outputs({"-o": tmp_path / "other.csv"}, [tmp_path / "log.csv"])
    require_outputs({"-o": tmp_path / "new.h5", "--plot": None, "--report": tmp_path / "new.html"}, [None, "log.csv"])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["log.csv", "other.csv"]


def test_a_report_that_fails_leaves_no_result(run, logs, model, tmp_path, monkeypatch):
    def fail(*args, **kwargs):
        raise InputError("broken")

    monkeypatch.setattr("loadid._results.report.page", fail)
    code, _, err = run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5", "--report", tmp_path / "p.html")
    assert code == 3
    assert "broken" in err
    assert not (tmp_path / "r.h5").exists()


@pytest.mark.parametrize("where", ["while it computes", "while it writes"])
def test_a_run_that_is_stopped_leaves_no_partial_result(run, logs, model, tmp_path, monkeypatch, where):
    """Ctrl-C: exit code 130, one line, the old result untouched, and no temporary file."""
    (tmp_path / "r.h5").write_bytes(b"the result of yesterday")
    before, reached = listing(tmp_path), []

    def stop(*args, **kwargs):
        reached.append(args)
        if where == "while it writes" or args[1] >= 0.5:
            raise KeyboardInterrupt

    monkeypatch.setattr(*("os.fsync", stop) if where == "while it writes" else ("loadid._commands.Bar.__call__", stop))
    code, out, err = run("identify", logs[3], "--model", model, "-o", tmp_path / "r.h5")
    assert (code, out) == (130, "")
    assert "interrupted" in err
    assert reached
    assert listing(tmp_path) == before


@pytest.mark.parametrize("kind", ["link", "dangling link", "pipe", "socket", "folder"])
def test_only_a_plain_file_is_replaced(tmp_path, monkeypatch, kind):
    """What stands there stays what it is, and so does what a link leads to; nothing is left beside it."""
    import socket

    monkeypatch.chdir(tmp_path)  # paths of sockets are short
    place, other = tmp_path / "o", tmp_path / "other"
    if "link" in kind:
        if kind == "link":
            other.write_text("of somebody else")
        place.symlink_to(other)
    elif kind == "pipe":
        os.mkfifo(place)
    elif kind == "folder":
        place.mkdir()
    server = socket.socket(socket.AF_UNIX)
    try:
        if kind == "socket":
            server.bind("o")
        before = place.lstat()
        with pytest.raises(InputError, match=f"this is a {kind.split()[-1]}"):
            storage.replace(place, b"new")
        with pytest.raises(InputError, match=f"this is a {kind.split()[-1]}"):
            storage.write(place, {}, "estimate")
        assert place.lstat() == before
        assert sorted(p.name for p in tmp_path.iterdir()) == (["o", "other"] if kind == "link" else ["o"])
        assert kind != "link" or other.read_text() == "of somebody else"
    finally:
        server.close()


def test_a_device_is_refused(run, logs, model):
    node = "/dev/null"
    before = os.lstat(node)
    for outputs in (["-o", node], ["-o", "r.h5", "--report", node], ["-o", "r.h5", "--plot", node]):
        code, _, err = run("identify", logs[3], "--model", model, *outputs)
        assert code == 3
        assert "this is a device" in err
    assert os.lstat(node) == before


def test_results_and_models_are_named_as_hdf5(tmp_path, model):
    from structures import MeasuredModel

    known = MeasuredModel.load(model)
    for name in ("m.npz", "m.txt", "m.h5.bak"):
        with pytest.raises(InputError, match=r"suffix.*\.h5 or \.hdf5.*name it m\.h5?"):
            known.save(tmp_path / name)
        assert not (tmp_path / name).exists()
    for name in ("m", "m.H5", "m.hdf5"):
        known.save(tmp_path / name)
        assert MeasuredModel.load(tmp_path / name).fingerprint == known.fingerprint
