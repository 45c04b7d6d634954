import contextlib
import time

import numpy as np
import pytest

from loadid import read
from loadid._readers import scan
from structures._flags import codes
from structures.errors import InputError

from .files import A, F, csv

G = 9.80665


def write(tmp_path, text, name="log.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", "."), ("   ", ",")]
)
def test_delimiters_and_decimals(tmp_path, separator, decimal):
    if separator.isspace() and separator != "\t":  # names must not hold the delimiter
        text = separator.join(("time", "F", "acc")) + "\n" + csv(separator, decimal, header=False)
    else:
        text = csv(separator, decimal)
    r = read(write(tmp_path, text), units={"F": "N", "acc": "g"})
    assert r.labels == ("F", "acc")
    assert r.dt == 0.001
    np.testing.assert_allclose(r.values, np.column_stack((F, A * G)), rtol=1e-15)


def test_units_in_the_names(tmp_path):
    r = read(write(tmp_path, csv()))
    assert [(c.label, c.quantity, c.unit) for c in r.channels] == [
        ("F", "force", "N"),
        ("acc", "acceleration", "m/s^2"),
    ]
    assert r.units == ("N", "g")
    assert read(write(tmp_path, csv()), units={"acc": "m/s^2"})["acc"] == pytest.approx(A)


@pytest.mark.parametrize("row", ["s,kN,m/s^2", "[s],[kN],[m/s^2]", "(s),(kN),(m/s2)"])
def test_units_row(tmp_path, row):
    r = read(write(tmp_path, "time,F,acc\n" + row + "\n" + csv(header=False)))
    np.testing.assert_allclose(r.values, np.column_stack((F * 1000, A)))


def test_time_unit(tmp_path):
    r = read(write(tmp_path, csv().replace("time [s]", "time [ms]")))
    assert r.dt == pytest.approx(1e-6)
    assert read(write(tmp_path, csv().replace("time [s]", "time")), units={"time": "ms"}).dt == pytest.approx(1e-6)


def test_preamble_comment_quotes_bom_utf16_and_trailing_delimiter(tmp_path):
    body = csv(header=False)
    for text, encoding in (
        ("made by X\n\noperator;N.N.\n" + csv(), "utf-8"),
        ("# time [s],F [N],acc (g)\n" + body, "utf-8-sig"),
        ('"time [s]","F [N]","acc (g)"\n' + body, "cp1252"),
        (csv().replace("\n", ",\n"), "utf-8"),
        (csv().replace("\n", "\r\n"), "utf-16"),
        ("\n".join(",".join(f'"{c}"' for c in line.split(",")) for line in csv().splitlines()) + "\n", "utf-8"),
    ):
        r = read(write(tmp_path, text, encoding=encoding))
        np.testing.assert_allclose(r.values, np.column_stack((F, A * G)), err_msg=text[:30])


def test_without_names(tmp_path):
    path = write(tmp_path, csv(header=False))
    r = read(path, columns=("time", "force", "acc"), units={"force": "N", "acc": "g"})
    assert (r.labels, r.dt) == (("force", "acc"), 0.001)
    assert read(path, columns=("force", "acc"), units={"force": "N", "acc": "g"}).labels == ("force", "acc")
    assert read(path, units={"ch1": "N", 1: "g"}).labels == ("ch1", "ch2")
    with pytest.raises(InputError, match="4 names"):
        read(path, columns=("a", "b", "c", "d"), units={})


def test_without_time_fs_is_required(tmp_path):
    text = "F [N],a [g]\n" + "\n".join(f"{f},{a}" for f, a in zip(F, A, strict=True))
    path = write(tmp_path, text + "\n")
    with pytest.raises(InputError, match="--fs HZ"):
        read(path)
    assert read(path, fs=512).dt == 1 / 512


def test_columns_select_by_name_or_index(tmp_path):
    path = write(tmp_path, csv())
    assert read(path, columns=["acc"]).labels == ("acc",)
    assert read(path, columns="time,acc,F").labels == ("acc", "F")
    assert read(path, columns=[1]).labels == ("acc",)
    with pytest.raises(InputError, match=r"no column 'ac'.*0: F, 1: acc.*did you mean 'acc'"):
        read(path, columns=["ac"])
    with pytest.raises(InputError, match=r"no channel 'f'.*did you mean 'F'"):
        read(path, units={"f": "N"})
    for bad in ([], ["F", "F"], ["time"], [None], 3):
        with pytest.raises(InputError):
            read(path, columns=bad)


def test_missing_units_are_listed_with_the_way_to_state_them(tmp_path):
    path = write(tmp_path, "time,F,a\n" + csv(header=False))
    with pytest.raises(InputError, match=r"2 channels.*F, a.*--unit F=UNIT --unit a=UNIT.*\"F\": \"UNIT\".*arbitrary"):
        read(path)
    with pytest.raises(InputError, match=r"log\.csv, channel a: unknown unit.*parsec"):
        read(path, units={"F": "N", "a": "parsec"})
    assert read(path, units={"F": "arbitrary"}, columns=["F"]).channels[0].unit == "arbitrary"


