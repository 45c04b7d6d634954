"""Deconvolution: exactness, invariances, offsets, refusals."""

from functools import cache

import numpy as np
import pytest

from loadid import Deconvolution, Lambda, Noise, Penalty, Record
from loadid._spellings import folded
from structures import (
    Channel,
    ForwardModel,
    ImpulseModel,
    InputError,
    MeasuredModel,
    NotIdentifiable,
    StateSpace,
    beams,
    damping,
    loads,
    sensors,
)

DT = 1 / 5000


def make_model(places=(0.3, 0.8, 1.4), at=(0.65,), zeta=0.03, kind=sensors.Accelerometer, **settings):
    structure = beams.simply_supported(
        length=2.0,
        section=beams.Section.rectangle(0.05, 0.01),
        material=beams.materials.steel,
        elements=20,
        damping=damping.Modal(zeta),
    )
    observed = [kind(at=x, direction="Z", label=f"s{i}") for i, x in enumerate(places)]
    applied = [loads.Point(at=x, direction="Z", label=f"p{i}") for i, x in enumerate(at)]
    return ForwardModel(structure, observed, applied, **{"modes": 8, **settings})


def pulse(samples=300, start=40, width=20, height=100.0):
    k = np.arange(samples)
    return np.where((k >= start) & (k <= start + width), height * np.sin(np.pi * (k - start) / width), 0.0)[:, None]


def noisy(y, level, seed=0):
    e = np.random.default_rng(seed).standard_normal(y.shape)
    return y + level * np.sqrt(np.mean(y**2, axis=0)) * e


def test_rebuilds_an_impact():
    model = make_model()
    g = pulse()
    estimate = Deconvolution(model).estimate(noisy(model.predict(g, DT), 0.01), dt=DT)
    assert estimate.load.shape == g.shape
    assert np.linalg.norm(estimate.load - g) < 0.05 * np.linalg.norm(g)
    assert estimate.peaks[0].value == pytest.approx(100, rel=0.03)


def test_equals_augmented_least_squares():
    """At a given relative lambda the answer is the minimiser of |Hg - y|^2 + lambda^2 |Lg|^2."""
    model, g = make_model(at=(0.65, 1.2)), np.hstack([pulse(80, 10, 12), pulse(80, 30, 9, -40.0)])
    y = noisy(model.predict(g, DT), 0.02)
    estimate = Deconvolution(model, choice=1e-2, noise=[1.0, 2.0, 3.0], penalty="first_difference").estimate(y, dt=DT)
    h = model.impulse_response(DT, 80) / np.array([1.0, 2.0, 3.0])[:, None]
    H = np.zeros((80, 3, 80, 2))
    for t in range(80):
        for u in range(t + 1):
            H[t, :, u] = h[t - u]
    L = np.kron(np.diff(np.eye(80), axis=0), np.eye(2))
    lam = estimate.choice.lam * estimate.choice.scale
    A = np.vstack([H.reshape(240, 160), lam * L])
    b = np.concatenate([(y / [1.0, 2.0, 3.0]).ravel(), np.zeros(len(L))])
    expected = np.linalg.lstsq(A, b, rcond=None)[0].reshape(80, 2)
    assert np.linalg.norm(estimate.load - expected) < 1e-8 * np.linalg.norm(expected)


@pytest.fixture(scope="module")
def unscaled():
    """Load of one record by path and choice, which records in other units are held against."""

    @cache
    def load(samples: int, path: str, choice: str | float | None):
        return scaled(1.0, samples, path, choice)

    return load


def scaled(factor: float, samples: int, path: str, choice: str | float | None):
    """Load behind a response in units that make both, model and data, so many times as large."""
    h = make_model(zeta=0.05).impulse_response(DT, samples)
    y = noisy(ImpulseModel(h, DT, kind="held").predict(pulse(samples), DT), 0.02)
    solve = Deconvolution(ImpulseModel(factor * h, DT, kind="held"), choice=Lambda(choice, path=path))
    return solve.estimate(factor * y, dt=DT).load


