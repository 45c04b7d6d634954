"""The two contracts, the forward model and the regularization path: one thin specimen of every family through each."""

import inspect

import numpy as np
import pytest

import loadid
from loadid import (
    AutomaticInversion,
    Deconvolution,
    FieldDeconvolution,
    FrequencyInversion,
    HarmonicInversion,
    LoadTracker,
    LocationSearch,
    Search,
    SparseDeconvolution,
    Spectra,
    StaticInversion,
)
from loadid._inverse import rules
from loadid._inverse.problem import whiten
from loadid._inverse.spectral import LinesPath, compress, factor, posterior
from loadid.paths import LinearProblem, PathPoint, RegularizationPath, Solution, SVDPath, choose
from loadid.sources._transfer import SensorSubset
from structures import Channel, ForwardModel, FrfModel, InputError, Model, StateSpace, beams, damping, loads, sensors
from structures._models.mapped import mapped

BEAM = beams.simply_supported(
    length=2.0,
    section=beams.Section.rectangle(0.05, 0.01),
    material=beams.materials.steel,
    elements=20,
    damping=damping.Modal(0.01),
)
DT = 1 / 2000


def beam(places, at=(0.65,), kind=sensors.Accelerometer, modes=8):
    observed = [kind(at=x, direction="Z", label=f"s{i}") for i, x in enumerate(places)]
    applied = [loads.Point(at=x, direction="Z", label=f"p{i}") for i, x in enumerate(at)]
    return ForwardModel(BEAM, observed, applied, modes=modes)


def test_static_solve_with_a_cone_projected_step():
    """Tactile: tangential and normal parts on a cone; one projected gradient step lowers the misfit and is feasible."""
    model = beam([0.3, 0.7, 1.1, 1.5, 1.7], at=(0.6, 1.2), kind=sensors.Displacement)
    H, truth, mu = model.static(), np.array([3.0, 10.0]), 0.5  # (tangential, normal) stand-ins
    y = H @ truth
    path = SVDPath(LinearProblem.whitened(H, y))
    g = path.solution(1e-9, None).load
    assert g == pytest.approx(truth, rel=1e-6)

    def project(g):
        t, n = g
        if abs(t) <= mu * n:
            return g
        n = max((n + mu * abs(t)) / (1 + mu**2), 0.0)
        return np.array([mu * n * np.sign(t), n])

    start = project(np.array([9.0, 5.0]))
    step = project(start - H.T @ (H @ start - y) / np.linalg.norm(H, 2) ** 2)
    assert np.linalg.norm(H @ step - y) < np.linalg.norm(H @ start - y)
    assert abs(step[0]) <= mu * step[1] * (1 + 1e-12)


def test_lines_with_one_lambda_each():
    """Frequency inversion: all lines in one path, GCV chosen line by line, each line equal to its own dense problem."""
    model = beam([0.3, 0.8, 1.4, 1.7], at=(0.65, 1.25))
    f = np.linspace(5, 200, 30)
    H = model.frf(f)
    rng = np.random.default_rng(0)
    G = np.array([10.0, 4.0]) * np.ones((len(f), 2))
    Y = np.einsum("ksl,kl->ks", H, G) + 1e-3 * (
        rng.standard_normal(H.shape[:2]) + 1j * rng.standard_normal(H.shape[:2])
    )
    lines = factor(compress(H, Y), np.ones((len(f), 2)))
    path = LinesPath(lines)
    grid = np.geomspace(1e-6, 1, 60)
    gcv = rules.gcv_function(path, path.at(grid))
    assert gcv.shape == (30, 60)
    lam = grid[np.nanargmin(gcv, axis=1)]
    load = posterior(lines, (lam * path.scale) ** 2).load[..., 0]
    assert load.shape == (30, 2)
    for k in (0, 11, 29):
        x = lam[k] * path.scale[k]
        augmented = np.vstack([H[k], x * np.eye(2)])
        expected = np.linalg.lstsq(augmented, np.concatenate([Y[k], np.zeros(2)]), rcond=None)[0]
        assert load[k] == pytest.approx(expected, rel=1e-8)


