"""One family on several paths: the same load from each, and what only some of them take."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import Deconvolution, Guards, Lambda, Penalty
from loadid._spellings import folded
from loadid.constraints import Bounds, NonNegative
from structures import ForwardModel, ImpulseModel, InputError, StateSpace, beams, damping, loads, sensors

DT, N = 1 / 2000, 300
BEAM = beams.simply_supported(
    length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=16,
    damping=damping.Modal(0.03),
)  # fmt: skip


def model(at=(0.65, 1.25), kinds=(sensors.Accelerometer, sensors.Displacement, sensors.Velocity)):
    observed = [
        kind(at=x, direction="Z", label=f"s{i}")
        for i, (kind, x) in enumerate(zip(kinds, (0.3, 0.9, 1.5), strict=False))
    ]
    return ForwardModel(BEAM, observed, [loads.Point(at=x, direction="Z", label=f"p{x}") for x in at], modes=5)


def case(own, seed=0, samples=N):
    rng, t = np.random.default_rng(seed), np.arange(samples)
    g = np.stack([np.hanning(40)[(t - 60 - 50 * j).clip(0, 39)] for j in range(len(own.loads))], axis=1)
    clean = own.predict(g, DT)
    noise = 0.01 * clean.std(axis=0)
    return g, clean + noise * rng.standard_normal(clean.shape), noise


@pytest.mark.parametrize(
    ("penalty", "hold"), [("identity", "foh"), ("first_difference", "zoh"), ("second_difference", "foh")]
)
def test_the_paths_agree(penalty, hold):
    own = model()
    _, y, noise = case(own, samples=160)
    found = {
        path: Deconvolution(own, penalty=penalty, hold=hold, noise=noise, choice=Lambda(0.01, path=path)).estimate(
            y, dt=DT
        )
        for path in ("dense", "statespace", "toeplitz")
    }
    dense = found.pop("dense")
    for path, estimate in found.items():
        assert estimate.load == pytest.approx(dense.load, abs=1e-6 * np.abs(dense.load).max()), path
        assert estimate.std == pytest.approx(dense.std, rel=1e-3), path
        assert estimate.residual == pytest.approx(dense.residual, abs=1e-6 * np.abs(y).max(axis=0).max()), path
        assert estimate.facts["edf"] == pytest.approx(dense.facts["edf"], rel=1e-3), path
    assert {e.facts["path"] for e in found.values()} == {"state space, O(N)", "Toeplitz, preconditioned CG"}


def test_a_short_record_of_displacements_that_ring_on():
    """The circulant preconditioner is of no use here: at small lambdas the iteration ends without an answer."""
    seen, pushed = sensors.Displacement(at=0.9, direction="Z"), loads.Point(at=0.65, direction="Z")
    own = ForwardModel(BEAM, [seen], [pushed], modes=3)
    rng, t = np.random.default_rng(0), np.arange(120)
    clean = own.predict(np.sin(np.pi * ((t - 30) / 30).clip(0, 1))[:, None], 1e-3)
    said = {"penalty": "second_difference", "noise": 0.05 * clean.std(axis=0)}
    y = clean + said["noise"] * rng.standard_normal(clean.shape)
    found, other = (
        Deconvolution(own, choice=Lambda(path=path), **said).estimate(y, dt=1e-3) for path in ("toeplitz", "statespace")
    )
    assert found.choice.lam == pytest.approx(other.choice.lam, rel=0.02)
    other = Deconvolution(own, choice=Lambda(found.choice.lam, path="statespace"), **said).estimate(y, dt=1e-3)
    assert found.load == pytest.approx(other.load, abs=1e-7 * np.abs(other.load).max())


@pytest.mark.parametrize("penalty", ["identity", "first_difference"])
def test_a_response_that_begins_a_sample_late(penalty):
    """Modal displacement under a zero-order hold: the data are advanced on both paths."""
    whole = model(at=(0.65,), kinds=(sensors.Displacement, sensors.Displacement)).state_space(DT, "zoh")
    own = StateSpace(whole.A, whole.B, whole.C, np.zeros_like(whole.D), DT, "zoh")
    _, y, noise = case(own, samples=160)
    settings = {"hold": "zoh", "noise": noise, "choice": 0.01, "penalty": penalty}
    dense, states = (
        Deconvolution(own, **folded(Deconvolution, {"path": p, **settings})).estimate(y, dt=DT)
        for p in ("dense", "statespace")
    )
    assert states.load.shape == (159, 1)
    assert states.load == pytest.approx(dense.load, abs=1e-8 * np.abs(dense.load).max())
    assert states.residual == pytest.approx(dense.residual, abs=1e-8 * np.abs(y).max())


def test_the_path_follows_length_and_model():
    own = model(at=(0.65,))
    _, y, _ = case(own, samples=1100)
    state = own.state_space(DT, "foh")
    h = own.impulse_response(DT, 1100)
    assert Deconvolution(own, choice=0.01).estimate(y[:200], dt=DT).facts["path"] == "dense SVD"
    assert Deconvolution(state, choice=0.01).estimate(y, dt=DT).facts["path"] == "state space, O(N)"
    bare = Deconvolution(ImpulseModel(h, DT, kind="held"), choice=Lambda(0.01, path="toeplitz")).estimate(y, dt=DT)
    assert bare.facts["path"] == "Toeplitz, preconditioned CG"
    with pytest.raises(InputError, match="no state space"):
        Deconvolution(ImpulseModel(h, DT, kind="held"), choice=Lambda(path="statespace")).estimate(y, dt=DT)
    with pytest.raises(InputError, match="unknown path"):
        Deconvolution(own, choice=Lambda(path="quick"))
    for extra in (
        {"initial": "unknown"},
        {"penalty": Penalty("first_difference", leak=0.9)},
        {"penalty": Penalty(from_zero=True)},
    ):
        with pytest.raises(InputError, match="does not know this setting"):
            Deconvolution(ImpulseModel(h, DT, kind="held"), **extra).estimate(y, dt=DT)


def test_covariance_and_missing_samples_together():
    """Rows of the dense problem deleted and whitened by what is left of the covariance."""
    own = model()
    _, y, noise = case(own, samples=120)
    R = np.diag(noise) @ np.array([[1, 0.6, 0.2], [0.6, 1, 0.1], [0.2, 0.1, 1]]) @ np.diag(noise)
    y[10:30, 1] = np.nan
    y[50, :] = np.nan
    estimate = Deconvolution(own, noise=R, choice=0.02).estimate(y, dt=DT)
    h = own.impulse_response(DT, 120)
    rows, data = [], []
    for k in range(120):
        there = ~np.isnan(y[k])
        if not there.any():
            continue
        root = np.linalg.cholesky(R[np.ix_(there, there)])
        row = np.zeros((3, 240))
        row[:, : 2 * (k + 1)] = h[k::-1].transpose(1, 0, 2).reshape(3, -1)
        rows.append(np.linalg.solve(root, row[there]))
        data.append(np.linalg.solve(root, y[k][there]))
    H, lam = np.vstack(rows), estimate.choice.lam * estimate.choice.scale
    ref = np.linalg.lstsq(np.vstack([H, lam * np.eye(240)]), np.r_[np.hstack(data), np.zeros(240)], rcond=None)[0]
    assert estimate.choice.scale == pytest.approx(np.linalg.norm(H, 2), rel=1e-6)
    assert estimate.load.reshape(-1) == pytest.approx(ref, abs=1e-9 * np.abs(ref).max())
    assert np.all(estimate.residual[50] == 0)
    assert np.all(np.isfinite(estimate.response))
    assert estimate.facts["missing"] == "1 of 120 samples of s0, 21 of s1, 1 of s2"


def test_a_start_in_motion():
    own = model(at=(0.65,))
    system = own.state_space(DT, "foh")
    x0 = np.random.default_rng(3).standard_normal(len(system.A)) * 1e-3
    g = np.zeros((N, 1))
    g[100:140, 0] = np.hanning(40) * 5
    clean = system.simulate(g, x0)
    noise = 1e-3 * clean.std(axis=0)
    y = clean + noise * np.random.default_rng(0).standard_normal(clean.shape)
    errors = {}
    for name, initial in (("rest", "rest"), ("unknown", "unknown"), ("known", x0)):
        estimate = Deconvolution(system, initial=initial, noise=noise, choice=Lambda(path="statespace")).estimate(
            y, dt=DT
        )
        errors[name] = np.linalg.norm(estimate.load - g) / np.linalg.norm(g)
    assert errors["unknown"] < 0.2 * errors["rest"]
    assert errors["known"] < 0.2 * errors["rest"]
    with pytest.raises(InputError, match="initial state does not fit"):
        Deconvolution(system, initial=x0[:2]).estimate(y, dt=DT)


class TestSigns:
    def test_against_nnls(self):
        from scipy.optimize import nnls

        own = model(at=(0.65,))
        _, y, noise = case(own, samples=150)
        h = own.impulse_response(DT, 150)[:, :, 0] / noise
        H = np.zeros((150, 3, 150))
        for k in range(150):
            H[k:, :, k] = h[: 150 - k]
        H, data = H.reshape(-1, 150), (y / noise).reshape(-1)
        for path in ("dense", "statespace", "toeplitz"):
            e = Deconvolution(own, noise=noise, choice=Lambda(0.02, path=path), constraints=[NonNegative()]).estimate(
                y, dt=DT
            )
            lam = e.choice.lam * e.choice.scale
            ref = nnls(np.vstack([H, lam * np.eye(150)]), np.r_[data, np.zeros(150)])[0]
            assert e.load[:, 0] == pytest.approx(ref, abs=1e-7 * ref.max()), path
            assert e.facts["gap"] < 1e-6

    def test_lambda_is_chosen_under_the_signs(self):
        own = model(at=(0.65,), kinds=(sensors.Displacement,))
        g, y, noise = case(own)
        plain = Deconvolution(own, noise=noise).estimate(y, dt=DT)
        pushed = Deconvolution(own, noise=noise, constraints=[NonNegative()]).estimate(y, dt=DT)
        assert np.all(pushed.load >= 0)
        assert pushed.choice.rule == "discrepancy of loads that push"
        assert np.linalg.norm(pushed.load - g) < 0.7 * np.linalg.norm(plain.load - g)
        assert pushed.facts["residual_to_noise"] == pytest.approx(1.0, abs=0.1)

    def test_one_of_two_loads(self):
        own = model()
        _, y, noise = case(own)
        e = Deconvolution(own, noise=noise, choice=0.02, constraints=[NonNegative(loads=[1])]).estimate(-y, dt=DT)
        assert e.load[:, 0].min() < 0 <= e.load[:, 1].min()

    def test_loads_that_pull_are_said(self):
        own = model(at=(0.65,))
        _, y, noise = case(own)
        pushed = Deconvolution(own, noise=noise, constraints=[NonNegative()])
        flag = next(f for f in pushed.estimate(-y, dt=DT).flags if f.code == "LID-W308")
        assert flag.evidence.value > 2
        assert "only push" in flag.message
        good = pushed.estimate(y, dt=DT)
        assert not {"W308", "W410"} & good.codes
        assert good.provenance["prior"].endswith("it only pushes")

    def test_unknown_start_under_signs(self):
        own = model(at=(0.65,))
        system = own.state_space(DT, "foh")
        x0 = np.random.default_rng(3).standard_normal(len(system.A)) * 1e-3
        g = np.zeros((N, 1))
        g[100:140, 0] = np.hanning(40) * 5
        y = system.simulate(g, x0)
        noise = 1e-3 * y.std(axis=0)
        y = y + noise * np.random.default_rng(0).standard_normal(y.shape)
        e = Deconvolution(system, initial="unknown", noise=noise, constraints=[NonNegative()]).estimate(y, dt=DT)
        assert np.linalg.norm(e.load - g) < 0.1 * np.linalg.norm(g)
        assert np.sqrt(np.mean((e.residual / noise) ** 2)) == pytest.approx(1.0, abs=0.1)

    def test_other_constraints_are_refused(self):
        with pytest.raises(InputError, match="signs only"):
            Deconvolution(model(), constraints=[Bounds(upper=1.0)])


def test_no_rule_is_called_undetermined_that_nobody_asked():
    own = model(at=(0.65,))
    _, y, noise = case(own)
    e = Deconvolution(own, choice=Lambda(0.01, path="statespace"), noise=noise).estimate(y, dt=DT)
    assert (e.choice.rule, e.choice.verdict) == ("given", "not asked")
    assert "W407" not in e.codes


def test_a_lambda_below_the_digits_is_refused():
    own = model(at=(0.65,))
    _, y, _ = case(own)
    with pytest.raises(InputError, match="too small"):
        Deconvolution(own, choice=Lambda(1e-10, path="statespace")).estimate(y, dt=DT)


def test_an_undetectable_constant_is_refused_and_the_leak_helps():
    own = model(at=(0.65,), kinds=(sensors.Accelerometer,))
    g, y, noise = case(own)
    settings = {"noise": noise, "choice": Lambda(0.01, path="statespace")}
    leaky = Deconvolution(own, penalty=Penalty("first_difference", leak=0.99), **settings).estimate(y, dt=DT)
    assert np.linalg.norm(leaky.load - g) < 0.5 * np.linalg.norm(g)
    with pytest.raises(InputError, match="leak"):
        Deconvolution(own, penalty=Penalty(leak=0.9), choice=Lambda(path="statespace")).estimate(y, dt=DT)


def test_scale_invariance_on_the_state_space_path():
    own = model(at=(0.65,))
    state = own.state_space(DT, "foh")
    _, y, _ = case(own)
    base = Deconvolution(state, choice=Lambda(path="statespace")).estimate(y, dt=DT)
    for factor in (1e-6, 1e6):
        C, D = factor * state.C, factor * state.D
        scaled = StateSpace(state.A, state.B, C, D, DT, "foh", sensors=state.sensors, loads=state.loads)
        again = Deconvolution(scaled, choice=Lambda(path="statespace")).estimate(factor * y, dt=DT)
        assert again.load == pytest.approx(base.load, abs=1e-8 * np.abs(base.load).max())
        assert again.choice.lam == pytest.approx(base.choice.lam, rel=1e-6)


def test_an_unknown_start_of_states_that_no_sensor_sees():
    """A mode with its node at the sensor, and one that dies within a sample, take nothing from the fit."""
    state = model(at=(0.65,), kinds=(sensors.Displacement,)).state_space(DT, "foh")
    n, g = len(state.A), np.zeros((N, 1))
    g[100:140, 0] = np.hanning(40) * 5
    A = np.block([[state.A, np.zeros((n, 2))], [np.zeros((2, n)), np.diag([0.9, 0.0])]])
    wide = StateSpace(A, np.vstack([state.B, [[1.0], [1.0]]]), np.hstack([state.C, [[0.0, 0.0]]]), state.D, DT, "foh")
    x0 = np.random.default_rng(3).standard_normal(n) * 1e-3
    y = state.simulate(g, x0)
    y = y + 1e-3 * y.std() * np.random.default_rng(0).standard_normal(y.shape)
    plain, more = (
        Deconvolution(s, initial="unknown", noise=1e-3 * y.std(), choice=0.01).estimate(y, dt=DT) for s in (state, wide)
    )
    assert more.load == pytest.approx(plain.load, abs=1e-7 * np.abs(plain.load).max())
    assert more.residual == pytest.approx(plain.residual, abs=1e-7 * np.abs(y).max())


def test_the_declared_class_of_load():
    own = model(at=(0.65,))
    _, y, noise = case(own)

    def found(**extra):
        extra = folded(Deconvolution, extra)
        return {"W311", "W510"} & Deconvolution(own, noise=noise, **extra).estimate(y, dt=DT).codes

    assert found() == set()
    assert found(load_class="impact") == {"W510"}  # a pulse of 40 of 300 samples is no impulse yet
    assert found(load_class="service") == set()
    assert found(load_class="impact", constraints=[NonNegative()]) == set()
    peaked = np.zeros((N, 1))
    peaked[100:104] = 50.0
    hit = own.predict(peaked, DT)
    for variance, codes in (
        ("constant", {"W311"}),
        ("auto", set()),
    ):  # a variance that changes with time smears nothing
        told = Deconvolution(own, noise=1e-3 * hit.std(), allow=Guards(load_class="service"),
                             penalty=Penalty("identity", variance=variance))  # fmt: skip
        assert {"W311"} & told.estimate(hit, dt=DT).codes == codes
    with pytest.raises(InputError, match="class of load"):
        Deconvolution(own, allow=Guards(load_class="hammer"))
