"""FRFs from files as a model: SI, DOFs, kinds and lines, and every refusal that a wrong table would need."""

import io
import logging

import numpy as np
import pytest
from scipy.io import savemat

from structures import FrfModel
from structures.errors import InputError
from structures.files import read_frfs
from tests.benchmarks.fuzz import mutant

from .mat_made import mat73
from .uff_made import binary58, frfs, text58, units

RNG = np.random.default_rng(20)
H = RNG.normal(size=(6, 3, 2)) + 1j * RNG.normal(size=(6, 3, 2))
F = 20 + 2.5 * np.arange(6)
ROWS, COLUMNS = [(1, 3), (2, -3), (3, 1)], [(7, 3), (8, 2)]
LABELS = (("1+Z", "2-Z", "3+X"), ("7+Z", "8+Y"))


@pytest.fixture
def place(tmp_path):
    def put(data, name="x.uff"):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return put


def labels(model):
    return tuple(s.label for s in model.sensors), tuple(c.label for c in model.loads)


@pytest.mark.parametrize("write", [text58, binary58])
def test_a_matrix_of_frfs(place, write):
    path = place(frfs(H, ROWS, COLUMNS, write, start=20, step=2.5, ordinate=(12, "g"), denominator=(13, "kN")))
    model = read_frfs(path)
    assert isinstance(model, FrfModel)
    assert labels(model) == LABELS
    assert {(s.quantity, s.unit) for s in model.sensors} == {("acceleration", "m/s^2")}
    assert {(c.quantity, c.unit) for c in model.loads} == {("force", "N")}
    np.testing.assert_array_equal(model.frequencies, F)
    np.testing.assert_allclose(model.frf(F), H * 9.80665 / 1000, rtol=1e-10)
    assert not any(flag.code == "LID-W208" for flag in model.flags)


def test_the_order_in_the_file_does_not_matter_and_parts_can_be_chosen(place):
    sets = [text58(H[:, i, j], response=("", *r), reference=("", *c), start=20, step=2.5)
            for i, r in enumerate(ROWS) for j, c in enumerate(COLUMNS)]  # fmt: skip
    path = place(b"".join(sets[k] for k in RNG.permutation(len(sets))))
    model = read_frfs(path, responses=["3X+", (1, 3)], references=["8:+Y", "7+Z"])
    assert labels(model) == (("3+X", "1+Z"), ("8+Y", "7+Z"))
    np.testing.assert_allclose(model.frf(F), H[:, [2, 0]][:, :, [1, 0]], rtol=1e-10)


@pytest.mark.parametrize(
    ("type_", "kind", "unit", "factor"),
    [(8, "receptance", "m", 1e-3), (11, "mobility", "m/s", 1e-3), (12, "accelerance", "m/s^2", 1e-3)],
)
def test_kind_and_units_from_data_types_and_the_units_of_the_file(place, type_, kind, unit, factor):
    data = frfs(H, ROWS, COLUMNS, ordinate=(type_, "NONE"), denominator=(13, "NONE"))
    path = place(units(1e3, 1e3, 5, "mm (milli newton)") + data)
    model = read_frfs(path, kind=kind)
    assert {s.unit for s in model.sensors} == {unit}
    np.testing.assert_allclose(model.H, H * factor / 1e-3, rtol=1e-10)
    with pytest.raises(InputError, match=r"LID-W208.*kind='mobility'|LID-W208.*kind='receptance'"):
        read_frfs(path, kind="mobility" if kind == "receptance" else "receptance")


def test_both_units_in_one_text(place):
    model = read_frfs(place(frfs(H, ROWS, COLUMNS, ordinate=(1, "(1/N)*(m/s²)"), denominator=(0, "NONE"))))
    assert model.sensors[0].unit == "m/s^2"
    np.testing.assert_allclose(model.H, H, rtol=1e-10)


