"""Hertz and Cattaneo-Mindlin against worked values and convolution; the guard of half-space formulas on thin pads."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from structures import InputError, NotIdentifiable
from structures._flags import codes
from tactile import Hertz, Mindlin
from tactile._closed import halfspace as closed
from tactile._closed.halfspace import point_forces

SPHERE = Hertz(4.0, 1.0, 0.147, 0.3223)


def test_worked_values() -> None:
    assert (SPHERE.radius, SPHERE.peak, SPHERE.approach) == pytest.approx((2.6347, 0.0688, 1.7354), rel=5e-4)
    assert SPHERE.depth([0.0])[0] == pytest.approx(SPHERE.approach, rel=1e-12)
    total = quad(lambda r: SPHERE.pressure([r])[0] * 2 * np.pi * r, 0, SPHERE.radius)[0]
    assert total == pytest.approx(SPHERE.force, rel=1e-7)


def test_inside_the_contact_the_surface_has_the_shape_of_the_sphere() -> None:
    r = np.linspace(0, SPHERE.radius, 9)
    np.testing.assert_allclose(SPHERE.approach - SPHERE.depth(r), r**2 / 2 / SPHERE.R, atol=1e-12)


def _convolved(radius: float, at: float, entry: tuple[int, int]) -> float:
    """Motion at (at, 0) of the traction sqrt(1 - r^2/radius^2), by polar quadrature about that point."""
    x, w = np.polynomial.legendre.leggauss(80)
    t, dt = (1 - np.cos(np.pi * (x + 1) / 2)) / 2, np.pi / 4 * w * np.sin(np.pi * (x + 1) / 2)
    if at < radius:
        turn, dturn = (np.arange(90) + 0.5) * np.pi / 45, np.full(90, np.pi / 45)
    else:
        rim = np.arcsin(radius / at)
        turn, dturn = rim * (2 * t - 1), 2 * rim * dt
    half = np.sqrt(radius**2 - (at * np.sin(turn)) ** 2)
    low, high = np.maximum(at * np.cos(turn) - half, 0), at * np.cos(turn) + half
    rho = low[:, None] + np.outer(high - low, t)
    offsets = np.stack([rho * np.cos(turn)[:, None], rho * np.sin(turn)[:, None]], axis=-1)
    square = 1 - ((at - offsets[..., 0]) ** 2 + offsets[..., 1] ** 2) / radius**2
    traction = np.sqrt(np.clip(square, 0, None))
    weight = np.outer(dturn * (high - low), dt) * rho
    return float((weight * traction * point_forces(SPHERE.ground, offsets)[..., *entry]).sum())


@pytest.mark.parametrize("share", [0.0, 0.4, 0.9, 1.3, 2.5])
def test_hertz_depth_is_the_convolution_of_the_pressure(share: float) -> None:
    at = share * SPHERE.radius
    found = SPHERE.peak * _convolved(SPHERE.radius, at, (2, 2))
    assert SPHERE.depth([at])[0] == pytest.approx(found, rel=1e-5)
    assert -SPHERE.press().displacement(SPHERE.ground, [[at, 0.0]])[0, 2] == pytest.approx(SPHERE.depth([at])[0])


def test_mindlin_sticks_inside_and_holds_friction() -> None:
    slip = Mindlin(SPHERE, 0.25, 0.5)
    assert slip.stick / slip.radius == pytest.approx(0.7937, abs=5e-5)
    assert slip.shift == pytest.approx(0.39742, abs=5e-6)
    r = np.linspace(0, 1.2 * slip.radius, 200)
    assert (slip.traction(r) <= slip.friction * SPHERE.pressure(r) + 1e-12 * SPHERE.peak).all()
    total = quad(lambda r: slip.traction([r])[0] * 2 * np.pi * r, 0, slip.radius, points=[slip.stick])[0]
    assert total == pytest.approx(0.25, rel=1e-6)

    def moved(at: float) -> float:
        both = _convolved(slip.radius, at, (0, 0)), _convolved(slip.stick, at, (0, 0))
        return slip.friction * SPHERE.peak * (both[0] - slip.stick / slip.radius * both[1])

    for share in (0.0, 0.5, 0.95):
        assert moved(share * slip.stick) == pytest.approx(slip.shift, rel=1e-4)
    # in the ring that slips the pad stays behind the sphere
    assert moved(0.97 * slip.radius) < 0.99 * slip.shift


def test_mindlin_as_presses_is_the_same_load() -> None:
    slip = Mindlin(SPHERE, 0.25, 0.5)
    loads = slip.presses(at=(1.0, 2.0), direction=(3.0, 4.0))
    np.testing.assert_allclose(loads.resultant((1.0, 2.0)), [0.15, 0.2, -1, 0, 0, 0], atol=1e-14)
    r = np.linspace(0, 3, 31)
    found = loads.traction(np.column_stack([1.0 + r, np.full(31, 2.0)]))
    truth = np.outer(slip.traction(r), [0.6, 0.8, 0]) - np.outer(SPHERE.pressure(r), [0, 0, 1])
    np.testing.assert_allclose(found, truth, atol=1e-15)
    inside = np.column_stack([1.0 + np.linspace(0, 0.99, 9) * slip.stick, np.full(9, 2.0)])
    shear = loads.displacement(SPHERE.ground, inside) - SPHERE.press((1.0, 2.0)).displacement(SPHERE.ground, inside)
    np.testing.assert_allclose(shear[:, :2], np.tile(slip.shift * np.array([0.6, 0.8]), (9, 1)), rtol=1e-10)


def test_full_slip_and_no_shear_are_the_ends() -> None:
    full, none = Mindlin(SPHERE, 0.5, 0.5), Mindlin(SPHERE, 0.0, 0.5)
    assert full.stick == 0
    np.testing.assert_allclose(full.traction([0.0, 1.0]), 0.5 * SPHERE.pressure([0.0, 1.0]))
    assert none.stick == none.radius
    assert (none.shift, np.abs(none.traction([0.0, 1.0])).max()) == (0.0, 0.0)
    with pytest.raises(InputError, match="friction cannot hold"):
        Mindlin(SPHERE, 0.51, 0.5)


def test_thick_pads_are_silent_thin_ones_warned_and_refused() -> None:
    radius = SPHERE.radius
    assert Hertz(4.0, 1.0, 0.147, 0.3223, thickness=11 * radius).flags == ()
    flagged = Hertz(4.0, 1.0, 0.147, 0.3223, thickness=radius / 0.3 * 1.001).flags
    assert codes(flagged) == {"W601"}
    assert "18 %" in flagged[0].message  # literature page: 18-22 % at 0.3
    with pytest.raises(NotIdentifiable, match=r"51 % too soft.*1, nu") as refused:
        Hertz(4.0, 1.0, 0.147, 0.3223, thickness=radius)
    assert refused.value.code == "LID-E602"
    allowed = Hertz(4.0, 1.0, 0.147, 0.3223, thickness=radius, allow=["E602"]).flags
    assert codes(allowed) == {"E602"}
    assert "allowed by the user" in allowed[0].message


@pytest.mark.parametrize(("nu", "ratio", "percent"), [(0.3223, 0.1, 5.9), (0.49, 0.1, 7.4), (0.49, 0.3, 21.7)])
def test_the_guard_knows_by_how_much(nu: float, ratio: float, percent: float) -> None:
    assert closed.too_soft(ratio, nu) == pytest.approx(percent, abs=0.1)


def test_near_the_edge() -> None:
    assert closed.near_edge(12.1e-3, 3e-3) is None
    flag = closed.near_edge(6e-3, 3e-3)
    assert flag is not None
    assert flag.code == "LID-W601"
    assert "2 thicknesses" in flag.message
