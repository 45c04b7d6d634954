"""Distributed loads over space and time, and on one frequency line, against dense solutions and closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from loadid import FieldDeconvolution, HarmonicInversion, InputError, Lambda, Noise, NotIdentifiable
from loadid._families import smoothness as spatial
from loadid._families.field import harmonic_power, mean_power, told_apart
from loadid._families.harmonic import complex_load
from loadid._inverse import penalties
from loadid._inverse.gaussian.posterior import MappedPosterior
from loadid._inverse.posterior import from_arrays
from loadid._results.estimate import Axis
from loadid._spellings import folded
from loadid.paths import toeplitz
from structures import ForwardModel, ImpulseModel, bases, beams, damping, sensors
from structures._models.mapped import mapped
from structures._models.motion import harmonic_motion
from tests.benchmarks import field as plate

DT, N, LENGTH = 1 / 400, 50, 0.4
BEAM = beams.simply_supported(
    length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=20, damping=0.03
)
HATS = bases.hats(BEAM, 5)
GAUGES = [
    *(sensors.StrainGauge(at=x, fibre=0.005) for x in (0.21, 0.53, 0.87, 1.18, 1.55, 1.83)),
    sensors.Accelerometer(at=0.71),
    sensors.Accelerometer(at=1.37),
]
MODEL = ForwardModel(BEAM, GAUGES, HATS, modes=6)
RNG = np.random.default_rng(0)
TRUTH = np.sin(2 * np.pi * np.outer(np.arange(N) * DT, np.arange(10, 70, 10))) * 50
CLEAN = MODEL.predict(TRUTH, DT)
NOISE = 0.03 * CLEAN.std(axis=0)
RECORD = CLEAN + NOISE * RNG.standard_normal(CLEAN.shape)


def dense(T, time, lam, seen=slice(None)):
    """Load and its standard deviation, by one dense least-squares problem and its covariance: T maps unknowns."""
    loads, unknowns = T.shape
    A = toeplitz(MODEL.impulse_response(DT, N)).reshape(-1, N * loads)
    A = (A / np.tile(NOISE, N)[:, None]) @ np.kron(np.eye(N), T)
    L = penalties.matrix(time, N, unknowns)
    L = np.eye(N * unknowns) if L is None else L
    stack = np.vstack([A[seen], lam * L])
    u = np.linalg.lstsq(stack, np.concatenate([(RECORD / NOISE).ravel()[seen], np.zeros(len(L))]), rcond=None)[0]
    half = np.linalg.qr(stack, mode="r")
    spread = np.kron(np.eye(N), T) @ np.linalg.solve(half, np.eye(len(half)))
    return u.reshape(N, unknowns) @ T.T, np.linalg.norm(spread, axis=1).reshape(N, loads)


def whole(space, length=LENGTH):
    W = spatial.root(space, length, len(HATS), HATS, 6)
    return np.linalg.solve(W, np.eye(len(W)))


@pytest.mark.parametrize("path", ["dense", "statespace"])
@pytest.mark.parametrize(("space", "time"), [("gradient", "identity"), ("laplacian", "first_difference")])
def test_the_load_is_that_of_the_dense_problem(space, time, path):
    family = FieldDeconvolution(
        MODEL, space=space, length=LENGTH, time=time, choice=Lambda(0.02, path=path), noise=Noise(NOISE, source="known")
    )
    found = family.estimate(RECORD, DT)
    load, std = dense(whole(space), time, found.choice.lam * found.choice.scale)
    assert found.load == pytest.approx(load, abs=1e-7 * np.abs(load).max())
    assert found.posterior.std == pytest.approx(found.facts["noise_level"] * std, rel=1e-6)
    w = RNG.standard_normal(found.load.shape)
    back = from_arrays({"kind": "mapped", "base": found.posterior.base.to_arrays(), "T": found.posterior.T})
    assert isinstance(back, MappedPosterior)
    assert back.variance(w) == pytest.approx(found.posterior.variance(w), rel=1e-6)


def test_missing_samples():
    seen = np.random.default_rng(5).random(RECORD.shape) > 0.1
    found = FieldDeconvolution(MODEL, space="gradient", length=LENGTH, choice=0.02, noise=NOISE).estimate(
        np.where(seen, RECORD, np.nan), DT
    )
    load, std = dense(whole("gradient"), "identity", found.choice.lam * found.choice.scale, seen.ravel())
    assert found.load == pytest.approx(load, abs=1e-7 * np.abs(load).max())
    assert found.posterior.std == pytest.approx(found.facts["noise_level"] * std, rel=1e-6)


def test_the_variance_of_any_sum_and_its_bias_weights():
    """Against the dense covariance and resolution."""
    lam = 0.05
    found = FieldDeconvolution(
        MODEL, space="gradient", length=LENGTH, choice=Lambda(lam, path="dense"), noise=NOISE
    ).estimate(RECORD, DT)
    T, x, w = whole("gradient"), lam * found.choice.scale, RNG.standard_normal((N, 6))
    A = toeplitz(MODEL.impulse_response(DT, N)).reshape(-1, N * 6) / np.tile(NOISE, N)[:, None]
    precision = A.T @ A + x**2 * np.kron(np.eye(N), np.linalg.solve(T @ T.T, np.eye(6)))
    sigma = found.facts["noise_level"]
    assert found.posterior.variance(w) == pytest.approx(
        sigma**2 * w.ravel() @ np.linalg.solve(precision, w.ravel()), rel=1e-7
    )
    R = np.linalg.solve(precision, A.T @ A)
    told = found.posterior.bias_weights(w)
    assert told == pytest.approx(((R - np.eye(len(R))).T @ w.ravel()).reshape(w.shape), abs=1e-7 * np.abs(told).max())


def test_the_spatial_prior_is_the_integral_that_it_says():
    """|W c|^2 is proportional to the integral of q^2 + length^2 q'^2, by quadrature; a finer basis changes nothing."""
    x = np.linspace(0, 2, 20_001)
    for grid in (5, 10):
        hats = bases.hats(BEAM, grid)
        W = spatial.root("gradient", LENGTH, len(hats), hats, 6)
        both = [np.sin(3 * hats.coordinates[:, 0]), hats.coordinates[:, 0] ** 2]
        ours = [np.sum((W @ c) ** 2) for c in both]
        q = [np.interp(x, hats.coordinates[:, 0], c) for c in both]
        integrals = [np.trapezoid(f**2 + LENGTH**2 * np.gradient(f, x) ** 2, x) for f in q]
        assert ours[0] / ours[1] == pytest.approx(integrals[0] / integrals[1], rel=2e-3)
        assert np.allclose(W, np.triu(W))
        assert np.all(np.diag(W) > 0)


