"""Presses: resultants, exact means over cells, superposition, frames of a slide, and the Fourier sum of the kernels."""

from __future__ import annotations

import time

import numpy as np
import pytest

from structures import InputError
from tactile import HalfSpace, Layer, Press, press_and_slide
from tactile._closed.presses import Presses

LAYER = Layer(3e-3, 147e3, 0.3223)
PRESS = Press(at=(0.31e-3, -0.2e-3), radius=2.5e-3, force=1.0, shear=(0.2, 0.1))


def cells(half: float, n: int, skew: float = 0.0) -> np.ndarray:
    """Quadrilaterals that tile a square, (n^2, 4, 2); its inner corners moved at random by `skew` of a side."""
    g = np.linspace(-half, half, n + 1)
    grid = np.stack(np.meshgrid(g, g), axis=-1)
    grid[1:-1, 1:-1] += skew * (g[1] - g[0]) * np.random.default_rng(0).uniform(-1, 1, (n - 1, n - 1, 2))
    return np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2).reshape(-1, 4, 2)


def areas(quads: np.ndarray) -> np.ndarray:
    d1, d2 = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    return (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / 2


@pytest.mark.parametrize("profile", ["hertz", "uniform"])
def test_means_over_any_cells_carry_the_whole_resultant(profile: str) -> None:
    press = Press(at=PRESS.at, radius=PRESS.radius, force=1.0, shear=(0.2, 0.1), profile=profile)
    for n, skew in ((3, 0.0), (17, 0.0), (31, 0.3)):
        quads = cells(4e-3, n, skew)
        forces = press.mean_tractions(quads) * areas(quads)[:, None]
        np.testing.assert_allclose(forces.sum(axis=0), press.resultant()[:3], atol=1e-8)
    middle = quads.mean(axis=1)
    moments = np.cross(np.column_stack([middle, np.zeros(len(middle))]), forces).sum(axis=0)
    np.testing.assert_allclose(moments, press.resultant()[3:], atol=2e-6)


def test_a_mean_is_the_mean_of_the_traction() -> None:
    quads = cells(4e-3, 11)
    found, s = PRESS.mean_tractions(quads), (np.arange(300) + 0.5) / 300
    side = quads[0, 1, 0] - quads[0, 0, 0]
    for i in (60, 50, 38, 92):
        inside = quads[i, 0] + side * np.stack(np.meshgrid(s, s), axis=-1).reshape(-1, 2)
        np.testing.assert_allclose(found[i], PRESS.traction(inside).mean(axis=0), atol=2e-5 * PRESS.peak)


def test_traction_and_peak() -> None:
    p = 1.5 / np.pi / PRESS.radius**2
    np.testing.assert_allclose(PRESS.traction([PRESS.at]), [[0.2 * p, 0.1 * p, -p]], rtol=1e-12)
    assert PRESS.peak == pytest.approx(p)
    assert np.abs(PRESS.traction([[3e-3, 0.0]])).max() == 0
    flat = Press(radius=1e-3, force=2.0, profile="uniform")
    np.testing.assert_allclose(flat.traction([[0.9e-3, 0.0]]), [[0, 0, -2 / (np.pi * 1e-6)]])


def test_resultant_about_a_point() -> None:
    force, moment = np.split(PRESS.resultant((1e-3, 2e-3)), 2)
    arm = np.array([*PRESS.at, 0.0]) - [1e-3, 2e-3, 0.0]
    np.testing.assert_allclose(moment, np.cross(arm, force), rtol=1e-14)


@pytest.mark.parametrize("nu", [0.3223, 0.49])
@pytest.mark.parametrize("z", [None, 1.8e-3])
def test_displacements_are_the_fourier_sum_of_the_kernels(nu: float, z: float | None) -> None:
    """Full 3 x 3 kernels on a periodic plane, with a smooth load: the radial functions and their turning."""
    layer, n, side = Layer(3e-3, 147e3, nu), 256, 90e-3
    k = 2 * np.pi * np.fft.fftfreq(n, side / n)
    kx, ky = np.meshgrid(k, k)
    from tactile._closed.profiles import PROFILES

    load = PROFILES["hertz"].transform(np.hypot(kx, ky) * 4e-3)[..., None] * np.array([0.3, -0.2, -1.0])
    waves = np.einsum("yxij,yxj->yxi", layer.interior(kx, ky, z), load)
    truth = np.fft.ifft2(waves, axes=(0, 1)).real * (n / side) ** 2
    i = np.array([0, 3, 8, 14, 20, n - 6, n - 15])
    at = np.stack(np.meshgrid(i, i), axis=-1).reshape(-1, 2)
    points = np.where(at > n // 2, at - n, at) * side / n
    if z is not None:
        points = np.column_stack([points, np.full(len(points), z)])
    found = Press(radius=4e-3, force=1.0, shear=(0.3, -0.2)).displacement(layer, points)
    assert np.abs(found - truth[at[:, 1], at[:, 0]]).max() < (2e-3 if z is None else 2e-5) * np.abs(truth).max()


def test_loads_add_up_and_follow_their_centre() -> None:
    points = np.random.default_rng(3).uniform(-5e-3, 5e-3, (30, 2))
    other = Press(at=(-2e-3, 1e-3), radius=1e-3, force=0.4, profile="uniform")
    both = PRESS + other
    assert both == Presses((PRESS, other)) == sum([PRESS, other])
    np.testing.assert_allclose(
        both.displacement(LAYER, points), PRESS.displacement(LAYER, points) + other.displacement(LAYER, points)
    )
    np.testing.assert_allclose(both.resultant(), PRESS.resultant() + other.resultant())
    home = Press(radius=PRESS.radius, force=1.0, shear=(0.2, 0.1)).displacement(LAYER, points - np.array(PRESS.at))
    np.testing.assert_allclose(PRESS.displacement(LAYER, points), home, rtol=1e-9, atol=1e-12)


def test_units_do_not_matter() -> None:
    points = np.random.default_rng(4).uniform(-5e-3, 5e-3, (30, 2))
    mm = Press(at=(0.31, -0.2), radius=2.5, force=1.0, shear=(0.2, 0.1))
    found = mm.displacement(Layer(3.0, 0.147, 0.3223), 1e3 * points)
    np.testing.assert_allclose(found * 1e-3, PRESS.displacement(LAYER, points), rtol=1e-9, atol=1e-14)


def test_two_thousand_points_take_less_than_a_tenth_of_a_second() -> None:
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(-12e-3, 12e-3, (2000, 2)), np.full(2000, 2.5e-3)])
    PRESS.displacement(LAYER, points)  # Gauss rules are kept
    spent = []
    for _ in range(3):
        start = time.process_time()
        PRESS.displacement(LAYER, points)
        spent.append(time.process_time() - start)
    assert min(spent) < 0.1


