"""A loop before its compiler is loaded: the same bits, no load where few samples come, one where many do."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from loadid._inverse.gaussian import loop as loops
from loadid._inverse.gaussian.compiled import Compiled
from loadid._inverse.gaussian.loop import Loop

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def cold(monkeypatch):
    """As in a process that has compiled nothing."""
    for loop in (loops._step, loops._block):
        monkeypatch.setattr(loop, "_fast", None)


def recursion(n, m, p, limit=None):
    """A stable filter of random numbers, and samples."""
    rng = np.random.default_rng(n)
    M = rng.standard_normal((p + m + n, n + m))
    M[p + m :, :n] /= 1.02 * np.abs(np.linalg.eigvals(M[p + m :, :n])).max()
    return Loop(M, p, m, rng.standard_normal(n), limit), rng.standard_normal((500, m))


def ran(loop, Y):
    load, e = np.zeros((len(Y), loop.p)), np.zeros((len(Y), loop.m))
    taken = loop.block(Y, load, e)
    return taken, load.tobytes(), e.tobytes(), loop.x.tobytes()


@pytest.mark.parametrize(("n", "m", "p"), [(40, 8, 1), (21, 4, 2), (6, 1, 1), (1, 1, 1), (61, 10, 3)])
def test_the_same_bits_without_the_compiler(cold, n, m, p):
    limit = np.full(m, 1e9)
    loop, Y = recursion(n, m, p, limit)
    Y[400, 0] = np.nan
    found = ran(loop, Y)
    assert loop._fast is None
    fast, _ = recursion(n, m, p, limit)
    fast.compile()
    assert ran(fast, Y) == found
    assert found[0] == 400
    loop.compile()  # and on from there
    assert ran(loop, Y[401:]) == ran(fast, Y[401:])
    assert np.array_equal(loop.step(Y[0]), fast.step(Y[0]))


def test_samples_one_by_one_and_many_at_once_are_compiled(cold, monkeypatch):
    loop, Y = recursion(6, 2, 1)
    loop.step(Y[0])
    assert loop._fast is not None
    monkeypatch.setattr(loops._block, "_fast", None)
    loop = recursion(6, 2, 1)[0]
    monkeypatch.setattr(loops, "COLD", 1000)
    for k in range(0, len(Y), 10):  # a live stream
        ran(loop, Y[k : k + 10])
    assert loop._fast is None
    ran(loop, Y)
    assert loop._fast is not None


@Compiled
def _double(x: float) -> float:
    return 2 * x


@Compiled
def _more(x: float) -> float:
    return _double(x) + 1.0


def test_a_loop_that_calls_another_is_compiled_with_it():
    assert not _more.built
    assert _more(3.0) == 7.0
    assert _double.built


def test_loops_are_compiled_where_no_folder_can_keep_them(tmp_path):
    """A file stands in the way of every folder that numba would make."""
    (tmp_path / "__pycache__").write_text("")
    (tmp_path / "own.py").write_text(
        "import logging\nfrom loadid._inverse.gaussian.compiled import Compiled\nlogging.basicConfig()\n"
        "@Compiled\ndef double(x):\n    return 2 * x\n"
        "@Compiled\ndef more(x):\n    return double(x) + 1.0\n"
        "print(more(3.0), type(more.build()).__module__)\n"
    )
    nowhere = str(tmp_path / "own.py" / "in it")
    env = os.environ | {"HOME": nowhere, "XDG_CACHE_HOME": nowhere, "NUMBA_CACHE_DIR": nowhere, "PYTHONPATH": str(ROOT)}
    ran = subprocess.run([sys.executable, "-B", "-c", "import own"], cwd=tmp_path, env=env, capture_output=True,
                         text=True, timeout=120)  # fmt: skip
    assert ran.stdout.split() == ["7.0", "numba.core.registry"], ran.stderr
    assert ran.stderr.count("set NUMBA_CACHE_DIR") == 1


def test_nothing_is_compiled_where_a_module_is_only_imported():
    code = (
        "import sys; import loadid._stream, loadid._families.kalman, loadid._inverse.gaussian.passes; "
        "print('numba' in sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=dict(os.environ), capture_output=True, text=True,
                         check=True, timeout=60)  # fmt: skip
    assert ran.stdout.strip() == "False"