def test_scale_invariance():
    """A model and data in other units give the same load; so do other units of the load, but for the unit."""
    h = MODEL.impulse_response(DT, N)
    prior = np.diff(np.eye(6), axis=0)

    def load(factor, per=1.0):
        model = ImpulseModel(h * factor * per, DT, kind="held")
        return FieldDeconvolution(model, space=prior, noise=NOISE * factor).estimate(RECORD * factor, DT).load

    reference = load(1.0)
    for factor in (1e-6, 1e6):
        assert load(factor) == pytest.approx(reference, abs=1e-9 * np.abs(reference).max())
        assert load(1.0, factor) * factor == pytest.approx(reference, abs=1e-9 * np.abs(reference).max())


def test_shapes_stand_for_a_basis():
    """Two shapes over the hats: as a model under these two loads, and found exactly where the load has them."""
    x = HATS.coordinates[:, 0]
    shapes = np.stack([np.sin(np.pi * x / 2), np.sin(2 * np.pi * x / 2)], axis=1)
    g = TRUTH[:, :2] @ shapes.T
    y = MODEL.predict(g, DT)
    found = FieldDeconvolution(MODEL, shapes=shapes, choice=Lambda(1e-4, path="dense"), noise=NOISE).estimate(y, DT)
    assert np.linalg.norm(found.load - g) < 0.02 * np.linalg.norm(g)
    again = FieldDeconvolution(MODEL, shapes=shapes, noise=NOISE, choice=Lambda(0.3, path="statespace"))
    estimate = again.estimate(RECORD, DT)
    load, std = dense(shapes, "identity", estimate.choice.lam * estimate.choice.scale)
    assert estimate.load == pytest.approx(load, abs=1e-8 * np.abs(load).max())
    assert estimate.posterior.std == pytest.approx(estimate.facts["noise_level"] * std, rel=1e-8)
    assert estimate.posterior.bias_weights(np.ones((N, 6))) is None


