import numpy as np
import pytest

from loadid import read, read_all
from loadid._readers import scan
from structures._flags import codes
from structures.errors import InputError
from tests.data import measured

from .files import A, F, lvm

G = 9.80665
LOG = ("hammer_two_hits", "long_single_header_multi_ch.lvm")


def write(tmp_path, text, name="log.lvm"):
    path = tmp_path / name
    path.write_bytes(text.encode())
    return path


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("multi", [False, True])
def test_records_of_one_file(tmp_path, decimal, newline, multi):
    first, second = read_all(write(tmp_path, lvm(decimal=decimal, newline=newline, multi=multi)))
    assert (first.name, second.name, first.dt) == ("record_1", "record_2", 0.001)
    assert (first.labels, first.units) == (("F", "a"), ("N", "g"))
    both = np.vstack((first.values, second.values))
    np.testing.assert_allclose(both, np.column_stack((F, A * G)))
    assert not first.flags
    assert not second.flags


def test_decimal_comma_without_a_word_in_the_header(tmp_path):
    text = lvm(decimal=",").replace("Decimal_Separator\t,\n", "")
    np.testing.assert_allclose(read(write(tmp_path, text), 0)["F"], F[:8])


@pytest.mark.parametrize("columns", ["One", "Multi"])
def test_time_columns(tmp_path, columns):
    (r,) = read_all(write(tmp_path, lvm(columns=columns)))  # time runs on: packets of one record
    np.testing.assert_allclose(r.values, np.column_stack((F, A * G)))
    assert (r.labels, r.units, r.dt) == (("F", "a"), ("N", "g"), 0.001)
    parts = read_all(write(tmp_path, lvm(columns=columns, records=4)))  # and starts anew
    assert [len(p) for p in parts] in ([16, 16], [8, 8, 8, 8])


def test_several_records_must_be_chosen(tmp_path):
    path = write(tmp_path, lvm())
    with pytest.raises(InputError, match=r"0: record_1 8x2, 1: record_2 8x2.*--record"):
        read(path)
    assert read(path, "record_2").sha256 == read(path, 1).sha256 == read(path, "1").sha256
    with pytest.raises(InputError, match=r"no record 'record_3'.*did you mean"):
        read(path, "record_3")


def test_fs_and_units_override(tmp_path):
    r = read(write(tmp_path, lvm()), 0, fs=1024, units={"F": "arbitrary", "a": "m/s^2"})
    assert (r.dt, r.channels[0].unit) == (1 / 1024, "arbitrary")
    np.testing.assert_allclose(r.values, np.column_stack((F, A))[:8])
    assert any("1024" in n and "0.001" in n for n in r.notes)


@pytest.mark.parametrize("multi", [False, True])
def test_truncation_at_every_byte_is_said(tmp_path, multi):
    text = lvm(multi=multi, samples=4)
    whole = [r.values for r in read_all(write(tmp_path, text))]
    bare = [r.values for r in read_all(write(tmp_path, text.rstrip()[: text.rstrip().rfind("\n") + 1]))]
    assert len(bare) == 2
    silent = []
    for size in range(len(text)):
        try:
            records = read_all(write(tmp_path, text[:size]))
        except InputError:
            continue
        for k, r in enumerate(records):
            np.testing.assert_array_equal(r.values, whole[k][: len(r)])  # never a wrong number
            if len(r) < 4:
                assert codes(r.flags) == {"W209"}
                assert f"{len(r)} of 4" in r.flags[0].message
        if len(records) < 2 and not records[-1].flags:
            silent.append(size)
    # A file cut exactly after a whole record is a valid file with fewer records: nothing in it says otherwise.
    assert len(silent) <= (3 if multi else 1)


