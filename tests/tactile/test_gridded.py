"""Layers on a grid: influence against Fourier sums, motion against exact presses, and the way back."""

from __future__ import annotations

import numpy as np
import pytest

from structures import InputError, NotIdentifiable
from tactile import HalfSpace, Layer, LayerGrid, Press
from tactile._closed.gridded import influence
from tactile.design._resolution import noise_std

LAYER = Layer(3e-3, 147e3, 0.3223)
PRESS = Press(at=(0.1e-3, -0.2e-3), radius=2.5e-3, force=1.0, shear=(0.25, 0.1))


@pytest.mark.parametrize("nu", [0.3223, 0.49])
@pytest.mark.parametrize("shape", ["patch", "hat"])
def test_influence_inside_against_the_fourier_sum(shape: str, nu: float) -> None:
    layer, pitch, n, side, z = Layer(3e-3, 147e3, nu), 0.8e-3, 256, 60e-3, 1.5e-3
    k = 2 * np.pi * np.fft.fftfreq(n, side / n)
    kx, ky = np.meshgrid(k, k)
    basis = (np.sinc(kx * pitch / 2 / np.pi) * np.sinc(ky * pitch / 2 / np.pi)) ** (1 if shape == "patch" else 2)
    waves = layer.interior(kx, ky, z) * (basis * pitch**2 * (n / side) ** 2)[..., None, None]
    waves[n // 2] = waves[:, n // 2] = 0  # odd entries have no place at the end of the band
    truth = np.fft.ifft2(waves, axes=(0, 1))
    assert np.abs(truth.imag).max() < 1e-14 * np.abs(truth).max()
    i = np.array([0, 1, 3, 7, 11, 30, n - 2, n - 9])
    at = np.stack(np.meshgrid(i, i), axis=-1).reshape(-1, 2)
    points = np.column_stack([np.where(at > n // 2, at - n, at) * side / n, np.full(len(at), z)])
    found = influence(layer, points, [[0.0, 0.0]], pitch, shape).reshape(-1, 3, 3)
    # what is left: the images of a periodic plane
    assert np.abs(found - truth.real[at[:, 1], at[:, 0]]).max() < 5e-6 * np.abs(truth).max()


def test_a_hat_is_the_sum_of_its_small_patches() -> None:
    ground, points = (
        HalfSpace(1.0, 0.3),
        np.array([[0.0, 0.0], [0.3, 0.0], [1.0, 1.0], [0.6, -0.9], [1.7, 0.4], [4, 1]]),
    )

    def summed(n: int) -> np.ndarray:
        x = (np.arange(2 * n) + 0.5) / n - 1
        nodes = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
        weights = (1 - np.abs(nodes)).prod(axis=1)
        return influence(ground, points, nodes, 1 / n).reshape(-1, 3, len(nodes), 3).transpose(0, 1, 3, 2) @ weights

    coarse, fine = summed(32), summed(64)
    truth = fine + (fine - coarse) / 3
    found = influence(ground, points, [[0.0, 0.0]], 1.0, "hat").reshape(-1, 3, 3)
    np.testing.assert_allclose(found, truth, atol=1e-4 * np.abs(truth).max())


def test_hats_change_their_rules_without_a_jump() -> None:
    ground = HalfSpace(1.0, 0.3)
    for r in (3.0, 6.0):
        near, far = influence(ground, [[r - 1e-9, 0.3], [r + 1e-9, 0.3]], [[0.0, 0.3]], 1.0, "hat").reshape(2, 3, 3)
        np.testing.assert_allclose(near, far, atol=1e-6 * np.abs(near).max())


@pytest.mark.parametrize("load", ["patch", "hat"])
def test_motion_of_a_press_converges_to_the_exact_one(load: str) -> None:
    errors = []
    for n in (24, 48):
        grid = LayerGrid(LAYER, (n, n + 2), 12e-3 / n, load=load)
        places, d = grid.nodes.reshape(-1, 2), grid.pitch / 2
        cells = places[:, None] + d * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        loads = PRESS.mean_tractions(cells) if load == "patch" else PRESS.traction(places)
        error = []
        for z in (None, 2e-3):
            found = grid.displacements(loads.reshape(*grid.shape, 3), z).reshape(-1, 3)
            points = places if z is None else np.column_stack([places, np.full(len(places), z)])
            truth = PRESS.displacement(LAYER, points)
            error.append(np.linalg.norm(found - truth) / np.linalg.norm(truth))
        errors.append(error)
    assert max(errors[1]) < 8e-3
    assert (np.array(errors[1]) < 0.45 * np.array(errors[0])).all()


def test_transforms_are_the_dense_matrix() -> None:
    grid = LayerGrid(Layer(3e-3, 147e3, 0.49), (7, 9), 0.6e-3, load="hat")
    tractions = np.random.default_rng(0).standard_normal((7, 9, 3))
    H = grid.influence(grid.nodes.reshape(-1, 2))
    np.testing.assert_allclose(grid.displacements(tractions).ravel(), H @ tractions.ravel(), rtol=1e-6, atol=1e-13)
    np.testing.assert_allclose(H, H.T, atol=1e-6 * np.abs(H).max())
    for lam in (0.0, 0.03):
        u = np.random.default_rng(1).standard_normal(189) * 1e-5
        truth = np.linalg.lstsq(np.vstack([H, lam * _top(grid) * np.eye(189)]), np.r_[u, np.zeros(189)])[0]
        found = grid.tractions(u.reshape(7, 9, 3), lam=lam).ravel()
        np.testing.assert_allclose(found, truth, atol=1e-5 * np.abs(truth).max())


def _top(grid: LayerGrid) -> float:
    """Largest compliance of all waves on the padded grid."""
    return float(np.linalg.eigvalsh(grid._symbol).max())


@pytest.mark.parametrize("nu", [0.3223, 0.49])
def test_there_and_back(nu: float) -> None:
    grid = LayerGrid(Layer(3e-3, 147e3, nu), (40, 40), 0.5e-3)
    loads = PRESS.traction(grid.nodes.reshape(-1, 2)).reshape(40, 40, 3)
    u = grid.displacements(loads)
    np.testing.assert_allclose(grid.tractions(u, lam=0.0), loads, atol=1e-8 * np.abs(loads).max())
    mm = LayerGrid(Layer(3.0, 0.147, nu), (40, 40), 0.5)  # other units, the same lambda, the same map
    one, other = grid.tractions(u, lam=0.02), mm.tractions(1e3 * u, lam=0.02)
    np.testing.assert_allclose(other * 1e6, one, atol=1e-8 * np.abs(loads).max())


def test_exact_motion_with_noise_comes_back_as_the_press() -> None:
    grid = LayerGrid(LAYER, (48, 48), 0.5e-3, load="hat")
    places = grid.nodes.reshape(-1, 2)
    truth = PRESS.traction(places).reshape(48, 48, 3)
    u = PRESS.displacement(LAYER, places).reshape(48, 48, 3)
    noisy = u + np.random.default_rng(0).standard_normal(u.shape) * np.array([2e-6, 2e-6, 1e-5])
    raw, calm = grid.tractions(noisy, lam=0.0), grid.tractions(noisy, lam=0.04)
    assert np.linalg.norm(calm - truth) < 0.25 * np.linalg.norm(truth) < 0.5 * np.linalg.norm(raw - truth)
    np.testing.assert_allclose(calm.sum(axis=(0, 1)) * grid.pitch**2, PRESS.resultant()[:3], atol=0.04)
    # the formula knows waves, not the shape that a node stands for
    patches = LayerGrid(LAYER, (48, 48), 0.5e-3)
    pressure = patches.tractions(noisy - u, lam=0.0)[..., 2].std()
    assert pressure == pytest.approx(noise_std(LAYER, 0.5e-3, 2e-6, 1e-5)[1], rel=0.15)


def test_what_cannot_be_is_refused() -> None:
    grid = LayerGrid(LAYER, (4, 5), 1e-3)
    good = np.zeros((4, 5, 3))
    bad = np.where(np.arange(3) == 1, np.nan, good)
    for what, make in {
        "three components at every node": lambda: grid.displacements(good[:3]),
        "NaN or infinity": lambda: grid.tractions(bad),
        "lam must not be negative": lambda: grid.tractions(good, lam=-1.0),
        "no layer": lambda: LayerGrid(HalfSpace(1e5, 0.3), (4, 5), 1e-3),
        "no load of a grid": lambda: LayerGrid(LAYER, (4, 5), 1e-3, load="gauss"),
        "no number of nodes": lambda: LayerGrid(LAYER, (0, 5), 1e-3),
        "points must be finite": lambda: influence(LAYER, [[0.0]], [[0.0, 0.0]], 1e-3),
        "no shape": lambda: influence(LAYER, [[0.0, 0.0]], [[0.0, 0.0]], 1e-3, "disc"),
    }.items():
        with pytest.raises(InputError, match=what):
            make()
    assert noise_std(LAYER, 1e-3, 0.0, 0.0) == (0.0, 0.0)
    with pytest.raises(NotIdentifiable) as refused:
        LayerGrid(Layer(3e-3, 1e5, 0.5), (64, 64), 1e-6).tractions(np.zeros((64, 64, 3)), lam=0.0)
    assert refused.value.code == "LID-E306"


@pytest.mark.parametrize("share", [0.1, 0.45, 1.2])
def test_a_cell_is_the_sum_of_its_quarters(share: float) -> None:
    """On a layer, at any pitch and next to the base too: what the short rules leave out."""
    layer, pitch = Layer(1.0, 1.0, 0.49), share
    x = np.linspace(0, 3, 7)
    places = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    quarters = pitch / 4 * np.array([[1, 1], [-1, 1], [1, -1], [-1, -1]])
    top = np.abs(influence(layer, places, [[0.0, 0.0]], pitch)).max()
    for z in (1.0, 0.1):
        points = np.column_stack([places, np.full(len(places), z)])
        whole = influence(layer, points, [[0.0, 0.0]], pitch)
        parts = influence(layer, points, quarters, pitch / 2).reshape(-1, 4, 3).sum(axis=1)
        np.testing.assert_allclose(whole, parts, atol=3e-7 * top)
