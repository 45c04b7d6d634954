"""Kernels of the bonded layer against an independent solution of its boundary conditions, and its limits."""

from __future__ import annotations

import numpy as np
import pytest

from structures import InputError
from tactile import HalfSpace, Layer

NUS = (0.0, 0.1, 0.3, 0.3223, 0.45, 0.49, 0.499)
KH = (0.05, 0.1, 0.3, 0.6, 1.0, 2.0, 4.0, 8.0, 15.0)
PLANE = np.ix_([0, 2], [0, 2])


def boundary_system(h: float, E: float, nu: float, k: float, z: float) -> np.ndarray:
    """Motion (along k, normal) at z per traction at h: four modes, u(0) = 0 and t(h) given, solved as 4 x 4."""
    mu, kappa = E / 2 / (1 + nu), 3 - 4 * nu
    lam = 2 * mu * nu / (1 - 2 * nu)

    def modes(z: float) -> tuple[np.ndarray, np.ndarray]:
        u, slope = [], []
        for s in (1, -1):
            e = np.exp(s * k * z - (k * h if s == 1 else 0))
            u += [(1j * e, s * e), (1j * z * e, (s * z - kappa / k) * e)]
            slope += [(1j * s * k * e, k * e), (1j * (1 + s * k * z) * e, s * e + (s * z - kappa / k) * s * k * e)]
        return np.array(u).T, np.array(slope).T

    base, (top, slope) = modes(0.0)[0], modes(h)
    shear = mu * (slope[0] + 1j * k * top[1])
    press = (lam + 2 * mu) * slope[1] + lam * 1j * k * top[0]
    A = np.vstack([base, shear, press])
    scale = np.abs(A).max(axis=1, keepdims=True)
    right = np.vstack([np.zeros((2, 2)), np.eye(2)]) / scale
    return modes(z)[0] @ np.linalg.solve(A / scale, right)


@pytest.mark.parametrize("nu", NUS)
def test_the_kernels_meet_the_boundary_conditions(nu: float) -> None:
    layer = Layer(3e-3, 147e3, nu)
    for x in KH:
        k = x / layer.h
        for share in (1.0, 0.9, 0.4, 0.05):
            truth = boundary_system(layer.h, layer.E, nu, k, share * layer.h)
            found = layer.interior(k, 0.0, share * layer.h)
            assert np.abs(found[PLANE] - truth).max() < 1e-12 * np.abs(truth).max(), (x, share)
            across = np.sinh(share * x) / np.cosh(x) / layer.mu / k
            assert found[1, 1] == pytest.approx(across, rel=1e-13)
            assert abs(found[1, [0, 2]]).max() == 0


def test_the_textbook_form_is_the_same() -> None:
    nu, x = 0.3223, np.array(KH)
    layer, kappa = Layer(1.0, 1.0, nu), 3 - 4 * nu
    D = kappa * np.cosh(2 * x) + 2 * x**2 + (kappa**2 + 1) / 2
    a, f = (1 - nu) / layer.mu / x, layer.components(x)
    np.testing.assert_allclose(f.zz, a * (kappa * np.sinh(2 * x) - 2 * x) / D, rtol=1e-12)
    np.testing.assert_allclose(f.kk, a * (kappa * np.sinh(2 * x) + 2 * x) / D, rtol=1e-12)
    C = (kappa * (1 - 2 * nu) * (np.cosh(2 * x) - 1) - 2 * x**2) / (2 * layer.mu * x * D)
    np.testing.assert_allclose(f.kz, C, rtol=1e-10)
    # t_z = 0 imposed: the finite-thickness kernel of traction force microscopy
    tfm = (kappa * np.cosh(x) ** 2 + x**2 + (1 - 2 * nu) ** 2) / (kappa * np.sinh(x) * np.cosh(x) + x)
    np.testing.assert_allclose(1 / f.kk, layer.mu * x / (1 - nu) * tfm, rtol=1e-12)


@pytest.mark.parametrize("nu", [*NUS, 0.4999, 0.5])
def test_compliance_is_hermitian_positive_and_undone_by_the_stiffness(nu: float) -> None:
    layer, rng = Layer(2e-3, 1e6, nu), np.random.default_rng(1)
    k = np.geomspace(1e-3, 300, 40) / layer.h
    turn = rng.uniform(0, 2 * np.pi, 40)
    kx, ky = k * np.cos(turn), k * np.sin(turn)
    G, K = layer.kernel(kx, ky), layer.stiffness(kx, ky)
    assert G.shape == (40, 3, 3)
    np.testing.assert_allclose(G, np.swapaxes(G.conj(), -1, -2), atol=1e-15 * np.abs(G).max())
    assert np.linalg.eigvalsh(G).min() > 0
    # columns weighted by their size: G_zz of an incompressible layer vanishes with k^2
    size = np.sqrt(np.einsum("nii->ni", G).real)
    both = np.einsum("nij,njk->nik", K, G) * size[:, :, None] / size[:, None, :]
    np.testing.assert_allclose(both, np.broadcast_to(np.eye(3), both.shape), atol=1e-10)


