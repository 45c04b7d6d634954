"""Diagnostics: conditioning with its rank, widths of known shapes, resolution of known operators."""

import numpy as np
import pytest
import scipy.linalg

from loadid._inverse.convolved.path import SpectralPath
from loadid._inverse.diagnosis import diagnose, identifiability
from loadid.paths import LinearProblem, SVDPath, toeplitz
from structures._testing.spectra import padded_length
from structures.errors import InputError, NotIdentifiable

FWHM = 2 * np.sqrt(2 * np.log(2))


@pytest.mark.parametrize("std", [1.0, 2.5, 7.0])
@pytest.mark.parametrize("centre", [40, 43])
def test_width_of_a_gaussian(std: float, centre: int) -> None:
    t = np.arange(100)
    spread = -3 * np.exp(-0.5 * ((t - centre) / std) ** 2)
    assert identifiability.width(spread, centre) == pytest.approx(FWHM * std, rel=0.06)  # linear between samples


def test_width_is_local_at_least_one_sample_and_at_most_what_is_there() -> None:
    spike = np.zeros(20)
    spike[7] = 2.0
    assert identifiability.width(spike, 7) == 1.0
    two = spike.copy()
    two[15] = 2.0  # a second peak far away does not widen the first
    assert identifiability.width(two, 7) == 1.0
    assert identifiability.width(np.ones(20), 7) == 21.0


def test_layout_tells_lost_modes_from_a_better_condition() -> None:
    s = np.array([10.0, 5.0, 1e-3])
    assert identifiability.layout(s, 3) == (pytest.approx(1e4), 3, 0)
    kappa, rank, nullity = identifiability.layout(np.array([10.0, 5.0, 1e-17]), 4)  # kappa fell because a mode was lost
    assert (kappa, rank, nullity) == (pytest.approx(2.0), 2, 2)


def gaussian(n: int, std: float) -> np.ndarray:
    t = np.arange(n)
    return scipy.linalg.toeplitz(np.exp(-0.5 * (t / std) ** 2))


def test_resolution_follows_the_blur_and_the_noise() -> None:
    load = np.zeros((80, 1))
    load[33] = 1.0
    path = SVDPath(LinearProblem.whitened(gaussian(80, 3.0), gaussian(80, 3.0) @ load[:, 0], shape=(80, 1)))
    widths, losses = zip(*(identifiability.resolution(path, lam, load) for lam in (1e-6, 1e-3, 0.1, 0.9)), strict=True)
    assert list(widths) == sorted(widths)
    assert list(losses) == sorted(losses)
    assert widths[-1] == pytest.approx(np.sqrt(2) * 3.0 * FWHM, rel=0.15)  # large lambda: the blur twice
    assert 0 <= losses[0] < losses[-1] < 1
    sharp = SVDPath(LinearProblem.whitened(np.eye(80), load[:, 0], shape=(80, 1)))
    assert identifiability.resolution(sharp, 1e-6, load) == (1.0, pytest.approx(0, abs=1e-9))


