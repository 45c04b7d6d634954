"""What users hand over by mistake: every fault is one InputError with what, where and what was expected."""

import numpy as np
import pytest

from loadid import StaticInversion
from loadid.constraints import Bounds, FrictionCone, NonNegative, Resultant, Support
from loadid.settings import Noise
from loadid.validate import Known, coverage, validate
from structures import ForwardModel, InputError, MatrixModel, bases, beams, files, sensors
from structures.errors import reals

RNG = np.random.default_rng(0)
H = RNG.standard_normal((6, 4))
Y = H @ np.arange(1.0, 5.0) + 1e-3 * RNG.standard_normal(6)
SETTINGS = {"noise": Noise(1e-3, source="bench")}

NO_READINGS = {
    "text": ["a"] * 6,
    "truth values": Y > 0,
    "complex": Y * 1j,
    "mapping": {"sensor 0": 1.0},
    "set": set(Y),
    "object": object(),
    "ragged": [[1.0, 2.0], [3.0]],
    "path": "log.csv",
    "none": None,
    "inf": np.where(np.arange(6) == 2, np.inf, Y),
    "nan": np.where(np.arange(6) == 2, np.nan, Y),
    "overflow": Y * 1e300,
    "masked": np.ma.array(Y, mask=np.arange(6) == 2),
    "transposed": np.stack([Y, Y]).T,
}


@pytest.mark.parametrize("constraints", [(), (NonNegative(),)], ids=["product", "solver"])
@pytest.mark.parametrize("name", NO_READINGS)
def test_frozen_inverses_and_estimates_refuse_bad_readings(name, constraints):
    family = StaticInversion(H, choice=0.1, constraints=constraints, **SETTINGS)
    with pytest.raises(InputError):
        family.freeze()(NO_READINGS[name])
    with pytest.raises(InputError):
        family.estimate(NO_READINGS[name])


def test_frozen_inverses_take_lists_and_integers():
    frozen = StaticInversion(H, choice=0.1, **SETTINGS).freeze()
    np.testing.assert_array_equal(frozen(list(Y)), frozen(Y))
    np.testing.assert_array_equal(frozen(np.arange(6)), frozen(np.arange(6.0)))


def test_mappings_of_several_frames_must_agree():
    model = MatrixModel(H, sensors=[f"s{i}" for i in range(6)])
    found = {f"s{i}": np.ones(3) for i in range(6)}
    assert StaticInversion(model, **SETTINGS).estimate(found).load.shape == (3, 4)
    for wrong in (np.ones(2), np.ones((2, 2)), np.zeros(0)):
        with pytest.raises(InputError, match="no common number of frames"):
            StaticInversion(model, **SETTINGS).estimate(found | {"s1": wrong})
    with pytest.raises(InputError, match="s1"):
        StaticInversion(model, **SETTINGS).estimate(found | {"s1": "x"})


def test_calibration_names_the_bad_record():
    with pytest.raises(InputError, match="record 2: NaN"):
        StaticInversion(H, **SETTINGS).calibrate([Y, Y * np.nan])


@pytest.mark.parametrize("noise", ["x", True, {"s0": 1.0}, 1j, [[1.0], [1.0, 2.0]], np.nan])
def test_noise_that_is_no_number(noise):
    with pytest.raises(InputError, match="noise"):
        StaticInversion(H, noise=noise).estimate(Y)


@pytest.mark.parametrize("choice", [[1.0], np.array([0.1]), True, np.inf, np.nan, -1, 1e300, 1e-300, object()])
def test_lambda_that_is_no_number(choice):
    with pytest.raises(InputError, match="relative lambda"):
        StaticInversion(H, choice=choice, **SETTINGS)


def test_lambda_may_be_any_real_number():
    one = StaticInversion(H, choice=np.float32(0.5), **SETTINGS)
    np.testing.assert_allclose(one.freeze()(Y), one.estimate(Y).load, rtol=1e-12)


@pytest.mark.parametrize("penalty", [["a"], np.eye(4) * 1j, True, [[1.0], [1.0, 2.0]]])
def test_penalty_that_is_no_matrix(penalty):
    with pytest.raises(InputError, match="penalty"):
        StaticInversion(H, penalty=penalty, **SETTINGS)


@pytest.mark.parametrize("allow", [3, None, "E102"])
def test_allow_is_a_list(allow):
    with pytest.raises(InputError, match="list of codes"):
        StaticInversion(H, allow=allow)


@pytest.mark.parametrize("chosen", ["s0", 0, [True, False], [np.int64(99)], [0.5]])
def test_sensors_that_are_none(chosen):
    with pytest.raises(InputError, match="sensors"):
        StaticInversion(H, sensors=chosen, **SETTINGS).estimate(Y)


