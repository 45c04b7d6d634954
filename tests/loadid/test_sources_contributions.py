"""Contributions against superposition, closed forms, simulated draws and the mean square of the signals."""

from dataclasses import replace

import numpy as np
import pytest

from loadid import LoadEstimate
from loadid._results.estimate import Axis
from loadid.sources import contributions, synthesise
from structures import ForwardModel, InputError, chains, loads, sensors
from tests.loadid import sourced
from tests.loadid.made import Gaussian
from tests.loadid.sourced import LINES, densities, estimated, table

H = sourced.receiver()
MODEL = table(H)
F = sourced.spectra(len(LINES), 2) * [3.0, 1.0]


def test_superposition_of_two_loads():
    c = contributions(MODEL, estimated(F))
    np.testing.assert_allclose(c.values[..., 0], H[..., 0] * F[:, :1], rtol=1e-12)
    np.testing.assert_allclose(c.values.sum(axis=2), c.total, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(c.total, np.einsum("lij,lj->li", H, F), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(c.projected.sum(axis=2), np.abs(c.total) ** 2, rtol=1e-9, atol=1e-12)
    assert c.units == ("m/s^2",) * 4
    shares = c.shares()
    alone = np.sum(np.abs(c.values) ** 2, axis=0)
    np.testing.assert_allclose(shares.share[0], alone / alone.sum(axis=1, keepdims=True), rtol=1e-12)
    np.testing.assert_allclose(shares.in_phase.sum(axis=2), 1, rtol=1e-12)
    np.testing.assert_allclose(shares.rms[0] ** 2, np.sum(np.abs(c.total) ** 2, axis=0), rtol=1e-12)


def test_an_oscillator_with_two_loads_on_one_mass():
    f = np.array([3.0, 7.0, 20.0])
    m, k, d = 2.0, 4e3, 5.0
    w = 2 * np.pi * f
    closed = -(w**2) / (k - m * w**2 + 1j * w * d)
    body = chains.oscillator(mass=m, stiffness=k, dashpot=d)
    dof = "1+X"
    model = ForwardModel(
        body,
        [sensors.Accelerometer(dof)],
        [loads.Point(dof, label="left"), loads.Point(dof, label="right")],
    )
    for factor, level in ((1.0, 10 * np.log10(2)), (-0.9, 10 * np.log10(0.01 / 1.81))):
        e = estimated(np.outer([1.0, 2j, -3.0], [1.0, factor]), f=f, labels=["left", "right"])
        c = contributions(model, e)
        np.testing.assert_allclose(c.total[:, 0], closed * [1.0, 2j, -3.0] * (1 + factor), rtol=1e-9)
        shares = c.shares()
        np.testing.assert_allclose(shares.share[0, 0], np.array([1, factor**2]) / (1 + factor**2), rtol=1e-9)
        np.testing.assert_allclose(shares.in_phase[0, 0], np.array([1, factor]) / (1 + factor), rtol=1e-6)
        assert shares.interference[0, 0] == pytest.approx(level, abs=1e-6)
        assert ("the loads cancel" in str(c)) == (factor < 0)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_shares_do_not_depend_on_units(scale):
    one, two = contributions(MODEL, estimated(F, 0.1)), contributions(table(scale * H), estimated(F, 0.1))
    for fraction in (None, 1, 3):
        a, b = one.shares(fraction), two.shares(fraction)
        np.testing.assert_allclose(b.share, a.share, rtol=1e-9)
        np.testing.assert_allclose(b.in_phase, a.in_phase, rtol=1e-9)
        np.testing.assert_allclose(b.uncertain, a.uncertain, rtol=1e-9)
        np.testing.assert_allclose(b.interference, a.interference, atol=1e-9)
        np.testing.assert_allclose(b.rms, scale * a.rms, rtol=1e-9)


def test_loads_are_found_by_their_names_and_sensors_as_asked():
    turned = estimated(F[:, ::-1], [0.2, 0.1], labels=["f1", "f0"])
    straight = estimated(F, [0.1, 0.2])
    a, b = contributions(MODEL, turned, ["a3", 0]), contributions(MODEL, straight)
    np.testing.assert_allclose(a.values, b.values[:, [3, 0]])
    np.testing.assert_allclose(a.std, b.std[:, [3, 0]])
    assert [s.label for s in a.sensors] == ["a3", "a0"]
    assert a.ranking("a0") == b.ranking("a0")
    assert a.ranking("a0")[0][0] == "f0"


def test_bands_hold_what_the_lines_hold():
    c = contributions(MODEL, estimated(F))
    whole, banded = c.shares(), c.shares(3)
    np.testing.assert_allclose(np.sum(banded.rms**2, axis=0), whole.rms[0] ** 2, rtol=1e-9)
    k = banded.bands.names.index("40")
    inside = (banded.bands.lower[k] <= LINES) & (banded.bands.upper[k] > LINES)
    power = np.sum(np.abs(c.values[inside]) ** 2, axis=0)
    np.testing.assert_allclose(banded.share[k], power / power.sum(axis=1, keepdims=True), rtol=1e-9)


# -- cross spectra ----------------------------------------------------------------------------------------------------
def test_loads_that_do_not_correlate_add_in_power():
    S = np.zeros((len(LINES), 2, 2), complex)
    S[:, 0, 0], S[:, 1, 1] = 4.0, 1.0
    c = contributions(MODEL, densities(S))
    np.testing.assert_allclose(c.total, np.abs(H[..., 0]) ** 2 * 4 + np.abs(H[..., 1]) ** 2, rtol=1e-12)
    np.testing.assert_allclose(c.coherent, 0, atol=1e-12 * c.total.max())
    np.testing.assert_allclose(c.shares(3).interference, 0, atol=1e-9)
    assert c.units[0] == "(m/s^2)^2/Hz"
    # a density of 1 (m/s^2)^2/Hz over the lines has their width as mean square
    np.testing.assert_allclose(c.shares().rms[0] ** 2, c.total.sum(axis=0) * 0.5, rtol=1e-12)


def test_one_coherent_source_gives_what_amplitudes_give():
    S = np.einsum("lj,lk->ljk", F, F.conj())
    a, b = contributions(MODEL, densities(S)), contributions(MODEL, estimated(F))
    np.testing.assert_allclose(a.total, np.abs(b.total) ** 2, rtol=1e-9, atol=1e-9 * a.total.max())
    np.testing.assert_allclose(a.values, np.abs(b.values) ** 2, rtol=1e-9)
    np.testing.assert_allclose(a.projected, b.projected, atol=1e-9 * a.total.max())
    parts = np.abs(b.values) ** 2
    np.testing.assert_allclose(a.coherent, np.abs(b.total) ** 2 - parts.sum(axis=2), atol=1e-9 * a.total.max())


# -- what the loads leave open ----------------------------------------------------------------------------------------
def test_std_of_amplitudes_is_that_of_draws():
    rng, draws, pick = np.random.default_rng(3), 20000, [10, 60, 150]
    f, G = LINES[pick], H[pick]
    A = sourced.spectra(3, 4, seed=4).reshape(3, 2, 2)
    C = 0.01 * np.einsum("ljk,lik->lji", A, A.conj())  # correlated errors
    std = np.sqrt(np.einsum("ljj->lj", C).real)
    variance = 1e-4 * np.abs(G) ** 2
    e = estimated(F[pick], std, f, covariance=C)
    response = synthesise(table(G, f, variance=variance), e)
    e_draw = 0.1 * np.einsum("ljk,dlk->dlj", A, _circular(rng, (draws, 3, 2)))
    h_draw = np.sqrt(variance) * _circular(rng, (draws, *G.shape))
    y = np.einsum("dlij,lj->dli", h_draw, F[pick]) + np.einsum("lij,dlj->dli", G, e_draw)
    np.testing.assert_allclose(response.std, np.sqrt(np.mean(np.abs(y) ** 2, axis=0)), rtol=0.03)
    # without the covariance errors are taken as uncorrelated, which here is another number
    loose = synthesise(table(G, f, variance=variance), estimated(F[pick], std, f))
    assert np.max(np.abs(loose.std / response.std - 1)) > 0.1
    c = contributions(table(G, f, variance=variance), e)
    each = h_draw * F[pick][:, None] + G * e_draw[:, :, None]
    np.testing.assert_allclose(c.std, np.sqrt(np.mean(np.abs(each) ** 2, axis=0)), rtol=0.03)


def test_std_of_densities_is_that_of_draws():
    rng, draws, pick = np.random.default_rng(5), 20000, [10, 60]
    f, G = LINES[pick], H[pick]
    S = np.einsum("ljk,lik->lji", A := sourced.spectra(2, 4, seed=6).reshape(2, 2, 2), A.conj())
    std, variance = np.array([[0.05, 0.02], [0.01, 0.1]]), 1e-5 * np.abs(G) ** 2
    model = table(G, f, variance=variance)
    c, whole = contributions(model, densities(S, std, f)), synthesise(model, densities(S, std, f))
    noisy = np.broadcast_to(S, (draws, *S.shape)).copy()
    for j in range(2):
        noisy[:, :, j, j] += std[:, j] * rng.standard_normal((draws, 2))
    h = G + np.sqrt(variance) * _circular(rng, (draws, *G.shape))
    total = np.einsum("dlij,dljk,dlik->dli", h, noisy, h.conj()).real
    np.testing.assert_allclose(whole.std, total.std(axis=0), rtol=0.05)
    alone = np.abs(h) ** 2 * np.einsum("dljj->dlj", noisy).real[:, :, None]
    np.testing.assert_allclose(c.std, alone.std(axis=0), rtol=0.05)


def test_a_load_within_its_own_std_is_said_to_be():
    rng = np.random.default_rng(7)
    quiet = F * [1.0, 0.0] + 0.5 * _circular(rng, F.shape) * [0.0, 1.0]
    words = contributions(MODEL, estimated(quiet, [0.01, 0.5])).table()
    assert all("f1" in line.split("(within its own std)")[0].split(",")[-1] for line in words.splitlines())
    assert "within" not in contributions(MODEL, estimated(F, 0.01)).table()


def test_lines_that_are_not_trusted_do_not_count_where_that_is_asked():
    std = np.full(F.shape, 0.01)
    std[40:50, 1] = 1e5
    wild = F.copy()
    wild[40:50, 1] *= 1e4  # an antiresonance that blew up
    e = estimated(wild, std)
    blind, careful = contributions(MODEL, e), contributions(MODEL, e, trust=0.3)
    assert blind.ranking()[0][0] == "f1"
    assert careful.ranking()[0][0] == "f0"
    assert "10 of 192 lines are uncertain by more than 50% and count" in str(blind)
    assert "10 of 192 lines left out" in str(careful)
    keep = np.delete(np.arange(len(LINES)), np.arange(40, 50))
    assert careful.trusted[keep].mean() > 0.99
    expected = np.sum(np.abs(careful.total) ** 2 * careful.trusted, axis=0)
    np.testing.assert_allclose(careful.shares().rms[0] ** 2, expected, rtol=1e-9)
    np.testing.assert_allclose(np.sum(careful.shares(3).rms ** 2, axis=0), expected, rtol=1e-9)
    k = careful.shares(3).bands.names.index("25")
    assert careful.shares(3).coverage[k].max() < 0.6 < blind.shares(3).coverage[k].min()
    with pytest.raises(InputError, match="no line is left"):
        contributions(MODEL, e, trust=1e-6)
    with pytest.raises(InputError, match="trusted, not samples"):
        contributions(BODY, history(), trust=0.1)


# -- over time --------------------------------------------------------------------------------------------------------
DT, N = 2e-3, 250
BODY = ForwardModel(
    chains.chain(masses=[1.0, 1.0, 0.5], springs=[4e4, 3e4, 2e4], dashpots=6.0),
    [sensors.Accelerometer("1+X"), sensors.Displacement("3+X")],
    [loads.Point("2+X"), loads.Point("3+X")],
)


def history(seed=0, **changes):
    g = np.cumsum(np.random.default_rng(seed).standard_normal((N, 2)), axis=0) * [1.0, 0.3]
    names = [c.label for c in BODY.loads]
    settings = {"load": g, "std": np.full(g.shape, 0.1), "labels": names, "units": ["N"] * 2,
                "axis": Axis("time", "s", np.arange(N) * DT)}  # fmt: skip
    return LoadEstimate(**(settings | changes))


def test_histories_superpose_and_their_bands_add_to_the_mean_square():
    e = history()
    c = contributions(BODY, e)
    whole = BODY.predict(e.load, DT)
    np.testing.assert_allclose(c.total, whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())
    np.testing.assert_allclose(c.values[..., 1], BODY.predict(e.load * [0, 1], DT), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(c.shares().rms[0], whole.std(axis=0), rtol=1e-9)
    np.testing.assert_allclose(c.shares().share[0], c.values.var(axis=0) / c.values.var(axis=0).sum(1)[:, None])
    np.testing.assert_allclose(c.shares().in_phase.sum(axis=2), 1, rtol=1e-9)
    assert c.std is None


def test_std_of_histories_is_that_of_draws():
    rng = np.random.default_rng(8)
    root = 0.05 * np.tril(np.exp(-0.1 * np.arange(2 * N)))  # errors that correlate in time and between the loads
    root = root + 0.1 * np.diag(rng.uniform(0.5, 1, 2 * N))
    e = history(posterior=Gaussian(root @ root.T))
    c = contributions(BODY, e, points=4)
    assert c.points.tolist() == [61, 124, 187, 249]
    draws = 400
    errors = (root @ rng.standard_normal((2 * N, draws))).T.reshape(draws, N, 2)
    alone = np.array([[BODY.predict(x * pick, DT)[c.points] for pick in ([1, 0], [0, 1])] for x in errors])
    np.testing.assert_allclose(np.moveaxis(alone.std(axis=0), 0, 2), c.std, rtol=0.15)
    np.testing.assert_allclose(alone.sum(axis=1).std(axis=0), c.total_std, rtol=0.15)
    np.testing.assert_allclose(synthesise(BODY, e, points=4).std, c.total_std, rtol=1e-12)
    biased = replace(e, bias=np.full((N, 2), 50.0))
    hidden = np.abs(BODY.predict(biased.bias, DT)[c.points])
    np.testing.assert_allclose(synthesise(BODY, biased, points=4).std, np.maximum(c.total_std, hidden), rtol=1e-9)


def test_what_was_measured_comes_along():
    y = BODY.predict(history().load, DT)
    names = [s.label for s in BODY.sensors]
    e = history(response=y[:, :1], residual=np.zeros((N, 1)), sensors=names[:1], sensor_units=["m/s^2"])
    one, two = contributions(BODY, e).measured
    np.testing.assert_array_equal(one, y[:, 0])
    assert two is None


# -- bad input --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("estimate", "match"),
    [
        (LoadEstimate(load=[1.0], std=[0.1], labels=["f0"], units=["N"]), "static"),
        (estimated(np.abs(F)), "autospectra alone"),
        (estimated(F[:, :1]), "different loads"),
        (estimated(F, units=["N", "N*m"]), "unit of a load"),
        (estimated(F, f=LINES + 0.1), "line"),
        (estimated(F, covariance=np.eye(2)), "no matrix"),
    ],
)
def test_loads_that_do_not_fit_are_refused(estimate, match):
    with pytest.raises(InputError, match=match):
        contributions(MODEL, estimate)


@pytest.mark.parametrize("asked", ["b7", 4, [], True])
def test_sensors_that_are_not_there_are_refused(asked):
    with pytest.raises(InputError):
        contributions(MODEL, estimated(F), asked)


def _circular(rng, shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)
