import numpy as np
import pytest

from structures import Channel, ImpulseModel, InputError, MatrixModel, StateSpace

H = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.5]])
DT = 0.01
DECAYING = np.exp(-0.2 * np.arange(100))


def test_matrix_model_is_static_only():
    model = MatrixModel(H, sensors=["a", "b", "c"])
    assert np.array_equal(model.static(), H)
    assert [c.label for c in model.sensors] == ["a", "b", "c"]
    assert [c.label for c in model.loads] == ["u0", "u1"]
    for ask in (lambda: model.frf([1.0]), lambda: model.impulse_response(DT, 3), lambda: model.state_space(DT)):
        with pytest.raises(InputError, match="families that can run on this model: StaticInversion"):
            ask()
    assert MatrixModel([1.0, 2.0]).static().shape == (2, 1)


def test_matrix_model_keeps_its_own_read_only_copy():
    mine = H.copy()
    model = MatrixModel(mine)
    mine[0, 0] = 99
    assert model.static()[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        model.static()[0, 0] = 2.0


@pytest.mark.parametrize("bad", [[[np.nan]], [[1j]], "text", np.zeros((0, 2)), np.zeros((2, 2, 2)), 3.0, [["a"]]])
def test_a_bad_matrix_is_refused(bad):
    with pytest.raises(InputError):
        MatrixModel(bad)


def test_fingerprints_tell_models_apart():
    assert MatrixModel(H).fingerprint == MatrixModel(H.copy()).fingerprint
    assert MatrixModel(H).fingerprint != MatrixModel(H.T).fingerprint
    noisy = [Channel(label=f"y{i}", noise=0.1) for i in range(3)]
    assert MatrixModel(H, sensors=noisy).fingerprint != MatrixModel(H).fingerprint
    held, continuous = (ImpulseModel(DECAYING, DT, kind=k).fingerprint for k in ("held", "continuous"))
    assert held != continuous
    assert held != ImpulseModel(DECAYING, 2 * DT, kind="held").fingerprint


@pytest.mark.parametrize("shape", [(100,), (100, 1), (100, 1, 1)])
def test_kinds_and_shapes(shape):
    held = ImpulseModel(DECAYING.reshape(shape), DT, kind="held")
    assert np.array_equal(held.impulse_response(DT, 40)[:, 0, 0], DECAYING[:40])
    continuous = ImpulseModel(DECAYING.reshape(shape), DT, kind="continuous")
    assert np.allclose(continuous.impulse_response(DT, 40), DT * held.impulse_response(DT, 40))
    assert ImpulseModel(np.ones((5, 3, 2)), DT, "held").h.shape == (5, 3, 2)
    assert ImpulseModel(np.ones((5, 3)), DT, "held").h.shape == (5, 3, 1)


def test_the_kind_must_be_stated():
    for kind in (None, "sampled", ""):
        with pytest.raises(InputError, match=r"'held'.*'continuous'"):
            ImpulseModel(DECAYING, DT, kind=kind)


def test_more_samples_only_after_it_has_decayed():
    model = ImpulseModel(DECAYING, DT, kind="held")
    longer = model.impulse_response(DT, 150)
    assert np.array_equal(longer[:100, 0, 0], DECAYING)
    assert not np.any(longer[100:])
    short = ImpulseModel(DECAYING[:20], DT, kind="held")
    assert short.impulse_response(DT, 20).shape == (20, 1, 1)
    with pytest.raises(InputError, match=r"21 samples were asked.*last tenth up to 0\.027 .*below 0\.001"):
        short.impulse_response(DT, 21)
    with pytest.raises(InputError, match="has not decayed"):
        short.frf([1.0])


def test_one_sensor_that_rings_on_is_enough_to_refuse():
    model = ImpulseModel(np.column_stack([DECAYING, 1e-6 * np.ones(100)]), DT, kind="held")
    with pytest.raises(InputError, match="last tenth up to 1 "):
        model.impulse_response(DT, 101)


def test_frequency_response_is_that_of_the_state_space_it_came_from():
    a = np.array([[0.8, 0.3], [-0.3, 0.8]])
    system = StateSpace(a, [[1.0], [0.5]], [[1.0, 0.0], [0.3, 1.0]], [[0.2], [0.0]], DT)
    f = np.linspace(0, 50, 23)
    model = ImpulseModel(system.impulse_response(DT, 400), DT, kind="held", hold="zoh")
    assert np.allclose(model.frf(f), system.frf(f), rtol=1e-9)
    assert model.default_hold == "zoh"


def test_what_an_impulse_response_cannot_change_is_refused():
    model = ImpulseModel(DECAYING, DT, kind="held")
    for dt, hold in ((2 * DT, None), (DT, "zoh"), (np.nan, None)):
        with pytest.raises(InputError, match=r"dt=0\.01, hold='foh'"):
            model.impulse_response(dt, 5, hold)
    with pytest.raises(InputError, match="frequencies"):
        model.frf([51.0])
    with pytest.raises(InputError, match="families that can run on this model: FrequencyInversion, Deconvolution"):
        model.static()


@pytest.mark.parametrize("h", [[], [1.0, np.nan], np.zeros((2, 2, 2, 2)), 3.0, ["x"], [1j]])
def test_a_bad_impulse_response_is_refused(h):
    with pytest.raises(InputError):
        ImpulseModel(h, DT, kind="held")


def test_prediction_is_a_convolution():
    model = ImpulseModel(np.stack([DECAYING, 2 * DECAYING], axis=1), DT, kind="held")
    u = np.random.default_rng(0).standard_normal(80)
    y = model.predict(u, DT)
    assert np.allclose(y[:, 0], np.convolve(u, DECAYING)[:80])
    assert np.allclose(y[:, 1], 2 * y[:, 0])


@pytest.mark.parametrize(
    "make", [lambda: MatrixModel(np.zeros((3, 2))), lambda: ImpulseModel(np.zeros((9, 2, 1)), 0.1, kind="held")]
)
def test_a_model_in_which_nothing_moves_is_refused(make):
    with pytest.raises(InputError, match="no load moves any sensor"):
        make()


def test_one_dead_load_among_others_is_the_families_business():
    assert MatrixModel([[1.0, 0.0], [0.0, 0.0]]).static()[0, 0] == 1.0