def test_press_and_slide() -> None:
    frames = press_and_slide(force=1.0, shear=(0.25, 0.0), radius=2.5e-3, travel=(1e-3, 0.0), frames=20, pressing=0.5)
    force = np.array([f.resultant()[:3] for f in frames])
    np.testing.assert_allclose(force[:10, 2], -np.linspace(0.1, 1, 10))
    assert (force[:10, 0] == 0).all()
    np.testing.assert_allclose(force[9:, 0], np.linspace(0, 0.25, 11))
    np.testing.assert_allclose([f.radius for f in frames], 2.5e-3 * np.cbrt(-force[:, 2]))
    assert frames[-1].at == (1e-3, 0.0)
    assert press_and_slide(frames=1, pressing=1.0)[0].force == 1.0


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: Press(radius=-1.0), "radius must be positive"),
        (lambda: Press(profile="flat"), "no profile"),
        (lambda: Press(shear=0.1), "two finite numbers"),
        (lambda: Press(force=np.nan), "one finite number"),
        (lambda: PRESS.displacement(LAYER, [[0.0, 0.0, 4e-3]]), "outside the body"),
        (lambda: PRESS.displacement(HalfSpace(1e5, 0.3), [[0.0, 0.0, 4e-3]]), "outside the body"),
        (lambda: PRESS.traction([[0.0, np.nan]]), "finite"),
        (lambda: PRESS.mean_tractions(cells(1e-3, 2)[:, ::-1]), "clockwise"),
        (lambda: PRESS.mean_tractions(np.zeros((4, 2))), "no polygons"),
        (lambda: Presses(()), "no presses"),
        (lambda: press_and_slide(frames=0), "no number of frames"),
        (lambda: press_and_slide(pressing=1.5), "no share"),
    ],
)
def test_what_cannot_be_is_refused(make, what: str) -> None:
    with pytest.raises(InputError, match=what):
        make()
