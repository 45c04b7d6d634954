"""What an import costs: the two packages and the command line load nothing heavy before it is used."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys

import pytest

from .sources import PACKAGES, ROOT, imported, modules, parsed, walked

HEAVY = ("scipy", "matplotlib", "casadi", "filterpy", "h5py", "skfem", "clarabel", "numba")
QUIET = (
    "import contextlib, io\n"
    "with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):\n    "
)
LIGHT = {
    "import loadid": "import loadid",
    "import structures": "import structures",
    "import tactile": "import tactile",
    "loadid --version": f"from loadid.cli import main\n{QUIET}assert main(['--version']) == 0",
    "loadid --help": f"from loadid.cli import main\n{QUIET}assert main(['--help']) == 0",
    "loadid identify --help": f"from loadid.cli import main\n{QUIET}assert main(['identify', '--help']) == 0",
}


def heavy_after(code: str) -> list[str]:
    """Heavy packages in sys.modules of a fresh interpreter that ran some code."""
    probe = f"{code}\nimport json, sys\nprint(json.dumps([m for m in {HEAVY!r} if m in sys.modules]))"
    run = _python("-c", probe)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def _python(*arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=120,
    )


@pytest.mark.parametrize("what", LIGHT)
def test_nothing_heavy_is_loaded(what: str) -> None:
    assert heavy_after(LIGHT[what]) == []


@pytest.mark.parametrize("name", ["scipy", "h5py"])
def test_a_heavy_import_would_be_seen(name: str) -> None:
    assert heavy_after(f"import loadid\nimport {name}") == [name]


def test_the_version_is_printed_and_is_that_of_the_project() -> None:
    import tomllib

    import loadid

    run = _python("-m", "loadid.cli", "--version")
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    assert (run.returncode, run.stdout.split(), run.stderr) == (0, ["loadid", stated], "")
    assert loadid.__version__ == stated


@pytest.mark.parametrize("package", ["loadid", "structures"])
def test_every_public_name_resolves(package: str) -> None:
    module = importlib.import_module(package)
    missing = [name for name in module.__all__ if not hasattr(module, name)]
    assert missing == []
    assert len(set(module.__all__)) == len(module.__all__)
    assert set(module.__all__) <= set(dir(module))


@pytest.mark.parametrize("package", ["loadid", "structures"])
def test_a_name_that_is_not_there_raises_by_name(package: str) -> None:
    module = importlib.import_module(package)
    with pytest.raises(AttributeError, match=r"module '\w+' has no attribute 'no_such_name'"):
        _ = module.no_such_name


def test_the_default_install_has_what_the_packages_import() -> None:
    """A test extra, such as scikit-fem, is imported by no module; what optional extras bring, inside functions."""
    import tomllib

    declared = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"]
    allowed = (
        {line.split(">")[0] for line in declared}
        | {"cv2", "PIL", "distributed", "pyarrow", "fatpack", "paho", "zmq", "mcap"}
        | {"nptdms", "asammdf", "openpyxl", "rosbags", "pymseed", "meshio"}
        | {"torch"}
        | {*PACKAGES}
        | sys.stdlib_module_names
    )
    outside = {
        (name, base.split(".")[0])
        for name, path in modules(*PACKAGES)
        for node in walked(parsed(path))
        for base, *_ in imported(node, name)
        if base.split(".")[0] not in allowed
    }
    assert outside == set()
