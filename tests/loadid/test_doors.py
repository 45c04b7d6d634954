"""What every command keeps to: examples, FRFs as models, pages that are no PDF."""

from __future__ import annotations

import numpy as np
import pytest

import loadid
import structures
from loadid._commands import demo as demonstration
from loadid.cli import main, parsers
from structures.errors import InputError


@pytest.mark.parametrize("name", ["batch", "info", "check", "demo", "identify", "compare", "calibrate", "model",
                                  "design", "convert"])  # fmt: skip
def test_the_options_of_the_examples_exist(name):
    parser = parsers()[name]
    assert (parser.epilog or "").startswith("examples:")
    assert f"    loadid {name} " in parser.epilog
    known = {option for action in parser.arguments for option in action.option_strings}
    for line in (parser.epilog or "").splitlines():
        words = line.split()
        if words[:2] == ["loadid", name]:
            assert {w for w in words if w.startswith("-")} <= known, line


@pytest.fixture(scope="module")
def frfs(tmp_path_factory):
    """FRFs of the demonstration as a text table without a unit of its own, and a log of a hit."""
    folder = tmp_path_factory.mktemp("frfs")
    model = demonstration.model()
    f = np.arange(2.0, 2500.0, 2.0)
    H = model.frf(f)[:, :, 0]
    named = ["12+Z", "13+Z", "14+Z"]
    head = ["Frequency [Hz]"] + [f"{p} {n}/31+Z [(m/s^2)/N]" for n in named for p in ("Real", "Imag")]
    columns = np.column_stack([f, *(part for k in range(3) for part in (H[:, k].real, H[:, k].imag))])
    np.savetxt(folder / "frfs.csv", columns, delimiter=",", header=",".join(head), comments="")
    record = demonstration.simulate().record
    titles = ",".join(f"{n} [m/s^2]" for n in named)
    np.savetxt(folder / "log.csv", record.values[:5000], delimiter=",", header=titles, comments="")
    return folder


def test_frfs_in_place_of_a_log_name_the_command_that_takes_them(frfs, capsys):
    assert main(["info", str(frfs / "frfs.csv")]) == 3
    said = capsys.readouterr().err
    assert "loadid model import FILE -o model.h5" in said
    assert "structures.files" not in said


def test_that_command_takes_them(frfs, capsys):
    model = frfs / "model.h5"
    assert main(["model", "import", str(frfs / "frfs.csv"), "-o", str(model)]) == 0
    words = [str(frfs / "log.csv"), "--fs", "10000", "--family", "frequency", "--signal", "transient"]
    loads = []
    for given in (model, frfs / "frfs.csv"):
        out = frfs / f"load of {given.stem}{given.suffix[1:]}.h5"
        assert main(["identify", *words, "--model", str(given), "-o", str(out)]) == 0
        loads.append(loadid.load(out).load)
    np.testing.assert_array_equal(loads[0], loads[1])
    assert np.abs(loads[0]).max() == pytest.approx(demonstration.PEAK, rel=0.25)
    capsys.readouterr()


def test_frfs_without_units_are_given_them(tmp_path, capsys):
    f = np.arange(1.0, 20.0)
    np.savetxt(tmp_path / "x.csv", np.column_stack([f, f, -f]), delimiter=",", comments="",
               header="Frequency [Hz],Real 1+Z/5+Z,Imag 1+Z/5+Z")  # fmt: skip
    words = ["model", "import", str(tmp_path / "x.csv"), "-o", str(tmp_path / "m.h5")]
    assert main(words) == 3
    assert main([*words, "--frf-kind", "accelerance", "--response-unit", "g", "--reference-unit", "N"]) == 0
    made = structures.FrfModel.load(tmp_path / "m.h5")
    np.testing.assert_allclose(made.H[:, 0, 0], 9.80665 * (f - 1j * f), rtol=1e-12)
    assert main([*words, "--length", "1"]) == 3
    capsys.readouterr()


def test_a_report_is_no_pdf(tmp_path, capsys):
    few = loadid.StaticInversion(_springs(), noise=0.1).estimate([1.0, 2.0])
    with pytest.raises(InputError, match="print the page to PDF in the browser"):
        few.report(tmp_path / "r.pdf")
    assert not list(tmp_path.iterdir())
    assert main(["identify", "log.csv", "--model", "m.h5", "-o", "r.h5", "--report", str(tmp_path / "r.pdf")]) == 3
    assert "print the page to PDF in the browser" in capsys.readouterr().err


def _springs():
    class Springs(structures.Model):
        sensors = tuple(structures.Channel(label=n, quantity="displacement", unit="m") for n in "ab")
        loads = (structures.Channel(label="F", quantity="force", unit="N"),)

        def static(self):
            return np.array([[1.0], [2.0]])

    return Springs()
