"""What a shell completes, asked of a shell; and what the command line says of a word that is near one that it knows."""

import json
import logging
import shutil
import subprocess

import pytest

from loadid import _commands as commands
from loadid import cli
from loadid._commands import Bar, completion
from structures._advice import nearest
from tests.loadid.test_cli import Screen, installed, run

__all__ = ["installed", "run"]
ASK = 'source {script}; COMP_WORDS=({words}); COMP_CWORD=$((${{#COMP_WORDS[@]}}-1)); _loadid; echo "${{COMPREPLY[@]}}"'


@pytest.fixture(scope="module")
def known():
    return completion.words()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("loadid ide", {"identify"}),
        ("loadid --log-level inf", {"info"}),
        ("loadid --log-level info ide", {"identify"}),
        ("loadid identify log.csv --cho", {"--choice"}),
        ("loadid identify --choice l_", {"l_curve"}),
        ("loadid identify --penalty second", {"second_difference"}),
        ("loadid calibrate --estimator H", {"H1", "H2", "Hv", "Hs"}),
        ("loadid completion z", {"zsh"}),
        ("loadid identify --model m", set()),  # a file, which the shell knows
        ("loadid info lo", set()),
    ],
)
def test_bash_completes(known, tmp_path, words, expected):
    script = tmp_path / "c.sh"
    script.write_text(completion.bash(known))
    told = ASK.format(script=script, words=" ".join(f"'{w}'" for w in words.split()))
    done = subprocess.run(["bash", "-c", told], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == expected
    assert done.stderr == ""


def test_every_command_and_every_option_is_completed(known):
    for shell, write in completion.WRITERS.items():
        script = write(known)
        assert set(cli.commands()) <= set(known)
        for name, some in known.items():
            assert name in script, shell
            for option in (o for one in some.options for o in one.names):
                spelled = f"-l {option[2:]}" if option.startswith("--") else f"-s {option[1:]}"
                assert (spelled if shell == "fish" else option) in script


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_read_their_script(known, tmp_path, shell):
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    (tmp_path / "c").write_text(completion.WRITERS[shell](known))
    subprocess.run([shell, "-n", tmp_path / "c"], check=True)


@pytest.mark.parametrize(
    ("argv", "meant"),
    [
        (["idntify", "a.csv"], "identify"),
        (["identify", "a.csv", "--chocie", "gcv"], "--choice"),
        (["info", "a.csv", "--untis=F=N"], "--unit"),
        (["identify", "a.csv", "--model", "m.h5", "-o", "r.h5", "--choice", "lcurve"], "l_curve"),
        (["identify", "a.csv", "--model", "m.h5", "-o", "r.h5", "--penalty", "seconddifference"], "second_difference"),
        (["identify", "a.csv", "--model", "m.h5", "-o", "r.h5", "--family", "frequenzy"], "frequency"),
        (["calibrate", "a.csv", "--force", "F", "--response", "a", "-o", "m.h5", "--estimator", "h1"], "H1"),
        (["--log-level", "warn", "info", "a.csv"], "warning"),
    ],
)
def test_a_word_that_is_near_another_is_told(run, argv, meant):
    code, _, err = run(*argv)
    assert code == cli.USAGE
    assert f"did you mean {meant}?" in err


def test_a_word_that_is_near_none_is_not_made_into_one(run):
    assert "did you mean" not in run("info", "a.csv", "--xyzzy")[2]
    assert nearest("q", ["gcv", "quasi"]) is None
    assert nearest("lcurve", ["l_curve", "gcv"]) == "l_curve"
    assert nearest("noise", ["units"]) is None


def test_quiet_prints_no_answer_and_no_progress(run, monkeypatch):
    def work(args):
        with Bar(screen, interval=0) as bar:
            bar(0.5, "working")
        commands.emit(args, {"load": 1.0}, "the load is 1 N")
        return 0

    screen = Screen()
    monkeypatch.setattr(cli, "commands", lambda: {"w": commands.Command("w", "w", lambda p: None, work)})
    for argv in (["w", "-q"], ["-q", "w"], ["w", "--quiet"]):
        assert run(*argv) == (0, "", "")
    assert screen.getvalue() == ""
    assert json.loads(run("w", "-q", "--json")[1]) == json.loads(run("--json", "w")[1]) == {"load": 1.0}
    assert "working" in screen.getvalue() or run("w")[1] == "the load is 1 N\n"
    assert "working" in screen.getvalue()


def test_the_log_as_json(run, monkeypatch):
    def talk(args):
        logging.getLogger("loadid.x").info('said "%s"', "so")
        return 0

    monkeypatch.setattr(cli, "commands", lambda: {"talk": commands.Command("talk", "talk", lambda p: None, talk)})
    for argv in (["--log-json", "--log-level", "info", "talk"], ["talk", "--log-level", "info", "--log-json"]):
        line = json.loads(run(*argv)[2].splitlines()[1])  # between begin and end of the command
        assert {**line, "time": 0} == {"time": 0, "level": "info", "logger": "loadid.x", "message": 'said "so"'}
