"""A tracker in C: compiled with every warning an error, loaded, and run over a record."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

CC = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror")
needs_compiler = pytest.mark.skipif(CC is None, reason="no C compiler (cc, gcc or clang) on this machine")
ROOM = 1 << 22  # bytes for the state of a tracker: the C compiler knows how many it takes

Array = NDArray[np.float64]


def build(source: Path, *flags: str, out: Path) -> Path:
    """Compile a C file; what the compiler says beside is an error."""
    made = subprocess.run(
        [str(CC), *STRICT, *flags, "-o", str(out), str(source), "-lm"], capture_output=True, text=True
    )
    assert made.returncode == 0, made.stderr
    return out


class Controller:
    """One tracker in C; several of them share a library.

    Parameters
    ----------
    source : Path
        What `Tracker.to_c` wrote.
    name : str
        Prefix of its names.
    sensors, loads : int
    dtype : {"double", "float"}
    """

    def __init__(self, source: Path, name: str, sensors: int, loads: int, dtype: str = "double") -> None:
        library = source.with_name(f"{source.stem}_{dtype}.so")
        if not library.exists():
            build(source, "-O2", "-shared", "-fPIC", f"-D{name.upper()}_{dtype.upper()}", out=library)
        self._all = ctypes.CDLL(str(library))
        self._step = self._all[f"{name}_step"]
        self._step.argtypes, self._step.restype = [ctypes.c_void_p] * 4, ctypes.c_uint
        self._starts = self._all[f"{name}_reset"], self._all[f"{name}_reset_moving"]
        self._state = ctypes.create_string_buffer(ROOM)
        self.m, self.p, self.type = sensors, loads, np.float64 if dtype == "double" else np.float32
        self.reset()

    def reset(self, moving: bool = False) -> None:
        """Before the first sample, at rest or in motion."""
        self._starts[moving](ctypes.c_void_p(ctypes.addressof(self._state)))

    def run(self, Y: Array) -> tuple[Array, Array, NDArray[np.int_]]:
        """Loads and std (samples, loads), and what each sample answered (samples,)."""
        rows = np.ascontiguousarray(Y, self.type)
        load, std = np.empty((len(rows), self.p), self.type), np.empty((len(rows), self.p), self.type)
        said, state, size = np.empty(len(rows), int), ctypes.addressof(self._state), rows.itemsize
        y, at, band = rows.ctypes.data, load.ctypes.data, std.ctypes.data
        for k in range(len(rows)):
            said[k] = self._step(state, y + k * self.m * size, at + k * self.p * size, band + k * self.p * size)
        return load.astype(float), std.astype(float), said