def test_lines_of_a_model_and_of_its_table_are_one():
    """Frequency inversion asks a model for `frf` alone: a table of the same lines gives the same loads and flags."""
    model = beam([0.3, 0.8, 1.4, 1.7], at=(0.65, 1.25))
    f = np.linspace(5, 200, 60)
    H = model.frf(f)
    noise = np.random.default_rng(0).standard_normal((2, 60, 4))
    Y = H @ np.array([10.0, 4.0j]) + 1e-3 * (noise[0] + 1j * noise[1])
    spectra = Spectra(f, Y, noise=1e-3 * np.sqrt(2))
    first, second = (FrequencyInversion(m).estimate(spectra) for m in (model, FrfModel.of(model, f)))
    assert np.array_equal(first.load, second.load)
    assert first.codes == second.codes
    trusted = first.trust().all(axis=1)
    assert trusted.any()
    assert np.linalg.norm(first.load[trusted] - [10, 4j]) < 0.1 * np.linalg.norm(first.load[trusted])


def test_joined_lines_serve_every_rule_that_asks_for_no_residual():
    """All lines as one path: their GCV is that of the problem with the lines on the diagonal of one matrix."""
    f = np.linspace(5, 200, 6)
    H = beam([0.3, 0.8, 1.4], at=(0.65, 1.25)).frf(f)
    Y = np.random.default_rng(0).standard_normal((2, 6, 3))
    Y = Y[0] + 1j * Y[1]
    joined = LinesPath(factor(compress(H, Y), np.ones((6, 2)))).joined()
    whole = np.zeros((18, 12), complex)
    for k in range(6):
        whole[3 * k : 3 * k + 3, 2 * k : 2 * k + 2] = H[k]
    real = np.block([[whole.real, -whole.imag], [whole.imag, whole.real]])
    dense = SVDPath(LinearProblem.whitened(real, np.concatenate([Y.ravel().real, Y.ravel().imag])))
    lam = np.geomspace(1e-3, 1, 9)
    assert joined.scale == pytest.approx(dense.scale)
    assert rules.gcv_function(joined, joined.at(lam)) == pytest.approx(
        2 * rules.gcv_function(dense, dense.at(lam)), rel=1e-8
    )


def test_one_proximal_step_of_l1():
    """Sparse family: a proximal step from the path's operator lowers the l1 objective."""
    model = beam([0.4, 1.3])
    h = model.impulse_response(DT, 80)
    from loadid.paths import toeplitz

    H = toeplitz(h)
    g = np.zeros(80)
    g[30] = 100.0
    problem = LinearProblem.whitened(H, H @ g)
    A, y = problem.H, problem.y
    mu = 0.01 * np.abs(A.T @ y).max()
    x, L = np.zeros(80), np.linalg.norm(A, 2) ** 2

    def objective(x):
        return 0.5 * np.sum((A @ x - y) ** 2) + mu * np.abs(x).sum()

    z = x - A.T @ (A @ x - y) / L
    new = np.sign(z) * np.maximum(np.abs(z) - mu / L, 0)
    assert objective(new) < objective(x)
    assert np.argmax(np.abs(new)) == 30


