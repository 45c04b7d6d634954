"""Result files come back bit for bit, and a damaged or hostile one is never read."""

import errno
import hashlib
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from structures.errors import InputError
from structures.files import _child as child
from structures.files import _storage as storage
from structures.files import _tree

TREE = {
    "real": np.linspace(0, 1, 7),
    "complex": np.array([[1 + 2j, 3], [np.inf, 0]]),
    "flags": np.array([True, False]),
    "integers": np.arange(6, dtype="i2").reshape(2, 3),
    "empty": np.zeros((0, 3)),
    "scalar array": np.array(2.5),
    "text": "Stöße in µm",
    "none": None,
    "numbers": [1, 2, 3],
    "decimals": (0.1, 0.2),
    "names": ["a", "", "ü"],
    "mixed": [1, 2.5, None, "x", {"deep": [[], {}]}, np.eye(2)],
    "a/b": {"": 1, ".": True, "50%": 1j, "..": -0.0},
}


def same(a, b):
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return isinstance(b, dict) and list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return isinstance(b, list) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and repr(a) == repr(b)


@pytest.fixture
def path(tmp_path):
    storage.write(tmp_path / "x.h5", TREE, "estimate")
    return tmp_path / "x.h5"


def test_round_trip(path):
    assert same(TREE, storage.read(path, "estimate"))
    assert storage.kind_of(path) == "estimate"
    assert os.listdir(path.parent) == ["x.h5"]


numbers = st.integers(-(2**63), 2**63 - 1) | st.floats() | st.booleans() | st.complex_numbers()
text = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=8)
arrays = hnp.arrays(
    st.sampled_from(["f8", "f4", "c16", "i8", "u1", "?", ">f8"]), hnp.array_shapes(min_dims=0, min_side=0)
)
trees = st.dictionaries(
    text,
    st.recursive(
        numbers | text | st.none() | arrays,
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(text, inner, max_size=3),
        max_leaves=6,
    ),
    max_size=4,
)


@settings(max_examples=40, deadline=None)
@given(trees)
def test_any_tree_comes_back(tree):
    data = _tree.encode(tree, "")
    found = _tree.decode(b"\0" * storage.BLOCK + data, "")
    assert same(tree, found)
    plain, arrays = _tree.taken_apart(found)
    assert same(tree, _tree.put_together(json.loads(json.dumps(plain)), arrays))


def test_any_hdf5_tool_opens_it_and_it_is_deterministic(path):
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["real"], TREE["real"])
        assert file["real"].fletcher32
        assert file["text"].asstr()[()] == TREE["text"]
    storage.write(path.with_name("y.h5"), TREE, "estimate")
    assert path.read_bytes() == path.with_name("y.h5").read_bytes()


@pytest.mark.parametrize(
    ("value", "word"),
    [
        (object(), "type"),
        (np.array(["a"]), "type"),
        (np.array([object()]), "type"),
        ("a\0b", "NUL"),
        (2**63, "large"),
        ({1: 2}, "not text"),
        ("\ud800", "Unicode"),
        ({"\ud800": 1}, "Unicode"),
    ],
)
def test_what_cannot_be_stored_is_refused_by_name(tmp_path, value, word):
    with pytest.raises(InputError, match=word) as error:
        storage.write(tmp_path / "x.h5", {"outer": {"inner": value}}, "estimate")
    assert "outer" in str(error.value)
    assert not os.listdir(tmp_path)


def test_a_tree_that_contains_itself_is_refused(tmp_path):
    tree: dict = {}
    tree["self"] = tree
    with pytest.raises(InputError, match="deep"):
        storage.write(tmp_path / "x.h5", tree, "estimate")


