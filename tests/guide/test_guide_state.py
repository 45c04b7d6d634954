"""The state of a guide: what a change makes stale, and a file that is damaged, edited or fought over."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loadid._guide import ledger
from loadid._guide.job import Guide
from structures.errors import InputError
from tests.sources import ROOT

from . import jobs
from .jobs import guide


def states(folder: Path) -> dict[int, str]:
    return {one.step.number: one.state for one in Guide.open(folder / "wing.toml").standing()}


def reasons(folder: Path, number: int) -> str:
    return "; ".join(Guide.open(folder / "wing.toml").standing()[number - 1].why)


def touched(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b"\n")


# -- stale -------------------------------------------------------------------------------------------------------------
def another_model(folder: Path) -> None:
    jobs.wing(38, jobs.PATCHES).save(folder / "wing.h5")


def settings(old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / "wing.toml").read_text()
        assert old in text
        (folder / "wing.toml").write_text(text.replace(old, new))

    return change


CHANGES: dict[str, tuple[Callable[[Path], Any], int, str]] = {
    "model": (another_model, 1, "wing.h5 has changed since it was signed"),
    "log": (lambda folder: touched(folder / "service.csv"), 4, "service.csv has changed since"),
    "log gone": (lambda folder: (folder / "service.csv").unlink(), 4, "service.csv is not there any more"),
    "report": (lambda folder: touched(folder / "report.pdf"), 1, "evidence report.pdf has changed"),
    "known load": (lambda folder: touched(folder / "hang.csv"), 2, "evidence hang.csv has changed"),
    "validation": (lambda folder: (folder / "sand.csv").unlink(), 9, "evidence sand.csv is not there any more"),
    "inverse": (lambda folder: (folder / "wing.inverse.h5").write_bytes(b""), 8, "wing.inverse.h5 has changed"),
    "frozen job": (lambda folder: touched(folder / "wing.frozen.toml"), 8, "wing.frozen.toml has changed"),
    "penalty": (settings("second_difference", "gradient"), 3,
                'penalty of the job has changed: "second_difference" when it was signed, "gradient" now'),
    "a setting more": (settings("family", "nonnegative = true\nfamily"), 3,
                       "nonnegative of the job has changed: not given when it was signed, true now"),
    "another log": (settings("service.csv", "plain.csv"), 4, 'log of the job has changed: "service.csv" when'),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGES)
def test_what_a_signature_stands_on_makes_it_stale_and_those_after_it(wing: Path, name: str) -> None:
    change, first, said = CHANGES[name]
    change(wing)
    found = states(wing)
    assert [n for n, state in found.items() if state == "stale"] == list(range(first, 11)), found
    assert said in reasons(wing, first)
    if first < 10:
        assert f"step {first} " in reasons(wing, 10)
    waits = Guide.open("wing.toml").next()
    assert waits is not None
    assert waits.step.number == first


@pytest.mark.parametrize("change", [
    settings("family", "# a remark\nfamily"), settings("family", 'output = "load.h5"\nfamily'),
    lambda folder: os.utime(folder / "wing.h5", (0, 0)), lambda folder: (folder / "cell.txt").write_text("new"),
])  # fmt: skip
def test_what_no_signature_stands_on_changes_nothing(wing: Path, change: Callable[[Path], Any]) -> None:
    change(wing)
    assert set(states(wing).values()) == {"signed"}


def test_a_stale_step_locks_those_after_it_until_it_is_signed_again(wing: Path, capsys: Any) -> None:
    touched(wing / "hang.csv")
    assert guide("sign", 4) == 3
    said = capsys.readouterr().err
    assert "step 2 verify the forward model is signed again: evidence hang.csv has changed" in said
    assert guide("sign", 2, "--evidence", "hang.csv") == 0
    found = states(wing)
    assert (found[1], found[2], found[3]) == ("signed", "signed", "stale")
    assert "step 2 verify the forward model was signed again" in reasons(wing, 3)
    assert len(Guide.open("wing.toml").ledger.signatures) == 11  # nothing is ever taken away


# -- damaged -----------------------------------------------------------------------------------------------------------
def test_a_file_that_was_cut_is_refused_at_every_50th_byte(wing: Path) -> None:
    path = wing / "wing.guide.toml"
    whole = path.read_bytes()
    for k in range(0, len(whole) - 1, 50):
        path.write_bytes(whole[:k])
        with pytest.raises(InputError):
            ledger.read(path)
    path.write_bytes(whole)
    assert len(ledger.read(path).signatures) == 10


def parsed(line: str) -> Any:
    try:
        return tomllib.loads(line)
    except tomllib.TOMLDecodeError:
        return line


def test_every_figure_that_is_changed_is_refused_by_the_name_of_its_step(wing: Path) -> None:
    """The last digit of every number of every signature, one after the other."""
    path = wing / "wing.guide.toml"
    lines = path.read_text("utf-8").splitlines(keepends=True)
    step, tried = 0, 0
    for k, line in enumerate(lines):
        if line.startswith("step = "):
            step = int(line.removeprefix("step = "))
        if not step or not (digit := re.search(r"\d(?=\D*$)", line)) or line.startswith(("#", "step")):
            continue
        tried += 1
        if tried % 5:
            continue
        other = line[: digit.start()] + str((int(digit[0]) + 1) % 10) + line[digit.end() :]
        if parsed(other) == parsed(line):
            continue  # the seventeenth digit of a number may be one too many
        path.write_text("".join([*lines[:k], other, *lines[k + 1 :]]), "utf-8")
        with pytest.raises(InputError, match=rf"of step {step} .* was changed after it was signed|no TOML|is none"):
            ledger.read(path)
    assert tried > 100


EDITS: dict[str, tuple[Callable[[str], str], str]] = {
    "a signature taken out": (lambda t: re.sub(r"# -- 10 .*?(?=# end)", "", t, flags=re.S), "one is missing"),
    "one in the middle": (lambda t: re.sub(r"# -- 4 .*?(?=# -- 5)", "", t, flags=re.S), "of step 5 physical"),
    "two in another order": (lambda t: re.sub(r"(# -- 4 .*?)(# -- 5 .*?)(?=# -- 6)", r"\2\1", t, flags=re.S), "step 5"),
    "a key twice": (lambda t: t.replace("holds = true", "holds = true\nholds = true", 1), "no TOML"),
    "another verdict": (lambda t: t.replace("holds = true", "holds = false", 1), "of step 1 characterise"),
    "a key that is none": (lambda t: t.replace("holds = true", "holds = true\nseen = 1", 1), "'seen'"),
    "a key less": (lambda t: t.replace("note = ", "# note = ", 1), "note is none"),
    "another signer": (lambda t: t.replace("A. Engineer", "B. Engineer", 1), "of step 1 characterise"),
    "the date as a date": (lambda t: re.sub(r'date = "([^"]+)"', r"date = \1", t, count=1), "date is none"),
    "another job": (lambda t: t.replace('job = "wing.toml"', 'job = "other.toml"', 1), "the seal"),
    "a step that is none": (lambda t: t.replace("step = 3", "step = 30", 1), "no such step"),
    "a step as a text": (lambda t: t.replace("step = 3", 'step = "3"', 1), "step is none"),
    "another format": (lambda t: t.replace("format = 1", "format = 2", 1), "newer release"),
    "figures as a number": (lambda t: t.replace("[signature.figures]", "figures = 3\n[signature.other]", 1), "other"),
    "a hash": (lambda t: re.sub(r'"wing.h5" = "\w{4}', '"wing.h5" = "0000', t, count=1), "of step 1 characterise"),
    "signatures that are none": (lambda t: t.partition("# -- 1 ")[0].replace("\n[about]", '\nsignature = 3\n[about]')
                                 + "# end of the guide\n", "no list of signatures"),
    "empty": (lambda t: "", "its end is missing"),
    "not a word of it": (lambda t: "\0\1\n# end of the guide\n", "no TOML"),
}  # fmt: skip


@pytest.mark.parametrize("name", EDITS)
def test_an_edit_is_refused_by_name_and_never_guessed(wing: Path, capsys: Any, name: str) -> None:
    path = wing / "wing.guide.toml"
    edit, said = EDITS[name]
    text = path.read_text("utf-8")
    assert edit(text) != text
    path.write_text(edit(text), "utf-8")
    before = path.read_bytes()
    for command in (["status"], ["sign", "10", "--evidence", "later.csv"], ["page"]):
        assert guide(*command) == 3
        error = capsys.readouterr().err
        assert said in error
        assert "what to do" in error
    assert path.read_bytes() == before
    assert not (wing / "wing.guide.html").exists()


@pytest.mark.parametrize("bomb", [
    lambda: b"a = " + b"[" * 100_000, lambda: b"a." * 100_000 + b"a = 1", lambda: b"x = " + b"9" * 1_000_000,
    lambda: b"#" * 6_000_000, lambda: b"\xff\xfe" + b"\0" * 100, lambda: b"x = {" + b"a = {" * 10_000,
])  # fmt: skip
def test_a_bomb_is_refused(begun: Path, bomb: Callable[[], bytes]) -> None:
    (begun / "wing.guide.toml").write_bytes(bomb() + b"\n# end of the guide\n")
    with pytest.raises(InputError):
        ledger.read(begun / "wing.guide.toml")


def test_words_about_the_job_may_be_edited_and_nothing_else_of_the_head(wing: Path) -> None:
    path = wing / "wing.guide.toml"
    text = path.read_text("utf-8").replace("\n[about]", '\n[about]\nclient = "an authority"', 1)
    path.write_text(text, "utf-8")
    assert ledger.read(path).about["client"] == "an authority"


def test_what_is_written_is_read_back_to_the_last_digit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    values = (rng.standard_normal(40) * 10.0 ** rng.integers(-300, 300, 40)).tolist()
    odd = {'a "b"\n\\c': "\t\u00e9\u6f22 \x7f", "empty": "", "list": [1, 2.5, "x"], "none": []}
    figures = {"numbers": values, "table": {"r\u00f6w 1": {"x": 1.0, "y": float("inf")}, "row.2": {}}, **odd}
    one = ledger.Signature(4, "said", False, "me", "2026-11-24", "0.1", figures=figures)
    written = ledger.Ledger("a.toml", "now", {}, ()).with_signature(one).with_signature(one)
    ledger.write(tmp_path / "a.guide.toml", written)
    back = ledger.read(tmp_path / "a.guide.toml")
    assert back == written
    assert back.signatures[0].figures["numbers"] == values


# -- two at once, and places that cannot be written --------------------------------------------------------------------
SIGN = "import sys; from loadid import cli; sys.exit(cli.main(['guide', 'sign', *sys.argv[1:]]))"


def test_two_processes_that_sign_at_once_lose_nothing(begun: Path) -> None:
    """Each is signed, or refused by name; the file is whole whichever way they fall."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"}
    words = (["1", "--evidence", "report.pdf"], ["2", "--evidence", "hang.csv"])
    running = [subprocess.Popen([sys.executable, "-c", SIGN, *one], cwd=begun, env=environment, text=True,
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE) for one in words]  # fmt: skip
    ended = [(process.communicate(timeout=120), process.returncode) for process in running]
    good = [k for k, (_, code) in enumerate(ended, 1) if code == 0]
    assert good
    assert set(Guide.open(begun / "wing.toml").ledger.latest()) == set(good)
    for (_, error), code in ended:
        assert code in (0, 3)
        assert code == 0 or "another run goes on" in error
    assert sorted(p.name for p in begun.glob(".*")) == []