def test_three_kalman_steps_from_the_state_space():
    """Online family: the random-walk filter equals batch least squares with L = first difference (load zero before)."""
    model = beam([0.4, 1.3])
    ss = model.state_space(DT)
    rng = np.random.default_rng(1)
    y, sigma, q = rng.standard_normal((3, 2)), 0.5, 4.0
    nx, p = ss.B.shape
    # augmented state [x; g], the load moves before it acts: y_k = C x_k + D g_k
    F = np.block([[ss.A, ss.B], [np.zeros((p, nx)), np.eye(p)]])
    x, P = np.zeros(nx + p), np.zeros((nx + p, nx + p))
    P[nx:, nx:] = q
    C = np.hstack([ss.C, ss.D])
    for k in range(3):
        S = C @ P @ C.T + sigma**2 * np.eye(2)
        K = np.linalg.solve(S, C @ P).T
        x, P = x + K @ (y[k] - C @ x), P - K @ S @ K.T
        filtered = x[nx:].copy()
        x, P = F @ x, F @ P @ F.T
        P[nx:, nx:] += q
    from loadid.paths import toeplitz

    H = toeplitz(model.impulse_response(DT, 3)).reshape(6, 3) / sigma
    L = (np.eye(3) - np.eye(3, k=-1)) / np.sqrt(q)
    batch = np.linalg.lstsq(np.vstack([H, L]), np.concatenate([y.ravel() / sigma, np.zeros(3)]), rcond=None)[0]
    assert filtered[0] == pytest.approx(batch[-1], rel=1e-8)


def test_a_smoothed_track_equals_tikhonov():
    """Online family, whole: a random walk's smoothed loads are batch least squares with L = first difference."""
    from loadid.paths import toeplitz
    from loadid.priors import RandomWalk

    model, N, sd, rate = beam([0.4, 1.3], kind=sensors.Displacement), 60, 1e-6, 300.0
    y = model.predict(np.sin(np.arange(N)[:, None] / 5), DT, "zoh")
    y = y + sd * np.random.default_rng(4).standard_normal(y.shape)
    tracker = LoadTracker(model, prior=RandomWalk(rate), noise=sd, hold="zoh").fit(y, DT)
    first = np.linalg.norm(tracker.fitted.model.Cp @ tracker.fitted.model.L0)  # std of the load before the record
    step = rate * np.sqrt(DT)
    L = (np.eye(N) - np.eye(N, k=-1)) / np.where(np.arange(N) == 0, first, step)[:, None]
    H = toeplitz(model.impulse_response(DT, N, "zoh")).reshape(2 * N, N) / sd
    batch = np.linalg.lstsq(np.vstack([H, L]), np.r_[y.ravel() / sd, np.zeros(N)], rcond=None)[0]
    found = tracker.smooth(y, DT).load[:, 0]
    assert np.linalg.norm(found - batch) <= 1e-8 * np.linalg.norm(batch)


def test_moving_load():
    """A load that moves is a basis whose columns change with time: the state space carries B(t)."""
    start, stop, N = 0.2, 1.8, 60
    path = np.linspace(start, stop, N)
    model = ForwardModel(
        BEAM,
        [sensors.Displacement(at=1.0, direction="Z", label="mid")],
        [loads.MovingPoint(path, label="truck")],
        modes=8,
    )
    ss = model.state_space(DT)
    assert ss.B.shape[0] == N
    with pytest.raises(InputError, match="static"):
        model.static()
    moving = ss.simulate(np.full((N, 1), 50.0))
    # superposition of fixed loads, each on for the hat of its own sample
    fixed = np.zeros((N, 1))
    for k in range(N):
        pulse = np.zeros((N, 1))
        pulse[k] = 50.0
        single = ForwardModel(BEAM, model.sensors, [loads.Point(at=path[k], direction="Z", label="p")], modes=8)
        fixed += single.predict(pulse, DT)
    assert np.linalg.norm(moving - fixed) <= 1e-9 * np.linalg.norm(fixed)


def test_perturbed_model_gives_the_sensitivity_to_a_stiffness_factor():
    """Families that carry model error ask for a perturbed model: u ~ 1/k, so d ln u / d ln k = -1 for a static load."""
    model = beam([0.5, 1.2], kind=sensors.Displacement)
    h = 1e-4
    up, down = model.perturbed("stiffness", 1 + h), model.perturbed("stiffness", 1 - h)
    assert type(up) is type(model)
    derivative = (up.static() - down.static()) / (2 * h)
    assert derivative == pytest.approx(-model.static(), rel=1e-6)
    assert up.fingerprint != model.fingerprint


