"""Universal files: every layout of the format, cuts at every byte, another writer, faults seen in the field."""

import itertools

import numpy as np
import pytest

from structures.errors import InputError
from structures.files._uff import System, parse_uff, ratio, read_uff, unit_of
from structures.files._uff_datasets import unrounded
from structures.files._uff_records import AxisRecord

from .uff_made import END, binary58, block, frfs, head, text58, units

RNG = np.random.default_rng(58)
X = np.cumsum(RNG.uniform(1, 2, 7)).astype(np.float32).astype(float)
REAL, COMPLEX = RNG.normal(size=7), RNG.normal(size=7) + 1j * RNG.normal(size=7)


def only(data):
    (function,) = parse_uff(data, "x.uff").functions
    return function


@pytest.mark.parametrize("values", [REAL, COMPLEX], ids=["real", "complex"])
@pytest.mark.parametrize("x", [None, X], ids=["even", "uneven"])
@pytest.mark.parametrize("double", [False, True])
def test_every_layout_of_the_format(values, x, double):
    text = only(text58(values, x, double=double, start=10.0, step=0.25))
    np.testing.assert_allclose(text.values, values, rtol=1e-11 if double else 5e-5)
    np.testing.assert_allclose(text.abscissa, 10 + 0.25 * np.arange(7) if x is None else x, rtol=5e-6)
    for order, wide, newline in itertools.product("<>", (False, True), (b"", b"\n", b"\r\n")):
        found = only(binary58(values, x, double=double, order=order, wide=wide, newline=newline, step=0.25))
        np.testing.assert_allclose(found.values, values, rtol=1e-15 if double else 1e-6)
        np.testing.assert_array_equal(found.abscissa, 0.25 * np.arange(7) if x is None else X)


@pytest.mark.parametrize(
    "data",
    [
        text58(REAL),
        text58(COMPLEX, X),
        text58(REAL, double=False),
        binary58(REAL),
        binary58(COMPLEX, X, order=">"),
        binary58(COMPLEX, X, wide=True, newline=b"\n"),
        units(),
        block(15, f"{1:10d}{0:10d}{0:10d}{8:10d}{-1.0:13.5E}{-1.0:13.5E}{-1.0:13.5E}"),
    ],
    ids=["text", "complex uneven", "single", "binary", "big endian", "newline", "units", "nodes"],
)
def test_a_cut_at_every_byte_is_refused(data):
    parse_uff(data, "x.uff")
    last = len(data) - 1  # without its last line feed the file is whole
    for k in range(last):
        with pytest.raises(InputError, match=r"x\.uff"):
            parse_uff(data[:k], "x.uff")
    parse_uff(data[:last], "x.uff")


def test_a_cut_between_data_sets_leaves_those_before_it():
    sets = [units(), text58(REAL), binary58(COMPLEX)]
    data = b"".join(sets)
    borders = np.cumsum([len(s) for s in sets])
    for k in range(len(data)):
        if any(k in (b, b - 1) for b in borders):
            found = parse_uff(data[:k], "x.uff")
            assert len(found.functions) == sum(b - 1 <= k for b in borders[1:])
        else:
            with pytest.raises(InputError):
                parse_uff(data[:k], "x.uff")


def test_it_says_how_many_samples_are_left():
    data = text58(np.arange(1024.0))
    rows = data.split(b"\n")
    with pytest.raises(InputError, match="truncated: 812 of 1024 samples"):
        parse_uff(b"\n".join(rows[: 13 + 203]) + b"\n" + END.encode(), "x.uff")
    with pytest.raises(InputError, match="more samples than declared"):
        parse_uff(b"\n".join([*rows[:-2], b" 1.0E+00", *rows[-2:]]), "x.uff")
    data = binary58(np.arange(1024.0))
    with pytest.raises(InputError, match="truncated: 999 of 1024 samples"):
        parse_uff(data[: len(data) - 7 - 8 * 25], "x.uff")
    with pytest.raises(InputError, match="do not end where they should"):
        parse_uff(data[:-108] + data[-100:] + data, "x.uff")


