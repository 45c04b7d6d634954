"""Skin design: every statement of the design table as a number, against dense and closed forms."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from case_studies import contact_inversion as surrogate
from loadid import StaticInversion
from structures import MatrixModel
from structures._flags import codes
from structures.errors import InputError
from tactile import Layer, Press, design
from tactile.design import Skin
from tactile.design._modes import modes, spectrum
from tactile.design._resolution import noise_std

GEL = {"h": 3e-3, "E": 0.147e6, "nu": 0.3223}


# -- the statements of the design table -----------------------------------------------------------------------------


def test_the_modulus_is_a_pure_gain() -> None:
    soft, stiff = design.skin(**GEL), design.skin(**(GEL | {"E": 147e6}))
    assert stiff.kappa == pytest.approx(soft.kappa, rel=1e-9)
    assert (stiff.pressure_raw, stiff.shear_raw) == pytest.approx(
        (1e3 * soft.pressure_raw, 1e3 * soft.shear_raw), rel=1e-9
    )
    assert stiff.depth_signal == pytest.approx(1e-3 * soft.depth_signal, rel=1e-9)
    assert stiff.strain_load == pytest.approx(1e3 * soft.strain_load, rel=1e-9)
    assert stiff.crossover == pytest.approx(soft.crossover, rel=1e-9)
    assert codes(stiff.flags) == {"W111"}
    assert not soft.flags
    k = np.array([1e2, 1e3, 1e4])
    u = np.ones((3, 3))
    force = [np.einsum("nij,nj->ni", d.skin.layer.stiffness(k, 0.3 * k), u) for d in (soft, stiff)]
    assert force[1] == pytest.approx(1e3 * force[0], rel=1e-12)


def inverted(factor: float, lam: float) -> np.ndarray:
    """Load on the surrogate's 48 nodes, with a modulus off by a factor and lambda relative to sigma_1."""
    right = surrogate.model(0.1)
    wrong = MatrixModel(right.H / factor, sensors=right.sensors, loads=right.loads)
    y, sigma = surrogate.readings(0.1, surrogate.bumps, "every node", 0)
    return StaticInversion(wrong, choice=lam, noise=sigma, allow=surrogate.QUIET).estimate(y).load


def test_lambda_with_units_makes_the_modulus_change_the_shape() -> None:
    """E off by 10: with lambda relative to sigma_1 a pure factor, with the same absolute lambda another map."""
    lam = 0.01
    right, relative, absolute = inverted(1, lam), inverted(10, lam), inverted(10, 10 * lam)

    def shape(a: np.ndarray) -> float:
        return float(np.linalg.norm(a / np.linalg.norm(a) - right / np.linalg.norm(right)))

    assert relative == pytest.approx(10 * right, rel=1e-9)
    assert shape(relative) < 1e-12
    assert 0.3 < shape(absolute) < 0.5


def test_resolution_scales_with_thickness() -> None:
    found = [design.skin(**(GEL | {"h": h, "size": (40e-3, 40e-3)})) for h in (1.5e-3, 3e-3, 6e-3)]
    lengths = [f.crossover for f in found]
    assert lengths[1] / lengths[0] == pytest.approx(2, rel=1e-6)
    assert lengths[2] / lengths[1] == pytest.approx(2, rel=1e-6)
    # at equal depth in thicknesses, the markers' noise-limited resolution follows as well
    deep = [design.skin(**GEL | {"h": h, "depth": h / 3, "size": (40e-3, 40e-3)}) for h in (1.5e-3, 3e-3, 6e-3)]
    ratio = [b.pressure_resolution / a.pressure_resolution for a, b in pairwise(deep)]
    assert all(1.5 < r < 2.2 for r in ratio)
    assert found[2].depth_signal > found[1].depth_signal > found[0].depth_signal  # and the signal grows


