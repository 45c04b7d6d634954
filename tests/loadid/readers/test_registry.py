import importlib
import re
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest

import loadid
from loadid import _readers as readers
from loadid import read, read_all
from loadid._readers import formats, scan
from loadid._readers import source as registry
from loadid._readers.source import Table, register
from structures.errors import InputError
from tests.benchmarks.fuzz import outcomes

from .exports import WRITERS
from .files import A, F, csv, npy, small_files

# suffixes of the small files
SMALL = ["csv", "lvm", "npy", "npz", "h5", "uff", "ufb", "mat", *WRITERS]


def test_every_format_has_a_small_file(tmp_path):
    there = {s for s in SMALL if s not in WRITERS or find_spec(WRITERS[s][0])}
    assert set(small_files(tmp_path)) == there
    without = [f.name for f in formats() if not any(f".{suffix}" in f.suffixes for suffix in SMALL)]
    assert not without, f"write one in tests/loadid/readers/files.py, and name its suffix here: {without}"


def test_the_recipe_imports_what_is_there():
    lines = re.findall(r"^ +from (\S+) import (.+)$", readers.__doc__, re.MULTILINE)
    assert lines
    for module, names in lines:
        found = importlib.import_module(module, "loadid._readers")
        assert all(hasattr(found, name) for name in names.split(", ")), module


def test_public_names():
    assert loadid.read is read
    assert loadid.read_all is read_all


def test_all_formats_give_the_same_record(tmp_path):
    for suffix, path in small_files(tmp_path).items():
        records = read_all(path, fs=1000, units={0: "N", 1: "g"})
        values = np.vstack([r.values for r in records])
        np.testing.assert_allclose(values, np.column_stack((F, A * 9.80665)), err_msg=suffix)
        assert {r.dt for r in records} == {0.001}
        assert {r.source for r in records} == {str(path)}


def test_missing_file_names_the_nearest(tmp_path):
    (tmp_path / "hammer.csv").write_text(csv())
    with pytest.raises(InputError, match=r"did you mean hammer\.csv"):
        read(tmp_path / "hamer.csv")
    (tmp_path / "empty").mkdir()
    for bad in (tmp_path / "empty", tmp_path / "a\0b.csv", None, 3):
        with pytest.raises(InputError):
            read(bad)


def test_unknown_suffix_lists_the_known_ones(tmp_path):
    path = tmp_path / "log.xyz"
    path.write_bytes(npy(F))
    with pytest.raises(InputError, match=r"unknown suffix.*\.csv.*\.lvm.*looks like NPY"):
        read(path)
    path.with_suffix("").write_text(csv())
    with pytest.raises(InputError, match="no suffix"):
        read(path.with_suffix(""))


@pytest.mark.parametrize("suffix", [s for f in formats() for s in f.suffixes])
@pytest.mark.parametrize(
    "content", [b"", b"\0", b"\xff" * 5000, bytes(range(256)) * 20, b"hello", b"1\n", b"PK\x03\x04", b"\x93NUMPY"]
)
def test_junk_of_every_suffix(tmp_path, suffix, content):
    path = tmp_path / f"junk{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError, match="junk"):
        read(path)


def test_content_beats_the_suffix(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(npy(F))
    assert len(read(path, fs=1, units={0: "N"})) == 16
    path = tmp_path / "log.npy"
    path.write_text(csv())
    with pytest.raises(InputError, match="the content is not NPY"):
        read(path)


@pytest.mark.parametrize("fs", [0, -1, np.nan, np.inf, "fast", True])
def test_fs_must_be_positive(tmp_path, fs):
    for path in small_files(tmp_path).values():
        with pytest.raises(InputError, match="sampling frequency is not positive"):
            read_all(path, fs=fs, units={0: "N", 1: "g"})


def test_a_new_format_is_one_function(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "_FORMATS", dict(registry._FORMATS))

    @register("pairs", suffixes=(".pairs",), sniff=lambda head: head.startswith(b"PAIRS"))
    def load(source, options):
        return [Table(np.ones((3, 2)), columns=("F", "a"), units=("N", "g"), dt=0.1)]

    path = tmp_path / "x.pairs"
    path.write_bytes(b"PAIRS")
    assert read(path).units == ("N", "g")
    with pytest.raises(InputError, match="registered"):
        register("pairs", suffixes=(".p",), sniff=lambda head: True)(load)

    @register("broken", suffixes=(".broken",), sniff=lambda head: True)
    def broken(source, options):
        raise RecursionError("deep")

    path = tmp_path / "x.broken"
    path.write_bytes(b"?")
    with pytest.raises(InputError, match=r"cannot be read as broken.*RecursionError: deep"):
        read(path)


def test_scan_needs_nothing(tmp_path):
    path = tmp_path / "x.npy"
    path.write_bytes(npy(np.column_stack((F, A))))
    (table,) = scan(path)
    assert table.values.shape == (16, 2)
    assert table.columns is None


def test_reading_text_imports_nothing_heavy(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(csv())
    code = f"""
import sys
from loadid import read
read({str(path)!r}).health()
print([m for m in ("scipy", "h5py", "matplotlib") if m in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("suffix", SMALL)
def test_damaged_files(tmp_path, suffix):
    """300 mutants, 100 of other tools: nothing but an InputError, nothing hangs, no declared length is cut silently."""
    path = small_files(tmp_path)[suffix]
    count = 100 if suffix in WRITERS else 300
    seen = list(outcomes(path, count, tmp_path))
    library = next(f.library for f in formats() if f".{suffix}" in f.suffixes)  # imported anew after a hang
    assert max(seconds for _, _, seconds in seen) < (8 if library else 5)
    cut = [outcome for kind, outcome, _ in seen if kind == "truncated"]
    assert len(cut) > 0.26 * count
    if suffix in ("npy", "npz", "h5", "parquet", "arrow", "xlsx", "mf4", "bag", "db3"):
        assert set(cut) == {"refused"}
    if suffix in ("tdms", "wav", "mcap", "mseed"):  # what is there is read, and flagged
        assert cut.count("shorter") <= 2
        assert "other values" not in cut
        assert "flagged" in cut or suffix in ("mcap", "mseed")
    if suffix in ("lvm", "uff", "ufb", "mat"):  # a cut between two records leaves a whole file with fewer of them
        assert cut.count("shorter") <= 2
        assert "other values" not in cut
    said = ("refused", "flagged") if suffix == "wav" else ("refused",)
    assert sum(outcome in said for _, outcome, _ in seen) > 0.2 * count
