"""Options of static inversion together: frames of their own, frozen inverses, measured resultants, functionals."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import Absolute, InputError, Lambda, Noise, NotIdentifiable, Record, StaticInversion, load
from loadid._families.frozen import Frozen
from loadid.constraints import Bounds, NonNegative, Resultant, Support
from structures import Channel, ForwardModel, MatrixModel, bases, beams

from .test_static import BEAM, bump, gauges, smooth

LEVEL = 1e-3 * np.linspace(0.3, 3, 16)  # noise that differs from sensor to sensor


def readings(seed=0, level=1e-3):
    model = smooth()
    return model, model.H @ bump() + level * np.random.default_rng(seed).standard_normal(16)


# -- frames with a lambda each ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("constraints", [(), (NonNegative(),)])
def test_frames_of_their_own_keep_their_posteriors(tmp_path, constraints):
    model, y = readings()
    family = StaticInversion(model, noise=1e-3, constraints=constraints)
    each = family.estimate(np.stack([y, 2 * y, readings(1)[1]]), joint=False)
    alone = family.estimate(readings(1)[1])
    w = np.zeros((3, 24))
    w[2] = 1.0
    assert each.functional(w).std == pytest.approx(alone.functional("sum").std, rel=1e-9)
    both = each.functional(np.ones((3, 24))).noise_std
    apart = [family.estimate(x).functional("sum").noise_std for x in (y, 2 * y, readings(1)[1])]
    assert both == pytest.approx(np.linalg.norm(apart), rel=1e-9)  # noise of different frames is independent
    each.save(tmp_path / "frames.h5")
    back = load(tmp_path / "frames.h5")
    assert back.functional(w) == each.functional(w)
    assert type(back.posterior) is type(each.posterior)
    assert back.posterior.approximation == each.posterior.approximation
    if not constraints:
        assert each.functional(w, limit=2.0).bias_limit == pytest.approx(alone.functional("sum", limit=2.0).bias_limit)
        assert back.functional(w, limit=2.0) == each.functional(w, limit=2.0)


def test_frames_of_their_own_on_a_basis_have_a_summary():
    beam = beams.cantilever(**BEAM)
    model = ForwardModel(beam, gauges(10), bases.patches(beam, 8))
    y = model.static() @ np.linspace(1, 2, 8)
    each = StaticInversion(model, penalty="gradient").estimate(np.stack([y, 1.5 * y]), joint=False)
    assert "resultants" in each.summary(details=True)


def test_the_bias_under_constraints_stays_unknown_in_a_file(tmp_path):
    model, y = readings()
    held = StaticInversion(model, noise=1e-3, constraints=[NonNegative()]).estimate(y)
    held.save(tmp_path / "held.h5")
    for estimate in (held, load(tmp_path / "held.h5")):
        assert estimate.posterior.approximation == "draws by randomise-then-optimise"
        with pytest.raises(InputError, match="resolution"):
            estimate.functional("sum", limit=1.0)


# -- frozen -----------------------------------------------------------------------------------------------------------
def test_without_a_noise_level_a_frozen_inverse_has_no_std(tmp_path):
    model, y = readings()
    frozen = StaticInversion(model, choice=1e-2).freeze()
    np.testing.assert_allclose(frozen(y), StaticInversion(model, choice=1e-2).estimate(y).load, rtol=1e-9, atol=1e-12)
    assert frozen.std is None
    frozen.save(tmp_path / "inverse.h5")
    assert Frozen.read(tmp_path / "inverse.h5").std is None


def test_measured_resultants_need_a_noise_level_to_be_frozen():
    total = Resultant(np.ones((1, 24)), [9.0], covariance=[[0.5]])
    model, y = readings()
    with pytest.raises(InputError, match="noise"):
        StaticInversion(model, choice=1e-2, constraints=total).freeze()
    family = StaticInversion(model, choice=1e-2, constraints=total, noise=1e-3)
    np.testing.assert_allclose(family.freeze()(y), family.estimate(y).load, rtol=1e-9, atol=1e-12)


def test_a_frozen_inverse_keeps_the_noise_that_the_records_told():
    model, rng = smooth(), np.random.default_rng(0)
    channels = [Channel(label=f"s{i}", quantity="displacement", unit="m", noise=x) for i, x in enumerate(LEVEL)]
    ramp = np.outer(np.linspace(0, 1, 40), model.H @ bump())
    records = [Record((k + 1) * ramp + LEVEL * rng.standard_normal((40, 16)), 0.01, channels) for k in range(2)]
    family = StaticInversion(model)
    calibration = family.calibrate(records)
    frozen, estimate = family.freeze(), family.estimate(records[0])
    np.testing.assert_allclose(frozen(records[0].values[-1]), estimate.load[-1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(frozen.std, estimate.posterior.std[-1] / estimate.facts["noise_level"], rtol=1e-9)
    assert frozen.delta_source == calibration.sigma_source == estimate.facts["noise_source"]


def test_readings_of_a_singular_covariance_freeze():
    """Nothing but zeros is in the range of every interpolation."""
    rng = np.random.default_rng(0)
    W, H = np.diff(np.eye(6), axis=0).T, rng.standard_normal((5, 8))
    model = MatrixModel(W @ H)
    y = W @ (H @ bump(8) + 1e-3 * rng.standard_normal(5))
    family = StaticInversion(model, choice=1e-2, noise=Noise(1e-3, interpolation=W))
    np.testing.assert_allclose(family.freeze()(y), family.estimate(y).load, rtol=1e-8, atol=1e-12)


# -- measured resultants without a noise level ------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(3))
def test_measured_resultants_are_weighed_against_the_noise_that_is_seen(seed):
    model, y = readings(seed)
    total = Resultant(np.ones((1, 24)), [bump().sum()], covariance=[[0.04]])
    known = StaticInversion(model, choice=1e-2, constraints=total, noise=1e-3).estimate(y)
    free = StaticInversion(model, choice=1e-2, constraints=total).estimate(y)
    assert 0.5 < free.functional("sum").std / known.functional("sum").std < 2.5
    np.testing.assert_allclose(free.load.sum(), known.load.sum(), atol=0.05)


# -- functionals ------------------------------------------------------------------------------------------------------
def test_sums_and_means_over_loads():
    model, y = readings()
    frames = StaticInversion(model, noise=1e-3).estimate(np.stack([y, 2 * y]))
    assert frames.functional("sum").value == pytest.approx(frames.load[-1].sum())
    beam = beams.cantilever(**BEAM)
    edges = [0.0, 0.2, 0.5, 1.0, 2.0]
    pressures = ForwardModel(beam, gauges(10), bases.patches(beam, edges))
    forces = ForwardModel(beam, gauges(10), bases.nodal(beam, (0.2, 2.0)))
    for found, weights in (
        (pressures, np.diff(edges) / 2.0),
        (forces, np.full(len(forces.loads), 1 / len(forces.loads))),
    ):
        e = StaticInversion(found, noise=1e-6).estimate(found.static() @ np.linspace(1, 2, len(found.loads)))
        assert e.functional("mean").value == pytest.approx(weights @ e.load)
    smooth_loads = ForwardModel(beam, gauges(10), bases.polynomials(beam, 3))
    e = StaticInversion(smooth_loads, noise=1e-6).estimate(smooth_loads.static() @ np.ones(4))
    with pytest.raises(InputError, match="first coefficient"):
        e.functional("mean")


def test_a_load_that_a_constraint_holds_has_a_band():
    model, y = readings()
    held = StaticInversion(model, noise=1e-3, constraints=[NonNegative()]).estimate(y)
    assert np.any(held.load == 0)
    assert np.all(held.std > 0)
    assert "under the constraints, by draws" in held.facts["band"]


def test_many_constrained_values_have_the_band_of_the_active_face():
    model, y = readings()
    many = StaticInversion(model, noise=1e-3, constraints=[NonNegative()]).estimate(np.stack([y] * 20))
    assert np.any(many.std == 0)
    assert "does not say that it is known" in many.summary(details=True)


# -- without regularisation -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("constraint", [NonNegative(), Bounds(lower=-10, upper=10), Support(np.arange(6))])
def test_bounds_do_not_determine_a_load(constraint):
    """Differences leave a constant open: inside its bounds it may be anything, so that a band would be a lie."""
    H = np.diff(np.eye(6), axis=0)
    with pytest.raises(NotIdentifiable, match="rank 5 of 6"):
        StaticInversion(MatrixModel(H), penalty=None, noise=0.1, constraints=constraint).estimate(H @ np.arange(6.0))


@pytest.mark.parametrize(
    "constraint", [Resultant(np.ones((1, 6)), [15.0]), Resultant(np.ones((1, 6)), [15.0], covariance=[[0.1]]),
                   Support([1, 2, 3, 4, 5])],
)  # fmt: skip
def test_a_resultant_or_a_support_may_determine_it(constraint):
    H = np.diff(np.eye(6), axis=0)
    found = StaticInversion(MatrixModel(H), penalty=None, noise=0.1, constraints=constraint)
    np.testing.assert_allclose(found.estimate(H @ np.arange(6.0)).load, np.arange(6.0), atol=1e-8)


def test_signs_that_the_data_push_against_determine_the_rest():
    model, y = readings()
    found = StaticInversion(model, penalty=None, noise=1e-3, constraints=[NonNegative()]).estimate(y)
    assert found.load.min() >= 0
    assert np.sum(found.load > 0) <= 16


# -- what a stream of readings needs ----------------------------------------------------------------------------------
def test_a_frozen_solver_takes_new_resultants() -> None:
    x = (np.arange(24) + 0.5) / 24
    H = 0.1 / np.pi / (0.01 + (x[:, None] - x) ** 2) / 24
    y = H @ np.exp(-(((x - 0.5) / 0.1) ** 2))
    total = np.ones((1, 24))
    held = StaticInversion(H, noise=1e-3, choice=1e-2, constraints=[NonNegative(), Resultant(total, [4.0])]).freeze()
    for value in (4.0, 4.5, 3.8):
        load = held(y, resultants=[[value]])
        assert load.sum() == pytest.approx(value, rel=1e-9)
        assert load.min() >= -1e-12
    free = StaticInversion(H, noise=1e-3, choice=1e-2).freeze()
    with pytest.raises(InputError, match="no resultant"):
        free(y, resultants=[[4.0]])


def test_an_absolute_lambda_can_be_frozen() -> None:
    H = np.random.default_rng(0).standard_normal((8, 5))
    family = StaticInversion(H, noise=1.0, choice=Absolute(0.5))
    y = np.arange(8.0)
    np.testing.assert_allclose(family.freeze()(y), family.estimate(y).load, rtol=1e-9)


def test_weights_that_could_mean_two_things_are_refused() -> None:
    H = np.random.default_rng(0).standard_normal((8, 5))
    square = StaticInversion(H, noise=1.0).estimate(np.ones((5, 8)))
    with pytest.raises(InputError, match="same length"):
        square.functional(np.ones(5))


# -- draws ------------------------------------------------------------------------------------------------------------
def test_draws_reproduce_the_posterior() -> None:
    model, y = readings()
    family = StaticInversion(model, noise=1e-3, choice=2e-2)
    estimate, drawn = family.estimate(y), family.sample(y, 4000)
    assert drawn.shape == (4000, 24)
    np.testing.assert_allclose(drawn.mean(axis=0), estimate.load, atol=5 * estimate.posterior.std.max() / 60)
    np.testing.assert_allclose(drawn.std(axis=0), estimate.posterior.std, rtol=0.1)
    frames = family.sample(np.stack([y, 2 * y]), 50)
    assert frames.shape == (50, 2, 24)


def test_a_truncated_inverse_gives_draws_of_its_band() -> None:
    model, y = readings()
    family = StaticInversion(model, noise=1e-3, choice=Lambda("gcv", method="tsvd"))
    np.testing.assert_allclose(family.sample(y, 4000).std(axis=0), family.estimate(y).posterior.std, rtol=0.1)


def test_draws_meet_the_constraints_and_cover_more_than_the_face() -> None:
    """A bump with p >= 0: the band of the draws has a width where loads are held."""
    model, y = readings(level=1e-2)
    family = StaticInversion(model, noise=1e-2, constraints=NonNegative())
    drawn = family.sample(y, 400)
    assert drawn.min() >= 0
    held = family.estimate(y).load == 0
    assert np.any(held)
    assert np.all(drawn.std(axis=0)[held] > 0)
    assert np.mean(np.quantile(drawn, 0.975, axis=0)[held] > 0) > 0.8
    for wrong in (0, -1, 2.5, True, "many"):
        with pytest.raises(InputError, match="draws"):
            family.sample(y, wrong)
