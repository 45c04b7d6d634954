import io
import zipfile

import numpy as np
import pytest

from loadid import read, read_all
from loadid._readers import source
from structures.errors import InputError
from tests.data import measured

from .files import A, F, T, npy, npz

BOTH = np.column_stack((F, A))
UNITS = {0: "N", 1: "m/s^2"}


def write(tmp_path, data, name="log.npy"):
    path = tmp_path / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("dtype", ["f8", ">f8", "f4", "i4", "u1", "f2"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_both_orientations(tmp_path, dtype, order):
    x = np.array(np.abs(BOTH), dtype=dtype, order=order)
    for array, axis in ((x, 0), (np.asarray(x.T, order=order), 1)):
        r = read(write(tmp_path, npy(array)), fs=100, units=UNITS)
        np.testing.assert_array_equal(r.values, x.astype(float))
        assert any(f"axis {axis}" in n and "longer" in n for n in r.notes)
    with pytest.raises(InputError, match=r"channel|unit"):  # stated the other way round there are 16 channels
        read(write(tmp_path, npy(x)), fs=100, units=UNITS, axis=1)


def test_square_arrays_need_the_axis(tmp_path):
    path = write(tmp_path, npy(BOTH[:2]))
    with pytest.raises(InputError, match="--axis"):
        read(path, fs=1, units=UNITS)
    np.testing.assert_array_equal(read(path, fs=1, units=UNITS, axis=1).values, BOTH[:2].T)
    for bad in (2, "time", -3):
        with pytest.raises(InputError, match="axis"):
            read(path, fs=1, units=UNITS, axis=bad)


def test_time_row_and_column(tmp_path):
    x = np.column_stack((T, F, A))
    for array in (x, x.T):
        r = read(write(tmp_path, npy(array)), units=UNITS)
        assert (r.dt, r.labels) == (0.001, ("ch1", "ch2"))
        r = read(write(tmp_path, npy(array)), columns=("time", "force", "acceleration"), units=UNITS)
        assert r.labels == ("force", "acceleration")
        np.testing.assert_array_equal(r.values, BOTH)
    one = read(write(tmp_path, npy(F)), fs=10, columns=("F",), units={"F": "kN"})
    assert one.values.shape == (16, 1)


@pytest.mark.parametrize("k", range(1, 6))
def test_measured_hits(k):
    path = measured("hammer_five_hits", f"measurements_{k}.npy")
    stated = {"force": "N", "acceleration": "m/s^2"}
    r = read(path, columns=("time", "force", "acceleration"), units=stated)
    assert (r.dt, len(r), r.labels) == (1 / 25600, 25600, ("force", "acceleration"))
    np.testing.assert_array_equal(r.values.T, np.load(path)[1:])
    with pytest.raises(InputError, match="--unit force=UNIT --unit acceleration=UNIT"):
        read(path, columns=("time", "force", "acceleration"))


def test_measured_shaker_names_and_rounded_time():
    stated = {"drive_V": "V", "force_lbf": "lbf", "acc_g": "g"}
    r = read(measured("cantilever_shaker", "cantilever_shaker.npz"), "test2", units=stated)
    assert (r.fs, len(r)) == (3200, 63041)
    assert r.labels == ("drive_V", "force_lbf", "acc_g")


def test_truncation_at_every_byte(tmp_path):
    data = npy(BOTH)
    for size in range(len(data)):
        with pytest.raises(InputError):
            read(write(tmp_path, data[:size]), fs=1, units=UNITS)
    with pytest.raises(InputError, match="truncated: 31 of 32"):
        read(write(tmp_path, data[:-1]), fs=1, units=UNITS)
    with pytest.raises(InputError, match="more bytes"):
        read(write(tmp_path, data + b"\0"), fs=1, units=UNITS)


class Trap:
    def __reduce__(self):
        return (open, ("/tmp/loadid_trap", "w"))


def test_never_unpickled(tmp_path):
    file = io.BytesIO()
    np.save(file, np.array([Trap()], dtype=object), allow_pickle=True)
    for data, name in ((file.getvalue(), "log.npy"), (archive({"x.npy": file.getvalue()}), "log.npz")):
        with pytest.raises(InputError, match="never unpickled"):
            read(write(tmp_path, data, name), fs=1)


def header(shape, descr="<f8"):
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": shape})
    return file.getvalue()


@pytest.mark.parametrize("shape", [(10**12,), (2**40, 2**40), (-1,), (0, 3), (3, 0), (2, 2, 2), ()])
def test_hostile_shapes(tmp_path, shape):
    with pytest.raises(InputError):
        read(write(tmp_path, header(shape) + b"\0" * 64), fs=1)


@pytest.mark.parametrize("dtype", ["<c16", "<U3", "?", [("a", "<f8")], "<M8[s]", "V8"])
def test_other_dtypes(tmp_path, dtype):
    with pytest.raises(InputError):
        read(write(tmp_path, npy(np.zeros(4, dtype=dtype))), fs=1)


def archive(members, method=zipfile.ZIP_DEFLATED):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as z:
        for name, data in members.items():
            z.writestr(name, data)
    return file.getvalue()


def test_npz_records(tmp_path):
    path = write(tmp_path, npz(hit1=BOTH, hit2=BOTH + 1, fs=500.0), "log.npz")
    with pytest.raises(InputError, match="0: hit1 16x2, 1: hit2 16x2"):
        read(path)
    r = read(path, "hit2", units=UNITS)
    assert (r.fs, r.name) == (500, "hit2")
    np.testing.assert_array_equal(r.values, BOTH + 1)
    assert [x.name for x in read_all(path, units=UNITS)] == ["hit1", "hit2"]


def test_npz_of_channels(tmp_path):
    r = read(write(tmp_path, npz(t=T, F=F, a=A), "log.npz"), units={"F": "N", "a": "g"})
    assert (r.labels, r.dt) == (("F", "a"), 0.001)
    r = read(write(tmp_path, npz(x=BOTH, time=T, channels=["F", "a"], units=["N", "g"]), "log.npz"))
    assert (r.labels, r.dt, r.units) == (("F", "a"), 0.001, ("N", "g"))
    with pytest.raises(InputError, match="different length"):
        read(write(tmp_path, npz(F=F, a=A[:-1], fs=3), "log.npz"), units={"F": "N", "a": "g"})
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="not positive"):
            read(write(tmp_path, npz(F=F, fs=bad), "log.npz"), units={"F": "N"})


@pytest.mark.parametrize("name", ["../x.npy", "/x.npy", "a/../../x.npy", "x.txt", "C:\\x.npy", ".npy"])
def test_hostile_names(tmp_path, name):
    with pytest.raises(InputError, match="member of the archive"):
        read(write(tmp_path, archive({name: npy(BOTH)}), "log.npz"), fs=1)


def test_archive_bomb_is_refused_before_it_is_unpacked(tmp_path):
    bomb = archive({"x.npy": header((2**24,)) + b"\0" * 2**27})
    assert len(bomb) < 2**18
    with pytest.raises(InputError, match="declares more than may be read"):
        read(write(tmp_path, bomb, "log.npz"), fs=1)


def test_budget(tmp_path, monkeypatch):
    monkeypatch.setattr(source, "BUDGET", 100)
    with pytest.raises(InputError, match="at most 100 bytes"):
        read(write(tmp_path, npy(BOTH)), fs=1)


def test_npz_truncation_and_checksum(tmp_path):
    data = npz(x=BOTH, fs=1.0)
    for size in range(0, len(data), 7):
        with pytest.raises(InputError):
            read(write(tmp_path, data[:size], "log.npz"), units=UNITS)
    plain = bytearray(archive({"x.npy": npy(BOTH)}, zipfile.ZIP_STORED))
    plain[200] ^= 1
    with pytest.raises(InputError, match="CRC"):
        read(write(tmp_path, bytes(plain), "log.npz"), fs=1, units=UNITS)