def test_correlated_sensor_noise():
    """Whitening by a full covariance gives the generalised least-squares answer."""
    model = beam([0.3, 0.8, 1.4], kind=sensors.Displacement)
    H = model.static()
    rng = np.random.default_rng(2)
    root = rng.standard_normal((3, 3))
    R = root @ root.T + 0.1 * np.eye(3)
    y = H[:, 0] * 7 + np.linalg.cholesky(R) @ rng.standard_normal(3) * 1e-7
    path = SVDPath(LinearProblem.whitened(H, y, noise=R * 1e-14))
    expected = (H.T @ np.linalg.solve(R, y)) / (H.T @ np.linalg.solve(R, H))[0, 0]
    assert path.solution(0.0, 1.0).load == pytest.approx(expected, rel=1e-10)
    assert whiten(np.eye(3), R, axis=0) @ R @ whiten(np.eye(3), R, axis=0).T == pytest.approx(np.eye(3), abs=1e-10)


class Projected(RegularizationPath):
    """A constrained path: its effective degrees of freedom are not defined."""

    m, null, scale, smooth = 10, 0, np.asarray(1.0), True
    range = (1e-4, 1.0)
    coefficients = None

    def at(self, lam):
        lam = np.asarray(lam, float)
        return PathPoint(residual2=0.1 + lam**2 / (1 + lam), penalty2=1 / (0.01 + lam) ** 2)

    def predicted_error(self, lam, pilot, sigma):
        return None

    def resolve(self, load, lam):
        return load

    def residual(self, lam):
        return np.random.default_rng(0).standard_normal((10, 1))

    def solution(self, lam, sigma):
        return Solution(np.zeros(3), None)


def test_a_path_without_degrees_of_freedom():
    """Rules that need what a path cannot give refuse by name; the others choose."""
    path = Projected()
    assert isinstance(path, RegularizationPath)
    with pytest.raises(InputError, match="gcv needs left"):
        choose(path, "gcv")
    found = {r.rule: r for r in choose(path, "discrepancy", sigma=0.2).rules}
    assert found["discrepancy"].lam is not None
    assert found["upre"].lam is None
    assert "upre needs edf" in found["upre"].note
    assert found["ncp"].lam is not None


# -- models of one file ----------------------------------------------------------------------------------------------
SPRINGS, DECAY = np.array([[1.0, 0.3], [0.4, 0.9], [-0.5, 0.7]]), np.array([90.0, 140.0])  # sensors x modes = loads
OMEGA = 2 * np.pi * np.array([60.0, 110.0])


class Own(Model):
    """Two damped modes, a load on each, three sensors: channels, and nothing that the contract asks."""

    sensors = tuple(Channel(label=f"s{i}", quantity="displacement", unit="m") for i in range(3))
    loads = tuple(Channel(label=f"p{j}", quantity="force", unit="N") for j in range(2))


class OwnStatic(Own):
    def static(self):
        return SPRINGS


class OwnFrf(Own):
    def frf(self, frequencies):
        s = 2j * np.pi * np.asarray(frequencies, float)[:, None]
        return SPRINGS / ((s + DECAY) ** 2 + OMEGA**2)[:, None, :]


class OwnImpulse(Own):
    def impulse_response(self, dt, samples, hold="foh"):
        t = dt * np.arange(samples)[:, None]
        return SPRINGS * (dt * np.exp(-DECAY * t) * np.sin(OMEGA * t) / OMEGA)[:, None, :]


class OwnStates(Own):
    def state_space(self, dt, hold="foh"):
        r, w = np.exp(-DECAY * dt), OMEGA * dt
        A = np.zeros((4, 4))
        for k in range(2):
            A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = r[k] * np.array(
                [[np.cos(w[k]), np.sin(w[k])], [-np.sin(w[k]), np.cos(w[k])]]
            )
        B, C = np.zeros((4, 2)), np.zeros((3, 4))
        C[:, ::2] = SPRINGS * dt / OMEGA
        B[0, 0], B[2, 1] = r * np.sin(w)
        B[1, 0], B[3, 1] = r * np.cos(w)
        return StateSpace(A, B, C, np.zeros((3, 2)), dt, hold, sensors=self.sensors, loads=self.loads)


