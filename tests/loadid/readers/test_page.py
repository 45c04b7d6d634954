"""docs/formats.md against the registry; universal, MAT and Parquet files against what was written, bit by bit."""

import numpy as np
import pytest

import loadid
from loadid._readers import formats
from structures.files import _frfs
from tests.sources import ROOT
from tests.structures.uff_made import text58

from .exports import parquet
from .files import mat

PAGE = (ROOT / "docs" / "formats.md").read_text("utf-8")


def table(title):
    """Rows of the table under a heading, as lists of cells."""
    text = PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    rows = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row] for row in rows[2:]]


def test_every_format_has_a_row():
    rows = {row[0]: row for row in table("Logs")}
    assert set(rows) == {f.name for f in formats()}
    for form in formats():
        suffixes, reader = rows[form.name][1], rows[form.name][2]
        assert set(suffixes.split()) == set(form.suffixes), form.name
        assert ("child" in reader) == form.native, form.name
        assert len(rows[form.name]) == 8, form.name
        assert not form.library or form.library in reader.lower(), form.name


def test_the_readme_and_the_docstring_name_every_format():
    readme = (ROOT / "README.md").read_text("utf-8")
    words = {"LabVIEW LVM": "LVM", "MAT 7.3": "MAT", "ROS 1 bag": "ROS", "ROS 2 bag": "ROS"}
    for form in formats():
        word = words.get(form.name, form.name)
        assert word in loadid.read.__doc__, form.name
        assert word in readme, form.name


def test_frfs_are_read_from_the_suffixes_of_the_page():
    said = {suffix for row in table("FRFs") for suffix in row[1].split() if suffix.startswith(".")}
    assert said == {*_frfs.SUFFIXES, ".mat", ".npz", *_frfs.TEXT}


# -- round trips -------------------------------------------------------------------------------------------------------
def awkward(count=64):
    """Doubles of all sizes, subnormal ones and both zeros among them."""
    rng = np.random.default_rng(11)
    values = rng.standard_normal((count, 2)) * 10.0 ** rng.integers(-300, 300, (count, 2))
    values[:4, 0] = 5e-324, -0.0, np.nextafter(1, 2), 1e308
    return values


@pytest.mark.parametrize("compressed", [True, False])
def test_mat_files_come_back_bit_by_bit(tmp_path, compressed):
    values = awkward()
    path = tmp_path / "x.mat"
    path.write_bytes(mat(compressed, log=values, fs=51200.0, channels=["a", "b"], units=["N", "m/s^2"]))
    record = loadid.read(path)
    assert record.values.tobytes() == values.tobytes()
    assert record.dt == 1 / 51200


def test_parquet_files_come_back_bit_by_bit(tmp_path):
    pa = pytest.importorskip("pyarrow")
    values, dt = awkward(), 1 / 51200
    fields = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    fields += [pa.field(n, pa.float64(), metadata={"unit": u}) for n, u in (("a", "N"), ("b", "m/s^2"))]
    about = {"dt": repr(dt), "name": "run 3"}
    columns = [np.arange(len(values)) * dt, *values.T]
    record = loadid.read(parquet(tmp_path / "x.parquet", pa.table(columns, schema=pa.schema(fields, metadata=about))))
    assert record.values.tobytes() == values.tobytes()
    assert (record.dt, record.name, record.labels) == (dt, "run 3", ("a", "b"))
    columns[0] = columns[0] * 1.001  # a step that the column contradicts is not that of the file
    record = loadid.read(parquet(tmp_path / "y.parquet", pa.table(columns, schema=pa.schema(fields, metadata=about))))
    assert record.dt == pytest.approx(dt * 1.001, rel=1e-9)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # pyuff leaves files open
def test_universal_files_of_pyuff_come_back_bit_by_bit(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    values = awkward()
    path = tmp_path / "x.uff"
    file = pyuff.UFF(str(path))
    for k, (kind, unit) in enumerate([(13, "N"), (12, "m/s^2")]):
        file._write_set(
            {
                "type": 58, "binary": 1, "func_type": 1, "rsp_node": k + 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0,
                "data": values[:, k], "x": np.arange(len(values)) / 1024, "id1": "log", "rsp_ent_name": "NONE",
                "ref_ent_name": "NONE", "abscissa_spacing": 1, "abscissa_spec_data_type": 17, "abscissa_units_lab": "s",
                "ordinate_spec_data_type": kind, "orddenom_spec_data_type": 0, "z_axis_axis_lab": "NONE",
                "ordinate_axis_units_lab": unit, "ordinate_units_lab": unit,
            },
            "add",
        )  # fmt: skip
    record = loadid.read(path, units={"1+Z": "N", "2+Z": "m/s^2"})
    assert record.values.tobytes() == values.tobytes()
    assert record.dt == 1 / 1024


def test_a_commercial_export_without_units_is_asked_per_channel_and_its_frfs_are_said(tmp_path):
    """NONE for every unit, no data set 164, FRFs beside the time responses, as analysers export a whole run."""
    time = {"function": 1, "step": 0.001, "abscissa": ("time", "s"), "denominator": (0, "NONE")}
    x = np.round(awkward(16) / np.abs(awkward(16)).max(), 6)
    sets = text58(x[:, 0], response=("NONE", 1, 3), ordinate=(13, "NONE"), **time)
    sets += text58(x[:, 1], response=("NONE", 2, -1), ordinate=(12, "NONE"), **time)
    sets += text58(x[:, 0] + 1j * x[:, 1], response=("NONE", 2, -1), reference=("NONE", 1, 3), ordinate=(12, "NONE"))
    path = tmp_path / "x.unv"
    path.write_bytes(sets)
    with pytest.raises(loadid._readers.source.NotStated) as caught:
        loadid.read(path)
    assert 'units={"1+Z": "UNIT", "2-X": "UNIT"}' in str(caught.value)
    assert "--unit 1+Z=UNIT --unit 2-X=UNIT" in caught.value.command
    record = loadid.read(path, units={"1+Z": "N", "2-X": "g"})
    assert any("passed over: FRF 2-X" in note for note in record.notes)
