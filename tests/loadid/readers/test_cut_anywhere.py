"""Files cut at every byte and damaged in one bit: nothing is lost, and nothing changed by the cut, without a word."""

import numpy as np
import pytest

from loadid import read_all
from structures._flags import codes
from structures.errors import InputError
from tests.structures.uff_made import binary58

from .files import lvm, uff

RNG = np.random.default_rng(0)
VALUES = RNG.normal(size=(12, 2)) * [1.0, 1e-5]
FORMS = {"fixed": "{:.4f}", "exponent": "{:.6e}", "shortest": "{!r}", "significant": "{:.6g}", "whole": "{:.0f}"}


def answered(path, data):
    """Records of some bytes, and whether they are flagged as cut; None where they are refused."""
    path.write_bytes(data)
    try:
        found = read_all(path)
    except InputError:
        return None
    return found, any("W209" in codes(r.flags) for r in found)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ",")])
@pytest.mark.parametrize("magnitude", [1.0, 10.0])
def test_a_table_cut_at_every_byte_changes_no_number(tmp_path, form, separator, decimal, magnitude):
    values = VALUES * magnitude
    rows = [
        separator.join([f"{k / 100:.2f}", *(FORMS[form].format(float(v)) for v in row)]) for k, row in enumerate(values)
    ]
    head = separator.join(["time [s]", "F [N]", "a [V]"]) + "\n"
    data = (head + "\n".join(rows).replace(".", decimal) + "\n").encode()
    (whole,) = answered(tmp_path / "a.csv", data)[0]
    for cut in range(len(head), len(data)):
        found = answered(tmp_path / "a.csv", data[:cut])
        if found is None:
            continue
        (record,), said = found
        assert record.labels == whole.labels, cut
        np.testing.assert_array_equal(record.values, whole.values[: len(record)], str(cut))
        # rows are only missing without a word where the cut is at the end of one: no byte tells of them
        assert said or data[cut - 1 : cut] == b"\n" or data[cut : cut + 1] == b"\n", cut


@pytest.mark.parametrize("suffix", [".lvm", ".uff", ".ufb"])
def test_other_formats_cut_at_every_byte(tmp_path, suffix):
    data = {".lvm": lambda: lvm(multi=True).encode(), ".uff": uff, ".ufb": lambda: uff(binary58)}[suffix]()
    path = tmp_path / f"a{suffix}"
    whole, _ = answered(path, data)
    silent = []
    for cut in range(len(data)):
        found = answered(path, data[:cut])
        if found is None:
            continue
        for one, full in zip(found[0], whole, strict=False):
            columns = [full.labels.index(n) for n in one.labels]
            np.testing.assert_array_equal(one.values, full.values[: len(one)][:, columns])
        fewer = sum(r.values.size for r in found[0]) < sum(r.values.size for r in whole)
        if fewer and not found[1]:
            silent.append(cut)
    assert len(silent) <= 2  # exactly between two data sets or segments, the number of which no file declares


@pytest.mark.parametrize("write", ["text", "binary"])
def test_a_bit_in_the_heading_of_a_universal_file_loses_no_channel_in_silence(tmp_path, write):
    data = uff() if write == "text" else uff(binary58)
    path = tmp_path / "a.uff"
    whole, _ = answered(path, data)
    ends = [k for k, c in enumerate(data) if c == 10]
    lines = (1, 7, 8)  # the number of the data set, the degree of freedom, the form of the numbers
    for at in (k for line in lines for k in range(ends[line - 1] + 1, ends[line]) if data[k] != 32):
        for bit in range(8):
            damaged = bytearray(data)
            damaged[at] ^= 1 << bit
            found = answered(path, bytes(damaged))
            if found is not None:
                kept = sum(len(r.labels) for r in found[0])
                assert kept == len(whole[0].labels) or found[1], (at, bit)


def test_a_bit_in_the_end_of_a_header_of_lvm_loses_no_record(tmp_path):
    data = lvm(multi=True).encode()
    path, mark = tmp_path / "a.lvm", b"***End_of_Header***"
    places = [k for k in range(len(data)) if data[k : k + len(mark)] == mark]
    assert len(places) == 3
    for place in places:
        for at in range(place, place + len(mark) + 1):
            for bit in range(8):
                damaged = bytearray(data)
                damaged[at] ^= 1 << bit
                found = answered(path, bytes(damaged))
                assert found is None or found[1] or [len(r) for r in found[0]] == [8, 8], (at, bit)


def test_a_bit_or_a_cut_in_hdf5_loses_no_channel_in_silence(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        group.attrs["fs"] = 100.0
        for k, name in enumerate(("F", "a", "b")):
            group.create_dataset(name, data=VALUES[:, k % 2]).attrs["unit"] = "N"
    data = path.read_bytes()
    (whole,), _ = answered(path, data)
    assert (whole.labels, whole.notes) == (("F", "a", "b"), ())
    for cut in range(1, len(data), 97):
        assert answered(path, data[:cut]) is None
    space = b"\x01\x00\x18\x00"  # of a header: the message that says how many values there are
    places = [k for k in range(len(data)) if data[k : k + 4] == space]
    assert len(places) == 3
    flips = [(k + j, bit) for k in places for j in (0, 2, 8, 9, 16) for bit in range(8)]
    flips += [(int(k), int(k) % 8) for k in np.random.default_rng(2).choice(len(data), 120, replace=False)]
    said = 0
    for at, bit in flips:
        damaged = bytearray(data)
        damaged[at] ^= 1 << bit
        found = answered(path, bytes(damaged))
        if found is None:
            continue
        sizes = sum(r.values.size for r in found[0])
        noted = any("left out, as they are no record" in n for r in found[0] for n in r.notes)
        assert sizes >= whole.values.size or noted, (at, bit)
        said += noted
    assert said > 3
