"""Boussinesq, Cerruti and rectangular patches: equilibrium of a box, quadrature, and the cancelling logarithm."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import dblquad

from structures import InputError
from tactile import HalfSpace
from tactile._closed.halfspace import point_forces, rectangle
from tactile._closed.presses import moved, radial

GROUND = HalfSpace(0.147, 0.3223)


def test_worked_value_and_surface_formulas() -> None:
    x, y = 1.8, 2.4
    r, mu, nu = 3.0, GROUND.mu, GROUND.nu
    found = point_forces(GROUND, [x, y])
    assert found[2, 2] == pytest.approx(0.64681, abs=5e-6)
    assert found[0, 2] == pytest.approx((1 - 2 * nu) / (4 * np.pi * mu * r) * x / r)  # pressure draws in: -Z, -X
    assert found[0, 0] == pytest.approx(((1 - nu) / r + nu * x**2 / r**3) / (2 * np.pi * mu))
    assert found[1, 0] == pytest.approx(nu * x * y / (2 * np.pi * mu * r**3))
    np.testing.assert_allclose(found, point_forces(GROUND, [-x, -y]).T, rtol=1e-14)  # reciprocity on the surface


def test_the_field_is_in_equilibrium_and_carries_the_force() -> None:
    """Stress by central differences, integrated over a half-sphere, is the applied force; div of it vanishes."""
    mu, nu, step = GROUND.mu, GROUND.nu, 1e-4
    lam = 2 * mu * nu / (1 - 2 * nu)

    def stress(at: np.ndarray) -> np.ndarray:
        slope = np.stack(
            [(point_forces(GROUND, at + d) - point_forces(GROUND, at - d)) / (2 * step) for d in step * np.eye(3)], -1
        )  # (..., i, force, j)
        strain = (slope + np.swapaxes(slope, -1, -3)) / 2
        volume = np.einsum("...ifi->...f", strain)
        return 2 * mu * strain + lam * np.einsum("...f,ij->...ifj", volume, np.eye(3))

    x, w = np.polynomial.legendre.leggauss(24)
    turn = np.arange(48) * 2 * np.pi / 48
    c = -(x + 1) / 2 * (1 - 2 * step) - step
    s = np.sqrt(1 - c**2)
    normals = np.stack(
        [np.outer(s, np.cos(turn)), np.outer(s, np.sin(turn)), np.repeat(c[:, None], 48, axis=1)], axis=-1
    )
    force = np.einsum("nm,nmifj,nmj->if", np.outer(w / 2, np.full(48, 2 * np.pi / 48)), stress(normals), normals)
    np.testing.assert_allclose(force, -np.eye(3), atol=5e-4)
    top = stress(np.array([[0.7, 0.4, -step]]))[0, :, :, 2]  # free surface
    assert np.abs(top).max() < 1e-3


@pytest.mark.parametrize("at", [(2.0, 1.1, 0.0), (-3.0, 0.1, 0.0), (0.3, 0.2, -0.4), (1.0, 0.6, -0.3), (0.0, 0.0, -1)])
def test_patch_against_quadrature(at: tuple[float, float, float]) -> None:
    x, w = np.polynomial.legendre.leggauss(60)
    q = np.stack(np.meshgrid(1.0 * x, 0.6 * x), axis=-1).reshape(-1, 2)
    offsets = np.column_stack([np.array(at[:2]) - q, np.full(len(q), at[2])])
    truth = np.einsum("n,nij->ij", np.outer(w, w).ravel() * 0.6, point_forces(GROUND, offsets))
    np.testing.assert_allclose(rectangle(GROUND, at, (2.0, 1.2)), truth, atol=1e-12 * np.abs(truth).max())


@pytest.mark.parametrize("at", [(0.0, 0.0), (0.4, -0.3)])
def test_singular_patch_against_adaptive_quadrature(at: tuple[float, float]) -> None:
    a, b, found = 1.0, 0.6, rectangle(GROUND, at, (2.0, 1.2))
    for i, j in ((2, 2), (0, 0), (1, 0), (2, 0)):

        def polar(r: float, turn: float, i: int = i, j: int = j) -> float:
            return r * point_forces(GROUND, [r * np.cos(turn), r * np.sin(turn)])[i, j]

        corners = [(a - at[0], b - at[1]), (-a - at[0], b - at[1]), (-a - at[0], -b - at[1]), (a - at[0], -b - at[1])]
        turns = np.sort(np.mod(np.arctan2([c[1] for c in corners], [c[0] for c in corners]), 2 * np.pi))
        total = 0.0
        for low, high in zip(turns, np.roll(turns, -1) + 2 * np.pi * (np.arange(4) == 3), strict=True):

            def rim(turn: float) -> float:
                c, s = np.cos(turn), np.sin(turn)
                return min((np.copysign(a, c) - at[0]) / c, (np.copysign(b, s) - at[1]) / s)

            total += dblquad(polar, low, high, 1e-9, rim, epsabs=1e-8, epsrel=1e-8)[0]
        # offsets run from the patch to the point: odd entries turn their sign
        total *= -1 if (i == 2) != (j == 2) else 1
        assert found[i, j] == pytest.approx(total, abs=1e-6 * found[2, 2])


def test_own_centre_of_a_square() -> None:
    found = rectangle(GROUND, [0.0, 0.0], (2.0, 2.0))[2, 2]
    assert found == pytest.approx((1 - GROUND.nu**2) / (np.pi * GROUND.E) * 8 * np.log(1 + np.sqrt(2)), rel=1e-14)


@pytest.mark.parametrize("at", [(-30.0, 1e-7), (-30.0, 0.0), (1e-7, -30.0), (-1.0, 0.6), (0.0, 0.6), (1.0, 0.0)])
def test_no_logarithm_cancels(at: tuple[float, float]) -> None:
    with np.errstate(all="raise"):
        found, beside = rectangle(GROUND, at, (2.0, 1.2)), rectangle(GROUND, (*at, -1e-9), (2.0, 1.2))
    np.testing.assert_allclose(found, beside, atol=1e-6 * np.abs(found).max())


def test_four_small_patches_are_a_large_one_and_units_do_not_matter() -> None:
    at = np.array([0.37, 1.4, -0.2])
    parts = [rectangle(GROUND, at - np.array([x, y, 0.0]), (1.0, 0.6)) for x in (-0.5, 0.5) for y in (-0.3, 0.3)]
    large = rectangle(GROUND, at, (2.0, 1.2))
    np.testing.assert_allclose(np.sum(parts, axis=0), large, rtol=1e-12)
    tiny = rectangle(HalfSpace(GROUND.E * 1e6, GROUND.nu), at * 1e-6, (2e-6, 1.2e-6))
    np.testing.assert_allclose(tiny * 1e12, large, rtol=1e-9)


def test_uniform_disc() -> None:
    a, p = 1.7, 0.3
    load = radial(GROUND, "uniform", a, [0.0, a])[:, 0] * p * np.pi * a**2
    E, nu = GROUND.E, GROUND.nu
    np.testing.assert_allclose(load, [2 * (1 - nu**2) * p * a / E, 4 * (1 - nu**2) * p * a / (np.pi * E)], rtol=1e-12)


def test_a_disc_is_the_sum_of_its_patches() -> None:
    """Press, shear and their coupling, under the surface: little squares instead of the closed form of a disc."""
    n = 200
    x = (np.arange(n) + 0.5) / n * 2 - 1
    q = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    q = q[np.hypot(*q.T) < 1]
    at = np.array([0.8, 0.5, -0.6])
    offsets = np.column_stack([at[:2] - q, np.full(len(q), at[2])])
    truth = point_forces(GROUND, offsets).mean(axis=0)
    f = radial(GROUND, "uniform", 1.0, [np.hypot(0.8, 0.5)], [-0.6])
    found = np.column_stack([moved(f, at[None, :2], e)[0] for e in np.eye(3)])
    np.testing.assert_allclose(found, truth, atol=3e-4 * np.abs(truth).max())


def test_what_cannot_be_is_refused() -> None:
    for what, make in {
        "no bound": lambda: point_forces(GROUND, [0.0, 0.0, 0.0]),
        "above": lambda: point_forces(GROUND, [1.0, 0.0, 0.1]),
        "two or three": lambda: rectangle(GROUND, [1.0], (1.0, 1.0)),
        "sides must be positive": lambda: rectangle(GROUND, [1.0, 0.0], (0.0, 1.0)),
    }.items():
        with pytest.raises(InputError, match=what):
            make()