STEP, SAMPLES = 1e-3, 128
MODELS = {kind.__name__: kind for kind in (OwnStatic, OwnFrf, OwnImpulse, OwnStates)}
IN_TIME = {"OwnImpulse", "OwnStates"}
# family -> how it is made, the kinds that it can use
USERS = {
    "AutomaticInversion": (lambda m: AutomaticInversion(m), {"OwnStatic", "OwnFrf", *IN_TIME}),
    "Deconvolution": (lambda m: Deconvolution(m), IN_TIME),
    "FieldDeconvolution": (lambda m: FieldDeconvolution(m), IN_TIME),
    "FrequencyInversion": (lambda m: FrequencyInversion(m, signal="transient"), {"OwnFrf", *IN_TIME}),
    "HarmonicInversion": (lambda m: HarmonicInversion(m, 80.0), {"OwnFrf"}),
    "LoadTracker": (lambda m: LoadTracker(m), {"OwnStates"}),
    "LocationSearch": (lambda m: LocationSearch(m, search=Search(refine=False)), IN_TIME),
    "SparseDeconvolution": (lambda m: SparseDeconvolution(m), IN_TIME),
    "StaticInversion": (lambda m: StaticInversion(m), {"OwnStatic"}),
}


def pulse():
    load = np.zeros((SAMPLES, 2))
    load[30:42, 0] = 10 * np.sin(np.pi * (np.arange(12) + 0.5) / 12)
    return load


def data_for(family, kind):
    """Data of a family, made by the model that is inverted, and the load behind them."""
    rng = np.random.default_rng(0)
    if kind == "OwnStatic":
        truth = np.array([10.0, 4.0])
        y = SPRINGS @ truth
    elif kind == "OwnFrf":
        f = np.array([80.0]) if family == "HarmonicInversion" else np.linspace(20, 200, 40)
        truth = np.broadcast_to(np.array([10.0, 4.0j]), (len(f), 2))
        y = np.einsum("ksl,kl->ks", OwnFrf().frf(f), truth)
    else:
        truth = pulse()
        y = OwnImpulse().predict(truth, STEP)
    noise = 0.01 * np.sqrt(np.mean(np.abs(y) ** 2))
    y = y + noise * (rng.standard_normal(y.shape) + (1j * rng.standard_normal(y.shape) if np.iscomplexobj(y) else 0))
    if kind != "OwnFrf":
        return (y, STEP) if kind in IN_TIME else (y,), truth
    return (y[0] if len(y) == 1 else Spectra(f, y, noise=np.sqrt(2) * noise),), truth


def test_every_family_has_a_place_among_the_users_of_ones_own_model():
    public = [getattr(loadid, name) for name in loadid.__all__]
    families = {x.__name__ for x in public if inspect.isclass(x) and inspect.isfunction(getattr(x, "estimate", None))}
    assert families - {"ShapeSensing"} == set(USERS)  # that one takes a plate and its gauges, no model


@pytest.mark.parametrize(("family", "kind"), [(f, k) for f, (_, can) in USERS.items() for k in MODELS if k in can])
def test_a_model_of_one_method_goes_through(family, kind, tmp_path, monkeypatch):
    model = MODELS[kind]()
    given, truth = data_for(family, kind)
    found = USERS[family][0](model).estimate(*given)
    estimate = found.estimate if family == "LocationSearch" else found
    if family == "LocationSearch":
        assert found.best == (0,)
    else:
        load = estimate.load if family != "HarmonicInversion" else estimate.load[:1] + 1j * estimate.load[1:]
        load = load.reshape(-1, 2)
        wrong = np.linalg.norm(load - truth.reshape(-1, 2)[: len(load)])  # without what no response tells at the end
        assert wrong < 0.5 * np.linalg.norm(truth)
    assert found.provenance["model"] == model.fingerprint
    assert "p0" in estimate.summary()
    estimate.save(tmp_path / "found.h5")
    again = loadid.load(tmp_path / "found.h5")
    np.testing.assert_array_equal(again.load, estimate.load)
    again.report(tmp_path / "found.html")
    assert "p0" in (tmp_path / "found.html").read_text("utf-8")