def test_ambiguous_comma(tmp_path):
    rows = "\n".join(f"{i},{7 * i % 10}" for i in range(20)) + "\n"
    with pytest.raises(InputError, match="decimal sign or the delimiter"):
        read(write(tmp_path, rows), fs=1, units={0: "N"})
    assert read(write(tmp_path, "F [N]\n" + rows), fs=1)["F"][3] == 3.1
    assert read(write(tmp_path, "F [N],a [g]\n" + rows), fs=1).labels == ("F", "a")


def test_a_cut_last_line_is_said(tmp_path):
    text = csv()
    whole = read(write(tmp_path, text))
    assert not whole.flags
    assert not read(write(tmp_path, text[:-1])).flags  # only the line end is missing
    for cut in (3, 8, 12):
        r = read(write(tmp_path, text[:-cut]))
        assert codes(r.flags) == {"W209"}
        assert "15 of 16" in r.flags[0].message
        np.testing.assert_array_equal(r.values, whole.values[:-1])


RNG = np.random.default_rng(5)
LAST = {  # how a program may write the numbers of the last column
    "exponents": [f"{x:.6e}" for x in -6e-5 * RNG.random(9)],
    "long exponents": [f"{x:.18e}" for x in RNG.standard_normal(9) * 10.0 ** np.arange(-99, 18, 13)],
    "decimals": [f"{x:.3f}" for x in 100 * RNG.standard_normal(9)],
    "shortest": [repr(float(x)) for x in RNG.standard_normal(9) * 10.0 ** RNG.integers(-7, 3, 9)],
    "six digits": [f"{x:g}" for x in RNG.standard_normal(9) * 10.0 ** RNG.integers(-7, 3, 9)],
    "integers": [str(x) for x in RNG.integers(-4000, 4000, 9)],
    "gaps": ["1.250", "", "nan", "2.500", "3.125", "", "-1.000", "0.125", ""],
}


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".txt"])
@pytest.mark.parametrize("form", LAST)
def test_a_table_cut_at_any_byte_gives_no_wrong_number(tmp_path, form, suffix):
    mark, name = {".csv": (",", "log.csv"), ".tsv": ("\t", "log.tsv"), ".txt": (";", "log.txt")}[suffix]
    rows = [mark.join((f"{0.001 * i:.3f}", f"{i}", x)) for i, x in enumerate(LAST[form])]
    data = "\n".join([mark.join(("time [s]", "n [1]", "acc [m/s^2]")), *rows, ""]).encode()
    whole, flagged = scan(write(tmp_path, data.decode(), name))[0].values, 0
    path = tmp_path / name
    for size in range(len(data)):
        path.write_bytes(data[:size])
        try:
            (found,) = scan(path)
        except InputError:
            continue
        flagged += bool(found.flags)
        if not found.flags:
            assert found.values.shape[1] == 3, data[:size]
            np.testing.assert_array_equal(found.values, whole[: len(found.values)], err_msg=str(data[:size][-30:]))
            assert len(found.values) >= data[:size].count(b"\n") - 1
    assert flagged > 80  # most cuts leave a table that can be used


@pytest.mark.parametrize(("form", "rows"), [("exponents", 9), ("decimals", 9), ("decimals", 3), ("long exponents", 9)])
def test_a_table_without_a_last_line_end_is_whole_where_its_last_number_is(tmp_path, form, rows):
    text = "\n".join(["time [s],acc [m/s^2]", *(f"{i / 10},{x}" for i, x in enumerate(LAST[form][:rows]))])
    for one in (text, text.replace(",", "\t"), text.replace(",", ";").replace(".", ",")):
        found = read(write(tmp_path, one))
        assert not found.flags
        np.testing.assert_array_equal(found["acc"], np.array(LAST[form][:rows], float))


def test_a_last_line_that_was_blank_had_an_end(tmp_path):
    for tail in ("\n", "\n ", "\n,", "\n\n,,"):
        found = read(write(tmp_path, "n [V],m [V]\n" + "\n".join(f"{i},{2 * i}" for i in range(12)) + tail), fs=1)
        assert (len(found), found.flags) == (12, ())


def test_one_row_without_an_end_is_kept_and_said(tmp_path):
    (found,) = scan(write(tmp_path, "12;13"))
    np.testing.assert_array_equal(found.values, [[12, 13]])
    assert codes(found.flags) == {"W209"}