WAYS = [(200, "auto"), (400, "toeplitz"), (400, "fft")]


@pytest.mark.parametrize("factor", [1e-6, 1e6])
@pytest.mark.parametrize(
    ("samples", "path", "choice"),
    [(*way, choice) for way in WAYS for choice in (None, "gcv", "l_curve", 1e-3)] + [(3000, "auto", 1e-3)],
)
def test_scale_invariance(factor, samples, path, choice, unscaled):
    """The load does not change when model and data are multiplied by a constant, whichever path it takes."""
    one = unscaled(samples, path, choice)
    assert np.linalg.norm(scaled(factor, samples, path, choice) - one) < 1e-9 * np.linalg.norm(one)


def test_superposition():
    model = make_model()
    a, b = (noisy(model.predict(pulse(start=s), DT), 0.01, s) for s in (40, 90))
    solve = Deconvolution(model, choice=1e-2, noise=1.0)
    total = solve.estimate(a + b, dt=DT).load
    assert total == pytest.approx(
        solve.estimate(a, dt=DT).load + solve.estimate(b, dt=DT).load, abs=1e-9 * np.abs(total).max()
    )


def test_dense_and_fft_path_agree_on_a_decayed_record():
    model, g = make_model(zeta=0.05), pulse(1500)
    h = model.impulse_response(DT, 3000)
    long = np.vstack([g, np.zeros((1500, 1))])
    y = noisy(ImpulseModel(h, DT, kind="held").predict(long, DT), 0.01)
    dense = Deconvolution(ImpulseModel(h[:1500], DT, kind="held"), choice=1e-3, noise=1.0).estimate(y[:1500], dt=DT)
    fft = Deconvolution(ImpulseModel(h, DT, kind="held"), choice=Lambda(1e-3, path="fft"), noise=1.0).estimate(y, dt=DT)
    assert dense.facts["path"] == "dense SVD"
    assert fft.facts["path"] == "zero-padded FFT"
    # both are regularised by nearly the same absolute lambda
    assert fft.choice.scale == pytest.approx(dense.choice.scale, rel=0.05)
    assert np.linalg.norm(fft.load[:1200] - dense.load[:1200]) < 0.02 * np.linalg.norm(dense.load)


def test_several_loads_are_told_apart():
    model = make_model(places=(0.2, 0.5, 0.9, 1.3, 1.7), at=(0.65, 1.3))
    g = np.hstack([pulse(300, 40), pulse(300, 120, 30, -60.0)])
    estimate = Deconvolution(model).estimate(noisy(model.predict(g, DT), 0.005), dt=DT)
    assert np.linalg.norm(estimate.load - g) < 0.1 * np.linalg.norm(g)