@pytest.mark.parametrize(("family", "kind"), [(f, k) for f, (_, can) in USERS.items() for k in MODELS if k not in can])
def test_a_model_that_a_family_cannot_use_is_refused_by_name(family, kind):
    """Before anything is inverted, and mostly before any data: with the name of the model, the method, the family."""
    with pytest.raises(InputError, match=rf"{kind} has no \w+\(\): {family} cannot run on it") as refused:
        USERS[family][0](MODELS[kind]())
    able = [name for name, (_, can) in USERS.items() if kind in can]
    assert any(name in refused.value.hint for name in able)


def test_what_is_no_model_is_refused_by_every_family():
    for family, (make, _) in USERS.items():
        if family not in {"AutomaticInversion", "StaticInversion"}:  # these take a bare matrix
            with pytest.raises(InputError, match=f"{family}: no forward model"):
                make(np.eye(3))


def test_a_model_without_its_channels_is_refused():
    class Nameless(Model):
        def impulse_response(self, dt, samples, hold="foh"):
            return np.ones((samples, 1, 1))

    class Texts(OwnImpulse):
        sensors = ("s0", "s1", "s2")

    for model, name in ((Nameless(), "Nameless"), (Texts(), "Texts")):
        with pytest.raises(InputError, match=f"{name} does not say what its sensors are"):
            Deconvolution(model)


@pytest.mark.parametrize("slip", [lambda h: h[:, 0, 0], lambda h: h[:, :, :1], lambda h: h[:, 0], lambda h: None])
def test_an_impulse_response_that_does_not_fit_its_channels_is_refused(slip):
    class Slip(OwnImpulse):
        def impulse_response(self, dt, samples, hold="foh"):
            return slip(super().impulse_response(dt, samples, hold))

    (y, dt), _ = data_for("Deconvolution", "OwnImpulse")
    for asked in (lambda: Deconvolution(Slip()).estimate(y, dt), lambda: Slip().predict(pulse(), dt)):
        with pytest.raises(InputError, match=r"impulse_response\(\) of Slip does not fit its channels") as refused:
            asked()
        assert f"({SAMPLES}, 3, 2)" in str(refused.value)


def test_a_model_that_says_nothing_of_itself_is_told_by_its_answers():
    """The same class is the same model each time; another answer, another class or another channel is another."""

    class Louder(OwnImpulse):
        def impulse_response(self, dt, samples, hold="foh"):
            return 2 * super().impulse_response(dt, samples, hold)

    class OneStep(OwnImpulse):
        dt = STEP

        def impulse_response(self, dt, samples, hold="foh"):
            if dt != self.dt:
                raise ValueError("another step")
            return super().impulse_response(dt, samples, hold)

    one, other = OwnImpulse(), OwnImpulse()
    other.sensors = other.sensors[::-1]
    digests = {m.fingerprint for m in (one, other, Louder(), OneStep(), OwnStatic(), OwnFrf(), OwnStates())}
    assert len(digests) == 7
    assert OwnImpulse().fingerprint == one.fingerprint


@pytest.mark.parametrize("kind", MODELS)
def test_combinations_and_parts_of_ones_own_model_give_what_it_gives(kind):
    model = MODELS[kind]()
    under, part = mapped(model, np.eye(2)), SensorSubset(model, np.array([0, 2]))
    for method in ("static", "frf", "impulse_response", "state_space"):
        assert under.gives(method) == part.gives(method) == model.gives(method)
    missing = next(m for m in ("static", "frf") if not model.gives(m))
    for made in (under, part):
        with pytest.raises(InputError, match=f"{kind} has no {missing}"):
            made.require(missing)