def test_resolution_is_the_same_on_both_paths() -> None:
    n = 120
    h = np.exp(-0.5 * ((np.arange(n) - 8) / 2.0) ** 2)[:, None, None]
    padded = padded_length(n)
    load = np.zeros((n, 1))
    load[50] = 2.0
    y = (toeplitz(h) @ load[:, 0]).reshape(n, 1)
    dense = SVDPath(LinearProblem.whitened(toeplitz(h), y, shape=(n, 1)))
    fast = SpectralPath(np.fft.rfft(h, padded, axis=0), y, np.full((padded // 2 + 1, 1), float(n)))
    for lam in (0.01, 0.2):
        a = identifiability.resolution(dense, lam, load)
        b = identifiability.resolution(fast, lam * float(dense.scale / fast.scale), load)
        np.testing.assert_allclose(b, a, rtol=0.01)


def test_resolution_of_two_loads_looks_at_the_larger() -> None:
    H = np.zeros((30, 30))
    H[:15, 0::2], H[15:, 1::2] = np.eye(15), gaussian(15, 2.0)  # first load sharp, second blurred
    load = np.zeros((15, 2))
    load[7] = [1.0, 0.5]
    path = SVDPath(LinearProblem.whitened(H, H @ load.ravel(), shape=(15, 2)))
    assert identifiability.resolution(path, 0.05, load)[0] == pytest.approx(1.0)
    assert identifiability.resolution(path, 0.05, load[:, ::-1])[0] > 2.0


# -- the whole diagnosis ----------------------------------------------------------------------------------------------
def posed(H: np.ndarray, y: np.ndarray, L: np.ndarray | None = None) -> SVDPath:
    n = H.shape[1]
    layout = (len(H),) if y.ndim == 1 else (y.shape[1], len(H))
    return SVDPath(LinearProblem(H, y, L, layout, (n,)))


def test_diagonal_operator_in_closed_form() -> None:
    s = np.array([4.0, 2.0, 1.0, 0.5])
    d = diagnose.diagnose(posed(np.diag(s), s * [1.0, -2.0, 3.0, 4.0]), 0.25, 0.1, [0.0, 0.0, 1.0, 0.0])
    f = s**2 / (s**2 + 1.0)  # relative 0.25 of 4 is 1
    np.testing.assert_allclose(d.filter_factors, f)
    np.testing.assert_allclose(d.generalised, s)
    np.testing.assert_allclose(d.coefficients, s * [1, 2, 3, 4])
    np.testing.assert_allclose(d.heights, f)
    np.testing.assert_allclose(d.matrix, np.diag(f), atol=1e-15)
    assert (d.kappa, d.rank, d.nullity) == (pytest.approx(8.0), 4, 0)
    assert (d.load, d.worst, d.width, d.width_unit) == (2, 3, 1.0, "loads")
    assert d.peak_bias == pytest.approx(0.5)
    assert d.cross_talk.max() == pytest.approx(0, abs=1e-12)
    assert d.null_share == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("frames", [1, 5])
@pytest.mark.parametrize("penalised", [False, True])
def test_the_resolution_matrix_is_what_the_path_does(frames: int, penalised: bool) -> None:
    rng = np.random.default_rng(3)
    H = gaussian(30, 2.0)[:18]
    L = np.diff(np.eye(30), axis=0) if penalised else None
    y = H @ rng.standard_normal((30, frames)) + 1e-3 * rng.standard_normal((18, frames))
    path = posed(H, y[:, 0] if frames == 1 else y, L)
    d = diagnose.diagnose(path, 0.02)
    A = np.vstack([H, 0.02 * float(path.scale) * (np.eye(30) if L is None else L)])
    R = np.linalg.lstsq(A, np.vstack([H, np.zeros((len(A) - 18, 30))]), rcond=None)[0]
    assert d.matrix is not None
    np.testing.assert_allclose(d.matrix, R, atol=1e-8)
    np.testing.assert_allclose(d.heights, np.diag(R), atol=1e-8)
    np.testing.assert_allclose(d.point_spreads, R[:, d.shown], atol=1e-8)
    assert np.sum(d.filter_factors) == pytest.approx(np.trace(R), abs=1e-8)
    assert (d.rank, d.nullity, len(d.coefficients)) == (18, 12, 18)
    assert np.sum(np.isinf(d.generalised)) == int(penalised)  # the constant meets no penalty, and stands first
    rms = np.sqrt(np.sum((path.U.T @ y) ** 2) / frames)
    assert np.linalg.norm(d.coefficients) == pytest.approx(rms)


def test_large_problems_keep_selected_columns() -> None:
    path = posed(gaussian(450, 3.0), np.ones(450))
    d = diagnose.diagnose(path, 0.05, load=np.eye(450)[101])
    assert d.matrix is None
    assert 101 in d.columns
    assert len(d.columns) < 220
    R = path.resolution(0.05)
    np.testing.assert_allclose(d.heights, np.diag(R), atol=1e-10)
    np.testing.assert_allclose(d.point_spreads, R[:, d.shown], atol=1e-10)
    assert d.width == pytest.approx(identifiability.width(R[:, 101], 101))


def test_share_of_a_load_that_no_sensor_sees() -> None:
    H = np.eye(6)[:4]
    load = np.array([3.0, 0, 0, 0, 4.0, 0])
    d = diagnose.diagnose(posed(H, np.ones(4)), 0.1, load=load)
    assert d.null_share == pytest.approx(0.8)
    assert (d.rank, d.nullity) == (4, 2)
    assert d.load == 4
    assert d.peak_bias == pytest.approx(1.0)
    assert d.width == 6.0  # nothing is shown: as wide as all there is


def noisy(factor_H: float = 1.0, factor_y: float = 1.0) -> SVDPath:
    x = (np.arange(48) + 0.5) / 48
    H = (0.1 / np.pi) / (0.1**2 + (x[:, None] - x) ** 2) / 48
    load = np.exp(-0.5 * ((x - 0.375) / 0.03) ** 2) + np.exp(-0.5 * ((x - 0.625) / 0.03) ** 2)
    y = H @ load
    return posed(factor_H * H, factor_y * (y + 1e-3 * y.max() * np.random.default_rng(0).standard_normal(48)))


@pytest.mark.parametrize(("a", "b"), [(1e6, 1.0), (1.0, 1e-9), (1e-6, 1e6)])
def test_the_diagnosis_is_scale_free(a: float, b: float) -> None:
    one, other = diagnose.diagnose(noisy(), 1e-3), diagnose.diagnose(noisy(a, b), 1e-3)
    assert other.plateau == one.plateau
    assert 15 <= one.plateau <= 30
    assert other.decay.law == one.decay.law == "exponential"
    np.testing.assert_allclose(other.widths, one.widths, rtol=1e-6)
    np.testing.assert_allclose(other.filter_factors, one.filter_factors, rtol=1e-6, atol=1e-12)
    assert other.floor == pytest.approx(b * one.floor, rel=1e-6)


def test_a_flat_spectrum_far_above_the_noise_is_no_plateau() -> None:
    y = 100.0 + np.random.default_rng(0).standard_normal(20)
    assert diagnose.diagnose(posed(np.eye(20), y), 1e-3).plateau == 0  # by the coefficients alone
    assert diagnose.diagnose(posed(np.eye(20), y), 1e-3, sigma=1.0).plateau == 20


def test_a_promise_beyond_the_data_is_refused() -> None:
    d = diagnose.diagnose(noisy(), 1e-3)
    d.require(d.plateau)
    with pytest.raises(NotIdentifiable, match=rf"i\* = {d.plateau} recoverable modes of 48"):
        d.require(d.plateau + 1)


def test_it_goes_through_plain_values_and_cannot_be_changed() -> None:
    d = diagnose.diagnose(noisy(), 1e-3, 0.1, np.ones(48))
    other = diagnose.Diagnosis.from_dict(d.to_dict())
    assert other.decay == d.decay
    np.testing.assert_array_equal(other.matrix, d.matrix)
    with pytest.raises(ValueError, match="read-only"):
        d.heights[0] = 1.0


# -- widths in metres -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shuffled", [False, True])
def test_width_on_a_line_is_in_metres(shuffled: bool) -> None:
    x = np.linspace(0, 2.0, 201)
    order = np.random.default_rng(0).permutation(201) if shuffled else np.arange(201)
    spread = np.exp(-0.5 * ((x - 0.8) / 0.1) ** 2)[order]
    place = np.column_stack([np.zeros(201), 0.6 * x, 0.8 * x])[order]  # a line in space
    own = int(np.argmax(spread))
    found = diagnose.LoadLayout.of(201, 1, {"coordinates": place})
    assert found.unit == "m"
    assert found.width(spread, own) == pytest.approx(FWHM * 0.1, rel=0.01)


def test_width_on_a_surface_and_cross_talk() -> None:
    X, Y = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    places = np.column_stack([X.ravel(), Y.ravel(), np.full(X.size, 3.0)])
    spread = np.zeros((X.size, 3))
    spread[:, 1] = np.exp(-0.5 * ((X - 0.5) ** 2 + (Y - 0.5) ** 2).ravel() / 0.1**2)
    spread[:, 1] += 0.2 * (np.hypot(X - 0.9, Y - 0.9).ravel() < 0.01)  # a ghost far away
    own = 3 * int(np.argmin(np.hypot(X - 0.5, Y - 0.5))) + 1
    geometry = {"coordinates": places, "components": ["+X", "+Y", "+Z"], "kind": "nodal"}
    found = diagnose.LoadLayout.of(3 * X.size, 1, geometry)
    assert found.dimension == 2
    wide = found.width(spread.ravel(), own)
    assert wide == pytest.approx(FWHM * 0.1, rel=0.06)
    assert found.cross_talk(spread.ravel(), own, wide) == pytest.approx(0.2, rel=1e-3)
    spread[5, 2] = 0.4  # another direction
    assert found.cross_talk(spread.ravel(), own, wide) == pytest.approx(0.4)


def test_places_of_other_loads_are_refused() -> None:
    with pytest.raises(InputError, match="not those of the loads"):
        diagnose.LoadLayout.of(10, 1, {"coordinates": np.zeros((4, 2))})


# -- refining the loads -----------------------------------------------------------------------------------------------
def blurred(loads: int, sensors: int = 60) -> np.ndarray:
    """Mean response to constant loads on equal parts of a line, each of unit resultant per root length."""
    fine = (np.arange(960) + 0.5) / 960
    at = (np.arange(sensors) + 0.5) / sensors
    kernel = np.exp(-0.5 * ((at[:, None] - fine) / 0.1) ** 2)
    return kernel.reshape(sensors, loads, -1).sum(axis=2) * np.sqrt(loads) / 960


def test_refining_adds_modes_until_the_noise_is_reached() -> None:
    eta = 1e-3
    early = identifiability.refinement(blurred(4), blurred(8), eta)
    assert early.gained > 0
    late = identifiability.refinement(blurred(40), blurred(80), eta)
    assert (late.coarse, late.fine, late.gained) == (40, 80, 0)
    assert late.after == np.sum(np.linalg.svd(blurred(80))[1] > eta * np.linalg.svd(blurred(80))[1][0])
    halved = identifiability.against_half(blurred(80), eta)
    assert (halved.coarse, halved.fine, halved.before, halved.after) == (40, 80, late.before, late.after)


def test_merging_follows_the_neighbours_that_are_given() -> None:
    H = np.eye(6)
    pairs = identifiability.against_half(H, 0.5, edges=[[0, 3], [1, 4], [2, 5]])
    assert (pairs.coarse, pairs.before, pairs.after) == (3, 3, 6)
    assert identifiability.against_half(np.eye(6), 0.5, components=2).coarse == 4  # points 0 and 1 merge, 2 stays
    with pytest.raises(InputError, match="no relative noise"):
        identifiability.against_half(H, 2.0)
    with pytest.raises(InputError, match="not finer"):
        identifiability.refinement(H, H, 0.1)
