"""Every block of docs/commands.md runs, one after the other, in an empty folder; every command has an example."""

import re
import shlex
from pathlib import Path

import pytest

from loadid import cli
from tests.loadid.test_cli import installed, run

__all__ = ["installed", "run"]
PAGE = (Path(__file__).resolve().parents[2] / "docs" / "commands.md").read_text("utf-8")
BLOCKS = re.findall(r"```sh\n(.*?)```", PAGE, re.S)
OURS = ("model", "calibrate", "design", "convert", "doctor", "completion", "track", "serve")


def test_the_blocks_run(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = [line for block in BLOCKS for line in block.replace("\\\n", " ").splitlines() if line.strip()]
    assert len(lines) >= 7
    for line in lines:
        command, _, target = line.partition(" > ")
        words = shlex.split(command)
        assert words[0] == "loadid"
        code, out, err = run(*words[1:])
        assert code == 0, f"{line}: {err}"
        assert out.strip()
        if target:
            (tmp_path / target).write_text(out)
    assert {"model.h5", "wing.h5", "layout.png", "model.npz"} <= {p.name for p in tmp_path.iterdir()}


@pytest.mark.parametrize("name", OURS)
def test_help_ends_with_an_example(run, name):
    code, out, _ = run(name, "--help")
    assert code == 0
    assert "examples:" in out
    assert f"loadid {name}" in out.partition("examples:")[2]


def test_every_option_that_the_page_names_is_one(run):
    known = {o for parser in cli.parsers().values() for a in parser.arguments for o in a.option_strings}
    assert set(re.findall(r"(?<![\w-])--[a-z][a-zEI-]*", PAGE)) - known <= {"--family", "--signal"}