class TestIndexOffset:
    """A zero-order hold gives displacement h[0] = 0: the data are advanced, and the load stays where it acted."""

    @pytest.mark.parametrize("where", [0, 100, 197])
    def test_one_sample_load(self, where):
        model = make_model(kind=sensors.Displacement, residual=False)
        h = model.impulse_response(DT, 200, hold="zoh")
        assert np.abs(h[0]).max() < 1e-12 * np.abs(h).max()
        g = np.zeros((200, 1))
        g[where] = 100.0
        y = model.predict(g, DT, hold="zoh")
        estimate = Deconvolution(model, hold="zoh", choice=1e-9, noise=1e-12).estimate(y, dt=DT)
        assert len(estimate.load) == 199
        assert int(np.argmax(np.abs(estimate.load))) == where

    def test_first_order_hold_needs_none(self):
        model = make_model(kind=sensors.Displacement)
        assert len(Deconvolution(model).estimate(noisy(model.predict(pulse(), DT), 0.01), dt=DT).load) == 300

    def test_no_shift_helps(self):
        h = np.zeros(100)
        h[70:] = 1.0
        with pytest.raises(InputError, match=r"LID-E506.*no usable diagonal"):
            Deconvolution(ImpulseModel(h, DT, kind="held")).estimate(np.ones(100), dt=DT)

    def test_loads_that_arrive_at_different_times(self):
        """Only what no load needs is dropped: a load that arrives earlier keeps its first samples."""
        n = np.arange(200)
        decay = np.exp(-n / 10) * np.cos(n / 3)
        h = np.zeros((200, 2, 2))
        h[2:, 0, 0] = decay[:-2]
        h[5:, 1, 1] = decay[:-5]
        h[:, 1, 0] = 0.2 * h[:, 1, 1]
        g = np.hstack([pulse(200, 40, 30), pulse(200, 90, 50)])
        model = ImpulseModel(h, DT, kind="held")
        estimate = Deconvolution(model, noise=Noise(1e-3, source="data sheet")).estimate(
            model.predict(g, DT) + 1e-3 * np.random.default_rng(0).standard_normal((200, 2)), dt=DT
        )
        assert len(estimate.load) == 198
        for j in range(2):
            assert np.linalg.norm(estimate.load[:, j] - g[:198, j]) < 0.01 * np.linalg.norm(g[:, j])

    def test_a_load_that_no_sensor_sees(self):
        h = np.zeros((50, 1, 2))
        h[:, 0, 0] = 0.5 ** np.arange(50)
        with pytest.raises(InputError, match="LID-E506"):
            Deconvolution(ImpulseModel(h, DT, kind="held")).estimate(np.ones(50), dt=DT)

    def test_allowed(self):
        h = np.concatenate([[0.0], 0.5 ** np.arange(1, 100)])
        model = ImpulseModel(h, DT, kind="held")
        assert len(Deconvolution(model).estimate(np.ones(100), dt=DT).load) == 99
        allowed = Deconvolution(model, allow=["E506"]).estimate(np.ones(100), dt=DT)
        assert len(allowed.load) == 100
        assert allowed.allowed == ("LID-E506",)
        assert "E506" in allowed.codes
        assert "E506" in allowed.summary()


class TestRefusals:
    def test_least_squares_without_enough_sensors(self):
        model = make_model(places=(0.3,), at=(0.65, 1.2))
        y = model.predict(np.hstack([pulse(100), pulse(100)]), DT)
        with pytest.raises(NotIdentifiable, match="rank") as caught:
            Deconvolution(model, penalty=None).estimate(y, dt=DT)
        assert caught.value.code == "LID-E306"
        with pytest.raises(NotIdentifiable):
            Deconvolution(model, choice=0.0).estimate(y, dt=DT)

    def test_constant_load_is_invisible_to_accelerometers_and_to_the_difference(self):
        """Two loads at one place: their difference is in ker(H), and constants of it in ker(L) too."""
        model = make_model(places=(0.3,), at=(0.65, 0.65 + 1e-15))
        y = model.predict(np.hstack([pulse(60), pulse(60)]), DT)
        with pytest.raises(NotIdentifiable, match="LID-E306"):
            Deconvolution(model, penalty="first_difference").estimate(y, dt=DT)

    @pytest.mark.parametrize(
        ("settings", "words"),
        [
            ({"method": "magic"}, "unknown method"),
            ({"penalty": "smooth"}, "unknown penalty"),
            ({"penalty": None, "choice": "gcv"}, "no lambda to choose"),
            ({"allow": ["X1"]}, "no such guard code"),
            ({"allow": "W114"}, "list of codes"),
        ],
    )
    def test_settings(self, settings, words):
        with pytest.raises(InputError, match=words):
            Deconvolution(make_model(), **folded(Deconvolution, settings))

    @pytest.mark.parametrize(
        ("choice", "words"),
        [
            ("best", "unknown rule"),
            (-1.0, "relative lambda"),
            (float("nan"), "relative lambda"),
            (1e300, "relative lambda"),
            (True, "relative lambda"),
            ("upre", "noise level"),
        ],
    )
    def test_choice(self, choice, words):
        model = make_model()
        with pytest.raises(InputError, match=words):
            Deconvolution(model, choice=choice).estimate(noisy(model.predict(pulse(100), DT), 0.01), dt=DT)

    def test_records(self):
        model = make_model()
        y = model.predict(pulse(100), DT)
        solve = Deconvolution(model)
        for bad, words in (
            (y[:, :2], r"\(100, 2\)"),
            (np.where(np.arange(100)[:, None] == 5, np.inf, y), "inf"),
        ):
            with pytest.raises(InputError, match=words):
                solve.estimate(bad, dt=DT)
        with pytest.raises(InputError, match="step"):
            solve.estimate(y)
        with pytest.raises(InputError, match="did you mean 's00'"):
            solve.estimate(Record(y, DT, ["s00", "s1", "s2"]))
        with pytest.raises(InputError, match="m/s\\^2"):
            solve.estimate(Record(y, DT, [Channel(label=f"s{i}", quantity="displacement", unit="m") for i in range(3)]))
        with pytest.raises(InputError, match=r"--unit s0=m/s\^2"):
            solve.estimate(Record(y, DT, ["s0", "s1", "s2"]))
        with pytest.raises(InputError, match="too few samples"):
            solve.estimate(y[:2], dt=DT)

    def test_noise(self):
        model = make_model()
        y = model.predict(pulse(100), DT)
        for bad in ([1.0, 2.0], np.nan, [1.0, -1.0, 1.0], -np.eye(3)):
            with pytest.raises(InputError, match="noise"):
                Deconvolution(model, noise=bad).estimate(y, dt=DT)


