"""Loads of one set of sensors held against others: blocked forces on a second assembly, coverage, guards, bad input."""

from types import SimpleNamespace

import numpy as np
import pytest

from loadid import Deconvolution, Record
from loadid.sources import split, validate_on
from structures import Channel, CrossSpectra, ForwardModel, FrfModel, InputError, MeasuredModel, chains, loads, sensors
from tests.loadid import sourced
from tests.loadid.sourced import LINES, densities, estimated, solved, table

SOURCE = (np.diag([0.8, 0.4]), sourced.stiffness([3e4]))  # mass 0 is driven inside, mass 1 is the interface


def assembled(masses, springs, ground):
    """A source on a receiver: FRFs from the force inside the source and from one at the interface, to the receiver."""
    M = np.zeros((len(masses) + 1,) * 2)
    K = np.zeros_like(M)
    M[:2, :2] += SOURCE[0]
    K[:2, :2] += SOURCE[1]
    M[1:, 1:] += np.diag(masses)
    K[1:, 1:] += sourced.stiffness(springs, ground)
    H = sourced.accelerance(LINES, M, K)
    return H[:, 1:, 0], H[:, 1:, 1]


def blocked(internal):
    """Force at the interface of the source when it is held there, by the matrices of the source alone."""
    w2 = (2 * np.pi * LINES) ** 2
    Z = (1 + 0.03j) * SOURCE[1] - w2[:, None, None] * SOURCE[0]
    return -Z[:, 1, 0] / Z[:, 0, 0] * internal


TEST = ((1.0, 1.5, 0.7, 0.5), (6e4, 9e4, 7e4), 5e4)
USE = ((2.0, 0.6, 1.0), (2e4, 8e4), 2e5)


class TestBlockedForce:
    internal = sourced.spectra(len(LINES), 1)[:, 0]

    def identified(self):
        """From three receiver accelerations of the test assembly, by FRFs from its interface."""
        inside, interface = assembled(*TEST)
        y = inside[:, 1:] * self.internal[:, None]
        h = interface[:, 1:, None]
        force = np.sum(h[..., 0].conj() * y, axis=1) / np.sum(np.abs(h[..., 0]) ** 2, axis=1)
        return estimated(force[:, None], 1e-6, labels=["interface"], sensors=["t1", "t2", "t3"],
                         sensor_units=["m/s^2"] * 3, response=y, residual=y - h[..., 0] * force[:, None])  # fmt: skip

    def test_the_identified_force_is_the_blocked_force(self):
        np.testing.assert_allclose(self.identified().load[:, 0], blocked(self.internal), rtol=1e-9)

    def test_it_predicts_the_source_on_another_receiver(self):
        inside, interface = assembled(*USE)
        model = table(interface[..., None], loads=["interface"], sensors=["b0", "b1", "b2"])
        made = validate_on(self.identified(), model, inside * self.internal[:, None], source="the second assembly")
        np.testing.assert_allclose(made.comparison.correlation, 1, rtol=1e-9)
        np.testing.assert_allclose(made.comparison.overall, 0, atol=1e-9)
        np.testing.assert_allclose(made.comparison.bands(3).error, 0, atol=1e-6)
        assert made.inside == (1.0, 1.0, 1.0)
        assert made.flags == ()
        assert "the second assembly" in str(made)

    def test_a_contact_force_does_not_carry_over(self):
        inside, _ = assembled(*TEST)
        # what acts between source and receiver in the test assembly: by the receiver alone
        alone = sourced.accelerance(LINES, np.diag(TEST[0]), sourced.stiffness(*TEST[1:]))[:, :, 0]
        contact = inside[:, 0] * self.internal / alone[:, 0]
        model = table(assembled(*USE)[1][..., None], loads=["interface"], sensors=["b0", "b1", "b2"])
        wrong = estimated(contact[:, None], 1e-6, labels=["interface"])
        made = validate_on(wrong, model, assembled(*USE)[0] * self.internal[:, None])
        assert np.abs(made.comparison.rms_lines).min() > 3
        assert max(made.inside) < 0.05
        assert not made.validation.agrees

    def test_a_wrong_gain_shows_in_db(self):
        model = table(2 * assembled(*USE)[1][..., None], loads=["interface"], sensors=["b0", "b1", "b2"])
        made = validate_on(self.identified(), model, assembled(*USE)[0] * self.internal[:, None])
        np.testing.assert_allclose(made.comparison.overall, 6.0206, atol=1e-3)
        np.testing.assert_allclose(made.comparison.correlation, 1, rtol=1e-9)


