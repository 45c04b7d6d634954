"""The wing, signed to the end once; every test gets a copy, which is its current folder."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from . import jobs


@pytest.fixture(scope="package")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wing")
    jobs.static_job(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert jobs.guide("new", "wing.toml", "--structure", "wing of <b>6 m</b>") == 0
        jobs.signed(folder, evidence=jobs.WING)
    return folder


@pytest.fixture
def wing(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """All ten steps signed."""
    folder = tmp_path / "job"
    shutil.copytree(finished, folder)
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def begun(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Nothing signed yet."""
    folder = tmp_path / "job"
    shutil.copytree(finished, folder, ignore=shutil.ignore_patterns("*.guide.toml", "*.frozen.toml", "*.inverse.h5"))
    monkeypatch.chdir(folder)
    assert jobs.guide("new", "wing.toml") == 0
    return folder