# -- another writer ---------------------------------------------------------------------------------------------------
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # it leaves files open
@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("even", [0, 1])
@pytest.mark.parametrize("values", [REAL, COMPLEX], ids=["real", "complex"])
def test_files_that_pyuff_writes(tmp_path, binary, even, values):
    """It declares 8 bytes per value whatever they take (its issue 91): number and type of the values count."""
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "p.uff"
    x = 5 + 0.5 * np.arange(7)
    file = pyuff.UFF(str(path))
    about = {"rsp_node": 3, "rsp_dir": -2, "ref_node": 8, "ref_dir": 4, "abscissa_spec_data_type": 18}
    about |= {"ordinate_spec_data_type": 11, "orddenom_spec_data_type": 13, "abscissa_spacing": even}
    for k in (1, 2):
        file._write_set({"type": 58, "binary": binary, "func_type": 4, "data": k * values, "x": x, **about}, "add")
    found = read_uff(path)
    assert [f.response for f in found.functions] == ["3-Y", "3-Y"]
    assert [f.reference for f in found.functions] == ["8+RX", "8+RX"]
    for k, function in enumerate(found.functions, 1):
        np.testing.assert_allclose(function.values, k * values, rtol=1e-10)
        np.testing.assert_array_equal(function.abscissa, x)


@pytest.mark.parametrize("values", [REAL, COMPLEX], ids=["real", "complex"])
@pytest.mark.parametrize("write", [text58, binary58])
def test_pyuff_reads_what_the_tests_write(tmp_path, values, write):
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "p.uff"
    path.write_bytes(write(values, step=0.5))
    theirs, ours = pyuff.UFF(str(path)).read_sets(), read_uff(path).functions[0]
    np.testing.assert_allclose(theirs["data"], ours.values, rtol=1e-14)
    np.testing.assert_allclose(theirs["x"], ours.abscissa)


def test_nodes_and_units_that_pyuff_writes(tmp_path):
    """Coordinates of -1 look like the end of a data set to one who searches for ``-1`` (its issue 99)."""
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "p.uff"
    file = pyuff.UFF(str(path))
    nodes = {"node_nums": [1, 2], "def_cs": [0, 0], "disp_cs": [0, 0], "color": [1, 1]}
    file._write_set({"type": 15, **nodes, "x": [-1.0, 0.5], "y": [-1.0, 2.0], "z": [-1.0, -1.0]}, "add")
    system = {"units_code": 5, "units_description": "mm", "temp_mode": 1, "length": 1e3, "force": 1e3, "temp": 1.0}
    file._write_set({"type": 164, **system, "temp_offset": 273.15}, "add")
    found = read_uff(path)
    np.testing.assert_array_equal(found.nodes[1], [-1, -1, -1])
    np.testing.assert_array_equal(found.nodes[2], [0.5, 2, -1])
    assert found.system is not None
    np.testing.assert_allclose((found.system.length, found.system.force), 1e-3)


# -- what instruments write -------------------------------------------------------------------------------------------
def test_exponents_of_three_digits_leave_no_blank():
    text = text58(REAL, double=False, step=0.5).decode()
    rows = text.split("\n")
    rows[13] = " 3.81956E+000-3.56616E+000-2.98987E-100-2.62207E+000-3.22879E+000-3.63712E+000"
    assert only("\n".join(rows).encode()).values[1:4].tolist() == [-3.56616, -2.98987e-100, -2.62207]


def test_columns_that_are_not_kept():
    """pyuff's issue 52: fields that begin in other columns than the format says."""
    rows = text58(REAL, X).decode().split("\n")
    rows[7] = "1         0    0           0 AP                 0   0 NONE               0   0"
    rows[13:17] = ["  1.0E+00   0.000000000000E+00   2.00000E+00   1.0000000E+00", " 3.0 4 4.0 5 5.0 6 6.0 7 7.0 8"]
    found = only("\n".join(rows).encode())
    assert (found.head.function, found.response) == (1, "AP")
    assert found.values.tolist() == [0, 1, 4, 5, 6, 7, 8]


def test_other_letters_exponents_and_line_ends():
    latin = text58(REAL, ordinate=(1, "m/s²"), label="ÄÖ", ids=("Messung Straße", *["NONE"] * 4))
    found = only(latin)
    assert (found.head.axes[1].unit, found.head.axes[1].label, found.head.ids[0]) == ("m/s²", "ÄÖ", "Messung Straße")
    utf8 = latin.decode("latin-1").encode("utf-8")
    assert only(utf8).head.axes[1].unit == "m/s²"
    dos = text58(REAL).replace(b"\n", b"\r\n").replace(b"E+0", b"D+0")
    np.testing.assert_allclose(only(dos + b"\x1a").values, REAL, rtol=1e-11)
    padded = b"".join(line.ljust(80) + b"\n" for line in text58(REAL).split(b"\n")[:-1])
    np.testing.assert_allclose(only(padded).values, REAL, rtol=1e-11)


