"""Hankel integrals of round loads: reference values, an independent quadrature, and superposition on the surface."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import jv

from structures import InputError
from tactile import HalfSpace, Layer
from tactile._closed.presses import HEIGHTS, matrices, moved, radial, unit_point
from tactile._closed.profiles import PROFILES

# depth of the centre over that of a half-space, tactile literature page
RATIOS = {
    0.3223: (0.941, 0.882, 0.824, 0.715, 0.595, 0.494, 0.349, 0.260),
    0.45: (0.931, 0.863, 0.797, 0.672, 0.535, 0.423, 0.270, 0.183),
    0.49: (0.926, 0.854, 0.783, 0.650, 0.505, 0.388, 0.230, 0.143),
}


def by_sum(ground: Layer, shape: str, a: float, r: np.ndarray, z: float, end: float, nodes: int) -> np.ndarray:
    """The same five functions by one long Gauss rule over the whole kernel, no half-space taken out."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    k, w = (x + 1) * end / 2, w * end / 2
    f = ground.components(k, z)
    w = w * k * PROFILES[shape].transform(k * a) / (2 * np.pi)
    J = [jv(m, np.multiply.outer(r, k)) for m in range(3)]
    return np.column_stack(
        [J[0] @ (w * f.zz), J[1] @ (w * f.kz), J[1] @ (w * f.zk), J[0] @ (w * (f.kk + f.tt) / 2),
         J[2] @ (w * (f.kk - f.tt) / 2)]
    )  # fmt: skip


def test_reference_values() -> None:
    for nu, depth in ((0.3223, 0.7522), (0.49, 0.5013)):
        assert radial(Layer(3.0, 0.147, nu), "hertz", 3.0, [0.0])[0, 0] == pytest.approx(depth, abs=5e-5)


@pytest.mark.parametrize("nu", RATIOS)
def test_the_base_stiffens_a_thin_pad(nu: float) -> None:
    layer = Layer(1.0, 1.0, nu)
    found = [
        radial(layer, "hertz", a, [0.0])[0, 0] / radial(layer.half_space, "hertz", a, [0.0])[0, 0]
        for a in (0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0)
    ]
    np.testing.assert_allclose(found, RATIOS[nu], atol=1e-3)


@pytest.mark.parametrize("shape", PROFILES)
@pytest.mark.parametrize("depth", [0.3, 1.0, 2.9])
def test_inside_against_a_plain_quadrature(shape: str, depth: float) -> None:
    layer, r = Layer(3.0, 0.147, 0.45), np.array([0.0, 1e-5, 0.4, 1.99, 2.0, 2.01, 5.0])
    truth = by_sum(layer, shape, 2.0, r, 3.0 - depth, 36 / depth, 900)
    found = radial(layer, shape, 2.0, r, np.full(len(r), 3.0 - depth))
    np.testing.assert_allclose(found, truth, atol=1e-10 * np.abs(truth).max())


@pytest.mark.parametrize("shape", PROFILES)
def test_the_surface_is_the_limit_of_the_inside(shape: str) -> None:
    # at the rim of a uniform load the slopes grow as a logarithm, hence not there
    for ground in (Layer(3.0, 0.147, 0.45), HalfSpace(0.147, 0.45)):
        r = np.array([0.0, 1e-4, 0.5, 1.9, 2.1, 6.0])
        top, under = radial(ground, shape, 2.0, r), radial(ground, shape, 2.0, r, ground.top - np.full(6, 1e-7))
        np.testing.assert_allclose(under, top, atol=1e-6 * np.abs(top).max())


def test_interpolation_over_distance_and_height_changes_nothing() -> None:
    layer, rng = Layer(3e-3, 147e3, 0.49), np.random.default_rng(2)
    r, z = rng.uniform(0, 20e-3, 600), rng.uniform(0, 3e-3, 600)
    many = radial(layer, "hertz", 1e-3, r, z)
    few = np.vstack([radial(layer, "hertz", 1e-3, [a], [b]) for a, b in zip(r[:40], z[:40], strict=True)])
    np.testing.assert_allclose(many[:40], few, atol=1e-11 * np.abs(many).max())
    # two heights: interpolated over the distance only; 20 000 distances: by a spline
    flat = radial(layer, "hertz", 1e-3, np.r_[r[:40], np.linspace(0, 20e-3, 20_000)], np.full(20_040, 2e-3))
    one = radial(layer, "hertz", 1e-3, r[:40], np.full(40, 2e-3))
    np.testing.assert_allclose(flat[:40], one, atol=1e-10 * np.abs(one).max())
    assert len(np.unique(z)) > HEIGHTS


def test_nothing_moves_at_the_base() -> None:
    layer, r = Layer(3e-3, 147e3, 0.3223), np.linspace(0, 9e-3, 9)
    found, top = radial(layer, "uniform", 2e-3, r, np.zeros(9)), radial(layer, "uniform", 2e-3, r)
    assert np.abs(found).max() < 1e-10 * np.abs(top).max()


def test_a_small_press_is_a_point_force() -> None:
    layer, r = Layer(1.0, 1.0, 0.4), np.array([0.5, 1.0, 3.0])
    small = radial(layer, "hertz", 1e-4, r) - radial(layer.half_space, "hertz", 1e-4, r)
    np.testing.assert_allclose(unit_point(layer, r), small, atol=1e-8 * np.abs(small).max())


def test_signs_of_a_press_and_of_a_shear() -> None:
    layer = Layer(1.0, 1.0, 0.3223)
    at = np.array([[0.3, 0.0], [-0.3, 0.0], [0.0, 0.3]])
    f = radial(layer, "hertz", 0.2, np.hypot(*at.T))
    pressed, sheared = moved(f, at, (0, 0, -1)), moved(f, at, (1, 0, 0))
    assert (pressed[:, 2] < 0).all()
    assert pressed[0, 0] < 0 < pressed[1, 0]  # drawn in beside a small press, as on a half-space
    assert (sheared[:, 0] > 0).all()
    assert sheared[0, 2] == pytest.approx(-sheared[1, 2])
    assert sheared[0, 2] < 0  # by reciprocity the surface sinks ahead of a small shear
    # reciprocity: the motion along a at b per force along c is that along c at -b per force along a
    np.testing.assert_allclose(matrices(f, at), np.swapaxes(matrices(f, -at), 1, 2), atol=1e-15)


def test_what_cannot_be_is_refused() -> None:
    layer = Layer(1e-3, 1e5, 0.4)
    for what, make in {
        "outside the body": lambda: radial(layer, "hertz", 1e-3, [0.0], [2e-3]),
        "must be finite": lambda: radial(layer, "hertz", 1e-3, [np.nan]),
        "no profile": lambda: radial(layer, "square", 1e-3, [0.0]),
        "radius must be positive": lambda: radial(layer, "hertz", 0.0, [0.0]),
    }.items():
        with pytest.raises(InputError, match=what):
            make()
