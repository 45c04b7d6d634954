import h5py
import numpy as np
import pytest

from loadid import read, read_all
from structures.errors import InputError
from structures.files import _child as child

from .files import A, F, T, hdf5

BOTH = np.column_stack((F, A))
UNITS = {0: "N", 1: "m/s^2"}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.h5"


@pytest.mark.parametrize("compression", [None, "gzip", "lzf"])
def test_dataset_with_attributes(path, compression):
    r = read(hdf5(path, compression))
    assert (r.name, r.dt, r.labels, r.units) == ("run", 0.001, ("F", "a"), ("N", "g"))
    np.testing.assert_allclose(r.values, BOTH * [1, 9.80665])


def test_channels_of_a_group_and_inherited_step(path):
    with h5py.File(path, "w") as file:
        file.attrs["fs"] = 250
        for name in ("hit1", "hit2"):
            group = file.create_group(f"tests/{name}")
            for label, x, unit in (("F", F, "kN"), ("a", A, "g")):
                group.create_dataset(label, data=x).attrs["unit"] = unit
    first, second = read_all(path)
    assert (first.name, second.name) == ("tests/hit1", "tests/hit2")
    assert (first.labels, first.units, first.fs) == (("F", "a"), ("kN", "g"), 250)
    np.testing.assert_allclose(first["F"], F * 1000)
    with pytest.raises(InputError, match="0: tests/hit1 16x2"):
        read(path)


def test_time_dataset_text_lists_and_orientation(path):
    with h5py.File(path, "w") as file:
        file["time"] = T
        file["x"] = BOTH.T
        file["x"].attrs["channels"] = "F, a"
        file["x"].attrs["units"] = np.array([b"N", b"g"])
    r = read(path)
    assert (r.dt, r.labels, r.units) == (0.001, ("F", "a"), ("N", "g"))


def test_different_lengths(path):
    with h5py.File(path, "w") as file:
        file["F"], file["a"] = F, A[:-1]
    with pytest.raises(InputError, match="different length"):
        read(path, fs=1, units={"F": "N", "a": "g"})


@pytest.fixture
def foreign(tmp_path):
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["x"] = BOTH
        file["deep/x"] = BOTH
    (tmp_path / "other.bin").write_bytes(BOTH.tobytes())
    return other


@pytest.mark.parametrize("depth", ["", "a/", "a/b/"])
@pytest.mark.parametrize("kind", ["external link", "external storage", "virtual"])
def test_nothing_outside_the_file_is_read(path, foreign, depth, kind):
    with h5py.File(path, "w") as file:
        if depth:
            file.create_group(depth)
        if kind == "external link":
            file[depth + "x"] = h5py.ExternalLink(str(foreign), "x")
        elif kind == "external storage":
            place = (str(foreign.with_suffix(".bin")), 0, BOTH.nbytes)
            file.create_dataset(depth + "x", BOTH.shape, "f8", external=[place])
        else:
            layout = h5py.VirtualLayout(BOTH.shape, "f8")
            layout[...] = h5py.VirtualSource(str(foreign), "x", BOTH.shape)
            file.create_virtual_dataset(depth + "x", layout)
    with pytest.raises(InputError, match=r"leaves the file|outside the file"):
        read(path, fs=1, units=UNITS)


def test_soft_link_through_an_external_link(path, foreign):
    with h5py.File(path, "w") as file:
        file["own"] = BOTH
        file["door"] = h5py.ExternalLink(str(foreign), "deep")
        file["soft"] = h5py.SoftLink("/door/x")
    with pytest.raises(InputError, match="leaves the file"):
        read_all(path, fs=1, units=UNITS)


def test_inner_links_and_cycles_do_no_harm(path):
    with h5py.File(path, "w") as file:
        file["g/x"] = BOTH
        file["g/loop"] = file["/"]
        file["again"] = file["g/x"]
        file["soft"] = h5py.SoftLink("/g/x")
        file["nowhere"] = h5py.SoftLink("/none")
    assert len(read_all(path, fs=1, units=UNITS)) == 1