def test_a_last_line_filled_with_zeros():
    rows = text58(REAL, double=False).split(b"\n")
    rows[14] += b"  0.00000E+00" * 5
    assert len(only(b"\n".join(rows)).values) == 7
    rows[14] = rows[14].replace(b"0.00000", b"1.00000")
    with pytest.raises(InputError, match="more samples than declared"):
        only(b"\n".join(rows))


def test_the_end_mark_within_binary_data():
    values = np.frombuffer((b"\n    -1\n" * 14)[:56], "<f8")
    np.testing.assert_array_equal(only(binary58(values)).values, values)


def test_a_wrong_byte_count_is_said():
    assert "declares 56 bytes and holds the 112" in only(binary58(COMPLEX, declared=56)).notes[0]
    assert not only(binary58(COMPLEX)).notes


@pytest.mark.parametrize(
    ("text", "step"),
    [
        ("1.95313e-01", 25 / 128),
        ("1.95312E-05", 1 / 51200),
        ("9.76563E-06", 1 / 102400),
        ("5.00000E-005", 5e-5),
        ("1.00000E-01", 0.1),
        ("3.33333E-03", 1 / 300),
        ("3.14159E-01", 0.314159),
        ("1.2345678901E-01", 0.12345678901),
    ],
)
def test_a_rounded_step(text, step):
    """The step that was meant, never further from what is written than its last digit."""
    assert unrounded(float(text), text) == step
    assert abs(step - float(text)) <= 10.0 ** (np.floor(np.log10(step)) - 5)


def test_as_many_abscissae_as_values():
    """pyuff's issue 75: steps of 0.1 from 25 gave one too many."""
    assert len(only(text58(np.ones(101), start=25.0, step=0.1)).abscissa) == 101


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_doubles_under_the_header_of_singles_are_refused(tmp_path):
    """What pyuff writes with force_double=False: half of the bytes would pass for other numbers."""
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "p.uff"
    about = {"rsp_node": 3, "rsp_dir": 2, "ref_node": 8, "ref_dir": 1, "abscissa_spec_data_type": 18}
    about |= {"orddenom_spec_data_type": 13, "abscissa_spacing": 1, "ord_data_type": 2, "n_bytes": 0}
    dataset = {"type": 58, "binary": 1, "func_type": 4, "data": REAL, "x": np.arange(7.0), **about}
    pyuff.UFF(str(path))._write_set(dataset, "add", force_double=False)
    with pytest.raises(InputError, match="do not end where they should; found: 28 bytes declared"):
        read_uff(path)


def test_skipped_sets_are_counted():
    data = block(82, "1 2 3") + block(2411, "1", "2") + block(2411, "3") + block(999, "?") + units() + text58(REAL)
    found = parse_uff(data, "x.uff")
    assert found.skipped == {82: 1, 2411: 2, 999: 1}
    assert found.notes[1] == "skipped: 1 x data set 999 (unknown)"
    assert found.holds() == "1 x FRF"


# -- units ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("kind", "direction", "text", "system", "expected"),
    [
        (12, 3, "g", None, "g"),
        (12, 3, "", System(1.0, 1.0), "m/s^2"),
        (12, 3, "", System(1e-3, 1e-3), "mm/s^2"),
        (11, 3, "", System(0.0254, 4.4482216152605), "in/s"),
        (8, 3, "", System(1e-3, 1.0), "mm"),
        (13, 3, "", System(1.0, 4.4482216152605), "lbf"),
        (13, 4, "", System(1e-3, 1.0), "N*mm"),
        (12, 5, "", System(1e-3, 1.0), "rad/s^2"),
        (3, 3, "", System(1e-3, 1.0), "m/m"),
        (1, 3, "(m/s²)", None, "m/s²"),
    ],
)
def test_units_that_are_known(kind, direction, text, system, expected):
    said = unit_of(AxisRecord(kind, 0, 0, 0, "", text), direction, system)
    assert said.unit is not None
    assert set(said.unit.symbol.split("*")) == set(expected.split("*"))


