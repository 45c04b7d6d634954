"""`loadid lab` on the command line, and the pages that it finds."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import webbrowser
from importlib.metadata import EntryPoint

import pytest

from loadid._lab import pages as found
from loadid._lab.server import Lab
from tests.loadid.test_cli import installed, run

__all__ = ["installed", "run"]
ADDRESS = r"http://127\.0\.0\.1:\d+/\?token=[\w-]{32}"


def test_it_prints_one_line_and_ends_by_an_interrupt() -> None:
    # a shell that starts the tests in the background mutes the interrupt
    heard = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{heard}; from loadid.cli import main; sys.exit(main(['lab', '--no-browser']))"
    pipe, words = subprocess.PIPE, [sys.executable, "-c", code]
    with subprocess.Popen(words, stdout=pipe, stderr=pipe, text=True) as running:
        assert running.stdout is not None
        line = running.stdout.readline()
        assert re.fullmatch(rf"the lab is at {ADDRESS} \(Ctrl-C ends it\)\n", line), line
        running.send_signal(signal.SIGINT)
        try:
            out, err = running.communicate(timeout=20)
        finally:
            running.kill()
    assert (running.returncode, out, err) == (0, "", "the lab has ended\n")


@pytest.fixture
def ended(monkeypatch):
    """The lab is interrupted at once; the addresses that a browser was asked to open."""
    opened: list[str] = []

    def interrupted(self: Lab) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Lab, "run", interrupted)
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    return opened


def test_it_opens_the_browser_where_there_is_a_screen(run, ended, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    code, out, err = run("lab")
    assert (code, err) == (0, "the lab has ended\n")
    assert out == f"the lab is at {ended[0]} (Ctrl-C ends it)\n"
    assert re.fullmatch(ADDRESS, ended[0])


def test_without_a_screen_or_a_browser_it_says_so(run, ended, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    code, _, err = run("lab")
    assert (code, ended) == (0, [])
    assert err.startswith("no browser was found: open the address yourself")

    def broken(address: str) -> bool:
        raise webbrowser.Error

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(webbrowser, "open", broken)
    assert "no browser was found" in run("lab")[2]


def test_the_address_as_json(run, ended):
    code, out, _ = run("lab", "--no-browser", "--json")
    assert code == 0
    assert re.fullmatch(ADDRESS, json.loads(out)["address"])
    assert ended == []


def test_ports(run, ended):
    with Lab([]) as other:
        port = str(other.http.server_address[1])
        code, out, err = run("lab", "--no-browser", "--port", port)
    assert (code, out) == (3, "")
    assert f"--port {port}" in err
    assert "any that is free" in err
    for wrong in ("x", "-1", "65536", "8e3"):
        assert run("lab", "--port", wrong)[0] == 2


def test_its_help_ends_with_examples(run):
    code, out, _ = run("lab", "--help")
    assert code == 0
    assert "loadid lab --no-browser --port 8123" in out


def test_pages_of_other_packages_are_found_and_a_broken_one_is_left_out(monkeypatch, caplog):
    points = [EntryPoint("other", "tests.lab_pages.test_server:ECHO", found.GROUP),
              EntryPoint("broken", "tests.lab_pages.nothing:page", found.GROUP)]  # fmt: skip
    monkeypatch.setattr(found, "entry_points", lambda group: points if group == found.GROUP else [])
    names = [page.name for page in found.pages()]
    assert names == ["contact", "lcurve", "own", "cards", "echo"]
    assert "'broken'" in caplog.text
