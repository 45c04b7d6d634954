"""Records in MAT files of both formats."""

import numpy as np
import pytest

from loadid import read, read_all
from structures.errors import InputError
from tests.benchmarks.fuzz import outcomes
from tests.structures.mat_made import level5_big_endian, mat73

from .files import A, F, T, mat

BOTH = np.column_stack((F, A))


@pytest.fixture(params=["compressed", "plain", "7.3", "big endian"])
def put(request, tmp_path):
    def write(**arrays):
        path = tmp_path / "x.mat"
        if request.param == "7.3":
            return mat73(path, **{k: x if isinstance(x, str) else np.atleast_2d(x) for k, x in arrays.items()})
        if request.param == "big endian":
            data = level5_big_endian(**{k: np.atleast_2d(x) for k, x in arrays.items() if not isinstance(x, str)})
        else:
            data = mat(request.param == "compressed", **arrays)
        path.write_bytes(data)
        return path

    return write


def test_vectors_are_channels_and_scalars_the_step(put):
    record = read(put(F=F[:, None], a=A[None], fs=250.0), units={"F": "N", "a": "g"})
    assert (record.labels, record.fs) == (("F", "a"), 250)
    np.testing.assert_allclose(record.values, BOTH * [1, 9.80665])


def test_matrices_are_records_and_t_is_time(put):
    path = put(x=BOTH.T, y=2 * BOTH, t=T[:, None])
    first, second = read_all(path, units={0: "N", 1: "m/s^2"})
    assert (first.name, second.name, first.dt) == ("x", "y", 0.001)
    np.testing.assert_array_equal(second.values, 2 * first.values)
    np.testing.assert_array_equal(read(path, "x", units={0: "N", 1: "m/s^2"}).values, BOTH)


def test_the_step_and_the_units_must_be_known(put):
    path = put(x=BOTH)
    with pytest.raises(InputError, match="sampling frequency is not known"):
        read(path, units={0: "N", 1: "g"})
    with pytest.raises(InputError, match="does not state the unit of 2 channels"):
        read(path, fs=100)
    assert read(path, fs=100, units={0: "N", 1: "g"}).dt == 0.01


def test_what_is_passed_over_is_said(put):
    path = put(x=F, H=BOTH.reshape(4, 4, 2), note="text")
    record = read(path, fs=1, units={"x": "N"})
    assert "H (3 axes)" in "".join(record.notes) or "H (struct, cell or complex)" in "".join(record.notes)
    with pytest.raises(InputError, match=r"holds no record.*read_frfs"):
        read(put(H=BOTH.reshape(4, 4, 2)), fs=1)


@pytest.mark.parametrize("content", [bytes(124) + b"\x00\x01IM", bytes(124) + b"\x00\x02IM", bytes(300)])
def test_a_header_and_nothing_behind_it(tmp_path, content):
    path = tmp_path / "x.mat"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"x\.mat"):
        read(path)


def test_damaged_files_of_version_73(tmp_path):
    path = mat73(tmp_path / "a.mat", x=BOTH, fs=np.array([[1000.0]]))
    seen = list(outcomes(path, 300, tmp_path))
    assert max(seconds for _, _, seconds in seen) < 5
    assert {outcome for kind, outcome, _ in seen if kind == "truncated"} == {"refused"}  # as at every other byte


def test_nothing_outside_the_file_is_read(tmp_path):
    import h5py

    path = mat73(tmp_path / "x.mat", a=BOTH)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = BOTH
    with h5py.File(path, "r+") as file:
        file["x"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "x")
    with pytest.raises(InputError, match="leaves the file"):
        read(path, fs=1, units={0: "N", 1: "g"})