class TestNoise:
    def test_discrepancy_when_the_noise_is_known(self):
        model, g = make_model(places=(0.3,)), pulse(400)
        y = model.predict(g, DT)
        sigma = 0.05 * np.sqrt(np.mean(y**2))
        estimate = Deconvolution(model, noise=sigma, choice="discrepancy").estimate(
            y + sigma * np.random.default_rng(0).standard_normal(y.shape), dt=DT
        )
        assert np.sum((estimate.residual / sigma) ** 2) == pytest.approx(y.size, rel=0.2)

    def test_quiet_segment(self):
        model, g = make_model(), pulse(600, 250)
        y = model.predict(g, DT)
        sigma = 0.02 * np.sqrt(np.mean(y**2, axis=0))
        estimate = Deconvolution(model).estimate(y + sigma * np.random.default_rng(0).standard_normal(y.shape), dt=DT)
        assert "quiet" in estimate.choice.sigma_source
        assert "W406" not in estimate.codes

    def test_declared_with_the_sensors(self):
        model = make_model()
        from dataclasses import replace

        stated = ForwardModel(model.structure, [replace(s, noise=0.5) for s in model.sensors], model.loads, modes=8)
        estimate = Deconvolution(stated).estimate(noisy(model.predict(pulse(), DT), 0.01), dt=DT)
        assert "declared" in estimate.choice.sigma_source

    def test_covariance_equals_whitened_data(self):
        model, g = make_model(), pulse(120)
        y = model.predict(g, DT)
        root = np.array([[1.0, 0.0, 0.0], [0.8, 0.6, 0.0], [0.1, 0.2, 0.9]])
        R = root @ root.T
        full = Deconvolution(model, noise=R, choice=1e-3).estimate(y, dt=DT)
        h = np.einsum("ij,tjl->til", np.linalg.solve(root, np.eye(3)), model.impulse_response(DT, 120))
        white = Deconvolution(ImpulseModel(h, DT, kind="held"), noise=1.0, choice=1e-3).estimate(
            np.linalg.solve(root, y.T).T, dt=DT
        )
        assert full.load == pytest.approx(white.load, abs=1e-8 * np.abs(white.load).max())