def test_units_that_the_file_leaves_open(place):
    path = place(frfs(H, ROWS, COLUMNS, ordinate=(0, "NONE"), denominator=(13, "NONE")))
    every = r"LID-W208.*units of 1\+Z, 2-Z, 3\+X, 7\+Z \(force\).*data type 0.*response_unit=.*reference_unit=\"N\""
    with pytest.raises(InputError, match=every):
        read_frfs(path)
    with pytest.raises(InputError, match=r"units? of 7\+Z \(force\).*no data set 164.*reference_unit="):
        read_frfs(path, response_unit="mm")
    with pytest.raises(InputError, match=r"unit of 7\+Z contradicts the file.*V \(voltage\).*force"):
        read_frfs(path, response_unit="mm", reference_unit="V")
    with pytest.raises(InputError, match="LID-W208"):
        read_frfs(path, response_unit="arbitrary", reference_unit="N")
    model = read_frfs(path, response_unit={"1+Z": "m", "2-Z": "mm", "3+X": "um"}, reference_unit="kN")
    np.testing.assert_allclose(model.H, H * np.array([1, 1e-3, 1e-6])[:, None] / 1e3, rtol=1e-10)
    assert model.as_kind("mobility").sensors[0].quantity == "velocity"


def test_responses_of_different_kinds(place):
    data = frfs(H[:, :2], ROWS[:2], COLUMNS) + frfs(H[:, 2:], ROWS[2:], COLUMNS, ordinate=(3, "um/m"))
    model = read_frfs(place(data))
    assert [s.unit for s in model.sensors] == ["m/s^2", "m/s^2", "m/m"]
    np.testing.assert_allclose(model.H[:, 2], H[:, 2] * 1e-6, rtol=1e-10)
    turning = frfs(H[:, :1], [(1, 5)], [(7, 4)], ordinate=(12, "NONE"), denominator=(13, "NONE"))
    model = read_frfs(place(units() + turning))
    assert (model.sensors[0].unit, model.loads[0].unit, model.loads[0].label) == ("rad/s^2", "N*m", "7+RX")


def test_a_conjugated_table_is_flagged(place):
    """W207 for imported FRFs: the other sign of time."""
    f = 1.0 + np.arange(128)
    frf = -((2 * np.pi * f) ** 2) / ((2 * np.pi) ** 2 * (40.0**2 - f**2 + 0.06j * 40 * f))
    codes = [
        {flag.code for flag in read_frfs(place(text58(x, start=1.0), f"{k}.unv")).flags}
        for k, x in enumerate((frf, frf.conj()))
    ]
    assert codes == [set(), {"LID-W207"}]


def test_coherence_comes_along(place):
    gamma = RNG.uniform(0.5, 1, (6, 3))
    about = {"step": 2.5, "start": 20, "denominator": (0, "NONE"), "ordinate": (0, "NONE")}
    sets = frfs(H[:, :, :1], ROWS, COLUMNS[:1], start=20, step=2.5)
    for i, r in enumerate(ROWS):
        sets += text58(gamma[:, i], function=6, response=("", *r), reference=("", *COLUMNS[0]), **about)
    coherence = read_frfs(place(sets)).coherence
    np.testing.assert_allclose(coherence, gamma, rtol=1e-10)
    assert read_frfs(place(sets.replace(b"    6         0    0", b"    0         0    0", 1))).coherence is None


def test_what_was_decided_is_logged(place, caplog):
    data = binary58(H[:, 0, 0], declared=1, step=0.195313) + text58(np.arange(3.0), function=12)
    with caplog.at_level(logging.INFO, "structures"):
        read_frfs(place(data))
    assert "declares 1 bytes" in caplog.text
    assert "0.1953125" in caplog.text