def test_density_averages_only_independent_noise() -> None:
    pitches = (1e-3, 0.5e-3, 0.25e-3, 0.125e-3)
    own = [design.skin(**GEL, pitch=p) for p in pitches]
    for coarse, fine in pairwise(own):
        assert fine.pressure_raw / coarse.pressure_raw == pytest.approx(0.5, rel=0.03)  # and tells images apart
        assert fine.effective / coarse.effective == pytest.approx(4, rel=1e-9)
    assert own[3].pressure_raw / own[2].pressure_raw == pytest.approx(0.5, rel=1e-9)
    length = 0.8e-3
    shared = [design.skin(**GEL, pitch=p, correlated=0.95, correlation=length) for p in pitches]
    ceiling = 20e-3 * 16e-3 / (2 * np.pi * length**2)
    assert shared[-1].effective == pytest.approx(ceiling / 0.95, rel=1e-3)
    assert shared[-1].skin.markers / shared[-1].effective > 200
    assert shared[-1].effective < 1.01 * shared[1].effective  # four times the markers twice over: one per cent
    # half of the noise shared: twice the ceiling is never passed, and the std stops falling
    half = [design.skin(**GEL, pitch=p, correlated=0.5, correlation=length) for p in pitches]
    assert half[-1].effective < 2 * ceiling
    assert half[-1].effective > 1.9 * ceiling


def test_sensing_on_the_surface_beats_sensing_at_depth() -> None:
    at = [design.skin(**GEL, depth=d) for d in (0.0, 0.5e-3, 1e-3, 2e-3)]
    kappas = [a.kappa for a in at]
    assert kappas == sorted(kappas)
    assert kappas[2] / kappas[0] > 100
    assert [a.recoverable for a in at] == sorted((a.recoverable for a in at), reverse=True)
    assert at[2].shear_std > 10 * at[0].shear_std
    # singular values fall like e^{-k d}: two short waves at 1 and 2 mm
    k = np.array([4e3, 6e3])
    one, two = (Layer(**GEL).components(k, 3e-3 - d).tt for d in (1e-3, 2e-3))
    assert np.log(one / two) == pytest.approx(k * 1e-3, rel=1e-3)


@pytest.mark.parametrize(("nu", "ratio"), [(0.3, 0.99), (0.45, 0.96), (0.49, 0.80), (0.499, 0.33)])
def test_plain_bricks_lock_as_nu_goes_to_one_half(nu: float, ratio: float) -> None:
    assert design.locking(nu) == pytest.approx(ratio, abs=0.035)


# -- numbers against dense and closed forms ---------------------------------------------------------------------------


@pytest.mark.parametrize(("per", "fine", "nu"), [(1, 45, 0.3223), (2, 42, 0.45), (3, 45, 0.49)])
def test_waves_against_a_dense_problem(per: int, fine: int, nu: float) -> None:
    """Patches of constant traction on a periodic pad of 7 x 7, read at `per` x `per` markers each: a dense matrix.

    Its columns come from a grid so fine that every marker lies on a node of it.
    """
    n, size = 7, 7 * fine
    s = Skin(h=3e-3, E=0.147e6, nu=nu, size=(7e-3, 7e-3), load=5e3, depth=0.4e-3, pitch=1e-3 / per)
    k = 2 * np.pi * np.fft.fftfreq(size, 1e-3 / fine)
    patch = np.zeros((size, size))
    patch[:fine, :fine] = 1.0
    G = s.layer.interior(*np.meshgrid(k, k, indexing="ij"), s.height)
    u = np.fft.ifft2(np.fft.fft2(patch)[..., None, None] * G, axes=(0, 1)).real
    at = (fine * (2 * np.arange(per) + 1) - per) // (2 * per)
    markers = (fine * np.arange(n)[:, None] + at).ravel()
    H = np.empty((n * per, n * per, 3, n, n, 3))
    for i in range(n):
        for j in range(n):
            H[:, :, :, i, j] = u[np.ix_((markers - i * fine) % size, (markers - j * fine) % size)]
    A = H.reshape(-1, 3 * n * n) / np.tile([s.noise, s.noise, s.noise_z], (n * per) ** 2)[:, None] * s.load
    found = modes(s)
    assert np.linalg.svd(A, compute_uv=False) == pytest.approx(np.sort(found.signal.ravel())[::-1], rel=5e-3)
    cov = s.load**2 * np.linalg.solve(np.eye(3 * n * n) + A.T @ A, np.eye(3 * n * n))
    assert np.sqrt(np.diag(cov)[:3]) == pytest.approx(found.posterior, rel=5e-3)
    q, r = np.linalg.qr(A / s.load)
    assert np.linalg.norm(np.linalg.solve(r, q.T), axis=1)[:3] == pytest.approx(found.unregularised, rel=5e-3)