def test_gaps(tmp_path):
    lines = csv().splitlines()
    r = read(write(tmp_path, "\n".join(lines[:6] + lines[7:]) + "\n"))
    assert np.flatnonzero(np.isnan(r["F"])).tolist() == [5]
    assert len(r) == 16
    assert any("1 sample is missing" in n and "after sample 4" in n for n in r.notes)
    assert [f.evidence.name for f in r.select("F").health()] == ["missing"]
    lines[8] = lines[8].rsplit(",", 1)[0] + ","
    r = read(write(tmp_path, "\n".join(lines) + "\n"))
    assert np.flatnonzero(np.isnan(r["acc"])).tolist() == [7]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("0.0050,", "0.0054,", "not uniform|missing"),
        ("0.0050,", "0.0020,", "does not rise"),
        ("0.0050,", "nan,", "no step"),
        ("0.0050,", "900.0,", "does not rise|missing"),
        ("0.0050,", "0.0050,1,", "different length"),
        ("0.0050,", "five,", r"no number.*line 7"),
        ("0.0050,", "inf,", "no step"),
    ],
)
def test_bad_rows(tmp_path, old, new, match):
    with pytest.raises(InputError, match=match):
        read(write(tmp_path, csv().replace(old, new, 1)))


@pytest.mark.parametrize("text", ["", "\n\n", "a,b\n", "only words here", "1", "time,F\n0,1\n", "\x00\x01\x02\x03" * 9])
def test_no_table(tmp_path, text):
    with pytest.raises(InputError):
        read(write(tmp_path, text), units={0: "N"})


def test_rounded_stamps_give_the_step_of_the_instrument(tmp_path):
    for fs, digits in ((3200, 6), (3200, 4), (25600, 5), (1024, 4), (10 / 7, 4), (51200, 9), (44100, 6), (0.1, 1)):
        t = np.round(np.arange(4000) / fs, digits)
        rows = "\n".join(f"{x:.{digits}f},1" for x in t)
        r = read(write(tmp_path, "t,F [N]\n" + rows + "\n"))
        assert r.fs == pytest.approx(fs, rel=1e-15 if fs == int(fs) else 1e-7), (fs, digits)


def test_doubled_and_empty_names_are_numbered(tmp_path):
    text = "a [N],a [N], [N]\n" + "\n".join("1,2,3.5" for _ in range(5)) + "\n"
    found = read(write(tmp_path, text), fs=1, units={2: "N"})
    assert found.labels == ("a (column 1)", "a (column 2)", "[N]")
    text = "ch1 [N],[N],\n" + "\n".join("1,2,3.5" for _ in range(5)) + "\n"
    assert len(set(read(write(tmp_path, text), fs=1, units={1: "N", 2: "N"}).labels)) == 3


# -- what a table may be beside the usual ------------------------------------------------------------------------------
def test_commas_that_part_columns_and_decimals(tmp_path):
    german = csv(",", ",")
    names, *rows = german.splitlines()
    assert rows[3].count(",") == 5
    r = read(write(tmp_path, german))
    np.testing.assert_allclose(r.values, np.column_stack((F, A * G)), rtol=1e-15)
    assert any("two groups of digits are read as one number" in n for n in r.notes)
    mixed = "\n".join(
        [names, *rows[:4], rows[4].replace(",0000", "", 1) if ",0000" in rows[4] else "0,0040,7,1,5", *rows[5:]]
    )
    with pytest.raises(InputError, match=r"decimal sign too|different length"):
        read(write(tmp_path, mixed + "\n"))
    whole = "t [s],F [N]\n" + "\n".join(f"{i},{i % 7}" for i in range(20)) + "\n"  # whole numbers are no such pairs
    assert read(write(tmp_path, whole))["F"][8] == 1.0


def test_a_table_on_its_side_is_recognised(tmp_path):
    t = np.arange(300) / 1000
    lines = [
        ",".join([n, *(f"{v:.4f}" for v in x)]) for n, x in (("time [s]", t), ("F [N]", np.sin(t)), ("a [g]", t**2))
    ]
    with pytest.raises(InputError, match=r"on its side.*'time \[s\]', 'F \[N\]', 'a \[g\]'.*transpose"):
        read(write(tmp_path, "\n".join(lines) + "\n"))
    bare = "\n".join(line.partition(",")[2] for line in lines) + "\n"
    with pytest.raises(InputError, match="on its side"):
        read(write(tmp_path, bare), fs=1000)


def test_addresses_and_home_folders(tmp_path, monkeypatch):
    path = write(tmp_path, csv())
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    assert len(read(f"~/{path.name}")) == len(F)
    for address in ("https://example.com/a.csv", "s3://bucket/a.csv", "file:///a.csv"):
        with pytest.raises(InputError, match=f"an address is no file.*{address[:2]}.*download"):
            read(address)


@pytest.mark.parametrize(
    "heading", ["a" + "[" * 100_000, "t" + " " * 100_000, "(" * 100_000, '"' * 100_000, "1." * 50_000]
)
def test_a_long_heading_costs_no_more_than_its_length(tmp_path, heading):
    path = write(tmp_path, f"{heading},b\n" + "".join(f"{i / 100:.2f},{i % 7}.5\n" for i in range(20)))
    begin = time.process_time()
    with contextlib.suppress(InputError):
        read(path, fs=100, units={1: "N"})
    assert time.process_time() - begin < 1.0  # a hundredth of it here; the square of the length takes minutes