def test_truncated_svd():
    model, g = make_model(), pulse(150)
    y = noisy(model.predict(g, DT), 0.01)
    estimate = Deconvolution(model, choice=Lambda(method="tsvd")).estimate(y, dt=DT)
    assert np.linalg.norm(estimate.load - g) < 0.1 * np.linalg.norm(g)
    kept = estimate.facts["edf"]
    assert kept == int(kept)


def test_sparse_penalty_and_complex_record():
    from scipy import sparse

    model, g = make_model(), pulse(100)
    y = noisy(model.predict(g, DT), 0.01)
    by_name, by_matrix = (
        Deconvolution(model, choice=1e-2, penalty=p).estimate(y, dt=DT).load
        for p in ("identity", sparse.eye_array(100))
    )
    assert by_matrix == pytest.approx(by_name, abs=1e-8 * np.abs(by_name).max())
    with pytest.raises(InputError, match="real"):
        Deconvolution(model).estimate(y.astype(complex), dt=DT)


def test_posterior_covers_loads_drawn_from_the_prior():
    """With loads from the prior and noise as stated, the 95 % band holds 95 % of the samples."""
    model = make_model()
    rng = np.random.default_rng(3)
    h = model.impulse_response(DT, 150)
    sigma, inside = 0.2 * np.abs(h).max(), []
    scale = Deconvolution(model, noise=sigma, choice=1.0).estimate(np.ones((150, 3)), dt=DT).choice.scale
    solve = Deconvolution(model, noise=sigma, choice=1.0 / scale)
    for _ in range(40):
        g = rng.standard_normal((150, 1))
        y = model.predict(g, DT) + sigma * rng.standard_normal((150, 3))
        estimate = solve.estimate(y, dt=DT)
        assert estimate.choice.scale == pytest.approx(scale)
        inside.append(np.mean(np.abs(estimate.load - g) < 1.96 * estimate.std))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.01)


def test_functional_of_the_impulse():
    model, g = make_model(places=(0.3, 0.8)), pulse()
    estimate = Deconvolution(model, penalty=Penalty(variance="constant")).estimate(
        noisy(model.predict(g, DT), 0.01), dt=DT
    )
    impulse = estimate.functional("impulse", window=(0.0, 0.03))
    w = np.zeros((300, 1))
    w[estimate.axis.values <= 0.03] = DT
    assert impulse.value == pytest.approx(np.sum(w * estimate.load))
    assert impulse.std == pytest.approx(max(np.sqrt(estimate.posterior.variance(w)), abs(np.sum(w * estimate.bias))))


def test_user_state_space_and_bare_arrays():
    ss = make_model().state_space(DT)
    g = pulse(200)
    y = noisy(StateSpace(ss.A, ss.B, ss.C, ss.D, DT, hold="foh").predict(g, DT), 0.01)
    by_state = Deconvolution(StateSpace(ss.A, ss.B, ss.C, ss.D, DT, hold="foh")).estimate(y, dt=DT)
    assert np.linalg.norm(by_state.load - g) < 0.1 * np.linalg.norm(g)


def test_imported_frf():
    model, g = make_model(zeta=0.05), pulse(2048, 100)
    f = np.fft.rfftfreq(4096, DT)
    h = model.impulse_response(DT, 2048)
    H = np.fft.rfft(h, 4096, axis=0)
    y = noisy(ImpulseModel(h, DT, kind="held").predict(g, DT), 0.01)
    imported = MeasuredModel.from_frf(f, H, kind="accelerance")
    estimate = Deconvolution(imported).estimate(y, dt=DT)
    assert np.linalg.norm(estimate.load - g) < 0.1 * np.linalg.norm(g)
    with pytest.raises(InputError, match="steps"):
        Deconvolution(imported).estimate(y, dt=2 * DT)


def test_progress_and_provenance():
    model, said = make_model(), []
    y = noisy(model.predict(pulse(), DT), 0.01)
    estimate = Deconvolution(model, progress=lambda fraction, text: said.append((fraction, text))).estimate(
        Record(y, DT, model.sensors, name="run 7"), None
    )
    fractions = [f for f, _ in said]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert estimate.provenance["model"] == model.fingerprint
    assert len(next(iter(estimate.provenance["inputs"].values()))) == 64