@pytest.mark.parametrize("nu", [0.3, 0.49, 0.5])
def test_short_waves_see_a_half_space_and_overflow_nothing(nu: float) -> None:
    layer, half = Layer(1.0, 1.0, nu), HalfSpace(1.0, nu)
    with np.errstate(all="raise", under="ignore"):
        for x in (50.0, 1e3, 1e5):
            for z in (0.0, -1 / x, -5 / x):
                ours, theirs = (g.interior(0.6 * x, 0.8 * x, g.top + z) for g in (layer, half))
                assert np.abs(ours - theirs).max() < 1e-11 * np.abs(theirs).max()
            K = layer.stiffness(0.6 * x, 0.8 * x)
            np.testing.assert_allclose(K, half.stiffness(0.6 * x, 0.8 * x), atol=1e-11 * np.abs(K).max())
            assert np.abs(layer.interior(x, 0.0, 0.0)).max() < 1e-15
    np.testing.assert_allclose(half.kernel(3.0, 4.0) @ half.stiffness(3.0, 4.0), np.eye(3), atol=1e-14)


def test_the_half_space_at_depth() -> None:
    nu, k, d = 0.3223, 700.0, 2e-3
    half = HalfSpace(147e3, nu)
    q = k * d
    a, f = np.exp(-q) / (2 * half.mu * k), half.interior(k, 0.0, -d)
    assert f[2, 2] == pytest.approx(a * (2 * (1 - nu) + q), rel=1e-14)
    assert f[0, 0] == pytest.approx(a * (2 * (1 - nu) - q), rel=1e-14)
    assert f[0, 2] == pytest.approx(-1j * a * (1 - 2 * nu - q), rel=1e-14)
    assert f[2, 0] == pytest.approx(1j * a * (1 - 2 * nu + q), rel=1e-14)


@pytest.mark.parametrize("nu", [0.0, 0.3223, 0.49, 0.5])
def test_uniform_traction(nu: float) -> None:
    layer = Layer(3e-3, 147e3, nu)
    G, near = layer.kernel(0.0, 0.0), layer.kernel(1e-4 / layer.h, 0.0)
    limit = np.diag([layer.h / layer.mu, layer.h / layer.mu, layer.h * (1 - 2 * nu) / (2 * layer.mu * (1 - nu))])
    np.testing.assert_allclose(G, limit, rtol=1e-15)
    np.testing.assert_allclose(near, limit, atol=1e-4 * layer.h / layer.mu)
    if nu == 0.5:
        assert near[2, 2].real == pytest.approx((1e-4 / layer.h) ** 2 * layer.h**3 / 3 / layer.mu, rel=1e-7)
        with pytest.raises(InputError, match="no finite stiffness"):
            layer.stiffness(0.0, 0.0)
    else:
        np.testing.assert_allclose(layer.stiffness(0.0, 0.0) @ G, np.eye(3), atol=1e-14)


@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="needs extended precision to compare with")
@pytest.mark.parametrize("nu", [0.4995, 0.49999, 0.5])
def test_long_waves_of_a_nearly_incompressible_layer_lose_no_digits(nu: float) -> None:
    layer, x = Layer(1.0, 1.0, nu), np.array([1e-3, 3e-3, 1e-2, 0.1, 0.49, 0.51])
    long = x.astype(np.longdouble)
    kappa = 3 - 4 * np.longdouble(nu)
    D = kappa * np.cosh(2 * long) + 2 * long**2 + (kappa**2 + 1) / 2
    truth = (1 - np.longdouble(nu)) / layer.mu / long * (kappa * np.sinh(2 * long) - 2 * long) / D
    np.testing.assert_allclose(layer.components(x).zz, truth.astype(float), rtol=1e-12)
    np.testing.assert_allclose(layer.components(x, z=1 - 1e-10).zz, truth.astype(float), rtol=1e-8)


def test_modulus_is_a_gain_and_units_do_not_matter() -> None:
    one, stiff, mm = Layer(3e-3, 147e3, 0.45), Layer(3e-3, 147e6, 0.45), Layer(3.0, 0.147, 0.45)
    np.testing.assert_allclose(one.kernel(300.0, 200.0), 1e3 * stiff.kernel(300.0, 200.0), rtol=1e-14)
    np.testing.assert_allclose(one.kernel(300.0, 200.0), 1e-9 * mm.kernel(0.3, 0.2), rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: Layer(0.0, 1e5, 0.4), "h must be positive"),
        (lambda: Layer(1e-3, -1e5, 0.4), "E must be positive"),
        (lambda: Layer(1e-3, 1e5, 0.6), "Poisson"),
        (lambda: HalfSpace(1e5, "0.3"), "Poisson"),
        (lambda: Layer(1e-3, 1e5, 0.4).kernel(np.nan, 0.0), "finite"),
        (lambda: Layer(1e-3, 1e5, 0.4).interior(1.0, 0.0, 2e-3), "outside the layer"),
        (lambda: HalfSpace(1e5, 0.3).interior(1.0, 0.0, 2e-3), "above the half-space"),
        (lambda: HalfSpace(1e5, 0.3).kernel(0.0, 0.0), "no finite mean"),
    ],
)
def test_what_cannot_be_is_refused(make, what: str) -> None:
    with pytest.raises(InputError, match=what):
        make()
