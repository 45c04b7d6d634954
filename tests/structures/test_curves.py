"""FRFs of SDynPy archives, of the structs of Simcenter Testlab and of text tables; their time responses as records."""

import numpy as np
import pytest
from scipy.io import savemat

import loadid
from loadid._readers import scan
from loadid._readers.source import NotStated
from structures.errors import InputError
from structures.files import read_frfs
from tests.benchmarks.fuzz import mutant

F = np.arange(1.0, 9.0) * 2.5
RNG = np.random.default_rng(3)
H = RNG.standard_normal((8, 2, 1, 2)) @ [1, 1j]  # (lines, responses, references)
N = 16
T = np.arange(N) / 1000
X = np.column_stack((np.hanning(N), np.sin(T * 500)))
G = 9.80665


# -- SDynPy ------------------------------------------------------------------------------------------------------------
def sdynpy(path, kind, abscissa, ordinate, coordinates, compressed=False):
    """An archive as release 0.23 saves it; ordinate (functions, lines), coordinates as (node, direction)."""
    coordinates = np.array(coordinates)
    fields = [("abscissa", "<f8", (len(abscissa),)), ("ordinate", ordinate.dtype.str, (len(abscissa),))]
    fields += [(f"comment{k}", "<U80") for k in range(1, 6)]
    fields += [("coordinate", [("node", "<u8"), ("direction", "i1")], (coordinates.shape[1],))]
    data = np.zeros(len(ordinate), fields)
    data["abscissa"], data["ordinate"] = abscissa, ordinate
    data["coordinate"]["node"], data["coordinate"]["direction"] = coordinates[..., 0], coordinates[..., 1]
    if not compressed:
        np.savez(path, data=data, function_type=kind)
        return path
    bare = data[[f[0] for f in fields[1:]]].copy()
    np.savez(path, data=bare, function_type=kind, abscissa_start=abscissa[0], abscissa_step=np.diff(abscissa).mean())
    return path


@pytest.mark.parametrize("compressed", [False, True])
def test_time_responses_of_sdynpy(tmp_path, compressed):
    path = sdynpy(tmp_path / "x.npz", 1, T, X.T, [[(1, 3)], [(2, -1)]], compressed)
    with pytest.raises(NotStated, match=r"unit of 2 channels; found: 1\+Z, 2-X.*--unit 1\+Z=UNIT --unit 2-X=UNIT"):
        loadid.read(path)
    record = loadid.read(path, units={"1+Z": "N", "2-X": "g"})
    assert record.dt == 0.001
    np.testing.assert_allclose(record.values, X * [1, G], rtol=1e-15)


@pytest.mark.parametrize("compressed", [False, True])
def test_frfs_of_sdynpy(tmp_path, compressed):
    path = sdynpy(tmp_path / "x.npz", 4, F, H[:, :, 0].T, [[(1, 3), (5, 3)], [(2, -1), (5, 3)]], compressed)
    with pytest.raises(InputError, match=r"no time response; found: 2 x FRF.*read_frfs"):
        loadid.read(path)
    with pytest.raises(InputError, match=r"LID-W208.*units of 1\+Z, 2-X, 5\+Z are not known"):
        read_frfs(path)
    model = read_frfs(path, response_unit="g", reference_unit="N", responses=["2X-", "1+Z"])
    assert [s.label for s in model.sensors] == ["2-X", "1+Z"]
    np.testing.assert_allclose(model.H, H[:, ::-1] * G, rtol=1e-14)
    np.testing.assert_allclose(model.frequencies, F, rtol=1e-14)


def test_pickled_archives_are_refused(tmp_path):
    np.savez(tmp_path / "x.npz", data=np.array([{"a": 1}], object), function_type=1)
    with pytest.raises(InputError, match="pickle"):
        loadid.read(tmp_path / "x.npz")
    np.savez(tmp_path / "y.npz", data=np.arange(4.0), function_type=1)
    for read in (loadid.read, read_frfs):
        with pytest.raises(InputError, match="no data array of SDynPy"):
            read(tmp_path / "y.npz")


# -- Simcenter Testlab -------------------------------------------------------------------------------------------------
def cell(*texts):
    out = np.empty((1, len(texts)), object)
    out[0, :] = texts
    return out