def test_noise_of_a_map_without_prior_is_near_that_of_band_limited_waves() -> None:
    """The closed form takes waves without images: sampled patches couple pressure and shear less."""
    s = Skin(**GEL, size=(64e-3, 64e-3))
    shear, pressure = noise_std(s.layer, 1e-3, s.noise, s.noise_z, coupled=False)
    assert modes(s).unregularised == pytest.approx([shear, shear, pressure], rel=0.15)


@pytest.mark.parametrize("share", [0.4, 0.99])
def test_effective_markers_against_the_sum_over_all_pairs(share: float) -> None:
    s = Skin(**GEL, size=(20e-3, 20e-3), pitch=1e-3, correlated=share, correlation=1.1e-3)
    x = 1e-3 * np.arange(-20, 21)
    rho = share * np.exp(-(x[:, None] ** 2 + x**2) / (2 * 1.1e-3**2))
    rho[20, 20] = 1.0
    kx, ky = 700.0, -300.0
    phase = np.cos(kx * x[:, None] + ky * x)
    assert design.effective_markers(s) == pytest.approx(400 / rho.sum(), rel=1e-9)
    assert design.effective_markers(s, kx, ky) == pytest.approx(400 / (rho * phase).sum(), rel=1e-9)
    fine = Skin(**GEL, size=(20e-3, 20e-3), pitch=4e-6, correlated=0.5, correlation=1.1e-3)
    assert design.effective_markers(fine, kx) == pytest.approx(
        4e-4 / (0.5 * 2 * np.pi * 1.1e-3**2 * np.exp(-((kx * 1.1e-3) ** 2) / 2)), rel=1e-5
    )


def test_strain_is_the_derivative_of_the_motion() -> None:
    layer, a, e = Layer(h=3e-3, E=0.147e6, nu=0.45), 2.5e-3, 2e-6
    press = Press(radius=a, force=1.0)
    for r, z in ((0.7e-3, 1.5e-3), (2.4e-3, 2.5e-3), (3e-3, 0.4e-3)):
        steps = np.array([[r + e, 0, z], [r - e, 0, z], [r, 0, z + e], [r, 0, z - e], [r, 0, z]])
        u = press.displacement(layer, steps)
        by_r, by_z = (u[0] - u[1]) / (2 * e), (u[2] - u[3]) / (2 * e)
        expected = [by_r[0], u[4, 0] / r, by_z[2], (by_z[0] + by_r[2]) / 2]
        assert design.strains(layer, a, [r], z)[0] == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())


def test_strain_under_a_small_press_is_that_of_hertz() -> None:
    """On the axis of a half-space: Johnson, Contact Mechanics, eq. 3.45."""
    a, E, nu = 0.1e-3, 1e5, 0.4
    layer = Layer(h=3e-3, E=E, nu=nu)
    p0 = 3 / (2 * np.pi * a**2)
    for depth in (0.1e-3, 0.2e-3):
        x = depth / a
        zz = -p0 / (1 + x**2)
        rr = -p0 * ((1 + nu) * (1 - x * np.arctan(1 / x)) - 0.5 / (1 + x**2))
        expected = [(rr - nu * (rr + zz)) / E, (zz - 2 * nu * rr) / E]
        assert design.strains(layer, a, [0.0], 3e-3 - depth)[0, [0, 2]] == pytest.approx(expected, rel=5e-3)