def test_a_result_is_kept_whole(tmp_path):
    found = FieldDeconvolution(MODEL, space="gradient", noise=NOISE).estimate(RECORD, DT)
    assert found.labels == tuple(HATS.labels)
    assert set(found.units) == {"N/m"}
    assert found.facts["told_apart"] == 6
    assert found.facts["length"] == pytest.approx(2.0 / 6)
    assert "gradient" in found.provenance["prior"]
    found.save(tmp_path / "field.h5")
    back = type(found).read(tmp_path / "field.h5")
    assert np.array_equal(back.load, found.load)
    assert back.posterior.variance(np.ones((N, 6))) == pytest.approx(found.posterior.variance(np.ones((N, 6))))
    figure = found.plot("spacetime", truth=TRUTH)
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert [t.split()[-1] for t in titles if t] == ["estimate", "truth", "std"]


def test_the_motion_of_an_estimate_is_in_equilibrium_and_is_the_response():
    whole = ForwardModel(BEAM, GAUGES, HATS)
    family = FieldDeconvolution(whole, noise=NOISE, choice=Lambda(path="dense"))
    found = family.estimate(RECORD, DT)
    motion = family.motion(found)
    assert motion.imbalance() < 1e-10
    rows = np.array([s.row(BEAM) for s in GAUGES])
    read = np.where(np.arange(8) < 6, motion.displacement @ rows.T, motion.acceleration @ rows.T)
    assert read == pytest.approx(found.predicted, abs=1e-8 * np.abs(read).max())


def test_a_full_grid_is_refused_with_rank_and_nullity():
    """Twenty-one places, eight sensors: refused; with a spatial prior, with few shapes, or allowed, it runs."""
    full = ForwardModel(BEAM, GAUGES, bases.hats(BEAM), modes=12)
    with pytest.raises(NotIdentifiable, match=r"rank 400 for 1050 unknowns, nullity 650") as refusal:
        FieldDeconvolution(full, noise=NOISE).estimate(RECORD, DT)
    assert refusal.value.code == "LID-E514"
    found = FieldDeconvolution(full, noise=NOISE, choice=0.1, allow=["E514"]).estimate(RECORD, DT)
    assert "E514" in found.codes
    smooth = FieldDeconvolution(full, space="laplacian", noise=NOISE, choice=0.1).estimate(RECORD, DT)
    assert "E514" not in smooth.codes
    assert smooth.facts["told_apart"] == 8


def test_ranks():
    rng = np.random.default_rng(1)
    H = rng.standard_normal((5, 7, 4)) + 1j * rng.standard_normal((5, 7, 4))
    units = 10.0 ** rng.integers(-9, 9, 7)
    assert told_apart(H * units[:, None]) == 4
    H[..., 3] = H[..., :3] @ [1, 2, 3]
    assert told_apart(H * units[:, None]) == 3
    assert told_apart(H[:, :2]) == 2


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"space": "wavelet"}, "unknown spatial prior"),
        ({"space": "gradient", "length": -1.0}, "length must be positive"),
        ({"length": 1.0}, "belongs to a spatial prior"),
        ({"space": np.eye(3)}, "does not fit the loads"),
        ({"space": np.full((2, 6), np.nan)}, "does not fit the loads"),
        ({"shapes": np.eye(5)}, "do not fit the loads"),
        ({"shapes": np.eye(6), "space": "gradient"}, "prior of their own"),
        ({"time": np.eye(3)}, "in time is a name"),
        ({"penalty": "identity"}, "two penalties"),
        ({"method": "magic"}, "unknown method"),
    ],
)
def test_bad_settings_are_refused_at_once(changed, says):
    with pytest.raises(InputError, match=says):
        FieldDeconvolution(MODEL, **folded(FieldDeconvolution, changed))