def test_a_claim_of_128_gib(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("x", (2**34,), "f8", chunks=(2**16,))
    assert path.stat().st_size < 10_000
    with pytest.raises(InputError, match="declares more than may be read"):
        read(path, fs=1, units={"x": "N"})


def test_groups_beyond_number_are_refused_in_their_own_words(path):
    with h5py.File(path, "w") as file:
        for k in range(10_050):
            file.create_group(f"g{k}")
        file["x"] = np.ones(10)
    with pytest.raises(InputError, match=r"too many groups and datasets.*a file of their own"):
        read(path, fs=1, units={"x": "N"})


def test_a_bomb(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("x", data=np.zeros(2**24), chunks=(2**20,), compression="gzip")
    with pytest.raises(InputError, match="declares more than may be read"):
        read(path, fs=1, units={"x": "N"})


def test_samples_that_were_never_written(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("x", (100,), "f8", chunks=(10,))[:35] = 1.0
    with pytest.raises(InputError, match="truncated: 4 of 10 chunks"):
        read(path, fs=1, units={"x": "N"})
    with h5py.File(path, "w") as file:
        file.create_dataset("x", (100,), "f8")
    with pytest.raises(InputError, match="truncated: 0 of 800 bytes"):
        read(path, fs=1, units={"x": "N"})


def test_unknown_filter(path):
    with h5py.File(path, "w") as file:
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk((16, 2))
        plist.set_scaleoffset(h5py.h5z.SO_INT, 0)
        space = h5py.h5s.create_simple((16, 2))
        h5py.h5d.create(file.id, b"x", h5py.h5t.NATIVE_INT32, space, plist)
    with pytest.raises(InputError, match="unknown compression"):
        read(path, fs=1, units=UNITS)


def test_large_attribute(path):
    with h5py.File(path, "w", libver="latest") as file:
        file["x"] = BOTH
        file["x"].attrs.create("units", np.zeros(2**14, "S16"))
    with pytest.raises(InputError, match="attribute is too large"):
        read(path, fs=1, units=UNITS)


def test_a_hang_and_a_crash_of_the_library_are_bad_input(path, monkeypatch):
    good = hdf5(path).read_bytes()
    place = good.index(b"GCOL")
    heap = bytearray(good)
    at = place + 16
    while int.from_bytes(heap[at : at + 2], "little"):
        at += 16 + (int.from_bytes(heap[at + 8 : at + 16], "little") + 7) // 8 * 8
    heap[at + 8 : at + 16] = bytes(8)  # a free block of no size: the library walks on the spot
    monkeypatch.setattr(child, "PATIENCE", 1.0)
    path.write_bytes(heap)
    with pytest.raises(InputError, match=r"log\.h5: the HDF5 library hangs.*no answer in 1 s"):
        read(path)
    path.write_bytes(good)
    assert read(path).labels == ("F", "a")  # the next file finds a new child
    child._process.kill()
    child._process.wait()
    assert read(path).labels == ("F", "a")
    monkeypatch.setattr(child, "_send", lambda *_: child._process.kill())
    with pytest.raises(InputError, match="the HDF5 library crashed"):
        read(path)


def test_nothing_there(path):
    with h5py.File(path, "w") as file:
        file["words"] = "hello"
        file["cube"] = np.zeros((2, 2, 2))
        file["empty"] = h5py.Empty("f8")
        file["z"] = np.zeros((3, 3), complex)
    with pytest.raises(InputError, match="holds no record"):
        read(path, fs=1)


def test_truncation(path):
    data = hdf5(path, "gzip").read_bytes()
    for size in range(0, len(data), 37):
        path.write_bytes(data[:size])
        with pytest.raises(InputError):
            read(path)