def test_largest_strain_is_at_least_that_of_any_point() -> None:
    layer = Layer(h=3e-3, E=0.147e6, nu=0.49)
    top = design.largest_strain(layer, 2e-3)
    r = np.linspace(0, 4e-3, 40)
    for z in (0.2e-3, 1.1e-3, 2.2e-3, 2.8e-3):
        e = design.strains(layer, 2e-3, r, z)
        tensors = np.zeros((40, 3, 3))
        tensors[:, 0, 0], tensors[:, 1, 1], tensors[:, 2, 2] = e[:, 0], e[:, 1], e[:, 2]
        tensors[:, 0, 2] = tensors[:, 2, 0] = e[:, 3]
        assert np.abs(np.linalg.eigvalsh(tensors)).max() <= 1.01 * top


def test_nothing_of_the_pressure_in_long_waves_of_an_incompressible_gel() -> None:
    hard, soft = (spectrum(Skin(**(GEL | {"nu": nu}), size=(0.2, 0.2), load=3e3)).pressure[0] for nu in (0.5, 0.3223))
    assert hard < 0.02
    assert soft > 0.9


def test_in_plane_markers_alone_leave_waves_open() -> None:
    d = design.skin(**GEL, noise_z=None)
    assert d.nullity == d.waves / 3
    assert d.pressure_raw is None
    assert d.depth_snr is None
    assert d.pressure_std > 0.9 * d.skin.load  # the prior, nearly
    assert "not determined" in d.table()
    sparse = design.skin(**GEL, pitch=2e-3)  # two patches for each marker and direction
    assert sparse.nullity > sparse.waves / 2
    assert sparse.pressure_raw is None


def test_no_unit_matters() -> None:
    a = design.skin(**GEL, correlated=0.5, correlation=1e-3)
    b = design.skin(h=3.0, E=0.147, nu=0.3223, size=(20.0, 16.0), pitch=1.0, noise=2.1e-3, noise_z=10e-3, patch=1.0,
                    load=10e-3, radius=2.0, correlated=0.5, correlation=1.0)  # fmt: skip
    for name in ("kappa", "recoverable", "rank", "depth_snr", "side_snr", "effective"):
        assert getattr(b, name) == pytest.approx(getattr(a, name), rel=1e-9), name
    assert b.pressure_std == pytest.approx(1e-6 * a.pressure_std, rel=1e-9)
    assert b.pressure_resolution == pytest.approx(1e3 * a.pressure_resolution, rel=1e-9)


def test_designs_side_by_side() -> None:
    found = design.compare([Skin(**GEL, name="thick"), Skin(**(GEL | {"h": 1.5e-3}), name="thin")])
    assert found["thin"].crossover < found["thick"].crossover
    text = found.table()
    for words in ("thick", "thin", "condition number", "N at 10 % strain", "rank, nullity"):
        assert words in text
    figure = found.plot()
    drawn = figure.subfigs[0].axes
    assert [t.get_text() for t in drawn[0].get_legend().get_texts()] == ["thick", "thin"]
    assert len(figure.subfigs[1].axes) == 4


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"nu": 0.6}, "Poisson"),
        ({"depth": 3e-3}, "outside the pad"),
        ({"correlated": 0.5}, "a share and a length"),
        ({"noise": -1e-6}, "noise must be positive"),
        ({"size": (2e-3, 2e-3)}, "fewer than four"),
    ],
)
def test_designs_that_are_none_are_refused(change: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        design.skin(**(GEL | change))


def test_comparisons_that_are_none_are_refused() -> None:
    with pytest.raises(InputError, match="do not compare"):
        design.compare([Skin(**GEL), Skin(**GEL)])
    with pytest.raises(InputError, match="do not compare"):
        design.compare([Skin(**GEL, name="a"), Skin(**GEL, name="b", load=1.0)])
    with pytest.raises(InputError, match="a Skin, or"):
        design.skin()