@pytest.mark.parametrize(
    ("kind", "text", "system", "why"),
    [
        (12, "", None, "no data set 164"),
        (0, "", System(1.0, 1.0), "data type 0 tells none"),
        (12, "N", None, "data type 12 is acceleration, and its unit reads 'N'"),
        (12, "g", System(1.0, 1.0), "reads 'g', and data set 164 makes it m/s"),
        (0, "furlong", None, "not known"),
    ],
)
def test_units_that_stay_open(kind, text, system, why):
    said = unit_of(AxisRecord(kind, 0, 0, 0, "", text), 3, system)
    assert said.unit is None
    assert why in said.why


def test_a_system_without_symbols_keeps_its_factor():
    said = unit_of(AxisRecord(15, 0, 0, 0, "", ""), 3, System(1e-2, 1e-2))  # centinewtons per square centimetre
    assert said.unit is not None
    assert (said.unit.factor, said.unit.si) == (pytest.approx(100.0), "Pa")


def test_two_units_in_one_text():
    assert ratio("(m/s^2)/N") == ("m/s^2", "N")
    assert ratio("(1/N)*(m/s²)") == ("m/s²", "N")
    assert ratio("g/kN") == ("g", "kN")
    assert ratio("m/s^2") is None
    assert ratio("Pa") is None


def test_units_that_contradict_each_other():
    with pytest.raises(InputError, match=r"line 3: data set 164 contradicts itself.*code 5.*1000 and 1000"):
        parse_uff(units(1.0, 1.0, 5, "mm (milli newton)"), "x.uff")
    with pytest.raises(InputError, match="two systems of units"):
        parse_uff(units() + units(1e3, 1.0), "x.uff")
    with pytest.raises(InputError, match="gives no units"):
        parse_uff(units(0.0), "x.uff")


# -- refusals ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"", "no data set"),
        (b"hello\n", "line 1: no data set begins here"),
        (text58(REAL) + b"x\n", "no data set begins here"),
        (END.encode() + b"    xy\n" + END.encode(), "line 2: no number of a data set"),
        (text58(REAL).replace(b"E+00", b"E+0x", 1), "no number"),
        (
            text58(REAL).replace(b"    -1\n    58\n", b"    -1\n    58b     1     1          11          56\n"),
            "binary form",
        ),
        (text58(REAL, X[::-1]), "the abscissa does not rise"),
        (text58(REAL, step=-1.0), "the abscissa does not rise"),
        ((END + f"{58:6d}\n" + head(precision=3) + END).encode(), "what the format does not know"),
        ((END + f"{58:6d}\n" + head(count=0) + END).encode(), "what the format does not know"),
        ((END + f"{58:6d}\n" + head(count=10**8) + END).encode(), "truncated: 0 of 100000000 samples"),
        (block(15, "1 2 3"), "holds no nodes"),
        (text58(1j * REAL, function=47), "line 14: a type of function that the format does not know.*found: 47"),
        (text58(1j * REAL, function=7), "has complex values.*type 7, auto correlation"),
        (text58(REAL).replace(b"    58\n", b"    5877777 \n"), "line 2: no number of a data set"),
        (text58(np.zeros(7)).replace(b"0.000000000000E+00", b"0.00000000000E+00\x1f", 1), "no number"),
    ],
)
def test_damage_is_named(data, what):
    with pytest.raises(InputError, match=what):
        parse_uff(data, "x.uff")


def test_a_missing_file(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_uff(tmp_path / "none.uff")


def test_numbers_by_python_and_no_underscores():
    with pytest.raises(InputError, match=r"line 14: no number.*'1_0'"):
        parse_uff(text58(np.zeros(7)).replace(b"0.000000000000E+00", b"1_0", 1), "x.uff")


def test_a_long_text_is_turned_into_numbers_in_parts(monkeypatch):
    data = text58(np.arange(5000.0))
    whole = only(data).values
    monkeypatch.setattr("structures.files._uff_records.CHUNK", 999)
    np.testing.assert_array_equal(only(data).values, whole)
    with pytest.raises(InputError, match=r"line 1014: no number.*'4.0x"):
        only(data.replace(b"4.000000000000E+03", b"4.0x0000000000E+03"))


def test_frfs_come_in_the_order_of_the_file():
    H = RNG.normal(size=(4, 2, 2)) + 1j * RNG.normal(size=(4, 2, 2))
    found = parse_uff(frfs(H, [(1, 3), (2, -3)], [(7, 1), (8, 0)]), "x.uff").functions
    assert [(f.response, f.reference) for f in found] == [
        ("1+Z", "7+X"), ("1+Z", ""), ("2-Z", "7+X"), ("2-Z", "")
    ]  # fmt: skip