# -- refusals ---------------------------------------------------------------------------------------------------------
def test_missing_and_doubled_pairs_are_named(place):
    sets = [text58(H[:, i, j], response=("", *r), reference=("", *c))
            for i, r in enumerate(ROWS) for j, c in enumerate(COLUMNS)]  # fmt: skip
    with pytest.raises(InputError, match=r"2 of 6 pairs.*missing; found: 1\+Z / 8\+Y, 3\+X / 7\+Z;"):
        read_frfs(place(b"".join(s for k, s in enumerate(sets) if k not in (1, 4))))
    with pytest.raises(InputError, match=r"comes twice; found: 2-Z / 7\+Z in lines \d+ and \d+"):
        read_frfs(place(b"".join([*sets, sets[2]])))
    with pytest.raises(InputError, match=r"9\+Z is none of the responses"):
        read_frfs(place(b"".join(sets)), responses=["9+Z"])
    with pytest.raises(InputError, match=r"2\+Z is none of the responses"):  # a flip of sign is never made in silence
        read_frfs(place(b"".join(sets)), responses=["2+Z"])


def test_lines_that_differ_are_named(place):
    first = text58(H[:, 0, 0], response=("", 1, 3), start=20, step=2.5)
    for about in ({"start": 20, "step": 2.6}, {"start": 22.5, "step": 2.5}):
        with pytest.raises(InputError, match=r"2\+Z / 1\+Z has other lines than 1\+Z / 1\+Z"):
            read_frfs(place(first + text58(H[:, 1, 0], response=("", 2, 3), **about)))
    with pytest.raises(InputError, match="found: 5 lines"):
        read_frfs(place(first + text58(H[:5, 1, 0], response=("", 2, 3), start=20, step=2.5)))
    same = read_frfs(place(first + text58(H[:, 1, 0], F, response=("", 2, 3))))
    np.testing.assert_array_equal(same.frequencies, F)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (text58(np.ones(4), function=1), "holds no FRF; found: 1 x time response"),
        (text58(H[:, 0, 0], abscissa=("time", "s")), "abscissa of an FRF is no frequency"),
        (text58(H[:, 0, 0], abscissa=("frequency", "rpm")), "abscissa of an FRF is no frequency"),
        (text58(np.full(4, np.nan)), "NaN or infinity"),
        (text58(np.zeros(4)), "no load moves any sensor"),
        (
            text58(H[:, 0, 0]) + text58(H[:, 0, 1], reference=("", 2, 3), ordinate=(12, "g")),
            "FRFs of 1.Z are in different units",
        ),
    ],
)
def test_what_is_no_table_of_frfs(place, data, what):
    with pytest.raises(InputError, match=what):
        read_frfs(place(data))


def test_other_suffixes_and_bad_lists(place):
    with pytest.raises(InputError, match=r"\.uff.*\.mat.*\.npz.*\.csv.*FrfModel\.from_frf"):
        read_frfs(place(b"1,2\n", "x.xyz"))
    path = place(text58(H[:, 0, 0]))
    for bad in ("1+Z", [], [3.5], ["1+Z", "1Z+"]):
        with pytest.raises(InputError):
            read_frfs(path, responses=bad)


# -- MAT files --------------------------------------------------------------------------------------------------------
def matlab(**arrays) -> bytes:
    file = io.BytesIO()
    savemat(file, arrays)
    return file.getvalue()


STATED = {
    "frf": "H", "frequencies": "f", "kind": "accelerance", "response_unit": "g", "reference_unit": "N",
    "responses": LABELS[0], "references": LABELS[1],
}  # fmt: skip


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 1, 0), (2, 0, 1)])
def test_the_axes_of_a_mat_array_follow_from_its_shape(place, tmp_path, order):
    arrays = {"H": np.transpose(H, order), "f": F}
    model = read_frfs(place(matlab(**arrays), "x.mat"), **STATED)
    np.testing.assert_allclose(model.frf(F), H * 9.80665, rtol=1e-14)
    assert labels(model) == LABELS
    again = read_frfs(mat73(tmp_path / "y.mat", H=arrays["H"], f=F[:, None]), **STATED)
    np.testing.assert_array_equal(again.H, model.H)