# -- coverage ---------------------------------------------------------------------------------------------------------
H = sourced.receiver(sensors=(0, 1, 2, 3, 5))


def measured(seed, noise, G=H):
    F = sourced.spectra(len(LINES), 2, seed=seed) * [3.0, 1.0]
    y = np.einsum("lij,lj->li", G, F)
    return F, y + noise * sourced.spectra(len(LINES), G.shape[1], seed=seed + 1000)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_the_band_holds_what_it_says(scale):
    parted = split(table(scale * H), ["a1", "a4"])
    noise = 0.05 * scale * np.sqrt(np.mean(np.abs(measured(0, 0)[1]) ** 2, axis=0))
    held = []
    for seed in range(6):
        one, two = parted.columns(scale * measured(seed, noise / scale)[1])
        F, std, C = solved(parted.training.frf(LINES), one, parted.columns(noise)[0])
        made = validate_on(
            estimated(F, std, covariance=C), parted.validation, two, noise=parted.columns(noise)[1], level=0.9
        )
        held.append(made.inside)
    # 6 x 192 lines at 90 %: 3 standard deviations are 2.7 %
    np.testing.assert_allclose(np.mean(held, axis=0), 0.9, atol=0.027)
    assert made.validation.sensors[0].noise_ratio is not None


def test_errors_of_the_frfs_widen_the_band():
    spread = 0.1 * np.abs(H)
    wrong = H + spread * (
        np.random.default_rng(9).standard_normal(H.shape) + 1j * np.random.default_rng(10).standard_normal(H.shape)
    ) / np.sqrt(2)
    F, y = measured(3, 0)
    e = estimated(F, 1e-6)
    blind = validate_on(e, table(wrong), y)
    told = validate_on(e, table(wrong, variance=spread**2), y)
    assert max(blind.inside) < 0.01
    np.testing.assert_allclose(told.inside, 0.95, atol=0.05)


# -- cross spectra, lines, channels -----------------------------------------------------------------------------------
def test_cross_spectra_are_compared_by_their_autospectra():
    rng = np.random.default_rng(11)
    S = np.einsum("ljk,lik->lji", A := sourced.spectra(len(LINES), 4).reshape(-1, 2, 2), A.conj())
    Syy = np.einsum("lij,ljk,lmk->lim", H, S, H.conj())
    channels = [Channel(label=f"a{i}", quantity="acceleration", unit="m/s^2") for i in range(5)]
    exact = validate_on(densities(S), table(H), CrossSpectra(LINES, Syy, channels, averages=np.inf))
    np.testing.assert_allclose(exact.comparison.lines, 0, atol=1e-9)
    assert exact.comparison.correlation is None
    n = 50
    draws = np.linalg.cholesky(S)[None] @ sourced.spectra(n * len(LINES), 2, seed=12).reshape(n, -1, 2, 1)
    y = np.einsum("lij,dlj->dli", H, draws[..., 0])
    estimate = np.einsum("dli,dlm->lim", y, y.conj()) / n
    order = rng.permutation(5)
    found = CrossSpectra(LINES, estimate[:, order][:, :, order], [channels[i] for i in order], averages=n)
    made = validate_on(densities(S), table(H), found)
    np.testing.assert_allclose(made.inside, 0.95, atol=0.05)
    np.testing.assert_allclose(made.comparison.overall, 0, atol=0.5)


