"""What a bonded layer lets through: the figures of the tactile literature page."""

from __future__ import annotations

import numpy as np
import pytest

from structures import InputError
from tactile import Layer
from tactile.design._resolution import cutoff, mistaken_shear, noise_std, peak, sideways, sign_change

# h (mm), E (MPa), nu: peak of G_zz (mm/MPa) and its wavelength over h, uniform/peak, wavelengths (mm) at 10 % of the
# peak (zz, kk, tt), noise (kPa) of shear and pressure at 1 mm, 2.1 um in the plane and 10 um along the normal
PADS = [
    (3, 0.147, 0.3223, 14.8, 6.0, 0.96, (0.76, 2.8, 1.9), (0.39, 2.1)),
    (4, 0.435, 0.475, 4.73, 3.2, 0.27, (0.84, 4.8, 2.5), (1.23, 7.2)),
    (3, 0.3, 0.49, 4.95, 3.0, 0.12, (0.61, 3.7, 1.9), (0.86, 5.1)),
]
NUS = (0.3223, 0.40, 0.45, 0.475, 0.49, 0.5)


@pytest.mark.parametrize("pad", PADS, ids=lambda p: f"nu {p[2]}")
def test_figures_of_three_pads(pad: tuple) -> None:
    h, E, nu, top, wave, uniform, ends, noise = pad
    layer = Layer(h, E, nu)
    found = peak(layer)
    assert found.compliance == pytest.approx(top, rel=4e-3)
    assert found.wavelength / h == pytest.approx(wave, abs=0.06)
    assert found.uniform == pytest.approx(uniform, abs=6e-3)
    for name, end in zip(("zz", "kk", "tt"), ends, strict=True):
        assert cutoff(layer, name) == pytest.approx(end, rel=2e-2)
        k = 2 * np.pi / cutoff(layer, name)
        assert getattr(layer.components(k), name) == pytest.approx(0.1 * peak(layer, name).compliance, rel=1e-9)
    spread = noise_std(layer, 1.0, 0.03 / 14, 0.01, coupled=False)
    np.testing.assert_allclose(np.array(spread) * 1e3, noise, rtol=2e-2)
    rms = np.sqrt(2 / 3) * np.pi * layer.mu
    closed = 0.03 / 14 * rms * np.sqrt(0.5 + 0.5 / (1 - nu) ** 2), 0.01 * rms / (1 - nu)
    np.testing.assert_allclose(spread, closed, rtol=2.5e-2)


def test_noise_goes_as_one_over_the_pitch_and_coupling_adds_to_it() -> None:
    layer = Layer(3e-3, 147e3, 0.3223)
    fine, coarse = (np.array(noise_std(layer, b, 2e-6, 1e-5)) for b in (0.25e-3, 0.5e-3))
    np.testing.assert_allclose(fine / coarse, 2.0, rtol=1e-2)
    alone = noise_std(layer, 0.5e-3, 2e-6, 1e-5, coupled=False)
    assert coarse[0] > 1.3 * alone[0]  # noise along the normal is read as shear
    # independent: the inverse of the kernels, wave by wave
    k = 2 * np.pi * np.fft.fftfreq(64, 0.5e-3)
    kx, ky = np.meshgrid(k, k)
    K = np.linalg.solve(layer.kernel(kx, ky), np.broadcast_to(np.eye(3), (64, 64, 3, 3)))
    K[0, 0] = 0
    truth = np.sqrt((np.abs(K) ** 2).mean(axis=(0, 1)) @ np.array([2e-6, 2e-6, 1e-5]) ** 2)
    np.testing.assert_allclose(coarse, truth[[0, 2]], rtol=1e-10)


@pytest.mark.parametrize(("nu", "x"), list(zip(NUS, (1.25, 2.07, 2.78, 3.35, 4.02), strict=False)))
def test_where_pressure_drags_the_other_way(nu: float, x: float) -> None:
    layer = Layer(2e-3, 1e6, nu)
    k = sign_change(layer)
    assert k is not None
    assert k * layer.h == pytest.approx(x, abs=8e-3)
    C = layer.components(np.array([0.99, 1.01]) * k).kz
    assert C[0] < 0 < C[1]  # long waves push the surface out from under the pressure


def test_where_it_never_turns() -> None:
    k = np.geomspace(1e-2, 30, 50)
    for nu, sign in ((0.5, -1), (0.2, 1), (0.0, 1)):
        layer = Layer(1.0, 1.0, nu)
        assert sign_change(layer) is None
        assert (sign * layer.components(k).kz >= 0).all()


def test_pressure_moves_markers_sideways_and_is_mistaken_for_shear() -> None:
    for found, page in (
        (sideways, (0.06, 0.33, 0.65, 0.89, 1.08, 1.23)),
        (mistaken_shear, (0.03, 0.14, 0.24, 0.29, 0.33, 0.36)),
    ):
        np.testing.assert_allclose([found(Layer(1.0, 1.0, nu), 1.0) for nu in NUS], page, atol=6e-3)


def test_uniform_pressure_is_hardly_seen_near_incompressibility() -> None:
    np.testing.assert_allclose(
        [peak(Layer(1.0, 1.0, nu)).uniform for nu in NUS[1:]], (0.76, 0.48, 0.27, 0.12, 0.0), atol=5e-3
    )
    assert np.isinf(peak(Layer(1.0, 1.0, 0.4), "kk").wavelength)


def test_resolution_scales_with_thickness_and_not_with_the_modulus() -> None:
    one, thick, stiff = Layer(1e-3, 1e5, 0.45), Layer(3e-3, 1e5, 0.45), Layer(1e-3, 1e8, 0.45)
    for name in ("zz", "kk", "tt"):
        assert cutoff(thick, name) == pytest.approx(3 * cutoff(one, name), rel=1e-9)
        assert cutoff(stiff, name) == pytest.approx(cutoff(one, name), rel=1e-9)


@pytest.mark.parametrize("share", [0.999, 0.5, 1e-4])
@pytest.mark.parametrize("nu", [-0.5, 0.0, 0.3, 0.5])
def test_every_cutoff_is_found(nu: float, share: float) -> None:
    layer = Layer(1.0, 1.0, nu)
    for name in ("zz", "kk", "tt"):
        k = 2 * np.pi / cutoff(layer, name, share)
        assert getattr(layer.components(k), name) == pytest.approx(share * peak(layer, name).compliance, rel=1e-8)


def test_what_cannot_be_is_refused() -> None:
    layer = Layer(1e-3, 1e5, 0.4)
    for what, make in {
        "no component": lambda: peak(layer, "xx"),
        "share must be": lambda: cutoff(layer, share=1.0),
        "pitch must be positive": lambda: noise_std(layer, 0.0, 1e-6, 1e-6),
        "std must not be negative": lambda: noise_std(layer, 1e-3, -1e-6, 1e-6),
    }.items():
        with pytest.raises(InputError, match=what):
            make()