@pytest.mark.parametrize(
    "form",
    [
        {"columns": "No", "multi": True},
        {"columns": "One", "multi": True, "records": 3},
        {"columns": "Multi"},
        {"columns": "No", "decimal": ","},
    ],
    ids=str,
)
def test_a_damaged_header_gives_no_other_record(tmp_path, form):
    """One flipped bit: the same numbers, or it is refused, or flagged."""
    path, data = write(tmp_path, lvm(**form)), lvm(**form).encode()
    whole, at, refused = scan(path), 0, 0
    for line in data.splitlines(keepends=True):
        header = line[:1] not in b"\t-0123456789"
        for place in range(at, at + len(line)) if header else ():
            for bit in range(8) if line.startswith(b"***") else [(place * 5) % 8]:
                mutant = bytearray(data)
                mutant[place] ^= 1 << bit
                path.write_bytes(mutant)
                try:
                    found = scan(path)
                except InputError:
                    refused += 1
                    continue
                if not any(t.flags for t in found):
                    assert [t.values.shape for t in found] == [t.values.shape for t in whole], bytes(mutant)
                    for one, own in zip(found, whole, strict=True):
                        np.testing.assert_array_equal(one.values, own.values)
        at += len(line)
    assert refused > 300


def test_the_end_of_the_first_header_is_missed(tmp_path):
    for k in range(2):
        parts = lvm(multi=True).split("***End_of_Header***")
        text = (
            "***End_of_Header***".join(parts[: k + 1])
            + "***End_of_Heades***"
            + "***End_of_Header***".join(parts[k + 1 :])
        )
        with pytest.raises(InputError, match="does not end"):
            read_all(write(tmp_path, text))


def test_measured_log_is_the_same_as_its_npz():
    path = measured(*LOG)
    stated = {"F": "arbitrary"}
    records = read_all(path, units=stated)
    with np.load(measured("hammer_two_hits", "lvm_two_hits.npz")) as z:
        for r, name in zip(records, ("hit1", "hit2"), strict=True):
            np.testing.assert_array_equal(r.values, z[name])
            assert (r.labels, r.dt) == (("F", "m_1", "m_2"), 0.000977)
            assert r.units == ("arbitrary", "m/s^2", "m/s^2")
    assert read(path, 1, fs=1024, units=stated).dt == 1 / 1024
    as_written = read(path, 0)
    assert as_written.channels[0].quantity == "acceleration"  # the header is wrong, and taken at its word
    np.testing.assert_allclose(as_written["F"], records[0]["F"] * G)
    for r, s in zip(records, read_all(measured("hammer_two_hits", "lvm_two_hits.npz"), units={"F": "arbitrary", "m_1": "m/s2", 2: "m/s2"}), strict=True):  # fmt: skip  # noqa: E501
        np.testing.assert_array_equal(r.values, s.values)
        assert s.fs == 1024


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("Samples\t8\t8", "Samples\t8\t9", "different length"),
        ("Samples\t8\t8", "Samples\t8", "how many samples"),
        ("Samples\t8\t8", "Samples\t-8\t8", "no whole number"),
        ("Samples\t8\t8", "Samples\t0\t0", "without samples"),
        ("Channels\t2", "Channels\t999999999", "no sensible number"),
        ("Delta_X\t0.001000\t0.001000", "Delta_X\tnan\tnan", "no number"),
        ("Delta_X\t0.001000\t0.001000", "Delta_X\t0.001\t0.002", "differ"),
        ("Delta_X\t0.001000\t0.001000", "Delta_X\t0\t0", "not positive"),
        ("Delta_X\t0.001000\t0.001000", "Note\t0", "sampling frequency is not known"),
        ("X_Value\tF\ta", "X_Value\tF", "line is too short|do not fit|Comment"),
        ("X_Columns\tNo", "X_Columns\tSome", "unknown number"),
        ("Y_Unit_Label\tN\tg", "Y_Unit_Label\tN\t", "does not state the unit"),
        ("Y_Unit_Label\tN\tg", "Y_Unit_Label\tN\tEU", "unknown unit"),
    ],
)
def test_bad_headers(tmp_path, old, new, match):
    assert old in lvm()
    with pytest.raises(InputError, match=match):
        read(write(tmp_path, lvm().replace(old, new)), 0)


def test_a_text_suffix_does_not_hide_it(tmp_path):
    assert len(read_all(write(tmp_path, lvm(), "log.txt"))) == 2