def test_lines_in_common_are_compared_and_the_others_counted():
    F, y = measured(5, 0)
    channels = [Channel(label=f"a{i}", quantity="acceleration", unit="m/s^2") for i in (3, 0, 4, 2, 1)]
    other = np.concatenate([[1.0], LINES[20:100], [300.0]])
    values = np.concatenate([np.ones((1, 5)), y[20:100][:, [3, 0, 4, 2, 1]], np.ones((1, 5))])
    data = SimpleNamespace(frequencies=other, values=values, channels=channels, noise=np.full(5, 1e-9))
    made = validate_on(estimated(F, 1e-9), table(H), data)
    assert len(made.comparison.axis.values) == 80
    assert made.left_out == len(LINES) - 80
    np.testing.assert_allclose(made.comparison.lines, 0, atol=1e-6)
    std = np.full(F.shape, 1e-9)
    std[::2, 1] = 1e3
    few = validate_on(estimated(F, std), table(H), data, trust=0.1)
    np.testing.assert_array_equal(few.comparison.axis.values, LINES[21:100:2])
    assert few.left_out == len(LINES) - 40


def test_what_was_used_is_flagged():
    F, y = measured(6, 0.1)
    e = estimated(F, 0.1, sensors=["a0", "a1"], sensor_units=["m/s^2"] * 2, response=y[:, :2], residual=0 * y[:, :2])
    parted = split(table(H), ["a1", "a4"])
    made = validate_on(e, parted.validation, parted.columns(y)[1])
    assert {f.code for f in made.flags} == {"LID-W704"}
    assert "a1" in str(made.flags[0])
    clean = split(table(H), ["a3", "a4"])
    assert validate_on(e, clean.validation, clean.columns(y)[1]).flags == ()
    # the same numbers under another name
    renamed = table(H[:, [1, 4]], sensors=["x", "y"])
    assert {f.code for f in validate_on(e, renamed, y[:, [1, 4]]).flags} == {"LID-W704"}
    kept = e.validated(made.validation)
    assert "W704" in kept.codes
    assert kept.validation.level == "held-out sensors"


# -- over time --------------------------------------------------------------------------------------------------------
def test_histories_are_validated_through_held_out_channels():
    body = chains.chain(masses=[1.0, 1.0, 0.5], springs=[4e4, 3e4, 2e4], dashpots=20.0)
    model = ForwardModel(body, [sensors.Accelerometer(f"{n}+X") for n in (1, 2, 3)], [loads.Point("2+X")])
    dt, n = 2e-3, 200
    g = np.exp(-(((np.arange(n) - 60) / 10.0) ** 2))[:, None] * 50
    y = model.predict(g, dt)
    noise = 0.01 * y.std(axis=0)
    y = y + noise * np.random.default_rng(0).standard_normal(y.shape)
    channels = [Channel(label=s.label, quantity=s.quantity, unit=s.unit, noise=x) for s, x in
                zip(model.sensors, noise, strict=True)]  # fmt: skip
    record = Record(y, dt, channels)
    parted = split(model, ["1+X"])
    estimate = Deconvolution(parted.training, noise=noise[1:]).estimate(record.select(list(parted.labels[0])))
    made = validate_on(estimate, parted.validation, record, noise=noise[:1])
    assert made.comparison.correlation[0] > 0.999
    assert abs(made.comparison.overall[0]) < 0.1
    assert made.comparison.running(0.05).rms_error[0] < 0.3
    assert made.comparison.std.shape == (8, 1)
    assert made.inside[0] >= 6 / 8
    assert made.validation.agrees
    assert "TRAC" in made.table()