def block(values, label, *, x="s", increment=0.001, kind="Signal", factor=1.0, count=None, start=0.0, **record):
    """A struct with the fields of an export; values (samples, channels)."""
    change = {"offset": 0.0, "factor": factor, "log_reference": 1.0}
    quantity = {
        "label": label,
        "quantity_terms": {"name": "ACCELERATION", "exponent": 1.0},
        "unit_transformation": change,
    }
    over = {"label": x, "quantity_terms": {"name": "TIME"}, "info": {"dir_format": 1.0}}
    about = {"start_value": start, "increment": increment, "number_of_values": float(count or len(values))}
    return {
        "x_values": {**about, "quantity": over},
        "y_values": {"values": values, "quantity": quantity},
        "function_record": {"type": kind, "creation_time": "2026/11/24 08:00:00", **record},
    }


def mat(path, compression=True, **variables):
    savemat(path, variables, do_compression=compression, long_field_names=True)
    return path


@pytest.mark.parametrize("compression", [True, False])
def test_channels_of_one_struct(tmp_path, compression):
    signal = block(X, "g", factor=G, name=cell("3:Point1", "4:Point2"), primary_channel={"label": cell("P1", "P2")})
    record = loadid.read(mat(tmp_path / "x.mat", compression, Signal=signal))
    assert (record.labels, record.units, record.dt) == (("P1", "P2"), ("g", "g"), 0.001)
    np.testing.assert_array_equal(record.values, X * G)


def test_a_struct_for_each_channel_and_an_frf_beside_them(tmp_path):
    path = mat(
        tmp_path / "x.mat",
        Signal_0=block(X[:, :1], "N", name="Hammer", start=-0.25),
        Signal_1=block(X[:, 1:], "m/s^2", name="12:+Z", start=-0.25),
        FRF=block(H[:, 0], "g/N", x="Hz", increment=2.5, start=2.5, kind="FRF", name="12:+Z/Hammer"),
    )
    record = loadid.read(path)
    assert (record.labels, record.units) == (("Hammer", "12+Z"), ("N", "m/s^2"))
    assert any("of 2 x time response, 1 x FRF only the time responses are read" in note for note in record.notes)
    assert any("begins at -0.25 s" in note for note in record.notes)
    model = read_frfs(path)
    assert ([s.label for s in model.sensors], [c.label for c in model.loads]) == (["12+Z"], ["Hammer"])
    np.testing.assert_allclose(model.H, H[:, :1] * G, rtol=1e-14)
    np.testing.assert_allclose(model.frequencies, F)


def test_a_transformation_that_contradicts_the_label_leaves_the_unit_open(tmp_path):
    path = mat(tmp_path / "x.mat", Signal=block(X[:, :1], "g", factor=3.0, name="P1"))
    with pytest.raises(NotStated, match="P1"):
        loadid.read(path)
    assert any("factor 3" in note for note in scan(path)[0].notes)


def test_structs_that_contradict_themselves(tmp_path):
    path = mat(tmp_path / "x.mat", Signal=block(X, "g", count=20))
    with pytest.raises(InputError, match="truncated: 16 of 20"):
        loadid.read(path)
    path = mat(tmp_path / "y.mat", FRF=block(H[:, 0], "g/N", x="Hz", kind="FRF"))
    with pytest.raises(InputError, match=r"no time response; found: 1 x FRF"):
        loadid.read(path)
    whole = mat(tmp_path / "w.mat", False, s={"a": 1.0}).read_bytes()
    at = whole.index(b"\x05\x00\x04\x00")  # the width of the names of its fields
    (tmp_path / "w.mat").write_bytes(whole[:at] + b"\x05" + bytes(7) + whole[at + 8 :])
    with pytest.raises(InputError, match="a struct is damaged"):
        loadid.read(tmp_path / "w.mat", fs=1.0)
    nested: dict = {"a": 1.0}
    for _ in range(20):
        nested = {"s": nested}
    with pytest.raises(InputError, match="nested too deep"):
        loadid.read(mat(tmp_path / "z.mat", deep=nested))
    with pytest.raises(InputError, match=r"holds no record.*other \(struct\)"):
        loadid.read(mat(tmp_path / "o.mat", other={"a": 1.0, "b": "text", "c": cell("x", "y")}))


def test_every_cut_of_a_struct_is_refused(tmp_path):
    path = mat(tmp_path / "x.mat", False, Signal=block(X, "g", name=cell("a", "b")))
    data = path.read_bytes()
    for n in range(129, len(data), 23):
        path.write_bytes(data[:n])
        with pytest.raises(InputError):
            loadid.read(path)


# -- text tables -------------------------------------------------------------------------------------------------------
def rows(columns, separator=",", decimal="."):
    return "".join(
        separator.join(f"{x:.9e}".replace(".", decimal) for x in row) + "\n" for row in np.column_stack(columns)
    )


