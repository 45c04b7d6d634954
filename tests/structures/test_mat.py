"""MAT files: against scipy's reader, cut at every byte, and what must not be read."""

import io
import zlib

import numpy as np
import pytest
from scipy import sparse
from scipy.io import loadmat, savemat

from structures.errors import InputError
from structures.files._hdf5 import read_mat
from structures.files._mat_level5 import read_level5

from .mat_made import level5_big_endian, mat73

RNG = np.random.default_rng(5)
ARRAYS = {
    "H": RNG.normal(size=(3, 2, 5)) + 1j * RNG.normal(size=(3, 2, 5)),
    "f": np.arange(5.0),
    "n": np.arange(6, dtype=np.int16).reshape(2, 3),
    "single": RNG.normal(size=(2, 2)).astype(np.float32),
    "flag": np.array([[True, False]]),
    "x": 7.0,
    "long": RNG.integers(0, 9, (4, 4)).astype(np.uint64),
}


def written(compressed=True, **arrays) -> bytes:
    file = io.BytesIO()
    savemat(file, arrays, do_compression=compressed)
    return file.getvalue()


@pytest.mark.parametrize("compressed", [False, True])
def test_the_same_as_scipy(compressed):
    data = written(compressed, **ARRAYS, text="m/s^2")
    theirs = loadmat(io.BytesIO(data))
    ours, others = read_level5(data, "x.mat")
    assert not others
    for name in ARRAYS:
        np.testing.assert_array_equal(ours[name], theirs[name], strict=name != "flag")
    assert str(ours["text"]) == "m/s^2"


def test_the_same_as_scipy_from_a_big_endian_machine():
    arrays = {"a": RNG.normal(size=(3, 4)), "some_longer_name": RNG.normal(size=(2, 3, 2))}
    data = level5_big_endian(**arrays)
    theirs, (ours, _) = loadmat(io.BytesIO(data)), read_level5(data, "x.mat")
    for name, x in arrays.items():
        np.testing.assert_array_equal(ours[name], x)
        np.testing.assert_array_equal(theirs[name], x)


@pytest.mark.parametrize("compressed", [False, True])
def test_a_cut_at_every_byte_is_refused(compressed):
    data = written(compressed, H=ARRAYS["H"])
    for k in range(len(data)):
        if k == 128:  # a file without a variable is whole
            assert read_level5(data[:k], "x.mat") == ({}, {})
            continue
        with pytest.raises(InputError, match=r"x\.mat"):
            read_level5(data[:k], "x.mat")


def test_what_is_no_array_of_numbers_is_listed_only(tmp_path):
    cell = np.array([1, "a"], dtype=object)
    data = written(a=np.eye(2), c=cell, s={"H": np.eye(2)}, sp=sparse.eye_array(3).tocsc())
    arrays, others = read_level5(data, "x.mat")
    assert list(arrays) == ["a"]
    assert others == {"c": "cell", "s": "struct", "sp": "sparse"}
    path = tmp_path / "x.mat"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"s is a struct.*found: a 2x2"):
        read_mat(path).named("s", "FRFs")
    with pytest.raises(InputError, match="there is no array q"):
        read_mat(path).named("q", "FRFs")


def test_a_bomb_is_refused_before_it_is_unpacked():
    start = written(a=np.eye(2))[:128]
    for declared in (2**31 - 1, 2**30, 2**27):
        head = np.array([14, declared], "<u4").tobytes()
        packed = zlib.compress(head + b"\0" * 10**6)
        tag = np.array([15, len(packed)], "<u4").tobytes()
        with pytest.raises(InputError, match="unpacks to more than may be read"):
            read_level5(start + tag + packed, "x.mat")
    many = np.array([6, 8, 6, 0, 5, 12, 2**30, 2**30, 2**30, 0], "<u4").tobytes()
    many += np.array([1, 0, 9, 0], "<u4").tobytes()
    tag = np.array([14, len(many)], "<u4").tobytes()
    with pytest.raises(InputError, match="unpacks to more than may be read"):
        read_level5(start + tag + many, "x.mat")


def test_a_changed_bit_of_a_compressed_variable_is_seen():
    data = bytearray(written(True, H=ARRAYS["H"]))
    for at in range(150, len(data), 37):
        damaged = bytearray(data)
        damaged[at] ^= 4
        with pytest.raises(InputError):
            read_level5(bytes(damaged), "x.mat")


def test_version_73_has_the_same_axes(tmp_path):
    real = {k: v for k, v in ARRAYS.items() if k != "flag"}
    found = read_mat(mat73(tmp_path / "x.mat", **{k: np.atleast_2d(v) for k, v in real.items()}))
    for name, x in real.items():
        np.testing.assert_array_equal(found.named(name, "test"), np.atleast_2d(x))


def test_version_73_cut(tmp_path):
    path = mat73(tmp_path / "x.mat", H=ARRAYS["H"])
    data = path.read_bytes()
    for k in [*range(0, len(data), 43), len(data) - 1]:  # all of them are refused; a stride saves time
        path.write_bytes(data[:k])
        with pytest.raises(InputError):
            read_mat(path)


def test_version_73_struct(tmp_path):
    import h5py

    path = mat73(tmp_path / "x.mat", a=np.eye(2))
    with h5py.File(path, "r+") as file:
        file.create_group("s").create_dataset("H", data=np.eye(2))
    found = read_mat(path)
    assert found.others == {"s": "struct"}


@pytest.mark.parametrize("content", [b"", b"junk" * 50, bytes(200), b"\x00\x00\x00\x00\x05\x00\x00\x00" * 20])
def test_no_mat_file(tmp_path, content):
    path = tmp_path / "x.mat"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"no MAT file that is read.*-v7"):
        read_mat(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_mat(tmp_path / "none.mat")
