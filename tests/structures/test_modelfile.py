"""Forward models as files: the same numbers, the same fingerprint, and what is refused."""

import numpy as np
import pytest

from structures import ForwardModel, MatrixModel, StateSpace, Structure, bases, beams, damping, loads, sensors
from structures.errors import InputError
from structures.files import _modelfile as modelfile
from structures.files import _storage as storage


def mast(**settings):
    beam = beams.cantilever(length=12.0, EI=4e6, mass_per_length=60.0, elements=12, damping=damping.Modal([0.02, 0.01]))
    rows = [
        sensors.Accelerometer("12+Z", noise=0.01), sensors.Velocity(at=4.3, label="v"), sensors.Displacement("6-Z"),
        sensors.StrainGauge(at=0.5, fibre=0.1, highpass=0.3),
    ]  # fmt: skip
    return ForwardModel(beam, rows, [loads.Point("12+Z", label="wind"), loads.Point(at=3.3)], **settings)


def through(model, tmp_path):
    model.save(tmp_path / "model.h5")
    return modelfile.load(tmp_path / "model.h5")


@pytest.mark.parametrize("settings", [{"modes": 5}, {"band": 30.0, "residual": False}])
def test_the_model_of_the_file_is_the_model(tmp_path, settings):
    model = mast(**settings)
    model.verify(np.ones((50, 2)), model.predict(np.ones((50, 2)), 0.01), 0.01)
    found = through(model, tmp_path)
    assert found.fingerprint == model.fingerprint
    assert found.sensors != model.sensors  # rows, no places
    assert [(s.label, s.unit, s.noise, s.highpass) for s in found.sensors] == [
        (s.label, s.unit, s.noise, s.highpass) for s in model.sensors
    ]
    assert found.certificate == model.certificate
    assert found.flags == model.flags
    f = np.linspace(0.5, 40, 7)
    assert np.array_equal(found.frf(f), model.frf(f))
    assert np.array_equal(found.static(), model.static())
    for a, b in zip("ABCD", "ABCD", strict=True):
        assert np.array_equal(getattr(found.state_space(0.01), a), getattr(model.state_space(0.01), b))
    stiff = found.perturbed("stiffness", 1.21)
    assert stiff.natural_frequencies == pytest.approx(1.1 * model.natural_frequencies, rel=1e-9)


def test_bases_own_matrices_and_every_damping(tmp_path):
    beam = beams.simply_supported(
        length=6.0, EI=2e6, mass_per_length=40.0, elements=8, damping=damping.Rayleigh(0.1, 1e-4)
    )
    model = ForwardModel(beam, [sensors.Displacement("4+Z")], bases.patches(beam, 5))
    found = through(model, tmp_path)
    assert found.fingerprint == model.fingerprint
    assert [c.measure for c in found.loads] == [c.measure for c in model.loads]
    assert np.array_equal(found.static(), model.static())
    K = np.array([[2.0, -1.0], [-1.0, 1.0]])
    own = Structure.from_matrices(K, np.eye(2), 0.01 * K, damping=damping.Structural(0.03))
    free = ForwardModel(own, [sensors.Displacement("0+S")], [loads.Point("1+S")])
    assert through(free, tmp_path).structure.digest == own.digest


def test_terms_of_a_structure_stay_its_parameters(tmp_path):
    beam = beams.simply_supported(length=6.0, EI=2e4, mass_per_length=40.0, tension=5e3, elements=8)
    model = ForwardModel(beam, [sensors.Displacement("4+Z")], [loads.Point("3+Z")])
    found = through(model, tmp_path)
    assert "tension" in found.structure.terms
    assert np.allclose(found.perturbed("tension", 2.0).static(), model.perturbed("tension", 2.0).static(), rtol=1e-12)


def test_a_state_space_is_kept_as_it_is(tmp_path):
    space = mast(modes=3).state_space(0.01)
    space.save(tmp_path / "space.h5")
    found = modelfile.load(tmp_path / "space.h5")
    assert isinstance(found, StateSpace)
    assert found.fingerprint == space.fingerprint
    assert found.hold == space.hold


def test_what_cannot_be_kept_or_read_is_refused(tmp_path):
    beam = beams.simply_supported(length=6.0, EI=2e6, mass_per_length=40.0, elements=8)
    moving = loads.MovingPoint(np.linspace(0, 6, 50), direction="-Z")
    with pytest.raises(InputError, match="moves"):
        modelfile.save(ForwardModel(beam, [sensors.Displacement("4+Z")], [moving]), tmp_path / "x.h5")
    with pytest.raises(InputError, match="no forward model"):
        modelfile.save(beam, tmp_path / "x.h5")
    with pytest.raises(InputError, match="MatrixModel is not kept"):
        modelfile.save(MatrixModel(np.eye(2)), tmp_path / "x.h5")
    assert not (tmp_path / "x.h5").exists()
    found = through(mast(modes=3), tmp_path)
    path = tmp_path / "model.h5"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="damaged"):
        modelfile.load(path)
    tree = {"sensors": []}
    storage.write(path, tree, modelfile.KIND)
    with pytest.raises(InputError, match="release"):
        modelfile.load(path)
    storage.write(path, tree, "load estimate")
    with pytest.raises(InputError, match="another kind"):
        modelfile.load(path)
    other = Structure.from_matrices(2 * np.eye(2))
    with pytest.raises(InputError, match="another structure"):
        found.sensors[0].row(other)


def test_indices_outside_of_a_matrix_are_refused(tmp_path):
    modelfile.save(mast(modes=3), tmp_path / "m.h5")
    tree = storage.read(tmp_path / "m.h5", modelfile.KIND)
    tree["matrices"]["K"]["indices"] = tree["matrices"]["K"]["indices"] + 10_000
    storage.write(tmp_path / "m.h5", tree, modelfile.KIND)
    with pytest.raises(InputError, match="release"):
        modelfile.load(tmp_path / "m.h5")