# -- parting the sensors ----------------------------------------------------------------------------------------------
def test_both_sides_answer_as_the_whole():
    frequencies = np.linspace(0, 500, 201)
    h = np.random.default_rng(0).standard_normal((201, 3, 2)) + 0j
    names = [Channel(label=n) for n in "abc"]
    forces = [Channel(label=n, quantity="force", unit="N") for n in "pq"]
    body = chains.chain(masses=[1.0, 1.0, 0.5], springs=[4e4, 3e4, 2e4], dashpots=20.0)
    models = {
        MeasuredModel: MeasuredModel(frequencies, h, sensors=names, loads=forces, variance=np.abs(h)),
        FrfModel: FrfModel(frequencies[3:], h[3:], sensors=names, loads=forces, variance=np.abs(h[3:])),
        ForwardModel: ForwardModel(body, [sensors.Displacement(f"{n}+X") for n in (1, 2, 3)], [loads.Point("2+X")]),
    }
    for kind, model in models.items():
        parted = split(model, [1])
        f = [10.0, 20.0]
        np.testing.assert_array_equal(parted.training.frf(f), model.frf(f)[:, [0, 2]])
        np.testing.assert_array_equal(parted.validation.frf(f), model.frf(f)[:, [1]])
        assert parted.labels == ((model.sensors[0].label, model.sensors[2].label), (model.sensors[1].label,))
        assert parted.training.loads == model.loads
        assert len({parted.training.fingerprint, parted.validation.fingerprint, model.fingerprint}) == 3
        if kind is ForwardModel:
            one = parted.validation
            np.testing.assert_array_equal(one.static(), model.static()[[1]])
            np.testing.assert_array_equal(one.impulse_response(1e-3, 9), model.impulse_response(1e-3, 9)[:, [1]])
            np.testing.assert_allclose(
                one.state_space(1e-3).impulse_response(1e-3, 9), model.impulse_response(1e-3, 9)[:, [1]], rtol=1e-9
            )
            stiffer = one.perturbed("stiffness", 2.0)
            np.testing.assert_allclose(stiffer.static(), one.static() / 2, rtol=1e-9)
            assert one.frf_variance([1.0]) is None
        else:
            assert type(parted.training) is kind
            np.testing.assert_array_equal(parted.training.frf_variance(f), model.frf_variance(f)[:, [0, 2]])


@pytest.mark.parametrize("asked", [["a9"], ["a0", "a0"], [0, 1, 2, 3, 4], []])
def test_sensors_that_cannot_be_parted(asked):
    with pytest.raises(InputError):
        split(table(H), asked)
    with pytest.raises(InputError, match="not those of the model"):
        split(table(H), ["a0"]).columns(np.ones((7, 4)))


# -- bad input --------------------------------------------------------------------------------------------------------
SPEEDS = [Channel(label=f"a{i}", quantity="velocity", unit="m/s") for i in range(5)]


def spectral(values, channels=None, f=LINES):
    return SimpleNamespace(frequencies=f, values=values, channels=channels or ())


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (np.ones((5, 5)), "do not fit"),
        (np.full((len(LINES), 5), np.nan), "do not fit"),
        (Record(np.ones((9, 5)), 1.0, list("abcde")), "spectra are compared"),
        (spectral(np.ones((len(LINES), 5)), f=LINES + 0.25), "no line in common"),
        (spectral(np.ones((len(LINES), 2)), list("ab")), "was not measured"),
        (spectral(np.ones((len(LINES), 5)), SPEEDS), "unit of a channel"),
        (CrossSpectra(LINES, np.tile(np.eye(5), (len(LINES), 1, 1)), [f"a{i}" for i in range(5)], 9), "amplitudes"),
        (np.zeros((len(LINES), 5)), "zeros"),
    ],
)
def test_data_that_do_not_fit_are_refused(data, match):
    with pytest.raises(InputError, match=match):
        validate_on(estimated(measured(0, 0)[0]), table(H), data)


def test_settings_that_make_no_sense_are_refused():
    F, y = measured(0, 0)
    e = estimated(F, 1e3)
    wrong = [({"level": 1.0}, "probability"), ({"trust": 0.1}, "no line is left")]
    wrong += [({"noise": n}, "noise std") for n in ([1, 2], -1, np.nan)]
    for settings, match in wrong:
        with pytest.raises(InputError, match=match):
            validate_on(e, table(H), y, **settings)
    with pytest.raises(InputError, match="densities are real"):
        validate_on(densities(np.tile(np.eye(2) + 0j, (len(LINES), 1, 1))), table(H), y)
