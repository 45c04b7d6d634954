"""The settled filter in C: compiled, loaded, and the same numbers as in Python; what it does with a missing value."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from loadid._inverse.gaussian.exports import c_source, write_c
from loadid._inverse.gaussian.loop import Loop
from loadid._inverse.gaussian.steady import SteadyFilter, steady
from structures import InputError
from tests.tracked import Tracked, ar1, bm2, bm3, filter_model, matern32

CC = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)
STRICT = ("-std=c99", "-O2", "-Wall", "-Wno-unused-parameter", "-Werror", "-pedantic")
needs_compiler = pytest.mark.skipif(CC is None, reason="no C compiler (cc, gcc or clang) on this machine")

Case = tuple[Tracked, SteadyFilter]


def building() -> Case:
    case = bm2("matern", samples=400)
    return case, steady(filter_model(case, matern32(100.0, 0.08, 0.01)), case.dt)


def beam() -> Case:
    """Noises that are correlated: the prediction takes the sample too."""
    case = bm3(samples=400)
    return case, steady(filter_model(case, ar1(10.0, float(np.exp(-2 * np.pi * 0.05 * 0.01)))), case.dt)


class Compiled:
    """The C file as a shared library."""

    def __init__(self, folder: Path, settled: SteadyFilter, name: str = "tracker") -> None:
        source = write_c(folder / f"{name}.c", settled, name=name)
        library = folder / f"{name}.so"
        made = subprocess.run(
            [str(CC), *STRICT, "-shared", "-fPIC", "-o", str(library), str(source)], capture_output=True, text=True
        )
        assert made.returncode == 0, made.stderr
        self.library, self.name = ctypes.CDLL(str(library)), name
        self.m, self.p = settled.model.m, settled.model.p

    def step(self, y: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
        load, e = np.empty(self.p), np.empty(self.m)
        y = np.ascontiguousarray(y, float)
        pointers = [x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for x in (y, load, e)]
        missing = self.library[f"{self.name}_step"](*pointers)
        return missing, load, e

    def reset(self) -> None:
        self.library[f"{self.name}_reset"]()

    @property
    def std(self) -> np.ndarray:
        return np.array((ctypes.c_double * self.p).in_dll(self.library, f"{self.name}_std"))


@needs_compiler
@pytest.mark.parametrize("make", [building, beam])
def test_c_and_python_agree(make, tmp_path: Path) -> None:
    case, settled = make()
    c = Compiled(tmp_path, settled)
    loop = Loop(settled.rows(), settled.model.p, settled.model.m, settled.model.x0)
    size = np.abs(case.load).max()
    for _ in range(2):  # the second time after a reset
        loop.x = settled.model.x0
        for y in case.y:
            missing, load, e = c.step(y)
            np.testing.assert_allclose(load, loop.step(y), rtol=0, atol=1e-12 * size)
            np.testing.assert_allclose(e, loop.e, rtol=1e-9, atol=1e-12 * np.abs(case.y).max())
            assert missing == 0
        c.reset()
    np.testing.assert_array_equal(c.std, settled.std)


@needs_compiler
def test_a_sample_that_is_not_finite_is_left_out(tmp_path: Path) -> None:
    """The state runs on by F, as it does where all channels are missing; NaN never enters it."""
    case, settled = building()
    model, c = settled.model, Compiled(tmp_path, settled, name="roof_2")
    x = model.x0  # prediction
    for k, y in enumerate(case.y[:100]):
        bad = k in (30, 31, 70)
        given = np.where(np.arange(4) == k % 4, np.inf if k == 70 else np.nan, y) if bad else y
        missing, load, e = c.step(given)
        x = x if bad else x + settled.K @ (y - model.H @ x)
        np.testing.assert_allclose(load, model.Cp @ x, rtol=0, atol=1e-9)
        assert missing == bad
        assert not bad or not e.any()
        x = model.F @ x


@needs_compiler
def test_the_object_needs_no_library(tmp_path: Path) -> None:
    """What the object asks of others: nothing but the memory functions that compilers put in by themselves."""
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("no nm to list symbols with")
    source = write_c(tmp_path / "t.c", building()[1])
    subprocess.run([str(CC), "-std=c99", "-O1", "-c", "-o", str(tmp_path / "t.o"), str(source)], check=True)
    listed = subprocess.run([nm, "-u", str(tmp_path / "t.o")], check=True, capture_output=True, text=True).stdout
    asked = {line.split()[-1].lstrip("_") for line in listed.splitlines() if line.strip()}
    assert asked <= {"memset", "memcpy", "memmove", "stack_chk_fail", "GLOBAL_OFFSET_TABLE_"}


def test_the_file_says_what_goes_in_and_out() -> None:
    settled = building()[1]
    source = c_source(settled, dt=0.01, sensors=["a3", "a6", "a10", "d10 */ µ"], loads=["roof"])
    head = source[: source.index("*/")]
    assert all(text in head for text in ("one sample every 0.01 s", "y[0]: a3", "y[3]: d10 * / ?", "load[0]: roof"))
    assert source.isascii()


@pytest.mark.parametrize("name", ["2nd", "a b", "", "f();", "ä"])
def test_a_name_that_c_does_not_take_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="identifier"):
        c_source(building()[1], name=name)


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        write_c(tmp_path / "nowhere" / "t.c", building()[1])