# -- damage -----------------------------------------------------------------------------------------------------------
def test_every_flipped_bit_is_found(path):
    data = bytearray(path.read_bytes())
    rng = np.random.default_rng(0)
    places = np.concatenate([np.arange(8 * storage.BLOCK), rng.integers(8 * storage.BLOCK, 8 * len(data), 600)])
    for place in places:
        data[place // 8] ^= 1 << (place % 8)
        path.write_bytes(data)
        with pytest.raises(InputError):
            storage.read(path, "estimate")
        data[place // 8] ^= 1 << (place % 8)
    path.write_bytes(data)
    storage.read(path, "estimate")


@pytest.mark.parametrize("size", [0, 1, 20, 511, 512, 513, 4000, -1])
def test_truncation_is_found(path, size):
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(InputError):
        storage.read(path, "estimate")


def test_bytes_at_the_end_are_found(path):
    path.write_bytes(path.read_bytes() + b"\0")
    with pytest.raises(InputError, match="sha256"):
        storage.read(path, "estimate")


def test_other_files_are_told_apart(path, tmp_path):
    with pytest.raises(InputError, match=r"found: estimate; expected: measured model"):
        storage.read(path, "measured model")
    with pytest.raises(InputError, match="no such file"):
        storage.read(tmp_path / "none.h5", "estimate")
    (tmp_path / "log.csv").write_text("1,2\n")
    assert storage.kind_of(tmp_path / "log.csv") is None
    with pytest.raises(InputError, match="not a file of this package"):
        storage.read(tmp_path / "log.csv", "estimate")
    with pytest.raises(InputError, match="cannot be read"):
        storage.read(tmp_path, "estimate")
    path.write_bytes(path.read_bytes().replace(b"format 1", b"format 2"))
    with pytest.raises(InputError, match="newer release"):
        storage.read(path, "estimate")


def forged(path: Path, fill) -> Path:
    """A file with a right hash and a wrong inside."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=storage.BLOCK) as file:
        file.attrs["is"] = "dict"
        fill(file)
    body = buffer.getvalue()[storage.BLOCK :]
    path.write_bytes(storage._block("estimate", hashlib.sha256(b"estimate\n" + body).hexdigest()) + body)
    return path


def external(file):
    file["x"] = h5py.ExternalLink("other.h5", "/")


def soft(file):
    file["x"] = h5py.SoftLink("/")


def cycle(file):
    file["x"] = file["/"]


def raw(file):
    file.create_dataset("x", (4,), "u1", external=[("secret.txt", 0, 4)]).attrs["is"] = "array"


def huge(file):
    file.create_dataset("x", (2**34,), "f8", chunks=(1024,)).attrs["is"] = "array"


def bomb(file):
    file.create_dataset("x", data=np.zeros(10**5), compression="gzip").attrs["is"] = "array"


def virtual(file):
    layout = h5py.VirtualLayout((4,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", (4,))
    file.create_virtual_dataset("x", layout).attrs["is"] = "array"


def unmarked(file):
    file["x"] = 1.0


def named_type(file):
    file["x"] = np.dtype("f8")


def vlen(file):
    file.create_dataset("x", data=np.array([np.ones(1), np.ones(2)], object), dtype=h5py.vlen_dtype("f8")).attrs[
        "is"
    ] = "array"


@pytest.mark.parametrize("fill", [external, soft, cycle, raw, huge, bomb, virtual, unmarked, named_type, vlen])
def test_a_forged_inside_is_refused(tmp_path, monkeypatch, fill):
    monkeypatch.chdir(tmp_path)
    Path("secret.txt").write_text("word")
    with pytest.raises(InputError):
        storage.read(forged(tmp_path / "x.h5", fill), "estimate")


def signed(path: Path, body: bytes) -> Path:
    path.write_bytes(storage._block("estimate", storage._digest("estimate", body)) + body)
    return path


def test_a_forged_file_that_hangs_the_library_leaves_the_caller(tmp_path, monkeypatch):
    storage.write(tmp_path / "x.h5", {"names": ["a", "b"]}, "estimate")
    body = bytearray((tmp_path / "x.h5").read_bytes()[storage.BLOCK :])
    at = body.index(b"GCOL") + 16
    while int.from_bytes(body[at : at + 2], "little"):
        at += 16 + (int.from_bytes(body[at + 8 : at + 16], "little") + 7) // 8 * 8
    body[at + 8 : at + 16] = bytes(8)  # a free block of no size: the library walks on the spot
    monkeypatch.setattr(child, "PATIENCE", 1.0)
    with pytest.raises(InputError, match=r"x\.h5: the HDF5 library hangs.*no answer in 1 s"):
        storage.read(signed(tmp_path / "x.h5", bytes(body)), "estimate")
    monkeypatch.undo()
    storage.write(tmp_path / "x.h5", TREE, "estimate")
    assert same(TREE, storage.read(tmp_path / "x.h5", "estimate"))


def sleeps(request):
    time.sleep(60)


def computes_now_and_then(request):
    until = time.monotonic() + 2.5
    while time.monotonic() < until:  # as on a machine that gives it a tenth of its time
        used = time.process_time() + 0.02
        while time.process_time() < used:
            pass
        time.sleep(0.2)
    return "read", []


def asked(task):
    return child.apart(f"{__name__}:{task.__name__}", {}, reader="HDF5", where="x.h5", size=0)


def test_a_child_that_waits_for_nothing_is_ended(monkeypatch):
    monkeypatch.setattr(child, "PATIENCE", 0.5)
    monkeypatch.setattr(child, "LOADED", 1.0)
    with pytest.raises(InputError, match=r"the HDF5 library hangs"):
        asked(sleeps)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the system does not tell what a process has used")
def test_a_child_that_other_work_slows_down_is_waited_for(monkeypatch):
    monkeypatch.setattr(child, "PATIENCE", 1.0)
    monkeypatch.setattr(child, "LOADED", 1.0)
    assert asked(computes_now_and_then) == ("read", [])


def test_where_no_child_starts_the_caller_reads_itself(path, monkeypatch):
    child.stop()
    monkeypatch.setattr(sys, "executable", "")
    assert same(TREE, storage.read(path, "estimate"))


def test_an_interrupt_does_not_leave_an_answer_for_the_next_file(path, monkeypatch):
    storage.write(path.with_name("y.h5"), {"y": 1}, "estimate")
    receive = child._receive

    def interrupted(pipe):
        monkeypatch.setattr(child, "_receive", receive)
        raise KeyboardInterrupt

    storage.read(path, "estimate")
    monkeypatch.setattr(child, "_receive", interrupted)
    with pytest.raises(KeyboardInterrupt):
        storage.read(path, "estimate")
    assert storage.read(path.with_name("y.h5"), "estimate") == {"y": 1}


# -- interruptions ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("call", ["fsync", "replace", "open"])
def test_a_disk_error_leaves_the_old_file_and_nothing_else(path, monkeypatch, call):
    before = path.read_bytes()

    def full(*args, **kwargs):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(*((Path, "open") if call == "open" else (os, call)), full)
    with pytest.raises(InputError, match="No space left"):
        storage.write(path, {"a": 1}, "estimate")
    monkeypatch.undo()
    assert os.listdir(path.parent) == ["x.h5"]
    assert path.read_bytes() == before


def test_an_interrupt_leaves_nothing_behind(path, monkeypatch):
    def interrupt(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        storage.write(path, {"a": 1}, "estimate")
    assert os.listdir(path.parent) == ["x.h5"]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(InputError, match="cannot be written") as error:
        storage.write(tmp_path / "none" / "x.h5", {}, "estimate")
    assert "none" in str(error.value)


def test_a_killed_writer_leaves_a_whole_file(tmp_path):
    code = """
import sys, numpy as np
from structures import storage
i = 0
while True:
    storage.write(sys.argv[1], {"i": np.full(200_000, i)}, "estimate")
    print(i, flush=True)
    i += 1
"""
    rng = np.random.default_rng(1)
    target = tmp_path / "x.h5"
    for _ in range(3):
        writer = subprocess.Popen([sys.executable, "-c", code, str(target)], stdout=subprocess.PIPE)
        assert writer.stdout is not None
        writer.stdout.readline()
        time.sleep(rng.uniform(0, 0.08))
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        writer.stdout.close()
        found = storage.read(target, "estimate")["i"]
        assert found.shape == (200_000,)
        assert np.all(found == found[0])