def test_a_map_wants_a_line_and_time():
    found = FieldDeconvolution(mapped(MODEL, np.eye(6)), noise=NOISE, choice=0.1).estimate(RECORD, DT)
    with pytest.raises(InputError, match="places along a line"):
        found.plot("spacetime")


def test_a_mapped_model_is_the_model_under_its_combinations():
    T = RNG.standard_normal((6, 3))
    under = mapped(MODEL, T)
    assert under.static() == pytest.approx(MODEL.static() @ T)
    assert under.frf([7.0]) == pytest.approx(MODEL.frf([7.0]) @ T)
    u = RNG.standard_normal((30, 3))
    expected = MODEL.predict(u @ T.T, DT)
    assert under.predict(u, DT) == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    states = under.state_space(DT).simulate(u)
    assert states == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    assert under.fingerprint != mapped(MODEL, 2 * T).fingerprint
    bare = ImpulseModel(MODEL.impulse_response(DT, N), DT, kind="held")
    with pytest.raises(InputError, match="has no state_space"):
        mapped(bare, T).state_space(DT)


def test_plate_pressure_near_its_oracle():
    """A travelling pressure that is not in the basis, from 16 gauges; the full size is in the benchmark."""
    places, q, y, noise = plate.record(240, 0)
    error, oracle = plate.errors(y, noise, q, places, steps=(-0.25, 0.25))
    assert error <= 1.2 * oracle
    assert error < 0.55
    with pytest.raises(NotIdentifiable, match=r"16 sensors tell 16 of 169 places apart.*nullity 36720"):
        plate.full_grid(y, noise)


# -- one line ---------------------------------------------------------------------------------------------------------
F = 30.0
LINE = np.array([40.0, 10j, -20, 5 + 5j, 30, -10j])
AMPLITUDES = MODEL.frf([F])[0] @ LINE
LEVEL = 0.01 * np.abs(AMPLITUDES)
SEEN = AMPLITUDES + LEVEL / np.sqrt(2) * (RNG.standard_normal(8) + 1j * RNG.standard_normal(8))


@pytest.mark.parametrize("space", [None, "gradient"])
def test_a_line_is_the_complex_least_squares_problem(space):
    found = HarmonicInversion(MODEL, F, space=space, choice=0.01, noise=LEVEL).estimate(SEEN)
    W = np.eye(6) if space is None else spatial.root(space, 2.0 / 6, 6, HATS, 6)
    lam = found.choice.lam * found.choice.scale / np.sqrt(2)  # each part carries half of the noise
    A = np.vstack([MODEL.frf([F])[0] / LEVEL[:, None], lam * W])
    expected = np.linalg.lstsq(A, np.concatenate([SEEN / LEVEL, np.zeros(6)]), rcond=None)[0]
    assert complex_load(found) == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    half = np.linalg.solve(np.linalg.qr(A, mode="r"), np.eye(6))
    sigma = found.facts["noise_level"]
    assert np.linalg.norm(found.posterior.std, axis=0) == pytest.approx(sigma * np.linalg.norm(half, axis=1), rel=1e-6)
    assert found.residual[0] + 1j * found.residual[1] == pytest.approx(
        SEEN - MODEL.frf([F])[0] @ expected, abs=1e-9 * np.abs(SEEN).max()
    )
    assert found.facts["frequency"] == F
    assert "rank" in found.summary(details=True)
    assert len(found.plot("field").axes) > 0
    with pytest.raises(InputError, match="no estimate of a frequency line"):
        complex_load(replace(found, axis=Axis("frame", "", np.arange(2.0))))