PARTS = [F, H[:, 0, 0].real, H[:, 0, 0].imag, H[:, 1, 0].real, H[:, 1, 0].imag]
RADIANS = [F / 1e3, abs(H[:, 0, 0]), np.angle(H[:, 0, 0])]
POLAR = [F, abs(H[:, 0, 0]), np.angle(H[:, 0, 0], deg=True)]


@pytest.mark.parametrize(
    ("heading", "columns", "separator", "decimal", "scale"),
    [
        ("Frequency [Hz],Real 1+Z/5+Z [(m/s^2)/N],Imag 1+Z/5+Z,Real 2/5+Z [(m/s^2)/N],Imag 2/5+Z", PARTS, ",", ".", 1),
        ("Analyser 9.1\nFrequency\tMagnitude 1Z+/5Z+\tPhase 1Z+/5Z+\nHz\tg/N\tdeg", POLAR, "\t", ".", G),
        ("Frequenz [Hz];Betrag 1+Z/5+Z [g/N];Phase 1+Z/5+Z [°]", POLAR, ";", ",", G),
        ("# f [Hz]  Re [m/s^2/N]  Im [m/s^2/N]", PARTS[:3], " ", ".", 1),
        ("Freq (kHz),Mag 1+Z/5+Z (mm/s/N),Phase 1+Z/5+Z (rad)", RADIANS, ",", ".", 1e-3),
        ('"f [kHz]","Re(1+Z/5+Z)[g/N]","Im(1+Z/5+Z)[g/N]"', [F / 1e3, *PARTS[1:3]], ",", ".", G),
        ("Frequency;Real 1+Z/5+Z [g/N];Imaginary 1+Z/5+Z;Amplitude 1+Z/5+Z;Angle 1+Z/5+Z", [*PARTS[:3], *POLAR[1:]],
         ";", ".", G),
        ("Frequency [Hz],H1 1+Z/5+Z Real [g/N],H1 1+Z/5+Z Imag,Coherence", [*PARTS[:3], F * 0 + 1], ",", ".", G),
    ],
)  # fmt: skip
def test_tables_of_analysers(tmp_path, heading, columns, separator, decimal, scale):
    path = tmp_path / "x.txt"
    path.write_text(f"{heading}\n" + rows(columns, separator, decimal), encoding="utf-8")
    with pytest.raises(InputError, match=r"table of FRFs over frequency, no record over time.*read_frfs"):
        loadid.read(path)
    model = read_frfs(path)
    np.testing.assert_allclose(model.H[:, 0, 0], H[:, 0, 0] * scale, rtol=1e-8)
    np.testing.assert_allclose(model.frequencies, F, rtol=1e-9)
    named = "1Z+" in heading or "1+Z" in heading
    assert (model.sensors[0].label, model.loads[0].label) == (("1+Z", "5+Z") if named else ("response", "reference"))