CONSTRAINTS = {
    "bounds text": lambda: Bounds("a"),
    "resultant text": lambda: Resultant("a", "b"),
    "covariance text": lambda: Resultant(np.ones((1, 4)), [1.0], covariance="x"),
    "friction text": lambda: FrictionCone("x", [[0, 1, 2]]),
    "normals text": lambda: FrictionCone(0.5, [[0, 1, 2]], normals=[["a", "b", "c"]]),
    "facets": lambda: FrictionCone(0.5, [[0, 1, 2]], facets=10**6),
    "facets text": lambda: FrictionCone(0.5, [[0, 1, 2]], facets="eight"),
    "facets bool": lambda: FrictionCone(0.5, [[0, 1, 2]], facets=True),
}


@pytest.mark.parametrize("name", CONSTRAINTS)
def test_constraints_that_are_no_numbers(name):
    with pytest.raises(InputError):
        CONSTRAINTS[name]()


@pytest.mark.parametrize("kind", [Support, NonNegative, lambda loads: Bounds(0.0, None, loads)])
def test_a_mask_speaks_of_every_load(kind):
    with pytest.raises(InputError, match="mask does not fit"):
        StaticInversion(H, constraints=[kind([True, False])], **SETTINGS).estimate(Y)
    mask, numbers = kind([True, False, True, False]), kind([0, 2])
    one = [StaticInversion(H, choice=0.1, constraints=[c], **SETTINGS).estimate(Y).load for c in (mask, numbers)]
    np.testing.assert_array_equal(*one)


def test_a_field_penalty_needs_places(tmp_path):
    beam = beams.cantilever(length=1.0, EI=100.0, mass_per_length=1.0, elements=6)
    from scipy.io import mmwrite

    mmwrite(str(tmp_path / "K.mtx"), beam.K.tocoo(), symmetry="symmetric")
    loaded = files.load(tmp_path / "K.mtx", dofs=[str(d) for d in beam.dofs], supports=beam.supports)
    basis = bases.nodal(loaded)
    model = ForwardModel(
        loaded, [sensors.Displacement("6+Z", noise=1e-6), sensors.Displacement("3+Z", noise=1e-6)], basis
    )
    for penalty in ("gradient", "laplacian"):
        with pytest.raises(InputError, match=r"where its loads are.*coordinates="):
            StaticInversion(model, penalty=penalty)


def test_reals():
    np.testing.assert_array_equal(reals(np.ma.array([1.0, 2.0], mask=[True, False]), where="x"), [np.nan, 2.0])
    np.testing.assert_array_equal(reals([1, "2"], where="x"), [1.0, 2.0])
    assert reals(np.inf, where="x").shape == ()


def test_frames_at_one_lambda_do_not_say_that_it_changed():
    frames = np.stack([Y, 2 * Y])
    assert "W409" in StaticInversion(H, **SETTINGS).estimate(np.stack([Y, Y[::-1]]), joint=False).codes
    assert "W409" not in StaticInversion(H, choice=0.1, **SETTINGS).estimate(frames, joint=False).codes


def test_frames_are_counted_in_words():
    text = StaticInversion(H, **SETTINGS).estimate(np.stack([Y, 2 * Y])).summary(details=True)
    assert "2 frames, 0 to 1" in text
    assert "at frame 1" in text


def test_one_sensor_that_sees_only_what_the_penalty_leaves_free():
    with pytest.raises(InputError, match="only what the penalty leaves free"):
        StaticInversion(np.ones((1, 5)), penalty="gradient", noise=1.0).estimate([1.0])


def test_known_loads_must_be_numbers(tmp_path):
    estimate = StaticInversion(H, **SETTINGS).estimate(Y)
    for truth, said in (("x", "no real numbers"), (np.full(4, np.nan), "NaN"), (np.ones(3), "does not fit")):
        with pytest.raises(InputError, match=said):
            estimate.plot(truth=truth)
        with pytest.raises(InputError, match=said):
            estimate.report(tmp_path / "r.html", truth=truth)
    assert not list(tmp_path.iterdir())


def test_limits_of_functionals_are_numbers():
    with pytest.raises(InputError, match="amplitude limit"):
        StaticInversion(H, **SETTINGS).estimate(Y).functional("sum", limit="a")


def test_a_reference_function_that_fails_is_named():
    beam = beams.cantilever(length=1.0, EI=100.0, mass_per_length=1.0, elements=6)
    model = ForwardModel(beam, [sensors.Displacement("6+Z", noise=1e-6)], bases.patches(beam, 3))
    estimate = StaticInversion(model).estimate([1e-3])
    with pytest.raises(InputError, match=r"reference function fails.*ZeroDivisionError"):
        validate(estimate, Known(lambda x: 1 / 0))
    with pytest.raises(InputError, match="no family"):
        coverage(model, np.ones(3), noise=1e-6, draws=2)


def test_what_is_determined_in_full_is_said_so():
    estimate = StaticInversion(H, penalty=None, **SETTINGS).estimate(Y)
    assert estimate.facts["peak_bias"] == 0
    assert "determined by the data" in next(f.message for f in estimate.flags if f.code == "LID-N303")
