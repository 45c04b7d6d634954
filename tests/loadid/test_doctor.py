"""What the doctor finds, and that it names who else holds a package name."""

import json

import numpy as np
import pytest

from loadid import __version__
from loadid._commands import doctor
from structures._threads import threads
from tests.loadid.test_cli import installed, run

__all__ = ["installed", "run"]


def test_what_it_finds_is_what_is_there(run):
    code, out, err = run("doctor", "--json")
    data = json.loads(out)
    assert code == (1 if data["wrong"] else 0), err
    assert data["loadid"] == __version__
    assert data["dependencies"]["numpy"] == np.__version__
    assert data["threads"] == threads()
    assert all(one["ours"] for one in data["packages"].values())
    assert run("doctor")[1].splitlines()[0] == "loadid is in order"


@pytest.mark.parametrize("package", doctor.PACKAGES)
def test_a_foreign_owner_is_named(run, monkeypatch, package):
    listed = {package: ["loadid", "somebody-else"], "numpy": ["numpy"]}
    monkeypatch.setattr(doctor.metadata, "packages_distributions", lambda: listed)
    code, out, _ = run("doctor")
    assert code == 1
    assert f"{package} belongs to somebody-else too" in out.splitlines()[0]
    assert json.loads(run("doctor", "--json")[1])["wrong"] == [package]


def test_a_package_found_elsewhere_is_not_ours(monkeypatch, tmp_path):
    (tmp_path / "tactile").mkdir()
    (tmp_path / "tactile" / "__init__.py").write_text("")
    spec = doctor.importlib.util.spec_from_file_location("tactile", tmp_path / "tactile" / "__init__.py")
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: spec)
    assert doctor.owners({})["tactile"] == {"place": str(tmp_path / "tactile"), "ours": False, "others": []}


def test_an_extra_says_how_it_is_installed(run, monkeypatch):
    lines = [
        'nptdms>=1.9; extra == "io"',
        'opencv-python-headless>=4; extra == "vision"',
        'ruff; extra == "dev"',
        "numpy",
    ]
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: lines)
    known = {"nptdms": None, "opencv-python-headless": "4.10"}
    monkeypatch.setattr(doctor, "version", lambda name: known.get(name, "1.0"))
    assert doctor.extras() == {"io": {"nptdms": None}, "vision": {"opencv-python-headless": "4.10"}}
    out = run("doctor")[1]
    assert 'pip install "loadid[io]"' in out
    assert 'pip install "loadid[vision]"' not in out