def test_a_line_without_regularisation_and_in_other_units():
    free = HarmonicInversion(MODEL, F, choice=0.0, noise=LEVEL).estimate(AMPLITUDES)
    assert complex_load(free) == pytest.approx(LINE, abs=1e-6)
    by_name = dict(zip([s.label for s in GAUGES], SEEN, strict=True))
    reference = HarmonicInversion(MODEL, F, noise=LEVEL).estimate(by_name)
    for factor in (1e-6, 1e6):
        h = ImpulseModel(MODEL.impulse_response(DT, 4000) * factor, DT, kind="held")
        same = ImpulseModel(MODEL.impulse_response(DT, 4000), DT, kind="held")
        a, b = (HarmonicInversion(m, F, noise=k * LEVEL).estimate(k * SEEN) for m, k in ((h, factor), (same, 1.0)))
        assert a.load == pytest.approx(b.load, abs=1e-9 * np.abs(b.load).max())
    assert np.linalg.norm(complex_load(reference) - LINE) < np.linalg.norm(LINE)
    with pytest.raises(NotIdentifiable, match="rank 3 of 6"):
        HarmonicInversion(MODEL, F, choice=0, sensors=[0, 1, 2]).estimate(SEEN[:3])


def test_the_motion_on_a_line_is_that_of_the_response():
    beam = BEAM.with_damping(damping.Rayleigh(0.5, 1e-4))
    model = ForwardModel(beam, [sensors.Displacement(at=0.7)], HATS)
    found = harmonic_motion(model, LINE, F)
    assert found.imbalance() < 1e-9
    row = sensors.Displacement(at=0.7).row(beam)
    assert row @ found.displacement == pytest.approx((model.frf([F])[0] @ LINE)[0], rel=1e-8)
    with pytest.raises(InputError, match="matrices that stay"):
        harmonic_motion(MODEL, LINE, F)


@pytest.mark.parametrize(
    ("given", "says"),
    [(SEEN[:5], "do not fit"), (SEEN * np.nan, "NaN"), ({"nobody": 1.0}, "no amplitude"), (["a"] * 8, "no numbers")],
)
def test_bad_amplitudes(given, says):
    with pytest.raises(InputError, match=says):
        HarmonicInversion(MODEL, F, noise=LEVEL).estimate(given)


def test_bad_lines():
    with pytest.raises(InputError, match="frequency"):
        HarmonicInversion(MODEL, -1.0)
    with pytest.raises(InputError, match="noise does not fit"):
        HarmonicInversion(MODEL, F, noise=[1.0, 2.0]).estimate(SEEN)
    with pytest.raises(InputError, match="zero"):
        HarmonicInversion(MODEL, F).estimate(np.zeros(8))


# -- power ------------------------------------------------------------------------------------------------------------
def test_power_of_a_sine():
    phase, t = 0.7, np.arange(4000) * 1e-3
    assert harmonic_power([3.0], [2 * np.exp(1j * phase)]) == pytest.approx([3 * np.cos(phase)])
    q, v = 3 * np.cos(2 * np.pi * 10 * t), 2 * np.cos(2 * np.pi * 10 * t + phase)
    found = mean_power(q[:, None], v[:, None], 1e-3, 0.8)
    assert found[1000:3000] == pytest.approx(3 * np.cos(phase), rel=1e-4)
    assert found == pytest.approx(3 * np.cos(phase), rel=0.1)
    with pytest.raises(InputError, match="window"):
        mean_power(q[:, None], v[:, None], 1e-3, 5.0)
    with pytest.raises(InputError, match="do not fit each other"):
        mean_power(q[:, None], v, 1e-3, 0.1)