def test_axes_that_the_shape_leaves_open(place):
    square = H[:, :2]
    path = place(matlab(H=square, f=F), "x.mat")
    stated = {**STATED, "responses": LABELS[0][:2]}
    with pytest.raises(InputError, match=r"leaves open which axis is which.*shape \(6, 2, 2\).*axes="):
        read_frfs(path, **stated)
    for axes, expected in (
        (("lines", "responses", "references"), square),
        (("lines", "references", "responses"), square.transpose(0, 2, 1)),
    ):
        np.testing.assert_allclose(read_frfs(path, axes=axes, **stated).H, expected * 9.80665, rtol=1e-14)
    with pytest.raises(InputError, match="axes do not fit"):
        read_frfs(path, axes=("responses", "references", "lines"), **stated)


def test_axes_of_length_one_that_matlab_drops(place):
    one = {**STATED, "references": ["7+Z"]}
    model = read_frfs(place(matlab(H=H[:, :, 0].T, f=F), "x.mat"), **one)
    np.testing.assert_allclose(model.H, H[:, :, :1] * 9.80665, rtol=1e-14)
    single = {**one, "responses": ["1+Z"]}
    model = read_frfs(place(matlab(H=H[:, 0, 0], f=F), "x.mat"), **single)
    np.testing.assert_allclose(model.H, H[:, :1, :1] * 9.80665, rtol=1e-14)


def test_frequencies_in_rad_per_second(place):
    path = place(matlab(H=H, f=2 * np.pi * F), "x.mat")
    np.testing.assert_allclose(read_frfs(path, frequency_unit="rad/s", **STATED).frequencies, F, rtol=1e-14)
    with pytest.raises(InputError, match="no frequencies"):
        read_frfs(path, frequency_unit="s", **STATED)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"frf": None}, r"which array holds the FRFs\?; found: H 6x3x2, f 1x6"),
        ({"frequencies": "w"}, "there is no array w"),
        ({"responses": None}, "a MAT file names no responses"),
        ({"references": ["7+Z"]}, "does not fit its labels and lines"),
        ({"kind": None}, r"LID-W208.*kind=None"),
        ({"kind": "receptance"}, r"LID-W208.*responses are acceleration"),
        ({"response_unit": None}, r"LID-W208.*units of 1\+Z, 2-Z, 3\+X are not known.*MAT file states no unit"),
        ({"frequencies": "H"}, "no frequencies"),
    ],
)
def test_what_must_be_stated_of_a_mat_file(place, change, what):
    with pytest.raises(InputError, match=what):
        read_frfs(place(matlab(H=H, f=F), "x.mat"), **{**STATED, **change})


# -- damage -----------------------------------------------------------------------------------------------------------
def damaged(path, count, **stated):
    """Kind of damage and model, or None where it is refused; an exception other than InputError passes through."""
    data, found = path.read_bytes(), []
    for seed in range(count):
        kind, changed = mutant(data, seed)
        path.write_bytes(changed)
        try:
            found.append((kind, read_frfs(path, **stated)))
        except InputError as error:
            found.append((kind, None if str(path) in str(error) else "a refusal that names no file"))
    assert "a refusal that names no file" not in [model for _, model in found]
    return found


@pytest.mark.parametrize("write", [text58, binary58])
def test_damaged_universal_files(place, write):
    found = damaged(place(units(code=1) + frfs(H, ROWS, COLUMNS, write), "x.unv"), 300)
    assert sum(model is None for _, model in found) > 150
    assert all(model is None for kind, model in found if kind == "truncated")  # a pair is missing at least


def test_damaged_mat_files(place, tmp_path):
    found = damaged(place(matlab(H=H, f=F), "x.mat"), 300, **STATED)
    assert all(model is None for kind, model in found if kind == "truncated")
    found = damaged(mat73(tmp_path / "y.mat", H=H, f=F[:, None]), 8, **STATED)
    assert all(model is None for kind, model in found if kind == "truncated")