def test_inputs_are_not_changed():
    model = make_model()
    y = noisy(model.predict(pulse(), DT), 0.01)
    copy = y.copy()
    Deconvolution(model).estimate(y, dt=DT)
    assert np.array_equal(y, copy)


def test_the_band_knows_what_regularisation_hides():
    """Accelerometers do not see the slow part of an impact: the stated std of its impulse must hold the loss."""
    from loadid._commands.demo import model, simulate

    simulated = simulate(1)
    estimate, dt = (
        Deconvolution(model(), penalty=Penalty(variance="constant")).estimate(simulated.record),
        simulated.record.dt,
    )
    pulse_only = slice(470, 567)
    found = estimate.functional("impulse", window=(470 * dt, 566.5 * dt))
    miss = found.value - float(simulated.force[pulse_only].sum() * dt)
    w = np.zeros_like(estimate.load)
    w[pulse_only] = dt
    assert abs(miss) > 3 * np.sqrt(estimate.posterior.variance(w))  # a stationary prior alone is overconfident here
    assert abs(miss) < 3 * found.std  # what is hidden, the noise, and the model of the demo, which is not the truth's
    padded = Deconvolution(model(), choice=Lambda(path="fft")).estimate(simulated.record)
    wrong = padded.functional("impulse", window=(470 * dt, 566.5 * dt)).value - float(
        simulated.force[pulse_only].sum() * dt
    )
    assert abs(miss) < 0.6 * abs(wrong)  # the ends of the record are right
    assert np.sign(estimate.bias[pulse_only].sum()) == np.sign(miss)


def test_a_record_that_ends_in_motion_is_flagged_on_the_padded_path():
    """The response decays within the record, but the load goes on to its end."""
    n, rng = np.arange(4000), np.random.default_rng(0)
    h = np.exp(-n / 30) * np.sin((n + 1) / 12)
    load = np.convolve(rng.standard_normal(2160), np.hanning(31) / 4, "same")[30:2130]
    rest = load * (np.arange(2100) < 1900)
    for g, flagged in ((load, True), (rest, False)):
        y = np.convolve(h, g)[:2100]
        y = y + 0.01 * y.std() * rng.standard_normal(2100)
        estimate = Deconvolution(ImpulseModel(h, DT, kind="held"), choice=Lambda(path="fft")).estimate(y, dt=DT)
        assert estimate.facts["path"] == "zero-padded FFT"
        assert ("W505" in estimate.codes) is flagged


def test_a_residual_that_is_small_by_chance_does_not_choose_lambda():
    """One displacement sensor, a load that fills the record: few degrees of freedom are left at a tiny lambda."""
    from loadid._inverse import rules
    from loadid.paths import LinearProblem, SVDPath, toeplitz

    beam = beams.cantilever(length=1.2, elements=24, EI=300.0, mass_per_length=1.5, damping=damping.Modal(0.04))
    model = ForwardModel(beam, [sensors.Displacement(at=0.8)], [loads.Point(at=1.0)], modes=4)
    h, samples = toeplitz(model.impulse_response(2e-3, 300)), 300
    for seed in range(8):
        rng = np.random.default_rng(seed)
        g = np.convolve(rng.standard_normal(samples + 60), np.hanning(31) / 4, "same")[30 : 30 + samples]
        y = model.predict(g, 2e-3)
        path = SVDPath(LinearProblem.whitened(h, y + 0.01 * y.std() * rng.standard_normal(y.shape)))
        sweep = rules.Sweep.over(path, None)

        def error(lam, path=path, g=g):
            return np.linalg.norm(path.X @ path.gains(lam) - g)

        assert error(rules.run("predicted_error", sweep).lam) < 1.5 * min(error(lam) for lam in sweep.lam)