class TestAddedPenalties:
    """The penalties in time and space added: against the dense problem that stacks them as they are written."""

    RATIO = 0.2

    def dense(self, time, lam, seen=slice(None)):
        """Load and std of ``|y - H g|^2 + lam^2 (|(L_t x S) g|^2 + ratio^2 |W g|^2)``."""
        S = np.linalg.cholesky(np.asarray(HATS.mass.toarray(), float)).T
        S = S * np.sqrt(len(S)) / np.linalg.norm(S)
        W = spatial.root("gradient", LENGTH, len(HATS), HATS, 6)
        A = (toeplitz(MODEL.impulse_response(DT, N)).reshape(-1, N * 6) / np.tile(NOISE, N)[:, None])[seen]
        steps = np.eye(N) if time == "identity" else np.diff(np.eye(N), n=2 if "second" in time else 1, axis=0)
        stack = np.vstack([A, lam * np.kron(steps, S), lam * self.RATIO * np.kron(np.eye(N), W)])
        y = (RECORD / NOISE).ravel()[seen]
        load = np.linalg.lstsq(stack, np.concatenate([y, np.zeros(len(stack) - len(y))]), rcond=None)[0]
        half = np.linalg.qr(stack, mode="r")
        return load.reshape(N, 6), np.linalg.norm(np.linalg.solve(half, np.eye(len(half))), axis=1).reshape(N, 6)

    def family(self, **settings):
        asked = {"space": "gradient", "length": LENGTH, "ratio": self.RATIO, "choice": 0.02, "noise": NOISE}
        return FieldDeconvolution(MODEL, **folded(FieldDeconvolution, {**asked, **settings}))

    @pytest.mark.parametrize("path", ["dense", "statespace"])
    @pytest.mark.parametrize("time", ["identity", "first_difference", "second_difference"])
    def test_the_load_is_that_of_the_dense_problem(self, time, path):
        found = self.family(time=time, path=path).estimate(RECORD, DT)
        load, std = self.dense(time, found.choice.lam * found.choice.scale)
        assert found.load == pytest.approx(load, abs=1e-7 * np.abs(load).max())
        assert found.posterior.std == pytest.approx(found.facts["noise_level"] * std, rel=1e-6)
        w = RNG.standard_normal(found.load.shape)
        back = from_arrays(found.posterior.to_arrays())
        assert back.variance(w) == pytest.approx(found.posterior.variance(w), rel=1e-9)
        assert "the two added" in found.provenance["prior"]

    def test_missing_samples(self):
        seen = np.random.default_rng(5).random(RECORD.shape) > 0.1
        found = self.family(time="first_difference").estimate(np.where(seen, RECORD, np.nan), DT)
        load, std = self.dense("first_difference", found.choice.lam * found.choice.scale, seen.ravel())
        assert found.load == pytest.approx(load, abs=1e-7 * np.abs(load).max())
        assert found.posterior.std == pytest.approx(found.facts["noise_level"] * std, rel=1e-6)

    def test_one_lambda_is_chosen_for_both(self):
        """By the rules, and the same from either path; the units of the record do not matter."""
        first, second = (self.family(time="first_difference", choice=None, path=p).estimate(RECORD, DT)
                         for p in ("dense", "statespace"))  # fmt: skip
        assert second.choice.lam == pytest.approx(first.choice.lam, rel=1e-2)
        assert np.linalg.norm(first.load - TRUTH) < 0.8 * np.linalg.norm(TRUTH)
        h = MODEL.impulse_response(DT, N)
        small = FieldDeconvolution(ImpulseModel(1e-6 * h, DT, kind="held"), space=np.diff(np.eye(6), axis=0), ratio=0.2,
                                   time="first_difference", noise=1e-6 * NOISE)  # fmt: skip
        own = FieldDeconvolution(ImpulseModel(h, DT, kind="held"), space=np.diff(np.eye(6), axis=0), ratio=0.2,
                                 time="first_difference", noise=NOISE)  # fmt: skip
        load = own.estimate(RECORD, DT).load
        assert small.estimate(1e-6 * RECORD, DT).load == pytest.approx(load, abs=1e-9 * np.abs(load).max())

    def test_what_does_not_fit_is_refused(self):
        with pytest.raises(InputError, match="ratio stands between"):
            FieldDeconvolution(MODEL, ratio=0.1)
        with pytest.raises(InputError, match="ratio must be positive"):
            FieldDeconvolution(MODEL, space="gradient", ratio=0.0)
        with pytest.raises(InputError, match="two penalties"):
            FieldDeconvolution(MODEL, space="gradient", size=0.1)
        with pytest.raises(InputError, match="does not know this setting"):
            self.family(path="toeplitz").estimate(RECORD, DT)