def test_headings_that_come_again_are_the_next_frf(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("frequency;real [g/N];imag;real [g/N];imag\n" + rows(PARTS, ";"))
    model = read_frfs(path, responses=["1+Z", "2+Z"], references=["5+Z"])
    np.testing.assert_allclose(model.H[:, :, 0], H[:, :, 0] * G, rtol=1e-8)


def test_names_of_a_table_that_has_none(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("Frequency [Hz],Real [g/N],Imag [g/N]\n" + rows(PARTS[:3]))
    model = read_frfs(path, responses=["1+Z"], references=["5+Z"])
    assert (model.sensors[0].label, model.loads[0].label) == ("1+Z", "5+Z")
    with pytest.raises(InputError, match="labels do not fit"):
        read_frfs(path, responses=["1+Z", "2+Z"])


@pytest.mark.parametrize(
    ("heading", "what"),
    [
        ("Frequency [Hz],Mag [g/N],Phase", "unit of the phase is not known"),
        ("Frequency [Hz],Mag [dB],Phase [deg]", "magnitudes in dB"),
        ("Frequency [Hz],Mag [g],Phase [deg]", "LID-W208.*units of response, reference"),
        ("Frequency [Hz],a,b", "headings name no FRFs"),
        ("Frequency [s],Real,Imag", "first column is no frequency"),
    ],
)
def test_tables_that_leave_something_open(tmp_path, heading, what):
    path = tmp_path / "x.csv"
    path.write_text(f"{heading}\n" + rows(POLAR))
    with pytest.raises(InputError, match=what):
        read_frfs(path)


def test_a_table_cut_at_every_byte_of_its_last_rows(tmp_path):
    path = tmp_path / "x.csv"
    text = "Frequency [Hz],Real 1+Z/5+Z [g/N],Imag 1+Z/5+Z [g/N]\n" + rows(PARTS[:3])
    whole = H[:, 0, 0] * G
    for n in range(len(text) - 120, len(text)):
        path.write_text(text[:n])
        try:
            model = read_frfs(path)
        except InputError:
            continue
        np.testing.assert_allclose(model.H[:, 0, 0], whole[: len(model.frequencies)], rtol=1e-8)


def test_a_record_with_words_like_those_of_frfs_is_still_a_record(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("time [s],real load [N],phase [rad]\n" + rows([T, X[:, 0], X[:, 1]]))
    assert loadid.read(path).labels == ("real load", "phase")


def test_mutants(tmp_path):
    """100 damaged copies of each file: nothing but an InputError leaves `read_frfs` or `read`."""
    made = [
        (read_frfs, sdynpy(tmp_path / "a.npz", 4, F, H[:, :, 0].T, [[(1, 3), (5, 3)], [(2, -1), (5, 3)]])),
        (read_frfs, mat(tmp_path / "b.mat", False, FRF=block(H[:, 0], "g/N", x="Hz", kind="FRF", name="1:+Z/5:+Z"))),
        (loadid.read, mat(tmp_path / "c.mat", False, Signal=block(X, "g", name=cell("a", "b")))),
        (loadid.read, sdynpy(tmp_path / "d.npz", 1, T, X.T, [[(1, 3)], [(2, -1)]])),
    ]
    table = tmp_path / "e.csv"
    table.write_text("Frequency [Hz],Real 1+Z/5+Z [g/N],Imag 1+Z/5+Z [g/N]\n" + rows(PARTS[:3]))
    made.append((read_frfs, table))
    for read, path in made:
        stated = {"units": {0: "N", 1: "g"}} if read is loadid.read else {"response_unit": "g", "reference_unit": "N"}
        data, place, refused = path.read_bytes(), tmp_path / f"mutant{path.suffix}", 0
        for seed in range(100):
            place.write_bytes(mutant(data, seed)[1])
            try:
                read(place, **stated)
            except InputError:
                refused += 1
        assert refused > 60, path.name


def mat73(path, tree):
    """A file as MATLAB writes it with -v7.3: groups for structs, references for cells, characters as numbers."""
    import h5py

    def put(group, name, value):
        if isinstance(value, dict):
            below = group.create_group(name)
            below.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, one in value.items():
                put(below, key, one)
        elif isinstance(value, np.ndarray) and value.dtype == object:
            refs = np.empty(value.T.shape, h5py.ref_dtype)
            for k, text in enumerate(value.ravel()):
                put(group.file["#refs#"], f"{name}{k}", text)
                refs[k, 0] = group.file["#refs#"][f"{name}{k}"].ref
            group.create_dataset(name, data=refs, dtype=h5py.ref_dtype).attrs["MATLAB_class"] = np.bytes_("cell")
        elif isinstance(value, str):
            codes = np.array([[ord(c)] for c in value], "u2")
            group.create_dataset(name, data=codes).attrs["MATLAB_class"] = np.bytes_("char")
        else:
            group.create_dataset(name, data=np.atleast_2d(value).T).attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_group("#refs#")
        for name, value in tree.items():
            put(file, name, value)
    mark = b"MATLAB 7.3 MAT-file".ljust(116) + bytes(8) + b"\x00\x02IM"
    path.write_bytes(mark + path.read_bytes()[128:])
    return path


def test_structs_of_version_73(tmp_path):
    signal = block(X, "g", factor=G, name=cell("3:Point1", "4:Point2"), primary_channel={"label": cell("P1", "P2")})
    record = loadid.read(mat73(tmp_path / "x.mat", {"Signal": signal}))
    assert (record.labels, record.units, record.dt) == (("P1", "P2"), ("g", "g"), 0.001)
    np.testing.assert_array_equal(record.values, X * G)
    with pytest.raises(InputError, match=r"holds no record.*other \(struct, cell or complex\)"):
        loadid.read(mat73(tmp_path / "y.mat", {"other": {"a": 1.0, "b": "text"}}))


def test_long_headings_cost_no_more_than_their_length(tmp_path):
    import time

    path = tmp_path / "x.csv"
    for heading in (
        "Frequency [Hz]," + "real(" * 40_000 + ",imag",
        "f,re" + " [" * 40_000 + ",im",
        "f " * 100_000 + ",re,im",
    ):
        path.write_text(f"{heading}\n" + rows(PARTS[:3]))
        begun = time.process_time()
        with pytest.raises(InputError):
            read_frfs(path)
        assert time.process_time() - begun < 2