def test_who_comes_second_is_refused_and_one_that_signed_meanwhile_is_kept(begun: Path, capsys: Any) -> None:
    old = Guide.open("wing.toml")
    assert guide("sign", 1, "--evidence", "report.pdf") == 0
    changed, _ = old.sign(2, ["hang.csv"], by="me")  # of a guide that was opened before
    assert set(changed.ledger.latest()) == {1, 2}
    from loadid._stream.output import StateLock

    with StateLock(begun / "wing.guide.toml"):
        assert guide("sign", 3) == 3
    assert "another run goes on" in capsys.readouterr().err


def test_a_file_that_changes_while_a_step_is_computed_is_not_signed(begun: Path, monkeypatch: Any) -> None:
    from loadid._guide import figures

    plain = figures.compute

    def slow(*given: Any) -> Any:
        found = plain(*given)
        thread = threading.Thread(target=touched, args=(begun / "hang.csv",))
        thread.start()
        thread.join()
        return found

    monkeypatch.setattr(figures, "compute", slow)
    with pytest.raises(InputError, match="changed while the step was computed"):
        Guide.open("wing.toml").sign(2, ["hang.csv"], by="me")
    assert Guide.open("wing.toml").ledger.signatures == ()


def test_a_folder_that_cannot_be_written_keeps_the_old_state(wing: Path, monkeypatch: Any, capsys: Any) -> None:
    before = {p.name: p.read_bytes() for p in wing.iterdir()}

    def refused(*given: Any) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(os, "replace", refused)  # permission bits do not stop every user
    assert guide("sign", 10, "--evidence", "later.csv") == 3
    error = capsys.readouterr().err
    assert "Read-only file system" in error
    assert "what to do" in error
    assert guide("page") == 3
    monkeypatch.undo()
    assert {p.name: p.read_bytes() for p in wing.iterdir()} == before
    assert guide("new", "/proc/job.toml", "--log", "service.csv", "--model", "wing.h5") == 3


def test_json_of_a_refusal_names_file_and_way_out(wing: Path, capsys: Any) -> None:
    (wing / "wing.guide.toml").write_text("")
    assert guide("status", "--json") == 3
    error = json.loads(capsys.readouterr().err)["error"]
    assert error["where"].endswith("wing.guide.toml")
    assert error["hint"]
